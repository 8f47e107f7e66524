"""The exact solution of the fully discrete scheme on the infinite lattice, from initial values or driven by forces."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from scipy import fft

from farhorizon.analysis.exact.chain import Recursion
from farhorizon.errors import InputError
from farhorizon.machine import check_fits
from farhorizon.medium.integrators import Integrator, ModifiedEquation, Verlet
from farhorizon.medium.stencil import Stencil
from farhorizon.rounding import TINY


def largest_speed(stencil: Stencil) -> float:
    """Largest group speed of waves on the lattice in units of the long-wave speed, ``max |grad omega|``."""
    _, values, slopes = stencil.zone_branches
    omega = np.sqrt(np.maximum(values, TINY))
    squared = sum((slope / (2 * omega)) ** 2 for slope in slopes)
    return float(np.sqrt(np.max(np.where(omega > 1e-6, squared, 1.0))))


def wave_travel(stencil: Stencil, rate: float, steps: int, dt: float) -> float:
    """Nodes over which waves travel in some steps, apart from what is below rounding: the front has an Airy tail ahead
    of it, whose width grows as the cube root of its way.
    """
    front = largest_speed(stencil) * np.sqrt(rate) * steps * dt
    # Ai is 1e-16 at 14.5 widths, each cbrt(front) / 2 for nearest neighbours; 20 reaches while the tail still forms
    return float(front + (20 * max(stencil.reach) + 10 * np.cbrt(front)))


def undisturbed(stencil: Stencil, rate: float, order: int, until: float) -> int:
    """Nodes by which a domain must be larger on each open side so that nothing returns to the near field until the end
    of a run; `rate` is the largest ``coefficient / spacing^2``.
    """
    # half the way there and back; in diffusion that is 12 sqrt(rate until), where exp(-36) = 2e-16 is left
    distance = 0.5 * until * np.sqrt(rate) * largest_speed(stencil) if order == 2 else 6 * np.sqrt(rate * until)
    distance += stencil.drift * rate * until
    return int(np.ceil(distance)) + 10 * max(stencil.reach) + int(5 * np.cbrt(distance))


class InfiniteLattice:
    """States of the scheme on the infinite lattice after up to `last` steps, for initial values u (less the background)
    and v, components first, that vanish outside a box; `rate` is ``coefficient / spacing^2``. The update is diagonal in
    Fourier space, on a periodic box so large that nothing returns in time or exceeds rounding; an InputError if it does
    not fit into memory.
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
        if integrator.equation_order == 2:
            travel = wave_travel(stencil, rate, last, dt)
        else:
            # a field that diffuses has fallen to exp(-13^2/4) = 4e-19 there
            travel = 13 * np.sqrt(rate * last * dt) + 12 * max(stencil.reach) + stencil.drift * rate * last * dt
        self.box = [fft.next_fast_len(int(n + travel) + 1, real=True) for n in self.shape]
        check_fits(
            16 * 8 * stencil.components**2 * float(np.prod(self.box)),
            "the infinite lattice at so late a time does",
            "run.until",
            "an earlier time or a coarser lattice",
            f"{self.box} nodes",
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
        if integrator.equation_order == 2:
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


_WIDEST = 1e5  # largest number of neighbours of a step's operator
_FAINT = 1e-20  # weights below this part of the largest are rounding


@dataclass(frozen=True)
class Scheme:
    """A uniform medium and its time integration, as one operator per step."""

    stencil: Stencil
    rate: float  # factor on the stencil, ``coefficient / spacing^2``; 1 where the stencil is that of a whole step
    recursion: Recursion
    dt: float
    order: int  # of the equation in time

    @classmethod
    def of(cls, stencil: Stencil, rate: float, integrator: Integrator, dt: float, damping: float = 0.0) -> Scheme:
        """The scheme of an integrator. A step of several stages is represented as one of forward Euler with its
        polynomial of the operator, whose reach is that of the stencil times the number of stages; an InputError if it
        couples too many nodes.
        """
        if isinstance(integrator, ModifiedEquation):
            raise InputError(
                "waves that come from or go to the exterior are those of one stage per step",
                value=integrator.name,
                limit="velocity Verlet",
                key="model.integrator",
                remedy='integrator = "verlet"',
            )
        if isinstance(integrator, Verlet):
            return cls(stencil, rate, Recursion.of(integrator, dt, damping), dt, 2)
        stages = len(integrator.stages(dt).numbers)
        if stages == 1:
            return cls(stencil, rate, Recursion.of(integrator, dt), dt, 1)
        sides = [2 * stages * m + 1 for m in stencil.reach]
        if np.prod(sides) > _WIDEST:
            raise InputError(
                "a step of so many stages couples too many nodes for a far field",
                value=f"{' x '.join(map(str, sides))} nodes",
                limit=f"{_WIDEST:g} nodes",
                key="model.integrator",
                remedy="euler, or fewer stages",
            )
        angles = np.ix_(*(2 * np.pi * np.fft.fftfreq(n) for n in sides))
        table = np.fft.fftshift(np.fft.ifftn(integrator.growth(rate * stencil.symbol(*angles), dt)).real)
        table = (table + np.flip(table)) / 2
        offsets = np.argwhere(np.ones(sides)) - np.array(sides) // 2
        weights = table.ravel()
        used = offsets.any(1) & (np.abs(weights) > _FAINT * np.abs(weights).max())
        growth = float(integrator.growth(np.array(rate * stencil.reaction), dt))
        step = Stencil(offsets[used], weights[used], max(1 - growth, 0.0))
        return cls(step, 1.0, Recursion(0.0, 1.0, 1.0), dt, 1)

    def travel(self, steps: int) -> float:
        """Number of nodes that a disturbance has travelled after some steps, apart from what is below rounding."""
        if self.order == 2:
            distance = wave_travel(self.stencil, self.rate, steps, self.dt)
        else:
            spread = 0.5 * self.stencil.weights @ self.stencil.offsets.astype(float) ** 2
            # exp(-13^2 / 4) is 4e-19; some reaches more, while the lattice is coarse for the field
            distance = 13 * np.sqrt(self.rate * self.recursion.scale * spread.max() * steps) + 12 * max(
                self.stencil.reach
            )
        # a step carries no farther than the stencil reaches
        return float(min(distance, steps * max(self.stencil.reach)))


class DrivenLattice:
    """The field at `receivers` (P, dim) that forces on `nodes` (W, dim) radiate on the infinite lattice in up to `last`
    steps, exactly as the fully discrete scheme computes it.

    Each Fourier mode of a periodic lattice is advanced separately, and the lattice is so large that nothing that wraps
    around reaches a receiver by the last step; an InputError if it does not fit into memory.
    """

    def __init__(self, scheme: Scheme, last: int, nodes: np.ndarray, receivers: np.ndarray) -> None:
        stencil, self._recursion = scheme.stencil, scheme.recursion
        self._components, self._last = stencil.components, last
        low = nodes.min(0)
        farthest = np.maximum(receivers.max(0) - low, nodes.max(0) - receivers.min(0))
        self.box = [fft.next_fast_len(int(n) + 2, real=True) for n in np.ceil(scheme.travel(last) + farthest)]
        check_fits(
            8 * (stencil.components**2 + 8 * stencil.components) * float(np.prod(self.box)),
            "the periodic lattice in which nothing comes round to the receivers does",
            "far_field.points",
            "receivers nearer to the box, a shorter run, or the pattern by direction and frequency",
            f"{' x '.join(map(str, self.box))} nodes",
        )
        angles = [2 * np.pi * np.fft.fftfreq(n) for n in self.box[:-1]] + [2 * np.pi * np.fft.rfftfreq(self.box[-1])]
        symbol = self._recursion.scale * scheme.rate * stencil.symbol(*np.ix_(*angles))
        self._pull = np.moveaxis(symbol, (-2, -1), (0, 1)) if stencil.components > 1 else symbol
        self._shape = tuple(nodes.max(0) - low + 1)
        self._nodes = tuple((nodes - low).T)
        self._receivers = (receivers - low) % self.box

    def field(self, forces: Iterable[np.ndarray]) -> np.ndarray:
        """The field at the receivers at the start, where it is zero, and after each step, shape (steps + 1, P[,
        components]); from the forces at each step, (components * W,), components first.
        """
        field = np.zeros((self._last + 1, self._components, len(self._receivers)))
        spectrum = (self._components, *self._pull.shape[-len(self.box) :])
        value, increment = np.zeros(spectrum, complex), np.zeros(spectrum, complex)
        for step, force in enumerate(forces):
            scaled = self._recursion.scale * (1.0 if step else self._recursion.first)
            increment *= self._recursion.keep
            increment += self._spectrum(scaled * force)
            if self._components == 1:
                increment -= self._pull * value
            else:
                increment -= np.einsum("ij...,j...->i...", self._pull, value)
            value += increment
            field[step + 1] = self._seen(value)
        return field[:, 0] if self._components == 1 else field.swapaxes(1, 2)

    def _spectrum(self, force: np.ndarray) -> np.ndarray:
        """Fourier coefficients of forces on the nodes, axis by axis, because all but a few rows are zero."""
        block = np.zeros((self._components, *self._shape))
        block[(slice(None), *self._nodes)] = force.reshape(self._components, -1)
        spectrum = fft.rfft(block, self.box[-1])
        for axis, count in enumerate(self.box[:-1]):
            spectrum = fft.fft(spectrum, count, axis=axis + 1)
        return spectrum

    def _seen(self, value: np.ndarray) -> np.ndarray:
        """The field at the receivers, shape (components, P), axis by axis, because only a few rows are needed."""
        place = np.zeros(len(self._receivers), int)  # of each receiver among the remaining rows
        value = value[:, None]
        for axis, count in enumerate(self.box[:-1]):
            value = fft.ifft(value, axis=2)
            rows, place = np.unique(place * count + self._receivers[:, axis], return_inverse=True)
            value = value.reshape(len(value), -1, *value.shape[3:])[:, rows]
        return np.asarray(fft.irfft(value, self.box[-1])[:, place, self._receivers[:, -1]])
