"""Tables of bonds that make elastic solids: offsets, and a matrix of weights for each.

Peridynamic materials consist of two parts, with Lame's constants ``lam`` and ``mu`` of the plane or of space: bonds
``(dim + 2) mu w(r) n n`` with half second moment 1, which make a Cauchy solid, lam = mu; and a nonlocal gradient ``g``
in place of the derivatives of the continuum.
"""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np

from farhorizon.errors import InputError
from farhorizon.medium.stencil import Stencil

Table = tuple[np.ndarray, np.ndarray]

_MOST_PAIRS = 3e7  # of bonds at one node: far more than any use needs, and still added up in some seconds


def isotropic(offsets: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Adjust the weights of bonds such that the lattice is exactly isotropic for long waves, with half second moment 1;
    an InputError for a family that is too small for this.

    The fourth moments of a lattice's family have cubic symmetry only. The factor ``alpha + beta sum_a n_a^4`` gives
    them the two values that they have in the continuum, ``sum w r^2 n_x^4 / 2 = 3/(dim + 2)`` and ``sum w r^2 n_x^2
    n_y^2 / 2 = 1/(dim + 2)``.
    """
    dim = offsets.shape[1]
    r2 = (offsets**2).sum(1)
    n = offsets / np.sqrt(r2)[:, None]
    shape = np.stack([np.ones(len(r2)), (n**4).sum(1)])
    moments = np.stack([n[:, 0] ** 4, n[:, 0] ** 2 * n[:, 1] ** 2]) * weights * r2 / 2
    try:
        factors = np.linalg.solve(moments @ shape.T, np.array([3.0, 1.0]) / (dim + 2)) @ shape
    except np.linalg.LinAlgError:
        factors = np.zeros(1)
    if factors.min() <= 0:
        raise InputError(
            "no positive bonds of so small a family are isotropic",
            value=f"{len(weights)} neighbours",
            key="model.kernel",
            remedy="a larger horizon, or calibrate = false",
        )
    return weights * factors


def central(offsets: np.ndarray, weights: np.ndarray, shear: float) -> Table:
    """Springs along the bonds: ``(dim + 2) shear w n n`` for weights with half second moment 1 along an axis."""
    n = offsets / np.linalg.norm(offsets, axis=1)[:, None]
    return offsets, (offsets.shape[1] + 2) * shear * weights[:, None, None] * n[:, :, None] * n[:, None, :]


def dilatation(offsets: np.ndarray, weights: np.ndarray, lame: float, calibrate: bool = True) -> Table:
    """The pressure ``lame theta`` of the nonlocal dilatation ``theta = sum_k g_k . (u_k - u)``, where g is w xi over
    the second moment of the weights along an axis (2 unless calibrated).
    """
    moment = (weights * offsets[:, 0] ** 2).sum() if calibrate else 2.0
    g = weights[:, None] * offsets / moment
    return _convolution(offsets, g, lambda gk: lame * gk[:, None] * g[:, None, :])


def correspondence(
    offsets: np.ndarray, weights: np.ndarray, lame: float, shear: float, stabilisation: float = 0.0
) -> Table:
    """``div (lame tr(e) + 2 shear e)`` with the gradient ``g_k = K^-1 w xi`` and its negative transpose as divergence.

    The stabilisation adds ``c sum_k w_k (2 (u_k - u) - G_k u xi_k)``, c = stabilisation / K (in P moduli), which
    vanishes for linear fields.
    """
    moment = (weights * offsets[:, 0] ** 2).sum()
    g = weights[:, None] * offsets / moment
    eye = np.eye(offsets.shape[1])
    factors = (lame + shear, shear, -stabilisation)
    table = _convolution(
        offsets,
        g,
        lambda gk: factors[0] * gk[:, None] * g[:, None, :] + (factors[1] + factors[2]) * eye * (g @ gk)[:, None, None],
    )
    return (
        sum_of(table, (offsets, 2 * stabilisation / moment * weights[:, None, None] * eye)) if stabilisation else table
    )


def neutral_stabilisation(lame: np.ndarray | float, shear: np.ndarray | float) -> np.ndarray:
    """The stabilisation of a correspondence material, relative to the P modulus, above which S waves grow faster as
    they grow shorter.

    Let b be the fourth moment of the weights over the second. The gradient of a wave along an axis is then ``k - b
    k^3/6`` and the springs of the stabilisation are ``k^2 - b k^4/12``, so that ``rho omega^2 = mu k^2 + b k^4 (G/4 -
    mu/3)``: no S wave is faster than long ones if G is at most 4 mu/3, and no P wave if it is at most 4/3 of its
    modulus.
    """
    return np.asarray(4 * shear / (3 * (lame + 2 * shear)))


def finite_element(lame: float, shear: float, dim: int) -> Table:
    """Bilinear or trilinear elements with lumped mass: products of one-dimensional stiffness, mass and differences."""
    stiffness, mass, difference = (
        np.array([1.0, -2.0, 1.0]),
        np.array([1.0, 4.0, 1.0]) / 6,
        np.array([-1.0, 0.0, 1.0]) / 2,
    )

    def product(matrices: list[np.ndarray]) -> np.ndarray:
        return np.einsum(",".join("ijk"[:dim]) + "->" + "ijk"[:dim], *matrices)

    offsets = np.array([o for o in itertools.product((-1, 0, 1), repeat=dim) if any(o)])
    weights = np.zeros((len(offsets), dim, dim))
    for a, b in itertools.product(range(dim), repeat=2):
        if a == b:
            along = [
                (lame + 2 * shear if c == a else shear) * product([stiffness if d == c else mass for d in range(dim)])
                for c in range(dim)
            ]
            table = np.sum(along, axis=0)
        else:
            table = (lame + shear) * product([difference if c in (a, b) else mass for c in range(dim)])
        weights[:, a, b] = table[tuple(offsets.T + 1)]
    return offsets, weights


def _convolution(offsets, g, product) -> Table:  # type: ignore[no-untyped-def]
    """Table whose weight at o is the sum over all k + l = o of ``product(g_k)[l]``, where `product` gives the products
    with all g_l at once.
    """
    reach, dim = int(np.abs(offsets).max()), offsets.shape[1]
    if len(offsets) ** 2 > _MOST_PAIRS:
        raise InputError(
            "the horizon spans too many nodes for a material with states of nodes",
            value=f"{len(offsets)} neighbours",
            limit=f"{int(_MOST_PAIRS**0.5)} neighbours",
            key="kernel.horizon",
            remedy="a horizon of three spacings, a coarser lattice or a bond-based material",
        )
    table = np.zeros((*[4 * reach + 1] * dim, dim, dim))
    for o, gk in zip(offsets, g, strict=True):
        table[tuple((offsets + o + 2 * reach).T)] += product(gk)
    return _listed(table)


def _listed(table: np.ndarray) -> Table:
    """Offsets and matrices of a dense table, without the centre and entries at rounding level."""
    size = np.abs(table).max((-2, -1))
    reach = np.array(size.shape) // 2
    size[tuple(reach)] = 0
    offsets = np.argwhere(size > 1e-14 * size.max())
    return offsets - reach, table[tuple(offsets.T)]


def sum_of(first: Table, second: Table) -> Table:
    """The sum of two tables."""
    reach = max(int(np.abs(offsets).max(initial=0)) for offsets, _ in (first, second))  # a part may vanish
    dim = first[0].shape[1]
    table = np.zeros((*[2 * reach + 1] * dim, dim, dim))
    for offsets, weights in (first, second):
        table[tuple((offsets + reach).T)] += weights
    return _listed(table)


def stencil_of(table: Table) -> Stencil:
    """Stencil with all symmetries of the lattice to the last digit: each weight is the mean over its mirror images."""
    offsets, weights = table
    dim = offsets.shape[1]
    by_offset = dict(zip(map(tuple, offsets.tolist()), weights, strict=True))
    for axis in range(dim):
        sign = np.where(np.arange(dim) == axis, -1, 1)
        by_offset = {
            o: (w + np.outer(sign, sign) * by_offset[tuple((sign * o).tolist())]) / 2 for o, w in by_offset.items()
        }
    return Stencil(np.array(list(by_offset)), np.array(list(by_offset.values())))


@lru_cache(maxsize=8)  # a set-up asks for its stencil many times, and each check covers all waves
def _lowest(offsets: bytes, weights: bytes, dim: int) -> float:
    """Smallest eigenvalue over all waves of a stencil with matrix weights."""
    places = np.frombuffer(offsets).reshape(-1, dim).astype(int)
    stencil = Stencil(places, np.frombuffer(weights).reshape(-1, dim, dim))
    return float(stencil.branches(*stencil._zone()).min())


def stable_solid(stencil: Stencil) -> Stencil:
    """Refuse a stencil that gains energy for some waves."""
    lowest = _lowest(stencil.offsets.astype(float).tobytes(), stencil.weights.tobytes(), stencil.dim)
    if lowest < -1e-9:
        raise InputError(
            "the lattice material is unstable for short waves",
            value=lowest,
            limit=">= 0",
            key="model.poisson",
            remedy="a larger Poisson's ratio, or another kernel",
        )
    return stencil
