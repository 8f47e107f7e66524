"""Linear correspondence elasticity on a box of nodes: deformation gradient, stress, divergence, memory of the layers,
bonds that break.

Fields are flat arrays, one row a component, over the box with a halo of one reach on every side; what stands in the
halo is zero. Along the last axis rows are cut into *tiles* of at most `TILE` nodes, each wholly inside or wholly
outside the layers. Tiles whose nodes have all their bonds share one shape tensor, and are summed over pairs of opposite
bonds in registers; of *incomplete* tiles the bonds are kept as bits, with the inverse shape tensors, and where a node
lacks some its sums are done anew, bond by bond. Nodes in layers have memory. Both are arrays over such nodes only.

The constants of the material stand in rows, one value a node, or, where all nodes are alike, one tile of values that
serves all of them.

A step has two parts, between which threads meet: from displacements to stresses (where bonds break), and from stresses
to displacements. With bonds xi and weights w (influence function times volume, scaled so that the shape tensor K = sum
w xi xi of an intact node is 1), the deformation gradient less 1 is e = (sum w (u_j - u_i) xi) K^-1 and the acceleration
sum w (P_i + P_j) xi, P = stress K^-1 / density: minus the transpose of the gradient (Silling et al. 2007; Wildman and
Gazonas 2012, eqs 2-6 to 2-14).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.rows.vectors import Vectors
from farhorizon.engine.threads import barrier, share

TILE = 256
#: Kinds of a tile, to be added: bonds missing, in a layer, may break, under load.
INCOMPLETE, LAYER, BREAKABLE, LOADED = 1, 2, 4, 8
#: Rows of the constants: Lame's, the shear modulus and the stabilisation of a bond, all over the reference density;
#: this over the
#: node's density, and the inverse.
LAME, SHEAR, PULL, LIGHTNESS, MASS = range(5)
#: What is added up over time, by thread: of the last whole step the kinetic and the strain energy; since the start the
#: rest.
KINETIC, STRAIN, WORK, BROKEN, DRAG, OUTFLOW, PENDING_WORK, PENDING_OUTFLOW, BONDS, TERMS = range(10)
_UNROLLED = 2  # vectors of sums that go through the bonds together
CHUNK = _UNROLLED * 8  # nodes that are summed at a time: rows are read so far beyond their end

# Sums may be taken in vectors; never where a bond's two ends must agree. What may be summed in any order is inlined: of
# two copies, one by itself and one in its caller, the compiler makes different code, and which of them runs depends on
# what the process has compiled before.
_ANY_ORDER = {"reassoc", "contract", "nsz"}

_I64 = ir.IntType(64)


def _pair_sums(fields: int, outputs: int) -> Any:
    """Intrinsic that adds up differences over pairs of opposite bonds, ``out_g += w_kg (src(i + o_k) - src(i - o_k))``.

    One field and several sums with weights of their own (a gradient), or several fields, each with weights of its own,
    and one sum (a divergence). Takes byte addresses of the first node in `src`, of the distances (int64) and the
    weights, and of `out`, the distance of fields in bytes, how many weights a bond has, the number of pairs and of
    nodes, which is rounded up to `CHUNK`; the sums stand `TILE` apart.
    """

    @intrinsic
    def sums(typingctx, src, apart, offsets, weights, row, pairs, out, nodes):
        def codegen(context: Any, builder: ir.IRBuilder, signature: Any, args: tuple[Any, ...]) -> Any:
            src, apart, offsets, weights, row, pairs, out, nodes = args
            vectors = Vectors.of(builder, "float64")
            wide = vectors.lanes * vectors.size
            zero = ir.Constant(vectors.type, [0.0] * vectors.lanes)
            totals = [[cgutils.alloca_once(builder, vectors.type) for _ in range(_UNROLLED)] for _ in range(outputs)]
            with cgutils.for_range_slice(builder, _I64(0), nodes, _I64(CHUNK), _I64) as (first, _):
                at = builder.mul(first, _I64(vectors.size))
                for total in totals:
                    for vector in total:
                        builder.store(zero, vector)
                with cgutils.for_range(builder, pairs) as loop:
                    ahead = builder.mul(
                        builder.load(vectors.pointer(vectors.shifted(offsets, (1, loop.index)), _I64)),
                        _I64(vectors.size),
                    )
                    factors = vectors.splat_all(
                        vectors.shifted(weights, (1, builder.mul(loop.index, row))), max(fields, outputs)
                    )
                    for field in range(fields):
                        here = builder.add(builder.add(src, builder.mul(apart, _I64(field))), at)
                        plus, minus = builder.add(here, ahead), builder.sub(here, ahead)
                        for number in range(_UNROLLED):
                            move = _I64(number * wide)
                            difference = builder.fsub(
                                vectors.load(builder.add(plus, move)), vectors.load(builder.add(minus, move))
                            )
                            for output in range(outputs):
                                total = totals[output][number]
                                factor = factors[max(field, output)]
                                builder.store(vectors.multiply_add(builder.load(total), factor, difference), total)
                for output in range(outputs):
                    for number in range(_UNROLLED):
                        place = builder.add(builder.add(out, at), _I64(output * TILE * vectors.size + number * wide))
                        vectors.store(builder.load(totals[output][number]), place)
            return context.get_dummy_value()

        return types.void(*[types.int64] * 8), codegen

    return sums


_sum_1 = _pair_sums(1, 1)
_gradient_2, _gradient_3 = _pair_sums(1, 2), _pair_sums(1, 3)
_divergence_2, _divergence_3 = _pair_sums(2, 1), _pair_sums(3, 1)


@njit(error_model="numpy", cache=True)
def gradient(u, start, count, pairs, weights, out):
    """Sums ``w_kb (u_a(i + o_k) - u_a(i - o_k))`` of `count` nodes from `start` on: row ``a dim + b`` of `out`, shape
    (dim^2, TILE).
    """
    dim = weights.shape[1]
    for a in range(dim):
        here, to = (
            np.int64(u.ctypes.data) + 8 * (a * u.shape[1] + start),
            np.int64(out.ctypes.data) + 8 * a * dim * TILE,
        )
        distances, factors = np.int64(pairs.ctypes.data), np.int64(weights.ctypes.data)
        if dim == 2:
            _gradient_2(here, 0, distances, factors, dim, pairs.size, to, count)
        else:
            _gradient_3(here, 0, distances, factors, dim, pairs.size, to, count)


@njit(error_model="numpy", cache=True)
def divergence(p, start, count, pairs, weights, out):
    """Sums ``w_kb (P_ab(i + o_k) - P_ab(i - o_k))`` over k and b: row a of `out`, shape (dim, TILE)."""
    dim = weights.shape[1]
    for a in range(dim):
        here, to = (
            np.int64(p.ctypes.data) + 8 * (a * dim * p.shape[1] + start),
            np.int64(out.ctypes.data) + 8 * a * TILE,
        )
        distances, factors = np.int64(pairs.ctypes.data), np.int64(weights.ctypes.data)
        if dim == 2:
            _divergence_2(here, 8 * p.shape[1], distances, factors, dim, pairs.size, to, count)
        else:
            _divergence_3(here, 8 * p.shape[1], distances, factors, dim, pairs.size, to, count)


@njit(error_model="numpy", cache=True)
def split_divergence(p, start, count, pairs, weights, out):
    """The same with the directions b apart: row ``a dim + b`` of `out`."""
    dim = weights.shape[1]
    for number in range(dim * dim):
        here, to = (
            np.int64(p.ctypes.data) + 8 * (number * p.shape[1] + start),
            np.int64(out.ctypes.data) + 8 * number * TILE,
        )
        _sum_1(
            here,
            0,
            np.int64(pairs.ctypes.data),
            np.int64(weights.ctypes.data) + 8 * (number % dim),
            dim,
            pairs.size,
            to,
            count,
        )


@njit(error_model="numpy", inline="always")
def _whole(bits, node, bond):
    """Whether a bond of a node of a tile is there."""
    return (bits[bond >> 6, node] >> np.uint64(bond & 63)) & np.uint64(1) != 0


@njit(error_model="numpy", inline="always")
def _complete(bits, node, full):
    """Whether a node has all its bonds."""
    for word in range(full.size):
        if bits[word, node] != full[word]:
            return False
    return True


@njit(error_model="numpy", cache=True, entry=False)
def incomplete_gradient(u, i, node, bonds, weights, bits, inverse, total, out):
    """Gradient of u at node i, which is `node` among those of incomplete tiles, over the bonds that are there:
    ``out[a dim + b]``.
    """
    dim = weights.shape[1] - 1
    total[: dim * dim] = 0
    for k in range(bonds.size):
        if _whole(bits, node, k):
            for a in range(dim):
                difference = u[a, i + bonds[k]] - u[a, i]
                for b in range(dim):
                    total[a * dim + b] += weights[k, b] * difference
    for a in range(dim):
        for b in range(dim):
            out[a * dim + b] = 0.0
            for c in range(dim):
                out[a * dim + b] += total[a * dim + c] * inverse[c * dim + b, node]


@njit(error_model="numpy", cache=True, entry=False)
def incomplete_divergence(p, i, node, bonds, weights, bits, out):
    """Sums ``w_kb (P_ab(i) + P_ab(i + o_k))`` at node i, `node` among those of incomplete tiles, over the bonds that
    are there: ``out[a dim + b]``.
    """
    dim = weights.shape[1] - 1
    for number in range(dim * dim):
        total = 0.0
        for k in range(bonds.size):
            if _whole(bits, node, k):
                total += weights[k, number % dim] * (p[number, i] + p[number, i + bonds[k]])
        out[number] = total


@njit(error_model="numpy", cache=True, entry=False)
def shape_inverse(node, weights, steps, bits, inverse):
    """Inverse shape tensor of a node from the bonds that are there; zero where its determinant is below a thousandth of
    that of an intact one.
    """
    dim = weights.shape[1] - 1
    k00, k01, k02, k11, k12, k22 = 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
    if dim == 3:
        k22 = 0.0
    for k in range(weights.shape[0]):
        if _whole(bits, node, k):
            k00 += weights[k, 0] * steps[k, 0]
            k01 += weights[k, 0] * steps[k, 1]
            k11 += weights[k, 1] * steps[k, 1]
            if dim == 3:
                k02 += weights[k, 0] * steps[k, 2]
                k12 += weights[k, 1] * steps[k, 2]
                k22 += weights[k, 2] * steps[k, 2]
    c00, c01, c02 = k11 * k22 - k12 * k12, k02 * k12 - k01 * k22, k01 * k12 - k02 * k11
    determinant = k00 * c00 + k01 * c01 + k02 * c02
    inverse[:, node] = 0
    if determinant < 1e-3:
        return
    inverse[0, node] = c00 / determinant
    inverse[1, node] = inverse[dim, node] = c01 / determinant
    inverse[dim + 1, node] = (k00 * k22 - k02 * k02) / determinant
    if dim == 3:
        inverse[2, node] = inverse[6, node] = c02 / determinant
        inverse[5, node] = inverse[7, node] = (k01 * k02 - k00 * k12) / determinant
        inverse[8, node] = (k00 * k11 - k01 * k01) / determinant


@njit(error_model="numpy", cache=True)
def shape_inverses(tiles, weights, steps, bits, inverse):
    """Inverse shape tensors of all incomplete tiles."""
    for tile in range(tiles.shape[0]):
        if tiles[tile, 4] >= 0:
            for node in range(tiles[tile, 4], tiles[tile, 4] + tiles[tile, 1]):
                shape_inverse(node, weights, steps, bits, inverse)


@njit(error_model="numpy", cache=True, entry=False)
def _node_energy(u, v, dt, i, node, medium, bonds, bits, inverse, total, e, rate):
    """Strain energy of node i, `node` among those of incomplete tiles, less half a step of its power: what breaking
    takes from it.
    """
    distances, weights, steps = bonds
    dim = weights.shape[1] - 1
    at = medium[1] * i
    lame, shear, pull = medium[0][LAME, at], medium[0][SHEAR, at], medium[0][PULL, at]
    incomplete_gradient(u, i, node, distances, weights, bits, inverse, total, e)
    incomplete_gradient(v, i, node, distances, weights, bits, inverse, total, rate)
    trace, speed = 0.0, 0.0
    for a in range(dim):
        trace += e[a * dim + a]
        speed += rate[a * dim + a]
    energy = lame * trace * (trace - dt * speed)
    for a in range(dim):
        for b in range(dim):
            energy += shear * (e[a * dim + b] + e[b * dim + a]) * (e[a * dim + b] - dt * rate[a * dim + b])
    if pull > 0:
        for k in range(distances.size):
            if _whole(bits, node, k):
                j = i + distances[k]
                for a in range(dim):
                    rest, moving = u[a, j] - u[a, i], v[a, j] - v[a, i]
                    for b in range(dim):
                        rest -= e[a * dim + b] * steps[k, b]
                        moving -= rate[a * dim + b] * steps[k, b]
                    energy += pull * weights[k, dim] * rest * (rest - dt * moving)
    return energy / 2


@njit(error_model="numpy", inline="always")
def _length(u, i, distance, step):
    """Squared length of a bond, the same from both ends to the last bit."""
    squared = 0.0
    for a in range(step.size):
        squared += (step[a] + (u[a, i + distance] - u[a, i])) ** 2
    return squared


@njit(error_model="numpy", inline="always")
def _inside(tile, node, triple, low, high):
    """Whether both ends of a bond lie where bonds may break."""
    inside = True
    for axis in range(3):
        at = tile[5 + axis] + (node if axis == 2 else 0)
        inside = inside and low[axis] <= at < high[axis] and low[axis] <= at + triple[axis] < high[axis]
    return inside


@njit(error_model="numpy", cache=True)
def largest_stretch(u, tiles, bonds, triples, slots, fracture):
    """Largest stretch of the bonds that may break."""
    distances, _, steps = bonds
    largest = 0.0
    for number in range(tiles.shape[0]):
        tile = tiles[number]
        if tile[2] & BREAKABLE:
            for node in range(tile[1]):
                for k in range(distances.size):
                    if _whole(slots[0], tile[4] + node, k) and _inside(
                        tile, node, triples[k], fracture[1], fracture[2]
                    ):
                        ratio = _length(u, tile[0] + node, distances[k], steps[k]) / np.sum(steps[k] ** 2)
                        largest = max(largest, ratio)
    return np.sqrt(largest) - 1


@njit(error_model="numpy", cache=True, entry=False)
def _any_beyond(u, start, count, distances, steps, limits, work):
    """Whether a bond of these nodes is longer than its limit; without branches, for it is asked of every tile that may
    break, in every step.
    """
    dim = steps.shape[1]
    found = 0
    for k in range(distances.size):
        length = work[0]
        length[:count] = 0
        for a in range(dim):
            here, there = u[a, start : start + count], u[a, start + distances[k] : start + distances[k] + count]
            across = steps[k, a]
            for i in range(count):
                length[i] += (across + (there[i] - here[i])) ** 2
        for i in range(count):
            found += length[i] > limits[k]
    return found > 0


@njit(error_model="numpy", cache=True, entry=False)
def _break_bonds(u, v, dt, tile, medium, bonds, triples, bits, inverse, fracture, balance, work):
    """Break the bonds of a tile's nodes that are longer than their limit; whether any did.

    A bond is looked at from both ends, which see the same length to the last bit. It breaks only if both lie where
    bonds may break.
    """
    distances, weights, steps = bonds
    limits, low, high, kept = fracture
    start, count = tile[0], tile[1]
    if not _any_beyond(u, start, count, distances, steps, limits, work):
        return False
    total, e, rate = work[0], work[1], work[2]
    any_broken = False
    for node in range(count):
        before, lost, place = 0.0, 0, tile[4] + node
        for k in range(distances.size):
            if not _whole(bits, place, k):
                continue
            if not _length(u, start + node, distances[k], steps[k]) > limits[k] or not _inside(
                tile, node, triples[k], low, high
            ):
                continue
            if lost == 0:
                before = _node_energy(u, v, dt, start + node, place, medium, bonds, bits, inverse, total, e, rate)
            bits[k >> 6, place] &= ~(np.uint64(1) << np.uint64(k & 63))
            lost += 1
        if lost:
            any_broken = True
            if not kept:
                shape_inverse(place, weights, steps, bits, inverse)
            balance[BONDS] += lost
            balance[BROKEN] += before - _node_energy(
                u, v, dt, start + node, place, medium, bonds, bits, inverse, total, e, rate
            )
    return any_broken


@njit(error_model="numpy", cache=True, entry=False)
def _smooth(v, out, tile, distances, bits, full, drag, work):
    """Velocities of a tile moved by `drag` towards the mean of their neighbours (Wildman and Gazonas 2012, eq. 3-4)."""
    start, count = tile[0], tile[1]
    for a in range(v.shape[0]):
        here, new, total = v[a, start : start + count], out[a, start : start + count], work[0]
        total[:count] = 0
        for k in range(distances.size):
            there = v[a, start + distances[k] : start + distances[k] + count]
            for i in range(count):
                total[i] += there[i]
        for i in range(count):
            new[i] = here[i] + drag * (total[i] / distances.size - here[i])
        if tile[2] & INCOMPLETE:
            for i in range(count):
                if not _complete(bits, tile[4] + i, full):
                    left, number = 0.0, 0
                    for k in range(distances.size):
                        if _whole(bits, tile[4] + i, k):
                            left += v[a, start + i + distances[k]]
                            number += 1
                    new[i] = here[i] + drag * (left / number - here[i]) if number else here[i]


@njit(error_model="numpy", cache=True, entry=False)
def _plain_strain(u, tile, pairs, bonds, slots, work):
    """Gradient of the displacements of a tile into ``work[:dim^2]``: as of intact nodes, then anew where bonds are
    missing.
    """
    gradient(u, tile[0], tile[1], pairs[0], pairs[1], work)
    if tile[2] & INCOMPLETE:
        bits, inverse, full = slots
        total, e = np.zeros(9), np.zeros(9)
        for node in range(tile[1]):
            if not _complete(bits, tile[4] + node, full):
                incomplete_gradient(u, tile[0] + node, tile[4] + node, bonds[0], bonds[1], bits, inverse, total, e)
                for row in range(u.shape[0] ** 2):
                    work[row, node] = e[row]


@njit(error_model="numpy", cache=True, entry=False)
def _stretch(tile, rows, first_row, layers, first, work):
    """Stretch the derivatives in ``work[:rows]``, direction ``row % dim``: m <- keep m + gain (new + old) is added to
    each (the trapezoidal rule).

    One number a derivative is remembered, keep m + gain old, ready for the next step. At the first step there is no
    memory yet.
    """
    memory, keep, gain, _ = layers
    slot, dim = tile[3], keep.shape[0]
    for row in range(rows):
        value, past = work[row], memory[first_row + row, slot : slot + tile[1]]
        kept, gained = keep[row % dim, slot : slot + tile[1]], gain[row % dim, slot : slot + tile[1]]
        if first:
            for i in range(tile[1]):
                past[i] = -gained[i] * value[i]
        for i in range(tile[1]):
            added = past[i] + gained[i] * value[i]
            past[i] = kept[i] * added + gained[i] * value[i]
            value[i] += added


@njit(error_model="numpy", fastmath=_ANY_ORDER, forceinline=True, cache=True, entry=False)
def _stress(tile, dim, medium, work):
    """Stress over the reference density into ``work[2 dim^2:]`` from the gradient in ``work[:dim^2]``; the strain
    energy of the nodes.
    """
    rows, count, at = dim * dim, tile[1], medium[1] * tile[0]
    lame, shear = medium[0][LAME, at : at + count], medium[0][SHEAR, at : at + count]
    energy = 0.0
    trace = work[3 * rows]
    trace[:count] = 0
    for a in range(dim):
        diagonal = work[a * dim + a]
        for i in range(count):
            trace[i] += lame[i] * diagonal[i]
    for a in range(dim):
        for b in range(dim):
            stress, e, mirrored = work[2 * rows + a * dim + b], work[a * dim + b], work[b * dim + a]
            own = 1.0 if a == b else 0.0
            for i in range(count):
                stress[i] = shear[i] * (e[i] + mirrored[i]) + own * trace[i]
                energy += stress[i] * e[i] / 2
    return energy


@njit(error_model="numpy", cache=True, entry=False)
def _push(p, tile, dim, inverse, work):
    """P = stress K^-1 of a tile from the stress in ``work[2 dim^2:]``."""
    start, count = tile[0], tile[1]
    for a in range(dim):
        for b in range(dim):
            to, stress = p[a * dim + b, start : start + count], work[2 * dim * dim + a * dim + b]
            if not tile[2] & INCOMPLETE:
                for i in range(count):
                    to[i] = stress[i]
                continue
            to[:] = 0
            for c in range(dim):
                stress, factor = work[2 * dim * dim + a * dim + c], inverse[c * dim + b, tile[4] : tile[4] + count]
                for i in range(count):
                    to[i] += stress[i] * factor[i]


@njit(error_model="numpy", fastmath=_ANY_ORDER, forceinline=True, cache=True, entry=False)
def _stabilise(u, tile, medium, bonds, bits, p, force, work):
    """Add what resists zero-energy modes, ``w (pull_i (u_j - u_i - e_i xi) + pull_j (u_j - u_i - e_j xi))`` a bond
    (Silling 2017).

    The part of e_i, which stands in ``work[dim^2:]``, goes into P, the rest into `force`, shape (dim, size).
    """
    distances, weights, steps = bonds
    start, count, dim, at = tile[0], tile[1], steps.shape[1], medium[1] * tile[0]
    mine = medium[0][PULL, at : at + count]
    for row in range(dim * dim):
        e, to = work[dim * dim + row], p[row, start : start + count]
        for i in range(count):
            to[i] -= mine[i] * e[i]
    for a in range(dim):
        here, total = u[a, start : start + count], force[a, start : start + count]
        total[:] = 0
        for k in range(distances.size):
            there, weight = u[a, start + distances[k] : start + distances[k] + count], weights[k, dim]
            across = at + medium[1] * distances[k]
            other = medium[0][PULL, across : across + count]
            if tile[2] & INCOMPLETE:
                for i in range(count):
                    if _whole(bits, tile[4] + i, k):
                        total[i] += weight * (mine[i] + other[i]) * (there[i] - here[i])
            else:
                for i in range(count):
                    total[i] += weight * (mine[i] + other[i]) * (there[i] - here[i])


@njit(error_model="numpy", cache=True, entry=False)
def _stabilisation_energy(u, tile, medium, bonds, bits, work):
    """Energy of what `_stabilise` adds, with the gradient in ``work[dim^2:]``."""
    distances, weights, steps = bonds
    dim = steps.shape[1]
    energy = 0.0
    for i in range(tile[1]):
        pull = medium[0][PULL, medium[1] * (tile[0] + i)]
        for k in range(distances.size):
            if not tile[2] & INCOMPLETE or _whole(bits, tile[4] + i, k):
                for a in range(dim):
                    rest = u[a, tile[0] + i + distances[k]] - u[a, tile[0] + i]
                    for b in range(dim):
                        rest -= work[dim * dim + a * dim + b, i] * steps[k, b]
                    energy += pull * weights[k, dim] * rest * rest / 2
    return energy


@njit(error_model="numpy", cache=True, entry=False)
def _split_divergence(p, tile, pairs, bonds, slots, work):
    """Force on a tile's nodes by the direction of the derivative, ``work[a dim + b]``: of intact nodes, then anew where
    bonds are missing.
    """
    split_divergence(p, tile[0], tile[1], pairs[0], pairs[1], work)
    if tile[2] & INCOMPLETE:
        parts = np.zeros(9)
        for node in range(tile[1]):
            if not _complete(slots[0], tile[4] + node, slots[2]):
                incomplete_divergence(p, tile[0] + node, tile[4] + node, bonds[0], bonds[1], slots[0], parts)
                for row in range(p.shape[0]):
                    work[row, node] = parts[row]


@njit(error_model="numpy", cache=True, entry=False)
def _force(p, tile, pairs, bonds, slots, layers, first, work):
    """Force on a tile's nodes, over the reference density, into ``work[:dim]``; the layers' memory moves on."""
    dim = bonds[2].shape[1]
    if not tile[2] & (INCOMPLETE | LAYER):
        divergence(p, tile[0], tile[1], pairs[0], pairs[1], work)
        return
    _split_divergence(p, tile, pairs, bonds, slots, work)
    if tile[2] & LAYER:
        _stretch(tile, dim * dim, dim * dim, layers, first, work)
    for a in range(dim):
        for i in range(tile[1]):
            total = 0.0
            for b in range(dim):
                total += work[a * dim + b, i]
            work[a, i] = total  # row a has been read: a <= a dim


@njit(error_model="numpy", cache=True, entry=False)
def _outflow(v, p, u, ago, medium, crossing, bonds, thread):
    """Power that the near field gains along the bonds which leave it, with the displacements a time `ago` before u."""
    distances, weights, steps = bonds
    dim = steps.shape[1]
    pull, stride = medium[0][PULL], medium[1]
    total = 0.0
    for number in range(thread.number, crossing.shape[0], thread.threads):
        i, k = crossing[number, 0], crossing[number, 1]
        j = i + distances[k]
        for a in range(dim):
            apart = weights[k, dim] * (u[a, j] - u[a, i] - ago * (v[a, j] - v[a, i]))
            mine, other = pull[stride * i] * apart, pull[stride * j] * apart
            for b in range(dim):
                mine += p[a * dim + b, i] * weights[k, b]
                other += p[a * dim + b, j] * weights[k, b]
            total += v[a, j] * mine + v[a, i] * other
    return total


@njit(error_model="numpy", cache=True, entry=False)
def _outside(tile, loads, factors, out):
    """Forces on a tile's nodes, over the reference density, by the loads of a step, shape (dim, TILE)."""
    start, count = tile[0], tile[1]
    out[:, :count] = 0
    if tile[2] & LOADED:
        for load in range(loads.shape[0]):
            for a in range(out.shape[0]):
                for i in range(count):
                    out[a, i] += factors[load] * loads[load, a, start + i]


@njit(error_model="numpy", fastmath=_ANY_ORDER, forceinline=True, cache=True, entry=False)
def _move(u, v, smoothed, tile, dt, kick, force, outside, damping, medium, terms):
    """New velocities and displacements of a tile, and what it adds to the terms of the energy balance: kinetic energy,
    work, drag.
    """
    start, count, at = tile[0], tile[1], medium[1] * tile[0]
    lightness, mass = medium[0][LIGHTNESS, at : at + count], medium[0][MASS, at : at + count]
    kinetic, now, following, lost = 0.0, 0.0, 0.0, 0.0
    for a in range(u.shape[0]):
        old, new, moved = smoothed[a, start : start + count], v[a, start : start + count], u[a, start : start + count]
        gained, load = force[a], outside[a]
        if tile[2] & LAYER:
            damped = damping[tile[3] : tile[3] + count]
            for i in range(count):
                new[i] = ((1 - damped[i] * dt) * old[i] + kick * lightness[i] * (gained[i] + load[i])) / (
                    1 + damped[i] * dt
                )
                moved[i] += dt * new[i]
        else:
            for i in range(count):
                last, begin, rate = new[i], old[i], lightness[i] * (gained[i] + load[i])
                speed = begin + kick * rate
                kinetic += mass[i] * speed * (speed - dt * rate) / 2
                lost += mass[i] * (last - begin) * (last + begin + dt * rate) / 2
                now += last * load[i]
                following += speed * load[i]
                new[i] = speed
                moved[i] += dt * speed
    terms[KINETIC] += kinetic
    terms[DRAG] += lost
    terms[WORK] += dt / 2 * now
    terms[PENDING_WORK] += dt / 2 * following


class BodyState(NamedTuple):
    """Fields of a body, in place.

    Attributes
    ----------
    u, v, spare : ndarray, shape (dim, size)
        Displacements, velocities half a step before, and room for smoothed ones.
    p, force : ndarray, shapes (dim^2, size) and (dim, size)
        Stresses, and the force of the stabilisation (without use if there is none).
    """

    u: np.ndarray
    v: np.ndarray
    spare: np.ndarray
    p: np.ndarray
    force: np.ndarray


class SplitState(NamedTuple):
    """Fields of a body in split form, in place.

    Attributes
    ----------
    u : ndarray, shape (dim, size)
        The sum of the parts.
    parts : ndarray, shape (dim, dim, size)
        Displacement a by the direction b of the derivative that drives it, ``parts[b, a]``.
    histories : ndarray, shape (dim, dim^2, size)
        The same for the time integral of the stress over the density.
    p : ndarray, shape (dim^2, size)
        Stresses.
    phi : ndarray, shape (dim, L)
        Stretch in the layers (1/time).
    """

    u: np.ndarray
    parts: np.ndarray
    histories: np.ndarray
    p: np.ndarray
    phi: np.ndarray


class BodyTiles(NamedTuple):
    """The nodes of a body and what connects them.

    Attributes
    ----------
    tiles : ndarray of int, shape (N, 8)
        First node, number of nodes, kind, first place among the nodes of layers and of incomplete tiles (-1: none),
        place along the three axes.
    medium : tuple
        The constants of the material, shape (5, size), or (5, TILE) where all nodes are alike; 1 or 0, by which a
        node's number is multiplied to find its own; whether there is a stabilisation.
    pairs : tuple
        Distances (int64) and weights ``w xi`` of one of each two opposite bonds.
    bonds : tuple
        Distances, weights (``w xi`` and w) and vectors xi of all bonds.
    triples : ndarray of int, shape (K, 3)
        The bonds in nodes.
    slots : tuple
        Bits of the bonds of nodes in incomplete tiles, shape (words, M), their inverse shape tensors, shape (dim^2, M),
        bits of a complete node.
    """

    tiles: np.ndarray
    medium: tuple[np.ndarray, int, bool]
    pairs: tuple[np.ndarray, np.ndarray]
    bonds: tuple[np.ndarray, np.ndarray, np.ndarray]
    triples: np.ndarray
    slots: tuple[np.ndarray, np.ndarray, np.ndarray]


class BodyLoads(NamedTuple):
    """Forces on a body from outside, and where it ends.

    Attributes
    ----------
    loads, factors : ndarray, shapes (L, dim, size) and (steps, L)
        Forces over the reference density, and their factors in each step.
    crossing : ndarray of int, shape (C, 2)
        Nodes of the near field and their bonds that leave it.
    """

    loads: np.ndarray
    factors: np.ndarray
    crossing: np.ndarray


class Watched(NamedTuple):
    """Nodes whose displacements are kept.

    Attributes
    ----------
    nodes : ndarray of int, shape (n,)
    seen : ndarray, shape (steps, dim, n)
        After each step.
    """

    nodes: np.ndarray
    seen: np.ndarray


@njit(error_model="numpy", nogil=True, cache=True)
def advance(thread, steps_to_do, done, dt, drag, state, body, fracture, layers, outside, balance, watched):
    """Displacement Verlet; one thread's share of the tiles.

    Parameters
    ----------
    thread : Thread
    steps_to_do, done : int
        Steps, and those before; the very first starts from velocities at its own time.
    dt, drag : float
        Step, and D of eq. 3-4 in a step.
    state : BodyState
    body : BodyTiles
    fracture : tuple
        Squared lengths at which bonds break, first and last + 1 node along each axis between which they may, whether K
        is kept.
    layers : tuple
        Memory of the layers' nodes, shape (2 dim^2, L), `keep` and `gain` of its recursion, shape (dim, L), damping,
        shape (L,).
    outside : BodyLoads
    balance : ndarray, shape (threads, TERMS)
        Energies over the reference mass of a node, as named above, of the near field.
    watched : Watched
    """
    u, v, spare, p, force = state
    tiles, medium, pairs, bonds, triples, slots = body
    loads, factors, crossing = outside
    dim = u.shape[0]
    rows = dim * dim
    work = np.zeros((3 * rows + 1, TILE))
    terms, (bits, inverse, full) = balance[thread.number], slots
    first_tile, last_tile = share(thread, tiles.shape[0])
    for step in range(steps_to_do):
        first = done + step == 0
        smoothing = drag > 0 and not first
        smoothed = spare if smoothing else v
        terms[STRAIN] = 0
        for number in range(first_tile, last_tile):
            tile = tiles[number]
            if tile[2] & BREAKABLE and _break_bonds(
                u, v, dt, tile, medium, bonds, triples, bits, inverse, fracture, terms, work
            ):
                tile[2] |= INCOMPLETE
            _plain_strain(u, tile, pairs, bonds, slots, work)
            if medium[2]:
                work[rows : 2 * rows] = work[:rows]
            if tile[2] & LAYER:
                _stretch(tile, rows, 0, layers, first, work)
            energy = _stress(tile, dim, medium, work)
            _push(p, tile, dim, inverse, work)
            if medium[2]:
                _stabilise(u, tile, medium, bonds, bits, p, force, work)
            if not tile[2] & LAYER:
                terms[STRAIN] += energy
                if medium[2] and step == steps_to_do - 1:  # the terms are read after the last step only
                    terms[STRAIN] += _stabilisation_energy(u, tile, medium, bonds, bits, work)
            if smoothing:
                _smooth(v, spare, tile, bonds[0], bits, full, drag, work)
        barrier(thread)
        if not first:
            outflow = _outflow(v, p, u, 0.0, medium, crossing, bonds, thread)
            terms[OUTFLOW] -= terms[PENDING_OUTFLOW] + dt / 2 * outflow
            terms[WORK] += terms[PENDING_WORK]
            barrier(thread)
        terms[KINETIC] = terms[PENDING_WORK] = 0
        for number in range(first_tile, last_tile):
            tile = tiles[number]
            _force(p, tile, pairs, bonds, slots, layers, first, work)
            if medium[2]:
                for a in range(dim):
                    for i in range(tile[1]):
                        work[a, i] += force[a, tile[0] + i]
            _outside(tile, loads, factors[step], work[dim : 2 * dim])
            _move(
                u, v, smoothed, tile, dt, dt / 2 if first else dt, work, work[dim : 2 * dim], layers[3], medium, terms
            )
        if first:
            terms[WORK] = 0
        barrier(thread)
        terms[PENDING_OUTFLOW] = dt / 2 * _outflow(v, p, u, dt, medium, crossing, bonds, thread)
        _see(thread, u, watched.nodes, watched.seen[step])
        barrier(thread)


@njit(error_model="numpy", cache=True, entry=False)
def _see(thread, u, watched, seen):
    """Copy the displacements of some nodes."""
    for a in range(u.shape[0]):
        for i in range(thread.number, watched.size, thread.threads):
            seen[a, i] = u[a, watched[i]]


@njit(error_model="numpy", nogil=True, cache=True)
def advance_split(thread, steps_to_do, dt, state, body, watched):
    """The published scheme: forward Euler on split fields (Wildman and Gazonas 2012, eqs 2-30 and 2-31, which are the
    same two steps at a time).

    Parameters
    ----------
    thread : Thread
    steps_to_do : int
    dt : float
    state : SplitState
    body : BodyTiles
        Whose nodes are all alike.
    watched : Watched
    """
    u, parts, histories, p, phi = state
    tiles, medium, pairs, bonds, _, slots = body
    dim = u.shape[0]
    rows = dim * dim
    lame, shear = medium[0][LAME, 0], medium[0][SHEAR, 0]
    work = np.zeros((3 * rows + 1, TILE))
    first_tile, last_tile = share(thread, tiles.shape[0])
    still = np.zeros(TILE)
    for step in range(steps_to_do):
        for number in range(first_tile, last_tile):
            tile = tiles[number]
            start, count = tile[0], tile[1]
            for row in range(rows):
                work[2 * rows + row, :count] = histories[0, row, start : start + count]
                for b in range(1, dim):
                    work[2 * rows + row, :count] += histories[b, row, start : start + count]
            _push(p, tile, dim, slots[1], work)
            _plain_strain(u, tile, pairs, bonds, slots, work)
            for b in range(dim):
                fade = phi[b, tile[3] : tile[3] + count] if tile[2] & LAYER else still[:count]
                for a in range(dim):
                    for c in range(dim):
                        history = histories[b, a * dim + c, start : start + count]
                        for i in range(count):
                            rate = -fade[i] * history[i]
                            if a == c:
                                rate += lame * work[b * dim + b, i]
                            if b == c:
                                rate += shear * work[a * dim + c, i]
                            if a == b:
                                rate += shear * work[c * dim + a, i]
                            history[i] += dt * rate
        barrier(thread)
        for number in range(first_tile, last_tile):
            tile = tiles[number]
            start, count = tile[0], tile[1]
            _split_divergence(p, tile, pairs, bonds, slots, work)
            for a in range(dim):
                u[a, start : start + count] = 0
                for b in range(dim):
                    fade = phi[b, tile[3] : tile[3] + count] if tile[2] & LAYER else still[:count]
                    part = parts[b, a, start : start + count]
                    for i in range(count):
                        part[i] += dt * (work[a * dim + b, i] - fade[i] * part[i])
                        u[a, start + i] += part[i]
        barrier(thread)
        _see(thread, u, watched.nodes, watched.seen[step])


@njit(error_model="numpy", cache=True)
def displacement_gradients(u, tiles, pairs, bonds, slots, out):
    """Gradient of the displacements of all nodes, not stretched, into `out`, shape (dim^2, size)."""
    work = np.zeros((out.shape[0], TILE))
    for number in range(tiles.shape[0]):
        tile = tiles[number]
        _plain_strain(u, tile, pairs, bonds, slots, work)
        out[:, tile[0] : tile[0] + tile[1]] = work[:, : tile[1]]


@njit(error_model="numpy", cache=True)
def accelerations(u, p, force, tiles, medium, pairs, bonds, slots, out):
    """Accelerations without layers, loads and damping into `out`, shape (dim, size); p and force are room, as of
    `advance`.
    """
    dim = u.shape[0]
    rows = dim * dim
    work = np.zeros((3 * rows + 1, TILE))
    for number in range(tiles.shape[0]):
        tile = tiles[number]
        _plain_strain(u, tile, pairs, bonds, slots, work)
        _stress(tile, dim, medium, work)
        _push(p, tile, dim, slots[1], work)
        if medium[2]:
            work[rows : 2 * rows] = work[:rows]
            _stabilise(u, tile, medium, bonds, slots[0], p, force, work)
    for number in range(tiles.shape[0]):
        tile = tiles[number]
        _split_divergence(p, tile, pairs, bonds, slots, work)
        for a in range(dim):
            for i in range(tile[1]):
                total = force[a, tile[0] + i] if medium[2] else 0.0
                for b in range(dim):
                    total += work[a * dim + b, i]
                out[a, tile[0] + i] = total * medium[0][LIGHTNESS, medium[1] * (tile[0] + i)]
