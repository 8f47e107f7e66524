"""Rigid shapes that push nodes, in the compiled loop.

A node in a shape is pushed along the outward normal with a force in proportion to its depth, which is the gradient of
an energy, so that contact without friction conserves energy to the order of the scheme. Friction brings the node's
velocity along the surface, relative to the shape, to zero, as far as Coulomb's law lets it. All forces of a step act on
the shape, too, with the opposite sign, and its momentum changes by what the nodes gain, to rounding error.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.feature import AFTER, CHANGE, Feature, Room, Step
from farhorizon.engine.layout import doubles, ints
from farhorizon.engine.passes import reads
from farhorizon.engine.tables import Inputs, Tables
from farhorizon.engine.threads import barrier, chunk_of

#: Terms of a shape: round with a centre and a radius, a box with two corners, a polygon with corners; and what joins
#: the two terms before it.
ROUND, BOX, POLYGON, UNION, INTERSECTION, DIFFERENCE = range(6)


class Impactors(NamedTuple):
    """The rigid shapes of a run, d components."""

    # Terms of all shapes in postfix order: what each is, its first number, and its number of coordinates, of a polygon
    # that of its corners. First of each shape, and the end.
    terms: np.ndarray = ints(0, 3)
    starts: np.ndarray = ints(1)
    numbers: np.ndarray = doubles(0)
    bounds: np.ndarray = doubles(0, 2, 0)  # corners of boxes around the shapes where they start; shape (n, 2, d)
    # Acceleration of a node of the medium per depth, coefficient of friction, and mass of such a node over that of the
    # shape, 0 for one with a prescribed path; shape (n, 3).
    constants: np.ndarray = doubles(0, 3)
    state: np.ndarray = doubles(0, 2, 0)  # displacement, and velocity half a step before; shape (n, 2, d)
    first: np.ndarray = ints(0)  # box of the nodes that may be pushed, shape (3,), as is `end`
    end: np.ndarray = ints(0)
    lower: np.ndarray = doubles(0)  # coordinates of the first of them, shape (d,)
    scales: np.ndarray = doubles(2)  # spacing and time step
    exists: np.ndarray = ints(0, bits="int8")  # of each place whether there is a node
    # Of each shape, axis and side of the box whether nodes beyond it would have to be pushed with the outermost ones,
    # shape (n, 3, 2); and of each shape whether it has pushed such a node.
    open_sides: np.ndarray = ints(0, 3, 2)
    beside: np.ndarray = ints(0)
    spans: np.ndarray = ints(0, 2)  # first node and end of what may lie in a shape, of each row of this box
    forces: np.ndarray = doubles(0)  # per mass of a node of the medium, zero between steps; shape (d * places,)
    room: np.ndarray = doubles(0, 0)  # depth and normal of each term that is being evaluated; shape (terms, 1 + d)
    # Force on a shape, its motion in a step, first node of a row, a point, slip; shape (5, d).
    vectors: np.ndarray = doubles(5, 0)


@reads("impactors", "mobility")
def push_with_shapes(thread, stage, sums, tables, inputs, step, number):
    """Push nodes in the shapes, and move the shapes, which all belong to the first thread."""
    block, mobility, impactors = sums.sweep.block, tables.mobility, tables.impactors
    chunk = chunk_of(thread, impactors.spans.shape[0])
    for row in range(chunk[0], chunk[1]):
        _find_span(stage, block, impactors, row)
    barrier(thread)
    if thread.number == 0:
        for number in range(impactors.state.shape[0]):
            _push(stage, block, mobility, impactors, inputs, step, number)
    barrier(thread)


@reads("impactors", "work")
def sum_work_of_pushes(thread, stage, sums, tables, inputs, step, number):
    """Add up the work of the pushes over one step, as that of sources, and forget them."""
    block, impactors, work = sums.sweep.block, tables.impactors, tables.work
    if thread.number == 0:
        places = stage.src.size // stage.components
        for row in range(impactors.spans.shape[0]):
            start, first, end = row_start(block, impactors, row), impactors.spans[row, 0], impactors.spans[row, 1]
            for c in range(stage.components):
                for place in range(start + c * places + first, start + c * places + end):
                    force = impactors.forces[place]
                    if force != 0 and work.size:
                        work[0] += 0.5 * force * (np.float64(stage.out[place]) - np.float64(stage.base[place]))
                    impactors.forces[place] = 0
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def row_start(block, impactors, row):
    """Place of the first node of a row of the near field."""
    across = impactors.end[1] - impactors.first[1]
    i0, i1 = impactors.first[0] + row // across, impactors.first[1] + row % across
    return block[0] + i0 * block[4] + i1 * block[5] + impactors.first[2]


@njit(error_model="numpy", cache=True, counted=False)
def _set_corner(impactors, components, row):
    """Let the third of the vectors be the coordinates of the first node of a row in the undeformed lattice."""
    across = impactors.end[1] - impactors.first[1]
    corner = impactors.vectors[2]
    for c in range(components):
        corner[c] = impactors.lower[c]
    corner[components - 2] += row % across * impactors.scales[0]
    if components == 3:
        corner[0] += row // across * impactors.scales[0]


@njit(error_model="numpy", cache=True, counted=False)
def _find_span(stage, block, impactors, row):
    """Set the span of the nodes of a row that may lie in a shape: those that the bounds of a shape meet as far as the
    smallest and the largest displacement in the row tell. Components are read until no shape is left.
    """
    d, nodes, start = stage.components, impactors.end[2] - impactors.first[2], row_start(block, impactors, row)
    places, spacing, across = stage.src.size // d, impactors.scales[0], impactors.end[1] - impactors.first[1]
    left = (np.int64(1) << impactors.state.shape[0]) - 1  # bits of the shapes that the row may meet
    first, end = nodes, np.int64(0)
    for c in range(d):
        u = stage.src[start + c * places : start + c * places + nodes]
        least, most = _range(u)
        index = 0 if c == d - 1 else row % across if c == d - 2 else row // across
        corner, length = impactors.lower[c] + index * spacing, nodes - 1 if c == d - 1 else 0
        for number in range(impactors.state.shape[0]):
            if (left >> number) & 1 == 0:
                continue
            moved = impactors.state[number, 0, c] - corner
            # of the nodes, counted from the corner
            low = (impactors.bounds[number, 0, c] + moved - most) / spacing
            high = (impactors.bounds[number, 1, c] + moved - least) / spacing
            if high < 0 or low > length:
                left &= ~(np.int64(1) << number)
            elif c == d - 1:
                first = min(first, np.int64(max(low, 0.0)))
                end = max(end, np.int64(min(high, np.float64(length))) + 1)
        if left == 0:
            break
    impactors.spans[row, 0], impactors.spans[row, 1] = (first, end) if left != 0 else (0, 0)


@njit(error_model="numpy", cache=True, counted=False)
def _range(u):
    """Smallest and largest of some values, of four at a time: a comparison need not wait for the one before."""
    a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = u[0]
    fours = u.size - u.size % 4
    for i in range(0, fours, 4):
        u0, u1, u2, u3 = u[i], u[i + 1], u[i + 2], u[i + 3]
        a0, a1 = u0 if u0 < a0 else a0, u1 if u1 < a1 else a1
        a2, a3 = u2 if u2 < a2 else a2, u3 if u3 < a3 else a3
        b0, b1 = u0 if u0 > b0 else b0, u1 if u1 > b1 else b1
        b2, b3 = u2 if u2 > b2 else b2, u3 if u3 > b3 else b3
    for i in range(fours, u.size):
        a0, b0 = min(a0, u[i]), max(b0, u[i])
    return min(min(a0, a1), min(a2, a3)), max(max(b0, b1), max(b2, b3))


@njit(error_model="numpy", cache=True, counted=False)
def _push(stage, block, mobility, impactors, inputs, step, number):
    """Push the nodes in one shape, and move it."""
    d, dt = stage.components, impactors.scales[1]
    x, v, lightness = impactors.state[number, 0], impactors.state[number, 1], impactors.constants[number, 2]
    total, moves = impactors.vectors[0], impactors.vectors[1]
    total[:] = 0
    stored, mass = _touch(stage, block, mobility, impactors, number, total, moves, 0.0)
    for c in range(d):
        given = inputs.impactor_paths[step, number, c]
        moves[c] = dt * (v[c] - lightness * dt * total[c]) if lightness > 0 else given - x[c]
    if stored > 0 and impactors.constants[number, 1] > 0:
        _touch(stage, block, mobility, impactors, number, total, moves, 1 / (1 + lightness * mass))
    kept = step < inputs.impactor_values.shape[0]
    for c in range(d):
        after = v[c] - lightness * dt * total[c] if lightness > 0 else moves[c] / dt
        if kept:
            row = inputs.impactor_values[step, number]
            row[c], row[d + c], row[2 * d + c] = x[c], 0.5 * (v[c] + after), total[c]
            row[3 * d] = stored
        v[c] = after
        x[c] = x[c] + dt * after if lightness > 0 else inputs.impactor_paths[step, number, c]


@njit(error_model="numpy", cache=True, counted=False)
def _touch(stage, block, mobility, impactors, number, total, moves, share):
    """Push nodes out of a shape or, with a `share`, let them rub against it; add the forces to `total`, and return the
    energy of the contact and the mass of the nodes, in units of that of a node of the medium.
    """
    stored, mass = 0.0, 0.0
    stiffness, friction = (
        impactors.constants[number, 0],
        impactors.constants[number, 1] * impactors.constants[number, 0],
    )
    for row in range(impactors.spans.shape[0]):
        first, end = impactors.spans[row, 0], impactors.spans[row, 1]
        if first >= end:
            continue
        start = row_start(block, impactors, row)
        _set_corner(impactors, stage.components, row)
        for i in range(first, end):
            depth = _depth_of_node(stage, impactors, number, i, start + i)
            if depth <= 0:
                continue
            mobile = np.float64(mobility[start + i]) if mobility.size else 1.0
            if share > 0:
                _rub(stage, impactors, start + i, mobile, friction * depth, total, moves, share)
                continue
            _repel(stage, impactors, start + i, mobile, stiffness * depth, total)
            stored += 0.5 * stiffness * depth**2
            mass += 1 / mobile
            if _is_beside(impactors, number, row, i):
                impactors.beside[number] = 1
    return stored, mass


@njit(error_model="numpy", cache=True, counted=False)
def _repel(stage, impactors, place, mobile, force, total):
    """Push a node out of a shape along the normal."""
    d, normal = stage.components, impactors.room[0, 1:]
    for c in range(d):
        _pull(stage, impactors, place + c * (stage.src.size // d), force * normal[c], mobile)
        total[c] += force * normal[c]


@njit(error_model="numpy", cache=True, counted=False)
def _is_beside(impactors, number, row, i):
    """Whether a node is an outermost one at an open side."""
    across = impactors.end[1] - impactors.first[1]
    for axis in range(3):
        index = i if axis == 2 else row % across if axis == 1 else row // across
        low, high = impactors.open_sides[number, axis, 0], impactors.open_sides[number, axis, 1]
        if (index == 0 and low) or (index == impactors.end[axis] - impactors.first[axis] - 1 and high):
            return True
    return False


@njit(error_model="numpy", cache=True, counted=False)
def _rub(stage, impactors, place, mobile, most, total, moves, share):
    """Add friction of at most a force between a node and a shape, which moves by `moves` in this step; `share` of the
    relative motion is what a node loses if all stop at once, because the shape moves, too.
    """
    d, normal, slip = stage.components, impactors.room[0, 1:], impactors.vectors[4]
    places, along, size = stage.src.size // d, 0.0, 0.0
    for c in range(d):
        at = place + c * places
        slip[c] = np.float64(stage.out[at]) - np.float64(stage.src[at]) - moves[c]
        along += slip[c] * normal[c]
    for c in range(d):
        slip[c] -= along * normal[c]
        size += slip[c] ** 2
    size = np.sqrt(size)
    if size == 0:
        return
    force = min(most, share * size / (np.float64(stage.scale) * mobile))
    for c in range(d):
        _pull(stage, impactors, place + c * places, -force * slip[c] / size, mobile)
        total[c] -= force * slip[c] / size


@njit(error_model="numpy", cache=True, counted=False)
def _pull(stage, impactors, place, force, mobile):
    """Let a force act on one component of a node in this step."""
    impactors.forces[place] += force
    stage.out[place] += np.float64(stage.scale) * mobile * force


@njit(error_model="numpy", cache=True, counted=False)
def _depth_of_node(stage, impactors, number, i, place):
    """Depth in a shape of node number i of the row whose corner is set."""
    d, corner, at = stage.components, impactors.vectors[2], impactors.vectors[3]
    places = stage.src.size // d
    if impactors.exists[place] == 0:
        return -1.0
    for c in range(d):
        at[c] = corner[c] + np.float64(stage.src[place + c * places]) - impactors.state[number, 0, c]
        if c == d - 1:
            at[c] += i * impactors.scales[0]
        if not impactors.bounds[number, 0, c] < at[c] < impactors.bounds[number, 1, c]:
            return -1.0
    return depth_of(impactors, number, at)


@njit(error_model="numpy", cache=True, counted=False)
def depth_of(impactors, number, at):
    """Depth of a point in a shape where it starts, negative outside; the first row of `room` gets depth and outward
    normal there.
    """
    room, numbers, top = impactors.room, impactors.numbers, 0
    for term in range(impactors.starts[number], impactors.starts[number + 1]):
        what, first, count = impactors.terms[term, 0], impactors.terms[term, 1], impactors.terms[term, 2]
        if what >= UNION:
            top -= 1
            a, b = room[top - 1], room[top]
            if what == DIFFERENCE:
                for c in range(b.size):
                    b[c] = -b[c]
            if (b[0] > a[0]) == (what == UNION):
                for c in range(b.size):
                    a[c] = b[c]
            continue
        result = room[top]
        for c in range(result.size):
            result[c] = 0
        if what == ROUND:
            _in_round(numbers[first:], count, at, result)
        elif what == BOX:
            _in_box(numbers[first:], count, at, result)
        else:
            _in_polygon(numbers[first:], count, at, result)
        top += 1
    return room[0, 0]


@njit(error_model="numpy", cache=True, counted=False)
def _in_round(numbers, count, at, result):
    """Depth and normal in a disc or a ball."""
    distance = 0.0
    for c in range(count):
        distance += (at[c] - numbers[c]) ** 2
    distance = np.sqrt(distance)
    result[0] = numbers[count] - distance
    for c in range(count):
        result[1 + c] = (at[c] - numbers[c]) / distance if distance > 0 else 0.0


@njit(error_model="numpy", cache=True, counted=False)
def _in_box(numbers, count, at, result):
    """Depth and normal in a box: those of the nearest face."""
    nearest, sign = 0, 1.0
    result[0] = np.inf
    for c in range(count):
        below, above = at[c] - numbers[c], numbers[count + c] - at[c]
        if min(below, above) < result[0]:
            result[0], nearest = min(below, above), c
            sign = -1.0 if below < above else 1.0
    result[1 + nearest] = sign


@njit(error_model="numpy", cache=True, counted=False)
def _in_polygon(numbers, count, at, result):
    """Depth and normal in a polygon: those of the nearest edge, and the inside as of `geometry.shapes.Polygon`."""
    nearest, inside = np.inf, False
    for i in range(count):
        x, y = numbers[2 * i], numbers[2 * i + 1]
        j = (i + 1) % count
        across, up = numbers[2 * j] - x, numbers[2 * j + 1] - y
        share = ((at[0] - x) * across + (at[1] - y) * up) / (across**2 + up**2)
        share = min(max(share, 0.0), 1.0)
        dx, dy = x + share * across - at[0], y + share * up - at[1]
        distance = np.sqrt(dx**2 + dy**2)
        if distance < nearest:
            nearest = distance
            result[1], result[2] = (dx / distance, dy / distance) if distance > 0 else (0.0, 0.0)
        if (y > at[1]) != (numbers[2 * j + 1] > at[1]) and at[0] < x + (at[1] - y) * across / up:
            inside = not inside
    result[0] = nearest if inside else -nearest
    if not inside:
        result[1], result[2] = -result[1], -result[2]


def _room(tables: Tables, inputs: Inputs, steps: int) -> list[Room]:
    pushed = len(tables.impactors.state) if inputs.impactor_paths.size else 0
    least = (steps, pushed, tables.components) if pushed else (0, 0, 0)
    return [("impactor_paths", inputs.impactor_paths.shape, least)]


IMPACTORS = Feature(
    "impactors",
    [
        Step(CHANGE, push_with_shapes, lambda tables, asked, _: asked.pushed),
        Step(AFTER, sum_work_of_pushes, lambda tables, asked, _: asked.pushed),
    ],
    table=Impactors,
    other=lambda impactors: {"impactors": impactors.state},
    more=lambda impactors: {"beside": impactors.beside},
    room=_room,
)
