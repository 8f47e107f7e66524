"""What the program needs of a run, whatever computes it: a time loop, fields and energies, a state that is saved, a
check before it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
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
from farhorizon.simulation.course import check_ahead, checked_end, go, say_doubt
from farhorizon.simulation.examination import Examination
from farhorizon.simulation.kept import packed
from farhorizon.simulation.nodal_stress import shown_fields
from farhorizon.simulation.outlines import outlines_of
from farhorizon.simulation.output import RunResults, written
from farhorizon.simulation.probes import Probes
from farhorizon.simulation.recorder import Observer, Recorder
from farhorizon.simulation.rest import Resting, coming_to_rest
from farhorizon.simulation.resume import stored
from farhorizon.simulation.steps import last_step, steps_between
from farhorizon.simulation.team import ALONE, Team

if TYPE_CHECKING:
    import xarray

    from farhorizon.checks.report import Report
    from farhorizon.pictures.movie import Film
    from farhorizon.simulation.far_field import FarField

_GUARD_STEPS = 200  # steps between two looks of the instability guard, at most; fewer on lattices above
_GUARD_NODES = 1_000_000  # this many nodes, so that an interrupt is heard within seconds


def _tells(value: Any) -> bool:
    """Whether something was given: not what stands for nothing."""
    return not (value is None or (isinstance(value, bool | tuple | list | dict | float) and not value))


class Run(ABC):
    """A run of a near field in time, such as `Simulation`.

    Attributes
    ----------
    lattice : Lattice
        The near field.
    beyond : dict of (axis, side) to int
        Nodes that are computed beyond each side.
    dt, time : float
    step_count : int
    observers : list of callable
        Called with the run every so often, see `run`.
    recorders : list of Recorder
        What records it in every step: `Receivers`.
    stop_requested : bool
        Set it (from a signal handler, an observer) to end `run` with KeyboardInterrupt between two steps.
    probes : Probes or None
        What `record` has made.
    peak : float
        The largest kinetic energy, of diffusion the largest value, that a run to its static state has seen.
    resting : Resting
        What tells whether the run has come to rest.
    team : Team
        The processes that compute it.
    cautions : list of Caution
        From when on the result is doubtful, and why; each has been a `ValidityWarning` when it was found.
    output : RunResults or None
        The results file that `run` has begun.
    next_look : int
        Step of the next look at bonds that cannot break.
    given : dict
        What was given, by names of arguments, without the initial data; the time step is the one that was chosen.
    """

    lattice: Lattice
    beyond: dict[tuple[int, int], int]
    given: dict[str, Any]
    stencil: Stencil
    dt: float
    probes: Probes | None = None
    output: RunResults | None = None
    resting: Resting
    team: Team = ALONE

    def _at_start(self, observe: Sequence[Observer], nodes: int) -> None:
        """Before the first step of a run that computes so many nodes."""
        given = kinds.sequence(observe, "observe", "functions of the run, and recorders")
        self.recorders = [one for one in given if isinstance(one, Recorder)]
        self.observers = [kinds.function(one, "observe", "run") for one in given if not isinstance(one, Recorder)]
        self.stop_requested = False
        self.cautions: list[Caution] = []
        self.time, self.step_count = 0.0, 0
        self.next_look = 0
        self.peak = 0.0
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

    # --- in time -----------------------------------------------------------------------------------------------

    @abstractmethod
    def step(self, count: int = 1) -> None:
        """Advance by `count` steps; raises UnstableError when a field becomes non-finite or explodes."""

    def prepare(self, until: float) -> int:
        """What `run` does first; returns the number of the last step, the first one at or after a time."""
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
        """Run to a time, or until it has come to rest; observers are called every `every` time units and at the end.

        Parameters
        ----------
        until : float or "static"
            The run stops at the first step at or after it; `time` says when that was. "static": it stops when the
            waves have left, see `farhorizon.simulation.rest.Rest`.
        every : float, optional
            A whole number of steps: build the run with ``dt=WholeSteps(every=...)`` where it matters.
        progress : bool, optional
            Show a bar; on terminals only unless given.
        allow_unstable : bool
            Run although something grows tenfold or more until then, see `examine`.
        tolerance : float, optional
            Of a run to the static state: part of their largest value below which velocities are to fall, 1e-3 unless
            given.
        limit : float, optional
            Of a run to the static state: the latest end, for which layers are chosen, too; a hundred times as long as
            the slowest wave takes to cross the near field unless given. A `ValidityWarning` tells of a run that ended
            there.
        output : str or Path, optional
            Results file, as the command line writes it: the start, and what observers are called for. A run that goes
            on with the file that it has begun appends; other results of that name are replaced. `open_results` reads
            it, `farhorizon plot` draws it, ParaView opens it.

        Raises
        ------
        InputError
            An end that is not finite or lies in the past, a time between outputs that is not a whole number of steps, a
            run that is not stable, or one to the static state whose loads change up to its latest end; a file that is
            not ours.
        """
        rest = coming_to_rest(self, until, tolerance, limit)
        end = checked_end(until, self.dt) if rest is None else rest.limit
        check_ahead(self, end, "run.until")
        count = None if every is None else steps_between(every, self.dt)
        last = self.prepare(end)
        self.examine(end, allow_unstable)
        show = progress if self.team.number == 0 else False
        with written(self, output):
            if rest is None:
                go(self, last, count, show)
            elif go(self, last, count, show, lambda: rest.reached(self), rest.pace):
                self._remarks.append(f"static at t = {self.time:.6g}, to a tolerance of {rest.tolerance:g}")
            else:
                say_doubt(self, "not static", f"the run, ended by its limit, is not static to {rest.tolerance:g}")
        return self

    def write(self, path: str | Path, fields: Sequence[str] | None = None) -> Path:
        """Write a results file of the run as it is now, with what recorders and probes have; older results of that
        name are replaced.

        Parameters
        ----------
        path : str or Path
            ParaView opens files whose names end in .h5, .hdf or .vtkhdf.
        fields : sequence of str, optional
            Some of `fields`; all but velocities unless given.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            A field that there is not, a file of another program, no such directory.
        """
        made = RunResults.begin(self, path, fields)
        made.append()
        made.copy_records()
        made.conclude()
        made.finish()
        return made.path

    def record(self, points: Any, every: float | None = None) -> Probes:
        """Record u at some nodes from now on, in place of what was recorded so far; each of several processes has all.

        Parameters
        ----------
        points : array_like, shape (n, dim), or (n,) in 1D
            Each stands for the node nearest to it.
        every : float, optional
            Time between two rows, a whole number of steps; one step unless given.

        Raises
        ------
        InputError
            A point outside the near field, a time that is not a whole number of steps.
        """
        probes = Probes(
            self.lattice.whole, points, 1 if every is None else steps_between(every, self.dt, "probes.every")
        )
        self._watch(probes.nodes)
        field, (inside, own) = self.fields["u"], self.lattice.own(probes.nodes)
        now = field.reshape(*field.shape[: field.ndim - self.lattice.dim], -1)[..., own].T
        now = self.team.completed(now, np.flatnonzero(inside), len(probes.nodes), 0)
        probes.add(self.step_count, self.dt, now[None])
        self.probes = probes
        return probes

    def far_field(self, name: str | None = None) -> FarField:
        """The far field that the run records, given in ``observe=[...]`` or as ``[far_field]`` in a case file.

        Parameters
        ----------
        name : str, optional
            Of one of several.

        Returns
        -------
        FarField
            Its `at` has receivers at any distance, its `pattern`, `energies` and `cross_sections` what goes where, by
            frequency.

        Raises
        ------
        InputError
            The run records none, none of this name, or several and no name is given.

        Examples
        --------
        >>> import farhorizon as fh
        >>> lattice, pulse = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0)), {"u": "exp(-x**2 - y**2)"}
        >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), initial=pulse, observe=[fh.FarField()])
        >>> times, u = sim.run(until=30.0).far_field().at([(20.0, 0.0)])
        """
        from farhorizon.simulation.far_field import FarField

        found = {one.name: one for one in self.recorders if isinstance(one, FarField)}
        if not found:
            raise InputError(
                "the run records no far field",
                value=f"{len(self.recorders)} recorders",
                limit="a FarField among them",
                key="far_field",
                remedy="observe=[FarField()], or [far_field] in the case file",
            )
        if name is None and len(found) > 1:
            raise InputError(
                "the run records several far fields", value=list(found), limit="1", key="name", remedy="name one"
            )
        return found[next(iter(found)) if name is None else kinds.one_of(name, "name", found, "no such far field")]

    @abstractmethod
    def _watch(self, nodes: np.ndarray) -> None:
        """From now on give the probes their rows: u on nodes of the lattice (flat indices) after every step."""

    # --- what comes out ----------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def fields(self) -> dict[str, np.ndarray]:
        """Copies of the near field by name, "u" among them; vectors have the components first."""

    @property
    @abstractmethod
    def notes(self) -> list[str]:
        """What is allowed, but to be known."""

    @abstractmethod
    def energy(self) -> float:
        """Energy of the near field."""

    @abstractmethod
    def balance(self) -> dict[str, float]:
        """Gains since the start and where they came from, of runs that record it; raises InputError for others."""

    def plot(self, name: str = "u", path: str | Path | None = None, limits: tuple[float, float] | None = None) -> Any:
        """Draw a field as it is now; in three dimensions the slice in the middle of z.

        Parameters
        ----------
        name : str
            One of `fields`; of vectors, whose length is drawn, also a component: "u_x"; of elastic media "stress_xx"
            and so on, and "stress_von_mises".
        path : str or Path, optional
            A file to write, PNG, PDF or SVG by the ending of its name.
        limits : (float, float), optional
            Of the colours, in one dimension of the axis.

        Returns
        -------
        matplotlib.figure.Figure
            Notebooks show it.

        Raises
        ------
        InputError
            A field that there is not, another format, no such directory, an empty range.
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
        """Run on to a time, and draw a film of a field on the way; in three dimensions of the slice in the middle of z.

        Parameters
        ----------
        name : str
            As of `plot`.
        until, every : float
            As of `run`: the end, and the time from one picture to the next.
        path : str or Path, optional
            A file to write: GIF, or MP4 with imageio-ffmpeg, by the ending of its name.
        limits : (float, float), optional
            Of the colours, in one dimension of the axis; chosen for all pictures together unless given.

        Returns
        -------
        Film
            Notebooks show it; ``film.save(path)`` writes it.

        Raises
        ------
        InputError
            As `run` and `plot`; an end that is not beyond the present time.
        """
        from farhorizon.pictures.snapshot import Frames
        from farhorizon.pictures.style import time_text

        if kinds.number(until, "run.until") <= self.time:
            raise InputError("the film ends before it begins", value=until, limit=f"> {self.time:g}", key="run.until")
        frames = Frames(name, self.lattice.axes, path, limits, outlines_of(self).get("cracks", []))

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
        """The fields as they are now, with their coordinates.

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

    # --- before it ---------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def crossing(self) -> float:
        """The run's own unit of time: in it the fastest wave crosses the near field, or what diffuses empties it,
        ``R^2/D``.
        """

    @abstractmethod
    def seconds_per_step(self) -> float:
        """Time of a step on this machine now; the state stays as it is."""

    @abstractmethod
    def certificate(self, budget: float, until: float = np.inf) -> Certificate:
        """Whether the complete update is stable, in at most `budget` seconds; as far as a run to `until` needs it."""

    def examine(self, until: float, allow_unstable: bool = False) -> Certificate:
        """What `run` knows of its stability before it begins; the same for a Python program and for the command line.

        White noise runs for as long as the run, ten crossing times at most. Where the run is longer modes are examined,
        too, for half the time of the run or two seconds. What was examined before is not examined again. What is to be
        known is added to the `notes`.

        Parameters
        ----------
        until : float
        allow_unstable : bool
            Note what grows, in place of refusing it.

        Returns
        -------
        Certificate

        Raises
        ------
        InputError
            What grows does so tenfold or more until then.
        """
        if self.team:
            self._remarks = ["the stability of a run on several processes is not examined: check the case on one"]
            return Certificate(UNDECIDED, "not examined on several processes")
        certificate = self._examination.of(self, until, allow_unstable)
        self._remarks = [remark] if (remark := certificate.remark(until)) else []
        return certificate

    @abstractmethod
    def check(self, until: float | None = None, budget: float | None = None) -> Report:
        """Facts, warnings and notes before a run to `until`."""

    # --- state -------------------------------------------------------------------------------------------------

    @abstractmethod
    def save(self, path: str | Path, **extra: Any) -> None:
        """Write the complete state under a temporary name and rename it; `extra` comes back from `load`."""

    @abstractmethod
    def load(self, path: str | Path) -> dict[str, Any]:
        """Take the state of a checkpoint written by the same set-up; what follows is bitwise the uninterrupted run.

        Raises
        ------
        FileFormatError
            A damaged file, or the checkpoint of another set-up.
        """

    @classmethod
    def restore(cls, path: str | Path, **changes: Any) -> Self:
        """The run that wrote a checkpoint, in the state in which it was saved.

        Parameters
        ----------
        path : str or Path
        **changes
            Arguments of the constructor to take instead of the stored ones: needed for Python functions (sources,
            loads), which a file cannot hold, and for observers.

        Raises
        ------
        InputError
            The set-up held a Python function that is not given again.
        FileFormatError
            A damaged or foreign file, or changes that make another set-up.
        """
        run = cls(**{**stored(path, cls.__name__, changes), **changes})
        run.load(path)
        return run
