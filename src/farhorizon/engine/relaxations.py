"""Forces that relax: mechanisms of attenuation as memory of the nodes, in the compiled loop.

What the operator and the layers exert on a node passes a filter in time. Where that is the same at all nodes, it makes
no difference whether the filter precedes the operator or follows it: near field, layers, cuts and varying bonds stay as
they are. Each mechanism l keeps ``r' = (a f - r) / tau`` for the force f of the unrelaxed medium, exactly for a force
that is linear within each step: ``r(n) = keep r(n-1) + b f(n-1) + c f(n)``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.vector_operations import relax_values
from farhorizon.engine.layout import ints, reals


class Relaxations(NamedTuple):
    """Spectra of mechanisms, by which forces relax."""

    keep: np.ndarray = reals(0, 0)  # factor of what is relaxed from one step to the next, shape (R, N)
    now: np.ndarray = reals(0, 0)  # share of the present force that is relaxed at once, shape (R, N)
    later: np.ndarray = reals(0, 0)  # share of the present force that is added to the memory, shape (R, N)
    total: np.ndarray = reals(0)  # share of the present force that is missing at once, shape (R,)
    # What will be relaxed in the next step of the forces so far, in units of the update: further levels of the engine,
    # shape (N, components * places).
    memory: np.ndarray = reals(0, 0)
    numbers: np.ndarray = ints(0)  # spectrum of each place
    ranges: np.ndarray = ints(1)  # first segment of each row and the end
    segments: np.ndarray = ints(0, 3)  # first node along the row, last + 1, and their spectrum
    # Box of the nodes whose forces are complete once they are swept, unless bonds are cut or there are two passes:
    # first and last + 1, shape (3,).
    first: np.ndarray = ints(0)
    end: np.ndarray = ints(0)


def relaxation_factors(times: np.ndarray, shares: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return `keep`, `now` and `later` of mechanisms for a step."""
    ratio = dt / times
    keep, mean = np.exp(-ratio), -np.expm1(-ratio) / ratio  # mean of exp(-t / tau) over a step
    now, before = shares * (1 - mean), shares * (mean - keep)
    return keep, now, keep * now + before


@njit(error_model="numpy", cache=True, counted=False)
def relax_rows(stage, sums, tables, i0, i1, end, swept):
    """Relax what the forces have done in this step on rows of a plane, before anything else has acted on the nodes: on
    nodes whose forces are complete once they are `swept`, or on the others. `base` still holds the level before `src`.
    """
    block, relaxations = sums.sweep.block, tables.relaxations
    at_once = sums.cuts.nodes.size == 0 and tables.gradient_pass.sweep.law.values.size == 0
    at_once &= relaxations.first[0] <= i0 < relaxations.end[0]
    for row in range(i1, end):
        first, last = block[3], block[3]
        if at_once and relaxations.first[1] <= row < relaxations.end[1]:
            first, last = relaxations.first[2], relaxations.end[2]
        place, number = block[0] + i0 * block[4] + row * block[5], i0 * block[2] + row
        for segment in range(relaxations.ranges[number], relaxations.ranges[number + 1]):
            start, stop, spectrum = relaxations.segments[segment]
            if swept:
                _relax_nodes(stage, relaxations, spectrum, place, max(start, first), min(stop, last))
            else:
                _relax_nodes(stage, relaxations, spectrum, place, start, min(stop, first))
                _relax_nodes(stage, relaxations, spectrum, place, max(start, last), stop)


@njit(error_model="numpy", cache=True, counted=False)
def _relax_nodes(stage, relaxations, spectrum, place, first, last):
    """Do the same on some nodes of a row, which begins at a place, of one spectrum."""
    size, memory, mechanisms = stage.out.itemsize, relaxations.memory, relaxations.memory.shape[0]
    factors = spectrum * mechanisms * size
    for c in range(stage.components if first < last else 0):
        at = (place + first + c * (stage.out.size // stage.components)) * size
        relax_values(
            (stage.out.ctypes.data + at, stage.src.ctypes.data + at, stage.base.ctypes.data + at),
            memory.ctypes.data + at,
            memory.strides[0],
            (relaxations.keep.ctypes.data + factors, relaxations.later.ctypes.data + factors, mechanisms),
            last - first,
            -stage.b,
            relaxations.total[spectrum],
        )
