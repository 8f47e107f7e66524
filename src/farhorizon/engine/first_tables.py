"""Tables of an engine before any of the settings that may follow."""

from __future__ import annotations

import numpy as np

from farhorizon.engine.bonds import Bonds
from farhorizon.engine.codegen.choose import compiled_rows
from farhorizon.engine.derivative_pml import DerivativePML
from farhorizon.engine.feature_list import FEATURES
from farhorizon.engine.field import Field, block_of, numbers_of
from farhorizon.engine.layout import aligned_zeros, ints, made, with_defaults
from farhorizon.engine.passes import FURTHER_PASSES
from farhorizon.engine.tables import Cuts, Material, Media, Pass, Surface, Sweep, Tables

_SECOND_CACHE = 600_000  # bytes of the second-level cache that a part of the box may occupy


def first_tables(engine: Field, heterogeneous: bool, rule: int) -> Tables:
    """Return the tables for a medium without any of the settings that may follow."""
    dtype, n = engine.dtype, engine.components
    numbers = [numbers_of(engine, *stage) for stage in engine.stages.numbers]
    sweep, layers = _sweep(engine, heterogeneous), engine.layer_tables.layers
    bond_stencil = with_defaults(Pass, dtype, sweep=sweep, layers=layers, columns=n, rows=n)
    passes = dict.fromkeys(FURTHER_PASSES, bond_stencil)  # it stands for those that do not exist
    if engine.passes is not None:
        passes["gradient_pass"], passes["divergence_pass"] = engine.passes.tables(sweep)
    if engine.heat_passes:
        passes["pushes"], passes["traces"] = (layer_pass.table(sweep) for layer_pass in engine.heat_passes)
    if engine.drag_pass is not None:
        passes["neighbours"] = engine.drag_pass.table(sweep)
    stretches = with_defaults(DerivativePML, dtype) if engine.passes is None else engine.passes.stretch_tables()
    features = {
        feature.name: made(feature.table, dtype) if feature.made is None else feature.made(engine)
        for feature in FEATURES
        if feature.table is not None
    }
    return Tables(
        rotation=np.array(engine.stages.rotation, np.int64),
        numbers=np.array(numbers).astype(dtype),
        increments=engine.stages.increments,
        components=n,
        sweep=sweep,
        layers=layers,
        work_space=aligned_zeros(max(tables.scratch for tables in engine.all_layers), dtype, engine.threads),
        copies=engine.layout.copies(),
        material=Material(np.ones(1, dtype), rule, dtype.type(1), dtype.type(np.inf)),
        operations=(),
        exchange=made(ints(0, 3, 5), dtype),
        free=made(ints(2, 2), dtype),
        media=with_defaults(Media, dtype),
        cuts=with_defaults(Cuts, dtype),
        surface=with_defaults(Surface, dtype),
        stretches=stretches,
        bonds=with_defaults(Bonds, dtype),
        **passes,
        **features,
    )


def _sweep(engine: Field, heterogeneous: bool) -> Sweep:
    """Sweep of the stencil; rows of a heterogeneous medium are not compiled for its weights."""
    reaction = np.asarray(engine.reaction) if np.ndim(engine.reaction) else np.zeros((0, 0))  # scalars: `numbers_of`
    blocks, block = block_of(engine)
    of_rows = engine.dtype.name, engine.stages.increments, engine.signs, reaction
    function, row = (0, np.zeros(1)) if heterogeneous else compiled_rows(engine.offsets, block, *of_rows)
    scale = np.array([n[2] for n in engine.stages.numbers])
    used = engine.weights.any(axis=tuple(range(1, engine.weights.ndim)))  # two passes may have no springs
    offsets, weights = engine.offsets[used], engine.weights[used]
    return with_defaults(
        Sweep,
        engine.dtype,
        block=engine.layout.table(engine.components // blocks, engine.components // blocks),
        function=function,
        blocks=blocks,
        depth=_depth(engine),
        weights=(scale[:, None] * row).astype(engine.dtype),
        offsets=offsets @ np.array(engine.layout.box.stride),
        general=(scale[:, None] * np.concatenate([weights.ravel(), -reaction.ravel()])).astype(engine.dtype),
        reach=np.array(engine.layout.reach),
    )


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
