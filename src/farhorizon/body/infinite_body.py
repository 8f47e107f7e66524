"""Symbols of the gradient of correspondence elasticity, and its waves on the infinite lattice."""

from __future__ import annotations

import numpy as np
from scipy import fft

from farhorizon.errors import InputError
from farhorizon.machine import available_memory
from farhorizon.medium.stencil import Stencil


def bond_weights(stencil: Stencil, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Bond vectors and weights w with ``sum w xi xi = 1``.

    Parameters
    ----------
    stencil : Stencil
        Its weights are the influence function times the volume.
    spacing : float

    Returns
    -------
    xi : ndarray, shape (K, dim)
    w : ndarray, shape (K,)

    Raises
    ------
    InputError
        A stencil that is not the same along all axes.
    """
    xi = stencil.offsets * spacing
    tensor = np.einsum("k,ka,kb->ab", stencil.weights, xi, xi)
    if np.abs(tensor - tensor[0, 0] * np.eye(stencil.dim)).max() > 1e-9 * tensor[0, 0]:
        raise InputError(
            "the shape tensor of an intact node must be isotropic",
            value=tensor.tolist(),
            key="model.kernel",
            remedy="a stencil that is the same along all axes",
        )
    return xi, stencil.weights / tensor[0, 0]


def gradient_symbol(stencil: Stencil, spacing: float, *k: np.ndarray) -> np.ndarray:
    """``g_b(k) = sum w xi_b sin(k . xi)``: the gradient of a plane wave is i g.

    Parameters
    ----------
    stencil : Stencil
    spacing : float
    *k : ndarray
        Wavenumbers, one array an axis (broadcast).

    Returns
    -------
    ndarray, shape (dim, ...)
    """
    xi, w = bond_weights(stencil, spacing)
    shape = np.broadcast_shapes(*(np.shape(a) for a in k))
    total = np.zeros((len(k), *shape))
    for bond, weight in zip(xi, w, strict=True):
        wave = weight * np.sin(sum(x * a for x, a in zip(bond, k, strict=True)))
        for b, x in enumerate(bond):
            if x:
                total[b] += x * wave
    return total


def largest_frequency(stencil: Stencil, spacing: float, fast: float, slow: float, stabilisation: float = 0.0) -> float:
    """Bound of the frequencies of an intact lattice; the step limit of velocity Verlet is 2 over it.

    Parameters
    ----------
    stencil : Stencil
    spacing : float
    fast, slow : float
        Longitudinal and transverse wave speed.
    stabilisation : float
        Part of the bond-based operator's missing energy that is put back.
    """
    zone = [a / spacing for a in stencil._zone()]
    squared = (gradient_symbol(stencil, spacing, *zone) ** 2).sum(0)
    _, w = bond_weights(stencil, spacing)
    bonds = stencil.symbol(*stencil._zone()) * 2 * w[0] / stencil.weights[0]
    rest = stabilisation * fast**2 * (bonds - squared)
    return float(np.sqrt(max((fast**2 * squared + rest).max(), (slow**2 * squared + rest).max())))


class InfiniteBody:
    """Displacements of correspondence elasticity by velocity Verlet on the infinite lattice, from data that vanish
    outside a box.

    A plane wave splits into a part along the gradient's symbol g, of frequency fast |g|, and a part across it, of
    frequency slow |g|; the step turns each by its discrete frequency. The periodic box is made so large that nothing
    that wraps around is back in time.

    Parameters
    ----------
    stencil : Stencil
    spacing : float
    fast, slow : float
        Longitudinal and transverse wave speed.
    dt : float
    last : int
        Largest number of steps that will be asked for.
    u : ndarray, shape (dim, ...)
        Initial displacements; at rest.

    Raises
    ------
    InputError
        A step above the limit, a time so late that the box does not fit into memory.
    """

    def __init__(
        self, stencil: Stencil, spacing: float, fast: float, slow: float, dt: float, last: int, u: np.ndarray
    ) -> None:
        self.shape, self.last, dim = u.shape[1:], last, stencil.dim
        zone = [a / spacing for a in stencil._zone()]
        sizes = np.sqrt((gradient_symbol(stencil, spacing, *zone) ** 2).sum(0))
        slopes = np.gradient(sizes, *[a.ravel() for a in zone])
        steepest = max(1.0, float(np.sqrt(sum(slope**2 for slope in slopes)).max()))
        travel = steepest * fast * last * dt / spacing
        travel += 20 * max(stencil.reach) + 10 * np.cbrt(travel)  # the front has an Airy tail ahead of it
        self.box = [fft.next_fast_len(int(n + travel) + 1, real=True) for n in self.shape]
        if (8 + 4 * dim) * 8 * float(np.prod(self.box)) > available_memory():
            raise InputError(
                "the infinite lattice at so late a time does not fit into memory",
                value=f"{self.box} nodes",
                key="run.until",
                remedy="an earlier time or a coarser lattice",
            )
        k = [2 * np.pi * np.fft.fftfreq(n) / spacing for n in self.box[:-1]] + [
            2 * np.pi * np.fft.rfftfreq(self.box[-1]) / spacing
        ]
        g = gradient_symbol(stencil, spacing, *np.ix_(*k))
        size = np.sqrt((g**2).sum(0))
        if fast * dt * size.max() >= 2:
            raise InputError("the step is above the limit", value=dt, limit=2 / (fast * float(size.max())), key="dt")
        start = np.stack([fft.rfftn(component, self.box) for component in u])
        along = (g * start).sum(0) / np.where(size > 0, size**2, 1.0) * g
        self._parts = (
            (2 * np.arcsin(fast * dt * size / 2), along),
            (2 * np.arcsin(slow * dt * size / 2), start - along),
        )

    def after(self, steps: int) -> np.ndarray:
        """Displacements after a number of steps, shape of the data."""
        if steps > self.last:
            raise InputError("later than the box was made for", value=steps, limit=self.last)
        state = sum(np.cos(steps * turn) * part for turn, part in self._parts)
        return np.stack(
            [fft.irfftn(component, self.box)[tuple(slice(n) for n in self.shape)] for component in np.asarray(state)]
        )
