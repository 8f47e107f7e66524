r"""Stress intensity factors from the interaction integral over a domain around the tip.

For a field and an auxiliary one of unit intensity (a: that of `farhorizon.analysis.fracture.near_tip`), with q = 1
inside a circle around the tip, falling to 0 at another one,

.. math:: M = \int \left(\sigma_{ij} u^a_{i,1} + \sigma^a_{ij} u_{i,1} - \sigma^a_{mn} u_{m,n} \delta_{1j}\right)
   q_{,j}\,dA + \int q\,(\rho \ddot u_i - b_i)\,u^a_{i,1}\,dA = \frac{2K}{E'}

(Yau, Wang and Corten, 1980, J. Appl. Mech. 47, 335; Li, Shih and Needleman, 1985, Eng. Fract. Mech. 21, 405). The
second integral contains the inertia inside and the loads on the medium there, including those on the faces of the
crack; with it the result does not depend on the circles. The gradient is needed only between the circles, away from the
tip, and is fitted to the nodes on the same side of the crack, so that K is a sum over the nodes: weights times
displacements, and weights times the forces on the nodes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from farhorizon.analysis.fracture.near_tip import NearTip
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Cut
from farhorizon.rounding import MARGIN

_NEAR = 3.4  # radius in spacings of the nodes to which parabolas are fitted; next to a face, three rows of them
_FARTHEST = 6.0  # largest radius, where a crack hides some of them
_ENOUGH = 9  # number of nodes for the six coefficients of a parabola
_MOST_ALONG = 16  # points of the quadrature across the ring, where fields are smooth; eight times as many around it
_GRAZING = 1e-6  # part of a half-turn by which the circles are examined short of the faces


class InteractionDomain:
    """A ring between two `radii` around the tip of a straight crack, with the flat indices of its `nodes` (N,), and
    their weights, (modes, N, components), in the intensities: `static` on displacements, `loaded` on the force per
    volume that bonds exert; an InputError if a circle leaves the near field or a crack crosses it other than once,
    behind the tip.
    """

    def __init__(
        self,
        lattice: Lattice,
        tip: Sequence[float] | np.ndarray,
        ahead: Sequence[float] | np.ndarray,
        radii: tuple[float, float],
        cuts: Sequence[Cut],
        medium: NearTip,
    ) -> None:
        self.medium, self.modes, self.radii = medium, medium.modes, radii
        self.tip, self._lattice, self._cuts = np.asarray(tip, float), lattice, list(cuts)
        first = np.asarray(ahead, float) / np.linalg.norm(ahead)
        self._axes = np.array([first, [-first[1], first[0]]])  # rows: the axes of the tip
        _check_circles(lattice, self.tip, self._axes, radii, cuts)
        grid = np.stack(lattice.coordinates(), axis=-1).reshape(-1, 2)
        inside = np.linalg.norm(grid - self.tip, axis=1) < radii[1] + _FARTHEST * lattice.spacing
        candidates = np.flatnonzero(inside & (True if lattice.mask is None else lattice.mask.ravel()))
        where, area = self._quadrature(lattice.spacing)
        numbers, slopes = parabolas(where, grid[candidates], cuts, lattice.spacing)
        parts = np.einsum("kqij,qjn->qnki", self._on_gradient(where, area), slopes[:, 1:])
        total = np.zeros((len(candidates), *parts.shape[2:]))
        np.add.at(total, numbers, parts)
        static = total.swapaxes(0, 1)
        loaded = self._on_force(grid[candidates], lattice.spacing**2)
        used = np.abs(static).any((0, 2)) | np.abs(loaded).any((0, 2))
        self.nodes, self.static, self.loaded = candidates[used], static[:, used], loaded[:, used]

    def intensities(self, u: np.ndarray, force: np.ndarray | None = None) -> np.ndarray:
        """Stress intensity factors (..., modes) of displacements u (..., N, components), and of the force per volume of
        the bonds.
        """
        static = np.einsum("knc,...nc->...k", self.static, u)
        return static if force is None else static + np.einsum("knc,...nc->...k", self.loaded, force)

    def energy_release(
        self, u: np.ndarray, v: np.ndarray, density: float, force: np.ndarray, held: np.ndarray | None = None
    ) -> float:
        """Energy that flows into the tip per new area, of a stationary or running crack, from displacements, velocities
        and `force` (density times acceleration, less the load), each (nx, ny) or (2, nx, ny), at the nodes `held` by
        bonds.

        It is the domain integral of ``(sigma_ij u_i,1 - (W + T) delta_1j) q_,j + q ((rho u_i'' - b_i) u_i,1 - rho u_i'
        u_i,1')`` (Nakamura, Shih and Freund, 1985, Int. J. Fract. 27, 229). Its second part leaves out what is closer
        to the tip than three spacings, where the fields are singular: for a running crack its terms cancel there.
        """
        lattice, components = self._lattice, 1 if self.medium.antiplane else 2
        part = slice(None) if held is None else np.flatnonzero(held)
        grid = np.stack(lattice.coordinates(), axis=-1).reshape(-1, 2)[part]
        fields = [np.reshape(values, (components, -1))[:, part] for values in (u, v, force)]
        where, area = self._quadrature(lattice.spacing)
        strain, _, motion = self._read(where, grid, fields)
        _, theta = self._polar(where)
        fall = -np.stack([np.cos(theta), np.sin(theta)], axis=-1) / (self.radii[1] - self.radii[0])
        stress = self.medium.stress(strain)
        energy = (stress * strain).sum((1, 2)) / 2 + density * (motion**2).sum(1) / 2
        flow = np.einsum("qij,qi,qj->q", stress, strain[..., 0], fall) - energy * fall[:, 0]
        r = self._polar(grid)[0]
        inside = np.flatnonzero((r < self.radii[1]) & (r > 3 * lattice.spacing))
        strain, rates, _ = self._read(grid[inside], grid, fields)
        q = np.clip((self.radii[1] - r[inside]) / (self.radii[1] - self.radii[0]), 0.0, 1.0)
        motion, net_force = fields[1][:, inside].T @ self._frame.T, fields[2][:, inside].T @ self._frame.T
        change = (net_force * strain[..., 0]).sum(1) - density * (motion * rates[..., 0]).sum(1)
        return float(area @ flow + lattice.spacing**2 * (q @ change))

    @property
    def _frame(self) -> np.ndarray:
        """Rotation of components of the field to the axes of the tip."""
        return np.eye(1) if self.medium.antiplane else self._axes

    def _read(
        self, where: np.ndarray, grid: np.ndarray, fields: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """In the axes of the tip: gradients of the displacements and of the velocities at points, (Q, components, 2),
        and the velocities, (Q, components).
        """
        numbers, weights = parabolas(where, grid, self._cuts, self._lattice.spacing)
        u, v = (np.einsum("qjn,cqn->qcj", weights, values[:, numbers]) for values in fields[:2])
        gradients = [np.einsum("ac,qcb,db->qad", self._frame, values[..., 1:], self._axes) for values in (u, v)]
        return gradients[0], gradients[1], v[..., 0] @ self._frame.T

    def _quadrature(self, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Points between the circles, shape (Q, 2), and the area that each represents."""
        inner, outer = self.radii
        along = int(np.clip(np.ceil((outer - inner) / spacing) + 1, 4, _MOST_ALONG))
        # angles vary no faster than cos(3 theta), which 24 points integrate to rounding
        around = int(np.clip(np.ceil(2 * np.pi * outer / spacing), 24, 8 * _MOST_ALONG))
        (s, ds), (t, dt) = (np.polynomial.legendre.leggauss(n) for n in (along, around))
        r, theta = (inner + outer) / 2 + (outer - inner) / 2 * s, np.pi * t
        local = np.stack([np.multiply.outer(r, f(theta)) for f in (np.cos, np.sin)], axis=-1)
        area = np.multiply.outer(r * ds * (outer - inner) / 2, np.pi * dt)
        return self.tip + local.reshape(-1, 2) @ self._axes, area.ravel()

    def _polar(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance from the tip, and angle from the direction ahead."""
        x, y = ((points - self.tip) @ self._axes.T).T
        return np.hypot(x, y), np.arctan2(y, x)

    def _on_gradient(self, where: np.ndarray, area: np.ndarray) -> np.ndarray:
        """Weights on the gradient of the field at the points, shape (modes, Q, components, 2)."""
        r, theta = self._polar(where)
        _, auxiliary = self.medium.fields(r, theta)
        stress = self.medium.stress(auxiliary)
        fall = -np.stack([np.cos(theta), np.sin(theta)], axis=-1) / (self.radii[1] - self.radii[0])  # grad q
        weights = self.medium.stress(np.einsum("kqi,qj->kqij", auxiliary[..., 0], fall))
        weights[..., 0] += np.einsum("kqij,qj->kqi", stress, fall)
        weights -= stress * fall[:, 0, None, None]
        weights *= area[:, None, None] * self.medium.stiffness / 2
        rotated = weights @ self._axes
        return rotated if self.medium.antiplane else np.einsum("kqia,ib->kqba", rotated, self._axes)

    def _on_force(self, points: np.ndarray, cell: float) -> np.ndarray:
        """Weights on the force at nodes, shape (modes, N, components)."""
        r, theta = self._polar(points)
        inner, outer = self.radii
        q = np.clip((outer - r) / (outer - inner), 0.0, 1.0)
        apart = np.maximum(r, 1e-3 * np.sqrt(cell))  # the gradient of a node on the tip itself is not finite
        ahead = self.medium.fields(apart, theta)[1][..., 0] * (q * cell * self.medium.stiffness / 2)[:, None]
        return ahead if self.medium.antiplane else ahead @ self._axes


def parabolas(
    where: np.ndarray, nodes: np.ndarray, cuts: Sequence[Cut], spacing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Value and derivatives at points (Q, 2) as sums over nodes (N, 2), by parabolas fitted to nearby nodes that no
    crack hides: numbers of the nodes that each point uses, (Q, K), and weights for the value and for the derivatives
    along the axes, (Q, 3, K).
    """
    most = min(len(nodes), int(np.ceil(np.pi * (_FARTHEST + 1) ** 2)))
    distance, numbers = cKDTree(nodes).query(where, most, distance_upper_bound=_FARTHEST * spacing)
    missing = ~np.isfinite(distance)
    numbers[missing] = 0
    for cut in cuts:
        missing |= cut.cuts(where[:, None], nodes[numbers])
    distance = np.where(missing, np.inf, distance / spacing)
    enough = np.sort(distance, axis=1)[:, min(_ENOUGH, most - 1), None]
    within = np.maximum(_NEAR, np.where(np.isfinite(enough), enough, _FARTHEST) * (1 + MARGIN))
    weight = np.maximum(0.0, 1 - (np.where(missing, within, distance) / within) ** 2) ** 2
    x, y = np.moveaxis((nodes[numbers] - where[:, None]) / spacing, -1, 0)
    table = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    weighted = table * weight[:, None]
    fitted = (np.linalg.pinv(weighted @ table.swapaxes(1, 2), hermitian=True) @ weighted)[:, :3]
    return numbers, fitted / np.array([1.0, spacing, spacing])[:, None]


def _check_circles(
    lattice: Lattice, tip: np.ndarray, axes: np.ndarray, radii: tuple[float, float], cuts: Sequence[Cut]
) -> None:
    """Refuse circles that leave the near field, or that cracks cross other than once behind the tip."""
    inner, outer = radii
    spacing = lattice.spacing
    if not 2 * spacing <= inner * (1 + MARGIN) < outer - spacing:
        raise InputError(
            "the circles around the tip are too close to it or to each other",
            value=[float(r) for r in radii],
            limit=f"the smaller {2 * spacing:.4g} at least, the larger {spacing:.4g} more than that",
            key="stress_intensity.radii",
            remedy="larger circles, a longer crack, or a finer lattice",
        )
    room = float(min((tip - lattice.lower).min(), (lattice.upper - tip).min()))
    if outer > room + MARGIN * spacing:
        raise InputError(
            "the domain around the tip leaves the near field",
            value=float(outer),
            limit=f"{room:.6g} from the tip {tip.tolist()} to the edge",
            key="stress_intensity.radii",
            remedy="smaller radii, or a larger near field",
        )
    r = np.append(np.arange(spacing, outer, spacing / 2), outer)
    theta = np.linspace(-np.pi, np.pi, max(16, int(np.ceil(4 * np.pi * outer / spacing))) + 1)
    theta[[0, -1]] *= 1 - _GRAZING
    rings = tip + r[:, None, None] * (np.stack([np.cos(theta), np.sin(theta)], axis=-1) @ axes)
    behind, elsewhere = np.zeros((2, len(r)), int)
    for cut in cuts:
        behind += cut.cuts(rings[:, -1], rings[:, 0])
        elsewhere += cut.cuts(rings[:, :-1], rings[:, 1:]).sum(1)
        elsewhere[1:] += cut.cuts(rings[:-1], rings[1:]).sum(1)
    wrong = np.flatnonzero((behind != 1) | (elsewhere > 0))
    if wrong.size:
        raise InputError(
            "around the tip of a crack its domain is cut by another crack, or by this one elsewhere than straight "
            "behind the tip",
            value=f"at a distance of {r[wrong[0]]:.6g} from {tip.tolist()}",
            limit=f"radii {inner:.6g} and {outer:.6g}",
            key="stress_intensity.radii",
            remedy="smaller radii, within which the crack is straight and alone; or the right direction",
        )
    if lattice.mask is not None:
        grid = np.stack(lattice.coordinates(), axis=-1)
        holes = ~lattice.mask & (np.linalg.norm(grid - tip, axis=-1) < outer)
        if holes.any():
            raise InputError(
                "the domain around the tip has places without nodes",
                value=grid[holes][0].tolist(),
                key="stress_intensity.radii",
                remedy="smaller radii",
            )
