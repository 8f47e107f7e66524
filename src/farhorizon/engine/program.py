"""The compiled time loop. This text is a template: `engine.build` writes it out once for one thread and once for several.

`advance` runs many steps without returning to Python. A step is one or more *stages*; a stage sweeps every block
(``out = a*in + b*base + weights * neighbours``), applies the sparse corrections, and fills the halo of what it wrote.
Arrays named ``levels[l]`` are flat time levels laid out by `engine.layout`, ``slots`` the continued values of the layers.
"""

import numpy as np
from numba import njit, prange

from farhorizon.engine.layout import LINES
from farhorizon.engine.simd import call_sweep, stretch_lines

PARALLEL = False

CHUNK = 64

stretch_bundle = stretch_lines(LINES, True)
stretch_bundle_memoryless = stretch_lines(LINES, False)
stretch_line = stretch_lines(1, True)
stretch_line_memoryless = stretch_lines(1, False)


@njit(error_model="numpy", inline="always")
def bond_factor(rule, mine, other):
    """Coefficient of a bond from those of its ends: 0 both (min), 1 arithmetic, 2 harmonic."""
    if rule == 0:
        return min(mine, other)
    total = mine + other
    if rule == 1:
        return total / 2
    return 2 * mine * other / total if total > 0 else 0 * total


@njit(error_model="numpy", cache=True)
def sweep_general(src, base, out, start, to, count, offsets, weights, a, b, increments, coefficient, rule):
    """One row of any stencil with run-time offsets; the sum runs over differences."""
    acc = np.empty(CHUNK, src.dtype)
    for first in range(0, count, CHUNK):
        n = min(CHUNK, count - first)
        origin = start + first
        here = src[origin : origin + n]
        acc[:n] = 0
        for k in range(offsets.size):
            w = weights[k]
            at = origin + offsets[k]
            there = src[at : at + n]
            if coefficient.size > 1:
                c_here, c_there = coefficient[origin : origin + n], coefficient[at : at + n]
                for i in range(n):
                    acc[i] += w * bond_factor(rule, c_here[i], c_there[i]) * (there[i] - here[i])
            else:
                for i in range(n):
                    acc[i] += w * (there[i] - here[i])
        node = to + first
        if increments:
            for i in range(n):
                base[node + i] = b * base[node + i] + acc[i]
                out[node + i] = here[i] + base[node + i]
        else:
            for i in range(n):
                out[node + i] = a * here[i] + b * base[node + i] + acc[i]


@njit(error_model="numpy", cache=True)
def sweep_at(src, base, out, block, i0, i1, function, weights, offsets, general, a, a_difference, b, increments, coefficient, rule):  # fmt: skip
    """The row, or the group of rows, of a block that begins at (i0, i1); a stencil without compiled rows has function 0."""
    start, to = block[1] + i0 * block[5] + i1 * block[6], block[10] + i0 * block[11] + i1 * block[12]
    if function != 0:
        size = src.itemsize
        call_sweep(function, src.ctypes.data + start * size, base.ctypes.data + to * size, out.ctypes.data + to * size, weights.ctypes.data,
                   a, b, block[4], block[7], block[8], block[9], block[11], block[12])  # fmt: skip
    else:
        sweep_general(src, base, out, start, to, block[4], offsets, general, a_difference, b, increments, coefficient, rule)


@njit(error_model="numpy", cache=True)
def sweep_group(src, base, out, block, number, group, functions, weights, offsets, general, a, a_difference, b, increments, coefficient, rule):  # fmt: skip
    """A whole group of rows, or one by one the rows left over at the edge of a block."""
    g0, g1 = group
    n1 = (block[3] + g1 - 1) // g1
    i0, i1 = (number // n1) * g0, (number % n1) * g1
    if i0 + g0 <= block[2] and i1 + g1 <= block[3]:
        sweep_at(src, base, out, block, i0, i1, functions[0], weights, offsets, general, a, a_difference, b, increments, coefficient, rule)
        return
    for j0 in range(i0, min(i0 + g0, block[2])):
        for j1 in range(i1, min(i1 + g1, block[3])):
            sweep_at(src, base, out, block, j0, j1, functions[1], weights, offsets, general, a, a_difference, b, increments, coefficient, rule)


@njit(error_model="numpy", cache=True)
def count_groups(block, group):
    """Groups of rows in a block, those at its edge included."""
    return ((block[2] + group[0] - 1) // group[0]) * ((block[3] + group[1] - 1) // group[1])


@njit(error_model="numpy", parallel=PARALLEL, cache=True)
def sweep(src, slots, base, out, blocks, functions, groups, lanes, backward, weights, offsets, general, a, a_difference, b, increments,
          coefficient, slot_coefficient, rule):  # fmt: skip
    """One stage on every block: the core, then the layers."""
    count = count_groups(blocks[0], groups[0])
    first, move = (count - 1, -1) if backward else (0, 1)  # every other stage meets first what the last one left in the cache
    for i in prange(count):
        sweep_group(src, base, out, blocks[0], first + move * i, groups[0], functions[0], weights[0], offsets[0], general, a, a_difference, b, increments,
                    coefficient, rule)  # fmt: skip
    if blocks.shape[0] > 1:
        for lane in prange(lanes):
            for k in range(1, blocks.shape[0]):
                for number in range(lane, count_groups(blocks[k], groups[k]), lanes):
                    sweep_group(slots, base, out, blocks[k], number, groups[k], functions[k], weights[k], offsets[k], general, a, a_difference, b,
                                increments, slot_coefficient, rule)  # fmt: skip


@njit(error_model="numpy", cache=True)
def stretch(work, far, near, here, diagonal, memory, r, e, f, single, remember):
    """One value of every line from its three neighbours in the (p, k) plane, given by their places in `work`."""
    size = work.itemsize
    start, cell = work.ctypes.data, LINES * size
    far, near, here, diagonal = start + far * cell, start + near * cell, start + here * cell, start + diagonal * cell
    if single:
        if remember:
            stretch_line(far, near, here, diagonal, memory, r, e, f)
        else:
            stretch_line_memoryless(far, near, here, diagonal, memory, r, e, f)
    elif remember:
        stretch_bundle(far, near, here, diagonal, memory, r, e, f)
    else:
        stretch_bundle_memoryless(far, near, here, diagonal, memory, r, e, f)


@njit(error_model="numpy", cache=True)
def continue_lines(work, memory, m, kmax, columns, r, e, f, single, remember):
    """U(p, k) for all k from U(p, 0) and the core's edge: outer end inwards for k > 0, outwards for k < 0 (the mirror image)."""
    row, next_cell = work.shape[1], LINES * work.itemsize
    for k in range(kmax):
        for p in range(columns, -1, -1):
            here, diagonal = p * row + m + k, (p + 1) * row + m + k + 1
            stretch(work, here + 1, diagonal - 1, here, diagonal, memory, r[p], e[p], f[p], single, remember)
            memory += next_cell
    for k in range(kmax):
        for p in range(columns):
            here, diagonal = (p + 1) * row + m - k, p * row + m - k - 1
            stretch(work, here - 1, diagonal + 1, here, diagonal, memory, r[p], e[p], f[p], single, remember)
            memory += next_cell


@njit(error_model="numpy", inline="always")
def move(array, at, step, work, p, q, count, out):
    """Values of a bundle of lines from an array into the work space, or back."""
    if step == 1:
        line = array[at : at + count]
        if out:
            for i in range(count):
                line[i] = work[p, q, i]
        else:
            for i in range(count):
                work[p, q, i] = line[i]
    elif out:
        for i in range(count):
            array[at + i * step] = work[p, q, i]
    else:
        for i in range(count):
            work[p, q, i] = array[at + i * step]


@njit(error_model="numpy", cache=True)
def fill_task(inside, slots, memory, work, task, reach, r, e, f, remember):
    """Continue one bundle of lines into a layer: read the edge of what lies inside, write its halo and the layer's slots."""
    inner, inner_k, inner_line = task[0], task[1], task[2]
    layer, layer_p, layer_k, layer_line = task[3], task[4], task[5], task[6]
    count, store, kmax, columns = task[7], task[8], task[9], task[11]
    m = reach
    if count < LINES:  # idle lanes stay zero, so that the memory is a function of the state alone
        work[:, :, count:] = 0
    work[columns + 1] = 0
    for k in range(kmax + 1):
        move(inside, inner - k * inner_k, inner_line, work, 0, m - k, count, False)
    for p in range(1, columns + 1):
        move(slots, layer + (p - 1) * layer_p, layer_line, work, p, m, count, False)
    continue_lines(work, memory.ctypes.data + store * memory.itemsize, m, kmax, columns, r, e, f, count == 1, remember)
    for k in range(1, kmax + 1):
        move(inside, inner + k * inner_k, inner_line, work, 0, m + k, count, True)
    for p in range(1, columns + 1):
        for k in range(1, kmax + 1):
            move(slots, layer + (p - 1) * layer_p + k * layer_k, layer_line, work, p, m + k, count, True)
            move(slots, layer + (p - 1) * layer_p - k * layer_k, layer_line, work, p, m - k, count, True)


@njit(error_model="numpy", parallel=PARALLEL, cache=True)
def fill(level, slots, memory, work, blocks, copies, copy_ranges, tasks, task_ranges, reach, r, e, f, remember):
    """Fill all halos of one level and the slots of the layers, axis by axis."""
    lanes = work.shape[0]
    if blocks.shape[0] > 1:
        for lane in prange(lanes):
            for number in range(1, blocks.shape[0]):
                block = blocks[number]
                for row in range(lane, block[2] * block[3], lanes):
                    i0, i1 = row // block[3], row % block[3]
                    to, at = block[1] + i0 * block[5] + i1 * block[6], block[10] + i0 * block[11] + i1 * block[12]
                    for i in range(block[4]):
                        slots[to + i] = level[at + i]
    for axis in range(3):
        for i in range(copy_ranges[axis], copy_ranges[axis + 1]):
            to, at = copies[0, i], copies[1, i]
            if to < level.size:
                level[to] = level[at]
            else:
                slots[to - level.size] = slots[at - level.size]
        first, last = task_ranges[axis], task_ranges[axis + 1]
        if first < last:
            for lane in prange(lanes):
                for t in range(first + lane, last, lanes):
                    profile = tasks[t, 10]
                    inside = slots if tasks[t, 12] else level
                    fill_task(inside, slots, memory, work[lane], tasks[t], reach[axis], r[profile], e[profile], f[profile], remember)


@njit(error_model="numpy", cache=True)
def advance(steps, phase, levels, slots, memory, work, stages, numbers, increments, blocks, functions, groups, weights, offsets, general,
            copies, copy_ranges, tasks, task_ranges, reach, r, e, f, remember, coefficient, slot_coefficient, rule,
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
                if increments:
                    base[node] *= damp_before[i]
                else:
                    base[node] = src[node] - (src[node] - base[node]) * damp_before[i]
            sweep(src, slots, base, out, blocks, functions, groups, work.shape[0], (phase + stage) % 2 == 1, weights[stage], offsets, general[stage],
                  a, a_difference, b, increments, coefficient, slot_coefficient, rule)  # fmt: skip
            for i in range(cut_nodes.size):
                node, other = cut_nodes[i], cut_neighbours[i]
                end = src[other] if other < src.size else slots[other - src.size]
                lost = scale * cut_weights[i] * (end - src[node])
                out[node] -= lost
                if increments:
                    base[node] -= lost
            for j in range(source_fields.shape[0]):
                amplitude = source_scale * source_times[step, stage, j]
                if amplitude != 0:
                    for i in range(source_nodes.size):
                        gain = amplitude * source_fields[j, i]
                        out[source_nodes[i]] += gain
                        if increments:
                            base[source_nodes[i]] += gain
            for i in range(damped.size):
                node = damped[i]
                out[node] = src[node] + (out[node] - src[node]) * damp_after[i] - scale * damp_leak[i] * src[node]
                if increments:
                    base[node] = out[node] - src[node]
            fill(out, slots, memory, work, blocks, copies, copy_ranges, tasks, task_ranges, reach, r, e, f, remember)
        phase = (phase + 1) % stages.shape[0]
    return phase
