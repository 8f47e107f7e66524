"""The features of a step. Operations at one place of a stage follow each other in the order of this list."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from farhorizon.engine.feature import Feature, Step
from farhorizon.engine.features.block_sums import BLOCK_SUMS
from farhorizon.engine.features.dampers import DAMPERS
from farhorizon.engine.features.damping import DAMPING
from farhorizon.engine.features.density import DENSITY
from farhorizon.engine.features.dependents import DEPENDENTS
from farhorizon.engine.features.dissipation import DISSIPATION
from farhorizon.engine.features.drag import DRAG
from farhorizon.engine.features.ends import ENDS
from farhorizon.engine.features.faces import FACES
from farhorizon.engine.features.filter import FILTER
from farhorizon.engine.features.flows import FLOWS
from farhorizon.engine.features.held import HELD
from farhorizon.engine.features.impactors import IMPACTORS
from farhorizon.engine.features.outline_stencil import OUTLINE
from farhorizon.engine.features.phases import PHASES
from farhorizon.engine.features.relaxations import RELAXATIONS
from farhorizon.engine.features.sources import SOURCES
from farhorizon.engine.features.thermal_strain import HEAT
from farhorizon.engine.passes import Operation
from farhorizon.engine.tables import Asked, Tables

FEATURES: list[Feature] = [
    RELAXATIONS,
    DISSIPATION,
    ENDS,
    SOURCES,
    DENSITY,
    IMPACTORS,
    DRAG,
    DAMPING,
    FILTER,
    DAMPERS,
    HELD,
    FLOWS,
    DEPENDENTS,
    OUTLINE,
    PHASES,
    BLOCK_SUMS,
    FACES,
    HEAT,
]


def steps() -> Iterator[Step]:
    """Yield the steps of all features."""
    for feature in FEATURES:
        yield from feature.steps


def operations_at(place: int, tables: Tables, asked: Asked, stage: int = 0) -> list[Operation]:
    """Operations of all features at a place of a stage, given its number."""
    last = stage == len(tables.numbers) - 1
    return [
        operation
        for step in steps()
        if step.place == place and (last or not step.last) and step.present(tables, asked, stage)
        for operation in step.around(tables, (step.name, 0, step.which))
    ]


def with_tables(tables: Tables) -> Iterator[tuple[Feature, Any]]:
    """Yield the features that have a table, and that."""
    for feature in FEATURES:
        if feature.table is not None:
            yield feature, getattr(tables, feature.name)
