"""Time steps and intervals that they divide: outputs, records and ends of runs are at whole numbers of steps."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from farhorizon import kinds
from farhorizon.engine.engine import Engine
from farhorizon.engine.state import as_before
from farhorizon.errors import InputError

#: An interval is a whole number of steps if it differs from one by at most this fraction of a step, to allow for typed
#: and divided numbers.
FITS = 1e-6
_CANDIDATES = 1_000_000  # largest number of step lengths that are tried
_TIMED, _PIECE = 0.1, 0.02  # seconds for which steps are timed, in all and in one piece
_MOST = 100_000  # largest number of steps in a piece
_COUNTED = 2.0**52  # number of steps up to which whole numbers are exact in floating point


def whole_steps(interval: float, dt: float) -> int | None:
    """Return the number of steps in an interval; None if it is not a whole number."""
    count = interval / dt
    if not (np.isfinite(count) and count > 0.5 and abs(count - round(count)) <= FITS):
        return None
    return round(count)


def last_step(until: float, dt: float) -> int:
    """Return the number of the first step at or after a time."""
    return int(np.ceil(until / dt - FITS))


class WholeSteps:
    """A rule for the time step: the largest step, up to the default, that divides given intervals evenly.

    To this end, the step may be as short as half the default (or as the shortest interval, if that is shorter).

    Parameters
    ----------
    **intervals : float
        Intervals by name, which messages mention: ``dt=WholeSteps(every=0.25, until=10.0)``.

    Raises
    ------
    InputError
        No interval, or one that is not finite and positive.

    Examples
    --------
    >>> import farhorizon as fh
    >>> rule = fh.WholeSteps(every=0.25, until=1.0)
    >>> rule(0.1)  # the default step would be 0.1
    0.08333333333333333
    """

    def __init__(self, **intervals: float) -> None:
        if not intervals:
            raise InputError(
                "a step is to divide one interval or more", key="dt", remedy="WholeSteps(every=..., until=...)"
            )
        self.intervals = {name: kinds.number(interval, name, above=0) for name, interval in intervals.items()}

    def __repr__(self) -> str:
        return f"WholeSteps({', '.join(f'{name}={interval:g}' for name, interval in self.intervals.items())})"

    def __call__(self, most: float) -> float:
        """Return the step.

        Parameters
        ----------
        most : float
            Step without this rule, which is not exceeded.

        Raises
        ------
        InputError
            No such step divides all of the intervals, or the step is so short that its steps cannot be counted.
        """
        step = self._largest(most)
        if step is not None:
            return step
        name, shortest = min(self.intervals.items(), key=lambda item: item[1])
        unlike, longer = max(
            self.intervals.items(), key=lambda item: abs(item[1] / shortest - round(item[1] / shortest))
        )
        raise InputError(
            f"no time step divides both {name} and {unlike}",
            value=f"{shortest:.10g} and {longer:.10g}",
            limit=f"steps from {most / 2:.4g} to {most:.4g}",
            key=unlike,
            remedy=f"{unlike} = {_beside(longer, shortest)}",
        )

    def _largest(self, most: float) -> float | None:
        """Return the largest step up to `most` that divides all intervals; None if it would be less than half of that,
        or of the shortest interval if that is shorter.
        """
        name, shortest = min(self.intervals.items(), key=lambda item: item[1])
        if not shortest < _COUNTED * most:
            raise InputError(
                "the time step is so short that its steps cannot be counted",
                value=f"dt = {most:.4g}",
                limit=f"at least {shortest / _COUNTED:.4g} for {name} = {shortest:.4g}",
                key="dt",
                remedy="coefficients in the units of the lattice",
            )
        first = max(1, int(np.ceil(shortest / most - FITS)))
        counts = np.arange(first, min(2 * first, first + _CANDIDATES) + 1)
        fit = np.ones(counts.size, bool)
        for interval in self.intervals.values():
            ratio = interval / shortest * counts
            fit &= np.abs(ratio - np.round(ratio)) <= FITS
        return float(shortest / counts[np.argmax(fit)]) if fit.any() else None

    def check(self, dt: float, key: str) -> None:
        """Refuse a given step that does not divide all of the intervals.

        Raises
        ------
        InputError
            The message names the next smaller step that does, and the nearest intervals that the given step divides.
        """
        for name, interval in self.intervals.items():
            if whole_steps(interval, dt) is None:
                smaller = self._largest(dt)
                remedy = "" if smaller is None else f"dt = {smaller:.10g}, or "
                raise InputError(
                    f"{name} is not a whole number of time steps",
                    value=f"dt = {dt:.10g} for {name} = {interval:.10g}",
                    limit=f"{interval / dt:.6g} steps",
                    key=key,
                    remedy=f"{remedy}{name} = {_beside(interval, dt)}",
                )


def steps_between(every: float, dt: float, key: str = "run.every") -> int:
    """Return the number of steps between two outputs; raises InputError if the time between them is not positive, or
    not a whole number of steps.
    """
    every = kinds.number(every, key, above=0)
    count = whole_steps(every, dt)
    if count is None:
        name = key.rpartition(".")[2]
        raise InputError(
            "not a whole number of time steps",
            value=f"{every:.10g}",
            limit=f"multiples of dt = {dt:.10g}",
            key=key,
            remedy=f"{name} = {_beside(every, dt)}; or build the run with dt = WholeSteps({name}={every:.10g})",
        )
    return count


def _beside(interval: float, unit: float) -> str:
    """Return, as text, the multiples of a unit on either side of an interval."""
    count = max(1, int(interval / unit))
    return f"{count * unit:.10g} or {(count + 1) * unit:.10g}"


def seconds_of(engine: Engine) -> float:
    """Measure the time of a step on this machine at present, without sources: the shortest in a tenth of a second,
    because whatever else the machine does only delays it. The state is not changed.
    """
    period = engine.every  # steps from one application of the layers' filter to the next
    count, least, spent = period, np.inf, 0.0
    with as_before(engine):
        engine.advance(period)  # the first steps load compiled code
        while spent < _TIMED:
            begin = perf_counter()
            engine.advance(count)
            took = perf_counter() - begin
            least, spent = min(least, took / count), spent + took
            count = period * int(np.clip(_PIECE / least / period, 1, _MOST))
    return least
