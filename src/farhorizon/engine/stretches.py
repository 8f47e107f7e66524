"""Layers that stretch derivatives, for operators of two passes, in the compiled loop.

Entry ``a dim + b`` of a node's state belongs to the derivative of the component a along the axis b. In a layer that
derivative is divided by ``1 + phi_b / (s + alpha)``, and so is the contribution to the force of the derivative along b
of the law's results. Each of them has one number of memory, advanced by the trapezoidal rule (Wildman and Gazonas 2012,
eqs 2-22 to 2-26, as memory variables).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.layout import Block, ints, reals
from farhorizon.engine.point_law import CHUNK
from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.threads import barrier, chunk_of

FIRST, COUNT, SLOT, LOST, LOST_END, ALONG = range(6)  # columns of `Stretches.runs`


class Stretches(NamedTuple):
    """Nodes whose derivatives are stretched, in runs of neighbours along the last axis; L nodes in all."""

    # Place of the first node, number of nodes, slot of the first node, first and last + 1 row of `lost`, and for each
    # axis whether any derivative along it is stretched; shape (R, 5 + dim).
    runs: np.ndarray = ints(0, 5)
    # Coefficients of the memory of a derivative along each axis, ``m <- keep m + gain (new + old)``, which is added to
    # it; shape (dim, L).
    keep: np.ndarray = reals(0, 0)
    gain: np.ndarray = reals(0, 0)
    # ``keep m + gain old`` of the derivatives, and of the contributions to the force in a step; shape (2 dim^2 L,).
    memory: np.ndarray = reals(0)
    own: np.ndarray = reals(0, 0)  # sum of `vectors` over the present bonds, shape (dim, L)
    lost: np.ndarray = ints(0, 3)  # cut bonds: index of the node in its run, place of the neighbour, number of the bond
    # Weights of a neighbour's state in the force, by the axis of the derivative; shape (K, dim).
    vectors: np.ndarray = reals(0, 0)
    distances: np.ndarray = ints(0)  # shape (K,)
    room: np.ndarray = reals(0, 0)  # shape (threads, CHUNK)

    @property
    def places(self) -> np.ndarray:
        """Places of the nodes, slot by slot."""
        return np.concatenate(
            [np.zeros(0, np.int64), *(np.arange(run[FIRST], run[FIRST] + run[COUNT]) for run in self.runs)]
        )


def stretches_of(
    box: Block, phi: np.ndarray, alpha: np.ndarray, dt: float, vectors: np.ndarray, distances: np.ndarray
) -> Stretches:
    """Return the tables of nodes with a stretch along some axis, in a medium with all its bonds. `phi`, shape (dim,
    *box), is the rate of the stretch along each of the last axes and `alpha` its shift (both 1/time).
    """
    real, dim = vectors.dtype, len(phi)
    rate = phi + alpha
    keep = np.exp(-rate * dt)
    gain = -0.5 * np.divide(phi, rate, out=np.zeros_like(phi), where=rate > 0) * (1 - keep)
    stretched: np.ndarray = np.any(phi > 0, axis=0)
    places, runs = box.node_indices(), []
    slot = 0
    for i0, i1 in zip(*np.nonzero(np.any(stretched, axis=2)), strict=True):
        ends = np.flatnonzero(np.diff(stretched[i0, i1].astype(int), prepend=0, append=0))
        for first, last in ends.reshape(-1, 2):
            for begin in range(first, last, CHUNK):
                count = min(CHUNK, last - begin)
                along = (phi[:, i0, i1, begin : begin + count] > 0).any(1)
                runs.append([places[i0, i1, begin], count, slot, 0, 0, *along.astype(int)])
                slot += count
    return Stretches(
        runs=np.array(runs, np.int64).reshape(-1, ALONG + dim),
        keep=np.ascontiguousarray(keep[:, stretched]).astype(real),
        gain=np.ascontiguousarray(gain[:, stretched]).astype(real),
        memory=np.zeros(2 * dim * dim * slot, real),
        own=np.zeros((dim, slot), real),
        lost=np.zeros((0, 3), np.int64),
        vectors=vectors,
        distances=distances,
        room=np.zeros((0, CHUNK), real),
    )


def without_bonds(
    stretches: Stretches, missing: np.ndarray, nodes: np.ndarray, neighbours: np.ndarray, bonds: np.ndarray
) -> Stretches:
    """Return the tables of the same nodes without some bonds, given by their node, other end and number; `missing`,
    shape (dim, L), is the sum of `vectors` over the absent ones, slot by slot.
    """
    places, runs = stretches.places, stretches.runs.copy()
    order = np.argsort(places)
    at = np.minimum(np.searchsorted(places[order], nodes), max(len(places) - 1, 0))
    known = places[order][at] == nodes if len(places) else np.zeros(len(nodes), bool)
    slots = order[at[known]] if len(places) else np.zeros(0, np.int64)
    rows = np.argsort(slots, kind="stable")
    slots, neighbours, bonds = slots[rows], neighbours[known][rows], bonds[known][rows]
    runs[:, LOST], runs[:, LOST_END] = (
        np.searchsorted(slots, runs[:, SLOT]),
        np.searchsorted(slots, runs[:, SLOT] + runs[:, COUNT]),
    )
    owners = np.searchsorted(runs[:, SLOT], slots, side="right") - 1
    lost = np.stack([slots - runs[owners, SLOT], neighbours, bonds], axis=1).astype(np.int64)
    return stretches._replace(runs=runs, own=np.ascontiguousarray(-missing, stretches.own.dtype), lost=lost)


@njit(error_model="numpy", cache=True, counted=False)
def remember(value, past, keep, gain, begins, out):
    """Add the memory of some values to `out`, and update it; if it `begins`, it is initialised so that nothing is
    added.
    """
    for i in range(value.size):
        new = gain[i] * value[i]
        added = value[i] * 0 if begins else past[i] + new
        past[i] = -new if begins else keep[i] * added + new
        out[i] += added


@njit(error_model="numpy", cache=True, counted=False)
def stretch_states(thread, law, stretches, begins):
    """Stretch the states of the nodes."""
    values, runs, dim = law.values, stretches.runs, stretches.keep.shape[0]
    size, slots = values.size // (dim * dim), stretches.keep.shape[1]
    chunk = chunk_of(thread, runs.shape[0])
    for r in range(chunk[0], chunk[1]):
        count, slot = runs[r, COUNT], runs[r, SLOT]
        for row in range(dim * dim):
            along = row % dim
            if runs[r, ALONG + along]:
                first, past = row * size + runs[r, FIRST], row * slots + slot
                remember(
                    values[first : first + count],
                    stretches.memory[past : past + count],
                    stretches.keep[along, slot : slot + count],
                    stretches.gain[along, slot : slot + count],
                    begins,
                    values[first : first + count],
                )
    barrier(thread)


@njit(error_model="numpy", cache=True, counted=False)
def stretch_forces(thread, stage, law, stretches, begins):
    """Add to the forces of the nodes what the stretch along each axis changes in its contribution."""
    values, runs, dim = law.values, stretches.runs, stretches.keep.shape[0]
    vectors, distances, lost = stretches.vectors, stretches.distances, stretches.lost
    size, slots, apart = values.size // (dim * dim), stretches.keep.shape[1], stage.out.size // dim
    chunk = chunk_of(thread, runs.shape[0])
    for r in range(chunk[0], chunk[1]):
        place, count, slot = runs[r, FIRST], runs[r, COUNT], runs[r, SLOT]
        total = stretches.room[thread.number, :count]
        for row in range(dim * dim):
            along, first = row % dim, row * size + place
            if not runs[r, ALONG + along]:
                continue
            for i in range(count):
                total[i] = stretches.own[along, slot + i] * values[first + i]
            for k in range(distances.size):
                weight, there = vectors[k, along], values[first + distances[k] : first + distances[k] + count]
                if weight != 0:
                    for i in range(count):
                        total[i] += weight * there[i]
            for j in range(runs[r, LOST], runs[r, LOST_END]):
                total[lost[j, 0]] -= vectors[lost[j, 2], along] * values[row * size + lost[j, 1]]
            for i in range(count):
                total[i] *= stage.scale
            past, to = (dim * dim + row) * slots + slot, row // dim * apart + place
            remember(
                total,
                stretches.memory[past : past + count],
                stretches.keep[along, slot : slot + count],
                stretches.gain[along, slot : slot + count],
                begins,
                stage.out[to : to + count],
            )
    barrier(thread)
