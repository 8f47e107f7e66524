"""Solid and liquid phases: tiles that are all liquid, all solid or mixed, and solid nodes that become liquid.

The coefficient of a node is its phase: 1 in the liquid, minus the factor of interface bonds in the solid
(`bonds.bond_factor`, rule "phases"). A *tile* is a run of `TILE` nodes in each of up to `TILE_ROWS` neighbouring rows;
tiles are small, so that few nodes share one with a front. A tile counts the solid nodes in it and within one reach of
it. If there are none, the plain rows of the stencil serve; if all are solid, nothing changes there; otherwise bonds are
processed one by one. A node that becomes liquid is subtracted from these counts, and so is a node of the halo that
other processes fill: they send its value, and it becomes liquid here by the same rule as there. A step processes
*runs*, neighbouring tiles of one kind in a row of tiles; they are found again in rows whose counts have changed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.bonds import RULES
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.stencil_sweeps import TILE, TILE_ROWS, call_sweep, sweep_phases
from farhorizon.engine.codegen.structs import Struct
from farhorizon.engine.codegen.vector_operations import any_below
from farhorizon.engine.feature import DONE, HALO, Feature, Step
from farhorizon.engine.field import Field
from farhorizon.engine.layout import ints
from farhorizon.engine.passes import Function, reads
from farhorizon.engine.program import ONE, copy
from farhorizon.engine.sweep_program import SHIFTS, ZERO, is_free, rows_of, sweep_rows
from farhorizon.engine.tables import Material, Tables
from farhorizon.engine.threads import ALONE, add, barrier, chunk_of

LIQUID, MIXED, SOLID = 0, 1, 2
#: Step of dissolution of a node that is still solid.
NEVER = np.iinfo(np.int64).max


class Phases(NamedTuple):
    """Tables of the two phases for the compiled loop."""

    #: (rows of tiles, tiles, 2): kind of each run of a row, and the tile after its last
    runs: np.ndarray = ints(0, 0, 2, bits="int32")
    #: (rows of tiles, tiles): number of solid nodes in each tile and within one reach of it
    solids: np.ndarray = ints(0, 0)
    volumes: np.ndarray = ints(0, 0)  # (rows of tiles, tiles): number of all nodes there
    changed: np.ndarray = ints(0, bits="bool")  # rows of tiles whose counts have changed since their runs were found
    dissolved: np.ndarray = ints(0)  # step at which each place became liquid
    total: np.ndarray = ints(2)  # nodes that have become liquid, at present and when the runs were last found
    saturation: float = 0.0  # value below which a solid node dissolves
    period: np.ndarray = ints(3)  # of each axis in nodes; 0 if not periodic, and if other processes fill halos
    #: solid nodes of the halo that other processes fill: places, and coordinates in the box
    halo: np.ndarray = ints(0, 4)


def phases_table(
    solids: np.ndarray,
    volumes: np.ndarray,
    dissolved: np.ndarray,
    saturation: float,
    period: np.ndarray,
    halo: np.ndarray,
) -> Phases:
    """Return the tables for given counts of the tiles; the arrays are not copied."""
    phases = Phases(
        runs=np.zeros((*solids.shape, 2), np.int32),
        solids=solids,
        volumes=volumes,
        changed=np.ones(len(solids), bool),
        dissolved=dissolved,
        total=np.zeros(2, np.int64),
        saturation=float(saturation),
        period=period.astype(np.int64),
        halo=halo.astype(np.int64),
    )
    if len(solids):
        find_runs(ALONE, Struct(phases))
    return phases


def count_solid(solid: np.ndarray, reach: tuple[int, ...], sizes: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Count the solid nodes in each tile and within one reach of it, and all nodes there, shape (rows of tiles, tiles).

    `solid` says which nodes of the core and of its halo are, three axes; `sizes` are the numbers of nodes of a tile
    along each axis, one along the first.
    """
    solids, volumes = solid.astype(np.int64), np.ones(1, np.int64)
    for axis, (m, size) in enumerate(zip(reach, sizes, strict=True)):
        nodes = solid.shape[axis] - 2 * m
        first = np.arange(0, nodes, size)
        last = np.minimum(first + size, nodes) + 2 * m
        total = np.concatenate([np.zeros_like(np.take(solids, [0], axis)), np.cumsum(solids, axis)], axis)
        solids = np.take(total, last, axis) - np.take(total, first, axis)
        volumes = np.multiply.outer(volumes, last - first)
    parts = (
        np.swapaxes(counts, 0, 1).reshape(-1, solids.shape[2]) for counts in (solids, volumes.reshape(solids.shape))
    )
    return next(parts), next(parts)


@njit(error_model="numpy", inline="always")
def phase_of(solid, volume):
    """Kind of a tile from the numbers of solid nodes and of all nodes in it and around it."""
    return LIQUID if solid == 0 else SOLID if solid == volume else MIXED


@njit(error_model="numpy", cache=True)
def find_runs(thread, phases):
    """Find the runs of the rows of tiles that have changed; one thread's chunk."""
    solids, volumes, changed, runs = phases.solids, phases.volumes, phases.changed, phases.runs
    rows, tiles = solids.shape
    first, last = chunk_of(thread, rows)
    for row in range(first, last):
        if not changed[row]:
            continue
        changed[row], run = False, 0
        for tile in range(tiles):
            runs[row, run, 0], runs[row, run, 1] = phase_of(solids[row, tile], volumes[row, tile]), tile + 1
            if tile + 1 < tiles and phase_of(solids[row, tile + 1], volumes[row, tile + 1]) != runs[row, run, 0]:
                run += 1


@njit(error_model="numpy", cache=True, entry=False)
def uncount(at, nodes, reach, phases):
    """Subtract the node at the coordinates `at`, and its periodic images, from the counts of all tiles around it."""
    period, tiles = phases.period, phases.solids.shape[1]
    word = np.int64(phases.solids.ctypes.data)
    for i0 in range(at[0] - period[0], at[0] + period[0] + 1, max(period[0], 1)):
        for i1 in range(at[1] - period[1], at[1] + period[1] + 1, max(period[1], 1)):
            for i2 in range(at[2] - period[2], at[2] + period[2] + 1, max(period[2], 1)):
                if (
                    -reach[0] <= i0 < nodes[0] + reach[0]
                    and -reach[1] <= i1 < nodes[1] + reach[1]
                    and -reach[2] <= i2 < nodes[2] + reach[2]
                ):
                    for t0 in range(max(i0 - reach[0], 0), min(i0 + reach[0], nodes[0] - 1) + 1):
                        for t1 in range(
                            max(i1 - reach[1], 0) // TILE_ROWS, min(i1 + reach[1], nodes[1] - 1) // TILE_ROWS + 1
                        ):
                            phases.changed[t1 * nodes[0] + t0] = True
                            for t2 in range(
                                max(i2 - reach[2], 0) // TILE, min(i2 + reach[2], nodes[2] - 1) // TILE + 1
                            ):
                                add(word + 8 * ((t1 * nodes[0] + t0) * tiles + t2), -1)


@njit(error_model="numpy", cache=True, entry=False)
def dissolve(thread, u, coefficient, sweep, phases, step):
    """Solid nodes of mixed tiles whose value is below the saturation become liquid at this step.

    Threads share the rows of tiles; the runs are not changed meanwhile.
    """
    block, runs = sweep.block, phases.runs
    nodes = (block[1], block[2], block[3])
    limit = u.dtype.type(phases.saturation)
    metal, values = coefficient.ctypes.data, u.ctypes.data
    for number in range(thread.number, runs.shape[0], thread.threads):
        i0, first = number % nodes[0], (number // nodes[0]) * TILE_ROWS
        corner = block[0] + i0 * block[4] + first * block[5]
        run, stop = 0, 0
        while stop < nodes[2]:
            start, stop, phase = stop, min(runs[number, run, 1] * TILE, nodes[2]), runs[number, run, 0]
            run += 1
            place, count = (corner + start) * u.itemsize, min(TILE_ROWS, nodes[1] - first)
            if phase != MIXED or not any_below(metal + place, values + place, limit, stop - start, count, block[5]):
                continue
            for i1 in range(first, first + count):
                row = block[0] + i0 * block[4] + i1 * block[5]
                for i2 in range(start, stop):
                    if coefficient[row + i2] <= 0 and u[row + i2] < limit:
                        coefficient[row + i2] = 1
                        phases.dissolved[row + i2] = step
                        uncount((i0, i1, i2), nodes, sweep.reach, phases)
                        add(np.int64(phases.total.ctypes.data), 1)


@njit(error_model="numpy", cache=True, entry=False)
def dissolve_copies(u, coefficient, sweep, phases):
    """Solid nodes of the halo whose value is below the saturation become liquid, as in the process that owns them."""
    block, halo, limit = sweep.block, phases.halo, u.dtype.type(phases.saturation)
    for i in range(halo.shape[0]):
        place = halo[i, 0]
        if coefficient[place] <= 0 and u[place] < limit:
            coefficient[place] = 1
            uncount((halo[i, 1], halo[i, 2], halo[i, 3]), (block[1], block[2], block[3]), sweep.reach, phases)
            phases.total[0] += 1


@reads("phases", "copies")
def dissolve_nodes(thread, stage, sums, tables, inputs, step, number):
    """Turn solid nodes liquid; where some have changed, find the runs of tiles anew."""
    phases, coefficient = tables.phases, sums.material.coefficient
    dissolve(thread, stage.out, coefficient, sums.sweep, phases, inputs.before[0] + step + 1)
    barrier(thread)
    if phases.total[0] != phases.total[1]:
        find_runs(thread, phases)
        barrier(thread)
        if thread.number == 0:
            phases.total[1] = phases.total[0]
            copy(coefficient, tables.copies, ONE)
        barrier(thread)


@reads("phases")
def dissolve_halo(thread, stage, sums, tables, inputs, step, number):
    """Do the same in the halo, as other processes have just filled it."""
    phases = tables.phases
    if thread.number == 0:
        dissolve_copies(stage.src, sums.material.coefficient, sums.sweep, phases)
    barrier(thread)
    if phases.total[0] != phases.total[1]:
        find_runs(thread, phases)
        barrier(thread)
        if thread.number == 0:
            phases.total[1] = phases.total[0]
        barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def sweep_runs(stage, sums, runs, number):
    """Sweep a part of the box: runs of liquid tiles by the compiled rows, mixed ones bond by bond, solid ones not at
    all.

    Runs are handled by addresses alone: Numba counts the references to an array that it passes on, which takes longer
    than a tile.
    """
    sweep, material, src = sums.sweep, sums.material, stage.src
    block = sweep.block
    i0, first, last = rows_of(sweep, number)
    upper, lower = first, last
    first, last = first // TILE_ROWS, (last + TILE_ROWS - 1) // TILE_ROWS
    metal = False
    for row in range(first, last):
        metal |= runs[row * block[1] + i0, 0, 0] != LIQUID or runs[row * block[1] + i0, 0, 1] * TILE < block[3]
    if not metal:
        sweep_rows(stage, sums, i0, upper, lower, ZERO, block[3])
        return
    size = src.itemsize
    places = src.ctypes.data, material.coefficient.ctypes.data, stage.base.ctypes.data, stage.out.ctypes.data
    bonds, apart = sweep.offsets.size, sweep.offsets.ctypes.data
    between = sweep.general.ctypes.data + stage.part * sweep.general.shape[1] * size
    plain = sweep.weights.ctypes.data + stage.part * sweep.weights.shape[1] * size
    for row in range(first, last):
        at = (block[0] + i0 * block[4] + row * TILE_ROWS * block[5]) * size
        to = (block[9] + i0 * block[10] + row * TILE_ROWS * block[11]) * size
        count = min(TILE_ROWS, block[2] - row * TILE_ROWS)
        run, stop = 0, 0
        while stop < block[3]:
            start, phase = stop, runs[row * block[1] + i0, run, 0]
            stop = min(runs[row * block[1] + i0, run, 1] * TILE, block[3])
            run += 1
            source, result = at + start * size, to + start * size
            if phase == LIQUID and sweep.function != 0:
                call_sweep(
                    sweep.function,
                    (places[0] + source, places[2] + result, places[3] + result),
                    plain,
                    stage.a,
                    stage.b,
                    (stop - start, count),
                    (block[6], block[7], block[8]),
                    (block[5], block[11]),
                    block.ctypes.data + 8 * SHIFTS,
                )
            elif phase != SOLID:
                sweep_phases(
                    (places[0] + source, places[1] + source, places[2] + result, places[3] + result),
                    (apart, between, bonds),
                    (stage.a_difference, stage.b, material.interface, material.ceiling),
                    (stop - start, count),
                    (block[5], block[11]),
                )


@reads("phases")
def phases_part(thread, stage, sums, tables, inputs, step, number):
    """Sweep a part of the box in which there are two phases."""
    sweep_runs(stage, sums, tables.phases.runs, number)


@reads("phases")
def phases_ahead(thread, stage, sums, tables, inputs, step, number):
    """Do the same if it needs no halo."""
    if is_free(sums, number):
        sweep_runs(stage, sums, tables.phases.runs, number)


@reads("phases")
def phases_rest(thread, stage, sums, tables, inputs, step, number):
    """Do the same if it needs the halo."""
    if not is_free(sums, number):
        sweep_runs(stage, sums, tables.phases.runs, number)


def _sweep(tables: Tables) -> tuple[Function, Function, Function] | None:
    return (phases_part, phases_ahead, phases_rest) if tables.phases.runs.size else None


PHASES = Feature(
    "phases",
    [
        Step(HALO, dissolve_halo, lambda tables, _, stage: stage == 0 and len(tables.phases.halo)),
        Step(DONE, dissolve_nodes, lambda tables, *_: tables.phases.runs.size),
    ],
    table=Phases,
    sweep=_sweep,
    nodal=lambda phases: {"dissolved": phases.dissolved},
    more=lambda phases: {name: getattr(phases, name) for name in ("runs", "solids", "volumes", "changed", "total")},
)


def set_phases(
    engine: Field, dissolved: np.ndarray, interface: float, saturation: float, limited: bool = False
) -> None:
    """Set two phases: bonds between solid nodes carry nothing, bonds between the phases `interface` times their weight,
    and a solid node becomes liquid once its value is below `saturation`; if `limited`, no value above it counts for
    more than it between the phases.

    `dissolved` are the steps (of `steps_done`) at which the nodes of the core became liquid, `NEVER` for solid ones.
    Everything beyond the core is liquid, except for periodic sides and halos that other processes fill, which all of
    them do together by calling this.
    """
    solid = dissolved == NEVER
    beyond = {(axis, side): 1.0 for axis in range(3) for side in (-1, 1) if axis not in engine.layout.periodic}
    steps = np.zeros(engine.layout.size, np.int64)
    engine.core.view(steps)[...] = dissolved
    factors = (engine.dtype.type(value) for value in (interface, saturation if limited else np.inf))
    coefficient = engine.spread(np.where(solid, -interface, 1.0), beyond, jointly=True)
    engine.replace(material=Material(coefficient, RULES.index("phases"), *factors))
    engine.sweep_in_pieces(TILE_ROWS)
    solid = engine.layout.box.all(coefficient) < 0
    solids, volumes = count_solid(solid, engine.layout.reach, (1, TILE_ROWS, TILE))
    period = np.array([n if a in engine.layout.periodic else 0 for a, n in enumerate(engine.layout.box.nodes)])
    halo = np.zeros((0, 4), np.int64)
    if engine.exchange is not None:
        filled = engine.exchange.filled
        filled, period = filled[coefficient[filled] < 0], np.zeros(3)
        halo = np.column_stack([filled, engine.layout.box.coordinates(filled)])
    engine.replace(phases=phases_table(solids, volumes, steps, saturation, period, halo))
