"""Exact ends of a bar in the compiled loop: forces of the half-infinite chains beyond on the nodes next to them, the
drivers.

An end is a sum of exponentials (states that cost the same in each step) or a convolution in blocks (the contribution of
earlier blocks is known in advance, and that of the block's own samples is computed here). See
`farhorizon.analysis.exact.chain` for the kernels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.feature import CHANGE, Feature, Room, Step
from farhorizon.engine.features.flows import add_to
from farhorizon.engine.field import Field
from farhorizon.engine.layout import doubles, ints
from farhorizon.engine.passes import reads
from farhorizon.engine.tables import Inputs, Tables
from farhorizon.engine.threads import barrier

Poles = tuple[np.ndarray, np.ndarray, np.ndarray]

_MODES = 8  # modes of an end are padded to whole vectors
_ANY_ORDER = {"reassoc", "contract", "nsz"}  # sums may be vectorised; inlined, because two copies would differ


class ExactEndTables(NamedTuple):
    """Chains beyond the ends of a bar. K4 is K rounded up to a multiple of four; entries beyond K are zero."""

    first: float = 1.0  # weight of the sample at step 0
    clock: np.ndarray = ints(1)  # number of the step; advanced by each step
    nodes: np.ndarray = ints(0, 0)  # drivers in a level, from each end inwards; shape (ends, K)
    poles: np.ndarray = doubles(0, 2, 0)  # real and imaginary parts, shape (ends, 2, P)
    # Real parts, then imaginary ones, of c_p, and of b_p with the sign of the imaginary parts reversed, so that the
    # force is a product with the states; shape (ends, K4, 2 P).
    inputs: np.ndarray = doubles(0, 0, 0)
    outputs: np.ndarray = doubles(0, 0, 0)
    states: np.ndarray = doubles(0, 0)  # shape (ends, 2 P)
    sample: np.ndarray = doubles(0)  # work space, shape (K4,)
    forces: np.ndarray = doubles(0, 0)  # accelerations of the drivers, shape (ends, K4)
    # Kernels, and contributions of earlier blocks, of convolutions in blocks of B steps, shapes (ends, B, K, K) and
    # (ends, B, K); B = 0 without convolutions.
    heads: np.ndarray = doubles(0, 0, 0, 0)
    past: np.ndarray = doubles(0, 0, 0)
    history: np.ndarray = doubles(0, 0, 0)  # values of the drivers, shape (ends, steps, K)


def ends_table(nodes: np.ndarray, first: float, sums: Sequence[Poles | None] = (), block: int = 0) -> ExactEndTables:
    """Return the tables of the ends, with zero states: poles, inputs and outputs, complex and of shapes (P,), (P, K)
    and (P, K), for each end that is a sum of exponentials, and the steps in a block of convolutions, 0 without.
    """
    ends, reach = nodes.shape
    rows = -(-reach // 4) * 4
    most = max((len(s[0]) for s in sums if s is not None), default=0)
    count = -(-most // _MODES) * _MODES
    poles, inputs, outputs = (
        np.zeros((ends, 2, count)),
        np.zeros((ends, rows, 2 * count)),
        np.zeros((ends, rows, 2 * count)),
    )
    for end, exponentials in enumerate(sums):
        if exponentials is not None:
            z, c, b = exponentials
            used, imaginary = slice(len(z)), slice(count, count + len(z))
            poles[end, 0, used], poles[end, 1, used] = z.real, z.imag
            inputs[end, :reach, used], inputs[end, :reach, imaginary] = c.real.T, c.imag.T
            outputs[end, :reach, used], outputs[end, :reach, imaginary] = b.real.T, -b.imag.T
    return ExactEndTables(
        first=float(first),
        clock=np.zeros(1, np.int64),
        nodes=nodes.astype(np.int64),
        poles=poles,
        inputs=inputs,
        outputs=outputs,
        states=np.zeros((ends, 2 * count)),
        sample=np.zeros(rows),
        forces=np.zeros((ends, rows)),
        heads=np.zeros((ends, block, reach, reach)),
        past=np.zeros((ends, block, reach)),
        history=np.zeros((ends, 0, reach)),
    )


@njit(error_model="numpy", fastmath=_ANY_ORDER, forceinline=True, cache=True, entry=False)
def force_of_states(end, outputs, states, forces):
    """Compute the force of one end, four drivers at a time."""
    for i in range(0, forces.shape[1], 4):
        f0, f1, f2, f3 = 0.0, 0.0, 0.0, 0.0
        for p in range(states.shape[1]):
            y = states[end, p]
            f0 += outputs[end, i, p] * y
            f1 += outputs[end, i + 1, p] * y
            f2 += outputs[end, i + 2, p] * y
            f3 += outputs[end, i + 3, p] * y
        forces[end, i], forces[end, i + 1], forces[end, i + 2], forces[end, i + 3] = f0, f1, f2, f3


@njit(error_model="numpy", fastmath=_ANY_ORDER, forceinline=True, cache=True, entry=False)
def advance_states(end, poles, inputs, sample, states):
    """Advance the states of one end, ``y <- z (y + c . u)``, four drivers at a time."""
    for m in range(0, sample.size, 4):
        u0, u1, u2, u3 = sample[m], sample[m + 1], sample[m + 2], sample[m + 3]
        for p in range(states.shape[1]):
            near = u0 * inputs[end, m, p] + u1 * inputs[end, m + 1, p]
            states[end, p] += near + (u2 * inputs[end, m + 2, p] + u3 * inputs[end, m + 3, p])
    count = poles.shape[2]
    real, imaginary = states[end, :count], states[end, count:]
    for p in range(count):
        a, b, x, y = poles[end, 0, p], poles[end, 1, p], real[p], imaginary[p]
        real[p] = a * x - b * y
        imaginary[p] = a * y + b * x


@njit(error_model="numpy", cache=True, entry=False)
def convolve(step, heads, past, history, force):
    """Add the contribution of earlier blocks, and that of this block's own samples."""
    reach, place = past.shape[1], step % heads.shape[0]
    for i in range(reach):
        force[i] += past[place, i]
    for lag in range(1, place + 1):
        sample, head = history[step - lag], heads[lag]
        for i in range(reach):
            total = 0.0
            for m in range(reach):
                total += head[i, m] * sample[m]
            force[i] += total


@njit(error_model="numpy", cache=True, entry=False)
def exact_ends(stage, ends):
    """Add to a step, from the state of its stage, the forces of all chains beyond the ends."""
    step = ends.clock[0]
    ends.clock[0] = step + 1
    weight = ends.first if step == 0 else 1.0
    nodes, sample, forces = ends.nodes, ends.sample, ends.forces
    reach = nodes.shape[1]
    for end in range(nodes.shape[0]):
        for m in range(reach):
            sample[m] = weight * stage.src[nodes[end, m]]
            ends.history[end, step, m] = sample[m]
        force_of_states(end, ends.outputs, ends.states, forces)
        advance_states(end, ends.poles, ends.inputs, sample, ends.states)
        if ends.heads.shape[1]:
            convolve(step, ends.heads[end], ends.past[end], ends.history[end], forces[end])
        for m in range(reach):
            node, gain = nodes[end, m], stage.scale * forces[end, m]
            if stage.increments:
                stage.base[node] += gain
                stage.out[node] = stage.src[node] + stage.base[node]
            else:
                stage.out[node] += gain


@reads("ends", "flows")
def add_exact_ends(thread, stage, sums, tables, inputs, step, number):
    """Add the forces of the chains beyond all exact ends, and to the flows what these bring to their drivers; an
    account below 0 means that there is none.
    """
    if thread.number == 0:
        ends, flows = tables.ends, tables.flows
        exact_ends(stage, ends)
        effect = flows.effects[stage.part]
        for end in range(flows.ends.shape[0]):
            for m in range(flows.ends.shape[1]):
                if flows.ends[end, m] >= 0:
                    add_to(flows.totals, flows.ends[end, m], effect * ends.forces[end, m])
    barrier(thread)


def _room(tables: Tables, inputs: Inputs, steps: int) -> list[Room]:
    """The clock counts once per stage."""
    ends, stages = tables.ends, len(tables.numbers)
    clock = int(ends.clock[0]) + steps * stages if len(ends.history) else 0
    return [("history", ends.history.shape[1:2], (clock,))]


ENDS = Feature(
    "ends",
    [Step(CHANGE, add_exact_ends, lambda tables, *_: len(tables.ends.nodes))],
    table=ExactEndTables,
    map=lambda ends: (ends.nodes, ends.poles, ends.inputs, ends.outputs),
    more=lambda ends: {"states": ends.states, "forces": ends.forces, "clock": ends.clock},
    room=_room,
)


def lengthen_history(engine: Field, steps: int) -> None:
    """Make room for the values of the drivers in a number of further steps."""
    ends = engine.tables.ends
    count, length, reach = ends.history.shape
    if count and length < ends.clock[0] + steps:
        more = max(int(ends.clock[0]) + steps - length, min(length, 1 << 20), 256)
        history = np.concatenate([ends.history, np.zeros((count, more, reach))], axis=1)
        engine.replace(ends=ends._replace(history=history))
