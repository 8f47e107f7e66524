"""What every recorder is: what it requests from the time loop, what it receives, and the rows that it keeps."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Length, Registered
from farhorizon.errors import InputError
from farhorizon.files.records import Recorded
from farhorizon.geometry.interpolation import Blocks
from farhorizon.machine import check_fits
from farhorizon.simulation.recorders.fourier_sums import FourierSums, SampledSums

Arrays = dict[str, np.ndarray]


class RecordRequest(NamedTuple):
    """What a recorder requests from the time loop."""

    nodes: np.ndarray  # flat indices of nodes in the lattice, on several processes in the whole one, shape (N,)
    blocks: tuple[Blocks, ...]  # weighted sums over blocks of nodes, computed in the loop
    every: int = 1  # only rows of steps that are multiples of it are needed; other rows may hold anything
    stop: bool = False  # the loop returns after such steps, so that the recorder can examine the run
    heat: bool = False  # the thermal strain as well, summed over the first of the blocks
    held: tuple[np.ndarray, ...] = ()  # groups of nodes, likewise, whose constraint forces are needed
    impactors: int = 0  # their number, if what they do is needed


class StepValues(NamedTuple):
    """What a recorder receives for some steps, the field minus the background, in arrays that are used again for the
    next.
    """

    nodes: np.ndarray  # shape (steps, N, components)
    # each of shape (steps, n, components); those of the thermal strain, the same for all components, come last
    blocks: tuple[np.ndarray, ...]
    # sums of the forces, per unit mass of a node of the medium, that held each group in a step: those at the time
    # before it; shape (steps, groups, components). Of impactors, instead, the rows of `Inputs.impactor_values`.
    forces: np.ndarray = np.zeros((0, 0, 0))


class Recorder(Registered, ABC):
    """An object that records a run in every step of the compiled loop; it is passed to a run in ``observe=[...]``.

    A recorder serves one run at a time: when passed to another one, it discards what it has recorded. ``CrackTips`` has
    the table ``[[crack_tips]]`` in a case file, unless the class states another `tag`.
    """

    known: ClassVar[dict[str, type[Recorder]]] = {}  # all recorders by name, including user-defined ones
    several: ClassVar[bool] = True  # a case file has a list of its tables; otherwise one table
    name: str  # by which results and checkpoints identify it
    notes: list[str]
    doubts: Sequence[str] = ()  # why the data may be wrong: `ValidityWarning` when the simulation is created
    # it can record runs on several processes: all that it requests and receives then refers to the whole lattice and is
    # the same on all of them
    shared = False
    unlike = False  # each process may give it other arguments, as long as it requests the same
    run = 0  # number of the run that it serves, among the runs of this process

    @property
    @abstractmethod
    def recorded(self) -> Recorded:
        """The data recorded so far, independent of the run."""

    @abstractmethod
    def forget(self) -> None:
        """Discard the rows recorded so far, once a file has them."""

    @property
    def asked(self) -> Arrays:
        """What a recorder that continues must have in common with the previous one, by name."""
        return {}

    @property
    def names(self) -> list[str]:
        """All names that it uses in results."""
        return [self.name]

    def concluded(self) -> list[Recorded]:
        """What follows from all recorded data once the run has ended; nothing for most recorders."""
        return []

    @abstractmethod
    def begin(self, setup: Any, parts: Any) -> RecordRequest:
        """Specify what to record of a run, given its set-up and the parts made from it; raises InputError for
        quantities that it cannot provide.
        """

    def foresee(self, until: float, steps: int) -> None:
        """Examine a run to a given time, of that many steps in all, as `run` does first; raises InputError for what
        cannot be recorded.
        """

    @abstractmethod
    def start(self, step: int, step_values: StepValues) -> None:
        """Discard what was recorded and record the first step, in the last of two rows; the row before is one step
        earlier.
        """

    @abstractmethod
    def add(self, step: int, step_values: StepValues) -> None:
        """Record the values after the steps from number `step` on."""

    @abstractmethod
    def state(self) -> Arrays:
        """Return everything that `take` needs to continue from here."""

    @abstractmethod
    def take(self, state: Arrays) -> None:
        """Restore a state that `state` returned."""


class Plane(NamedTuple):
    """A plane across an axis.

    Parameters
    ----------
    axis : str
        Normal of the plane: x, y or z.
    position : float
        Coordinate of the plane along its normal.
    """

    axis: str
    position: Length


class LinearRecorder(Recorder, offered=False):
    """A recorder of linear functionals of the field: `begin` requests nodes and sums over blocks of nodes, `functional`
    arranges their values in each step, and `keep` says what is done with them; `sums` adds them up by frequency.
    """

    sums: FourierSums | SampledSums | None = None
    _sums_key = "sums."  # before the names of the state of `sums`

    def __init__(self, name: str) -> None:
        self.name = _valid_name(name)
        self.notes = []

    def functional(self, step_values: StepValues) -> np.ndarray:
        """Return the values in each step, shape (steps, ...)."""
        return step_values.nodes

    def restart(self, step: int, values: np.ndarray, forces: np.ndarray) -> None:
        """Discard what was recorded; `values` are those of the step before the given one, and of this one."""

    def keep(self, step: int, values: np.ndarray, forces: np.ndarray) -> None:
        """Record the values after the steps from number `step` on, and the forces of `StepValues`."""

    def start(self, step: int, step_values: StepValues) -> None:
        values = self.functional(step_values)
        if self.sums is not None:
            self.sums.clear()
            self.sums.add(step, values[1:])
        self.restart(step, values, step_values.forces)

    def add(self, step: int, step_values: StepValues) -> None:
        values = self.functional(step_values)
        if self.sums is not None:
            self.sums.add(step, values)
        self.keep(step, values, step_values.forces)

    def forget(self) -> None:
        """Do nothing: sums go on, and there are no rows."""

    def state(self) -> Arrays:
        if self.sums is None or not self.sums.frequencies.size:
            return {}
        return {f"{self._sums_key}{name}": array for name, array in self.sums.state().items()}

    def take(self, state: Arrays) -> None:
        if self.sums is not None and self.sums.frequencies.size:
            key = self._sums_key
            self.sums.take({name.removeprefix(key): array for name, array in state.items() if name.startswith(key)})


class Window(NamedTuple):
    """What the rows of some steps follow from."""

    steps: np.ndarray  # shape (rows,)
    # values of the functional, each of shape (rows, ...): `RowRecorder.before` steps earlier, ..., `after` steps later
    values: tuple[np.ndarray, ...]
    forces: np.ndarray  # those of `StepValues`


class RowRecorder(LinearRecorder, offered=False):
    """A recorder that keeps rows of quantities, which follow from the functional in one or a few consecutive steps,
    until they are in a file.
    """

    points: np.ndarray  # shape (n, dim)
    every = 1  # steps from one row to the next
    before = after = 0  # how many steps before and after its own a row needs
    resting = False  # rows are states of equilibrium, which the steps before and after have, too
    unbroken = False  # there is a row for every step: the first step then determines all of them
    _last_key = "last"  # name of the last values in the state
    _labels: tuple[str, ...] = ()  # what the points stand for, if they are no places at which values are read

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.dt = 0.0  # step of the run, which `begin` sets
        self._next = 0  # step of the next row, if there is one for every step
        self._begin_rows({})

    @abstractmethod
    def rows(self, window: Window) -> Arrays:
        """Return the rows of each quantity, each of shape (rows, ...)."""

    @property
    def asked(self) -> Arrays:
        """The points."""
        return {"points": self.points}

    @property
    def times(self) -> np.ndarray:
        """Times at which the rows were recorded, shape (rows,)."""
        return np.concatenate(self._steps) * self.dt

    @property
    def data(self) -> Arrays:
        """Recorded values by quantity."""
        return {name: np.concatenate(rows) for name, rows in self._rows.items()}

    @property
    def recorded(self) -> Recorded:
        """The recorded data, independent of the run: it writes tables and arrays, and ObsPy traces."""
        return Recorded(self.name, self.points, self.times, self.data, labels=self._labels)

    def forget(self) -> None:
        """Discard the rows recorded so far."""
        self._begin_rows({name: rows[0][:0] for name, rows in self._rows.items()})

    def _begin_rows(self, empty: Arrays) -> None:
        """Discard all rows; `empty` has zero rows of each quantity, which define the shape of a row."""
        self._steps, self._rows = [np.zeros(0, np.int64)], {name: [rows] for name, rows in empty.items()}

    def restart(self, step: int, values: np.ndarray, forces: np.ndarray) -> None:
        none = values[:0]
        self._begin_rows(self.rows(Window(np.zeros(0, np.int64), (none,) * (1 + self.before + self.after), forces[:0])))
        self._last = values[1 - self.before : 1 + self.after].copy()
        self.keep(step + self.after, values[1 + self.after :], forces)

    def keep(self, step: int, values: np.ndarray, forces: np.ndarray) -> None:
        if self.resting:
            steps = np.arange(step, step + len(values))
            kept = slice(-step % self.every, None, self.every)
            if len(steps[kept]):
                alike = (values[kept],) * (1 + self.before + self.after)
                self._append(steps[kept], self.rows(Window(steps[kept], alike, forces[kept])))
            return
        span, count, first = self.before + self.after, len(values), step - self.after
        states = np.concatenate([self._last, values]) if span else values
        kept = slice(-first % self.every, count, self.every)
        steps = np.arange(first, first + count)[kept]
        if len(steps):
            shifted = tuple(states[shift : shift + count][kept] for shift in range(span + 1))
            self._append(steps, self.rows(Window(steps, shifted, forces[kept])))
        self._last = states[len(states) - span :].copy()

    def _append(self, steps: np.ndarray, rows: Arrays) -> None:
        for name, values in rows.items():
            self._rows[name].append(values)
        self._steps.append(steps)
        self._next = int(steps[-1]) + 1

    def state(self) -> Arrays:
        steps = np.concatenate(self._steps)
        of_steps = {"first": np.array([self._next - len(steps)])} if self.unbroken else {"steps": steps}
        last = {self._last_key: self._last} if self.before + self.after else {}
        rows = {name: np.concatenate(rows) for name, rows in self._rows.items()}
        return {**of_steps, **rows, **last, **super().state()}

    def take(self, state: Arrays) -> None:
        super().take(state)
        self._rows = {name: [state[name]] for name in self._rows}
        if self.unbroken:
            first, [rows] = int(state["first"][0]), next(iter(self._rows.values()))
            self._next = first + len(rows)
            self._steps = [np.arange(first, self._next)]
        else:
            self._steps = [np.asarray(state["steps"])]
        if self.before + self.after:
            self._last = state[self._last_key].copy()


def size_of_record(need: int, nodes: int, steps: int, key: str, remedy: str) -> str:
    """Return, in words, the size of a record of some nodes over all steps; raises InputError if it exceeds the
    available memory.
    """
    size = f"{nodes} nodes and {steps} steps"
    check_fits(need, "what is recorded on the shell of a box does", key, remedy, size)
    return f"about {need / 2**30:.3g} GiB for {size}"


Observer = Callable[[Any], None] | Recorder
"""What may be passed to a run in ``observe=[...]``."""


def recorders_given(observe: Any) -> tuple[Any, ...]:
    """Return the class of each recorder among some observers, with arguments that must be alike on all processes."""
    given = observe if isinstance(observe, Iterable) else ()
    recorders = [recorder for recorder in given if isinstance(recorder, Recorder) and not recorder.unlike]
    return tuple(
        (type(recorder), {name: getattr(recorder, name, None) for name in inspect.signature(type(recorder)).parameters})
        for recorder in recorders
    )


def check_from_start(step: int, what: str, key: str) -> None:
    """Raise InputError unless a recorder that needs all steps begins with the first one."""
    if step:
        raise InputError(
            f"{what} is recorded from the start of a run on",
            value=f"step {step}",
            limit="step 0",
            key=key,
            remedy="the checkpoint of a run that has it",
        )


def check_begun(begun: bool, what: str, key: str) -> None:
    """Raise InputError if data are requested of a recorder that has not recorded a run."""
    if not begun:
        raise InputError(
            f"the {what} of no run",
            value="0 steps",
            limit="a run that has begun",
            key=key,
            remedy=f"Simulation(..., observe=[{key.partition('_')[0]}])",
        )


def _valid_name(value: object) -> str:
    """Return the name of a recorder, of letters, digits, - and _, so that files can have it; raises InputError
    otherwise.
    """
    name = kinds.text(value, "name")
    if not name or not all(letter.isalnum() or letter in "-_" for letter in name):
        raise InputError(
            "a name has letters, digits, - and _",
            value=repr(name),
            limit="these, at least one",
            key="name",
            remedy="it names groups of files: replace other signs by _",
        )
    return name
