"""Runs to the static state: when a run has come to rest, without any damping except by waves that leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.inputs.load_steps import LoadSteps
from farhorizon.simulation.processes.process_group import ProcessGroup
from farhorizon.simulation.time.outer_loop import check_ahead, checked_end
from farhorizon.simulation.time.steps import last_step

STATIC = "static"
TOLERANCE = 1e-3  # unless given: velocities a thousandth of the largest ones
_PATIENCE = 100  # number of windows to the latest end, unless it is given
_LOOKS = 16  # checks per window


class SteadyStateQuantities(Protocol):
    """Quantities that determine whether a run has come to rest."""

    @property
    def slow_crossing(self) -> float:
        """Time that the slowest wave takes to cross the near field; for diffusion R^2/D."""

    def kinetic(self) -> float | None:
        """Return the kinetic energy of the near field; None for diffusion, and where velocities are not kept."""

    def change(self, step: int) -> float | None:
        """Return the largest change of the field per step since this was called before; None the first time."""

    def loading_at(self, t: float) -> Sequence[np.ndarray]:
        """Return all that drives the run at a time, as numbers that show whether it changes."""


class Running(Protocol):
    """A run that may come to rest."""

    dt: float
    time: float
    step_count: int
    background: float
    given: dict[str, Any]
    peak: float
    rest: SteadyState | None
    resting: SteadyStateQuantities
    team: ProcessGroup

    @property
    def fields(self) -> dict[str, np.ndarray]:
        """Copies of the fields in the near field by name."""


@dataclass
class SteadyState:
    """Criterion for whether a run has come to rest.

    Nothing that drives the run changes any more. For waves, the kinetic energy has stayed below the squared tolerance
    times its largest value, that is, velocities below the tolerance times theirs, for as long as the slowest wave takes
    to cross the near field. Diffusion has no such time, because it comes to rest as a power of time: instead, at its
    present rate, the field would change by less than the tolerance times its largest difference from the background, in
    a time as long as has passed since the loads became constant.
    """

    tolerance: float
    limit: float  # the latest end
    # time from which on nothing that drives the run changes by more than the tolerance times its largest value
    settled: float
    window: int  # number of steps for which a run has to be quiet
    pace: int  # number of steps from one check to the next
    quiet: int | None = None  # step since which the run has been quiet
    checked: int | None = None  # step at which this was checked last

    @classmethod
    def of(cls, run: Running, tolerance: float | None, limit: float | None) -> SteadyState:
        """Return the criterion for a run, or continue the same one by which it has been judged so far. The tolerance is
        1e-3 and the limit a hundred crossings of the slowest wave unless given; raises InputError if loads still change
        near the latest end.
        """
        tolerance = TOLERANCE if tolerance is None else kinds.number(tolerance, "run.tolerance", above=0, below=1)
        window = run.resting.slow_crossing
        before = run.rest
        if limit is None:
            ahead = run.time + _PATIENCE * window
            limit = ahead if before is None or before.limit <= run.time else before.limit
        else:
            limit = kinds.number(limit, "run.limit", above=0)
        limit = checked_end(limit, run.dt)
        check_ahead(run, limit, "run.limit")
        steps = max(_LOOKS, last_step(window, run.dt))
        # from the beginning, wherever the run stands: what drove it first is what later changes are compared with
        looks = np.linspace(0.0, limit, max(_LOOKS, int(_LOOKS * limit / window)))
        settled = run.team.largest(_last_change(run.resting, looks, tolerance))
        if settled > max(limit - window, 0.0):
            raise InputError(
                "what drives the run still changes up to its latest end, so the run does not come to rest",
                value=f"t = {settled:.6g}",
                limit=f"{limit:.6g}, less {window:.6g} for the slowest wave",
                key="run.until",
                remedy="loads that stay or end, a later limit, or a time",
            )
        made = cls(tolerance, limit, settled, steps, steps // _LOOKS)
        unchanged = before is not None and (before.tolerance, before.settled) == (tolerance, settled)
        if before is not None and unchanged and run.step_count - (before.checked or 0) <= made.pace:
            made.quiet, made.checked = before.quiet, before.checked
        return made

    def over(self, run: Running) -> bool:
        """Whether the present state of the run has been checked, and the run had come to rest."""
        return self.checked == run.step_count and self.quiet is not None and self.checked - self.quiet >= self.window

    def reached(self, run: Running) -> bool:
        """Check the present state of the run; returns whether the run has come to rest."""
        self.checked = run.step_count
        still = run.time >= self.settled and self._is_steady(run)
        if not still:
            self.quiet = None
        elif self.quiet is None:
            self.quiet = run.step_count
        return self.over(run)

    def _is_steady(self, run: Running) -> bool:
        kinetic = run.resting.kinetic()
        if kinetic is not None:
            run.peak = max(run.peak, kinetic)
            return kinetic <= self.tolerance**2 * run.peak
        run.peak = max(run.peak, run.team.largest(_size(run.fields["u"] - run.background)))
        change = run.resting.change(run.step_count)
        if change is None:
            return False
        return change / run.dt * (run.time - self.settled) <= self.tolerance * run.peak


def progress_of(run: Running) -> dict[str, Any]:
    """Return what a checkpoint keeps of a run on its way to its static state."""
    return {"peak": run.peak} | ({} if run.rest is None else {"rest": asdict(run.rest)})


def take_progress(run: Running, kept: Mapping[str, Any]) -> None:
    """Restore what `progress_of` returned."""
    run.peak = float(kept.get("peak", 0.0))
    run.rest = SteadyState(**kept["rest"]) if "rest" in kept else None


def _size(field: np.ndarray) -> float:
    """Return the largest magnitude, apart from nan."""
    return float(np.abs(field).max(initial=0, where=~np.isnan(field)))


def _last_change(run: SteadyStateQuantities, times: np.ndarray, tolerance: float) -> float:
    """Return the time from some given ones after which all that drives a run stays as it is at the last of them."""
    final = run.loading_at(float(times[-1]))
    sizes, apart = np.zeros((2, len(times), len(final)))
    for row, t in enumerate(times):
        for column, (now, end) in enumerate(zip(run.loading_at(float(t)), final, strict=True)):
            sizes[row, column] = np.abs(now).max(initial=0)
            apart[row, column] = np.abs(now - end).max(initial=0)
    changing = np.flatnonzero((apart > tolerance * sizes.max(0, initial=0)).any(1))
    return float(times[min(changing[-1] + 1, len(times) - 1)]) if changing.size else float(times[0])


def steady_state_criterion(
    run: Running, until: Any, tolerance: float | None, limit: float | None
) -> SteadyState | None:
    """Return the criterion of a run to its static state; None for a run to a time. Raises InputError for an end that is
    another text, a tolerance or limit for a run to a time, and loads that change near the limit.
    """
    if isinstance(until, str):
        if isinstance(run.given.get("dt"), LoadSteps):
            raise InputError(
                "each load step is static: their run ends at a time",
                value=until,
                key="run.until",
                remedy="the time of the last load step",
            )
        kinds.one_of(until, "run.until", (STATIC,), "neither a time nor a state")
        return SteadyState.of(run, tolerance, limit)
    for name, value in (("tolerance", tolerance), ("limit", limit)):
        if value is not None:
            raise InputError(
                "only a run to the static state has one", value=value, key=f"run.{name}", remedy='until="static"'
            )
    return None
