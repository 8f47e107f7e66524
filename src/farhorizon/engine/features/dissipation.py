"""What relaxation dissipates: displacements of the dashpots of all mechanisms, in the compiled loop.

The mechanism l is a spring, with the share a of the unrelaxed operator L, in series with a dashpot, whose displacement
s follows that of the node, ``tau s' = u - s``. Its force on a node is ``a L u - r``, where ``tau r' = a L u - r``, so
that its power is ``-tau s' . r'``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.feature import CHANGE, Feature, Step
from farhorizon.engine.features.relaxations import relaxation_factors
from farhorizon.engine.field import Field
from farhorizon.engine.layout import doubles, ints, reals
from farhorizon.engine.passes import reads
from farhorizon.engine.threads import barrier, chunk_of


class Dissipation(NamedTuple):
    """Dashpots of N mechanisms, the same at all nodes, and the energy that they have taken."""

    share: np.ndarray = reals(0)  # of the unrelaxed modulus, shape (N,), as are the next four
    rate: np.ndarray = reals(0)  # step over relaxation time
    keep: np.ndarray = reals(0)  # factors of the dashpot's displacement, and of that of its node, before and now
    before: np.ndarray = reals(0)
    now: np.ndarray = reals(0)
    # What the displacements so far contribute to that of the dashpots in the next step: further levels of the engine,
    # shape (N, components * places).
    slid: np.ndarray = reals(0, 0)
    first: np.ndarray = ints(0)  # box of the nodes whose loss is accumulated, shape (3,), as is `end`
    end: np.ndarray = ints(0)
    lost: np.ndarray = doubles(0, 0)  # in units of the update, over the mass of a node of the medium; (planes, rows)


@reads("relaxations", "dissipation")
def dissipate(thread, stage, sums, tables, inputs, step, number):
    """Move the dashpots to the present displacements, and accumulate what that takes, after the forces have relaxed and
    before anything else has acted on the nodes.
    """
    block, relaxations, dissipation = sums.sweep.block, tables.relaxations, tables.dissipation
    share, rate, keep = dissipation.share, dissipation.rate, dissipation.keep
    before, now, slid = dissipation.before, dissipation.now, dissipation.slid
    apart, back, mechanisms = stage.out.size // stage.components, -stage.b, share.size
    chunk = chunk_of(thread, block[1] * block[2])
    for row in range(chunk[0], chunk[1]):
        i0, i1, taken = row // block[2], row % block[2], 0.0
        near = dissipation.first[0] <= i0 < dissipation.end[0] and dissipation.first[1] <= i1 < dissipation.end[1]
        for c in range(stage.components):
            first = block[0] + i0 * block[4] + i1 * block[5] + c * apart
            for i in range(block[3]):
                at, total, weight = first + i, 0.0, 1.0
                u, counts = stage.src[at], near and dissipation.first[2] <= i < dissipation.end[2]
                for m in range(mechanisms):  # the unrelaxed force, from what is left of it and from the memory
                    total += relaxations.memory[m, at] / keep[m]
                    weight += share[m] * before[m] / keep[m]
                force = (stage.out[at] - (u + back * (u - stage.base[at])) + total) / weight
                for m in range(mechanisms):
                    relaxed = (relaxations.memory[m, at] - share[m] * before[m] * force) / keep[m]
                    dashpot = slid[m, at] + now[m] * u
                    if counts:
                        taken -= rate[m] * (u - dashpot) * (share[m] * force - relaxed)
                    slid[m, at] = keep[m] * dashpot + before[m] * u
        dissipation.lost[i0, i1] += taken
    barrier(thread)


DISSIPATION = Feature(
    "dissipation",
    [Step(CHANGE, dissipate, lambda tables, *_: tables.dissipation.share.size)],
    table=Dissipation,
    sums=lambda dissipation: {"relaxation": dissipation.lost[None]},
)


def set_dissipation(engine: Field, times: np.ndarray, shares: np.ndarray, first: np.ndarray, end: np.ndarray) -> None:
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


def begin_dissipation(engine: Field) -> None:
    """Let the dashpots be where they are without stress that has relaxed, in the present state."""
    dissipation = engine.tables.dissipation
    for now, slid in zip(dissipation.now, dissipation.slid, strict=True):
        slid[:] = -now * engine.current


def dissipated(engine: Field) -> float:
    """Energy that relaxation has dissipated, per unit mass of a node."""
    return float(engine.tables.dissipation.lost.sum()) / engine.dt**2


def dashpots(engine: Field) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Return for each mechanism its share, and the displacements of its dashpots now and a step ago, as levels."""
    share, _, keep, before, now, slid, *_ = engine.tables.dissipation
    u, old = engine.current, engine.older
    return [
        (float(share[m]), values + now[m] * u, (values - before[m] * old) / keep[m]) for m, values in enumerate(slid)
    ]
