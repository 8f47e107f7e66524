"""How late waves arrive at what is observed, by the dispersion of the stencil and the time step."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from farhorizon.analysis.resolution import Band, Lines, delay, lines_along, trace_error
from farhorizon.checks.examined import Examined
from farhorizon.inputs.signals import Signal
from farhorizon.medium.integrators import ModifiedEquation, Verlet
from farhorizon.medium.stencil import ORDERS, Stencil
from farhorizon.pictures.style import frequency_text, length_text
from farhorizon.rounding import MARGIN

ALLOWED = 0.01  # part of a period by which waves may be late; it changes a trace by 2 pi as much, 6 %
_FREQUENCIES = 257  # samples of a spectrum, which resolve delays of up to 128 of its shortest periods
VISIBLE = 0.05  # error of a trace that a picture shows
_CORRECTIONS = 8  # of a spacing: the error is of second order in it, unless it is large
_WAYS = 16  # of the longest ways, each in its own direction: several reach nearly as far


class _Scheme(NamedTuple):
    """The branches along a way, the time step and the integrator."""

    lines: Lines
    dt: float
    integrator: Verlet | ModifiedEquation


@dataclass(frozen=True, eq=False)
class Arrival:
    """The dominant wave of a run on its way from where it starts to a point that is observed."""

    sim: Examined
    #: From source to receiver, in lengths, shape (dim,): of the longest ways, that after which the wave is latest.
    way: np.ndarray
    #: Frequency of the wave, in cycles per time.
    frequency: float
    #: What the frequency is that of, for messages.
    origin: str
    #: Signal with the highest frequencies; None if the waves are those of initial data or of functions of time.
    signal: Signal | None

    @classmethod
    def of(cls, sim: Examined, waves: Band | None) -> Arrival | None:
        """The arrival of the waves of the signals, or else of the typical ones of what is known to send any; None if
        nothing sends waves, or nothing is observed but where they start.
        """
        named = max(sim.signals, key=lambda named: named[1].highest_frequency, default=None)
        ways = _longest_ways(sim)
        if not ways or (named is not None and not np.isfinite(named[1].highest_frequency)):
            return None
        if named is not None:
            key, signal = named
            frequency, origin = _dominant(signal), f"the dominant wave of {key}"
        elif waves is not None:
            signal, origin = None, "the typical wave"
            frequency = float(np.sqrt(sim.model.coefficient * sim.weakest)) / waves.typical
        else:
            return None
        return max((cls(sim, way, frequency, origin, signal) for way in ways), key=lambda one: abs(one.cycles))

    @property
    def _rate(self) -> float:
        return float(self.sim.model.coefficient * self.sim.weakest / self.sim.lattice.spacing**2)

    @property
    def _nodes(self) -> float:
        return float(np.linalg.norm(self.way) / self.sim.lattice.spacing)

    @cached_property
    def _lines(self) -> Lines:
        return lines_along(self.sim.stencil.beside(self.sim.weakest), self.way)

    @cached_property
    def cycles(self) -> float:
        """Periods by which the wave is late, negative if it is early."""
        return self._delay(self._scheme)

    @cached_property
    def error(self) -> float | None:
        """Largest error of the trace of the signal relative to its largest value; None without a signal."""
        return self._trace_error(self._scheme)

    @property
    def _scheme(self) -> _Scheme:
        """That of the run."""
        return _Scheme(self._lines, self.sim.dt, self.sim.model.integrator)  # type: ignore[arg-type]

    def _delay(self, scheme: _Scheme, finer: float = 1.0) -> float:
        """`cycles` with another scheme, or with spacing and step smaller by a factor."""
        lines, dt, integrator = scheme
        return delay(lines, self._rate, dt, finer * self.frequency, self._nodes / finer, integrator)

    def _trace_error(self, scheme: _Scheme, finer: float = 1.0) -> float | None:
        """`error` likewise."""
        if self.signal is None:
            return None
        frequencies = np.linspace(0.0, self.signal.highest_frequency, _FREQUENCIES)
        amplitudes = np.abs(self.signal.spectrum(frequencies))
        amplitudes[~np.isfinite(amplitudes)] = 0.0  # the constant part, which has no phase
        lines, dt, integrator = scheme
        nodes = self._nodes / finer
        return trace_error(lines, self._rate, dt, finer * frequencies, amplitudes, nodes, integrator)

    def _excess(self, scheme: _Scheme, finer: float = 1.0) -> float:
        """The larger one of both errors, relative to what is allowed."""
        error = self._trace_error(scheme, finer)
        return max(abs(self._delay(scheme, finer)) / ALLOWED, 0.0 if error is None else error / VISIBLE)

    @property
    def visible(self) -> bool:
        """Whether the error is worth a note: it is too large, and a signal is sent or points are observed."""
        observed = any(getattr(recorder, "points", None) is not None for recorder in self.sim.recorders)
        return bool(self.remedies) and (observed or self.signal is not None)

    @cached_property
    def remedies(self) -> list[str]:
        """The spacing and the order of differences with which the wave is late by less than `ALLOWED` and traces are
        wrong by less than `VISIBLE`; empty if they are so already.
        """
        if self._excess(self._scheme) <= 1:
            return []
        finer = 1.0
        for _ in range(_CORRECTIONS):
            finer *= min(1.0, self._excess(self._scheme, finer) ** -0.5)
        return [f"spacing = {_rounded_down(finer * self.sim.lattice.spacing):g}", *itertools.islice(self._orders(), 1)]

    def _orders(self) -> Iterator[str]:
        """Differences of higher order, with this integrator or that of fourth order, that leave errors as small."""
        sim, integrator = self.sim, self.sim.model.integrator
        fourth = ModifiedEquation()
        if not sim.stencil.accuracy:
            return
        schemes = [(integrator, order) for order in ORDERS if order > sim.stencil.accuracy]
        if isinstance(integrator, Verlet) and not sim.model.damping:
            schemes += [(fourth, order) for order in ORDERS if order >= max(4, sim.stencil.accuracy)]
        for other, order in schemes:
            stencil = Stencil.finite_difference(sim.lattice.dim, order)
            longer = float(np.sqrt(sim.stencil.symbol_maximum / stencil.symbol_maximum))
            if other is fourth:
                longer *= fourth.step_limit(1.0) / integrator.step_limit(1.0)
            dt = sim.dt * longer if sim.given.get("dt") is None else sim.dt
            scheme = _Scheme(lines_along(stencil, self.way), dt, other)  # type: ignore[arg-type]
            if dt < longer * sim.step_limit and self._excess(scheme) < 1:
                words = f"differences of order = {order}"
                yield words + ' with integrator = "modified-equation"' * (other is fourth)

    @property
    def in_words(self) -> str:
        """The delay, what reduces it, and what it does to a trace."""
        late = abs(self.cycles)
        when = "late" if self.cycles > 0 else "early"
        text = f"after a way of {length_text(float(np.linalg.norm(self.way)))} {self.origin}, of "
        text += f"{frequency_text(self.frequency)}, arrives {100 * late:.2g} % of a period "
        text += f"({360 * late:.2g} degrees) {when}"
        if self.error is not None:
            text += f", and traces are wrong by about {100 * self.error:.2g} % of their largest value"
        if self.remedies:
            text += f"; {' or '.join(self.remedies)} leaves less than {100 * ALLOWED:g} % of a period"
            text += "" if self.error is None else f" and {100 * VISIBLE:g} % of a trace"
            text += "" if self.sim.stencil.accuracy else ", with as many spacings per horizon"
        return text

    def on_finer(self, factor: float) -> str:
        """What remains of the error of a trace on a lattice whose spacing is smaller by a factor."""
        error = self._trace_error(self._scheme, factor)
        after = f"% after {length_text(float(np.linalg.norm(self.way)))}"
        return "" if error is None else f", and leaves traces that are wrong by about {100 * error:.2g} {after}"


def _dominant(signal: Signal) -> float:
    """Frequency at which the spectrum of a signal is largest; where this is that of its constant part, the median."""
    frequencies = np.linspace(0.0, signal.highest_frequency, _FREQUENCIES)
    amplitudes = np.abs(signal.spectrum(frequencies))
    top = int(np.argmax(amplitudes))
    if not 0 < top < _FREQUENCIES - 1:
        return signal.median_frequency
    low, middle, high = amplitudes[top - 1 : top + 2]
    # the vertex of the parabola through three samples
    return float(frequencies[top] + 0.5 * (low - high) / (low - 2 * middle + high) * frequencies[1])


def _longest_ways(sim: Examined) -> list[np.ndarray]:
    """The longest ways from what sends waves to points that are observed, or, where none is given, to the sides and
    corners of the near field; from its corners where it is not known what sends them.
    """
    low, high = sim.lattice.lower, sim.lattice.upper
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
    fields = [space for space, _ in sim.sources if space is not None] or [sim.start_u, sim.start_v]
    sizes = [np.abs(field).reshape(-1, *sim.lattice.shape).max(0) for field in fields]
    tops = [np.unravel_index(int(size.argmax()), size.shape) for size in sizes if size.any()]
    starts = [low + sim.lattice.spacing * np.array(node) for node in tops] or list(corners)
    points = [getattr(recorder, "points", None) for recorder in sim.recorders]
    given = [np.asarray(places, float).reshape(-1, len(low)) for places in points if places is not None]
    ways = []
    for start in starts:
        sides = np.array([np.where(np.eye(len(low), dtype=bool), side, start) for side in (low, high)])
        ends = np.concatenate(given or [corners, sides.reshape(-1, len(low))])
        ways += list(ends - start)
    lengths = np.linalg.norm(ways, axis=1)
    longest = np.argsort(-lengths, kind="stable")[:_WAYS]
    return [ways[number] for number in longest if lengths[number] > 0.5 * sim.lattice.spacing]


def _rounded_down(value: float) -> float:
    """The largest number of two digits that is not above a value."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(np.floor(value / unit * (1 + MARGIN)) * unit)
