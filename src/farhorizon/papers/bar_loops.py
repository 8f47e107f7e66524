"""Compiled loops of the one-dimensional exact boundary on plain arrays: a bar whose ends have a history.

Every scheme here is the recursion ``d <- keep d + scale A u, u <- u + d`` in increments
(`farhorizon.analysis.exact.chain.Recursion`). The bonds A are applied as differences, so that rounding errors do not
drift.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.codegen.compiled import njit


@njit(cache=True, error_model="numpy")
def bar_acceleration(u: np.ndarray, bonds: np.ndarray, out: np.ndarray) -> None:
    """Set ``out = A u``, in differences; bonds[k - 1, i] joins the nodes i and i + k (0 where there is no bond)."""
    out[:] = 0
    for k in range(1, bonds.shape[0] + 1):
        count = u.size - k
        bond, left, right = bonds[k - 1], u[:count], u[k:]
        pulled, pulling = out[:count], out[k:]
        for i in range(count):
            pulled[i] += bond[i] * (right[i] - left[i])
        for i in range(count):
            pulling[i] -= bond[i] * (right[i] - left[i])


class HeldNodes(NamedTuple):
    """Nodes of a bar with prescribed values, shape (h,), and their values after each step, shape (count, h)."""

    nodes: np.ndarray
    values: np.ndarray


class BarEnds(NamedTuple):
    """Response of what lies beyond a bar at its left and right end, K nodes each: the weights of bonds beyond it
    (`grounds`), the kernel at the lags of a block of B steps (`heads`), the force of earlier blocks (`past`), the end
    nodes' values (`samples`), or sums of P exponentials, whose `states` are updated in place.
    """

    grounds: np.ndarray
    heads: np.ndarray
    past: np.ndarray
    samples: np.ndarray
    poles: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    states: np.ndarray


@njit(cache=True, error_model="numpy")
def bar_steps(
    u: np.ndarray,
    d: np.ndarray,
    bonds: np.ndarray,
    keep: float,
    scale: float,
    held: HeldNodes,
    ends: BarEnds,
    first: float,
    offset: int,
    count: int,
) -> None:
    """Advance the state u and the increment d of a bar, shape (N,), in place by `count` steps, starting at step
    `offset` of a block; the first sample of this call has the weight `first`.
    """
    grounds, heads, past, samples, poles, inputs, outputs, states = ends
    reach, size = bonds.shape[0], u.size
    force = np.empty(size)
    for step in range(offset, offset + count):
        bar_acceleration(u, bonds, force)
        weight = first if step == offset else 1.0
        for side in range(2):
            for m in range(reach):
                node = m if side == 0 else size - 1 - m
                samples[side, step, m] = weight * u[node]
                total = past[side, step, m] - grounds[side, m] * u[node]
                for p in range(poles.shape[1]):
                    total += (
                        outputs[side, p, m].real * states[side, p].real
                        - outputs[side, p, m].imag * states[side, p].imag
                    )
                force[node] += total
            if heads.shape[1] > 1:
                for lag in range(1, step + 1):
                    for i in range(reach):
                        total = 0.0
                        for m in range(reach):
                            total += heads[side, lag, i, m] * samples[side, step - lag, m]
                        force[i if side == 0 else size - 1 - i] += total
            for p in range(poles.shape[1]):
                drive = 0j
                for m in range(reach):
                    drive += inputs[side, p, m] * samples[side, step, m]
                states[side, p] = poles[side, p] * (states[side, p] + drive)
        for i in range(size):
            d[i] = keep * d[i] + scale * force[i]
        for i in range(held.nodes.size):
            d[held.nodes[i]] = held.values[step - offset, i] - u[held.nodes[i]]
        for i in range(size):
            u[i] += d[i]


@njit(cache=True, error_model="numpy")
def _recursion_slope(state: np.ndarray, weights: np.ndarray, t: float, g: np.ndarray, out: np.ndarray) -> None:
    """Time derivative of g_0 .. g_(2K-1) and of their rates, closed by the recursion of Ji et al. (2021), eq 27, for
    the next K values; g is work space of size 3K.
    """
    reach = weights.size
    size = 2 * reach
    last = reach * weights[reach - 1]
    g[:size] = state[0]
    for m in range(size, 3 * reach):
        total = g[m - size]
        for k in range(1, reach):
            total -= k * weights[k - 1] / last * (g[m - reach + k] - g[m - reach - k])
        g[m] = total - 2 * (m - reach) / (last * t) * state[1, m - reach] if t > 0 else 0.0
    for m in range(size):
        out[0, m] = state[1, m]
        total = 0.0
        for k in range(1, reach + 1):
            total += weights[k - 1] * (g[m + k] + g[abs(m - k)] - 2 * g[m])
        out[1, m] = total


@njit(cache=True, error_model="numpy")
def recursive_impulse(weights: np.ndarray, dt: float, steps: int) -> np.ndarray:
    """g_0 .. g_(2K-1) at t = 0, dt, .. by fourth-order Runge-Kutta and the recursion of Ji et al. (2021), eqs 23 to 27;
    shape (steps + 1, 2K).
    """
    size = 2 * weights.size
    g = np.zeros((steps + 1, size))
    state, trial, work = np.zeros((2, size)), np.zeros((2, size)), np.zeros(3 * weights.size)
    slopes = np.zeros((4, 2, size))
    state[1, 0] = 1
    for step in range(steps):
        t = step * dt
        _recursion_slope(state, weights, t, work, slopes[0])
        for stage in range(1, 4):
            ahead = dt if stage == 3 else dt / 2
            trial[:] = state + ahead * slopes[stage - 1]
            _recursion_slope(trial, weights, t + ahead, work, slopes[stage])
        state += dt / 6 * (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3])
        g[step + 1] = state[0]
    return g
