"""Forces that relax: mechanisms of attenuation as memory of the nodes, in the compiled loop.

What the operator and the layers exert on a node passes a filter in time, the same one at all nodes, so that it makes no
difference whether the filter precedes the operator or follows it: near field, layers, cuts and varying bonds stay as
they are. Each mechanism l keeps ``r' = (a f - r) / tau`` for the force f of the unrelaxed medium, exactly for a force
that is linear within each step: ``r(n) = keep r(n-1) + b f(n-1) + c f(n)``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.layout import reals
from farhorizon.engine.threads import barrier, chunk_of


class Relaxations(NamedTuple):
    """Mechanisms, by which forces relax."""

    keep: np.ndarray = reals(0)  # factor of what is relaxed from one step to the next, shape (N,)
    now: np.ndarray = reals(0)  # share of the present force that is relaxed at once, shape (N,)
    later: np.ndarray = reals(0)  # share of the present force that is added to the memory, shape (N,)
    # What will be relaxed in the next step of the forces so far, in units of the update: further levels of the engine,
    # shape (N, components * places).
    memory: np.ndarray = reals(0, 0)
    room: np.ndarray = reals(0, 0)  # shape (threads, nodes of a row)


def relaxation_factors(times: np.ndarray, shares: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return `keep`, `now` and `later` of mechanisms for a step."""
    ratio = dt / times
    keep, mean = np.exp(-ratio), -np.expm1(-ratio) / ratio  # mean of exp(-t / tau) over a step
    now, before = shares * (1 - mean), shares * (mean - keep)
    return keep, now, keep * now + before


@njit(error_model="numpy", cache=True, counted=False)
def relax_forces(thread, stage, block, relaxations):
    """Relax what the forces have done in this step, before anything else has acted on the nodes; `base` still holds the
    level before `src`.
    """
    apart, back, total = stage.out.size // stage.components, -stage.b, relaxations.now.sum()
    chunk, room = chunk_of(thread, block[1] * block[2]), relaxations.room[thread.number]
    for row in range(chunk[0], chunk[1]):
        first = block[0] + row // block[2] * block[4] + row % block[2] * block[5]
        for c in range(stage.components):
            start, end = first + c * apart, first + c * apart + block[3]
            src, base, out = stage.src[start:end], stage.base[start:end], stage.out[start:end]
            for i in range(block[3]):
                room[i] = out[i] - (src[i] + back * (src[i] - base[i]))
                out[i] -= total * room[i]
            last = relaxations.keep.size - 1
            for mechanism in range(0, last, 2):  # two at a time, since each pass takes what memory can deliver
                _pass_on(relaxations, mechanism, mechanism + 1, start, room[: block[3]], out)
            if last % 2 == 0:
                _pass_on(relaxations, last, last, start, room[: block[3]], out)
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def _pass_on(relaxations, one, other, start, force, out):
    """Subtract what has relaxed by two mechanisms, or by one that is given twice, and add the force to their memory."""
    a, b = relaxations.memory[one, start : start + out.size], relaxations.memory[other, start : start + out.size]
    keep_a, later_a = relaxations.keep[one], relaxations.later[one]
    keep_b, later_b = relaxations.keep[other], relaxations.later[other]
    if one == other:
        for i in range(out.size):
            out[i] -= a[i]
            a[i] = keep_a * a[i] + later_a * force[i]
        return
    for i in range(out.size):
        out[i] -= a[i] + b[i]
        a[i] = keep_a * a[i] + later_a * force[i]
        b[i] = keep_b * b[i] + later_b * force[i]
