"""Sets the faces of cracks that slide in an engine, and their energies."""

from __future__ import annotations

import numpy as np

from farhorizon.engine.bonds import LAW_EXTENT, LAW_FIRST, factors_of
from farhorizon.engine.engine import Engine
from farhorizon.engine.faces import Faces
from farhorizon.engine.layout import with_defaults


def set_faces(
    engine: Engine, nodes: np.ndarray, neighbours: np.ndarray, normals: np.ndarray, friction: float, ratio: float
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


def energies_of_faces(engine: Engine, places: np.ndarray) -> tuple[float, float]:
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


def _motion(engine: Engine, level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motion of the ends of the cut bonds relative to each other in a level: along the normal, and along the face."""
    faces, thermal_strain = engine.tables.faces, engine.tables.bonds.thermal_strain
    values = level.reshape(engine.components, -1).astype(float)
    apart = (values[:, faces.neighbours] - values[:, faces.nodes]).T
    if thermal_strain.size > 1:
        both = thermal_strain[faces.nodes].astype(float) + thermal_strain[faces.neighbours]
        apart -= (both / 2)[:, None] * faces.arms
    gap = (faces.normals * apart).sum(1)
    return gap, apart - gap[:, None] * faces.normals
