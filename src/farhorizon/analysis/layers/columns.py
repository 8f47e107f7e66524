"""Compiled loops over the columns of a lattice PML, for many waves one after the other: waves are followed by the
thousand, and array operations would take several times as long as the solution of the equations.

Along the normal the field of a layer is U(p, k), column p continued by k nodes. Inwards it depends on the columns from
p on, outwards on those up to p and on the near field.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from farhorizon.engine.rows.compiled import njit


def continuations(stretch: np.ndarray, reach: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Continue the field of a layer by k = 1 .. reach nodes, for stretches of shape (n, L + 1), complex.

    Yields
    ------
    inwards : ndarray, shape (n, L + 1, L + 1)
        Matrices that give U(., k) at the columns 0 .. L from the values there.
    outwards : ndarray, shape (n, L, L + reach + 1)
        Matrices that give U(., -k) at the columns 1 .. L from the values there and at the near field's nodes 0, -1 ..
        -reach.
    """
    ratio, (n, edges) = (1 - stretch) / (1 + stretch), stretch.shape
    inwards = np.broadcast_to(np.eye(edges, dtype=complex), (n, edges, edges)).copy()
    outwards = np.broadcast_to(np.eye(edges - 1, edges + reach, dtype=complex), (n, edges - 1, edges + reach)).copy()
    for k in range(1, reach + 1):
        before, inwards = inwards, np.zeros_like(inwards)
        _inwards_by_a_node(ratio, before, inwards)
        before, outwards = outwards, np.zeros_like(outwards)
        _outwards_by_a_node(ratio, k, before, outwards)
        yield inwards, outwards


@njit(error_model="numpy", nogil=True, cache=True, counted=False, entry=True)
def _inwards_by_a_node(ratio: np.ndarray, field: np.ndarray, found: np.ndarray) -> None:
    """Compute U(., k) from U(., k - 1): ``U(p, k) = U(p+1, k-1) + ratio (U(p+1, k) - U(p, k-1))``, with zeros beyond
    the last column.
    """
    n, edges = ratio.shape
    for wave in range(n):
        last = edges - 1
        found[wave, last, last] = -ratio[wave, last] * field[wave, last, last]
        for p in range(last - 1, -1, -1):
            r = ratio[wave, p]
            for q in range(p, edges):
                found[wave, p, q] = field[wave, p + 1, q] + r * (found[wave, p + 1, q] - field[wave, p, q])


@njit(error_model="numpy", nogil=True, cache=True, counted=False, entry=True)
def _outwards_by_a_node(ratio: np.ndarray, k: int, field: np.ndarray, found: np.ndarray) -> None:
    """Compute U(., -k) from U(., 1 - k) by the same recursion outwards; before the first column are the near field's
    nodes.
    """
    n, columns, unknowns = field.shape
    for wave in range(n):
        for p in range(columns):
            r = ratio[wave, p]
            if p == 0:
                found[wave, 0, columns + k - 1] = 1.0
                found[wave, 0, columns + k] = r
                for q in range(unknowns):
                    found[wave, 0, q] -= r * field[wave, 0, q]
                continue
            for q in range(p + 1):
                found[wave, p, q] = field[wave, p - 1, q] + r * (found[wave, p - 1, q] - field[wave, p, q])
            for q in range(columns, columns + k + 1):
                found[wave, p, q] = field[wave, p - 1, q] + r * (found[wave, p - 1, q] - field[wave, p, q])


@njit(error_model="numpy", nogil=True, cache=True, counted=False, entry=True)
def take_stencil(
    ahead: np.ndarray,
    inwards: np.ndarray,
    behind: np.ndarray,
    outwards: np.ndarray,
    system: np.ndarray,
    drive: np.ndarray,
) -> None:
    """Subtract what the weights of the offsets k and -k contribute to the equations of the columns, and add the
    contribution of the near field to the right-hand side.

    Parameters
    ----------
    ahead, behind : ndarray of complex, shape (n, d, d)
        Weights of the offsets k and -k.
    inwards, outwards : ndarray of complex
        As `continuations` yields them.
    system : ndarray of complex, shape (n, d, L, d, L)
    drive : ndarray of complex, shape (n, K + 1, d, L, d)
    """
    n, d, columns = system.shape[:3]
    for wave in range(n):
        for c in range(d):
            for p in range(columns):
                for e in range(d):
                    weight = ahead[wave, c, e]
                    for q in range(p, columns):
                        system[wave, c, p, e, q] -= weight * inwards[wave, p + 1, q + 1]
                    weight = behind[wave, c, e]
                    for q in range(p + 1):
                        system[wave, c, p, e, q] -= weight * outwards[wave, p, q]
                    for node in range(drive.shape[1]):
                        drive[wave, node, c, p, e] += weight * outwards[wave, p, columns + node]
