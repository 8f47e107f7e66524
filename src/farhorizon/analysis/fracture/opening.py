r"""The displacement jump between the faces of a crack, and the intensities that follow from it.

Near a tip the jump of the displacement is :math:`\frac{8K}{E'}\sqrt{r / 2\pi}` in each mode: across the crack in mode
I, along it in mode II, out of the plane in mode III, where :math:`E' = 2\mu` (Williams, 1957, J. Appl. Mech. 24, 109).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from farhorizon.analysis.fracture.interaction import parabolas
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Cut, Polyline

_BESIDE = 1e-6  # spacings by which a face is off the crack, on its side


def opening_intensity(r: np.ndarray, jump: np.ndarray, stiffness: float, near: tuple[float, float]) -> float:
    """Intensity from the jumps (n,) of the displacement at distances r (n,) behind the tip, between the two distances
    `near`. The square is fitted by a parabola, because the position of the tip between two nodes is known only to a
    fraction of the spacing; an InputError for fewer than four places.
    """
    used = (r > near[0]) & (r < near[1])
    if used.sum() < 4:
        raise InputError(
            "too few places along the crack tell its intensity",
            value=int(used.sum()),
            limit="4 or more",
            key="opening_intensity.near",
            remedy="a wider part of the crack, or a finer lattice",
        )
    square = np.polynomial.Polynomial.fit(r[used], jump[used] ** 2, 2)
    roots = square.roots()
    tip = roots[np.argmin(np.abs(roots))]
    return float(np.sign(jump[used].mean()) * np.sqrt(2 * np.pi * np.abs(square.deriv()(tip).real)) * stiffness / 8)


def face_jumps(
    u: np.ndarray, lattice: Lattice, crack: Polyline, along: np.ndarray, cuts: Sequence[Cut] = ()
) -> np.ndarray:
    """Jumps (n,), or (n, 2) across and along the crack, of a field (nx, ny), or (2, nx, ny), from the right to the left
    face at distances `along` (n,) from the crack's first point; the values on a face are from parabolas fitted to the
    nodes on its side.
    """
    steps = np.diff(crack.points, axis=0)
    ends = np.append(0.0, np.cumsum(np.linalg.norm(steps, axis=1)))
    s = np.asarray(along, float)
    if s.size and not (s.min() >= 0 and s.max() <= ends[-1]):
        raise InputError(
            "a place beyond the ends of the crack",
            value=[float(s.min()), float(s.max())],
            limit=f"0 to {ends[-1]:.6g}",
            key="face_jumps.along",
        )
    number = np.clip(np.searchsorted(ends, s, side="right") - 1, 0, len(steps) - 1)
    tangent = (steps / np.linalg.norm(steps, axis=1)[:, None])[number]
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
    at = crack.points[number] + (s - ends[number])[:, None] * tangent
    grid = np.stack(lattice.coordinates(), axis=-1).reshape(-1, 2)
    values = np.reshape(u, (-1, len(grid)))
    sides = []
    for sign in (1, -1):
        faces = at + sign * _BESIDE * lattice.spacing * normal
        numbers, weights = parabolas(faces, grid, [crack, *cuts], lattice.spacing)
        sides.append(np.einsum("qn,cqn->qc", weights[:, 0], values[:, numbers]))
    jump = sides[0] - sides[1]
    if len(values) == 1:
        return np.asarray(jump[:, 0])
    return np.stack([(jump * normal).sum(1), (jump * tangent).sum(1)], axis=-1)
