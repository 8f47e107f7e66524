"""What it takes to break bonds."""

from __future__ import annotations

from typing import Any

import numpy as np


def fracture_energy(bonds: np.ndarray, stiffness: np.ndarray, stretch: float) -> float:
    """Energy per area (2D: per length and thickness) that is spent when all bonds across a plane break.

    A bond of stiffness C (force density over elongation) holds ``C V (s |xi|)^2 / 2`` at the critical stretch s, V the
    volume of a node, and ``|xi . n| / V`` of each pair of opposite bonds cross a unit of area with normal n. The mean
    over all normals is ``s^2/4 sum_k C_k |xi_k|^3 <|cos|>`` with 2/pi in the plane and 1/2 in space. In the continuum
    with a constant micromodulus c this is ``pi c s^2 horizon^5 / 10`` (Silling and Askari 2005, Computers and
    Structures 83) and ``c s^2 horizon^4 / 4`` in the plane, that is ``s = sqrt(5 G / (6 E horizon))`` in space,
    ``sqrt(4 pi G / (9 E horizon))`` in plane stress, ``sqrt(5 pi G / (12 E horizon))`` in plane strain.

    Parameters
    ----------
    bonds : ndarray, shape (K, dim)
        Both directions of each bond.
    stiffness : ndarray, shape (K,)
    stretch : float
    """
    lengths = np.linalg.norm(bonds, axis=1)
    return float(stretch**2 / 4 * (stiffness * lengths**3).sum() * (2 / np.pi if bonds.shape[1] == 2 else 0.5))


def stretch_that_spends(energy: Any, factor: float, young: float, horizon: float) -> Any:
    """The critical stretch at which a crack takes an energy per area, of which it is known what it takes over Young's
    modulus, the horizon and the square of that stretch.

    Parameters
    ----------
    energy : float or ndarray
    factor, young, horizon : float

    Returns
    -------
    float or ndarray
    """
    return np.sqrt(energy / (factor * young * horizon))


def final_stretch(bonds: np.ndarray, stiffness: np.ndarray, onset: Any, energy: Any) -> Any:
    """The stretch s1 at which bonds that soften carry nothing any more, so that a plane takes an energy per area.

    A bond whose force falls evenly from that at the stretch s0 to zero takes ``C V |xi|^2 s0 s1 / 2``, where at s0
    it holds ``C V |xi|^2 s0^2 / 2``: over all bonds across a plane the energy is ``s0 s1`` times the
    `fracture_energy` of a stretch of 1. A force that decays as ``exp(-2 (s - s0) / (s1 - s0))`` takes as much and
    never ends.

    Parameters
    ----------
    bonds : ndarray, shape (K, dim)
        Both directions of each bond.
    stiffness : ndarray, shape (K,)
    onset : float or ndarray
        s0.
    energy : float or ndarray
        Energy per area; infinite where there are no bonds.

    Returns
    -------
    float or ndarray
    """
    return energy / (fracture_energy(bonds, stiffness, 1.0) * onset)
