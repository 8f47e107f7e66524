"""Values of nodes, and sums over blocks of nodes, that are recorded after each step, in the compiled loop.

The next step does so for each part of the box as it sweeps it, when the values are in the cache.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.vector_operations import block_sum, copy_values
from farhorizon.engine.feature import DONE, Feature, Step
from farhorizon.engine.field import Field
from farhorizon.engine.layout import ints, reals, with_defaults
from farhorizon.engine.passes import reads
from farhorizon.engine.sweep_program import ONE, ZERO, count_parts, rows_of
from farhorizon.engine.threads import chunk_of


class BlockSums(NamedTuple):
    """Sums over blocks of nodes that are recorded after each step: values between nodes, and derivatives.

    The weight of a node is the product of one weight per axis. Blocks with equal weights along an axis share them,
    because reading weights takes as long as reading nodes.
    """

    stride: np.ndarray  # distances between neighbours in a level, shape (3,)
    # Number of sums over blocks of one size, and the size of these blocks along the axes; along the third it is a
    # whole number of vectors of 64 bytes, filled up with weights zero.
    sets: np.ndarray = ints(0, 4)
    # Of each sum, set by set and sorted: place in the middle of the block, in its component; place of the block's
    # first node in the level; indices of its first weights along the axes; and its column.
    rows: np.ndarray = ints(0, 6)
    weights: np.ndarray = reals(0)


@njit(error_model="numpy", cache=True, counted=False)
def first_from(rows, r, last, key):
    """First row from r on, before `last`, whose first number is not below `key`; rows are sorted by it."""
    while r < last:
        middle = (r + last) // 2
        if rows[middle, 0] < key:
            r = middle + 1
        else:
            last = middle
    return r


@njit(error_model="numpy", cache=True, counted=False)
def record_nodes(level, runs, low, high, node_values):
    """Copy the values of nodes whose keys are from `low` to `high`, run by run: reading an index for each node would
    take longer than copying the values.
    """
    source, to, size = level.ctypes.data, node_values.ctypes.data, level.itemsize
    r = first_from(runs, ZERO, runs.shape[0], low)
    while r < runs.shape[0] and runs[r, 0] < high:
        copy_values(source + runs[r, 1] * size, to + runs[r, 2] * 8, runs[r, 3], level[0])
        r += 1


@njit(error_model="numpy", cache=True, counted=False)
def sum_blocks(level, block_sums, low, high, way, block_values):
    """Sum over blocks of nodes whose middles are from `low` to `high`; if `way` is 1 or -1, over those whose last or
    first rows are: where rows are swept upwards or downwards, all their others have just been in the cache.
    """
    sets, rows, weights, stride = block_sums.sets, block_sums.rows, block_sums.weights, block_sums.stride
    source, factors, size = level.ctypes.data, weights.ctypes.data, level.itemsize
    none = level.dtype.type(0)  # 0 times a float32 is a float64 here
    end = ZERO
    for s in range(sets.shape[0]):
        start, end = end, end + sets[s, 0]
        planes, lines, nodes = sets[s, 1], sets[s, 2], sets[s, 3]
        rest = (lines - (way > 0)) // 2 * way * stride[1]
        r = first_from(rows, start, end, low - rest)
        while r < end and rows[r, 0] < high - rest:
            place, first = rows[r, 1], rows[r, 2]
            across, along = factors + rows[r, 3] * size, factors + rows[r, 4] * size
            total = none
            for i in range(planes):
                plane = source + (place + i * stride[0]) * size
                total += weights[first + i] * block_sum(plane, across, lines, stride[1], along, nodes, none)
            block_values[rows[r, 5]] = total
            r += 1


@njit(error_model="numpy", cache=True, counted=False)
def keys_of(sweep, number):
    """Keys of the first node of a part of the box and of the one after its last."""
    block = sweep.block
    i0, first, last = rows_of(sweep, number)
    plane = block[0] + i0 * block[4]
    return plane + first * block[5], plane + last * block[5]


@njit(error_model="numpy", cache=True, counted=False)
def is_kept(inputs, step):
    """Whether recorders want the field after a step."""
    return (inputs.before[0] + step + 1) % inputs.stride == 0


def record_nodes_part(thread, stage, sums, tables, inputs, step, number):
    """Record the values of nodes after the previous step: the sweep has just read them, so they are in the cache."""
    if step > 0 and stage.part == 0 and is_kept(inputs, step - 1):
        low, high = keys_of(sums.sweep, number)
        record_nodes(stage.src, inputs.recorded_nodes, low, high, inputs.node_values[step - 1])


@reads("block_sums")
def record_blocks_part(thread, stage, sums, tables, inputs, step, number):
    """Record the sums over blocks of nodes after the previous step."""
    if step > 0 and stage.part == 0 and is_kept(inputs, step - 1):
        low, high = keys_of(sums.sweep, number)
        way = ZERO if sums.sweep.block[1] > 1 else ONE - 2 * stage.backward  # in 3D the sweep visits planes before rows
        sum_blocks(stage.src, tables.block_sums, low, high, way, inputs.block_values[step - 1])


def record_nodes_last(thread, stage, sums, tables, inputs, step, number):
    """Record the values of nodes after the last step of a call; after others the next step does so."""
    if step == inputs.node_values.shape[0] - 1 and is_kept(inputs, step):
        chunk = chunk_of(thread, count_parts(sums.sweep))
        for part in range(chunk[0], chunk[1]):
            low, high = keys_of(sums.sweep, part)
            record_nodes(stage.out, inputs.recorded_nodes, low, high, inputs.node_values[step])


@reads("block_sums")
def record_blocks_last(thread, stage, sums, tables, inputs, step, number):
    """Record the sums over blocks of nodes after the last step of a call."""
    if step == inputs.node_values.shape[0] - 1 and is_kept(inputs, step):
        chunk = chunk_of(thread, count_parts(sums.sweep))
        for part in range(chunk[0], chunk[1]):
            low, high = keys_of(sums.sweep, part)
            sum_blocks(stage.out, tables.block_sums, low, high, ZERO, inputs.block_values[step])


def _none(engine: Field) -> BlockSums:
    return with_defaults(BlockSums, engine.dtype, stride=np.array(engine.layout.box.stride, np.int64))


BLOCK_SUMS = Feature(
    "block_sums",
    [
        Step(DONE, record_nodes_last, lambda _, asked, __: asked.recorded_nodes, part=record_nodes_part),
        Step(DONE, record_blocks_last, lambda tables, *_: tables.block_sums.rows.size, part=record_blocks_part),
    ],
    table=BlockSums,
    made=_none,
)


def record_blocks(engine: Field, blocks: Sequence[tuple[np.ndarray, Sequence[np.ndarray]]]) -> None:
    """Record sums over blocks of nodes in `block_values` after every step from now on: places of the first nodes of
    blocks in a level, shape (n,), and their weights along the three axes, three arrays of shape (n, width).
    """
    lanes = 64 // engine.dtype.itemsize
    stride, column = engine.tables.block_sums.stride, 0
    sets, rows, weights, count = [], [np.zeros((0, 6), np.int64)], [np.zeros(0, engine.dtype)], 0
    for places, (first, second, third) in blocks:
        padded = np.pad(third, ((0, 0), (0, -third.shape[1] % lanes)))
        middle = places % engine.layout.size + first.shape[1] // 2 * stride[0] + second.shape[1] // 2 * stride[1]
        order = np.argsort(middle, kind="stable")
        columns = [middle[order], places[order]]
        for along in (first, second, padded):
            lines, which = _distinct(along[order].astype(engine.dtype))
            columns.append(count + lines.shape[1] * which)
            weights.append(lines.ravel())
            count += lines.size
        sets.append([len(places), first.shape[1], second.shape[1], padded.shape[1]])
        columns.append(column + order)
        column += len(places)
        rows.append(np.stack(columns, axis=1))
    engine.replace(
        block_sums=engine.tables.block_sums._replace(
            sets=np.array(sets, np.int64).reshape(-1, 4), rows=np.concatenate(rows), weights=np.concatenate(weights)
        )
    )


def _distinct(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct rows in the order of their first occurrence, and the index of each row among them; the loop reads them
    one after the other.
    """
    _, first, which = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return rows[first[order]], np.argsort(order)[which.reshape(-1)]
