"""Bonds that follow a law of their own stretch and break, in a zone of the core, a box of nodes.

A bond whose ends both lie in the zone follows the law and may break; the others are those of the linear stencil. Nodes
of the zone are swept tile by tile, `LANES` nodes of up to `ROWS` rows. Each bond of each node of the core has a bit,
set while the bond is there. A *plain* tile has all its bonds, none of which leaves the zone, and is swept without bits
until one of them is about to break; from then on, as others from the start, it is swept with them. A bond's two ends
find out by themselves, and in the same step, that it breaks, so no thread writes what another reads. Nodes outside the
zone are swept by the plain stencil, their absent bonds taken back one by one as everywhere.

When a bond breaks it had the energy ``1/2 c d(n) d(n-1)``, d its elongation: with velocities half a step late that is
what the linear scheme loses, to rounding. So the level before the present one must outlive the sweep. Of bonds that
soften before they break each end remembers the share of their stiffness that is left, and a share that is lost takes as
much of that energy with it.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from farhorizon.engine.rows.bond_sweeps import LANES, PLACES, ROWS, TileAddresses, TileShape, call_bonds, call_steepness
from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.tables import Material
from farhorizon.engine.threads import barrier

PLAIN, DAMAGED = 0, 1
#: Of a tile of nodes with states: whether bonds have broken, or have just done so, or none has, but some that are cut
#: may close.
UNCHANGED, CHANGED, JUST_CHANGED, CLOSES = 0, 1, 2, 3
#: Entries of the table of the zone, each for the three axes: where bonds follow the law (first node, extent), and its
#: nodes (first, end).
LAW_FIRST, LAW_EXTENT, FIRST, END = 0, 3, 6, 9
#: Rules of `bond_factor`; the last one is that of solid and liquid nodes.
RULES = ("both", "arithmetic", "harmonic", "phases")
PHASES = RULES.index("phases")
#: Rows, and most nodes of a row, of the pieces of the zone that the stencil sweeps where nothing can break: whole
#: tiles, the same for all threads.
PIECE_ROWS, PIECE_NODES = 16, 8 * LANES
#: Sources whose work is added up by one thread at a time, in their order.
CHUNK = 1024

_ROWS_2, _ROWS_3 = ROWS[2], ROWS[3]


class Bonds(NamedTuple):
    """What the compiled loop knows of the bonds.

    Attributes
    ----------
    functions : ndarray of int, shape (3,)
        Addresses of the sweeps of plain tiles and of a damaged one, and of the bound of their stretch.
    table : ndarray, shape (K, components + 2)
        ``xi``, ``1 / |xi|^2`` and c, in units of the update, of each bond; beside states c is that of bonds that
        close.
    places : ndarray of int, shape (K, 4)
        Distance to the neighbour in a level, and its offset.
    alive : ndarray of uint64, shape (words, places of the core)
        Bits.
    kinds : ndarray, shape (planes, rows of tiles, tiles)
        `PLAIN` or `DAMAGED`.
    zone : ndarray of int, shape (12,)
        See `Zone.table`.
    limit : ndarray, shape (2,)
        Of the strain e, and of what `bond_sweeps.steepness` returns: below it no bond breaks.
    nonlinear : bool
    broken : ndarray, shape (planes, rows of tiles, 2)
        Energy, in units of c, and number of the bonds that have broken.
    forces : bool
        Whether the bonds bring forces by the law; else they break only, see `engine.damage`, for which is the rest.
    changed : ndarray, shape of `kinds`
        Whether bonds have broken in a tile, or may close.
    before : ndarray of uint64, shape of `alive`, or empty
        Bits for which the lost energy is known.
    full : ndarray of uint64, shape (words,)
        Bits of a node with all its bonds.
    strength : ndarray
        Of each place of a level the limit of the strain e of its bonds over `limit`, which is the least one: a bond
        breaks as the weaker of its ends does. Of one number where all are alike.
    closing : ndarray of uint64, shape of `alive`, or empty
        Bits of the bonds that carry compression, cut or broken or not.
    hardness : ndarray
        Beside states, of each place of a level the stiffness of bonds that close over that of the medium. Of one number
        where all are alike.
    warmth : ndarray
        Of each place of a level the strain that heat brings: a bond is strained by the mean of its ends. Of one number
        where there is none; see `engine.warmth`.
    shares : ndarray, shape (K, places of the core), or empty
        Of bonds that soften the part of the stiffness that is left, 1 until they are stretched beyond the limit. Those
        that are cut keep it.
    final : ndarray
        Of each place of a level the stretch at which nothing is left of its bonds that soften (`bond_sweeps`): of a
        bond the smaller one of its ends counts. Empty where none softens.
    released : ndarray, shape (K, 3), or empty
        Of bonds that break by the energy which is lost with them what that is at a critical stretch of 1, for a unit of
        each modulus of one end, in units of the update; see `engine.release`. Empty where they break by their stretch.
    bounds : ndarray, shape (2,)
        What the norm of differences along the axes times that of what the law has made of the states, and the square
        of that norm count for, at most, of the energy at a critical stretch of 1.
    firmness : ndarray
        Of each place of a level what its state counts for in that energy, see `shape_tensors.firmness`: no more where a
        node that lacked bonds at first bears its stress with the others. Of one number where no node does.
    room : ndarray, shape (threads, n, nodes)
        For threads that look at the energies of bonds to work in.
    """

    functions: np.ndarray
    table: np.ndarray
    places: np.ndarray
    alive: np.ndarray
    kinds: np.ndarray
    zone: np.ndarray
    limit: np.ndarray
    nonlinear: bool
    broken: np.ndarray
    forces: bool
    changed: np.ndarray
    before: np.ndarray
    full: np.ndarray
    strength: np.ndarray
    closing: np.ndarray
    hardness: np.ndarray
    warmth: np.ndarray
    shares: np.ndarray
    final: np.ndarray
    released: np.ndarray
    bounds: np.ndarray
    firmness: np.ndarray
    room: np.ndarray


def no_bonds(dtype: np.dtype) -> Bonds:
    """None: the stencil serves everywhere."""
    places, bits, kinds = np.zeros((0, PLACES), np.int64), np.zeros((0, 0), np.uint64), np.zeros((0, 0, 0), np.uint8)
    return Bonds(
        np.zeros(3, np.int64),
        np.zeros((0, 1), dtype),
        places,
        bits,
        kinds,
        np.zeros(12, np.int64),
        np.zeros(2, dtype),
        False,
        np.zeros((0, 0, 2)),
        True,
        kinds,
        bits,
        np.zeros(0, np.uint64),
        np.ones(1, dtype),
        bits,
        np.ones(1, dtype),
        np.zeros(1, dtype),
        np.zeros((0, 0), dtype),
        np.zeros(0, dtype),
        np.zeros((0, 3)),
        np.zeros(2),
        np.ones(1, dtype),
        np.zeros((0, 0, 0)),
    )


def all_bits(count: int) -> np.ndarray:
    """Words in which the first `count` bits are set."""
    return np.array([(1 << min(64, count - first)) - 1 for first in range(0, count, 64)], np.uint64)


@dataclass(frozen=True)
class Zone:
    """Where bonds follow the law and break.

    Attributes
    ----------
    first, end : tuple of int
        The box of nodes along the three axes, in nodes of the core.
    open : set of (int, int)
        Sides (axis, -1 or 1) of the box through which bonds follow the law, too: periodic ones, whose halo holds
        copies, and those beyond which another process has the zone.
    """

    first: tuple[int, int, int]
    end: tuple[int, int, int]
    open: Set[tuple[int, int]] = frozenset()

    def moved(self, by: tuple[int, ...]) -> Zone:
        """The same box, counted from other nodes."""
        first, end = (tuple(int(n) + d for n, d in zip(at, by, strict=True)) for at in (self.first, self.end))
        return Zone((first[0], first[1], first[2]), (end[0], end[1], end[2]), self.open)

    def table(self, reach: tuple[int, ...]) -> np.ndarray:
        """One row of four times three numbers."""
        first, end = np.array(self.first), np.array(self.end)
        below, above = (np.array([m if (a, side) in self.open else 0 for a, m in enumerate(reach)]) for side in (-1, 1))
        return np.concatenate([first - below, end - first + below + above, first, end]).astype(np.int64)


@njit(error_model="numpy", inline="always")
def bond_factor(rule, mine, other):
    """Coefficient of a bond from those of its ends: 0 both (min), 1 arithmetic, 2 harmonic, 3 phases.

    Phases: 1 between two liquid nodes, the solid's between it and a liquid one, 0 between two solid ones (see
    `engine.phases`).
    """
    if rule == PHASES:
        return max(mine, other, 0 * mine) * abs(min(mine, other))
    if rule == 0:
        return min(mine, other)
    total = mine + other
    if rule == 1:
        return total / 2
    return 2 * mine * other / total if total > 0 else 0 * total


def factors_of(material: Material, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """Factors of bonds from the coefficients of their ends, given by places in a level: `bond_factor` for arrays."""
    if material.coefficient.size == 1:
        return np.ones(len(nodes))
    mine, other = material.coefficient[nodes].astype(float), material.coefficient[neighbours].astype(float)
    if material.rule == PHASES:
        return np.asarray(np.maximum(np.maximum(mine, other), 0) * np.abs(np.minimum(mine, other)))
    return combined(RULES[material.rule], mine, other)


def combined(rule: str, mine: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Factors of bonds from the coefficients of their ends, by one of the rules but that of phases."""
    if rule == "both":
        return np.asarray(np.minimum(mine, other))
    total = mine + other
    return np.asarray(total / 2 if rule == "arithmetic" else 2 * mine * other / np.where(total > 0, total, 1.0))


@njit(error_model="numpy", inline="always")
def spring_factor(material, node, distance):
    """Factor on the spring of a bond."""
    coefficient = material.coefficient
    if coefficient.size == 1:
        return coefficient[0]
    return bond_factor(material.rule, coefficient[node], coefficient[node + distance])


@njit(error_model="numpy", inline="always")
def bond_gap(rule, mine, other, here, there, ceiling):
    """Difference of the values at the ends of a bond; between two phases none counts for more than the ceiling."""
    if rule == PHASES and mine * other < 0:
        return min(there, ceiling) - min(here, ceiling)
    return there - here


@njit(error_model="numpy", inline="always")
def follows_law(zone, i0, i1, i2):
    """Whether bonds between this node of the core, or of its halo, and the zone follow the law."""
    return (
        0 <= i0 - zone[LAW_FIRST] < zone[LAW_EXTENT]
        and 0 <= i1 - zone[LAW_FIRST + 1] < zone[LAW_EXTENT + 1]
        and 0 <= i2 - zone[LAW_FIRST + 2] < zone[LAW_EXTENT + 2]
    )


@njit(error_model="numpy", inline="always")
def strain_of(level, node, distance, xi, components, nonlinear):
    """``|xi + eta|^2 / |xi|^2 - 1`` of one bond, linearised unless `nonlinear`."""
    apart = level.size // components
    total, length = 0.0, 0.0
    for c in range(components):
        eta = np.float64(level[node + distance + c * apart]) - np.float64(level[node + c * apart])
        total += eta * (2 * xi[c] + (eta if nonlinear else 0.0))
        length += xi[c] * xi[c]
    return total / length


@njit(error_model="numpy", inline="always")
def elongation(e, nonlinear):
    """Stretch of a bond: ``|xi + eta| / |xi| - 1``, linearised e/2."""
    return e / (1 + np.sqrt(1 + e)) if nonlinear else e / 2


@njit(error_model="numpy", inline="always")
def strain_of_heat(warmth, node, other):
    """What heat makes of the strain e of a bond: twice the mean of its ends."""
    return np.float64(warmth[node]) + np.float64(warmth[other]) if warmth.size > 1 else 0.0


@njit(error_model="numpy", inline="always")
def bond_energy(u, old, node, bond, components, nonlinear, material, bonds):
    """``c d d' / 2`` of one bond from its elongations now and a step ago."""
    xi, distance, coefficient = bonds.table[bond], bonds.places[bond, 0], material.coefficient
    length = 0.0
    for c in range(components):
        length += np.float64(xi[c]) ** 2
    warm = strain_of_heat(bonds.warmth, node, node + distance)
    now = elongation(strain_of(u, node, distance, xi, components, nonlinear) - warm, nonlinear)
    before = elongation(strain_of(old, node, distance, xi, components, nonlinear) - warm, nonlinear)
    factor = np.float64(xi[components + 1])
    if coefficient.size > 1:
        factor *= bond_factor(material.rule, coefficient[node], coefficient[node + distance])
    return 0.5 * factor * length * now * before


@njit(error_model="numpy", cache=True, entry=False)
def add_broken(stage, material, bonds, kept, node, step, count, n, broken):
    """Add half the energy, if they bring forces, and half the number, of the bonds that have broken now: those of a
    tile whose bits are `kept` but no longer alive.
    """
    for row in range(count):
        for i in range(n):
            for word in range(bonds.alive.shape[0]):
                gone = kept[word, row, i] & ~bonds.alive[word, node + row * step + i]
                bond = 64 * word
                while gone != 0:
                    if gone & np.uint64(1) != 0:
                        place = node + row * step + i
                        if bonds.forces:
                            broken[0] += 0.5 * bond_energy(
                                stage.src, stage.base, place, bond, stage.components, bonds.nonlinear, material, bonds
                            )
                        broken[1] += 0.5
                    gone >>= np.uint64(1)
                    bond += 1


@njit(error_model="numpy", cache=True, entry=False)
def next_piece(stage, sweep, material, bonds, i0, first, last, begin):
    """Where a piece of the rows `first` to `last` of a plane ends that begins at a node, and whether it is whole: it
    has all its bonds, and none may break, so that the stencil serves, too (for a material that varies it takes longer
    than the bonds one by one)."""
    block, reach, src = sweep.block, sweep.reach, stage.src
    high, start, end = _ROWS_3 if stage.components == 3 else _ROWS_2, bonds.zone[FIRST + 2], bonds.zone[END + 2]
    if bonds.nonlinear or material.coefficient.size > 1 or bonds.warmth.size > 1:
        return end, False
    whole, stop = True, begin
    while stop < min(begin + PIECE_NODES, end):
        plain = True
        for row in range(first // high, (last + high - 1) // high):
            plain &= bonds.kinds[i0, row, (stop - start) // LANES] == PLAIN
        if stop == begin:
            whole = plain
        elif whole != plain:
            break
        stop += LANES
    stop = min(stop, end)
    if not whole:
        return stop, False
    node = block[0] + (i0 - reach[0]) * block[4] + (first - reach[1]) * block[5] + begin - reach[2]
    steep = call_steepness(
        bonds.functions[2],
        src.ctypes.data + node * src.itemsize,
        2 * reach[0] + 1,
        last - first + 2 * reach[1],
        stop - begin + 2 * reach[2],
        block[4],
        block[5],
        src.size // stage.components,
    )
    return stop, steep < bonds.limit[1]


@njit(error_model="numpy", cache=True, entry=False)
def sweep_tiles(stage, sweep, material, bonds, i0, first, last, begin, end):
    """Nodes `begin` to `end` of the rows `first` to `last` of a plane of the zone; they end where tiles end."""
    src, block, alive, kinds, zone = stage.src, sweep.block, bonds.alive, bonds.kinds, bonds.zone
    size, apart, high = src.itemsize, src.size // stage.components, _ROWS_3 if stage.components == 3 else _ROWS_2
    kept = np.empty((alive.shape[0], high, LANES), np.uint64)
    start = zone[FIRST + 2]
    for tile_row in range(first // high, (last + high - 1) // high):
        row = max(tile_row * high, first)
        count = min((tile_row + 1) * high, last) - row
        number, tiles = (begin - start) // LANES, (end - start + LANES - 1) // LANES
        while number < tiles:
            kind, stop = kinds[i0, tile_row, number], number + 1
            while kind == PLAIN and stop < tiles and kinds[i0, tile_row, stop] == PLAIN:
                stop += 1
            i2 = start + number * LANES
            node, n = block[0] + i0 * block[4] + row * block[5] + i2, min(start + stop * LANES, end) - i2
            if kind == DAMAGED:
                for word in range(alive.shape[0]):
                    for j in range(count):
                        for i in range(n):
                            kept[word, j, i] = alive[word, node + j * block[5] + i]
            at = TileAddresses(
                np.int64(src.ctypes.data + node * size),
                np.int64(stage.base.ctypes.data + node * size),
                np.int64(stage.out.ctypes.data + node * size),
                np.int64(material.coefficient.ctypes.data + node * size),
                np.int64(alive.ctypes.data + 8 * node),
                np.int64(bonds.strength.ctypes.data + node * size),
                np.int64(bonds.closing.ctypes.data + 8 * node),
                np.int64(bonds.warmth.ctypes.data + node * size),
                np.int64(bonds.shares.ctypes.data + node * size),
                np.int64(bonds.final.ctypes.data + node * size),
                np.int64(bonds.broken[i0, tile_row].ctypes.data),
                np.int64(bonds.table.ctypes.data),
                np.int64(bonds.places.ctypes.data),
                np.int64(zone.ctypes.data),
            )
            shape = TileShape(bonds.places.shape[0], alive.shape[1], n, count, block[5], apart, i0, row, i2)
            found = call_bonds(bonds.functions[kind], at, shape, stage.a_difference, stage.b, bonds.limit[0])
            if kind == PLAIN:
                number += found
                if number < stop:
                    kinds[i0, tile_row, number] = DAMAGED
            else:
                if found:
                    bonds.changed[i0, tile_row, number] = JUST_CHANGED
                    if not bonds.shares.size:  # what softens is added up as it does
                        broken = bonds.broken[i0, tile_row]
                        add_broken(stage, material, bonds, kept, node, block[5], count, n, broken)
                number += 1


@njit(error_model="numpy", cache=True, entry=False)
def add_work(thread, stage, work, inputs, times):
    """Add the work of sources over one step, ``f . (u(n+1) - u(n-1)) / 2``."""
    nodes, fields = inputs.source_nodes, inputs.source_fields
    for chunk in range(thread.number, (nodes.size + CHUNK - 1) // CHUNK, thread.threads):
        for j in range(fields.shape[0]):
            for i in range(chunk * CHUNK, min(nodes.size, (chunk + 1) * CHUNK)):
                change = np.float64(stage.out[nodes[i]]) - np.float64(stage.base[nodes[i]])
                work[chunk] += 0.5 * times[j] * fields[j, i] * change
    barrier(thread)  # the next sweep writes over the older level


@njit(error_model="numpy", cache=True, counted=False)
def hold_nodes(thread, stage, work, mobility, inputs, values):
    """Give nodes the values that they have after a step. Where work is added up so is that of what holds them, which is
    the force that makes the difference to where they would have gone.
    """
    held, places = inputs.held, stage.out.size // stage.components
    for chunk in range(thread.number, (held.size + CHUNK - 1) // CHUNK, thread.threads):
        for i in range(chunk * CHUNK, min(held.size, (chunk + 1) * CHUNK)):
            node = held[i]
            free = np.float64(stage.out[node])
            stage.out[node] = values[i]
            if work.size:
                now, change = np.float64(stage.out[node]), np.float64(stage.out[node]) - np.float64(stage.base[node])
                mobile = np.float64(mobility[node % places]) if mobility.size else 1.0
                work[chunk] += 0.5 * (now - free) / (stage.scale * mobile) * change
            if stage.increments:
                stage.base[node] = stage.out[node] - stage.src[node]


@njit(error_model="numpy", cache=True, entry=False)
def strains(found, level, node, distance, xi, components, nonlinear):
    """`strain_of` one bond of neighbouring nodes, in vectors."""
    apart = level.size // components
    length = 0.0
    found[:] = 0
    for c in range(components):
        here, there = level[node + c * apart :], level[node + distance + c * apart :]
        twice = 2 * np.float64(xi[c])
        length += np.float64(xi[c]) ** 2
        if nonlinear:
            for i in range(found.size):
                eta = np.float64(there[i]) - np.float64(here[i])
                found[i] += eta * (twice + eta)
        else:
            for i in range(found.size):
                found[i] += (np.float64(there[i]) - np.float64(here[i])) * twice
    for i in range(found.size):
        found[i] /= length
    return length


@njit(error_model="numpy", inline="always")
def curved_part(zone, i0, i1, offset, first, end):
    """Which of the nodes `first` to `end` of a row have a bond that follows the law: from where to where."""
    if not (
        follows_law(zone, i0, i1, zone[LAW_FIRST + 2])
        and follows_law(zone, i0 + offset[1], i1 + offset[2], zone[LAW_FIRST + 2])
    ):
        return first, first
    low, high = zone[LAW_FIRST + 2], zone[LAW_FIRST + 2] + zone[LAW_EXTENT + 2]
    start = min(max(first, low, low - offset[3]), end)
    return start, max(start, min(end, high, high - offset[3]))


@njit(error_model="numpy", cache=True)
def strain_energy(u, old, block, first, end, nodes, whole, components, material, bonds, heated):
    """Energy of all bonds of the nodes `first` to `end` of the core, in units of c; bonds to other nodes count half,
    across sides `whole` fully. If `heated`, heat strains those without a law of their own, too.
    """
    table, places, alive, zone = bonds.table, bonds.places, bonds.alive, bonds.zone
    coefficient, rule = material.coefficient, material.rule
    width = end[2] - first[2]
    now, before, energy = np.empty(width), np.empty(width), np.empty(width)
    total = 0.0
    for i0 in range(first[0], end[0]):
        for i1 in range(first[1], end[1]):
            node = block[0] + i0 * block[4] + i1 * block[5]
            energy[:] = 0
            for bond in range(places.shape[0]):
                offset, xi, bits = places[bond], table[bond], alive[bond >> 6, node + first[2] :]
                outside = (
                    (i0 + offset[1] < first[0] and whole[0, 0])
                    or (i0 + offset[1] >= end[0] and whole[0, 1])
                    or (i1 + offset[2] < first[1] and whole[1, 0])
                    or (i1 + offset[2] >= end[1] and whole[1, 1])
                )
                mask = np.uint64(1) << np.uint64(bond & 63)
                start, stop = curved_part(zone, i0, i1, offset, first[2], end[2])
                for begin, last, law in ((first[2], start, False), (start, stop, True), (stop, end[2], False)):
                    if begin >= last:
                        continue
                    curved, closes = bonds.nonlinear and law, law and bonds.closing.size > 0
                    softens = law and bonds.shares.size > 0
                    part = slice(begin - first[2], last - first[2])
                    length = strains(now[part], u, node + begin, offset[0], xi, components, curved)
                    strains(before[part], old, node + begin, offset[0], xi, components, curved)
                    factor = (0.5 if outside else 0.25) * np.float64(xi[components + 1]) * length
                    one, two, sums, there = now[part], before[part], energy[part], bits[part]
                    for i in range(last - begin if bonds.warmth.size > 1 and (law or heated) else 0):
                        warm = strain_of_heat(bonds.warmth, node + begin + i, node + begin + i + offset[0])
                        one[i] -= warm
                        two[i] -= warm
                    for i in range(last - begin):
                        gain = factor * elongation(one[i], curved) * elongation(two[i], curved)
                        if coefficient.size > 1:
                            gain *= bond_factor(
                                rule, coefficient[node + begin + i], coefficient[node + begin + i + offset[0]]
                            )
                        acts = there[i] & mask != 0
                        left = gain if acts else 0.0
                        if softens and acts:
                            left *= np.float64(bonds.shares[bond, node + begin + i])
                        if closes and (softens or not acts):
                            lasts = bonds.closing[bond >> 6, node + begin + i] & mask != 0
                            left = gain if lasts and one[i] < 0 and two[i] < 0 else left
                        sums[i] += left
                if (whole[2, 0] or whole[2, 1]) and not outside:  # bonds that leave along the row
                    for i2 in range(first[2], end[2]):
                        leaves = (i2 + offset[3] < first[2] and whole[2, 0]) or (
                            i2 + offset[3] >= end[2] and whole[2, 1]
                        )
                        if leaves and bits[i2 - first[2]] & mask != 0:
                            curved = bonds.nonlinear and start <= i2 < stop
                            energy[i2 - first[2]] += 0.5 * bond_energy(
                                u, old, node + i2, bond, components, curved, material, bonds
                            )
            line = 0.0
            for i2 in range(width):
                if nodes[i0 - first[0], i1 - first[1], i2]:
                    line += energy[i2]
            total += line
    return total


@njit(error_model="numpy", inline="always")
def weaker(strength, node, other):
    """Limit of a bond over the least one, from the strengths of its ends."""
    return min(strength[node], strength[other]) if strength.size > 1 else strength[0]


@njit(error_model="numpy", cache=True)
def largest_strain(u, block, components, bonds):
    """Largest e of a bond that may break; where strengths vary, over how much stronger it is than the weakest."""
    table, places, alive, zone, nonlinear = bonds.table, bonds.places, bonds.alive, bonds.zone, bonds.nonlinear
    found = np.empty(max(zone[END + 2] - zone[FIRST + 2], 0))
    largest = -1.0
    for i0 in range(zone[FIRST], zone[END]):
        for i1 in range(zone[FIRST + 1], zone[END + 1]):
            node = block[0] + i0 * block[4] + i1 * block[5]
            for bond in range(places.shape[0]):
                mask = np.uint64(1) << np.uint64(bond & 63)
                start, stop = curved_part(zone, i0, i1, places[bond], zone[FIRST + 2], zone[END + 2])
                if start < stop:
                    strains(found[: stop - start], u, node + start, places[bond, 0], table[bond], components, nonlinear)
                    there = alive[bond >> 6, node + start :]
                    for i in range(stop - start):
                        at, other = node + start + i, node + start + i + places[bond, 0]
                        e = found[i] - strain_of_heat(bonds.warmth, at, other)
                        strength = weaker(bonds.strength, at, other)
                        largest = max(largest, e / strength if there[i] & mask != 0 else -1.0)
    return largest


@njit(error_model="numpy", cache=True)
def steepest(level, nodes, bits, distances, xi, nonlinear, strength):
    """Which of the nodes has the bond that is nearest to its limit, and its e as in `largest_strain`; -1 without
    bonds."""
    components, apart = xi.shape[1], level.size // xi.shape[1]
    worst, largest = -1, -1.0
    for i in range(nodes.size):
        for k in range(distances.size):
            if bits[k >> 6, i] & (np.uint64(1) << np.uint64(k & 63)) != 0:
                total, length = 0.0, 0.0
                for c in range(components):
                    eta = np.float64(level[nodes[i] + distances[k] + c * apart]) - np.float64(
                        level[nodes[i] + c * apart]
                    )
                    total += eta * (2 * xi[k, c] + (eta if nonlinear else 0.0))
                    length += xi[k, c] * xi[k, c]
                length *= weaker(strength, nodes[i], nodes[i] + distances[k])
                if total > largest * length:
                    worst, largest = i, total / length
    return worst, largest
