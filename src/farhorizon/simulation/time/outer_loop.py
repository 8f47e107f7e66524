"""Loop of a run to its end, with observers called at intervals, its warnings, and its guard against instability."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from farhorizon import kinds
from farhorizon.checks.examined import Examined
from farhorizon.errors import InputError, UnstableError, ValidityWarning
from farhorizon.files.results_layout import Caution
from farhorizon.machine import progress
from farhorizon.simulation.processes.process_group import ProcessGroup, agreed
from farhorizon.simulation.time.steps import last_step

MOST_STEPS = 2**53  # step numbers up to this one are exact in double precision
EXPLODED = 1e6  # largest value over what initial data and source terms explain, above which a run counts as unstable


class Clocked(Protocol):
    """A run at some time."""

    dt: float
    time: float
    step_count: int


class Advancing(Clocked, Protocol):
    """A run that can be advanced."""

    stop_requested: bool
    observers: list[Callable[[Any], None]]
    cautions: list[Caution]
    guard_steps: int
    team: ProcessGroup

    def step(self, count: int = 1) -> None:
        """Advance by `count` steps."""


def advance_clock(run: Advancing, steps: int) -> None:
    """Advance the clock of a run by a number of steps."""
    run.step_count += steps
    run.time = run.step_count * run.dt


def warn_once(run: Advancing, brief: str, text: str) -> None:
    """Warn, once for each reason, that the result of a run is doubtful from now on."""
    if all(brief != caution.brief for caution in run.cautions):
        run.cautions.append(Caution(run.time, brief, text))
        warn(f"from t = {run.time:.6g} on {text}")


def warn(text: str) -> None:
    """Issue a `ValidityWarning` that points to the line which called the package, by whatever path."""
    level, frame = 1, inspect.currentframe()
    while frame and frame.f_globals.get("__name__", "").partition(".")[0] == "farhorizon":
        level, frame = level + 1, frame.f_back
    warnings.warn(text, ValidityWarning, stacklevel=level)


def checked_end(until: Any, dt: float) -> float:
    """Return the end of a run; raises InputError if it is negative, not finite, or requires too many steps to count."""
    until = kinds.number(until, "run.until", least=0)
    if until > MOST_STEPS * dt:
        raise InputError(
            "the run has more steps than can be counted",
            value=until,
            limit=MOST_STEPS * dt,
            key="run.until",
            remedy=f"other units: a step is {dt:.3g}",
        )
    return until


def check_ahead(run: Clocked, until: float, key: str) -> None:
    """Raise InputError for an end that a run has passed; one that it has just reached is allowed."""
    if last_step(until, run.dt) < run.step_count:
        raise InputError(
            "the run is already past this end",
            value=until,
            limit=f">= {run.time:g}, the present time",
            key=key,
            remedy="a later end, or a new run",
        )


def run_to_step(
    run: Advancing,
    last: int,
    count: int | None,
    show: bool | None,
    ended: Callable[[], bool] | None = None,
    check_every: int | None = None,
) -> bool:
    """Advance to a step; observers are called every `count` steps and at the end. Returns whether `ended`, which is
    called every `check_every` steps, has ended the run earlier. Raises KeyboardInterrupt between two steps once
    `stop_requested` is set, on any process.
    """
    with progress(max(last - run.step_count, 0), show=show) as bar:
        while run.step_count < last:
            due = [
                (run.step_count // interval + 1) * interval for interval in (count, check_every) if interval is not None
            ]
            stop = min([last, *due])
            while run.step_count < stop:
                before = run.step_count
                run.step(min(run.guard_steps, stop - run.step_count))
                bar.update(run.step_count - before)
                if run.step_count < stop and run.team.any(run.stop_requested):
                    raise _interrupt(run.team)
            over = ended is not None and check_every is not None and not run.step_count % check_every and ended()
            if over or run.step_count == last or (count is not None and not run.step_count % count):
                with run.team.agreed():
                    for observer in run.observers:
                        observer(run)
            if over:
                return True
            if run.step_count < last and run.team.any(run.stop_requested):
                raise _interrupt(run.team)
    return False


def _interrupt(team: ProcessGroup) -> KeyboardInterrupt:
    """Return the error by which all processes end a run, and of which the first one tells."""
    return agreed(KeyboardInterrupt(), told=team.number > 0)


def refuse_explosion(
    values: np.ndarray,
    first: np.ndarray,
    spacing: float,
    scale: float,
    step: int,
    time: float,
    cause: Callable[[], str],
) -> None:
    """Raise an UnstableError that names step, time, place and likely cause for a field, shape (..., n..), that is not
    finite, or has grown far beyond `scale`, the largest value that data and source terms explain.
    """
    top, low = float(values.max()), float(values.min())
    if np.isfinite(top) and np.isfinite(low) and max(top, -low) <= EXPLODED * scale:
        return
    worst = np.unravel_index(int(np.argmax(np.where(np.isfinite(values), np.abs(values), np.inf))), values.shape)
    place = first + spacing * np.array(worst[-first.size :])
    raise UnstableError(
        f"unstable at step {step}, t = {time:.6g}: u = {values[worst]:.3g} near {np.round(place, 6).tolist()}; "
        f"likely cause: {cause()}"
    )


def likely_cause(run: Examined) -> str:
    """Return the likely cause, in words, of the instability of a run."""
    if run.closure is not None:
        names = ", ".join(sorted({type(b).__name__ for b in run.sides.values() if b.closing}))
        return (
            f"{names} grows on this outline, which `check` tells before the run: try `farhorizon check "
            "--tune`, or LatticePML"
        )
    of_bonds = run.model.bond_law
    if of_bonds is not None and of_bonds.law is not None:
        return f"{of_bonds.law} at the stretches there; otherwise check dt, sources and coefficient"
    backward = run.stencil.backward_waves()
    if backward and run.engine.layers:
        return (
            "the stencil has backward waves, which grow in layers that do not damp them (up to "
            f"{backward.growth:.2g} sigma)"
        )
    return "check dt, sources and coefficient"
