"""The infinite lattice, initially at rest, driven by forces on some of its nodes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import fft

from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.references.infinite import wave_travel
from farhorizon.errors import InputError
from farhorizon.machine import available_memory
from farhorizon.medium.integrators import Integrator, ModifiedEquation, Verlet
from farhorizon.medium.stencil import Stencil

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

    Examples
    --------
    >>> scheme = Scheme.of(Stencil.finite_difference(1), 1.0, Verlet(), 1.0)
    >>> driven = DrivenLattice(scheme, 3, np.array([[0]]), np.array([[2]]))
    >>> round(float(driven.field(np.array([[1.0], [0.0], [0.0]]))[3, 0]), 12)  # it travels a node a step
    0.5
    """

    def __init__(self, scheme: Scheme, last: int, nodes: np.ndarray, receivers: np.ndarray) -> None:
        stencil, self._recursion = scheme.stencil, scheme.recursion
        self._components, self._last = stencil.components, last
        low = nodes.min(0)
        farthest = np.maximum(receivers.max(0) - low, nodes.max(0) - receivers.min(0))
        self.box = [fft.next_fast_len(int(n) + 2, real=True) for n in np.ceil(scheme.travel(last) + farthest)]
        if 8 * (stencil.components**2 + 8 * stencil.components) * float(np.prod(self.box)) > available_memory():
            raise InputError(
                "the periodic lattice in which nothing comes round to the receivers does not fit into memory",
                value=f"{' x '.join(map(str, self.box))} nodes",
                limit=f"{available_memory() / 2**30:.3g} GiB available",
                key="far_field.points",
                remedy="receivers nearer to the box, a shorter run, or the pattern by direction and frequency",
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
