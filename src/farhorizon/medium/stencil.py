"""Stencils: offsets and weights of a linear lattice operator, its symbol and its backward waves."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import factorial
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.files.storable import Storable
from farhorizon.medium.kernel import Kernel
from farhorizon.rounding import EQUAL, MARGIN

ORDERS = (2, 4, 6, 8)
"""Orders of accuracy of `Stencil.finite_difference`."""
_NO_DECAY = 1e-12  # rate of decay, over that of diffusion, that is rounding
_FARTHEST = 1000  # largest component of an offset, in nodes
_MOST_NEIGHBOURS = 100_000  # in a kernel's stencil: far more than any use needs, and still built quickly


@dataclass(frozen=True)
class BackwardWaves:
    """Waves whose group and phase velocity have opposite signs along an axis."""

    #: Largest first-order growth rate per unit of layer strength sigma; 0 if there are no backward waves.
    growth: float
    #: Fraction of the Brillouin zone in which waves are backward along any axis.
    fraction: float
    #: Smallest |k| times spacing of a backward wave; infinite if there are none.
    first_wavenumber: float

    def __bool__(self) -> bool:
        return self.growth > 0


class Stencil(Storable):
    """A translation-invariant operator ``(L u)_i = sum_k w_k (u_(i+k) - u_i) - r u_i``, for unit spacing and
    coefficient.

    Every operator with a finite reach has this form: the differences contain the effect of the neighbours on a node,
    and r that of its own value.

    Parameters
    ----------
    offsets : array_like of int, shape (K, dim)
        Offsets of the neighbours, without the centre.
    weights : array_like, shape (K,), or (K, d, d) for a field of d components, in two or three dimensions
        A model multiplies them by ``coefficient / spacing^2``. A field with as many components as axes is treated as a
        vector along these.
    reaction : float, or array_like, shape (d, d)
        r, the coefficient with which a node's own value is drawn back, scaled like the weights: the squared mass of a
        Klein-Gordon field, the stiffness of an elastic foundation, the rate of a decay. A coefficient that varies from
        node to node applies to the bonds and does not affect r. A symmetric matrix where the components are drawn back
        differently, as rotations of nodes are. That of a scalar may be negative, which is growth.

    Attributes
    ----------
    drifting : bool
        Whether weights at k and -k differ.

    Raises
    ------
    InputError
        Repeated or zero offsets, weights that are not finite, a stencil that is not symmetric, ``w_(-k) = w_k`` (for
        matrices the transpose), a negative reaction of vectors (a matrix that is not symmetric or has a negative
        eigenvalue).

    Notes
    -----
    In one dimension w_(-k) may differ from w_k: what diffuses then also drifts, with the velocity
    ``-coefficient / spacing * sum_k k w_k``, as in peridynamic advection and diffusion (Zhao, Chen, Mehrmashadi and
    Bobaru, Int. J. Heat Mass Transf. 126 (2018) 1253). Such a stencil serves diffusion and heat by forward Euler,
    between sides of type `Exact`, `Fixed` or `Periodic`.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> stencil = fh.Stencil.finite_difference(2)
    >>> float(stencil.symbol(np.pi, np.pi))  # 4 - 2 cos kx - 2 cos ky
    8.0
    """

    def __init__(self, offsets: np.ndarray, weights: np.ndarray, reaction: float | np.ndarray = 0.0) -> None:
        given = np.atleast_2d(kinds.array(offsets, "stencil.offsets"))
        weights, offsets = (
            kinds.array(weights, "stencil.weights"),
            np.round(np.clip(given, -_FARTHEST, _FARTHEST)).astype(int),
        )
        if given.ndim != 2 or (given != offsets).any():
            raise InputError(
                "offsets are whole numbers of nodes",
                value=given,
                limit=f"at most {_FARTHEST} in magnitude, shape (K, dim)",
                key="stencil.offsets",
            )
        count, dim = offsets.shape
        matrices = weights.ndim == 3 and dim > 1 and weights.shape[1] == weights.shape[2] > 1
        if weights.shape[:1] != (count,) or not (weights.ndim == 1 or matrices) or not 1 <= dim <= 3:
            raise InputError(
                "a stencil needs one weight an offset in 1 to 3 dimensions, or one square matrix in 2 or 3",
                value=(offsets.shape, weights.shape),
            )
        if not count:
            raise InputError(
                "a stencil needs neighbours",
                value=f"{count} offsets",
                limit="2 or more",
                key="stencil.offsets",
                remedy="those next to a node and their weights: [[1], [-1]] and [1.0, 1.0] in 1D",
            )
        if len(np.unique(offsets, axis=0)) != count or not offsets.any(1).all():
            raise InputError("stencil offsets must be distinct and not zero", value=offsets.tolist())
        order = np.lexsort(offsets.T[::-1])
        self.offsets, self.weights = offsets[order], weights[order]
        self.dim = dim
        self.reaction = _reaction(reaction, self.components)
        unlike = self._unlike(-self.offsets, np.swapaxes(self.weights, 1, 2) if weights.ndim == 3 else self.weights)
        self.drifting = dim == 1 and unlike is not None
        if unlike is not None and not self.drifting:
            raise InputError(
                "a stencil must have equal weights at k and -k, of matrices the transpose",
                value=unlike,
                remedy="symmetrise the table",
            )

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Stencil)
            and np.array_equal(self.offsets, other.offsets)
            and np.array_equal(self.weights, other.weights)
            and np.array_equal(self.reaction, other.reaction)
        )

    def __hash__(self) -> int:
        return hash((self.offsets.tobytes(), self.weights.tobytes(), np.asarray(self.reaction).tobytes()))

    @cached_property
    def accuracy(self) -> int:
        """Order of the central differences that the bonds are (`finite_difference`); 0 for other stencils."""
        if self.components > 1:
            return 0
        bonds = self.with_reaction(0.0)
        return next((order for order in ORDERS if bonds == Stencil.finite_difference(self.dim, order)), 0)

    @property
    def drift(self) -> float:
        """Nodes by which a `drifting` medium carries its field in a unit of time, 0 for others."""
        return abs(float(self.weights @ self.offsets[:, 0])) if self.drifting else 0.0

    @property
    def components(self) -> int:
        """Number of components of the field: 1 for scalar weights, otherwise the number of rows of the matrices."""
        return 1 if self.weights.ndim == 1 else self.weights.shape[1]

    @property
    def own(self) -> Any:
        """The reaction as a factor on a node's own value: a number for scalar weights, otherwise a matrix."""
        return (
            self.reaction if self.components == 1 or np.ndim(self.reaction) else self.reaction * np.eye(self.components)
        )

    @property
    def strongest_reaction(self) -> float:
        """Largest magnitude of the reaction, or of its eigenvalues."""
        return float(np.linalg.eigvalsh(self.reaction)[-1]) if np.ndim(self.reaction) else abs(float(self.reaction))

    @cached_property
    def signs(self) -> np.ndarray:
        """Sign of each component in a reflection across each axis: 1 if it is kept, -1 if it changes; shape
        (components, dim).

        The component of a vector along the axis changes its sign. For other fields, the signs follow from the weights,
        such that the stencil is invariant if possible.
        """
        if self.components in (1, self.dim):
            return np.ones((1, self.dim), int) if self.components == 1 else 1 - 2 * np.eye(self.dim, dtype=int)
        return np.stack([self._signs_along(axis) for axis in range(self.dim)], axis=-1)

    def _signs_along(self, axis: int) -> np.ndarray:
        """Signs of the components in a reflection across an axis.

        For two components that are coupled, the weights at mirror images determine the product of their signs.
        """
        table = dict(zip(map(tuple, self.offsets.tolist()), self.weights, strict=True))
        mirror = self.offsets * np.where(np.arange(self.dim) == axis, -1, 1)
        missing = np.full_like(self.weights[0], np.inf)
        images = np.stack([table.get(tuple(o), missing) for o in mirror.tolist()])
        limit = EQUAL * np.abs(self.weights).max()
        coupled = np.abs(self.weights).max(0) + np.abs(self.own) > limit
        even = np.abs(images - self.weights).max(0) <= limit
        signs = np.zeros(self.components, int)
        for first in range(self.components):
            signs[first] = signs[first] or 1
            for _ in range(self.components):
                for first_of, second_of in np.argwhere(coupled):
                    if signs[first_of] and not signs[second_of]:
                        signs[second_of] = signs[first_of] * (1 if even[first_of, second_of] else -1)
        return signs

    def _unlike(self, offsets: np.ndarray, weights: np.ndarray) -> list[int] | None:
        """The first offset at which another table differs from this one; None if they are alike."""
        table = dict(zip(map(tuple, self.offsets.tolist()), self.weights, strict=True))
        limit = EQUAL * np.abs(self.weights).max()
        for o, w in zip(offsets.tolist(), weights, strict=True):
            if tuple(o) not in table or np.abs(table[tuple(o)] - w).max() > limit:
                return list(o)
        return None

    def even_along(self, axis: int) -> bool:
        """Whether a reflection across an axis, in which components change `signs`, leaves the stencil unchanged."""
        mirror, sign = np.where(np.arange(self.dim) == axis, -1, 1), self.signs[:, axis]
        weights = self.weights if self.components == 1 else self.weights * np.outer(sign, sign)
        return self._unlike(self.offsets * mirror, weights) is None

    def same_along(self, axis: int, other: int) -> bool:
        """Whether exchanging two axes, and with them the components of a vector, leaves the stencil unchanged."""
        order = np.arange(self.dim)
        order[[axis, other]] = other, axis
        return self._unlike(self.offsets[:, order], self._reordered(order)) is None

    def _reordered(self, order: Sequence[int] | np.ndarray) -> np.ndarray:
        """Weights with the components of a vector in another order."""
        vector = self.components == self.dim > 1
        return self.weights[:, order][:, :, order] if vector else self.weights

    @cached_property
    def positive(self) -> bool:
        """Whether no bond releases energy in any motion of its ends, so that any subset of the bonds is also stable."""
        if self.components == 1:
            return bool((self.weights >= 0).all())
        if np.abs(self.weights - np.swapaxes(self.weights, 1, 2)).max() > EQUAL * np.abs(self.weights).max():
            return False
        return bool(np.linalg.eigvalsh(self.weights).min() >= -EQUAL * np.abs(self.weights).max())

    @classmethod
    def from_kernel(cls, kernel: Kernel, spacing: float, dim: int) -> Stencil:
        """Stencil of a kernel by one-point quadrature with the kernel's volume rule.

        Raises
        ------
        InputError
            A horizon below the spacing (no neighbours), or so many spacings wide that the stencil has more than 100 000
            neighbours.
        """
        grid, weights = cls.family(kernel, spacing, dim)
        if kernel.calibrate:
            weights = weights / (0.5 * (weights * grid[:, 0] ** 2).sum())
        return cls(grid, weights)

    @staticmethod
    def family(kernel: Kernel, spacing: float, dim: int) -> tuple[np.ndarray, np.ndarray]:
        """Offsets (K, dim) and weights (K,) of a kernel by one-point quadrature with its volume rule, for unit spacing,
        not calibrated.

        Raises
        ------
        InputError
            As in `from_kernel`.
        """
        if kernel.horizon < spacing * (1 - MARGIN):
            raise InputError(
                "the horizon is smaller than the spacing, no node has neighbours",
                value=kernel.horizon,
                limit=f">= {spacing}",
                key="kernel.horizon",
                remedy=f"horizon = {3 * spacing:g} (three spacings) or a finer lattice",
            )
        delta = kernel.horizon / spacing
        reach = int(np.floor(delta + (0.5 if kernel.volume == "ramp" else 0.0) + MARGIN))
        if (2 * reach + 1) ** dim > _MOST_NEIGHBOURS:
            most = int((_MOST_NEIGHBOURS ** (1 / dim) - 1) / 2)
            raise InputError(
                "the horizon spans too many nodes",
                value=f"{reach} nodes",
                limit=f"{most} nodes in {dim}D",
                key="kernel.horizon",
                remedy=f"horizon = {3 * spacing:g} (three spacings) or a coarser lattice",
            )
        grid = np.array([o for o in itertools.product(range(-reach, reach + 1), repeat=dim) if any(o)])
        r = np.sqrt((grid**2).sum(1))
        fraction = (
            np.clip(delta + 0.5 - r, 0.0, 1.0) if kernel.volume == "ramp" else (r <= delta + MARGIN).astype(float)
        )
        c = kernel.scaling_constant(dim) * spacing ** (dim + 2 - kernel.exponent)
        weights = c * kernel.influence_at(r * spacing) * fraction * r ** -float(kernel.exponent)
        used = weights > 1e-14 * weights.max()
        if not used.any():  # such as a linear influence, which is zero at the horizon
            raise InputError(
                "every neighbour within the horizon has the weight zero",
                value=kernel.influence,
                key="kernel.influence",
                remedy=f"horizon = {3 * spacing:g} (three spacings)",
            )
        return grid[used], weights[used]

    @classmethod
    def finite_difference(cls, dim: int, order: int = 2) -> Stencil:
        r"""The Laplacian by central differences along the axes: 3, 5 or 7 points for the classical one of order 2.

        Parameters
        ----------
        dim : int
        order : {2, 4, 6, 8}
            Order of accuracy: the error of long waves is proportional to that power of the spacing. A stencil of order
            2m reaches m nodes. Above 2, some weights are negative, so that the bonds serve media that do not end: free
            sides, bodies and cracks are refused. Where a medium varies, bonds average it to the second order only, and
            a layer of one or two nodes that is much softer than the medium around it makes the lattice unstable, which
            a run refuses.

        Raises
        ------
        InputError
            Another order.

        Notes
        -----
        The weight at the distance of k nodes is :math:`2 (-1)^{k+1} (m!)^2 / (k^2 (m - k)!\,(m + k)!)` (Fornberg,
        Math. Comp. 51 (1988) 699).

        Examples
        --------
        >>> import farhorizon as fh
        >>> fh.Stencil.finite_difference(1, order=4).weights.round(4).tolist()
        [-0.0833, 1.3333, 1.3333, -0.0833]
        """
        if kinds.integer(order, "stencil.order", least=2) not in ORDERS:
            raise InputError(
                "central differences of another order",
                value=order,
                limit=", ".join(map(str, ORDERS)),
                key="stencil.order",
                remedy="4, which needs 6 nodes per wavelength for an error of 1 % in speed, where 2 needs 13",
            )
        reach, eye = order // 2, np.eye(dim, dtype=int)
        far = [k * sign * eye for k in range(1, reach + 1) for sign in (1, -1)]
        weights = [
            2 * (-1) ** (k + 1) * factorial(reach) ** 2 / (k**2 * factorial(reach - k) * factorial(reach + k))
            for k in range(1, reach + 1)
        ]
        return cls(np.concatenate(far), np.repeat(weights, 2 * dim))

    @classmethod
    def finite_element(cls, dim: int) -> Stencil:
        """Lumped linear, bilinear or trilinear finite elements on a uniform mesh: 3, 9 or 27 points."""
        stiffness, mass = np.array([1.0, -2.0, 1.0]), np.array([1.0, 4.0, 1.0]) / 6
        table = np.zeros((3,) * dim)
        for axis in range(dim):
            factors = [stiffness if a == axis else mass for a in range(dim)]
            table += np.einsum(",".join("ijk"[:dim]) + "->" + "ijk"[:dim], *factors)
        grid = np.array([o for o in itertools.product((-1, 0, 1), repeat=dim) if any(o)])
        weights = np.array([table[tuple(o + 1)] for o in grid])
        used = np.abs(weights) > 1e-14
        return cls(grid[used], weights[used])

    def along(self, axis: int) -> Stencil:
        """The same stencil with another axis (and component of a vector) first, and the others in their order."""
        return self._by_first_axis[axis]

    @cached_property
    def _by_first_axis(self) -> list[Stencil]:
        """The stencils `along` each axis; this one for all axes that are alike."""
        turned = [self]
        for axis in range(1, self.dim):
            order = [axis, *(a for a in range(self.dim) if a != axis)]
            moved = np.ndim(self.reaction) and self.components == self.dim
            reaction = self.own[order][:, order] if moved else self.reaction
            along = Stencil(self.offsets[:, order], self._reordered(order), reaction)
            turned.append(self if along == self else along)
        return turned

    def with_reaction(self, reaction: float | np.ndarray) -> Stencil:
        """The same bonds with another reaction."""
        return self if np.array_equal(reaction, self.reaction) else Stencil(self.offsets, self.weights, reaction)

    def beside(self, factor: float) -> Stencil:
        """The stencil of a medium whose bonds are stronger by a factor, relative to these; the reaction is the same."""
        return self.with_reaction(self.reaction / factor)

    @cached_property
    def reach(self) -> tuple[int, ...]:
        """Largest offset along each axis."""
        return tuple(int(n) for n in np.abs(self.offsets).max(0))

    def symbol(self, *angles: np.ndarray | float) -> np.ndarray:
        """``sum_k w_k (1 - exp(i k . angle)) + r`` at wavenumbers times spacing, one array per axis (broadcast).

        Returns
        -------
        ndarray
            Real, of the shape of the angles, but complex for a `drifting` stencil; for matrices Hermitian, with two
            additional axes at the end, complex if any weight is not symmetric.
        """
        if self.drifting:
            phase = np.multiply.outer(np.asarray(angles[0], float), self.offsets[:, 0])
            return (2 * np.sin(phase / 2) ** 2 - 1j * np.sin(phase)) @ self.weights + self.own
        bonds = self._sum_up(lambda o, phase: 2 * np.sin(phase / 2) ** 2, lambda o, phase: np.sin(phase), *angles)
        return bonds + self.own

    def symbol_gradient(self, axis: int, *angles: np.ndarray | float) -> np.ndarray:
        """Derivative of the symbol along one axis; of its real part for a `drifting` stencil."""
        if self.drifting:
            phase = np.multiply.outer(np.asarray(angles[0], float), self.offsets[:, 0])
            return np.sin(phase) @ (self.weights * self.offsets[:, 0])
        return self._sum_up(lambda o, phase: o[axis] * np.sin(phase), lambda o, phase: o[axis] * np.cos(phase), *angles)

    def _sum_up(
        self,
        even: Callable[[np.ndarray, np.ndarray], np.ndarray],
        odd: Callable[[np.ndarray, np.ndarray], np.ndarray],
        *angles: np.ndarray | float,
    ) -> np.ndarray:
        """``sum_k w_k (even_k - i odd_k)`` of functions of k and k . angle that are even and odd in k; only one of k
        and -k is evaluated.
        """
        shape = np.broadcast_shapes(*(np.shape(a) for a in angles))
        width = self.weights.shape[1:]
        transposed = np.swapaxes(self.weights, 1, 2) if width else self.weights
        skew = bool(np.any(self.weights != transposed))
        total = np.zeros((*width, *shape), complex if skew else float)
        for o, w, opposite in zip(self.offsets, self.weights, transposed, strict=True):
            if tuple(o) < (0,) * self.dim:
                continue
            phase = sum((int(i) * np.asarray(a, float) for i, a in zip(o, angles, strict=True) if i), np.zeros(()))
            # has the full shape only for offsets that depend on all angles
            even_part, odd_part = even(o, phase), odd(o, phase) if skew else 0.0
            for entry in np.ndindex(width):
                if w[entry] or opposite[entry]:
                    total[entry] += (w[entry] + opposite[entry]) * even_part
                    if skew:
                        total[entry] -= 1j * (w[entry] - opposite[entry]) * odd_part
        return np.moveaxis(total, (0, 1), (-2, -1)) if width else total

    def branches(self, *angles: np.ndarray | float) -> np.ndarray:
        """Eigenvalues of the symbol, ascending, along an additional axis at the end: one for a scalar field, its real
        part.
        """
        symbol = self.symbol(*angles).real if self.drifting else self.symbol(*angles)
        return symbol[..., None] if self.components == 1 else np.linalg.eigvalsh(symbol)

    def branches_with_gradient(self, *angles: np.ndarray | float) -> tuple[np.ndarray, list[np.ndarray]]:
        """`branches` and their derivatives along each axis."""
        if self.components == 1:
            return self.branches(*angles), [self.symbol_gradient(a, *angles)[..., None] for a in range(self.dim)]
        values, modes = np.linalg.eigh(self.symbol(*angles))
        slopes = [
            np.einsum("...ij,...ik,...kj->...j", modes.conj(), self.symbol_gradient(a, *angles), modes).real
            for a in range(self.dim)
        ]
        return values, slopes

    def _zone(self) -> list[np.ndarray]:
        """Sample of the Brillouin zone as open grids.

        Half of the zone is enough, since eigenvalues are even in k; along each further axis in which the stencil is
        even, half of the range is enough.
        """
        count = {1: 4097, 2: 129, 3: 33}[self.dim]  # on each axis: 4 000 to 140 000 eigenvalues in all
        half, full = np.linspace(0, np.pi, count), np.linspace(-np.pi, np.pi, 2 * count - 1)
        return list(np.ix_(half, *[half if self.even_along(a) else full for a in range(1, self.dim)]))

    @property
    def symbol_maximum(self) -> float:
        """Largest value of the symbol, or of its eigenvalues, over the Brillouin zone; for a `drifting` stencil the
        real value that would limit the step of forward Euler alike, infinite if short waves grow at any step.
        """
        return _symbol_maximum(self)

    @property
    def zone_branches(self) -> tuple[list[np.ndarray], np.ndarray, list[np.ndarray]]:
        """Sample of the Brillouin zone (open grids), the branches there and their derivatives along each axis."""
        return _zone_branches(self)

    @property
    def layer_growth(self) -> tuple[list[np.ndarray], np.ndarray]:
        """Wavenumbers (open grids) and growth rates of waves in a layer, to first order in its strength sigma and per
        unit of sigma.

        Along an axis with wavenumber k (times spacing), a wave of frequency w grows at the rate
        ``-sin(k) d(w^2)/dk / (2 w^2)``; the largest value over the axes is used, and 0 for waves that decay. For vector
        fields, an additional axis at the end contains the branches.
        """
        zone, value, slopes = self.zone_branches
        growth = np.zeros_like(value)
        inner = value > MARGIN * value.max()
        for axis in range(self.dim):
            slope = np.sin(zone[axis])[..., None] * slopes[axis]
            growth = np.maximum(growth, np.where(inner, -slope / np.where(inner, 2 * value, 1.0), 0.0))
        growth[growth < MARGIN] = 0.0
        return zone, growth

    def backward_waves(self) -> BackwardWaves:
        """Backward waves along any axis, from the signs of group and phase velocity in the Brillouin zone; none where
        the medium drifts, which carries no waves.
        """
        if self.drifting:
            return BackwardWaves(0.0, 0.0, np.inf)
        zone, growth = self.layer_growth
        radius = np.sqrt(sum(a**2 for a in zone))
        backward = (growth > 0).any(-1)
        return BackwardWaves(
            float(growth.max()), float(backward.mean()), float(radius[backward].min()) if backward.any() else np.inf
        )

    def __repr__(self) -> str:
        more = ", drifting" * self.drifting
        more += f", reaction={self.strongest_reaction:g}" if np.any(self.reaction) else ""
        return f"Stencil(dim={self.dim}, neighbours={len(self.weights)}, reach={self.reach}{more})"


def _reaction(given: Any, components: int) -> Any:
    """Return the checked reaction: a number, or a symmetric matrix for a field of several components."""
    several = isinstance(given, list | tuple) or (isinstance(given, np.ndarray) and given.ndim > 0)
    if components == 1 or not several:
        return kinds.number(given, "stencil.reaction", least=None if components == 1 else 0)
    matrix = kinds.array(given, "stencil.reaction")
    size = np.abs(matrix).max(initial=0)
    if (
        matrix.shape != (components, components)
        or np.abs(matrix - matrix.T).max(initial=0) > EQUAL * size
        or np.linalg.eigvalsh(matrix).min(initial=0) < -EQUAL * size
    ):
        raise InputError(
            "a reaction is a number or a symmetric matrix that draws nothing away",
            value=matrix.tolist(),
            limit=f"{components} x {components}, no eigenvalue below 0",
            key="stencil.reaction",
        )
    return (matrix + matrix.T) / 2


@lru_cache(maxsize=32)  # copies of a set-up ask for equal stencils
def _symbol_maximum(stencil: Stencil) -> float:
    from scipy.optimize import minimize

    zone = stencil._zone()
    if stencil.drifting:
        return _drifting_maximum(stencil, zone[0][1:])
    values = stencil.branches(*zone)[..., -1]
    best = float(values.max())

    def largest(angles: np.ndarray) -> float:  # vectorised over offsets: the search evaluates hundreds of single points
        symbol = np.tensordot(1 - np.exp(1j * stencil.offsets @ angles), stencil.weights, 1) + stencil.own
        return float(symbol.real if stencil.components == 1 else np.linalg.eigvalsh(symbol)[-1])

    for flat in np.argsort(values, axis=None)[-3:]:
        index = np.unravel_index(flat, values.shape)
        start = [float(axis.ravel()[i]) for axis, i in zip(zone, index, strict=True)]
        maximum = minimize(lambda a: -largest(a), start, method="BFGS", options={"gtol": 1e-12})
        best = max(best, -float(maximum.fun))
    return best


def _drifting_maximum(stencil: Stencil, angle: np.ndarray) -> float:
    """Largest ``|s|^2 / Re s`` of the symbol s: ``|1 - dt s| <= 1`` where ``dt <= 2 Re s / |s|^2``."""
    values, k = stencil.symbol(angle), stencil.offsets[:, 0]
    if not (values.real > _NO_DECAY * np.abs(stencil.weights).max() * angle**2).all():
        return np.inf
    longest = 0.0 if stencil.own else 2 * stencil.drift**2 / (stencil.weights @ k**2)  # as angle -> 0
    return max(float((np.abs(values) ** 2 / values.real).max()), float(longest))


@lru_cache(maxsize=8)
def _zone_branches(stencil: Stencil) -> tuple[list[np.ndarray], np.ndarray, list[np.ndarray]]:
    zone = stencil._zone()
    return zone, *stencil.branches_with_gradient(*zone)
