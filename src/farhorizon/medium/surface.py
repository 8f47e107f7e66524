"""Stiffer springs of nodes that lack bonds, with which they hold as much energy as inside the solid."""

from __future__ import annotations

import itertools

import numpy as np

# Moments of the remaining bonds, relative to the largest, that are rounding: along them nothing can be made up for.
_NOTHING = 1e-9


def products(offsets: np.ndarray) -> np.ndarray:
    """Products ``n_a^2 n_b^2`` of the direction cosines of bonds along each pair of axes a <= b, shape (K, M).

    Unit stretches along two axes store the energy of a bond times these.
    """
    squares = (offsets / np.linalg.norm(offsets, axis=1)[:, None]) ** 2
    pairs = itertools.combinations_with_replacement(range(offsets.shape[1]), 2)
    return np.stack([squares[:, a] * squares[:, b] for a, b in pairs], axis=1)


def excess(present: np.ndarray, energies: np.ndarray, cosines: np.ndarray) -> np.ndarray:
    """Numbers q (S, M) by which the half of each `present` bond (S, K) that belongs to a node is stiffer, ``1 + cosines
    @ q``, for `energies` (K,) under a unit stretch and `products` (K, M).

    With them the energies of the node under unit stretches along each axis and each pair of axes are those that all K
    bonds would store. Of all numbers that achieve this they change the bonds least. A node whose bonds would have to be
    negative is stiffened as far as none is.
    """
    of_present = present * energies
    moments = np.einsum("sk,kp,kq->spq", of_present, cosines, cosines)
    lacking = (energies - of_present) @ cosines
    numbers = np.einsum("spq,sq->sp", np.linalg.pinv(moments, rcond=_NOTHING, hermitian=True), lacking)
    softest = (numbers @ cosines.T).min(axis=1, where=present, initial=0.0)
    return np.asarray(numbers / np.maximum(1.0, -softest)[:, None])
