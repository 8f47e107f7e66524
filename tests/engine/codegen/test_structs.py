"""Named tuples that compiled functions read in memory."""

from __future__ import annotations

import pickle
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest

from farhorizon.engine.codegen.structs import Struct


class Inner(NamedTuple):
    values: np.ndarray
    small: Any
    chosen: bool


class Outer(NamedTuple):
    count: int
    inner: Inner
    plane: np.ndarray
    factor: float


@numba.njit
def weigh(struct):
    total = 0.0
    for i in range(struct.plane.shape[0]):
        for j in range(struct.plane.shape[1]):
            total += struct.plane[i, j] * (i + 10 * j)
    inner = struct.inner
    if inner.chosen:
        inner.values[0] += struct.count
    return total * struct.factor + inner.small * inner.values[1]


def table(plane: np.ndarray, chosen: bool = True) -> Outer:
    return Outer(7, Inner(np.array([1, 2]), np.float32(-0.375), chosen), plane, 1.0 / 3.0)


def expected(given: Outer) -> float:
    i, j = np.indices(given.plane.shape)
    return float((given.plane * (i + 10 * j)).sum() * given.factor + given.inner.small * given.inner.values[1])


@pytest.mark.parametrize("chosen", [True, False])
def test_fields_are_those_of_the_tuple(chosen: bool) -> None:
    given = table(np.arange(12.0).reshape(3, 4), chosen)
    assert weigh(Struct(given)) == expected(given)
    assert given.inner.values[0] == (8 if chosen else 1)  # arrays are shared, not copied


def test_an_array_keeps_its_strides() -> None:
    given = table(np.arange(60.0).reshape(6, 10)[::2, 1::3])
    assert weigh(Struct(given)) == expected(given)


def test_what_has_changed_since_the_last_one_is_seen() -> None:
    first = Struct(table(np.arange(12.0).reshape(3, 4)))
    changed = first.table._replace(inner=first.table.inner._replace(small=np.float32(2.5)), factor=-1.0)
    second = Struct(changed, first)
    assert second.type is first.type
    assert weigh(second) == expected(changed)
    wider = changed._replace(plane=np.arange(12, dtype=np.float32).reshape(4, 3))
    assert weigh(Struct(wider, second)) == expected(wider)


def test_what_is_known_is_examined_once() -> None:
    first = Struct(table(np.ones((3, 4))))
    other = table(np.arange(6.0).reshape(2, 3))._replace(inner=first.table.inner)
    second = Struct(other, known=first.known())
    assert second.parts[1] is first.parts[1]
    assert weigh(second) == expected(other)


def test_a_copy_reads_its_own_arrays() -> None:
    given = table(np.ones((2, 2)))
    copied = pickle.loads(pickle.dumps(Struct(given)))
    given.plane[:] = 5
    assert weigh(copied) == expected(copied.table) != weigh(Struct(given))
