"""Bonds that break in state-based media, in the compiled loop.

Bonds break by their stretch, as bonds with a law of their own do, or by the energy that is lost with them
(`farhorizon.engine.release`), in the same zone (`farhorizon.engine.bonds`); they exert no force of their own. In tiles
where some have broken, the sums of both passes are recomputed over the present bonds for each node that lacks bonds,
and so is its shape tensor, unless it is kept. An absent bond that closes pushes its two ends apart, whatever their
states; in tiles where bonds are cut, but none has broken, nothing else is done.

The energy of a node falls when a bond breaks. Computed from the displacements of two successive steps, the difference
is what the scheme loses, to rounding.
"""

from __future__ import annotations

from farhorizon.engine.bonds import (
    CHANGED,
    CLOSES,
    END,
    FIRST,
    JUST_CHANGED,
    PIECE_ROWS,
    UNCHANGED,
    bond_factor,
    bond_stretch,
    follows_law,
    is_set,
    next_piece,
    spring_factor,
    squared_stretch,
    stiffening,
    sweep_tiles,
    thermal_squared_stretch,
)
from farhorizon.engine.codegen.bond_sweeps import LANES, ROWS
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.point_law import first_special
from farhorizon.engine.shape_tensors import FACE, SINGULAR
from farhorizon.engine.threads import barrier

#: What is recomputed for nodes that lack bonds.
STATES, FORCES, STATES_AGAIN = range(3)
_STATE, _SHAPE, _INVERSE, _LAST, _NUMBERS = range(0, 45, 9)  # offsets in a thread's work space, of 3 x 3 matrices

_ROWS_2, _ROWS_3 = ROWS[2], ROWS[3]


@njit(error_model="numpy", cache=True, counted=False)
def break_bonds(thread, stage, sweep, material, bonds):
    """Clear the bits of bonds beyond their limit; the next sweep overwrites what the kernels write otherwise."""
    zone = bonds.zone
    planes, rows = (
        zone[END] - zone[FIRST],
        (zone[END + 1] + PIECE_ROWS - 1) // PIECE_ROWS - zone[FIRST + 1] // PIECE_ROWS,
    )
    for number in range(thread.number, planes * rows, thread.threads):
        i0, piece = zone[FIRST] + number // rows, zone[FIRST + 1] // PIECE_ROWS + number % rows
        first, last = max(piece * PIECE_ROWS, zone[FIRST + 1]), min((piece + 1) * PIECE_ROWS, zone[END + 1])
        stop = zone[FIRST + 2]
        while stop < zone[END + 2]:
            start = stop
            stop, unbroken = next_piece(stage, sweep, material, bonds, i0, first, last, start)
            if not unbroken:
                sweep_tiles(stage, sweep, material, bonds, i0, first, last, start, stop)
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def sum_state(level, node, bits, gradient, numbers):
    """Compute the state and the shape tensor of a node from its present bonds."""
    law, general, distances = gradient.sweep.law, gradient.sweep.general[0], gradient.sweep.offsets
    columns, rows, apart = gradient.columns, gradient.rows, level.size // gradient.columns
    shapes, entries = law.shapes, law.shapes.shape[1]
    numbers[_STATE : _STATE + rows] = 0
    numbers[_SHAPE : _SHAPE + entries] = 0
    for k in range(distances.size):
        if is_set(bits, node, k):
            for column in range(columns):
                at = node + column * apart
                eta = level[at + distances[k]] - level[at]
                for row in range(rows):
                    numbers[_STATE + row] += general[(k * rows + row) * columns + column] * eta
            for i in range(entries):
                numbers[_SHAPE + i] += shapes[k, i]
    if law.thermal_strain.size:
        strain, dim = law.spacing * law.thermal_strain[node], columns
        for i in range(entries):
            if rows > 1:
                numbers[_STATE + i] -= strain * numbers[_SHAPE + i]
            elif i % (dim + 1) == 0:
                numbers[_STATE] -= strain * numbers[_SHAPE + i]


@njit(error_model="numpy", cache=True, counted=False)
def invert_shape(numbers, dim):
    """Invert the shape tensor; the result is zero if it is nearly singular."""
    k, inverse = numbers[_SHAPE:_INVERSE], numbers[_INVERSE:_LAST]
    inverse[:] = 0
    if dim == 2:
        determinant = k[0] * k[3] - k[1] * k[2]
        if determinant > SINGULAR:
            inverse[0], inverse[1] = k[3] / determinant, -k[1] / determinant
            inverse[2], inverse[3] = -k[2] / determinant, k[0] / determinant
        return
    for i in range(3):
        for j in range(3):
            a, b, c, d = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            inverse[3 * i + j] = k[3 * a + c] * k[3 * b + d] - k[3 * a + d] * k[3 * b + c]
    determinant = k[0] * inverse[0] + k[1] * inverse[3] + k[2] * inverse[6]
    for i in range(9):
        inverse[i] = inverse[i] / determinant if determinant > SINGULAR else 0


@njit(error_model="numpy", cache=True, counted=False)
def kept_law(law, node, numbers, rows):
    """Replace the state of a node by the result of the law with its initial shape tensor."""
    state, result, index = numbers[_STATE:_SHAPE], numbers[_SHAPE:_INVERSE], first_special(law.nodes, node)
    special = index < law.nodes.size and law.nodes[index] == node
    matrix = law.matrices[law.numbers[index]] if special else law.intact
    for row in range(rows):
        result[row] = 0
        for column in range(rows):
            factor = matrix[row, column]
            if law.local.size and not special:
                factor = law.bases[0, row, column] * law.local[0, node]
                for i in range(1, 3):
                    factor += law.bases[i, row, column] * law.local[i, node]
            result[row] += factor * state[column]
    for row in range(rows):
        state[row] = result[row]


@njit(error_model="numpy", cache=True, counted=False)
def borne_by_node(law, node, inverse, dim):
    """Fraction of its stress that a node bears as its bonds break, see `engine.shape_tensors.stress_left`."""
    index, initial, unity = first_special(law.nodes, node), law.harmonic_eigenvalue[0], law.intact.dtype.type(1)
    if index < law.nodes.size and law.nodes[index] == node:
        initial = law.harmonic_eigenvalue[law.numbers[index]]
    trace = inverse[0] + inverse[dim + 1]
    if dim == 3:
        trace += inverse[8]
    # infinite for nodes without a gradient, which have no stress, and for nodes that bear all of it
    left = dim / (trace * FACE * initial)
    return left * left if left < 1 else unity


@njit(error_model="numpy", cache=True, counted=False)
def law_of_node(law, node, numbers, rows):
    """Replace the state of a node by the result of the law."""
    if law.kept:
        kept_law(law, node, numbers, rows)
        return
    lame, shear, pull = law.moduli[0], law.moduli[1], law.moduli[2]
    if law.local.size:
        lame, shear, pull = law.local[0, node], law.local[1, node], law.local[2, node]
    state = numbers[_STATE:_SHAPE]
    if rows == 1:
        state[0] *= lame
        return
    dim = 2 if rows == 4 else 3
    invert_shape(numbers, dim)
    inverse, strain = numbers[_INVERSE:_LAST], numbers[_LAST:_NUMBERS]
    left = borne_by_node(law, node, inverse, dim)
    lame, shear = left * lame, left * shear
    trace = inverse[0] * 0
    for a in range(dim):
        for b in range(dim):
            total = trace * 0
            for c in range(dim):
                total += state[a * dim + c] * inverse[c * dim + b]
            strain[a * dim + b] = total
        trace += strain[a * dim + a]
    for a in range(dim):
        for b in range(dim):
            total = lame * trace * inverse[a * dim + b] - pull * strain[a * dim + b]
            for c in range(dim):
                total += shear * (strain[a * dim + c] + strain[c * dim + a]) * inverse[c * dim + b]
            state[a * dim + b] = total


@njit(error_model="numpy", cache=True, counted=False)
def node_energy(stage, node, bits, medium, numbers):
    """Twice the energy of a node with some bonds, from the present displacements and those of the previous step, in
    units of the update.
    """
    u, old, gradient, columns = stage.src, stage.base, medium.gradient, medium.gradient.columns
    sum_state(u, node, bits, gradient, numbers)
    law_of_node(gradient.sweep.law, node, numbers, gradient.rows)
    apart, rows, distances = u.size // columns, medium.divergence.columns, gradient.sweep.offsets
    weights, pulls = medium.divergence.sweep.general[stage.part], medium.springs.general[stage.part]
    thermal_strain, arms = gradient.sweep.law.thermal_strain, gradient.sweep.law.arms
    heated, strain, mean = thermal_strain.size > 0, u[0] * 0, u[0] * 0
    total = 0.0
    for k in range(distances.size):
        if is_set(bits, node, k):
            if heated:
                strain, mean = thermal_strain[node], (thermal_strain[node] + thermal_strain[node + distances[k]]) / 2
            for a in range(columns):
                at = node + a * apart
                force, spring = 0.0, 0.0
                for row in range(rows):
                    force += weights[(k * columns + a) * rows + row] * numbers[_STATE + row]
                if pulls.size:
                    factor = spring_factor(medium.material, node, distances[k]) / 2
                    if medium.bonds.excess.size:
                        factor *= stiffening(medium.bonds, node, k)
                    for b in range(columns):
                        place = node + b * apart
                        gap = u[place + distances[k]] - u[place]
                        if heated:
                            gap -= mean * arms[k, b]
                            spring += factor * pulls[(k * columns + a) * columns + b] * gap
                        force += factor * pulls[(k * columns + a) * columns + b] * gap
                total += force * (old[at + distances[k]] - old[at])
                if heated:
                    total -= ((force - spring) * strain + spring * mean) * arms[k, a]
    return total


@njit(error_model="numpy", cache=True, counted=False)
def weigh_broken(stage, medium, node, numbers, broken):
    """Add the energy that a node loses as bonds break, and mark these bonds as accounted."""
    gone, bonds = False, medium.bonds
    for word in range(bonds.alive.shape[0]):
        gone |= bonds.before[word, node] != bonds.alive[word, node]
    if gone:
        broken[0] += node_energy(stage, node, bonds.before, medium, numbers) / 2
        broken[0] -= node_energy(stage, node, bonds.alive, medium, numbers) / 2
        for word in range(bonds.alive.shape[0]):
            bonds.before[word, node] = bonds.alive[word, node]


@njit(error_model="numpy", cache=True, counted=False)
def push_apart(stage, node, at, bonds, rule):
    """Add to the new displacement of a node the effect of its absent bonds that are shorter than initially."""
    u, components, contact_stiffness = stage.src, stage.components, bonds.contact_stiffness
    apart = u.size // components
    for k in range(bonds.places.shape[0]):
        if is_set(bonds.closing, node, k) and not is_set(bonds.alive, node, k):
            offset, xi = bonds.places[k], bonds.table[k]
            neighbour = node + offset[0]
            e = squared_stretch(u, node, offset[0], xi, components, False)
            e -= thermal_squared_stretch(bonds.thermal_strain, node, neighbour)
            if e < 0 and follows_law(bonds.zone, at[0] + offset[1], at[1] + offset[2], at[2] + offset[3]):
                factor = (
                    bond_factor(rule, contact_stiffness[node], contact_stiffness[neighbour])
                    if contact_stiffness.size > 1
                    else contact_stiffness[0]
                )
                for c in range(components):
                    stage.out[node + c * apart] += factor * xi[components + 1] * bond_stretch(e, False) * xi[c]


@njit(error_model="numpy", cache=True, counted=False)
def node_force(stage, node, medium):
    """Compute the new displacement of a node from its present bonds."""
    u, states, columns = stage.src, medium.gradient.sweep.law.values, medium.gradient.columns
    apart, rows, distances = u.size // columns, medium.divergence.columns, medium.gradient.sweep.offsets
    weights, pulls = medium.divergence.sweep.general[stage.part], medium.springs.general[stage.part]
    for a in range(columns):
        at = node + a * apart
        total = stage.a_difference * u[at] + stage.b * stage.base[at]
        for k in range(distances.size):
            if is_set(medium.bonds.alive, node, k):
                for row in range(rows):
                    place = node + row * apart
                    total += weights[(k * columns + a) * rows + row] * (states[place] + states[place + distances[k]])
                if pulls.size:
                    factor = spring_factor(medium.material, node, distances[k])
                    if medium.bonds.excess.size:
                        factor *= stiffening(medium.bonds, node, k)
                    for b in range(columns):
                        place = node + b * apart
                        total += factor * pulls[(k * columns + a) * columns + b] * (u[place + distances[k]] - u[place])
        stage.out[at] = total


@njit(error_model="numpy", cache=True, counted=False)
def redo_damaged(thread, stage, medium, what):
    """Recompute nodes that lack bonds, in tiles where some have broken or may close: first `STATES`, later `FORCES`;
    `STATES_AGAIN` only in tiles where some have just broken.
    """
    bonds, gradient, block = medium.bonds, medium.gradient, medium.springs.block
    zone, changed, alive = bonds.zone, bonds.changed, bonds.alive
    law, numbers = gradient.sweep.law, gradient.sweep.law.room[thread.number, 0]
    closes, forces = bonds.closing.size > 0, what == FORCES
    high = _ROWS_3 if gradient.columns == 3 else _ROWS_2
    size = law.values.size // gradient.rows
    rows = changed.shape[1]
    # whole rows of tiles, because the losses of a row are added up in one place
    for number in range(thread.number, changed.shape[0] * rows, thread.threads):
        i0, row = number // rows, number % rows
        for tile in range(changed.shape[2]):
            state = changed[i0, row, tile]
            if state == UNCHANGED or (state == CLOSES and not (forces and closes)):
                continue
            if what == STATES_AGAIN and state != JUST_CHANGED:
                continue
            start, losses = zone[FIRST + 2] + tile * LANES, bonds.broken[i0, row]
            for i1 in range(max(row * high, zone[FIRST + 1]), min((row + 1) * high, zone[END + 1])):
                for i2 in range(start, min(start + LANES, zone[END + 2])):
                    node, full = block[0] + i0 * block[4] + i1 * block[5] + i2, True
                    for word in range(alive.shape[0]):
                        full &= alive[word, node] == (bonds.closing[word, node] if closes else bonds.full[word])
                    if full:
                        continue
                    if forces:
                        if state != CLOSES:
                            node_force(stage, node, medium)
                        if closes:
                            push_apart(stage, node, (i0, i1, i2), bonds, medium.material.rule)
                        continue
                    if state == JUST_CHANGED:
                        weigh_broken(stage, medium, node, numbers, losses)
                    sum_state(stage.src, node, alive, gradient, numbers)
                    law_of_node(law, node, numbers, gradient.rows)
                    for c in range(gradient.rows):
                        law.values[c * size + node] = numbers[_STATE + c]
            if not forces:
                changed[i0, row, tile] = CHANGED
    barrier(thread)
