"""Damping of short waves in the layers: a step subtracts from the increments there what a high-pass filter passes.

With the increment d of a step and the layers' nodal strengths D, zero outside, ``d <- d - D F D d``, where F is the sum
over the axes of one symmetric filter along each. F is positive semi-definite and D F D at most 1, so that this removes
energy and never adds any, at every time step. Waves that hardly move, such as those of a material with zero-energy
modes, keep their displacement that way. There both levels of the field are filtered (`whole`), so that a wave that
passes the filter decays by itself: s becomes ``s + rate``.

Where little is damped it is enough to do so in every second step, by as much as in both.

A line along an axis ends where its next bond is cut, or leads to a place without a node: a crack or a rim that runs
into a layer is no short wave. There the line meets its own mirror image, as beyond a free side, so that the filter
becomes the same polynomial of the second difference on a line that ends (`cut_filter`).

The increments of the layers' nodes, and only those, are put into a *box*, one component after the other. It has a place
for every node of the near field and of the layers, in their natural order, with margins as wide as the filter reaches:
one number each, however many components the field has. In it the layers form a frame, and the places of the near field
stay zero; they are read where the filter reaches them from a layer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.codegen.exchanges import NO_MESSAGES, RECEIVES, SENDS, TABLE, USED, call_exchange
from farhorizon.engine.codegen.vector_operations import TOGETHER, fetch, take_passed, weigh_change
from farhorizon.engine.feature import CHANGE, Feature, Step
from farhorizon.engine.field import Field
from farhorizon.engine.layout import ALIGN, SLACK, Layout, aligned_zeros, ints, reals, with_defaults
from farhorizon.engine.passes import reads
from farhorizon.engine.threads import barrier, chunk_of

_PIECE = 256  # nodes of a run that one thread takes at a time
_AHEAD = 8  # pieces between use and prefetch
# number of taps beyond which a filter in 3D works in blocks, and bytes that each block meets
_LONG, _CACHED = 7, 1 << 19
_CUT, _HELD = 1, 2  # how lines end


class Filter(NamedTuple):
    """What damps short waves in the layers; without runs where nothing is damped."""

    taps: np.ndarray = reals(1)  # weight of the node itself along one axis, of both neighbours, and so on; (R + 1,)
    steps: np.ndarray = ints(0)  # distances in the box between neighbours along the axes
    # A place for every node in their natural order, with margins; zero where nothing is damped. It goes on for `SLACK`
    # values, as do the strengths: different lines of these along the last axis.
    box: np.ndarray = reals(0)
    strengths: np.ndarray = reals(0)
    # Pieces of neighbouring nodes: place in the box, place in a level, place of the first strength, number of nodes;
    # and how far away along each axis of the filter there may be damped nodes, as it meets only zeros beyond them;
    # shape (P, 4 + axes).
    runs: np.ndarray = ints(0, 7)
    # Places of the box that repeat what lies across periodic axes or before walls, the places repeated, and the sign.
    copies: np.ndarray = ints(3, 0)
    cut_nodes: np.ndarray = ints(0)  # places in a level of nodes on lines that are cut within the filter's length
    cut_ends: np.ndarray = ints(1)  # where their entries begin in the next two arrays, and where the last ones end
    cut_places: np.ndarray = ints(0)  # places of the box
    # Weights, with the node's strength, by which their values are subtracted in addition to what the filter passes.
    cut_weights: np.ndarray = reals(0)
    whole: bool = False  # whether the waves themselves are filtered, not only their increments
    every: int = 1  # steps from one use of the filter to the next, which damps by as much as one in each
    blocked: bool = False  # whether the pieces are in blocks whose lines stay in the cache, not in the nodes' order
    # Messages by which other processes fill margins of the box, as a kind of `Tables.exchange`; shape (3, 5).
    exchange: np.ndarray = NO_MESSAGES


def filter_tables(
    layout: Layout,
    rates: Mapping[tuple[int, int], np.ndarray],
    taps: np.ndarray,
    dt: float,
    real: np.dtype,
    whole: bool = False,
    every: int = 1,
) -> Filter:
    """Tables that `damp_short_waves` reads. `rates` are those at which each layer, by (axis, side) and from the near
    field outwards, damps what passes the filter; where layers meet they are added.
    """
    if not any(np.any(rate) for rate in rates.values()):
        return with_defaults(Filter, real, whole=whole)
    nodes, axes = layout.box.nodes, [a for a in range(3) if layout.reach[a]]
    pads, extent, step = _extents(layout, taps)
    along = _along(layout, rates)
    across, line = np.unique(np.add.outer(along[0], along[1]), return_inverse=True)
    rate = np.add.outer(across, along[2])
    strengths = np.sqrt(-np.expm1(-len(axes) * rate * every * dt) / len(axes))
    parts = [(pad + np.arange(n)) * s for pad, n, s in zip(pads, nodes, step, strict=True)]
    places = np.add.outer(np.add.outer(parts[0], parts[1]), parts[2])
    entries = np.add.outer(line.reshape(nodes[:2]) * nodes[2], np.arange(nodes[2]))
    damped = strengths.ravel()[entries] > 0
    runs = _runs(
        np.array([places[damped], layout.box.node_indices()[damped], entries[damped]]),
        _limits(layout, along, len(taps) - 1)[:, damped],
    )
    blocked = len(axes) == 3 and len(taps) > _LONG
    return with_defaults(
        Filter,
        real,
        taps=np.ascontiguousarray(taps, real),
        steps=step[axes],
        box=aligned_zeros(int(np.prod(extent)) + SLACK, real),
        strengths=np.append(strengths, np.zeros(SLACK)).astype(real),
        runs=_in_blocks(runs, step, len(taps), real.itemsize) if blocked else runs,
        copies=_wrapped(places[damped], layout, step, pads, extent, len(taps) - 1),
        whole=whole,
        every=every,
        blocked=blocked,
    )


def _extents(layout: Layout, taps: np.ndarray) -> tuple[list[int], list[int], np.ndarray]:
    """Along the axes: margins of the box before its nodes, its extents including the margins behind them, and the
    distances of neighbours; lines begin on cache lines.
    """
    pads = [len(taps) - 1 if reach else 0 for reach in layout.reach]
    extent = [n + 2 * pad for n, pad in zip(layout.box.nodes, pads, strict=True)]
    behind = pads[2]
    pads[2] = -(-behind // ALIGN) * ALIGN
    extent[2] = -(-(pads[2] + layout.box.nodes[2] + behind) // ALIGN) * ALIGN
    return pads, extent, np.array([extent[1] * extent[2], extent[2], 1])


def _limits(layout: Layout, along: Sequence[np.ndarray], reach: int) -> np.ndarray:
    """How many nodes away, at most `reach`, there may be damped ones along each axis, shape (axes, *nodes)."""
    nodes, limits = layout.box.nodes, []
    for axis in (a for a in range(3) if layout.reach[a]):
        limit, (core, low, high) = np.full(nodes[axis], reach), (layout.core[axis], layout.low[axis], layout.high[axis])
        if core >= reach and axis not in layout.periodic:
            for first, columns in ((0, low), (low + core, high)):
                i = np.arange(columns)
                limit[first : first + columns] = np.minimum(np.maximum(i, columns - 1 - i), reach)
        elsewhere = [np.zeros(1) if a == axis else rate for a, rate in enumerate(along)]
        # lines that another layer damps
        crossed = np.add.outer(np.add.outer(elsewhere[0], elsewhere[1]), elsewhere[2]) > 0
        limits.append(np.where(crossed, reach, limit.reshape([-1 if a == axis else 1 for a in range(3)])))
    return np.array(np.broadcast_arrays(*limits))


def _along(layout: Layout, rates: Mapping[tuple[int, int], np.ndarray]) -> list[np.ndarray]:
    """Damping rates along each axis."""
    nodes = layout.box.nodes
    along = [np.zeros(n) for n in nodes]
    for (axis, side), values in rates.items():
        end = slice(len(values)) if side < 0 else slice(nodes[axis] - len(values), None)
        along[axis][end] += values[::side]
    return along


def margin_across(
    layout: Layout, rates: Mapping[tuple[int, int], np.ndarray], taps: np.ndarray, axis: int, side: int
) -> np.ndarray:
    """Places of the box's margin on a side, where layers along other axes damp, and those that it repeats if the axis
    is periodic; shape (2, n).
    """
    pads, _, step = _extents(layout, taps)
    along = [rate * (a != axis) for a, rate in enumerate(_along(layout, rates))]
    n, far = layout.box.nodes[axis], len(taps) - 1
    beyond = np.arange(-far, 0) if side < 0 else np.arange(n, n + far)
    both = []
    for lines in (beyond, beyond % n):
        indices = [lines if a == axis else np.arange(len(rate)) for a, rate in enumerate(along)]
        parts = [(pad + index) * s for pad, index, s in zip(pads, indices, step, strict=True)]
        both.append(np.add.outer(np.add.outer(parts[0], parts[1]), parts[2]))
    rates_across = [np.zeros(len(beyond)) if a == axis else rate for a, rate in enumerate(along)]
    damped = np.add.outer(np.add.outer(rates_across[0], rates_across[1]), rates_across[2]) > 0
    return np.array([places[damped] for places in both])


def line_damping(rates: np.ndarray, taps: np.ndarray, dt: float, across: np.ndarray) -> np.ndarray:
    """``D F D`` along a layer's normal, which a step subtracts from the increments, for waves along the layer with
    wavenumbers `across` times the spacing, shape (..., dim - 1); shape (..., columns, columns).
    """
    axes = 1 + across.shape[-1]
    strengths = np.sqrt(-np.expm1(-axes * rates * dt) / axes)
    row = np.zeros(max(len(rates), len(taps)))
    row[: len(taps)] = taps
    places = np.arange(len(rates))
    along = (taps[0] + 2 * np.cos(across[..., None] * np.arange(1, len(taps))) @ taps[1:]).sum(-1)
    passed = row[np.abs(places[:, None] - places)] + along[..., None, None] * np.eye(len(rates))
    return np.asarray(strengths[:, None] * passed * strengths)


def _runs(rows: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Pieces in which all rows, the place in the box first, increase by one, as `Filter.runs`, for nodes in their
    order; shapes (3, nodes) and (axes, nodes).
    """
    parted = np.flatnonzero((np.diff(rows, prepend=rows[:, :1] - 2) != 1).any(0))
    ends = np.append(parted, rows.shape[1])[1:]
    first = np.concatenate([np.zeros(0, np.int64), *(np.arange(*at, _PIECE) for at in zip(parted, ends, strict=True))])
    if not first.size:
        return np.zeros((0, 4 + len(limits)), np.int64)
    counts = np.diff(first, append=rows.shape[1])
    return np.vstack([rows[:, first], counts, np.maximum.reduceat(limits, first, axis=1)]).T.copy()


def _in_blocks(runs: np.ndarray, step: np.ndarray, taps: int, size: int) -> np.ndarray:
    """Pieces in blocks of lines, within each block plane by plane: the planes that a long filter meets in 3D do not
    stay in the cache, but the lines of a block do.
    """
    lines = max(1, _CACHED // (2 * taps * int(step[1]) * size))
    plane, line = runs[:, 0] // step[0], runs[:, 0] % step[0] // step[1]
    return np.ascontiguousarray(runs[np.lexsort((runs[:, 0], plane, line // lines))])


def without(tables: Filter, spared: Callable[[np.ndarray], np.ndarray]) -> Filter:
    """The same filter without the nodes for which `spared`, a function of their places in a level, is true."""
    run, number = np.repeat(tables.runs, tables.runs[:, 3], axis=0), _numbers_in(tables.runs[:, 3])
    kept = ~spared(run[:, 1] + number)
    runs = _runs(run[kept, :3].T + number[kept], run[kept, 4:].T)
    if tables.blocked:
        runs = _in_blocks(runs, tables.steps, len(tables.taps), tables.box.itemsize)
    weights = np.where(np.repeat(spared(tables.cut_nodes), np.diff(tables.cut_ends)), 0, tables.cut_weights)
    return tables._replace(runs=runs, cut_weights=weights.astype(tables.box.dtype))


def _numbers_in(counts: np.ndarray) -> np.ndarray:
    """0, 1, ... within each of successive pieces of given lengths."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def _wrapped(
    places: np.ndarray, layout: Layout, step: np.ndarray, pads: list[int], extent: list[int], reach: int
) -> np.ndarray:
    """Margins of the box that repeat what lies across periodic axes, as `Filter.copies`."""
    copies = [np.zeros((3, 0), np.int64)]
    for axis in layout.periodic:
        count, margin = layout.core[axis], pads[axis]
        index = places // step[axis] % extent[axis]
        lines = places[index == margin] - margin * step[axis]
        beyond = np.concatenate([margin - reach + np.arange(reach), margin + count + np.arange(reach)])
        inside = margin + (beyond - margin) % count
        to, source = (np.add.outer(a * step[axis], lines).ravel() for a in (beyond, inside))
        copies.append(np.array([to, source, np.ones_like(to)]))
    return np.concatenate(copies, axis=1)


def filter_with_images(tables: Filter, layout: Layout, images: Mapping[tuple[int, int], int]) -> Filter:
    """The same filter, which beyond some sides meets mirror images of what lies before them: a wave along a side that
    is free, or that is held, ends there and is no short wave.

    `images` is 1 beyond a free side, whose mirror is half a node beyond the last one, and -1 beyond one that holds the
    nodes beyond it at zero, the first of which is the mirror.
    """
    pads, extent, step = _extents(layout, tables.taps)
    places = np.repeat(tables.runs[:, 0], tables.runs[:, 3]) + _numbers_in(tables.runs[:, 3])
    copies = [tables.copies]
    for axis in sorted({axis for axis, _ in images}):
        n, index = layout.box.nodes[axis], places // step[axis] % extent[axis] - pads[axis]
        low, high, far = images.get((axis, -1), 0), images.get((axis, 1), 0), len(tables.taps) - 1
        for beyond in (*range(-far, 0), *range(n, n + far)):
            source, sign = _image(beyond, n, low, high)
            here = places[index == source] if sign else places[:0]
            copies.append(np.array([here + (beyond - source) * step[axis], here, np.full(here.size, sign)]))
    return tables._replace(copies=np.concatenate(copies, axis=1))


def cut_links(tables: Filter, layout: Layout, ends: np.ndarray, exists: np.ndarray) -> Iterator[np.ndarray]:
    """Where lines of the filter's box end: for each of its axes, by place of the box, `_CUT` after places where the
    line is cut, or ends freely, `_HELD` at a side that holds the next node, else 0. `ends`, shape (2, n), are the
    places in a level of both ends of absent bonds, and `exists` says where nodes are.
    """
    box, (pads, _, step), strides = layout.box, _extents(layout, tables.taps), np.array(layout.box.stride)
    halo = np.array(layout.reach)
    for axis in (a for a in range(3) if layout.reach[a]):
        lower = ends.min(axis=0)[np.abs(ends[0] - ends[1]) == strides[axis]] - box.origin + halo @ strides
        at = np.array([lower // strides[0], lower % strides[0] // strides[1], lower % strides[1]]) - halo[:, None]
        first = np.where(np.arange(3) == axis, -1, 0)[:, None]
        at = at[:, ((at >= first) & (at < np.array(box.nodes)[:, None])).all(0)]
        if not exists.all():
            # the outer end of a layer, beyond which there are no nodes, is no cut
            along = [np.arange(n) for n in box.nodes]
            along[axis] = np.arange(-int(layout.low[axis] == 0), box.nodes[axis] + int(layout.high[axis] == 0))
            parts = [indices * stride for indices, stride in zip(along, strides, strict=True)]
            nodes = exists[box.origin + np.add.outer(np.add.outer(parts[0], parts[1]), parts[2])]
            rims = np.array(np.nonzero(np.diff(nodes, axis=axis)))
            at = np.concatenate([at, rims + np.array([indices[0] for indices in along])[:, None]], axis=1)
        cut = np.zeros_like(tables.box)
        cut[step @ (at + np.array(pads)[:, None])] = _CUT
        # the first image beyond a side that holds lies two nodes from what it repeats
        to, source, sign = tables.copies
        cut[np.minimum(source, to + step[axis])[(sign < 0) & (np.abs(to - source) == 2 * step[axis])]] = _HELD
        yield cut


def cut_filter(tables: Filter, ends: Sequence[np.ndarray]) -> Filter:
    """The same filter, for lines that end where they are cut. `ends` says for each axis after which places of the box,
    margins included, they do; see `cut_links`.
    """
    far, (sources, signs) = len(tables.taps) - 1, _repeated(tables)
    run, number = np.repeat(tables.runs, tables.runs[:, 3], axis=0), _numbers_in(tables.runs[:, 3])
    places, levels = run[:, 0] + number, run[:, 1] + number
    strengths = tables.strengths[run[:, 2] + number]
    entries: list[tuple[np.ndarray, ...]] = [(np.zeros(0, np.int64),) * 2 + (np.zeros(0),)]
    for link, step in zip(ends, tables.steps, strict=True):
        if not (link == _CUT).any():
            continue
        # nodes before the next end on each side, `far` where there is none as near
        ahead, behind = (
            np.argmax(np.stack([link[places + k * step] > 0 for k in distances] + [places >= 0]), axis=0)
            for distances in (range(far), range(-1, -1 - far, -1))
        )
        row = np.flatnonzero((ahead < far) | (behind < far))
        places_of, ahead, behind = places[row], ahead[row], behind[row]
        held = link[places_of + ahead * step] == _HELD, link[places_of - (behind + 1) * step] == _HELD
        for j in (*range(-far, 0), *range(1, far + 1)):
            distance, sign = _reflected(j, (ahead, behind), held, far)
            met, image = places_of + j * step, places_of + distance * step
            differs = (sources[met] != sources[image]) | (signs[met] != sign * signs[image])
            for source, amount in ((image, sign), (met, -np.ones_like(sign))):
                weight = amount * tables.taps[abs(j)] * strengths[row]
                entries.append((row[differs], source[differs], weight[differs]))
    rows, of_box, weights = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    order = np.argsort(rows, kind="stable")
    nodes, first = np.unique(rows[order], return_index=True)
    return tables._replace(
        cut_nodes=levels[nodes],
        cut_ends=np.append(first, len(rows)),
        cut_places=of_box[order],
        cut_weights=weights[order].astype(tables.box.dtype),
    )


def _reflected(
    place: int, free: tuple[np.ndarray, np.ndarray], held: tuple[np.ndarray, np.ndarray], far: int
) -> tuple[np.ndarray, np.ndarray]:
    """For lines with given numbers of nodes ahead and behind, and ends that are held or free: the distance from a node
    to the one that stands for a place, and its sign, 0 where none does.
    """
    at, sign = np.full(len(free[0]), place), np.ones(len(free[0]), np.int64)
    for _ in range(2 * far):  # a line may be as short as one node
        for side, last, holds in zip((1, -1), free, held, strict=True):
            beyond = side * at > last
            sign = np.where(beyond & holds, np.where(side * at == last + 1, 0, -sign), sign)
            at = np.where(beyond, side * (2 * last + 1 + holds) - at, at)
    return at, sign


def _repeated(tables: Filter) -> tuple[np.ndarray, np.ndarray]:
    """For each place of the box, the place whose value it repeats, and the sign."""
    sources, signs = np.arange(tables.box.size), np.ones(tables.box.size, np.int64)
    to, source, sign = tables.copies
    sources[to], signs[to] = source, sign
    return sources, signs


def _image(place: int, n: int, low: int, high: int) -> tuple[int, int]:
    """Which of n nodes on a line stands for a place beyond its ends, and with which sign; sign 0 where none does."""
    sign = 1
    while sign and not 0 <= place < n:
        side, wall, last = (-1, low, 0) if place < 0 else (1, high, n - 1)
        source = 2 * last + side * (1 if wall > 0 else 2) - place
        sign *= wall if source != place else 0  # the value on a mirror that holds is zero
        place = source
    return place, sign


@njit(error_model="numpy", cache=True, counted=False)
def met_by_others(thread, runs, chunk, far):
    """End of the first and beginning of the last of a thread's pieces that the filter meets from those of other
    threads.
    """
    lead, tail = chunk
    if thread.threads > 1:
        while lead < chunk[1] and runs[lead, 0] <= runs[chunk[0], 0] + far:
            lead += 1
        while tail > lead and runs[tail - 1, 0] >= runs[chunk[1] - 1, 0] - far:
            tail -= 1
    return lead, tail


@njit(error_model="numpy", cache=True, counted=False)
def weigh_pieces(runs, first, last, arrays, subtracted):
    """Put the increments of some pieces into the box, times the strengths."""
    box, level, before, strengths, size = arrays
    for piece in range(first, last):
        place, node, strength, count = runs[piece, 0], runs[piece, 1], runs[piece, 2], runs[piece, 3]
        # pieces lie too far apart for the hardware prefetcher
        ahead = runs[min(piece + _AHEAD, runs.shape[0] - 1), 1] * size
        fetch(level + ahead)
        fetch(before + ahead)
        at = level + node * size
        weigh_change(box + place * size, at, before + node * size, subtracted, strengths + strength * size, count)


@njit(error_model="numpy", cache=True, counted=False)
def damp_short_waves(thread, stage, tables):
    """Filter the increments of a step, ``out - src`` or `base`, or both levels; one thread's chunk."""
    # Each kind of row is called here once: it is long machine code, compiled again in every function that calls it.
    taps, steps, box, runs, copies = tables.taps, tables.steps, tables.box, tables.runs, tables.copies
    like = stage.out[0]
    size, apart = stage.out.itemsize, stage.src.nbytes // stage.components
    out, src, base = stage.out.ctypes.data, stage.src.ctypes.data, stage.base.ctypes.data
    past = base if stage.increments else src
    places, weights, filtered = box.ctypes.data, tables.strengths.ctypes.data, taps.ctypes.data
    passes = 2 if tables.whole else 1
    subtracted = stage.out.dtype.type(0 if tables.whole else 1)
    chunk = chunk_of(thread, runs.shape[0])
    # Pieces are weighed when they are needed, so that their values are still in the cache when they are filtered; those
    # that other threads meet come first, or all where the box has copies or is filtered in blocks.
    far = steps[0] * (taps.size - 1) + _PIECE
    lead, tail = met_by_others(thread, runs, chunk, far)
    if (
        tables.blocked
        or copies.shape[1]
        or tables.exchange[0, USED]
        or tables.exchange[1, USED]
        or tables.exchange[2, USED]
    ):
        lead = tail
    for turn in range(passes * stage.components):
        shift = turn // passes * apart
        level = (past if turn % passes else out) + shift
        arrays = places, level, src + shift, weights, size
        weigh_pieces(runs, chunk[0], lead, arrays, subtracted)
        weigh_pieces(runs, tail, chunk[1], arrays, subtracted)
        barrier(thread)
        if copies.shape[1]:
            for i in range(thread.number, copies.shape[1], thread.threads):
                box[copies[0, i]] = copies[2, i] * box[copies[1, i]]
            barrier(thread)
        for axis in range(3):
            messages = tables.exchange[axis]
            if messages[USED] != 0:
                if thread.number == 0:
                    for function in (messages[SENDS], messages[RECEIVES]):
                        call_exchange(function, messages[TABLE], np.int64(places), np.int64(1), np.int64(box.nbytes))
                barrier(thread)
        # What is taken leaves the level and, where they are stored, the increments.
        older, weighed = base + shift - level if stage.increments and not tables.whole else 0, lead
        for piece in range(chunk[0], chunk[1], TOGETHER):
            number, first = min(TOGETHER, chunk[1] - piece), weighed
            while weighed < tail and runs[weighed, 0] <= runs[piece + number - 1, 0] + far:
                weighed += 1
            weigh_pieces(runs, first, weighed, arrays, subtracted)
            if older != 0:
                for i in range(piece + _AHEAD, min(piece + _AHEAD + TOGETHER, chunk[1])):
                    fetch(level + older + runs[i, 1] * size)
            of_piece = runs.ctypes.data + piece * runs.strides[0]
            take_passed(
                of_piece, number, (places, weights, level), steps.ctypes.data, steps.size, filtered, older, like
            )
        barrier(thread)
        if tables.cut_nodes.size:
            for i in range(thread.number, tables.cut_nodes.size, thread.threads):
                taken = like - like
                for entry in range(tables.cut_ends[i], tables.cut_ends[i + 1]):
                    taken += tables.cut_weights[entry] * box[tables.cut_places[entry]]
                node = tables.cut_nodes[i] + turn // passes * (stage.src.size // stage.components)
                if turn % passes == 0:
                    stage.out[node] -= taken
                if stage.increments and (turn % passes or not tables.whole):
                    stage.base[node] -= taken
                elif turn % passes:
                    stage.src[node] -= taken
            barrier(thread)


@reads("filter")
def filter_layers(thread, stage, sums, tables, inputs, step, number):
    """Damp short waves in the layers."""
    if (inputs.before[0] + step + 1) % tables.filter.every == 0:
        damp_short_waves(thread, stage, tables.filter)


def damping_of(engine: Field) -> tuple[dict[tuple[int, int], np.ndarray], np.ndarray]:
    """Rates at which layers damp short waves, from the near field outwards, and the filter."""
    rates = {
        name: layer.damping if layer.filtered else np.zeros(layer.columns) for name, layer in engine.layers.items()
    }
    return rates, max((layer.taps for layer in engine.layers.values()), key=len, default=np.zeros(1))


def _of_layers(engine: Field) -> Filter:
    """Return the filter of short waves; all layers share the longest one, and what it is applied to."""
    rates, taps = damping_of(engine)
    whole = any(layer.whole for layer in engine.layers.values())
    every = max((layer.every for layer in engine.layers.values() if layer.filtered), default=0) or 1
    return filter_tables(engine.layout, rates, taps, engine.dt, engine.dtype, whole, every)


FILTER = Feature(
    "filter",
    [Step(CHANGE, filter_layers, lambda tables, *_: tables.filter.runs.size, whole=True)],
    table=Filter,
    made=_of_layers,
)


def set_images(engine: Field, images: Mapping[tuple[int, int], int]) -> None:
    """Let the filter of short waves see walls, given by the signs of their images, mirrored beyond them."""
    engine.replace(filter=filter_with_images(engine.tables.filter, engine.layout, images))
