"""Bonds that have a law of their own stretch and may break, in a zone of the core, which is a box of nodes.

A bond whose ends both lie in the zone follows the law and may break; all others are bonds of the linear stencil. Nodes
of the zone are swept in tiles of `LANES` nodes of up to `ROWS` rows. Each bond of each node of the core has a bit, set
while the bond is present. A *plain* tile has all its bonds, none of which leaves the zone; it is swept without reading
bits until one of its bonds is about to break, and with bits from then on, as all other tiles are from the start. The
two ends of a bond detect independently, in the same step, that it breaks, so no thread writes what another reads. Nodes
outside the zone are swept by the plain stencil, and their absent bonds are corrected one by one as everywhere else.

A bond that breaks had the energy ``1/2 c d(n) d(n-1)``, d being its elongation: with velocities half a step late this
is what the linear scheme loses, to rounding. The level before the present one must therefore outlive the sweep. If
bonds soften before they break, each end stores the remaining fraction of the bond's stiffness, and a lost fraction
takes the same fraction of that energy with it.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from farhorizon.engine.codegen.bond_sweeps import (
    LANES,
    PLACES,
    ROWS,
    TileAddresses,
    TileShape,
    call_bonds,
    call_steepness,
)
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.layout import doubles, ints, reals
from farhorizon.engine.tables import Material

PLAIN, DAMAGED = 0, 1
#: State of a tile in a state-based medium: no bond broken; some broken; some just broken; none broken, but cut ones may
#: close.
UNCHANGED, CHANGED, JUST_CHANGED, CLOSES = 0, 1, 2, 3
#: Entries of the table of the zone, three numbers each: where bonds follow the law (first node, extent), and the nodes
#: of the zone (first, end).
LAW_FIRST, LAW_EXTENT, FIRST, END = 0, 3, 6, 9
#: Rules of `bond_factor`; the last one is for solid and liquid nodes.
RULES = ("both", "arithmetic", "harmonic", "phases")
PHASES = RULES.index("phases")
#: Rows, and largest number of nodes per row, of the pieces of the zone that the stencil sweeps where nothing can break:
#: whole tiles, and the same for any number of threads.
PIECE_ROWS, PIECE_NODES = 16, 8 * LANES
#: Number of sources whose work one thread adds up at a time, in their order; the sums depend on it.
CHUNK = 1024

_ROWS_2, _ROWS_3 = ROWS[2], ROWS[3]


class Bonds(NamedTuple):
    """Tables of the bonds for the compiled loop; without any the stencil serves everywhere. A node has K bonds and as
    many bits, in words of 64; a table of nodes has one value per place, or a single one where all are equal.
    """

    #: addresses of the sweeps of plain tiles and of a damaged tile, and of the bound of the stretch
    functions: np.ndarray = ints(3)
    #: (K, components + 2): xi, 1 / |xi|^2 and c in units of the update; state-based: c of closing bonds
    table: np.ndarray = reals(0, 1)
    places: np.ndarray = ints(0, PLACES)  # (K, 4): distance to the neighbour in a level, and its offset
    alive: np.ndarray = ints(0, 0, bits="uint64")  # (words, places of the core): bits of the bonds that are present
    kinds: np.ndarray = ints(0, 0, 0, bits="uint8")  # (planes, rows of tiles, tiles): `PLAIN` or `DAMAGED`
    zone: np.ndarray = ints(12)  # see `Zone.table`
    limit: np.ndarray = reals(2)  # of the strain e, and of `bond_sweeps.steepness`, below which no bond breaks
    nonlinear: bool = False
    #: (planes, rows of tiles, 2): energy, in units of c, and number of broken bonds
    broken: np.ndarray = doubles(0, 0, 2)
    forces: bool = True  # whether bonds exert forces by the law, or only break (`engine.damage`, for which the rest is)
    #: shape of `kinds`: `UNCHANGED`, `CHANGED`, `JUST_CHANGED` or `CLOSES`
    changed: np.ndarray = ints(0, 0, 0, bits="uint8")
    #: shape of `alive`, or empty: bits of the bonds for which the lost energy has been accounted
    before: np.ndarray = ints(0, 0, bits="uint64")
    full: np.ndarray = ints(0, bits="uint64")  # (words,): bits of a node that has all its bonds
    #: of nodes: limit of e relative to `limit`, the smallest one; the weaker end of a bond counts
    strength: np.ndarray = reals(1, value=1.0)
    #: of nodes, or a single one: relative stiffness, that of a bond being combined from its ends by `rule`. Strengths
    #: are then energies: the limit of the stretch is the root of that of the weaker end over the stiffness of the bond
    stiffness: np.ndarray = reals(1, value=1.0)
    rule: int = 0
    #: shape of `alive`, or empty: bits of bonds that carry compression even if cut or broken
    closing: np.ndarray = ints(0, 0, bits="uint64")
    #: of nodes, state-based media only: relative stiffness of closing bonds
    contact_stiffness: np.ndarray = reals(1, value=1.0)
    thermal_strain: np.ndarray = reals(
        1
    )  # of nodes; a bond has the mean of its ends, see `engine.features.thermal_strain`
    #: (K, places of the core), or empty: remaining fraction of the stiffness of softening bonds, 1 until stretched
    #: beyond the limit; kept by cut bonds
    residual_stiffness: np.ndarray = reals(0, 0)
    #: of nodes, or empty: stretch at which softening bonds have lost all stiffness; the smaller of both ends counts
    final: np.ndarray = reals(0)
    #: (numbers of a history * K, places of the core), or empty: what bonds remember whose law is a function
    history: np.ndarray = reals(0, 0)
    #: of such a law, or empty: 1 while histories rest, else 0, the time step, then its own
    parameters: np.ndarray = doubles(0)
    #: (K, 3), or empty if bonds break by their stretch: energy lost with a bond at a critical stretch of 1, per unit of
    #: each modulus of one end, in units of the update, see `engine.release`
    released: np.ndarray = doubles(0, 3)
    #: coefficients of an upper bound of that energy over the one at a critical stretch of 1: of the norm of differences
    #: along the axes times that of the results of the law, and of the square of the former
    bounds: np.ndarray = doubles(2)
    #: of nodes: weight of the state in that energy (`shape_tensors.harmonic_eigenvalue`), smaller where a node lacked
    #: bonds at first, so that fewer bear its stress
    harmonic_eigenvalue: np.ndarray = reals(1, value=1.0)
    room: np.ndarray = doubles(0, 0, 0)  # (threads, n, nodes): work space for energies of bonds
    #: (M, places), or empty: numbers of nodes from which the factors of springs near surfaces follow, and half the
    #: weights of each of a bond's ends in them, (K, M); see `stiffening`
    excess: np.ndarray = reals(0, 0)
    cosines: np.ndarray = reals(0, 0)


class StateBonds(NamedTuple):
    """What the bonds of a state-based medium are summed and break by: the sweep of their springs, the coefficients of
    these, both passes, and the bonds; tables, or structs of tables.
    """

    springs: Any
    material: Any
    gradient: Any
    divergence: Any
    bonds: Any


def all_bits(count: int) -> np.ndarray:
    """Return words in which the first `count` bits are set."""
    return np.array([(1 << min(64, count - first)) - 1 for first in range(0, count, 64)], np.uint64)


def set_bits(bits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns and the bonds whose bits are set in words, shape (words, n)."""
    columns, numbers = np.flatnonzero(bits.any(0)), np.arange(64, dtype=np.uint64)
    by_number = bits[:, columns].T[..., None] >> numbers & np.uint64(1)
    rows, bonds = np.nonzero(by_number.reshape(len(columns), 64 * len(bits)))
    return columns[rows], bonds


@dataclass(frozen=True)
class Zone:
    """Box of nodes of the core in which bonds follow the law and may break."""

    first: tuple[int, int, int]
    end: tuple[int, int, int]  # the node after the last along each axis
    #: Sides (axis, -1 or 1) across which bonds also follow the law: periodic ones, whose halo holds copies, and those
    #: beyond which the zone continues in another process.
    open: Set[tuple[int, int]] = frozenset()

    def moved(self, by: tuple[int, ...]) -> Zone:
        """Return the same box with `by` added to its node numbers."""
        first, end = (tuple(int(n) + d for n, d in zip(at, by, strict=True)) for at in (self.first, self.end))
        return Zone((first[0], first[1], first[2]), (end[0], end[1], end[2]), self.open)

    def table(self, reach: tuple[int, ...]) -> np.ndarray:
        """Return the entries `LAW_FIRST`, `LAW_EXTENT`, `FIRST` and `END` in a row, three numbers each."""
        first, end = np.array(self.first), np.array(self.end)
        below, above = (np.array([m if (a, side) in self.open else 0 for a, m in enumerate(reach)]) for side in (-1, 1))
        return np.concatenate([first - below, end - first + below + above, first, end]).astype(np.int64)


@njit(error_model="numpy", inline="always")
def bond_factor(rule, near, far):
    """Coefficient of a bond from those of its ends: 0 both (min), 1 arithmetic, 2 harmonic, 3 phases.

    Phases: 1 between two liquid nodes, the solid node's between a solid and a liquid one, 0 between two solid ones (see
    `engine.features.phases`).
    """
    if rule == PHASES:
        return max(near, far, 0 * near) * abs(min(near, far))
    if rule == 0:
        return min(near, far)
    total = near + far
    if rule == 1:
        return total / 2
    return 2 * near * far / total if total > 0 else 0 * total


def factors_of(material: Material, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """Factors of bonds from the coefficients of their ends, given by places in a level: `bond_factor` for arrays."""
    if material.coefficient.size == 1:
        return np.ones(len(nodes))
    near, far = material.coefficient[nodes].astype(float), material.coefficient[neighbours].astype(float)
    if material.rule == PHASES:
        return np.asarray(np.maximum(np.maximum(near, far), 0) * np.abs(np.minimum(near, far)))
    return combined(RULES[material.rule], near, far)


def combined(rule: str, near: np.ndarray, far: np.ndarray) -> np.ndarray:
    """Factors of bonds from the coefficients of their ends, by any rule except that of phases."""
    if rule == "both":
        return np.asarray(np.minimum(near, far))
    total = near + far
    return np.asarray(total / 2 if rule == "arithmetic" else 2 * near * far / np.where(total > 0, total, 1.0))


@njit(error_model="numpy", inline="always")
def spring_factor(material, node, distance):
    """Factor of the spring of a bond."""
    coefficient = material.coefficient
    if coefficient.size == 1:
        return coefficient[0]
    return bond_factor(material.rule, coefficient[node], coefficient[node + distance])


@njit(error_model="numpy", inline="always")
def stiffening(bonds, node, bond):
    """Factor of a spring near a surface: the mean of those of its ends, ``1 + 2 cosines . excess``."""
    factor = 1.0
    for number in range(bonds.excess.shape[0]):
        numbers = bonds.excess[number]
        both = np.float64(numbers[node]) + np.float64(numbers[node + bonds.places[bond, 0]])
        factor += np.float64(bonds.cosines[bond, number]) * both
    return factor


@njit(error_model="numpy", inline="always")
def bond_gap(rule, near, far, value_near, value_far, ceiling):
    """Difference of the values at the ends of a bond; between two phases no value counts for more than the ceiling."""
    if rule == PHASES and near * far < 0:
        return min(value_far, ceiling) - min(value_near, ceiling)
    return value_far - value_near


@njit(error_model="numpy", inline="always")
def is_set(bits, node, bond):
    """Whether the bit of a bond is set."""
    return (bits[bond >> 6, node] >> np.uint64(bond & 63)) & np.uint64(1) != 0


@njit(error_model="numpy", inline="always")
def follows_law(zone, i0, i1, i2):
    """Whether bonds between the zone and this node of the core, or of its halo, follow the law."""
    return (
        0 <= i0 - zone[LAW_FIRST] < zone[LAW_EXTENT]
        and 0 <= i1 - zone[LAW_FIRST + 1] < zone[LAW_EXTENT + 1]
        and 0 <= i2 - zone[LAW_FIRST + 2] < zone[LAW_EXTENT + 2]
    )


@njit(error_model="numpy", inline="always")
def squared_stretch(level, node, distance, xi, components, nonlinear):
    """Strain ``|xi + eta|^2 / |xi|^2 - 1`` of one bond, linearised unless `nonlinear`."""
    apart = level.size // components
    total, length = 0.0, 0.0
    for c in range(components):
        eta = np.float64(level[node + distance + c * apart]) - np.float64(level[node + c * apart])
        total += eta * (2 * xi[c] + (eta if nonlinear else 0.0))
        length += xi[c] * xi[c]
    return total / length


@njit(error_model="numpy", inline="always")
def bond_stretch(e, nonlinear):
    """Stretch of a bond, ``|xi + eta| / |xi| - 1``, from its strain e; linearised e/2."""
    return e / (1 + np.sqrt(1 + e)) if nonlinear else e / 2


@njit(error_model="numpy", inline="always")
def thermal_squared_stretch(thermal_strain, node, neighbour):
    """Thermal part of the strain e of a bond: twice the mean of the thermal strains of its ends."""
    return np.float64(thermal_strain[node]) + np.float64(thermal_strain[neighbour]) if thermal_strain.size > 1 else 0.0


@njit(error_model="numpy", inline="always")
def bond_energy(u, old, node, bond, components, nonlinear, material, bonds):
    """Energy ``c d d' / 2`` of one bond from its present elongation and that of the previous step."""
    xi, distance, coefficient = bonds.table[bond], bonds.places[bond, 0], material.coefficient
    length = 0.0
    for c in range(components):
        length += np.float64(xi[c]) ** 2
    thermal = thermal_squared_stretch(bonds.thermal_strain, node, node + distance)
    now = bond_stretch(squared_stretch(u, node, distance, xi, components, nonlinear) - thermal, nonlinear)
    before = bond_stretch(squared_stretch(old, node, distance, xi, components, nonlinear) - thermal, nonlinear)
    factor = np.float64(xi[components + 1])
    if coefficient.size > 1:
        factor *= bond_factor(material.rule, coefficient[node], coefficient[node + distance])
    if bonds.excess.size:
        factor *= stiffening(bonds, node, bond)
    return 0.5 * factor * length * now * before


@njit(error_model="numpy", cache=True, entry=False)
def add_broken(stage, material, bonds, kept, node, step, count, n, broken):
    """Add half the energy (if bonds exert forces) and half the number of the bonds that have just broken in a tile:
    those whose bits are set in `kept`, but no longer in `alive`.
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
    """Find the end of the piece of the rows `first` to `last` of a plane that begins at a node, and whether the stencil
    may sweep it: it has all its bonds and none can break (in a varying material that would take longer than single
    bonds).
    """
    block, reach, src = sweep.block, sweep.reach, stage.src
    high, start, end = _ROWS_3 if stage.components == 3 else _ROWS_2, bonds.zone[FIRST + 2], bonds.zone[END + 2]
    if bonds.nonlinear or material.coefficient.size > 1 or bonds.thermal_strain.size > 1:
        return end, False
    uniform, stop = True, begin
    while stop < min(begin + PIECE_NODES, end):
        plain = True
        for row in range(first // high, (last + high - 1) // high):
            plain &= bonds.kinds[i0, row, (stop - start) // LANES] == PLAIN
        if stop == begin:
            uniform = plain
        elif uniform != plain:
            break
        stop += LANES
    stop = min(stop, end)
    if not uniform:
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
    """Sweep the nodes `begin` to `end`, an end of tiles, in the rows `first` to `last` of a plane of the zone."""
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
                np.int64(bonds.stiffness.ctypes.data + node * size),
                np.int64(bonds.closing.ctypes.data + 8 * node),
                np.int64(bonds.thermal_strain.ctypes.data + node * size),
                np.int64(bonds.residual_stiffness.ctypes.data + node * size),
                np.int64(bonds.final.ctypes.data + node * size),
                np.int64(bonds.history.ctypes.data + node * size),
                np.int64(bonds.parameters.ctypes.data),
                np.int64(bonds.broken[i0, tile_row].ctypes.data),
                np.int64(bonds.table.ctypes.data),
                np.int64(bonds.places.ctypes.data),
                np.int64(zone.ctypes.data),
                np.int64(bonds.excess.ctypes.data + node * size),
                np.int64(bonds.cosines.ctypes.data),
            )
            shape = TileShape(bonds.places.shape[0], alive.shape[1], n, count, block[5], apart, i0, row, i2)
            result = call_bonds(bonds.functions[kind], at, shape, stage.a_difference, stage.b, bonds.limit[0])
            if kind == PLAIN:
                number += result
                if number < stop:
                    kinds[i0, tile_row, number] = DAMAGED
            else:
                if result:
                    bonds.changed[i0, tile_row, number] = JUST_CHANGED
                    if not bonds.residual_stiffness.size:  # softening bonds add up their losses themselves
                        broken = bonds.broken[i0, tile_row]
                        add_broken(stage, material, bonds, kept, node, block[5], count, n, broken)
                number += 1


@njit(error_model="numpy", cache=True, entry=False)
def squared_stretches(results, level, node, distance, xi, components, nonlinear):
    """Compute `squared_stretch` one bond for neighbouring nodes, in vectors; return the squared length of the bond."""
    apart = level.size // components
    length = 0.0
    results[:] = 0
    for c in range(components):
        near, far = level[node + c * apart :], level[node + distance + c * apart :]
        twice = 2 * np.float64(xi[c])
        length += np.float64(xi[c]) ** 2
        if nonlinear:
            for i in range(results.size):
                eta = np.float64(far[i]) - np.float64(near[i])
                results[i] += eta * (twice + eta)
        else:
            for i in range(results.size):
                results[i] += (np.float64(far[i]) - np.float64(near[i])) * twice
    for i in range(results.size):
        results[i] /= length
    return length


@njit(error_model="numpy", inline="always")
def range_under_law(zone, i0, i1, offset, first, end):
    """Range of the nodes `first` to `end` of a row whose bond with this offset follows the law."""
    if not (
        follows_law(zone, i0, i1, zone[LAW_FIRST + 2])
        and follows_law(zone, i0 + offset[1], i1 + offset[2], zone[LAW_FIRST + 2])
    ):
        return first, first
    low, high = zone[LAW_FIRST + 2], zone[LAW_FIRST + 2] + zone[LAW_EXTENT + 2]
    start = min(max(first, low, low - offset[3]), end)
    return start, max(start, min(end, high, high - offset[3]))


@njit(error_model="numpy", cache=True)
def strain_energy(u, old, block, first, end, nodes, full, components, material, bonds, heated):
    """Energy of all bonds of the nodes `first` to `end` of the core, in units of c; bonds to other nodes count half, or
    fully across sides that are `full`. If `heated`, bonds without a law have thermal strains, too.
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
                    (i0 + offset[1] < first[0] and full[0, 0])
                    or (i0 + offset[1] >= end[0] and full[0, 1])
                    or (i1 + offset[2] < first[1] and full[1, 0])
                    or (i1 + offset[2] >= end[1] and full[1, 1])
                )
                mask = np.uint64(1) << np.uint64(bond & 63)
                start, stop = range_under_law(zone, i0, i1, offset, first[2], end[2])
                for begin, last, law in ((first[2], start, False), (start, stop, True), (stop, end[2], False)):
                    if begin >= last:
                        continue
                    curved, closes = bonds.nonlinear and law, law and bonds.closing.size > 0
                    softens = law and bonds.residual_stiffness.size > 0
                    part = slice(begin - first[2], last - first[2])
                    length = squared_stretches(now[part], u, node + begin, offset[0], xi, components, curved)
                    squared_stretches(before[part], old, node + begin, offset[0], xi, components, curved)
                    factor = (0.5 if outside else 0.25) * np.float64(xi[components + 1]) * length
                    strain, strain_before, sums, words = now[part], before[part], energy[part], bits[part]
                    for i in range(last - begin if bonds.thermal_strain.size > 1 and (law or heated) else 0):
                        thermal = thermal_squared_stretch(
                            bonds.thermal_strain, node + begin + i, node + begin + i + offset[0]
                        )
                        strain[i] -= thermal
                        strain_before[i] -= thermal
                    for i in range(last - begin):
                        gain = factor * bond_stretch(strain[i], curved) * bond_stretch(strain_before[i], curved)
                        if coefficient.size > 1:
                            gain *= bond_factor(
                                rule, coefficient[node + begin + i], coefficient[node + begin + i + offset[0]]
                            )
                        if bonds.excess.size:
                            gain *= stiffening(bonds, node + begin + i, bond)
                        acts = words[i] & mask != 0
                        left = gain if acts else 0.0
                        if softens and acts:
                            left *= np.float64(bonds.residual_stiffness[bond, node + begin + i])
                        if closes and (softens or not acts):
                            may_close = bonds.closing[bond >> 6, node + begin + i] & mask != 0
                            left = gain if may_close and strain[i] < 0 and strain_before[i] < 0 else left
                        sums[i] += left
                if (full[2, 0] or full[2, 1]) and not outside:  # bonds that leave the box along the row
                    for i2 in range(first[2], end[2]):
                        leaves = (i2 + offset[3] < first[2] and full[2, 0]) or (i2 + offset[3] >= end[2] and full[2, 1])
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
def weaker(strength, node, neighbour):
    """Strength of the weaker end of a bond."""
    return min(strength[node], strength[neighbour]) if strength.size > 1 else strength[0]


@njit(error_model="numpy", inline="always")
def relative_limit(bonds, node, neighbour):
    """Limit of e of a bond relative to the smallest one."""
    strength, stiffness = weaker(bonds.strength, node, neighbour), bonds.stiffness
    if stiffness.size == 1:
        return np.float64(strength)
    ratio = np.sqrt(np.float64(strength) / bond_factor(bonds.rule, stiffness[node], stiffness[neighbour]))
    if not bonds.nonlinear:
        return ratio
    stretch = bond_stretch(np.float64(bonds.limit[0]), True) * ratio
    return stretch * (2 + stretch) / np.float64(bonds.limit[0])


@njit(error_model="numpy", cache=True)
def largest_strain(u, block, components, bonds):
    """Largest e of a bond that may break, divided by its relative strength if strengths vary."""
    table, places, alive, zone, nonlinear = bonds.table, bonds.places, bonds.alive, bonds.zone, bonds.nonlinear
    results = np.empty(max(zone[END + 2] - zone[FIRST + 2], 0))
    largest = -1.0
    for i0 in range(zone[FIRST], zone[END]):
        for i1 in range(zone[FIRST + 1], zone[END + 1]):
            node = block[0] + i0 * block[4] + i1 * block[5]
            for bond in range(places.shape[0]):
                mask = np.uint64(1) << np.uint64(bond & 63)
                start, stop = range_under_law(zone, i0, i1, places[bond], zone[FIRST + 2], zone[END + 2])
                if start < stop:
                    distance = places[bond, 0]
                    squared_stretches(
                        results[: stop - start], u, node + start, distance, table[bond], components, nonlinear
                    )
                    words = alive[bond >> 6, node + start :]
                    for i in range(stop - start):
                        at, neighbour = node + start + i, node + start + i + distance
                        e = results[i] - thermal_squared_stretch(bonds.thermal_strain, at, neighbour)
                        strength = relative_limit(bonds, at, neighbour)
                        largest = max(largest, e / strength if words[i] & mask != 0 else -1.0)
    return largest


@njit(error_model="numpy", cache=True)
def steepest(level, nodes, bits, distances, xi, nonlinear, strength):
    """Index of the node with the bond nearest to its limit, and the e of that bond as in `largest_strain`; -1 without
    bonds.
    """
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
