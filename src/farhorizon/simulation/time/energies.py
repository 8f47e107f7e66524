"""Energies of the near field."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from farhorizon.engine.engine import Engine
from farhorizon.engine.features.dissipation import dashpots, dissipated
from farhorizon.engine.features.drag import lost_by_drag
from farhorizon.engine.features.sources import work_of_sources
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.setup.grid import Grid
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Sides


def kinetic_energy(near: NearField, grid: Grid) -> float:
    """Return the kinetic energy of waves half a step ago."""
    rate = (_there(near, grid.get("u")).astype(float) - _there(near, grid.get("u_old"))) / near.dt
    return _kinetic(near, rate)


def _kinetic(near: NearField, rate: np.ndarray) -> float:
    """Kinetic energy for given velocities."""
    squares = rate**2 if near.density is None else rate**2 * _there(near, near.density)
    return float(near.mass * 0.5 * squares.sum())


def present(by_name: Mapping[str, float]) -> float:
    """Return the sum of the energies, given by name, that are present now: kinetic and stored ones."""
    return sum(by_name.get(name, 0.0) for name in ("kinetic", "strain", "reaction", "support", "stored", "thermal"))


def energies(parts: RunParts, work: bool, cold: bool = False, rim_held: bool = False) -> dict[str, float]:
    """Return the energies by name, see `farhorizon.Simulation.energies`. `work`: that of the sources is recorded;
    `cold`: thermal strains are not subtracted; `rim_held`: the field outside a body is fixed.
    """
    near, grid, breaking = parts.near, parts.grid, parts.breaking
    engine, lattice = grid.engine, near.lattice
    if near.model.order == 1:
        total = (_there(near, grid.get("u")).astype(float) ** 2).sum()
        return {"stored": float(0.5 * lattice.spacing**lattice.dim * total)}
    mass = near.mass
    lossy = near.model.attenuation is not None
    if lossy and not engine.get("dissipation.share").size:  # what the mechanisms hold follows from their dashpots
        return {"kinetic": kinetic_energy(near, grid)}
    further = {"drag": mass * lost_by_drag(engine)} if near.model.drag else {}
    if np.any(engine.reaction):
        now, ago = (_there(near, grid.get(name)).astype(float) for name in ("u", "u_old"))
        further["reaction"] = float(mass * 0.5 * (now * _drawn_back(engine, ago)).sum())
    if near.supports is not None:
        now, ago = (_there(near, grid.get(name)).astype(float) for name in ("u", "u_old"))
        stiffness = near.supports.stiffness * (1.0 if near.density is None else near.density)
        springs = _there(near, stiffness.reshape(near.field_shape))
        further["support"] = float(mass * 0.5 * (springs * now * ago).sum())
    if breaking is not None and engine.bonds.forces:
        return further | {
            "kinetic": kinetic_energy(near, grid),
            "strain": breaking.strain_energy(cold),
            "work": mass * work_of_sources(engine),
            "broken": mass * engine.bonds.broken[0],
            **breaking.friction(),
        }
    engine.complete("u")
    u, old = engine.get("u").astype(float), engine.get("u_old").astype(float)
    if parts.ends is not None:
        parts.ends.fill(u, old)
    rate = (_shown(near, grid, u) - _shown(near, grid, old)) / near.dt
    stretched = [(1.0, u, old)]
    if lossy:  # the relaxed springs, and those that dashpots follow
        held = dashpots(engine)
        stretched = [(1 - sum(share for share, _, _ in held), u, old)]
        for share, slid, slid_before in held:
            now, ago = u - slid, old - slid_before
            engine.complete(now)
            engine.complete(ago)
            stretched.append((share, now, ago))
        further["dissipated"] = mass * dissipated(engine)
    strain = np.sum(
        [
            share * _shown(near, grid, _strain(near, parts.layered.sides, grid, now, ago, rim_held))
            for share, now, ago in stretched
        ],
        axis=0,
    )
    if engine.get("heat.thermal_strain").size and not cold:  # the mixed and the purely thermal terms
        forces, resisted = engine.forces_of_heat()
        strain = strain - 2 * _shown(near, grid, forces * (u + old))
        strain[0] += _there(near, resisted[grid.nodes].reshape(near.lattice.shape))
    of_waves = {"kinetic": _kinetic(near, rate), "strain": float(mass * 0.25 * strain.sum())}
    if breaking is not None:
        further["broken"] = float(mass * engine.bonds.broken[0])
        if breaking.law.contact:
            of_waves["strain"] += breaking.strain_energy(cold)
            further |= breaking.friction()
    return of_waves | further | ({"work": mass * work_of_sources(engine)} if work else {})


def _strain(near: NearField, sides: Sides, grid: Grid, u: np.ndarray, old: np.ndarray, rim_held: bool) -> np.ndarray:
    """Four times the strain energy per unit of mass at each place of a level."""
    engine = grid.engine

    def apply(level: np.ndarray) -> np.ndarray:  # the bonds without the reaction
        return engine.apply_core(level.astype(engine.dtype)).astype(float) + _drawn_back(engine, level)

    strain = -u * apply(old) - old * apply(u)
    each, ago = u.reshape(engine.components, -1), old.reshape(engine.components, -1)
    for number, total in enumerate(strain.reshape(each.shape)):  # component by component: sum_b L_ab (u_a old_b)
        total += apply((each[number] * ago).ravel()).reshape(each.shape)[number]
    at_rest = grid.keyed({key: 0.0 for key, b in sides.items() if b.held == near.background})
    if at_rest or rim_held:  # the other half of the bonds to sides, and to the outside of a body, where u is zero
        inside = near.lattice.existing if rim_held else None
        core = np.ones(grid.core.nodes) if inside is None else grid.grown(inside.astype(float))
        exists = engine.spread(core, at_rest, jointly=inside is not None) * engine.get("exists")
        grid.clear_walls(exists)
        for unit, now in zip(
            np.eye(engine.components), each, strict=True
        ):  # sum_b (L there)_ba u_a old_b: L is symmetric
            strain -= (now * ago * apply(np.multiply.outer(unit, exists).ravel()).reshape(each.shape)).ravel()
    return strain


def _drawn_back(engine: Engine, values: np.ndarray) -> np.ndarray:
    """Apply the reaction to values, component by component."""
    if np.ndim(engine.reaction):
        return np.reshape(engine.reaction @ values.reshape(engine.components, -1), values.shape)
    return engine.reaction * values


def _shown(near: NearField, grid: Grid, level: np.ndarray) -> np.ndarray:
    """A level at the existing nodes of the near field."""
    part = grid.view(np.ascontiguousarray(level)).reshape(near.field_shape)
    return _there(near, part)


def _there(near: NearField, values: np.ndarray) -> np.ndarray:
    """Values at the existing nodes."""
    return values if near.lattice.mask is None else values[..., near.lattice.mask]
