"""Bonds of state-based media that break by the energy lost with them, in the compiled loop.

Let n be what a bond adds to the state of each of its ends, p the results of the law M for their states, B the spring of
the bond and eta the difference of the displacements. With the bond its two ends lose

    n . (p_i + p_j) - n . (M_i + M_j) n / 2 + eta . B eta / 2

as long as their shape tensors stay the same; M is the law of a node with all its bonds. A bond that is longer than
initially breaks if this exceeds the loss in an intact body that is critically strained along the bond
(`farhorizon.medium.force_states.energy_of_bonds`). Both ends compute the same number, to the last bit.

Patches of nodes are skipped if no bond in them can reach this energy: differences of displacements are bounded by those
of neighbouring nodes along each axis, and the results of the law by their largest entries.
"""

from __future__ import annotations

import numpy as np

from farhorizon.engine.bonds import (
    DAMAGED,
    END,
    FIRST,
    JUST_CHANGED,
    LAW_EXTENT,
    LAW_FIRST,
    range_under_law,
    relative_limit,
    spring_factor,
)
from farhorizon.engine.codegen.bond_sweeps import LANES, ROWS
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.threads import barrier

# Patches, and the smaller ones into which those are divided that are not skipped; both consist of whole tiles, and are
# large enough that the nodes around them matter less.
PATCH_PLANES, PATCH_ROWS, PATCH_NODES = 8, 16, 8 * LANES
NEAR_ROWS, NEAR_NODES = 8, 4 * LANES
# Lines of work space, of one number for each node of a row; three of them for eta.
_ELONGATION, _ENERGY, _LIMIT, _LAME, _SHEAR, _PULL, _ETA = range(7)
_TRACE, _WEIGHT, _NEIGHBOUR_WEIGHT = range(_ETA + 3, _ETA + 6)
LINES = 12

_ROWS_2, _ROWS_3 = ROWS[2], ROWS[3]


@njit(error_model="numpy", cache=True, counted=False)
def reached_box(zone, reach, first, end):
    """Box of nodes that bonds from a patch lead to, as far as they follow the law: first indices, and extents."""
    low_0 = max(first[0] - reach[0], zone[LAW_FIRST])
    low_1 = max(first[1] - reach[1], zone[LAW_FIRST + 1])
    low_2 = max(first[2] - reach[2], zone[LAW_FIRST + 2])
    return (
        (low_0, low_1, low_2),
        (
            min(end[0] + reach[0], zone[LAW_FIRST] + zone[LAW_EXTENT]) - low_0,
            min(end[1] + reach[1], zone[LAW_FIRST + 1] + zone[LAW_EXTENT + 1]) - low_1,
            min(end[2] + reach[2], zone[LAW_FIRST + 2] + zone[LAW_EXTENT + 2]) - low_2,
        ),
    )


@njit(error_model="numpy", cache=True, counted=False)
def largest_entry(level, start, step, step_0, step_1, n_0, n_1, n_2, line):
    """Largest magnitude of the values in a box of a level, or, given a nonzero step, of the differences to the values
    that far ahead.
    """
    for i in range(n_2):
        line[i] = 0.0
    for plane in range(n_0):
        for row in range(n_1):
            values = level[start + plane * step_0 + row * step_1 :]
            if step:
                ahead = values[step:]
                for i in range(n_2):
                    line[i] = max(line[i], abs(np.float64(ahead[i]) - np.float64(values[i])))
            else:
                for i in range(n_2):
                    line[i] = max(line[i], abs(np.float64(values[i])))
    top = 0.0
    for i in range(n_2):
        top = max(top, line[i])
    return top


@njit(error_model="numpy", cache=True, counted=False)
def squared_norm(level, dim, block, low, counts, differences, room):
    """Upper bound of the squared norms of all matrices in a box: the product of the largest row sum and the largest
    column sum of the matrix of largest magnitudes. Their columns are `differences` of a vector along the axes, or
    components.
    """
    node = block[0] + low[0] * block[4] + low[1] * block[5] + low[2]
    apart = level.size // (dim if differences else dim * dim)
    line, of_rows, of_columns = room[0], room[1], room[2]
    for a in range(dim):
        of_rows[a] = of_columns[a] = 0.0
    for a in range(dim):
        for b in range(dim):
            step, (n_0, n_1, n_2), entry = 0, counts, a * dim + b
            if differences:
                axis, entry = 3 - dim + b, a
                step = (block[4], block[5], 1)[axis]
                n_0, n_1, n_2 = n_0 - (axis == 0), n_1 - (axis == 1), n_2 - (axis == 2)
            top = largest_entry(level, node + entry * apart, step, block[4], block[5], n_0, n_1, n_2, line)
            of_rows[a] += top
            of_columns[b] += top
    row, column = 0.0, 0.0
    for a in range(dim):
        row, column = max(row, of_rows[a]), max(column, of_columns[a])
    return row * column


@njit(error_model="numpy", cache=True, counted=False)
def fill_lines(law, bonds, node, neighbour, n, lines, alike):
    """Fill the lines for the sums of the moduli of both ends of bonds, and for the weights of their states: those that
    are the same for all bonds if `alike`, the others if not.
    """
    local, weighted = law.local.size > 0, bonds.harmonic_eigenvalue.size > 1
    for modulus in range(3):
        if not local and alike:
            for i in range(n):
                lines[_LAME + modulus, i] = 2 * np.float64(law.moduli[modulus])
        elif local and not alike:
            for i in range(n):
                both = np.float64(law.local[modulus, node + i]) + np.float64(law.local[modulus, neighbour + i])
                lines[_LAME + modulus, i] = both
    if not weighted and alike:
        for i in range(n):
            lines[_WEIGHT, i] = lines[_NEIGHBOUR_WEIGHT, i] = 1.0
    elif weighted and not alike:
        for i in range(n):
            lines[_WEIGHT, i] = bonds.harmonic_eigenvalue[node + i]
            lines[_NEIGHBOUR_WEIGHT, i] = bonds.harmonic_eigenvalue[neighbour + i]


@njit(error_model="numpy", cache=True, counted=False)
def weigh_row(u, part, medium, bond, node, n, lines):
    """Compute, for one bond of each of some nodes of a row, the energy that would be lost with it, its limit, and its
    elongation, in units of the update; lines that are the same for all bonds must have been filled.
    """
    material, gradient, bonds = medium.material, medium.gradient, medium.bonds
    law, columns, rows = gradient.sweep.law, gradient.columns, gradient.rows
    first, last, pulls = gradient.sweep.general[0], medium.divergence.sweep.general[part], medium.springs.general[part]
    xi, heated, distance = bonds.table[bond], bonds.thermal_strain.size > 1, bonds.places[bond, 0]
    apart, size, neighbour = u.size // columns, law.values.size // rows, node + distance
    fill_lines(law, bonds, node, neighbour, n, lines, False)
    longer, trace, energy = lines[_ELONGATION], lines[_TRACE], lines[_ENERGY]
    for i in range(n):
        longer[i] = trace[i] = energy[i] = 0.0
    for a in range(columns):
        eta, near, far = lines[_ETA + a], u[node + a * apart :], u[neighbour + a * apart :]
        along, ahead = np.float64(first[(bond * rows + a) * columns]), np.float64(xi[a])
        for i in range(n):
            eta[i] = np.float64(far[i]) - np.float64(near[i])
        if heated:
            for i in range(n):
                both = np.float64(bonds.thermal_strain[node + i]) + np.float64(bonds.thermal_strain[neighbour + i])
                eta[i] -= both / 2 * ahead
        for i in range(n):
            longer[i] += eta[i] * ahead
            trace[i] += along * eta[i]
    for a in range(columns):
        for b in range(columns):
            eta, across = lines[_ETA + a], lines[_ETA + b]
            g_a, g_b = np.float64(first[(bond * rows + a) * columns]), np.float64(first[(bond * rows + b) * columns])
            weight, row, diagonal = np.float64(last[bond * columns * rows + b]), a * columns + b, 1.0 * (a == b)
            near, far = law.values[row * size + node :], law.values[row * size + neighbour :]
            for i in range(n):
                own_stress = lines[_SHEAR, i] * (g_b * eta[i] + g_a * across[i]) - lines[_PULL, i] * g_b * eta[i]
                own_stress += diagonal * lines[_LAME, i] * trace[i]  # the bond's own part of the stress
                stress = lines[_WEIGHT, i] * np.float64(near[i]) + lines[_NEIGHBOUR_WEIGHT, i] * np.float64(far[i])
                energy[i] += weight * eta[i] * (stress - own_stress / 2)
            pull = np.float64(pulls[(bond * columns + a) * columns + b]) / 2 if pulls.size else 0.0
            if pull != 0 and material.coefficient.size == 1:
                for i in range(n):
                    energy[i] += pull * np.float64(material.coefficient[0]) * eta[i] * across[i]
            elif pull != 0:
                for i in range(n):
                    energy[i] += pull * np.float64(spring_factor(material, node + i, distance)) * eta[i] * across[i]
    released, critical = bonds.released[bond], np.float64(bonds.limit[0]) / 2
    for i in range(n):
        unit = released[0] * lines[_LAME, i] + released[1] * lines[_SHEAR, i] + released[2] * lines[_PULL, i]
        lines[_LIMIT, i] = unit * (critical * relative_limit(bonds, node + i, neighbour + i)) ** 2


@njit(error_model="numpy", cache=True, counted=False)
def may_break(stage, medium, first, end, room):
    """Whether bonds of the nodes of a patch may have the energy at which they break."""
    bonds = medium.bonds
    if bonds.thermal_strain.size > 1:
        return True
    block, states = medium.springs.block, medium.gradient.sweep.law.values
    low, counts = reached_box(bonds.zone, medium.springs.reach, first, end)
    steep = squared_norm(stage.src, stage.components, block, low, counts, True, room)
    stress = np.sqrt(squared_norm(states, stage.components, block, low, counts, False, room))
    return not bonds.bounds[0] * np.sqrt(steep) * stress + bonds.bounds[1] * steep < bonds.limit[0] ** 2 / 4


@njit(error_model="numpy", cache=True, counted=False)
def break_row(stage, medium, i0, i1, begin, end, lines):
    """Break the bonds of some nodes of a row whose energy exceeds the limit."""
    bonds, block = medium.bonds, medium.springs.block
    zone, places, start = bonds.zone, bonds.places, bonds.zone[FIRST + 2]
    row = i1 // (_ROWS_3 if medium.gradient.columns == 3 else _ROWS_2)
    fill_lines(medium.gradient.sweep.law, bonds, 0, 0, end - begin, lines, True)
    for bond in range(places.shape[0]):
        low, top = range_under_law(zone, i0, i1, places[bond], begin, end)
        node = block[0] + i0 * block[4] + i1 * block[5] + low
        word, bit = bond >> 6, np.uint64(1) << np.uint64(bond & 63)
        weigh_row(stage.src, stage.part, medium, bond, node, top - low, lines)
        for i in range(top - low):
            beyond = lines[_ENERGY, i] > lines[_LIMIT, i] and lines[_ELONGATION, i] > 0
            if beyond and bonds.alive[word, node + i] & bit != 0:
                bonds.alive[word, node + i] &= ~bit
                tile = (low + i - start) // LANES
                bonds.kinds[i0, row, tile] = DAMAGED
                bonds.changed[i0, row, tile] = JUST_CHANGED
                bonds.broken[i0, row, 1] += 0.5


@njit(error_model="numpy", cache=True, counted=False)
def break_patch(stage, medium, first, end, room):
    """Break the bonds of a patch whose energy exceeds the limit, searching only those smaller patches that may have
    some.
    """
    for i0 in range(first[0], end[0]):
        for i1 in range(first[1], end[1], NEAR_ROWS):
            for begin in range(first[2], end[2], NEAR_NODES):
                low, top = (i0, i1, begin), (i0 + 1, min(i1 + NEAR_ROWS, end[1]), min(begin + NEAR_NODES, end[2]))
                if may_break(stage, medium, low, top, room):
                    for row in range(i1, top[1]):
                        break_row(stage, medium, i0, row, begin, top[2], room)


@njit(error_model="numpy", cache=True, counted=False)
def break_by_energy(thread, stage, medium):
    """Clear the bits of bonds whose energy exceeds the limit; each thread takes whole rows of patches."""
    zone, room = medium.bonds.zone, medium.bonds.room[thread.number]
    planes = (zone[END] - zone[FIRST] + PATCH_PLANES - 1) // PATCH_PLANES
    rows = (zone[END + 1] + PATCH_ROWS - 1) // PATCH_ROWS - zone[FIRST + 1] // PATCH_ROWS
    for number in range(thread.number, planes * rows, thread.threads):
        plane, row = zone[FIRST] + number // rows * PATCH_PLANES, zone[FIRST + 1] // PATCH_ROWS + number % rows
        for begin in range(zone[FIRST + 2], zone[END + 2], PATCH_NODES):
            first = (plane, max(row * PATCH_ROWS, zone[FIRST + 1]), begin)
            end = (
                min(plane + PATCH_PLANES, zone[END]),
                min((row + 1) * PATCH_ROWS, zone[END + 1]),
                min(begin + PATCH_NODES, zone[END + 2]),
            )
            if may_break(stage, medium, first, end, room):
                break_patch(stage, medium, first, end, room)
    barrier(thread)


@njit(error_model="numpy", cache=True)
def largest_energy(u, medium):
    """Largest energy lost with a bond that may break, relative to its limit; zero if there is no such bond."""
    bonds, block, largest = medium.bonds, medium.springs.block, 0.0
    zone, places, lines = bonds.zone, bonds.places, bonds.room[0]
    fill_lines(medium.gradient.sweep.law, bonds, 0, 0, PATCH_NODES, lines, True)
    for i0 in range(zone[FIRST], zone[END]):
        for i1 in range(zone[FIRST + 1], zone[END + 1]):
            for begin in range(zone[FIRST + 2], zone[END + 2], PATCH_NODES):
                for bond in range(places.shape[0]):
                    end = min(begin + PATCH_NODES, zone[END + 2])
                    low, top = range_under_law(zone, i0, i1, places[bond], begin, end)
                    node = block[0] + i0 * block[4] + i1 * block[5] + low
                    bit = np.uint64(1) << np.uint64(bond & 63)
                    weigh_row(u, 0, medium, bond, node, top - low, lines)
                    for i in range(top - low):
                        present = bonds.alive[bond >> 6, node + i] & bit != 0
                        if present and lines[_ELONGATION, i] > 0 and lines[_LIMIT, i] > 0:
                            largest = max(largest, lines[_ENERGY, i] / lines[_LIMIT, i])
    return largest
