"""Faces of cracks that touch and slide, in the compiled loop.

A cut bond whose ends have come closer along the normal of the crack, by a depth d, pushes them apart along the normal
with ``k d``, where ``k = c (n . xi)^2 / |xi|^2``, c being its force over its elongation: under uniaxial strain along
the normal these forces are those of the intact bonds. Friction is elastic until it slips: a spring of ``k`` times the
ratio of the moduli of S and P waves draws the ends back along the face, as stiff against shear as the solid, until its
force is Coulomb's; what exceeds this is slip. Both directions of a bond are computed alike, to the last bit.

Forces along a normal are not along the bond: momentum is conserved pair by pair, angular momentum in the mean over
bonds on both sides of the normal. Normals stay as they were, so that a rotation w moves the ends of a bond as a gap or
a slip of w times its length would: strains and rotations must be small. Where all faces of random cracks stick, the
largest squared frequency exceeds that of an intact solid of bonds by 0.0015 or less (measured).

With the elongation e of the spring, the work of friction in a step is ``k_t e . (s(n+1) - s(n-1)) / 2`` with the slip
s before and after; with elastic energies ``k_t e(n) . e(n-1) / 2`` the scheme then balances energies to rounding, as
for linear bonds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.layout import doubles, ints


class Faces(NamedTuple):
    """Cut bonds whose faces slide, n of them, one entry per direction, sorted; fields of d components."""

    nodes: np.ndarray = ints(0)  # places, as those of the neighbours
    neighbours: np.ndarray = ints(0)
    normals: np.ndarray = doubles(0, 0)  # unit vectors to the side of the neighbour, shape (n, d)
    arms: np.ndarray = doubles(0, 0)  # bond vectors, shape (n, d)
    stiffness: np.ndarray = doubles(0)  # along the normal, in units of the update; shape (n,)
    constants: np.ndarray = doubles(2)  # coefficient of friction, stiffness along the face over that along the normal
    slips: np.ndarray = doubles(0, 0)  # shape (n, d), or empty without friction
    rubbed: np.ndarray = doubles(0)  # energy that each entry has lost by friction, in units of c; shape (n,), or empty
    moving: int = 1  # whether slips advance


@njit(error_model="numpy", cache=True, counted=False)
def press_faces(stage, faces, thermal_strain, first, last):
    """Add the forces on the nodes of some entries; all those of one node belong to one thread."""
    src, base, d = stage.src, stage.base, stage.components
    apart = src.size // d
    most, ratio = faces.constants[0], faces.constants[1]
    for i in range(first, last):
        node, there, normal, mean = faces.nodes[i], faces.neighbours[i], faces.normals[i], 0.0
        if thermal_strain.size > 1:
            mean = 0.5 * (np.float64(thermal_strain[node]) + np.float64(thermal_strain[there]))
        gap = _along(src, node, there, normal, mean, faces.arms[i], apart)
        push = faces.stiffness[i] * min(gap, 0.0)
        if not faces.slips.size:
            for c in range(d):
                _pull(stage, node + c * apart, push * normal[c])
            continue
        slip, size = faces.slips[i], 0.0
        for c in range(d):
            size += (_apart(src, node, there, c, mean, faces.arms[i], apart) - gap * normal[c] - slip[c]) ** 2
        size, grip = np.sqrt(size), -most * min(gap, 0.0) / ratio
        share = 1.0 if size <= grip else grip / size
        ago = _along(base, node, there, normal, mean, faces.arms[i], apart) if share < 1 else 0.0
        for c in range(d):
            trial = _apart(src, node, there, c, mean, faces.arms[i], apart) - gap * normal[c] - slip[c]
            _pull(stage, node + c * apart, push * normal[c] + ratio * faces.stiffness[i] * share * trial)
            if share < 1 and faces.moving:
                before = _apart(base, node, there, c, mean, faces.arms[i], apart) - ago * normal[c] - slip[c]
                slid = (1 - share) * trial
                # half of the energy is counted at either end
                faces.rubbed[i] += 0.25 * ratio * faces.stiffness[i] * (before + share * trial) * slid
                slip[c] += slid


@njit(error_model="numpy", cache=True, counted=False)
def _apart(level, node, there, c, mean, arm, apart):
    """One component of the motion of the ends of a bond relative to each other, less that of heat."""
    return np.float64(level[there + c * apart]) - np.float64(level[node + c * apart]) - mean * arm[c]


@njit(error_model="numpy", cache=True, counted=False)
def _along(level, node, there, normal, mean, arm, apart):
    """How far the ends of a bond have moved apart along the normal."""
    total = 0.0
    for c in range(normal.size):
        total += normal[c] * _apart(level, node, there, c, mean, arm, apart)
    return total


@njit(error_model="numpy", cache=True, counted=False)
def _pull(stage, place, gain):
    """Change one component of a node's new value."""
    stage.out[place] += gain
    if stage.increments:
        stage.base[place] += gain
