"""Compiled loop of a chain with one driven node at its end, for the exact one-dimensional boundary.

Its scheme is the recursion ``d <- keep d + scale (A u - reaction u), u <- u + d`` in increments
(`farhorizon.analysis.exact.chain.Recursion`), with the bonds A in differences, so that rounding does not drift.
"""

from __future__ import annotations

import numpy as np

from farhorizon.engine.codegen.compiled import njit

_CHUNK = 512  # number of nodes whose increments stay in the first-level cache while the bonds are summed


@njit(cache=True, error_model="numpy")
def _chain_increment(
    u: np.ndarray, d: np.ndarray, scaled: np.ndarray, keep: float, own: float, first: int, last: int
) -> None:
    """Compute ``d <- keep d - own u + sum over k of scaled[k - 1] (u[i - k] - 2 u[i] + u[i + k])`` for the nodes first
    .. last - 1, four bonds per sweep.
    """
    # Views, whose indices start at 0, so that the compiler need not handle negative ones and can vectorise.
    reach, count = scaled.size, last - first
    here, out = u[first:last], d[first:last]
    for i in range(count):
        out[i] = keep * out[i] - own * here[i]
    in_fours = reach - reach % 4
    for k in range(1, in_fours + 1, 4):
        w0, w1, w2, w3 = scaled[k - 1], scaled[k], scaled[k + 1], scaled[k + 2]
        before, after = u[first - k - 3 : last - k], u[first + k : last + k + 3]
        for i in range(count):
            v = here[i]
            near = w0 * ((before[i + 3] - v) + (after[i] - v)) + w1 * ((before[i + 2] - v) + (after[i + 1] - v))
            far = w2 * ((before[i + 1] - v) + (after[i + 2] - v)) + w3 * ((before[i] - v) + (after[i + 3] - v))
            out[i] += near + far
    for k in range(in_fours + 1, reach + 1):
        w, before, after = scaled[k - 1], u[first - k : last - k], u[first + k : last + k]
        for i in range(count):
            out[i] += w * ((before[i] - here[i]) + (after[i] - here[i]))


@njit(cache=True, error_model="numpy")
def _add_drift(u: np.ndarray, d: np.ndarray, scaled: np.ndarray, first: int, last: int) -> None:
    """Add ``sum over k of scaled[k - 1] (u[i - k] - u[i + k])`` to the increments of the nodes first .. last - 1."""
    out, count = d[first:last], last - first
    for k in range(1, scaled.size + 1):
        w, before, after = scaled[k - 1], u[first - k : last - k], u[first + k : last + k]
        for i in range(count):
            out[i] += w * (before[i] - after[i])


@njit(cache=True, error_model="numpy")
def chain_responses(weights: np.ndarray, keep: float, scale: float, reaction: float, window: np.ndarray) -> np.ndarray:
    """Compute the ghost values (steps + 1, K, K) of a chain at rest of which one driver m + 1 has the value 1 at step 0
    only, from the weights (2, K) towards the drivers and away from them; ``window[n]`` nodes are advanced to step n.
    """
    reach, steps = weights.shape[1], window.size - 1
    length = window.max()
    kernel = np.zeros((steps + 1, reach, reach))
    u, d = np.zeros(length + 2 * reach), np.zeros(length + 2 * reach)
    scaled, drift = scale * (weights[0] + weights[1]) / 2, scale * (weights[0] - weights[1]) / 2
    drifting = drift.any()
    for driver in range(reach):
        u[:], d[:] = 0, 0
        u[reach - 1 - driver] = 1
        for step in range(1, steps + 1):
            last = reach + window[step]
            for start in range(reach, last, _CHUNK):
                end = min(start + _CHUNK, last)
                _chain_increment(u, d, scaled, keep, scale * reaction, start, end)
                if drifting:
                    _add_drift(u, d, drift, start, end)
            u[reach - 1 - driver] = 0
            for i in range(reach, last):
                u[i] += d[i]
            kernel[step, :, driver] = u[reach : 2 * reach]
    return kernel
