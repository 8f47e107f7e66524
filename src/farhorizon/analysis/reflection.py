"""Reflection of plane waves by a flat side, from the exact problem on the half-infinite lattice, without a time run.

Along a side a wave has a tangential wavenumber, and the medium in front of it is a chain. At a factor z a step the chain carries 2K modes
``zeta^j`` (K the reach of the stencil along the normal): the incoming wave, and K that leave the side or die out away from it. Near field,
layer and memory of the side obey ``z x = G x`` with the map G of one step; their solution must end in those modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from farhorizon.analysis.chain import Recursion
from farhorizon.errors import InputError
from farhorizon.stencil import Stencil

_UNIT = 1e-8  # a mode whose modulus differs less from 1 propagates


@dataclass(frozen=True)
class Modes:
    """Modes of a chain at one factor a step.

    Attributes
    ----------
    incoming : complex
        Factor over one node of the wave that comes to the side (towards larger j).
    leaving : ndarray of complex
        Factors of the modes that leave the side or die out away from it.
    travels : ndarray of bool
        Which of them propagate; where none does, the one that reaches farthest.
    """

    incoming: complex
    leaving: np.ndarray
    travels: np.ndarray


def chain_weights(stencil: Stencil, angles: Sequence[float]) -> np.ndarray:
    """The stencil along its first axis for waves of given tangential wavenumbers times spacing.

    Parameters
    ----------
    stencil : Stencil
    angles : sequence of float
        One for each axis but the first.

    Returns
    -------
    ndarray of complex, shape (2 K + 1,)
        Weights of the offsets -K .. K, the sum over all bonds taken off the middle one.
    """
    reach = stencil.reach[0]
    found = np.zeros(2 * reach + 1, complex)
    np.add.at(found, stencil.offsets[:, 0] + reach, stencil.weights * np.exp(1j * stencil.offsets[:, 1:] @ np.asarray(angles, float)))
    found[reach] -= stencil.weights.sum()
    return found


def factor_of_wave(eigenvalue: float, recursion: Recursion) -> complex:
    """Factor a step, phase falling in time, of a wave that an operator multiplies by a real `eigenvalue`; for first order the decaying one."""
    half = (1 + recursion.keep + recursion.scale * eigenvalue) / 2
    if recursion.keep == 0:
        return complex(2 * half)
    return complex(half - np.sqrt(complex(half**2 - recursion.keep)))


def chain_modes(weights: np.ndarray, factor: complex, recursion: Recursion, near: complex) -> Modes:
    """Modes of a chain that gains a factor a step.

    Parameters
    ----------
    weights : ndarray of complex, shape (2 K + 1,)
        As from `chain_weights`, times coefficient / spacing^2.
    factor : complex
    recursion : Recursion
    near : complex
        Factor over one node of the wave that is meant; if that one leaves the side (a backward wave), its mirror image comes.

    Raises
    ------
    InputError
        No wave comes to the side.
    """
    polynomial = weights[::-1].astype(complex)  # highest power first, times zeta^K
    reach = len(weights) // 2
    polynomial[reach] -= recursion.eigenvalue(np.array(factor))
    used = np.flatnonzero(np.abs(polynomial) > 1e-14 * np.abs(polynomial).max())
    roots = np.roots(polynomial[used[0] : used[-1] + 1])
    powers = np.arange(-reach, reach + 1)
    slope = (weights * powers * roots[:, None] ** powers).sum(1)  # zeta dL/dzeta
    step = 1e-6
    rise = (recursion.eigenvalue(np.array(factor * (1 + step))) - recursion.eigenvalue(np.array(factor * (1 - step)))) / (2 * step)
    apart = np.abs(roots) - 1
    # what grows in time came from where it was small: a wave that comes to the side then falls off towards it
    ahead = np.where(np.abs(apart) > _UNIT, apart, (rise / np.where(slope == 0, 1e-300, slope)).real) < 0
    if not ahead.any():
        raise InputError("no wave of this frequency and wavenumber comes to the side", value=near)
    incoming = roots[ahead][np.argmin(np.minimum(np.abs(roots[ahead] - near), np.abs(roots[ahead] - 1 / near)))]
    leaving = roots[~ahead]
    travels = np.abs(np.abs(leaving) - 1) <= _UNIT + 2 * abs(abs(incoming) - 1)
    if not travels.any():  # a field that dies out towards the side, and comes back as one that dies out away from it
        travels[np.argmin(np.abs(leaving))] = True
    return Modes(complex(incoming), leaving, travels)


def reflection(matrix: np.ndarray, columns: np.ndarray, levels: Sequence[complex], factor: complex, modes: Modes) -> complex:
    """Amplitude of the reflected wave for an incoming one of amplitude 1, both at the side's end of the near field.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        Map of one step of a near field whose high end is the side, and of all memory of the side. Its low end may be anything.
    columns : ndarray of int, shape (levels, columns)
        Entries of the state that are the near field's nodes along the normal, at least 2 K columns.
    levels : sequence of complex
        What each time level holds of a wave: 1 for the field itself.
    factor : complex
        Factor of a step.
    modes : Modes

    Returns
    -------
    complex
        Of several propagating modes the root of the sum of squares.
    """
    count, width = len(modes.leaving), columns.shape[1]
    reach = max(count, 1)
    place = np.arange(width) - (width - 1)
    wave = modes.incoming**place
    away = modes.leaving[None, :] ** (place + width - 1)[:, None]  # 1 at the low end, so that nothing overflows; they grow towards the side
    away = away / np.abs(away).max(0)
    size = len(matrix)
    system, right = np.zeros((size + count, size + count), complex), np.zeros(size + count, complex)
    system[:size, :size] = factor * np.eye(size) - matrix
    for level, share in zip(columns, levels, strict=True):
        for j in range(reach):  # here the low end would be felt: the modes take its place
            row = level[j]
            system[row] = 0
            system[row, row] = 1
            system[row, size:] = -share * away[j]
            right[row] = share * wave[j]
    for j in range(count):
        entry = columns[0, reach + j]
        system[size + j, entry], system[size + j, size:] = 1, -away[reach + j]
        right[size + j] = wave[reach + j]
    amplitudes = np.linalg.solve(system, right)[size:] * away[-1]
    return complex(np.sqrt((amplitudes[modes.travels] ** 2).sum())) if modes.travels.sum() != 1 else complex(amplitudes[modes.travels][0])
