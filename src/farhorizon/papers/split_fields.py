"""The original scheme of Wildman and Gazonas (2012), forward Euler on split fields, in plain NumPy.

Displacements and time integrals of the stress are sums of parts, one for each direction of the derivatives that drive
them. Each part decays at the rate phi of its direction. Two successive steps combine to eqs 2-30 and 2-31. All waves
grow at half of frequency^2 dt, and the scheme handles neither loads nor damage; the same layer without these
restrictions is a side of `Simulation` (`farhorizon.boundaries.nonlocal_pml`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from farhorizon import Elastic, Kernel, NonlocalPML, Stencil


class Gradient:
    """Derivatives ``sum_k g_kb u(i + o_k)`` on a box of nodes; values beyond it are zero, and shape tensors are 1."""

    def __init__(self, kernel: Kernel, spacing: float, dim: int) -> None:
        offsets, weights = Stencil.family(kernel, spacing, dim)
        half = [tuple(offset) > (0,) * dim for offset in offsets.tolist()]  # one of each pair of opposite bonds
        self.offsets = offsets[half]
        self.vectors = (weights[:, None] * offsets / (weights * offsets[:, 0] ** 2).sum() / spacing)[half]
        self.reach = int(np.abs(offsets).max())

    def along(self, axis: int, values: np.ndarray) -> np.ndarray:
        """Derivative along an axis of values of shape (..., *box)."""
        dim, m = self.offsets.shape[1], self.reach
        wide = np.pad(values, [(0, 0)] * (values.ndim - dim) + [(m, m)] * dim)
        derivative = np.zeros(values.shape)
        for offset, factor in zip(self.offsets, self.vectors[:, axis], strict=True):
            if factor:
                ahead, behind = (self._moved(sign * offset, values.shape[-dim:]) for sign in (1, -1))
                derivative += factor * (wide[ahead] - wide[behind])
        return derivative

    def _moved(self, offset: np.ndarray, box: tuple[int, ...]) -> tuple[Any, ...]:
        """Index of the neighbours of all nodes in the box padded by one reach on each side."""
        inner = (slice(self.reach + o, self.reach + o + n) for o, n in zip(offset.tolist(), box, strict=True))
        return (..., *inner)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Derivatives along all axes, shape (dim, ..., *box)."""
        return np.stack([self.along(axis, values) for axis in range(self.offsets.shape[1])])


class SplitFields:
    """A box of nodes with layers on all sides, beyond which the displacement is zero: initial displacements including
    the layers, shape (dim, *box), at rest, in plane strain in two dimensions; the density is 1.
    """

    def __init__(
        self,
        kernel: Kernel,
        spacing: float,
        u: np.ndarray,
        layer: NonlocalPML,
        dt: float,
        young: float = 1.0,
        poisson: float = 0.25,
    ) -> None:
        self.dim, self.dt, self.gradient = len(u), dt, Gradient(kernel, spacing, len(u))
        solid = Elastic(kernel, young, poisson, material="correspondence")
        self.lame, self.shear = solid.lame, solid.shear
        outwards = layer.stretch(spacing, float(np.sqrt(self.lame + 2 * self.shear)))
        self.phi = np.zeros((self.dim, *u.shape[1:]))
        for axis, phi in enumerate(self.phi):
            lines = np.moveaxis(phi, axis, -1)
            lines[..., : layer.nodes] += outwards[::-1]
            lines[..., -layer.nodes :] += outwards
        self.phi = self.phi + layer.cross * (self.phi.sum(0) - self.phi)
        self.parts = np.repeat(u[None], self.dim, 0) / self.dim  # indices: driving direction, component, node
        self.histories = np.zeros((self.dim, self.dim, *u.shape))

    @property
    def u(self) -> np.ndarray:
        """Displacements, shape (dim, *box)."""
        return np.asarray(self.parts.sum(0))

    def step(self, count: int) -> None:
        """Advance by `count` steps."""
        for _ in range(count):
            slopes, stress = self.gradient(self.u), self.histories.sum(0)
            forces = [self.gradient.along(b, stress[:, b]) for b in range(self.dim)]
            for b, (slope, force) in enumerate(zip(slopes, forces, strict=True)):
                strain = np.zeros_like(stress)  # as if all derivatives but those along b were zero
                strain[:, b] = slope
                driven = self.shear * (strain + strain.swapaxes(0, 1))
                for a in range(self.dim):
                    driven[a, a] += self.lame * slope[b]
                self.histories[b] += self.dt * (driven - self.phi[b] * self.histories[b])
                self.parts[b] += self.dt * (force - self.phi[b] * self.parts[b])
