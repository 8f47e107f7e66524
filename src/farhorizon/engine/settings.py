"""Settings of an existing engine: each function replaces tables of a plain medium."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from farhorizon.engine.engine import Engine
from farhorizon.engine.exchange import Exchange, Link, Messages, free_of_halos
from farhorizon.engine.features.filter import damping_of, margin_across
from farhorizon.engine.field import numbers_of
from farhorizon.engine.layers import Layers
from farhorizon.engine.media import media_of


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


def damp_increments(engine: Engine, factor: float) -> None:
    """Multiply the previous increment of velocity Verlet by a factor in each step from now on, of an engine made
    without damping whose older level outlives a step.
    """
    _, _, scale, source_scale = engine.stages.numbers[0]
    numbers = [numbers_of(engine, 1 + factor, -factor, scale, source_scale)]
    engine.replace(numbers=np.array(numbers).astype(engine.dtype))
