"""Critical stretches of bonds and the fracture energy that they give."""

from __future__ import annotations

from typing import Any

import numpy as np


def fracture_energy(bonds: np.ndarray, stiffness: np.ndarray, stretch: float) -> float:
    """Energy per area (2D: per length and thickness) that is spent when all bonds across a plane break at a stretch;
    for both directions of each bond, (K, dim), and their stiffness, (K,).

    A bond of stiffness C (force density over elongation) holds ``C V (s |xi|)^2 / 2`` at the critical stretch s, where
    V is the volume of a node, and each pair of opposite bonds contributes ``|xi . n| / V`` bonds across a unit of area
    with normal n. The mean over all normals is ``s^2/4 sum_k C_k |xi_k|^3 <|cos|>`` with 2/pi in the plane and 1/2 in
    space. In the continuum with a constant micromodulus c this is ``pi c s^2 horizon^5 / 10`` (Silling and Askari 2005,
    Computers and Structures 83) and ``c s^2 horizon^4 / 4`` in the plane, that is ``s = sqrt(5 G / (6 E horizon))`` in
    space, ``sqrt(4 pi G / (9 E horizon))`` in plane stress, ``sqrt(5 pi G / (12 E horizon))`` in plane strain.
    """
    lengths = np.linalg.norm(bonds, axis=1)
    return float(stretch**2 / 4 * (stiffness * lengths**3).sum() * (2 / np.pi if bonds.shape[1] == 2 else 0.5))


def stretch_that_spends(energy: Any, factor: float, young: float, horizon: float) -> Any:
    """Critical stretch s at which a crack spends the energy per area ``factor young horizon s^2``."""
    return np.sqrt(energy / (factor * young * horizon))


def final_stretch(bonds: np.ndarray, stiffness: np.ndarray, onset: Any, energy: Any) -> Any:
    """Stretch s1 at which softening bonds no longer carry any force, such that a crack across a plane spends the given
    energy per area, infinite where there are no bonds; `bonds` and `stiffness` as for `fracture_energy`, `onset` is s0.

    A bond whose force falls linearly from that at the stretch s0 to zero takes ``C V |xi|^2 s0 s1 / 2``, while it holds
    ``C V |xi|^2 s0^2 / 2`` at s0: over all bonds across a plane the energy is ``s0 s1`` times the `fracture_energy` of
    a stretch of 1. A force that decays as ``exp(-2 (s - s0) / (s1 - s0))`` takes the same energy but never reaches
    zero.
    """
    return energy / (fracture_energy(bonds, stiffness, 1.0) * onset)
