"""What a feature is: a part of a step that a run may have, such as drag, a filter of short waves or bodies in contact.

Each is a file of `features` with the table that it reads, the functions that set it, its operations, and what of it is
state. `engine.feature_list` lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.field import Field
from farhorizon.engine.passes import BOND_STENCIL, Function, Operation
from farhorizon.engine.tables import Asked, Inputs, Tables

#: Places of operations in a stage: before all others; before the sweep of the operator, whose halo is filled; after its
#: passes, as a part of it; changes of the new values; what follows once these are final; the end of a step.
BEFORE, HALO, OPERATOR, CHANGE, AFTER, DONE = range(6)

Arrays = Mapping[str, np.ndarray]
#: Name of a table that the loop indexes by step, its shape, and the least that this must be.
Room = tuple[str, Sequence[int], Sequence[int]]


class Step(NamedTuple):
    """An operation of a feature; those at one place follow each other as their features do in the list."""

    place: int
    function: Function  # as in `engine.program`; the operation has its name
    present: Callable[[Tables, Asked, int], Any]  # whether there is anything to do in a stage, given its number
    whole: bool = False  # whether it acts on the change of the whole step, in the last stage alone
    part: Function | None = None  # does some of it for a part of the box, as soon as that is swept
    # Operations among which it is, if it belongs to a pass of the operator.
    around: Callable[[Tables, Operation], Sequence[Operation]] = lambda tables, operation: [operation]
    which: int = BOND_STENCIL  # that pass

    @property
    def last(self) -> bool:
        """Whether it is done in the last stage alone."""
        return self.whole or self.place == DONE

    @property
    def name(self) -> str:
        """Name of the operation."""
        return str(self.function.__name__)


def _nothing(table: Any) -> Arrays:
    return {}


@dataclass(frozen=True)
class Feature:
    """A feature; what functions of its table return shares memory with it, and is empty where it is not used."""

    name: str
    steps: Sequence[Step]
    table: Any = None  # class of its table, or the default of an array; without one `Tables` does not have it
    made: Callable[[Field], Any] | None = None  # its table in a new engine; by default all are empty
    # Functions that sweep a part of the box in place of the stencil if they are needed: all of it, what needs no halo
    # from other processes, and the rest.
    sweep: Callable[[Tables], tuple[Function, Function, Function] | None] = lambda tables: None
    map: Callable[[Any], Iterable[Any]] = _nothing  # what of it determines the map of a step
    sums: Callable[[Any], Arrays] = _nothing  # what is accumulated; the first axis is that of the sums
    nodal: Callable[[Any], Arrays] = _nothing  # state of nodes, by place
    other: Callable[[Any], Arrays] = _nothing  # state of the run in checkpoints, beside these
    more: Callable[[Any], Arrays] = _nothing  # what else changes in a step
    room: Callable[[Tables, Inputs, int], Iterable[Room]] = lambda *_: ()  # what it needs for a number of steps

    def state(self, table: Any) -> Arrays:
        """All that changes in a step."""
        return {**self.sums(table), **self.nodal(table), **self.other(table), **self.more(table)}
