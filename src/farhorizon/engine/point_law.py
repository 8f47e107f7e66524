"""Law that nodes apply to their states between the two passes of an operator, in the compiled loop.

See `farhorizon.engine.two_pass`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.matrices import call_map
from farhorizon.engine.layout import empty, ints, reals

CHUNK = 256  # neighbouring nodes whose states are processed together: they stay in the first-level cache
WHOLE, ALIKE, EACH = range(3)  # neighbours with all their bonds, others with one matrix, and others with one each


class LawRows(NamedTuple):
    """Nodes of each row that do not have all their bonds."""

    #: (R, 2): first segment of neighbours of each row, and last + 1; equal rows share theirs
    ranges: np.ndarray = ints(0, 2)
    #: (T, 6): first node along the row, and last + 1; `ALIKE` or `EACH`; index in `weights` of the first of their
    #: matrices, and distance between entries of a matrix; index in `kinds` of the first node
    segments: np.ndarray = ints(0, 6)
    kinds: np.ndarray = ints(0)  # indices of the matrices of the nodes of all segments
    weights: np.ndarray = reals(0)  # the matrices themselves, then those of segments `EACH`, entry by entry


class PointLaw(NamedTuple):
    """Law that nodes apply to their states, which have n components."""

    values: np.ndarray = reals(0)  # states, laid out as a level of n components; empty if the operator has no passes
    functions: np.ndarray = ints(0)  # (3,): addresses of the compiled law of neighbours: `WHOLE`, `ALIKE`, `EACH`
    intact: np.ndarray = reals(1, 1)  # (n, n): matrix of all nodes except the following ones
    nodes: np.ndarray = ints(0)  # (S,): places of nodes that lack bonds, ascending
    numbers: np.ndarray = ints(0)  # (S,): index of the matrix of each of them
    matrices: np.ndarray = reals(1, 1, 1)  # (m, n, n)
    rows: LawRows = empty(LawRows)  # the same nodes, row by row
    #: (m,): of the shape tensors to which the matrices belong, see `engine.shape_tensors`; the first, that of places
    #: without a node, is 1, and so is that of all other nodes. Zeros if nodes bear all of their stress down to the last
    #: of their bonds.
    harmonic_eigenvalue: np.ndarray = reals(0)
    #: (3,): Lame's constant, shear modulus and stabilisation, from which the matrices are computed
    moduli: np.ndarray = reals(0)
    local: np.ndarray = reals(3, 0)  # (3, places): the same moduli of each node if they vary, or empty
    bases: np.ndarray = reals(1, 1, 1)  # (3, n, n): matrix of all other nodes per unit of each modulus
    shapes: np.ndarray = reals(1, 1)  # (K, d * d): contribution of each bond to the shape tensor
    kept: bool = False  # whether bonds that break leave the shape tensor unchanged
    #: (3,): box of nodes whose states are complete once swept: no layer adds to them, no bond is cut
    first: np.ndarray = ints(0)
    end: np.ndarray = ints(0)  # (3,)
    room: np.ndarray = reals(1, 1, CHUNK)  # (threads, n, CHUNK): work space
    thermal_strain: np.ndarray = reals(
        0
    )  # (places,), or empty: no force responds to it, see `engine.features.thermal_strain`
    spacing: float = reals(value=1.0)  # by which a unit strain is converted into displacements
    unit: np.ndarray = reals(0)  # (n,): state of a unit strain in all directions, for a node with all its bonds
    units: np.ndarray = reals(1, 1)  # (m, n): the same for the nodes to which `matrices` belong
    arms: np.ndarray = reals(0, 0)  # (K, d): bond vectors, in units of length


@njit(error_model="numpy", cache=True, counted=False)
def first_special(nodes, place):
    """Index of the first of ascending nodes that is not before a place."""
    low, high = 0, nodes.size
    while low < high:
        middle = (low + high) // 2
        if nodes[middle] < place:
            low = middle + 1
        else:
            high = middle
    return low


@njit(error_model="numpy", cache=True, counted=False)
def apply_local(law, start, n, room):
    """Apply the law to neighbours with all their bonds, each with its own moduli; in place."""
    values, local, bases, count = law.values, law.local, law.bases, law.intact.shape[0]
    size = values.size // count
    for row in range(count):
        total = room[row]
        total[:n] = 0
        for column in range(count):
            lame, shear, pull = bases[0, row, column], bases[1, row, column], bases[2, row, column]
            if lame != 0 or shear != 0 or pull != 0:
                state = values[column * size + start : column * size + start + n]
                for i in range(n):
                    at = start + i
                    total[i] += (lame * local[0, at] + shear * local[1, at] + pull * local[2, at]) * state[i]
    for row in range(count):
        for i in range(n):
            values[row * size + start + i] = room[row, i]


@njit(error_model="numpy", cache=True, counted=False)
def leave_out_thermal_strain(law, start, n, number):
    """Subtract thermal strains from the states of neighbours of one kind; `number` is the index of their matrix, or
    -1.
    """
    values, count = law.values, law.unit.size
    size = values.size // count
    for row in range(count):
        strained = law.spacing * (law.unit[row] if number < 0 else law.units[number, row])
        if strained != 0:
            for i in range(start, start + n):
                values[row * size + i] -= strained * law.thermal_strain[i]


@njit(error_model="numpy", cache=True, counted=False)
def apply_whole(thread, law, first, last):
    """Apply the law to neighbours with all their bonds, from the place `first` on, before `last`; in place."""
    values, intact, size = law.values, law.intact, law.values.itemsize
    if law.thermal_strain.size and first < last:
        leave_out_thermal_strain(law, first, last - first, -1)
    if law.local.size:
        for start in range(first, last, CHUNK):
            apply_local(law, start, min(CHUNK, last - start), law.room[thread.number])
    elif first < last:
        place, apart = values.ctypes.data + first * size, values.size // intact.shape[0] * size
        call_map(law.functions[WHOLE], place, apart, place, apart, intact.ctypes.data, size, last - first, 1.0)


@njit(error_model="numpy", cache=True, counted=False)
def apply_law(thread, law, row, origin, first, last):
    """Apply the law to nodes of a row, from `first` on, before `last`; `origin` is the place of its first node. In
    place.
    """
    values, rows, size = law.values, law.rows, law.values.itemsize
    apart, start = values.size // law.intact.shape[0] * size, first
    for segment in range(rows.ranges[row, 0], rows.ranges[row, 1]):
        place, stop, function, weight, step, kind = rows.segments[segment]
        begin, end = max(place, first), min(stop, last)
        if begin < end:
            apply_whole(thread, law, origin + start, origin + begin)
            at, on = origin + begin, begin - place
            if law.thermal_strain.size:
                for i in range(end - begin):
                    leave_out_thermal_strain(law, at + i, 1, rows.kinds[kind + on + i])
            matrix = rows.weights.ctypes.data + (weight + on * (function == EACH)) * size
            state, laws = values.ctypes.data + at * size, law.functions
            call_map(laws[function], state, apart, state, apart, matrix, step * size, end - begin, 1.0)
            start = end
    apply_whole(thread, law, origin + start, origin + last)


@njit(error_model="numpy", cache=True, counted=False)
def apply_to_rows(thread, law, block, i0, first, last, complete):
    """Apply the law to rows of a plane: to nodes whose states are `complete` once they are swept, or to the others."""
    inside = law.first[0] <= i0 < law.end[0]
    for i1 in range(first, last):
        origin, row = block[0] + i0 * block[4] + i1 * block[5], i0 * block[2] + i1
        low, high = law.first[2], law.end[2]
        if not inside or not law.first[1] <= i1 < law.end[1]:
            low, high = block[3], block[3]
        if complete:
            apply_law(thread, law, row, origin, low, high)
        else:
            apply_law(thread, law, row, origin, 0, low)
            apply_law(thread, law, row, origin, high, block[3])
