"""Masses of the nodes that differ, in the compiled loop."""

from __future__ import annotations

import numpy as np

from farhorizon.engine.feature import CHANGE, Feature, Step
from farhorizon.engine.field import Field
from farhorizon.engine.layout import reals
from farhorizon.engine.passes import reads
from farhorizon.engine.threads import barrier, chunk_of


@reads("mobility")
def scale_by_mobility(thread, stage, sums, tables, inputs, step, number):
    """Scale what forces have done to each node in this step by its mobility, to account for its mass; `base` still
    holds the level before `src`.
    """
    block, mobility = sums.sweep.block, tables.mobility
    apart, keep = stage.out.size // stage.components, -stage.b
    chunk = chunk_of(thread, block[1] * block[2])
    for row in range(chunk[0], chunk[1]):
        first = block[0] + row // block[2] * block[4] + row % block[2] * block[5]
        mobile = mobility[first : first + block[3]]
        for c in range(stage.components):
            start, end = first + c * apart, first + c * apart + block[3]
            src, base, out = stage.src[start:end], stage.base[start:end], stage.out[start:end]
            for i in range(block[3]):
                free = src[i] + keep * (src[i] - base[i])
                out[i] = free + mobile[i] * (out[i] - free)
    barrier(thread)


DENSITY = Feature(
    "mobility",  # acceleration of each place by a given force, relative to a node of the medium; or empty
    [Step(CHANGE, scale_by_mobility, lambda tables, *_: tables.mobility.size)],
    table=reals(0),
    map=lambda mobility: (mobility,),
)


def set_density(engine: Field, density: np.ndarray) -> None:
    """Set the mass of each node of the core relative to a node of the medium, by which its acceleration is divided. It
    continues beyond the core as at its edge. The base of each stage must outlive it.
    """
    engine.replace(mobility=engine.spread(1 / np.asarray(density, float), jointly=True))
