"""Forces that relax: mechanisms of attenuation as memory of the nodes, in the compiled loop.

What the operator and the layers exert on a node passes a filter in time. Where that is the same at all nodes, it makes
no difference whether the filter precedes the operator or follows it: near field, layers, cuts and varying bonds stay as
they are. Each mechanism l keeps ``r' = (a f - r) / tau`` for the force f of the unrelaxed medium, exactly for a force
that is linear within each step: ``r(n) = keep r(n-1) + b f(n-1) + c f(n)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.vector_operations import relax_values
from farhorizon.engine.feature import CHANGE, Feature, Step
from farhorizon.engine.field import Field
from farhorizon.engine.layout import ints, reals
from farhorizon.engine.passes import reads
from farhorizon.engine.sweep_program import rows_of
from farhorizon.engine.threads import barrier, chunk_of


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


@reads("relaxations", "gradient_pass")
def relax_all_forces(thread, stage, sums, tables, inputs, step, number):
    """Relax the forces on nodes to which more has been added since the sweep."""
    rows = sums.sweep.block[2]
    chunk = chunk_of(thread, sums.sweep.block[1] * rows)
    for row in range(chunk[0], chunk[1]):
        relax_rows(stage, sums, tables, row // rows, row % rows, row % rows + 1, False)
    barrier(thread)


@reads("relaxations", "gradient_pass")
def relax_part(thread, stage, sums, tables, inputs, step, number):
    """Relax the forces on nodes where they are complete, while what they are subtracted from is in the cache."""
    i0, first, last = rows_of(sums.sweep, number)
    relax_rows(stage, sums, tables, i0, first, last, True)


RELAXATIONS = Feature(
    "relaxations",
    [Step(CHANGE, relax_all_forces, lambda tables, *_: tables.relaxations.keep.size, part=relax_part)],
    table=Relaxations,
    map=lambda relaxations: relaxations._replace(memory=relaxations.memory[:0]),
)


def set_relaxations(
    engine: Field, spectra: Sequence[tuple[np.ndarray, np.ndarray, float]], numbers: np.ndarray
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


def begin_relaxations(engine: Field) -> None:
    """Let nothing have relaxed yet of the forces in the present state."""
    relaxations = engine.tables.relaxations
    if relaxations.now.size:
        force = engine.tables.numbers[-1, 3] * engine.apply(engine.current)
        for mechanism, memory in enumerate(relaxations.memory):
            memory[:] = -_at_places(engine, relaxations.now[:, mechanism]) * force


def relaxed(engine: Field, forces: np.ndarray) -> np.ndarray:
    """Return what mechanisms leave of the forces of the medium in the present state, as a level."""
    relaxations = engine.tables.relaxations
    if not relaxations.now.size:
        return forces
    lost = relaxations.memory.sum(0) / engine.tables.numbers[-1, 3] + _at_places(engine, relaxations.total) * forces
    return np.asarray(forces - lost)


def _at_places(engine: Field, of_spectra: np.ndarray) -> np.ndarray:
    """Values of the spectra of all places, as a level."""
    return np.tile(of_spectra[engine.tables.relaxations.numbers], engine.components)
