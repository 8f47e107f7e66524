"""Settings of an existing engine: each function replaces tables of a plain medium."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from farhorizon.engine.bonds import RULES, all_bits
from farhorizon.engine.codegen.build import load_program
from farhorizon.engine.codegen.stencil_sweeps import TILE, TILE_ROWS
from farhorizon.engine.dissipation import Dissipation
from farhorizon.engine.drag import Drag
from farhorizon.engine.engine import NEVER, Engine
from farhorizon.engine.exchange import Exchange, Link, Messages, free_of_halos
from farhorizon.engine.field import damping_of, numbers_of
from farhorizon.engine.filter import filter_with_images, margin_across, without
from farhorizon.engine.layers import Layers
from farhorizon.engine.layout import aligned_zeros
from farhorizon.engine.media import media_of
from farhorizon.engine.phases import count_solid, phases_table
from farhorizon.engine.relaxations import Relaxations, relaxation_factors
from farhorizon.engine.tables import Damping, Dependents, Flows, Material
from farhorizon.engine.thermal_strain import ThermalStrains

_NO_ENDS = np.zeros((0, 0), np.int64)


def connect(engine: Engine, link: Link, neighbours: Mapping[tuple[int, int], int]) -> None:
    """Let other processes fill the halos from now on, periodic ones included. `neighbours` are the ranks of the
    processes beyond each side, negative for none; axes that are not shared are left out.
    """
    passes = [] if engine.passes is None else [engine.tables.gradient_pass, engine.tables.divergence_pass]
    kinds = [Messages.between(link, neighbours, {side: engine.layout.across(*side) for side in neighbours})]
    for tables in engine.layers_of_passes:
        slots = {} if tables is None else {side: tables.across(*side) for side in neighbours}
        kinds.append(Messages.between(link, {side: neighbours[side] for side in slots}, slots))
    used = engine.tables.filter.runs.size
    filtered = {side: rank for side, rank in neighbours.items() if side[0] not in engine.layout.periodic and used}
    damping = damping_of(engine)
    margins = {side: margin_across(engine.layout, *damping, *side) for side in filtered}
    kinds.append(Messages.between(link, filtered, margins))
    states = max((tables.columns for tables in passes), default=0)
    rows = max((tables.rows for tables in passes), default=0)
    engine.exchange = Exchange(kinds, max(engine.components, states, rows), engine.dtype)
    if engine.varied:
        engine.join(engine.tables.material.coefficient, {})
        engine.replace(media=media_of(engine))
    further = {name: getattr(engine.tables, name) for name in ("gradient_pass", "divergence_pass", "neighbours")}
    engine.replace(
        exchange=engine.exchange.numbers[:-1],
        free=free_of_halos(engine.layout, neighbours),
        filter=engine.tables.filter._replace(exchange=engine.exchange.numbers[-1]),
        layers=_alone(engine.tables.layers),
        copies=engine.tables.copies[:, :0],
        **{name: sums._replace(layers=_alone(sums.layers)) for name, sums in further.items()},
    )


def _alone(layers: Layers) -> Layers:
    """Return layers whose slots are filled by other processes."""
    return layers._replace(copies=layers.copies[:, :0])


def set_damping(engine: Engine, nodes: np.ndarray, before: np.ndarray, after: np.ndarray, leak: np.ndarray) -> None:
    """Set the nodal factors of an absorbing zone: for the old increment, for the new increment, and a loss rate. Nodes
    that lose all of their new increment stay where they are.
    """
    if nodes.size:
        engine.replace(filter=without(engine.tables.filter, lambda damped: np.isin(damped, nodes[after == 0])))
    factors = (factor.astype(engine.dtype) for factor in (before, after, leak))
    engine.replace(damping=Damping(nodes.astype(np.int64), *factors))


def set_images(engine: Engine, images: Mapping[tuple[int, int], int]) -> None:
    """Let the filter of short waves see walls, given by the signs of their images, mirrored beyond them."""
    engine.replace(filter=filter_with_images(engine.tables.filter, engine.layout, images))


def damp_increments(engine: Engine, factor: float) -> None:
    """Multiply the previous increment of velocity Verlet by a factor in each step from now on, of an engine made
    without damping whose older level outlives a step.
    """
    _, _, scale, source_scale = engine.stages.numbers[0]
    numbers = [numbers_of(engine, 1 + factor, -factor, scale, source_scale)]
    engine.replace(numbers=np.array(numbers).astype(engine.dtype))


def set_thermal_strain(engine: Engine, spacing: float) -> None:
    """Let nodes, a spacing apart in the unit of the field, have thermal strains from now on, whose values
    `give_thermal_strain` sets; requires `BondZone.set` with `warm`.
    """
    tables, thermal_strain = engine.tables, engine.tables.bonds.thermal_strain
    arms = spacing * engine.offsets[:, 3 - engine.components :].astype(float)
    if engine.passes is not None:
        gradient_pass = tables.gradient_pass
        law = gradient_pass.sweep.law._replace(
            thermal_strain=thermal_strain, spacing=engine.dtype.type(spacing), arms=arms.astype(engine.dtype)
        )
        engine.replace(gradient_pass=gradient_pass._replace(sweep=gradient_pass.sweep._replace(law=law)))
    springs = engine.passes is not None and engine.weights.any() and not engine.heat_passes
    vectors = np.einsum("kab,kb->ka", engine.weights, arms) if springs else np.zeros((0, 0))
    heat = ThermalStrains(
        thermal_strain=thermal_strain,
        rate=np.zeros_like(thermal_strain),
        vectors=vectors.astype(engine.dtype),
        beyond=engine.heat_vectors.astype(engine.dtype),
        traces=aligned_zeros(engine.layout.size if engine.heat_passes else 0, engine.dtype),
    )
    engine.replace(heat=heat)


def give_thermal_strain(engine: Engine, strain: np.ndarray, rate: np.ndarray, steps: int = 0) -> None:
    """Set the thermal strains of the nodes of the core as of some steps ago, and their change per step; all processes
    that exchange halos call this together.
    """
    heat = engine.tables.heat
    heat.thermal_strain[:] = engine.spread(strain, jointly=True) * engine.absent.exists
    heat.rate[:] = engine.spread(rate, jointly=True) * engine.absent.exists
    for _ in range(steps):
        heat.thermal_strain[:] += heat.rate


def give_thermal_strain_beyond(engine: Engine, places: np.ndarray, strains: np.ndarray) -> None:
    """Set the thermal strains of nodes in the layers and in front of them, by their places in a level, after
    `give_thermal_strain`; they stay until the next call. Beyond the outer ends of the layers they are zero.
    """
    thermal_strain, nodes = engine.tables.heat.thermal_strain, engine.layout.box.node_indices()
    thermal_strain[places] = strains * engine.absent.exists[places]
    inside = thermal_strain[nodes]
    thermal_strain[:] = 0
    thermal_strain[nodes] = inside
    load_program().copy(thermal_strain, engine.tables.copies, 1)


def set_density(engine: Engine, density: np.ndarray) -> None:
    """Set the mass of each node of the core relative to a node of the medium, by which its acceleration is divided. It
    continues beyond the core as at its edge. The base of each stage must outlive it.
    """
    engine.replace(mobility=engine.spread(1 / np.asarray(density, float), jointly=True))


def set_drag(engine: Engine, rate: float, first: np.ndarray, end: np.ndarray) -> None:
    """Set drag towards the mean velocity of the neighbours, with a given rate, for equations of second order. The
    energy that it takes from the nodes of the core from `first` to `end` is accumulated.

    The older level must outlive a step, and the engine must have been created for drag. Absent bonds are set later.
    """
    assert engine.drag_pass is not None
    box, low = engine.layout.box, np.array(engine.layout.low)
    full, alive = all_bits(len(engine.offsets)), engine.tables.bonds.alive
    moved, beyond = aligned_zeros(engine.components * engine.layout.size, engine.dtype, 2)
    if not engine.bonds:
        alive = np.zeros((len(full), engine.layout.size), np.uint64)
        alive[:, box.node_indices()] = full[:, None, None, None]
    drag = Drag(
        rate=np.array([rate * engine.dt], engine.dtype),
        distances=engine.layout.distances,
        alive=alive,
        full=full,
        first=first.astype(np.int64) + low,
        end=end.astype(np.int64) + low,
        lost=np.zeros(box.nodes[:2]),
        room=np.zeros((engine.threads, engine.components, box.nodes[2]), engine.dtype),
        moved=moved,
        beyond=beyond,
    )
    engine.replace(drag=drag)


def set_relaxations(
    engine: Engine, spectra: Sequence[tuple[np.ndarray, np.ndarray, float]], numbers: np.ndarray
) -> None:
    """Have the forces of the medium relax, for equations of second order. Spectra consist of the relaxation times of
    mechanisms, their shares of the modulus, and the factor of the unrelaxed forces; `numbers` says which the nodes of
    the core have, which continue beyond it as at its edge. The older level must outlive a step, and the engine must
    have been created for as many mechanisms as the longest spectrum has.
    """
    most, box = max(len(times) for times, _, _ in spectra), engine.layout.box
    memory = engine.levels[engine.stages.levels :][:most]
    keep, now, later = np.zeros((3, len(spectra), len(memory)), engine.dtype)
    total = np.zeros(len(spectra), engine.dtype)
    for number, (times, shares, strength) in enumerate(spectra):
        kept, at_once, added = relaxation_factors(times, shares, engine.dt)
        keep[number, : len(times)] = kept
        now[number, : len(times)], later[number, : len(times)] = strength * at_once, strength * added
        total[number] = (1 - strength) + strength * at_once.sum()
    places = engine.spread(numbers).astype(np.int64)
    rows = places[box.node_indices()].reshape(-1, box.nodes[2])
    row, first = np.nonzero(np.diff(rows, axis=1, prepend=-1))
    end = np.append(first[1:], 0)
    end[end == 0] = box.nodes[2]
    segments = np.stack([first, end, rows[row, first]], axis=1)
    ranges = np.append(0, np.cumsum(np.bincount(row)))
    relaxations = Relaxations(keep, now, later, total, memory, places, ranges, segments, *engine.layout.away)
    engine.replace(relaxations=relaxations)


def set_dissipation(engine: Engine, times: np.ndarray, shares: np.ndarray, first: np.ndarray, end: np.ndarray) -> None:
    """Have the dashpots of the mechanisms of `set_relaxations`, which are the same at all nodes, followed; the energy
    that they take from the nodes of the core from `first` to `end` is accumulated.
    """
    low, nodes = np.array(engine.layout.low), engine.layout.box.nodes
    keep, now, later = relaxation_factors(times, np.ones_like(shares), engine.dt)
    dissipation = Dissipation(
        share=shares.astype(engine.dtype),
        rate=(engine.dt / times).astype(engine.dtype),
        keep=keep.astype(engine.dtype),
        before=(later - keep * now).astype(engine.dtype),
        now=now.astype(engine.dtype),
        slid=engine.levels[engine.stages.levels + len(times) :],
        first=first.astype(np.int64) + low,
        end=end.astype(np.int64) + low,
        lost=np.zeros(nodes[:2]),
    )
    engine.replace(dissipation=dissipation)


def begin_relaxations(engine: Engine) -> None:
    """Let nothing have relaxed yet of the forces in the present state."""
    relaxations = engine.tables.relaxations
    if relaxations.now.size:
        force = engine.tables.numbers[-1, 3] * engine.apply(engine.current)
        for mechanism, memory in enumerate(relaxations.memory):
            memory[:] = -_at_places(engine, relaxations.now[:, mechanism]) * force
    dissipation = engine.tables.dissipation
    for now, slid in zip(dissipation.now, dissipation.slid, strict=True):
        slid[:] = -now * engine.current


def relaxed(engine: Engine, forces: np.ndarray) -> np.ndarray:
    """Return what mechanisms leave of the forces of the medium in the present state, as a level."""
    relaxations = engine.tables.relaxations
    if not relaxations.now.size:
        return forces
    lost = relaxations.memory.sum(0) / engine.tables.numbers[-1, 3] + _at_places(engine, relaxations.total) * forces
    return np.asarray(forces - lost)


def dashpots(engine: Engine) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Return for each mechanism its share, and the displacements of its dashpots now and a step ago, as levels."""
    share, _, keep, before, now, slid, *_ = engine.tables.dissipation
    u, old = engine.current, engine.older
    return [
        (float(share[m]), values + now[m] * u, (values - before[m] * old) / keep[m]) for m, values in enumerate(slid)
    ]


def _at_places(engine: Engine, of_spectra: np.ndarray) -> np.ndarray:
    """Values of the spectra of all places, as a level."""
    return np.tile(of_spectra[engine.tables.relaxations.numbers], engine.components)


def set_phases(
    engine: Engine, dissolved: np.ndarray, interface: float, saturation: float, limited: bool = False
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


def set_dependents(
    engine: Engine, nodes: np.ndarray, starts: np.ndarray, sources: np.ndarray, weights: np.ndarray
) -> None:
    """Set nodes with prescribed values: node i is the sum of weights[k] times node sources[k], k from starts[i] to
    starts[i + 1], plus a value passed to `advance`. They are set in this order after each stage.
    """
    nodes, starts, sources = (a.astype(np.int64) for a in (nodes, starts, sources))
    engine.replace(dependents=Dependents(nodes, starts, sources, weights.astype(engine.dtype)))


class FlowBonds(NamedTuple):
    """Bonds whose flow into their nodes is counted in accounts: places in a level, and weights without coefficients. A
    negative neighbour has the value zero.
    """

    accounts: np.ndarray
    nodes: np.ndarray
    neighbours: np.ndarray
    weights: np.ndarray


def record_flows(
    engine: Engine,
    bonds: FlowBonds,
    effects: np.ndarray,
    count: int,
    ends: np.ndarray = _NO_ENDS,
    sides: Mapping[tuple[int, int], tuple[int, np.ndarray]] | None = None,
) -> None:
    """Integrate over time the flow along bonds into their nodes, in `count` accounts; `effects` are the factors of the
    flow of each stage in that of a step. First-order equations only.

    `ends`, shape (ends, K): accounts of the drivers of exact ends, -1 for none. `sides`: account of a layer (axis,
    side), and the nodes next to it whose inflow from the layer is counted.
    """
    beside, rows = [np.zeros(0, np.int64)], []
    for (axis, _), (account, nodes) in (sides or {}).items():
        first = sum(map(len, beside))
        rows.append((axis, account, first, first + len(nodes)))
        beside.append(nodes)
    flows = Flows(
        effects=effects.astype(float),
        accounts=bonds.accounts.astype(np.int64),
        nodes=bonds.nodes.astype(np.int64),
        neighbours=bonds.neighbours.astype(np.int64),
        weights=bonds.weights.astype(float),
        ends=ends,
        sides=np.array(rows, np.int64).reshape(-1, 4),
        beside=np.concatenate(beside),
        inflow=np.zeros(engine.layout.size if rows else 0, engine.dtype),
        totals=np.zeros((2, count)),
    )
    engine.replace(flows=flows)


def record_blocks(engine: Engine, blocks: Sequence[tuple[np.ndarray, Sequence[np.ndarray]]]) -> None:
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
