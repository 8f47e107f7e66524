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
    """Intensity from the jump along a crack. Its square is fitted by a parabola in the distance, because the position
    of the tip between two nodes is known only to a fraction of the spacing.

    Parameters
    ----------
    r, jump : ndarray, shape (n,)
        Distances from the tip, and displacement jumps there.
    stiffness : float
        E', see `farhorizon.analysis.fracture.near_tip.NearTip.stiffness`.
    near : (float, float)
        Distances between which the jump is used: above the horizon, and below a small part of the length of the crack.

    Raises
    ------
    InputError
        There are fewer than four places between them.

    Examples
    --------
    >>> import numpy as np
    >>> r = np.linspace(0.1, 4.0, 40)
    >>> jump = 8 * 1.7 / 2.0 * np.sqrt((r + 0.04) / (2 * np.pi))  # the tip is a little farther on
    >>> round(opening_intensity(r, jump, stiffness=2.0, near=(0.3, 2.0)), 12)
    1.7
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
    """Jumps of a field across a crack in the plane, from its right to its left side in the order of its points. The
    values on each face are from parabolas fitted to the nodes on its side.

    Parameters
    ----------
    u : ndarray, shape (nx, ny), of vectors (2, nx, ny)
    lattice : Lattice
    crack : Polyline
    along : ndarray, shape (n,)
        Distances from the crack's first point.
    cuts : sequence of Cut
        Other cracks.

    Returns
    -------
    ndarray, shape (n,), of vectors (n, 2)
        For vectors, the components across the crack (positive where it is open) and along it.

    Raises
    ------
    InputError
        A place is beyond the crack's ends.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> lattice, crack = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0)), fh.Polyline([(-3.0, 0.2), (3.0, 0.2)])
    >>> x, y = lattice.coordinates()
    >>> face_jumps(x * (y > 0.2), lattice, crack, np.array([2.0, 5.0])).round(9).tolist()
    [-1.0, 2.0]
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
