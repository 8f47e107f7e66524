"""Correlation of a run with its adjoint, in machine code: what a change of the medium at each node does to a misfit.

Both runs are given on a patch: rows of time, then components, then the places of a box in the order of its axes.
"""

from __future__ import annotations

import numpy as np

from farhorizon.engine.codegen.compiled import njit

ARITHMETIC, HARMONIC = range(2)
RULES = {"arithmetic": ARITHMETIC, "harmonic": HARMONIC}


@njit(error_model="numpy", inline="always", counted=False)
def _slope(rule, mine, other):
    """Derivative of the factor of a bond with respect to the factor of one of its ends."""
    if rule == ARITHMETIC:
        return 0.5
    total = mine + other
    return 2 * other * other / (total * total) if total > 0 else 0.0


# Slices that begin at 0: an index that might be negative keeps a loop from being vectorised.
@njit(error_model="numpy", inline="always", counted=False)
def _add_scalar(out, u, w, mine, other):
    """Add the products of the differences along bonds from the places `mine` on to the places `other` on."""
    ui, uj, wi, wj = u[mine:], u[other:], w[mine:], w[other:]
    for x in range(out.size):
        out[x] += (wj[x] - wi[x]) * (uj[x] - ui[x])


@njit(error_model="numpy", inline="always", counted=False)
def _add_plane(out, u, w, mine, other, arm):
    """The same for vectors of two components, along the arm of the bonds."""
    size, a, b = arm[0], arm[1], arm[2]
    ui, uj, wi, wj = u[0, mine:], u[0, other:], w[0, mine:], w[0, other:]
    vi, vj, zi, zj = u[1, mine:], u[1, other:], w[1, mine:], w[1, other:]
    for x in range(out.size):
        along = size * (a * (uj[x] - ui[x]) + b * (vj[x] - vi[x]))
        out[x] += along * (a * (wj[x] - wi[x]) + b * (zj[x] - zi[x]))


@njit(error_model="numpy", inline="always", counted=False)
def _add_space(out, u, w, mine, other, arm):
    """The same for vectors of three components."""
    size, a, b, c = arm[0], arm[1], arm[2], arm[3]
    ui, uj, wi, wj = u[0, mine:], u[0, other:], w[0, mine:], w[0, other:]
    vi, vj, yi, yj = u[1, mine:], u[1, other:], w[1, mine:], w[1, other:]
    si, sj, zi, zj = u[2, mine:], u[2, other:], w[2, mine:], w[2, other:]
    for x in range(out.size):
        along = size * (a * (uj[x] - ui[x]) + b * (vj[x] - vi[x]) + c * (sj[x] - si[x]))
        out[x] += along * (a * (wj[x] - wi[x]) + b * (yj[x] - yi[x]) + c * (zj[x] - zi[x]))


@njit(error_model="numpy", nogil=True, cache=True, fastmath={"contract"})
def correlate_bonds(u, row, w, shape, offsets, arms, rule, factor, begins, exists, lost, total):
    """Add to `total` (places,) the derivative of the sum over time of ``w . K u`` by the factor of each place, for the
    run u (rows, components, places), whose `row` belongs to the first one of the adjoint w (steps, components, places).

    The `offsets` (K, 3) are one of each pair of opposite bonds; the weight of a bond is the sum over the R `arms` (K,
    R, 1 + components) of the first number times the outer square of the others. Bonds that are counted begin where
    `begins` is 1 and end where `exists` is 1, and have `lost` a fraction (K, places) to cracks.
    """
    components, bonds = w.shape[1], arms.shape[0]
    n0, n1, n2 = shape
    sums = np.zeros((bonds, n2), np.float64)
    for row0 in range(n0):
        for row1 in range(n1):
            here = (row0 * n1 + row1) * n2
            sums[:] = 0
            for step in range(w.shape[0]):
                for k in range(bonds):
                    to0, to1 = row0 + offsets[k, 0], row1 + offsets[k, 1]
                    if to0 < 0 or to0 >= n0 or to1 < 0 or to1 >= n1:
                        continue
                    low, count = max(0, -offsets[k, 2]), n2 - abs(offsets[k, 2])
                    mine, other = here + low, (to0 * n1 + to1) * n2 + offsets[k, 2] + low
                    out = sums[k, low : low + count]
                    if components == 1:
                        _add_scalar(out, u[row - step, 0], w[step, 0], mine, other)
                    elif components == 2:
                        for rank in range(arms.shape[1]):
                            _add_plane(out, u[row - step], w[step], mine, other, arms[k, rank])
                    else:
                        for rank in range(arms.shape[1]):
                            _add_space(out, u[row - step], w[step], mine, other, arms[k, rank])
            for k in range(bonds):
                to0, to1 = row0 + offsets[k, 0], row1 + offsets[k, 1]
                if to0 < 0 or to0 >= n0 or to1 < 0 or to1 >= n1:
                    continue
                there = (to0 * n1 + to1) * n2 + offsets[k, 2]
                weight = arms[k, 0, 0] if components == 1 else 1.0
                for x in range(max(0, -offsets[k, 2]), min(n2, n2 - offsets[k, 2])):
                    mine, other = here + x, there + x
                    slope = -weight * sums[k, x] * begins[mine] * exists[other]
                    if lost.shape[0]:
                        slope *= 1 - lost[k, mine]
                    total[mine] += slope * _slope(rule, factor[mine], factor[other])
                    total[other] += slope * _slope(rule, factor[other], factor[mine])


@njit(error_model="numpy", nogil=True, cache=True, fastmath={"contract"})
def correlate_inertia(u, row, w, after, now, before, own, total):
    """Add to `total`, shape (places,), minus the sum over time of ``w . (after u[n+1] + now u[n] + before u[n-1])``;
    the rows are those of `correlate_bonds`, and `own`, shape (places,), is 1 at places that are nodes.
    """
    for step in range(w.shape[0]):
        for c in range(w.shape[1]):
            one, later, present = w[step, c], u[row - step + 1, c], u[row - step, c]
            earlier = u[row - step - 1, c] if before != 0 else present
            for i in range(total.size):
                total[i] -= own[i] * one[i] * (after * later[i] + now * present[i] + before * earlier[i])


@njit(error_model="numpy", nogil=True, cache=True, fastmath={"contract"})
def correlate_states(u, row, w, shape, offsets, gradient, present, laws, law_of, total):
    """Subtract from `total` (3, places) the sum over time of ``q(w) . L q(u)`` for the `laws` (kinds, 3, n, n) of unit
    moduli, of which a place has that of the number `law_of` (negative if it does not count).

    The state q of a node is the sum over its K bonds that are `present` (K, places) of `gradient` (K, n, components)
    times the difference of the field along them; u, row and w as in `correlate_bonds`.
    """
    bonds, states, components = gradient.shape
    n0, n1, n2 = shape
    reach0, reach1, reach2 = np.abs(offsets[:, 0]).max(), np.abs(offsets[:, 1]).max(), np.abs(offsets[:, 2]).max()
    count = n2 - 2 * reach2
    mine, other = np.zeros((states, count)), np.zeros((states, count))
    products = np.zeros((states, states, count))
    for row0 in range(reach0, n0 - reach0):
        for row1 in range(reach1, n1 - reach1):
            here = (row0 * n1 + row1) * n2 + reach2
            products[:] = 0
            for step in range(w.shape[0]):
                mine[:] = 0
                other[:] = 0
                for k in range(bonds):
                    neighbour = here + (offsets[k, 0] * n1 + offsets[k, 1]) * n2 + offsets[k, 2]
                    for c in range(components):
                        ui, uj = u[row - step, c, here:], u[row - step, c, neighbour:]
                        wi, wj = w[step, c, here:], w[step, c, neighbour:]
                        for a in range(states):
                            size = gradient[k, a, c]
                            if size != 0 and present.shape[0]:
                                of_u, of_w, there_is = mine[a], other[a], present[k, here:]
                                for x in range(count):
                                    of_u[x] += size * there_is[x] * (uj[x] - ui[x])
                                    of_w[x] += size * there_is[x] * (wj[x] - wi[x])
                            elif size != 0:
                                of_u, of_w = mine[a], other[a]
                                for x in range(count):
                                    of_u[x] += size * (uj[x] - ui[x])
                                    of_w[x] += size * (wj[x] - wi[x])
                for a in range(states):
                    for b in range(states):
                        out, one, two = products[a, b], other[a], mine[b]
                        for x in range(count):
                            out[x] += one[x] * two[x]
            for x in range(count):
                kind = law_of[here + x]
                if kind >= 0:
                    for m in range(3):
                        for a in range(states):
                            for b in range(states):
                                total[m, here + x] -= laws[kind, m, a, b] * products[a, b, x]
