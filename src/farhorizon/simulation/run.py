"""The interface of a run, however it is computed: a time loop, fields and energies, checks beforehand, saved states."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from farhorizon import kinds
from farhorizon.checks.certificate import UNDECIDED, Certificate
from farhorizon.errors import InputError, shown
from farhorizon.files.datasets import dataset
from farhorizon.files.html import table
from farhorizon.files.results_layout import Caution
from farhorizon.geometry.lattice import Lattice
from farhorizon.medium.stencil import Stencil
from farhorizon.simulation.pickling import packed
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.recorders.quantities import shown_fields
from farhorizon.simulation.recorders.recorder import Observer, Recorder
from farhorizon.simulation.recorders.recording import Probes
from farhorizon.simulation.time.checkpoint import arguments_in
from farhorizon.simulation.time.outer_loop import check_ahead, checked_end, run_to_step, warn_once
from farhorizon.simulation.time.output import RunResults, outlines_of, written
from farhorizon.simulation.time.steady_state import SteadyState, SteadyStateQuantities, steady_state_criterion
from farhorizon.simulation.time.steps import last_step, steps_between

if TYPE_CHECKING:
    import xarray

    from farhorizon.checks.report import Report
    from farhorizon.pictures.movie import Film
    from farhorizon.simulation.recorders.far_field import FarField
from typing import Protocol

from farhorizon.analysis.stability import step_seconds

_GUARD_STEPS = 200  # largest number of steps between two checks of the instability guard; fewer on lattices above
_GUARD_NODES = 1_000_000  # this many nodes, so that an interrupt takes effect within seconds


def _tells(value: Any) -> bool:
    """Whether an argument differs from the values that stand for nothing: None, False, 0.0 and empty collections."""
    return not (value is None or (isinstance(value, bool | tuple | list | dict | float) and not value))


class Run(ABC):
    """A run of a near field in time, for example a `Simulation`.

    Attributes
    ----------
    lattice : Lattice
        The near field.
    beyond : dict of (axis, side) to int
        Number of nodes that are computed beyond each side.
    dt, time : float
    step_count : int
    background : float
    observers : list of callable
        Called with the run as argument at regular intervals, see `run`.
    recorders : list of Recorder
        Recorders, such as `Receivers`, which record the run in every step.
    stop_requested : bool
        Set this to True (in a signal handler or an observer) to end `run` with a KeyboardInterrupt between two steps.
    probes : Probes or None
        The probes that `record` has created.
    peak : float
        The largest kinetic energy, for diffusion the largest difference from the background, that occurred in a run to
        its static state.
    rest : SteadyState or None
        Criterion of such a run.
    resting : SteadyStateQuantities
        Determines whether the run has come to rest.
    team : ProcessGroup
        The processes that compute the run.
    cautions : list of Caution
        Times from which the result is doubtful, with the reasons; a `ValidityWarning` was issued for each.
    output : RunResults or None
        The results file that `run` has begun.
    next_look : int
        Step at which bonds that cannot break are checked next.
    given : dict
        The arguments by name, without the initial data; the time step is the one that was chosen.
    """

    lattice: Lattice
    beyond: dict[tuple[int, int], int]
    given: dict[str, Any]
    stencil: Stencil
    dt: float
    background: float
    probes: Probes | None = None
    output: RunResults | None = None
    rest: SteadyState | None
    resting: SteadyStateQuantities
    team: ProcessGroup = ALONE

    def _at_start(self, observe: Sequence[Observer], nodes: int) -> None:
        """Initialize a run that computes `nodes` nodes, before its first step."""
        given = kinds.sequence(observe, "observe", "functions of the run, and recorders")
        self.recorders = [observer for observer in given if isinstance(observer, Recorder)]
        self.observers = [
            kinds.function(observer, "observe", "run") for observer in given if not isinstance(observer, Recorder)
        ]
        self.stop_requested = False
        self.cautions: list[Caution] = []
        self.time, self.step_count, self.next_look, self.peak, self.rest = 0.0, 0, 0, 0.0, None
        self._examination = Examination()
        self._remarks: list[str] = []
        self.guard_steps = max(1, min(_GUARD_STEPS, _GUARD_STEPS * _GUARD_NODES // max(nodes, 1)))

    def __repr__(self) -> str:
        nodes = " x ".join(map(str, self.lattice.shape))
        return f"<{type(self).__name__} on {nodes} nodes at t = {self.time:g}, step {self.step_count}>"

    def _repr_html_(self) -> str:
        rows = [("time", f"{self.time:g}, {self.step_count} steps of {self.dt:.6g}")]
        rows += [(name, shown(value)) for name, value in self.given.items() if _tells(value)]
        return table(rows, repr(self)[1:-1])

    def __reduce__(self) -> tuple[Any, ...]:
        return packed(self)

    # --- time stepping -----------------------------------------------------------------------------------------

    @abstractmethod
    def step(self, count: int = 1) -> None:
        """Advance by `count` steps; raises UnstableError if a field becomes non-finite or grows beyond all bounds."""

    def prepare(self, until: float) -> int:
        """Prepare a run, as `run` does first; returns the number of the last step, the first one at or after a time."""
        return last_step(until, self.dt)

    def run(
        self,
        until: float | str,
        every: float | None = None,
        progress: bool | None = None,
        allow_unstable: bool = False,
        tolerance: float | None = None,
        limit: float | None = None,
        output: str | Path | None = None,
    ) -> Self:
        """Run to a given time, or until the field is at rest; observers are called at intervals `every` and at the end.

        Parameters
        ----------
        until : float or "static"
            The run stops at the first step at or after this time; `time` gives the actual end. "static": the run stops
            when the waves have left, see `farhorizon.simulation.time.steady_state.SteadyState`.
        every : float, optional
            Must be a whole number of steps: create the run with ``dt=WholeSteps(every=...)`` to ensure this.
        progress : bool, optional
            Show a progress bar; by default only on terminals.
        allow_unstable : bool
            Run even if something grows tenfold or more by the end, see `examine`.
        tolerance : float, optional
            For a run to the static state: the fraction of their largest value below which velocities must fall, 1e-3
            unless given.
        limit : float, optional
            For a run to the static state: the latest end, for which layers are also chosen; unless given, a hundred
            times as long as the slowest wave takes to cross the near field. A `ValidityWarning` is issued if the run
            ends at this limit.
        output : str or Path, optional
            Results file, as the command line writes it, with the initial state and the states at which observers are
            called. A run that continues with the file it has begun appends to it; other results of that name are
            replaced. `open_results` reads the file, `farhorizon plot` draws it, ParaView opens it.

        Raises
        ------
        InputError
            An end that is not finite or lies in the past, a time between outputs that is not a whole number of steps, a
            run that is not stable, a run to the static state whose loads still change at its latest end, or a file that
            farhorizon did not write.
        """
        ends = {"until": until, "every": every, "tolerance": tolerance, "limit": limit, "output": output}
        self.team.alike({"run": ends})
        rest = None
        if isinstance(until, str) or tolerance is not None or limit is not None:
            rest = steady_state_criterion(self, until, tolerance, limit)
        end = checked_end(until, self.dt) if rest is None else rest.limit
        check_ahead(self, end, "run.until")
        count = None if every is None else steps_between(every, self.dt)
        last = self.prepare(end)
        self.examine(end, allow_unstable)
        show = progress if self.team.number == 0 else False
        self.rest = rest
        with nullcontext() if output is None else written(self, output):
            if rest is None:
                run_to_step(self, last, count, show)
            elif rest.over(self) or run_to_step(self, last, count, show, lambda: rest.reached(self), rest.pace):
                self._remarks.append(f"static at t = {self.time:.6g}, to a tolerance of {rest.tolerance:g}")
            else:
                warn_once(self, "not static", f"the run, ended by its limit, is not static to {rest.tolerance:g}")
        return self

    def write(self, path: str | Path, fields: Sequence[str] | None = None) -> Path:
        """Write a results file of the present state of the run, with the data of recorders and probes; older results of
        that name are replaced.

        Parameters
        ----------
        path : str or Path
            ParaView opens files whose names end in .h5, .hdf or .vtkhdf.
        fields : sequence of str, optional
            Some of `fields`; all except velocities unless given.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            A field that does not exist, a file of another program, a directory that does not exist.
        """
        made = RunResults.begin(self, path, fields)
        made.append()
        made.copy_records()
        made.conclude()
        made.finish()
        return made.path

    def record(self, points: Any, every: float | None = None) -> Probes:
        """Record u at some nodes from now on, and discard earlier records; each of several processes has all values.

        Parameters
        ----------
        points : array_like, shape (n, dim), or (n,) in 1D
            Each point is replaced by the nearest node.
        every : float, optional
            Time between two rows, a whole number of steps; unless given, one step.

        Raises
        ------
        InputError
            A point outside the near field, a time that is not a whole number of steps.
        """
        self.team.alike({"points": points, "every": every})
        probes = Probes(
            self.lattice.whole, points, 1 if every is None else steps_between(every, self.dt, "probes.every")
        )
        self._set_probes(probes.nodes)
        field, (inside, own_nodes) = self.fields["u"], self.lattice.own(probes.nodes)
        now = field.reshape(*field.shape[: field.ndim - self.lattice.dim], -1)[..., own_nodes].T
        probes.add(self.step_count, self.dt, self.team.completed(now, np.flatnonzero(inside), len(inside), 0)[None])
        self.probes = probes
        return probes

    def far_field(self, name: str | None = None) -> FarField:
        """The far field that the run records, specified by ``observe=[...]`` or by ``[far_field]`` in a case file.

        Parameters
        ----------
        name : str, optional
            Name of the far field, if there are several.

        Returns
        -------
        FarField
            Its `at` gives the field at receivers at any distance; its `pattern`, `energies` and `cross_sections` give
            the radiation by direction, wave and frequency.

        Raises
        ------
        InputError
            The run records no far field, none of this name, or several of them while no name is given.

        Examples
        --------
        >>> import farhorizon as fh
        >>> lattice, pulse = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0)), {"u": "exp(-x**2 - y**2)"}
        >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), initial=pulse, observe=[fh.FarField()])
        >>> times, u = sim.run(until=30.0).far_field().at([(20.0, 0.0)])
        """
        from farhorizon.simulation.recorders.far_field import FarField

        far_fields = {recorder.name: recorder for recorder in self.recorders if isinstance(recorder, FarField)}
        if not far_fields:
            raise InputError(
                "the run records no far field",
                value=f"{len(self.recorders)} recorders",
                limit="a FarField among them",
                key="far_field",
                remedy="observe=[FarField()], or [far_field] in the case file",
            )
        if name is None and len(far_fields) > 1:
            raise InputError(
                "the run records several far fields", value=list(far_fields), limit="1", key="name", remedy="name one"
            )
        return far_fields[
            next(iter(far_fields)) if name is None else kinds.one_of(name, "name", far_fields, "no such far field")
        ]

    @abstractmethod
    def _set_probes(self, nodes: np.ndarray) -> None:
        """From now on, record u for the probes on nodes of the lattice (flat indices) after every step."""

    # --- results -----------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def fields(self) -> dict[str, np.ndarray]:
        """Copies of the fields in the near field by name, including "u"; for vectors the components come first."""

    @property
    @abstractmethod
    def notes(self) -> list[str]:
        """Notes on what is allowed but should be known."""

    @abstractmethod
    def energy(self) -> float:
        """Energy of the near field."""

    @abstractmethod
    def balance(self) -> dict[str, float]:
        """Gains since the start by origin, for runs that record them; raises InputError for others."""

    def plot(self, name: str = "u", path: str | Path | None = None, limits: tuple[float, float] | None = None) -> Any:
        """Draw a field in its present state; in three dimensions, the slice in the middle of z.

        Parameters
        ----------
        name : str
            One of `fields`; for vectors, of which the magnitude is drawn, also a component, such as "u_x"; for elastic
            media also "stress_xx" and so on, and "stress_von_mises".
        path : str or Path, optional
            A file to write: PNG, PDF or SVG, depending on the ending of its name.
        limits : (float, float), optional
            Limits of the colour scale, in one dimension of the value axis.

        Returns
        -------
        matplotlib.figure.Figure
            Displayed by notebooks.

        Raises
        ------
        InputError
            A field that does not exist, another format, a directory that does not exist, an empty range.
        """
        from farhorizon.pictures.snapshot import snapshot
        from farhorizon.pictures.style import time_text

        cracks = outlines_of(self).get("cracks", [])
        return snapshot(
            shown_fields(self, name), name, self.lattice.axes, f"t = {time_text(self.time)}", path, limits, cracks
        )

    def animate(
        self,
        name: str = "u",
        *,
        until: float,
        every: float,
        path: str | Path | None = None,
        limits: tuple[float, float] | None = None,
    ) -> Film:
        """Continue the run to a given time and animate a field; in three dimensions, its slice in the middle of z.

        Parameters
        ----------
        name : str
            As in `plot`.
        until, every : float
            As in `run`: the end, and the time between two pictures.
        path : str or Path, optional
            A file to write: GIF, or MP4 with imageio-ffmpeg, depending on the ending of its name.
        limits : (float, float), optional
            Limits of the colour scale, in one dimension of the value axis; unless given, chosen for all pictures
            together.

        Returns
        -------
        Film
            Displayed by notebooks; ``film.save(path)`` writes it.

        Raises
        ------
        InputError
            As in `run` and `plot`; an end that is not later than the present time.
        """
        from farhorizon.pictures.snapshot import Frames
        from farhorizon.pictures.style import time_text

        if kinds.number(until, "run.until") <= self.time:
            raise InputError("the film ends before it begins", value=until, limit=f"> {self.time:g}", key="run.until")
        frames = Frames(kinds.text(name, "name"), self.lattice.axes, path, limits, outlines_of(self).get("cracks", []))

        def draw(run: Run) -> None:
            frames.add(shown_fields(run, name), f"t = {time_text(run.time)}")

        draw(self)
        observers, self.observers = self.observers, [*self.observers, draw]
        try:
            self.run(until, every)
        finally:
            self.observers = observers
        return frames.film()

    def to_xarray(self) -> xarray.Dataset:
        """The fields in their present state, with their coordinates.

        Returns
        -------
        xarray.Dataset
            Fields with the dimensions [component, ]x[, y[, z]]; time and step as coordinates.

        Raises
        ------
        InputError
            xarray is not installed.
        """
        return dataset(self.fields, self.lattice.axes, {"time": self.time, "step": self.step_count})

    # --- checks before a run -----------------------------------------------------------------------------------

    @property
    @abstractmethod
    def crossing(self) -> float:
        """The run's own unit of time: the time in which the fastest wave crosses the near field, or ``R^2/D``, in which
        diffusion empties it.
        """

    @abstractmethod
    def seconds_per_step(self) -> float:
        """Time per step on this machine at present; the state is not changed."""

    @abstractmethod
    def certificate(self, budget: float, until: float = np.inf) -> Certificate:
        """Examine the stability of the complete update, for `budget` seconds at most, as a run to `until` needs it."""

    def examine(self, until: float, allow_unstable: bool = False) -> Certificate:
        """Examine the stability of a run before it begins; a Python program and the command line do the same.

        White noise is followed for the length of the run, but for ten crossing times at most. If the run is longer,
        modes are also examined, for half the computing time of the run or two seconds, whichever is longer. What has
        been examined before is not examined again. Anything the user should know is added to the `notes`.

        Parameters
        ----------
        until : float
        allow_unstable : bool
            Note what grows instead of refusing the run.

        Returns
        -------
        Certificate

        Raises
        ------
        InputError
            Something grows tenfold or more by the end of the run.
        """
        if self.team:
            self._remarks = ["the stability of a run on several processes is not examined: check the case on one"]
            return Certificate(UNDECIDED, "not examined on several processes")
        certificate = self._examination.of(self, until, allow_unstable)
        self._remarks = [remark] if (remark := certificate.remark(until)) else []
        return certificate

    @abstractmethod
    def check(self, until: float | None = None, budget: float | None = None) -> Report:
        """Report facts, warnings and notes before a run to `until`."""

    # --- state -------------------------------------------------------------------------------------------------

    @abstractmethod
    def save(self, path: str | Path, **extra: Any) -> None:
        """Write the complete state to a temporary file, which is then renamed; `load` returns `extra`."""

    @abstractmethod
    def load(self, path: str | Path) -> dict[str, Any]:
        """Restore a checkpoint of the same set-up; what follows is bitwise identical to the uninterrupted run.

        Raises
        ------
        FileFormatError
            A damaged file, or a checkpoint of another set-up.
        """

    @classmethod
    def restore(cls, path: str | Path, **changes: Any) -> Self:
        """Recreate the run that wrote a checkpoint, in the state in which it was saved.

        Parameters
        ----------
        path : str or Path
        **changes
            Arguments of the constructor that replace the stored ones: needed for Python functions (sources, loads),
            which a file cannot hold, and for observers.

        Raises
        ------
        InputError
            The set-up contained a Python function that is not given again.
        FileFormatError
            A damaged or foreign file, or changes that result in another set-up.
        """
        run = cls(**{**arguments_in(path, cls.__name__, changes), **changes})
        run.load(path)
        return run


_LEAST = 2.0  # smallest budget for the modes of a run


class Examinable(Protocol):
    """A run that can be examined."""

    lattice: Lattice
    stencil: Stencil
    dt: float
    step_count: int

    def certificate(self, budget: float, until: float) -> Certificate:
        """Determine whether the complete update is stable, in at most `budget` seconds."""


class Examination:
    """The certificate of a run, which is made again only if it is not sufficient."""

    def __init__(self) -> None:
        self._known: Certificate | None = None
        self._asked = 0.0  # length of the run for which it was made

    def of(self, run: Examinable, until: float, allow_unstable: bool) -> Certificate:
        """Return the certificate of a run up to a time; raises InputError if anything grows tenfold or more by then."""
        known = self._known
        # growth seen in a short run of noise need not continue in a longer one
        little = known is not None and (
            (known.verdict == UNDECIDED and known.quiet < until) or known.grows_within(until)
        )
        if known is None or (little and self._asked < until):
            # doubling the length keeps the number of examinations small for a run in many pieces
            asked = until if known is None else max(until, 2 * self._asked)
            known = run.certificate(modes_budget(run, until), asked)
            self._known, self._asked = known, asked
        if known.grows_within(until) and not allow_unstable:
            raise InputError(
                "the run is not stable",
                value=known.reason,
                limit=f"no tenfold growth until t = {until:.6g}",
                remedy="see the warnings of check; Extended in place of absorbing sides; "
                "allow_unstable=True (--allow-unstable) runs it anyway",
            )
        return known


def modes_budget(run: Examinable, until: float) -> float:
    """Return what the examination of the modes may take for a run to a time, half of the run's own operations, in
    seconds of a typical core.
    """
    steps = until / run.dt - run.step_count
    return max(_LEAST, 0.5 * steps * step_seconds(run.lattice.nodes * run.stencil.weights.size))
