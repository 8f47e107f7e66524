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
    elongation,
    follows_law,
    is_set,
    next_piece,
    spring_factor,
    strain_of,
    strain_of_heat,
    sweep_tiles,
)
from farhorizon.engine.point_law import first_special
from farhorizon.engine.rows.bond_sweeps import LANES, ROWS
from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.shape_tensors import FACE, SINGULAR
from farhorizon.engine.threads import barrier

#: What is recomputed for nodes that lack bonds.
STATES, FORCES, STATES_AGAIN = range(3)
_STATE, _SHAPE, _INVERSE, _LAST, _NUMBERS = 0, 9, 18, 27, 36  # offsets in a thread's work space

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
            stop, whole = next_piece(stage, sweep, material, bonds, i0, first, last, start)
            if not whole:
                sweep_tiles(stage, sweep, material, bonds, i0, first, last, start, stop)
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def sum_state(level, node, bits, gradient_pass, numbers):
    """Compute the state and the shape tensor of a node from its present bonds."""
    law, general, distances = gradient_pass.sweep.law, gradient_pass.sweep.general[0], gradient_pass.sweep.offsets
    columns, rows, apart = gradient_pass.columns, gradient_pass.rows, level.size // gradient_pass.columns
    shapes, whole = law.shapes, law.shapes.shape[1]
    numbers[_STATE : _STATE + rows] = 0
    numbers[_SHAPE : _SHAPE + whole] = 0
    for k in range(distances.size):
        if is_set(bits, node, k):
            for column in range(columns):
                at = node + column * apart
                eta = level[at + distances[k]] - level[at]
                for row in range(rows):
                    numbers[_STATE + row] += general[(k * rows + row) * columns + column] * eta
            for i in range(whole):
                numbers[_SHAPE + i] += shapes[k, i]
    if law.thermal_strain.size:
        strain, dim = law.spacing * law.thermal_strain[node], columns
        for i in range(whole):
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
    state, made, odd = numbers[_STATE:_SHAPE], numbers[_SHAPE:_INVERSE], first_special(law.nodes, node)
    special = odd < law.nodes.size and law.nodes[odd] == node
    matrix = law.matrices[law.numbers[odd]] if special else law.intact
    for row in range(rows):
        made[row] = 0
        for column in range(rows):
            factor = matrix[row, column]
            if law.local.size and not special:
                factor = law.bases[0, row, column] * law.local[0, node]
                for i in range(1, 3):
                    factor += law.bases[i, row, column] * law.local[i, node]
            made[row] += factor * state[column]
    for row in range(rows):
        state[row] = made[row]


@njit(error_model="numpy", cache=True, counted=False)
def borne_by_node(law, node, inverse, dim):
    """Share of its stress that a node bears as its bonds break, see `farhorizon.engine.shape_tensors.stress_left`."""
    odd, first, whole = first_special(law.nodes, node), law.harmonic_eigenvalue[0], law.intact.dtype.type(1)
    if odd < law.nodes.size and law.nodes[odd] == node:
        first = law.harmonic_eigenvalue[law.numbers[odd]]
    trace = inverse[0] + inverse[dim + 1]
    if dim == 3:
        trace += inverse[8]
    # infinite for nodes without a gradient, which have no stress, and for nodes that bear all of it
    left = dim / (trace * FACE * first)
    return left * left if left < 1 else whole


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
def node_energy(stage, node, bits, bond_stencil, material, gradient_pass, divergence_pass, numbers):
    """Twice the energy of a node with some bonds, from the present displacements and those of the previous step, in
    units of the update.
    """
    u, old, columns = stage.src, stage.base, gradient_pass.columns
    sum_state(u, node, bits, gradient_pass, numbers)
    law_of_node(gradient_pass.sweep.law, node, numbers, gradient_pass.rows)
    apart, rows, distances = u.size // columns, divergence_pass.columns, gradient_pass.sweep.offsets
    weights, pulls = divergence_pass.sweep.general[stage.part], bond_stencil.general[stage.part]
    thermal_strain, arms = gradient_pass.sweep.law.thermal_strain, gradient_pass.sweep.law.arms
    warm, own, mean = thermal_strain.size > 0, u[0] * 0, u[0] * 0
    total = 0.0
    for k in range(distances.size):
        if is_set(bits, node, k):
            if warm:
                own, mean = thermal_strain[node], (thermal_strain[node] + thermal_strain[node + distances[k]]) / 2
            for a in range(columns):
                at = node + a * apart
                force, spring = 0.0, 0.0
                for row in range(rows):
                    force += weights[(k * columns + a) * rows + row] * numbers[_STATE + row]
                if pulls.size:
                    factor = spring_factor(material, node, distances[k]) / 2
                    for b in range(columns):
                        here = node + b * apart
                        gap = u[here + distances[k]] - u[here]
                        if warm:
                            gap -= mean * arms[k, b]
                            spring += factor * pulls[(k * columns + a) * columns + b] * gap
                        force += factor * pulls[(k * columns + a) * columns + b] * gap
                total += force * (old[at + distances[k]] - old[at])
                if warm:
                    total -= ((force - spring) * own + spring * mean) * arms[k, a]
    return total


@njit(error_model="numpy", cache=True, counted=False)
def weigh_broken(stage, bonds, bond_stencil, material, gradient_pass, divergence_pass, node, numbers, broken):
    """Add the energy that a node loses as bonds break, and mark these bonds as accounted."""
    gone = False
    for word in range(bonds.alive.shape[0]):
        gone |= bonds.before[word, node] != bonds.alive[word, node]
    if gone:
        broken[0] += (
            node_energy(stage, node, bonds.before, bond_stencil, material, gradient_pass, divergence_pass, numbers) / 2
        )
        broken[0] -= (
            node_energy(stage, node, bonds.alive, bond_stencil, material, gradient_pass, divergence_pass, numbers) / 2
        )
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
            other = node + offset[0]
            e = strain_of(u, node, offset[0], xi, components, False) - strain_of_heat(bonds.thermal_strain, node, other)
            if e < 0 and follows_law(bonds.zone, at[0] + offset[1], at[1] + offset[2], at[2] + offset[3]):
                factor = (
                    bond_factor(rule, contact_stiffness[node], contact_stiffness[other])
                    if contact_stiffness.size > 1
                    else contact_stiffness[0]
                )
                for c in range(components):
                    stage.out[node + c * apart] += factor * xi[components + 1] * elongation(e, False) * xi[c]


@njit(error_model="numpy", cache=True, counted=False)
def node_force(stage, node, bonds, bond_stencil, material, gradient_pass, divergence_pass):
    """Compute the new displacement of a node from its present bonds."""
    u, states, columns = stage.src, gradient_pass.sweep.law.values, gradient_pass.columns
    apart, rows, distances = u.size // columns, divergence_pass.columns, gradient_pass.sweep.offsets
    weights, pulls = divergence_pass.sweep.general[stage.part], bond_stencil.general[stage.part]
    for a in range(columns):
        at = node + a * apart
        total = stage.a_difference * u[at] + stage.b * stage.base[at]
        for k in range(distances.size):
            if is_set(bonds.alive, node, k):
                for row in range(rows):
                    here = node + row * apart
                    total += weights[(k * columns + a) * rows + row] * (states[here] + states[here + distances[k]])
                if pulls.size:
                    factor = spring_factor(material, node, distances[k])
                    for b in range(columns):
                        here = node + b * apart
                        total += factor * pulls[(k * columns + a) * columns + b] * (u[here + distances[k]] - u[here])
        stage.out[at] = total


@njit(error_model="numpy", cache=True, counted=False)
def redo_damaged(thread, stage, bond_stencil, material, gradient_pass, divergence_pass, bonds, what):
    """Recompute nodes that lack bonds, in tiles where some have broken or may close: first `STATES`, later `FORCES`;
    `STATES_AGAIN` only in tiles where some have just broken.
    """
    zone, block, changed, alive = bonds.zone, bond_stencil.block, bonds.changed, bonds.alive
    law, numbers = gradient_pass.sweep.law, gradient_pass.sweep.law.room[thread.number, 0]
    closes, forces = bonds.closing.size > 0, what == FORCES
    high = _ROWS_3 if gradient_pass.columns == 3 else _ROWS_2
    size = law.values.size // gradient_pass.rows
    rows = changed.shape[1]
    # whole rows of tiles, because the losses of a row are added up in one place
    for number in range(thread.number, changed.shape[0] * rows, thread.threads):
        i0, row = number // rows, number % rows
        for tile in range(changed.shape[2]):
            kind = changed[i0, row, tile]
            if kind == UNCHANGED or (kind == CLOSES and not (forces and closes)):
                continue
            if what == STATES_AGAIN and kind != JUST_CHANGED:
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
                        if kind != CLOSES:
                            node_force(stage, node, bonds, bond_stencil, material, gradient_pass, divergence_pass)
                        if closes:
                            push_apart(stage, node, (i0, i1, i2), bonds, material.rule)
                        continue
                    if kind == JUST_CHANGED:
                        weigh_broken(
                            stage, bonds, bond_stencil, material, gradient_pass, divergence_pass, node, numbers, losses
                        )
                    sum_state(stage.src, node, alive, gradient_pass, numbers)
                    law_of_node(law, node, numbers, gradient_pass.rows)
                    for c in range(gradient_pass.rows):
                        law.values[c * size + node] = numbers[_STATE + c]
            if not forces:
                changed[i0, row, tile] = CHANGED
    barrier(thread)
