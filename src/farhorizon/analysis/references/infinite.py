"""The exact solution of the fully discrete scheme on the infinite lattice."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import fft

from farhorizon.errors import InputError
from farhorizon.machine import available_memory
from farhorizon.medium.integrators import Integrator, ModifiedEquation, Verlet
from farhorizon.medium.stencil import Stencil


def largest_speed(stencil: Stencil) -> float:
    """Largest group speed of waves on the lattice in units of the long-wave speed, ``max |grad omega|``."""
    _, values, slopes = stencil.zone_branches
    omega = np.sqrt(np.maximum(values, 1e-300))
    squared = sum((slope / (2 * omega)) ** 2 for slope in slopes)
    return float(np.sqrt(np.max(np.where(omega > 1e-6, squared, 1.0))))


def wave_travel(stencil: Stencil, rate: float, steps: int, dt: float) -> float:
    """Nodes over which waves travel in some steps, apart from what is below rounding: the front has an Airy tail ahead
    of it, whose width grows as the cube root of its way.
    """
    front = largest_speed(stencil) * np.sqrt(rate) * steps * dt
    return float(front + (20 * max(stencil.reach) + 10 * np.cbrt(front)))


def undisturbed(stencil: Stencil, rate: float, order: int, until: float) -> int:
    """Nodes by which a domain must be larger on each open side so that nothing returns to the near field until the end
    of a run; `rate` is the largest ``coefficient / spacing^2``.
    """
    distance = 0.5 * until * np.sqrt(rate) * largest_speed(stencil) if order == 2 else 6 * np.sqrt(rate * until)
    distance += stencil.drift * rate * until
    return int(np.ceil(distance)) + 10 * max(stencil.reach) + int(5 * np.cbrt(distance))


class InfiniteLattice:
    """States of the scheme on the infinite lattice after up to `last` steps, for initial values u (less the background)
    and v that vanish outside a box; for vectors the components come first.

    The update is diagonal in Fourier space; the periodic box is so large that nothing that wraps around returns in time
    (waves) or exceeds rounding (diffusion); an InputError if it does not fit into memory. `rate` is the factor on the
    stencil, ``coefficient / spacing^2``.
    """

    def __init__(
        self,
        stencil: Stencil,
        rate: float,
        integrator: Integrator,
        dt: float,
        last: int,
        u: np.ndarray,
        v: np.ndarray | None = None,
        damping: float = 0.0,
    ) -> None:
        self.integrator, self.dt, self.last, self.shape = integrator, dt, last, u.shape[-stencil.dim :]
        if isinstance(integrator, Verlet | ModifiedEquation):
            travel = wave_travel(stencil, rate, last, dt)
        else:
            # a field that diffuses has fallen to exp(-13^2/4) = 4e-19 there
            travel = 13 * np.sqrt(rate * last * dt) + 12 * max(stencil.reach) + stencil.drift * rate * last * dt
        self.box = [fft.next_fast_len(int(n + travel) + 1, real=True) for n in self.shape]
        if 16 * 8 * stencil.components**2 * float(np.prod(self.box)) > available_memory():
            raise InputError(
                "the infinite lattice at so late a time does not fit into memory",
                value=f"{self.box} nodes",
                key="run.until",
                remedy="an earlier time or a coarser lattice",
            )
        angles = [2 * np.pi * np.fft.fftfreq(n) for n in self.box[:-1]] + [2 * np.pi * np.fft.rfftfreq(self.box[-1])]
        symbol = stencil.symbol(*np.ix_(*angles)) * rate
        self.symbol: np.ndarray = symbol
        self.modes: np.ndarray | None = None
        if stencil.components > 1:
            self.symbol, self.modes = self._diagonal(symbol)
        self.start = self._transform(u)
        self.speed = self._transform(v) if v is not None and np.any(v) else np.zeros(1)
        self._after: Callable[[int], np.ndarray]
        if isinstance(integrator, Verlet | ModifiedEquation):
            modes = integrator.modes(self.symbol, dt, damping)
            self._after = lambda steps: modes.after(steps, self.start, self.speed)
        else:
            growth = integrator.growth(self.symbol, dt)
            self._after = lambda steps: growth**steps * self.start

    @staticmethod
    def _diagonal(symbol: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues (components first, never below zero) and modes of Hermitian matrices."""
        values, modes = np.linalg.eigh(symbol)
        return np.moveaxis(np.maximum(values, 0.0), -1, 0), modes

    def _transform(self, field: np.ndarray) -> np.ndarray:
        """Fourier coefficients; for vectors those of the modes."""
        coefficients = fft.rfftn(field, self.box, axes=range(-len(self.box), 0))
        return coefficients if self.modes is None else np.einsum("...ij,i...->j...", self.modes.conj(), coefficients)

    def after(self, steps: int) -> np.ndarray:
        """The state after a number of steps, in the shape of the data."""
        if steps > self.last:
            raise InputError("later than the box was made for", value=steps, limit=self.last)
        end = self._after(steps)
        if self.modes is not None:
            end = np.einsum("...ij,j...->i...", self.modes, end)
        return fft.irfftn(end, self.box, axes=range(-len(self.box), 0))[(..., *(slice(n) for n in self.shape))]
