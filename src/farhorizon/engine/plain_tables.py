"""Tables of the compiled loop for a medium without any of the settings that may follow."""

from __future__ import annotations

import numpy as np

from farhorizon.engine.bonds import no_bonds
from farhorizon.engine.drag import no_drag
from farhorizon.engine.ends import ends_table
from farhorizon.engine.field import Field
from farhorizon.engine.filter import Filter, filter_tables
from farhorizon.engine.layout import aligned_zeros
from farhorizon.engine.operations import Pass, Tables
from farhorizon.engine.outline_stencil import no_outline
from farhorizon.engine.passes import no_law
from farhorizon.engine.phases import one_phase
from farhorizon.engine.rows.choose import compiled_rows, equal_blocks
from farhorizon.engine.stretches import no_stretches
from farhorizon.engine.surface import no_surface
from farhorizon.engine.tables import BlockSums, Cuts, Damping, Dependents, Material, Sweep, no_flows, one_medium
from farhorizon.engine.thermal_strain import no_heat

_SECOND_CACHE = 600_000  # bytes of the second-level cache that a part of the box may occupy


def first_tables(engine: Field, heterogeneous: bool, rule: int) -> Tables:
    """Return the tables for a medium without any of the settings that may follow."""
    none, nothing, one = np.zeros(0, np.int64), np.zeros(0, engine.dtype), engine.dtype.type(1)
    no_sums = np.zeros((0, 4), np.int64), np.zeros((0, 6), np.int64)
    numbers = [numbers_of(engine, *stage) for stage in engine.stages.numbers]
    sweep, layers = _sweep(engine, heterogeneous), engine.layer_tables.layers
    cuts = Cuts(none, none, nothing)
    surface = no_surface(engine.dtype)
    bond_stencil = Pass(sweep, layers, cuts, surface, engine.components, engine.components)
    gradient_pass, divergence_pass = (
        (bond_stencil, bond_stencil) if engine.passes is None else engine.passes.tables(sweep)
    )
    pushes, traces = (
        (bond_stencil, bond_stencil)
        if engine.thermoelastic_layers is None
        else engine.thermoelastic_layers.tables(sweep)
    )
    return Tables(
        operations=np.zeros((0, 3), np.int64),
        starts=np.zeros(len(numbers) + 1, np.int64),
        rotation=np.array(engine.stages.rotation, np.int64),
        numbers=np.array(numbers).astype(engine.dtype),
        increments=engine.stages.increments,
        components=engine.components,
        sweep=sweep,
        layers=layers,
        work_space=aligned_zeros(_scratch(engine), engine.dtype, engine.threads),
        copies=engine.layout.copies(),
        exchange=np.zeros((0, 3, 5), np.int64),
        free=np.zeros((2, 2), np.int64),
        material=Material(np.ones(1, engine.dtype), rule, one, engine.dtype.type(np.inf)),
        media=one_medium(engine.dtype),
        cuts=cuts,
        surface=surface,
        phases=one_phase(),
        bonds=no_bonds(engine.dtype),
        work=np.zeros(0),
        damping=Damping(none, nothing, nothing, nothing),
        mobility=nothing,
        ends=ends_table(np.zeros((0, 0), np.int64), 1.0),
        dependents=Dependents(none, np.zeros(1, np.int64), none, nothing),
        flows=no_flows(len(numbers), engine.dtype),
        outline_stencil=no_outline(),
        filter=_filter(engine),
        dampers=engine.dampers.tables(engine.memory, engine.dtype),
        block_sums=BlockSums(*no_sums, nothing, np.array(engine.layout.box.stride, np.int64)),
        gradient_pass=gradient_pass,
        divergence_pass=divergence_pass,
        pushes=pushes,
        traces=traces,
        neighbours=bond_stencil if engine.dragged_layers is None else engine.dragged_layers.table(sweep),
        stretches=no_stretches(engine.dtype) if engine.passes is None else engine.passes.stretch_tables(),
        drag=no_drag(engine.dtype),
        heat=no_heat(engine.dtype),
    )


def _scratch(engine: Field) -> int:
    """Number of values in the work space of a thread."""
    return max(tables.scratch for tables in engine.all_layers)


def _sweep(engine: Field, heterogeneous: bool) -> Sweep:
    own = np.asarray(engine.reaction) if np.ndim(engine.reaction) else np.zeros((0, 0))  # scalars are in `numbers_of`
    blocks, block = block_of(engine)
    given = engine.dtype.name, engine.stages.increments, engine.signs, own
    function, row = (0, np.zeros(1)) if heterogeneous else compiled_rows(engine.offsets, block, *given)
    scale = np.array([n[2] for n in engine.stages.numbers])
    there = engine.weights.any(axis=tuple(range(1, engine.weights.ndim)))  # two passes may have no springs
    offsets, weights = engine.offsets[there], engine.weights[there]
    return Sweep(
        engine.layout.table(engine.components // blocks, engine.components // blocks),
        function,
        blocks,
        _depth(engine),
        (scale[:, None] * row).astype(engine.dtype),
        offsets @ np.array(engine.layout.box.stride),
        (scale[:, None] * np.concatenate([weights.ravel(), -own.ravel()])).astype(engine.dtype),
        np.array(engine.layout.reach),
        no_law(engine),
    )


def block_of(engine: Field) -> tuple[int, np.ndarray]:
    """Number of equal stencils in the weights, one per component of the field, and one of these; otherwise 1 and all
    weights.
    """
    count = engine.components
    if count > 1 and not np.ndim(engine.reaction) and equal_blocks(engine.weights, count):
        return count, engine.weights[:, 0, 0]
    return 1, engine.weights


def numbers_of(engine: Field, a: float, b: float, scale: float, source_scale: float) -> tuple[float, ...]:
    """Numbers of a stage for the sweeps: factor of a node's own value for the rows' weights, the same for sums over
    differences, and the others. Rows of increments are differences, and leave out the value itself, which stays.
    """
    increments = engine.stages.increments
    own = a - float(increments) - (0.0 if np.ndim(engine.reaction) else scale * float(engine.reaction))
    block = block_of(engine)[1]
    rows = -float(block.sum()) if block.ndim == 1 and not increments else 0.0
    return own + scale * rows, own, b, scale, source_scale


def _depth(engine: Field) -> int:
    """Number of rows to sweep at a time: few enough that each thread gets some and that, in 3D, the planes that they
    read stay in the second-level cache.
    """
    box, reach = engine.layout.box, engine.layout.reach
    rows, planes = box.nodes[1], 2 * reach[0] + 1
    most = min(64, -(-box.nodes[0] * rows // (8 * engine.threads)))
    if planes > 1:
        most = min(
            most, _SECOND_CACHE // (engine.components * box.stride[1] * engine.dtype.itemsize * planes) - 2 * reach[0]
        )
    return -(-rows // -(-rows // max(most, 8)))


def _filter(engine: Field) -> Filter:
    """Return the filter of short waves; all layers share the longest one, and what it is applied to."""
    rates, taps = damping_of(engine)
    whole = any(layer.whole for layer in engine.layers.values())
    every = max((layer.every for layer in engine.layers.values() if layer.filtered), default=0) or 1
    return filter_tables(engine.layout, rates, taps, engine.dt, engine.dtype, whole, every)


def damping_of(engine: Field) -> tuple[dict[tuple[int, int], np.ndarray], np.ndarray]:
    """Rates at which layers damp short waves, from the near field outwards, and the filter."""
    rates = {
        name: layer.damping if layer.filtered else np.zeros(layer.columns) for name, layer in engine.layers.items()
    }
    return rates, max((layer.taps for layer in engine.layers.values()), key=len, default=np.zeros(1))
