"""The compiled time loop. This text is a template: `engine.build` writes it out once per stencil shape and number type.

`advance` runs many steps without returning to Python. A step is one or more *stages*; a stage sweeps every block
(``out = a*in + b*base + weights * neighbours``), applies the sparse corrections, and fills the halo of what it wrote.
Arrays named ``levels[l]`` are flat time levels laid out by `engine.layout`.
"""

import numpy as np
from numba import njit, prange

from farhorizon.engine.simd import row_group_sweep

SHAPE = ((0, 0, 1),)
REAL = "float64"
INCREMENTS = False
PARALLEL = False
HETEROGENEOUS = False
GROUP = (1, 1)
USE_SIMD = True

LINES = 32
CHUNK = 64
DTYPE = np.float64 if REAL == "float64" else np.float32
SIZE = 8 if REAL == "float64" else 4

sweep_group = row_group_sweep(SHAPE if USE_SIMD else SHAPE[:1], GROUP, REAL, INCREMENTS)
sweep_row = row_group_sweep(SHAPE if USE_SIMD else SHAPE[:1], (1, 1), REAL, INCREMENTS)


@njit(error_model="numpy", inline="always")
def bond_factor(rule, mine, other):
    """Coefficient of a bond from those of its ends: 0 both (min), 1 arithmetic, 2 harmonic."""
    if rule == 0:
        return min(mine, other)
    if rule == 1:
        return DTYPE(0.5) * (mine + other)
    total = mine + other
    return DTYPE(2.0) * mine * other / total if total > 0 else DTYPE(0.0)


@njit(error_model="numpy", cache=True)
def sweep_general(src, base, out, block, offsets, weights, a, b, row, coefficient, rule):
    """One row of any block with run-time offsets; the sum runs over differences."""
    i0, i1 = row // block[2], row % block[2]
    start = block[0] + i0 * block[6] + i1 * block[7]
    step = block[8]
    acc = np.empty(CHUNK, src.dtype)
    for first in range(0, block[3], CHUNK):
        n = min(CHUNK, block[3] - first)
        origin = start + first * step
        acc[:n] = 0
        for k in range(offsets.size):
            w = weights[k]
            at = origin + offsets[k]
            if step == 1:
                here, there = src[origin : origin + n], src[at : at + n]
                if HETEROGENEOUS:
                    c_here, c_there = coefficient[origin : origin + n], coefficient[at : at + n]
                    for i in range(n):
                        acc[i] += w * bond_factor(rule, c_here[i], c_there[i]) * (there[i] - here[i])
                else:
                    for i in range(n):
                        acc[i] += w * (there[i] - here[i])
            else:
                for i in range(n):
                    mine, other = origin + i * step, at + i * step
                    factor = bond_factor(rule, coefficient[mine], coefficient[other]) if HETEROGENEOUS else DTYPE(1.0)
                    acc[i] += w * factor * (src[other] - src[mine])
        for i in range(n):
            node = origin + i * step
            if INCREMENTS:
                base[node] = b * base[node] + acc[i]
                out[node] = src[node] + base[node]
            else:
                out[node] = a * src[node] + b * base[node] + acc[i]


@njit(error_model="numpy", cache=True)
def sweep_lines(src, base, out, block, weights, a, b, group):
    """One row group of a SIMD block, or the single rows left over at its edges."""
    groups1 = (block[2] + GROUP[1] - 1) // GROUP[1]
    i0, i1 = (group // groups1) * GROUP[0], (group % groups1) * GROUP[1]
    whole = block[6] == block[4] and block[7] == block[5] and i0 + GROUP[0] <= block[1] and i1 + GROUP[1] <= block[2]
    s0, s1, n, w = block[4], block[5], block[3], weights.ctypes.data
    if whole:
        shift = (block[0] + i0 * block[6] + i1 * block[7]) * SIZE
        sweep_group(src.ctypes.data + shift, base.ctypes.data + shift, out.ctypes.data + shift, w, a, b, n, s0, s1)
        return
    for j0 in range(i0, min(i0 + GROUP[0], block[1])):
        for j1 in range(i1, min(i1 + GROUP[1], block[2])):
            shift = (block[0] + j0 * block[6] + j1 * block[7]) * SIZE
            sweep_row(src.ctypes.data + shift, base.ctypes.data + shift, out.ctypes.data + shift, w, a, b, n, s0, s1)


@njit(error_model="numpy", inline="always")
def stretch(work, far, near, here, diagonal, memory, number, lines, r, e, f, remember):
    """One value of every line from its three neighbours in the (p, k) plane; the memory advances in place."""
    if remember:
        for i in range(lines):
            d = work[here[0], here[1], i] - work[diagonal[0], diagonal[1], i]
            n = memory[number + i]
            work[far[0], far[1], i] = work[near[0], near[1], i] + r * d - n
            memory[number + i] = e * n + f * d
    else:
        for i in range(lines):
            d = work[here[0], here[1], i] - work[diagonal[0], diagonal[1], i]
            work[far[0], far[1], i] = work[near[0], near[1], i] + r * d


@njit(error_model="numpy", inline="always")
def continue_lines(work, memory, store, m, kmax, columns, lines, r, e, f, remember):
    """U(p, k) for all k from U(p, 0) and the core's edge: outer end inwards for k > 0, outwards for k < 0 (the mirror image)."""
    number = store
    for k in range(kmax):
        for p in range(columns, -1, -1):
            stretch(work, (p, m + k + 1), (p + 1, m + k), (p, m + k), (p + 1, m + k + 1), memory, number, lines, r[p], e[p], f[p], remember)
            number += LINES
    for k in range(kmax):
        for p in range(columns):
            stretch(work, (p + 1, m - k - 1), (p, m - k), (p + 1, m - k), (p, m - k - 1), memory, number, lines, r[p], e[p], f[p], remember)
            number += LINES


@njit(error_model="numpy", inline="always")
def move(level, at, step, work, p, q, count, out):
    """Values of a bundle of lines from the level into the work space, or back."""
    if step == 1:
        line = level[at : at + count]
        if out:
            for i in range(count):
                line[i] = work[p, q, i]
        else:
            for i in range(count):
                work[p, q, i] = line[i]
    elif out:
        for i in range(count):
            level[at + i * step] = work[p, q, i]
    else:
        for i in range(count):
            work[p, q, i] = level[at + i * step]


@njit(error_model="numpy", cache=True)
def fill_task(level, memory, work, task, reach, r, e, f, remember):
    """Continue one bundle of lines into a layer: read the core's edge, write the core's halo and the layer's slots."""
    inner, inner_k, inner_line = task[0], task[1], task[2]
    layer, layer_p, layer_k, layer_line = task[3], task[4], task[5], task[6]
    count, store, kmax, columns = task[7], task[8], task[9], task[11]
    m = reach
    if count < LINES:  # idle lanes stay zero, so that the memory is a function of the state alone
        work[:, :, count:] = 0
    work[columns + 1] = 0
    for k in range(kmax + 1):
        move(level, inner - k * inner_k, inner_line, work, 0, m - k, count, False)
    for p in range(1, columns + 1):
        move(level, layer + (p - 1) * layer_p, layer_line, work, p, m, count, False)
    if count == 1:
        continue_lines(work, memory, store, m, kmax, columns, 1, r, e, f, remember)
    else:
        continue_lines(work, memory, store, m, kmax, columns, LINES, r, e, f, remember)
    for k in range(1, kmax + 1):
        move(level, inner + k * inner_k, inner_line, work, 0, m + k, count, True)
    for p in range(1, columns + 1):
        for k in range(1, kmax + 1):
            move(level, layer + (p - 1) * layer_p + k * layer_k, layer_line, work, p, m + k, count, True)
            move(level, layer + (p - 1) * layer_p - k * layer_k, layer_line, work, p, m - k, count, True)


@njit(error_model="numpy", parallel=PARALLEL, cache=True)
def fill(level, memory, work, copies, copy_ranges, tasks, task_ranges, reach, r, e, f, remember):
    """Fill all halos of one level, axis by axis."""
    for axis in range(3):
        for i in range(copy_ranges[axis], copy_ranges[axis + 1]):
            level[copies[0, i]] = level[copies[1, i]]
        first, last = task_ranges[axis], task_ranges[axis + 1]
        lanes = work.shape[0]
        for lane in prange(lanes):
            for t in range(first + lane, last, lanes):
                profile = tasks[t, 10]
                fill_task(level, memory, work[lane], tasks[t], reach[axis], r[profile], e[profile], f[profile], remember)


@njit(error_model="numpy", parallel=PARALLEL, cache=True)
def sweep(src, base, out, simd_blocks, simd_weights, general_blocks, general_offsets, general_weights, a, a_difference, b,
          coefficient, rule):  # fmt: skip
    """One stage on every block."""
    for number in range(simd_blocks.shape[0]):
        block = simd_blocks[number]
        groups = ((block[1] + GROUP[0] - 1) // GROUP[0]) * ((block[2] + GROUP[1] - 1) // GROUP[1])
        for group in prange(groups):
            sweep_lines(src, base, out, simd_blocks[number], simd_weights[number], a, b, group)
    for number in range(general_blocks.shape[0]):
        block = general_blocks[number]
        for row in prange(block[1] * block[2]):
            sweep_general(src, base, out, general_blocks[number], general_offsets[number], general_weights, a_difference, b,
                          row, coefficient, rule)  # fmt: skip


@njit(error_model="numpy", cache=True)
def advance(steps, phase, levels, memory, work, stages, numbers, simd_blocks, simd_weights, general_blocks, general_offsets,
            general_weights, copies, copy_ranges, tasks, task_ranges, reach, r, e, f, remember, coefficient, rule,
            cut_nodes, cut_neighbours, cut_weights, damped, damp_before, damp_after, damp_leak,
            source_nodes, source_fields, source_times):  # fmt: skip
    """Run `steps` steps from the rotation `phase`; the level that then holds the state is ``stages[phase', 0, 0]``.

    stages[phase, stage] = (in, base, out) levels; numbers[stage] = (a, a for differences, b, weight scale, source scale).
    source_times[step, stage, j] multiplies source_fields[j] on source_nodes.
    """
    per_step = stages.shape[1]
    for step in range(steps):
        for stage in range(per_step):
            src = levels[stages[phase, stage, 0]]
            base = levels[stages[phase, stage, 1]]
            out = levels[stages[phase, stage, 2]]
            a, a_difference, b, scale, source_scale = (numbers[stage, 0], numbers[stage, 1], numbers[stage, 2], numbers[stage, 3],
                                                       numbers[stage, 4])  # fmt: skip
            for i in range(damped.size):
                node = damped[i]
                if INCREMENTS:
                    base[node] *= damp_before[i]
                else:
                    base[node] = src[node] - (src[node] - base[node]) * damp_before[i]
            sweep(src, base, out, simd_blocks, simd_weights[stage], general_blocks, general_offsets, general_weights[stage],
                  a, a_difference, b, coefficient, rule)  # fmt: skip
            for i in range(cut_nodes.size):
                node = cut_nodes[i]
                lost = scale * cut_weights[i] * (src[cut_neighbours[i]] - src[node])
                out[node] -= lost
                if INCREMENTS:
                    base[node] -= lost
            for j in range(source_fields.shape[0]):
                amplitude = source_scale * source_times[step, stage, j]
                if amplitude != 0:
                    for i in range(source_nodes.size):
                        gain = amplitude * source_fields[j, i]
                        out[source_nodes[i]] += gain
                        if INCREMENTS:
                            base[source_nodes[i]] += gain
            for i in range(damped.size):
                node = damped[i]
                out[node] = src[node] + (out[node] - src[node]) * damp_after[i] - scale * damp_leak[i] * src[node]
                if INCREMENTS:
                    base[node] = out[node] - src[node]
            fill(out, memory, work, copies, copy_ranges, tasks, task_ranges, reach, r, e, f, remember)
        phase = (phase + 1) % stages.shape[0]
    return phase
