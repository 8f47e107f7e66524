"""Bonds between nodes with states that break by the energy which is lost with them, in the compiled loop.

With n what a bond adds to the state of each of its ends, p what the law M makes of their states, B its spring and eta
the difference of the displacements, the two ends lose

    n . (p_i + p_j) - n . (M_i + M_j) n / 2 + eta . B eta / 2

with it, as long as their shape tensors stay as they are; M is the law of a node with all its bonds. A bond that is
longer than in the beginning breaks where that is more than in an intact body that is strained critically along it
(`farhorizon.medium.force_states.energy_of_bonds`). Both of its ends find the same number, to the last bit.

Patches of nodes are passed over if no bond in them can have so much: a difference of displacements is bounded by those
of neighbouring nodes, and what the law has made of the states by the largest.
"""

from __future__ import annotations

import numpy as np

from farhorizon.engine.bonds import DAMAGED, END, FIRST, JUST_CHANGED, curved_part, spring_factor, weaker
from farhorizon.engine.rows.bond_sweeps import LANES, ROWS, call_steepness
from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.threads import barrier

PATCH_ROWS, PATCH_NODES = 8, 4 * LANES  # whole tiles
_ELONGATION, _ENERGY, _LIMIT, _LAME, _SHEAR, _PULL, _ETA, _TRACE, _MINE, _OTHERS = 0, 1, 2, 3, 4, 5, 6, 9, 10, 11
LINES = 12  # of numbers of the nodes of a row

_ROWS_2, _ROWS_3 = ROWS[2], ROWS[3]


@njit(error_model="numpy", cache=True, counted=False)
def largest_state(law, block, reach, i0, first, last, begin, end, squares):
    """Root of the largest square of what the law has made of the states of the nodes of a patch and of those that their
    bonds lead to.
    """
    rows = law.intact.shape[0]
    size, count, top = law.values.size // rows, end - begin + 2 * reach[2], 0.0
    for plane in range(i0 - reach[0], i0 + reach[0] + 1):
        for row in range(first - reach[1], last + reach[1]):
            start = block[0] + plane * block[4] + row * block[5] + begin - reach[2]
            squares[:count] = 0
            for c in range(rows):
                values = law.values[c * size + start : c * size + start + count]
                for i in range(count):
                    squares[i] += np.float64(values[i]) * np.float64(values[i])
            for i in range(count):
                top = max(top, squares[i])
    return np.sqrt(top)


@njit(error_model="numpy", cache=True, counted=False)
def weigh_row(u, part, springs, material, gather, scatter, bonds, bond, node, n, lines):
    """What would be lost with one bond of each of some nodes of a row, at how much it may be, and how much longer the
    bonds have become; in units of the update.
    """
    law, columns, rows = gather.sweep.law, gather.columns, gather.rows
    apart, size, distance = u.size // columns, law.values.size // rows, bonds.places[bond, 0]
    first, last = gather.sweep.general[0], scatter.sweep.general[part]
    pulls, xi, other = springs.general[part], bonds.table[bond], node + distance
    warm, local = bonds.warmth.size > 1, law.local.size > 0
    for modulus in range(3):
        line = lines[_LAME + modulus]
        if local:
            for i in range(n):
                line[i] = np.float64(law.local[modulus, node + i]) + np.float64(law.local[modulus, other + i])
        else:
            line[:n] = 2 * law.moduli[modulus]
    for i in range(n):
        lines[_MINE, i] = bonds.firmness[node + i if bonds.firmness.size > 1 else 0]
        lines[_OTHERS, i] = bonds.firmness[other + i if bonds.firmness.size > 1 else 0]
    lines[_ELONGATION, :n] = 0
    lines[_ENERGY, :n] = 0
    lines[_TRACE, :n] = 0
    for a in range(columns):
        eta, here, there = lines[_ETA + a], u[node + a * apart :], u[other + a * apart :]
        for i in range(n):
            eta[i] = np.float64(there[i]) - np.float64(here[i])
        if warm:
            for i in range(n):
                eta[i] -= (np.float64(bonds.warmth[node + i]) + np.float64(bonds.warmth[other + i])) / 2 * xi[a]
        along = np.float64(first[(bond * rows + a) * columns])
        for i in range(n):
            lines[_ELONGATION, i] += eta[i] * xi[a]
            lines[_TRACE, i] += along * eta[i]
    for a in range(columns):
        for b in range(columns):
            eta, across = lines[_ETA + a], lines[_ETA + b]
            g_a, g_b = np.float64(first[(bond * rows + a) * columns]), np.float64(first[(bond * rows + b) * columns])
            weight, row, same = np.float64(last[bond * columns * rows + b]), a * columns + b, 1.0 * (a == b)
            here, there = law.values[row * size + node :], law.values[row * size + other :]
            pull = np.float64(pulls[(bond * columns + a) * columns + b]) / 2 if pulls.size else 0.0
            for i in range(n):
                own = lines[_SHEAR, i] * (g_b * eta[i] + g_a * across[i]) - lines[_PULL, i] * g_b * eta[i]
                own += same * lines[_LAME, i] * lines[_TRACE, i]
                stress = lines[_MINE, i] * here[i] + lines[_OTHERS, i] * there[i]
                lines[_ENERGY, i] += weight * eta[i] * (stress - own / 2)
            if pull != 0:
                for i in range(n):
                    factor = np.float64(spring_factor(material, node + i, distance))
                    lines[_ENERGY, i] += factor * pull * eta[i] * across[i]
    released, critical = bonds.released[bond], np.float64(bonds.limit[0]) / 2
    for i in range(n):
        unit = released[0] * lines[_LAME, i] + released[1] * lines[_SHEAR, i] + released[2] * lines[_PULL, i]
        lines[_LIMIT, i] = unit * (critical * np.float64(weaker(bonds.strength, node + i, other + i))) ** 2


@njit(error_model="numpy", cache=True, counted=False)
def may_break(stage, springs, gather, bonds, i0, first, last, begin, end, squares):
    """Whether bonds of the nodes of a patch may have the energy at which they break."""
    if bonds.warmth.size > 1:
        return True
    block, reach, src, components = springs.block, springs.reach, stage.src, stage.components
    node = block[0] + (i0 - reach[0]) * block[4] + (first - reach[1]) * block[5] + begin - reach[2]
    steep = call_steepness(
        bonds.functions[2],
        src.ctypes.data + node * src.itemsize,
        2 * reach[0] + 1,
        last - first + 2 * reach[1],
        end - begin + 2 * reach[2],
        block[4],
        block[5],
        src.size // components,
    )
    stress = largest_state(gather.sweep.law, block, reach, i0, first, last, begin, end, squares)
    return not bonds.bounds[0] * np.sqrt(steep) * stress + bonds.bounds[1] * steep < bonds.limit[0] ** 2 / 4


@njit(error_model="numpy", cache=True, counted=False)
def break_patch(stage, springs, material, gather, scatter, bonds, i0, first, last, begin, end, lines):
    """Break the bonds of the nodes of a patch that have the energy."""
    zone, block, places = bonds.zone, springs.block, bonds.places
    high, start = _ROWS_3 if gather.columns == 3 else _ROWS_2, zone[FIRST + 2]
    for i1 in range(first, last):
        for bond in range(places.shape[0]):
            low, top = curved_part(zone, i0, i1, places[bond], begin, end)
            node = block[0] + i0 * block[4] + i1 * block[5] + low
            word, bit = bond >> 6, np.uint64(1) << np.uint64(bond & 63)
            weigh_row(stage.src, stage.part, springs, material, gather, scatter, bonds, bond, node, top - low, lines)
            for i in range(top - low):
                beyond = lines[_ENERGY, i] > lines[_LIMIT, i] and lines[_ELONGATION, i] > 0
                if beyond and bonds.alive[word, node + i] & bit != 0:
                    bonds.alive[word, node + i] &= ~bit
                    row, tile = i1 // high, (low + i - start) // LANES
                    bonds.kinds[i0, row, tile] = DAMAGED
                    bonds.changed[i0, row, tile] = JUST_CHANGED
                    bonds.broken[i0, row, 1] += 0.5


@njit(error_model="numpy", cache=True, counted=False)
def break_by_energy(thread, stage, springs, material, gather, scatter, bonds):
    """Clear the bits of bonds that have the energy; threads have whole rows of patches."""
    zone, room = bonds.zone, bonds.room[thread.number]
    patches = (zone[END + 1] + PATCH_ROWS - 1) // PATCH_ROWS - zone[FIRST + 1] // PATCH_ROWS
    for number in range(thread.number, (zone[END] - zone[FIRST]) * patches, thread.threads):
        i0, patch = zone[FIRST] + number // patches, zone[FIRST + 1] // PATCH_ROWS + number % patches
        first, last = max(patch * PATCH_ROWS, zone[FIRST + 1]), min((patch + 1) * PATCH_ROWS, zone[END + 1])
        for begin in range(zone[FIRST + 2], zone[END + 2], PATCH_NODES):
            end = min(begin + PATCH_NODES, zone[END + 2])
            if may_break(stage, springs, gather, bonds, i0, first, last, begin, end, room[0]):
                break_patch(stage, springs, material, gather, scatter, bonds, i0, first, last, begin, end, room)
    barrier(thread)


@njit(error_model="numpy", cache=True)
def largest_energy(u, springs, material, gather, scatter, bonds):
    """Largest energy that is lost with a bond which may break, over that at which it does; zero if there is none."""
    zone, block, places, lines, largest = bonds.zone, springs.block, bonds.places, bonds.room[0], 0.0
    for i0 in range(zone[FIRST], zone[END]):
        for i1 in range(zone[FIRST + 1], zone[END + 1]):
            for begin in range(zone[FIRST + 2], zone[END + 2], PATCH_NODES):
                for bond in range(places.shape[0]):
                    end = min(begin + PATCH_NODES, zone[END + 2])
                    low, top = curved_part(zone, i0, i1, places[bond], begin, end)
                    node = block[0] + i0 * block[4] + i1 * block[5] + low
                    bit = np.uint64(1) << np.uint64(bond & 63)
                    weigh_row(u, 0, springs, material, gather, scatter, bonds, bond, node, top - low, lines)
                    for i in range(top - low):
                        there = bonds.alive[bond >> 6, node + i] & bit != 0
                        if there and lines[_ELONGATION, i] > 0 and lines[_LIMIT, i] > 0:
                            largest = max(largest, lines[_ENERGY, i] / lines[_LIMIT, i])
    return largest
