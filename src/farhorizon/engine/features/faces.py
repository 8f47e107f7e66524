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

from farhorizon.engine.bonds import LAW_EXTENT, LAW_FIRST, factors_of
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.feature import OPERATOR, Feature, Step
from farhorizon.engine.field import Field
from farhorizon.engine.layout import doubles, ints, with_defaults
from farhorizon.engine.passes import reads
from farhorizon.engine.threads import barrier, chunk_of, run_start


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


@reads("faces", "bonds")
def touch(thread, stage, sums, tables, inputs, step, number):
    """Let faces of cracks push each other, and slide; all entries of one node belong to one thread."""
    faces, thermal_strain = tables.faces, tables.bonds.thermal_strain
    chunk = chunk_of(thread, faces.nodes.size)
    src, base, d = stage.src, stage.base, stage.components
    apart = src.size // d
    most, ratio = faces.constants[0], faces.constants[1]
    for i in range(run_start(faces.nodes, chunk[0]), run_start(faces.nodes, chunk[1])):
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
    barrier(thread)


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


FACES = Feature(
    "faces",
    [Step(OPERATOR, touch, lambda tables, *_: tables.faces.nodes.size)],
    table=Faces,
    map=lambda faces: faces[:6],
    sums=lambda faces: {"rubbed": faces.rubbed[None]},
    other=lambda faces: {"slips": faces.slips},
)


def set_faces(
    engine: Field, nodes: np.ndarray, neighbours: np.ndarray, normals: np.ndarray, friction: float, ratio: float
) -> None:
    """Let the faces of cracks slide where their bonds close, in place of bonds that carry compression along themselves.

    Cut bonds are given by the places of their ends, one entry per direction, and the normal of the crack where they
    cross it, of any sign, shape (n, d). Those of which an end lies outside the zone of the law are left out. Entries
    that were set before keep their slips. `ratio` is the stiffness along the faces over that along the normal.
    """
    table, size, d, before = engine.bonds.table, engine.layout.size, engine.components, engine.tables.faces
    zone, exists = table.zone, engine.absent.exists
    ends = engine.layout.box.coordinates(neighbours) - zone[LAW_FIRST : LAW_FIRST + 3]
    kept = engine.bonds.contains(engine.layout.box.coordinates(nodes)) & exists[nodes] & exists[neighbours]
    kept &= ((ends >= 0) & (ends < zone[LAW_EXTENT : LAW_EXTENT + 3])).all(1)
    keys, first = np.unique((nodes * size + neighbours)[kept], return_index=True)  # of crossing cracks the first
    nodes, neighbours, normals = (array[kept][first] for array in (nodes, neighbours, normals))
    bonds = engine.layout.bonds_between(nodes, neighbours)
    arms = table.table[bonds, :d].astype(float)
    across = (normals * arms).sum(1)
    stiffness = table.table[bonds, d + 1] * across**2 / (arms**2).sum(1)
    material = engine.tables.material
    if table.forces:
        stiffness = stiffness * engine.absent.factors_at_surfaces(nodes, neighbours)
    else:
        material = material._replace(coefficient=table.contact_stiffness)
    rubbing = len(nodes) if friction else 0
    slips, rubbed = np.zeros((rubbing, d)), np.zeros(rubbing)
    if before.slips.size and rubbing:
        _, now, then = np.intersect1d(keys, before.nodes * size + before.neighbours, return_indices=True)
        slips[now], rubbed[now] = before.slips[then], before.rubbed[then]
    engine.bonds.part(nodes, bonds)
    faces = with_defaults(
        Faces,
        engine.dtype,
        nodes=nodes.astype(np.int64),
        neighbours=neighbours.astype(np.int64),
        normals=np.where(across < 0, -1.0, 1.0)[:, None] * normals,
        arms=arms,
        stiffness=stiffness * factors_of(material, nodes, neighbours),
        constants=np.array([friction, ratio]),
        slips=slips,
        rubbed=rubbed,
    )
    engine.replace(faces=faces)


def energies_of_faces(engine: Field, places: np.ndarray) -> tuple[float, float]:
    """Return the elastic energy of faces that touch, half a step ago, counted for some places, and the energy that
    friction has dissipated until then, everywhere; per unit mass of a node. The halo of the present level is filled.
    """
    faces = engine.tables.faces
    if not faces.nodes.size:
        return 0.0, 0.0
    gaps, alongs = zip(*(_motion(engine, level) for level in (engine.current, engine.older)), strict=True)
    (friction, ratio), (depth, ago) = faces.constants, (np.minimum(gap, 0.0) for gap in gaps)
    stored, lost = depth * ago, 0.0
    if faces.slips.size:
        trial, before = (along - faces.slips for along in alongs)
        size, grip = np.linalg.norm(trial, axis=1), -friction * depth / ratio
        share = np.divide(grip, size, out=np.ones_like(size), where=size > grip)[:, None]
        stored += ratio * (before * share * trial).sum(1)
        # of the slip of this step half is dissipated by the force before it
        lost = faces.rubbed.sum() + 0.25 * ratio * (faces.stiffness * (before * (1 - share) * trial).sum(1)).sum()
    unit = engine.stages.numbers[0][2]
    counted = np.isin(faces.nodes, places)
    return float(0.25 * (faces.stiffness * stored)[counted].sum() / unit), float(lost) / unit


def _motion(engine: Field, level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motion of the ends of the cut bonds relative to each other in a level: along the normal, and along the face."""
    faces, thermal_strain = engine.tables.faces, engine.tables.bonds.thermal_strain
    values = level.reshape(engine.components, -1).astype(float)
    apart = (values[:, faces.neighbours] - values[:, faces.nodes]).T
    if thermal_strain.size > 1:
        both = thermal_strain[faces.nodes].astype(float) + thermal_strain[faces.neighbours]
        apart -= (both / 2)[:, None] * faces.arms
    gap = (faces.normals * apart).sum(1)
    return gap, apart - gap[:, None] * faces.normals
