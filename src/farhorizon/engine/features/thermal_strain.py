"""Thermal strains in the compiled loop: what a node would be strained by, in all directions, if it were free.

No force responds to them. A bond has the mean of the thermal strains of its ends, which its law subtracts
(`engine.codegen.bond_sweeps`); a state that of its node, and the law of the node acts on the remainder
(`engine.point_law`); the springs of state-based media have the mean of their ends again, which is subtracted here.
Between two times at which they are given thermal strains change linearly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.engine.bonds import END, FIRST, bond_factor, range_under_law
from farhorizon.engine.codegen.compiled import njit
from farhorizon.engine.feature import DONE, OPERATOR, Feature, Step
from farhorizon.engine.field import Field
from farhorizon.engine.layout import aligned_zeros, reals
from farhorizon.engine.passes import PUSHES, Operation, in_layers, reads
from farhorizon.engine.program import copy
from farhorizon.engine.tables import Tables
from farhorizon.engine.threads import barrier, chunk_of


class ThermalStrains(NamedTuple):
    """Thermal strains of the nodes; each table may be empty."""

    thermal_strain: np.ndarray = reals(0)  # (places,): at the present time
    rate: np.ndarray = reals(0)  # (places,): change per step
    #: (K, d): forces of the springs of state-based media per unit strain, in units of the operator
    vectors: np.ndarray = reals(0, 0)
    #: (K, d), if heat passes through the layers: the same for springs of state-based media and for all bonds of others,
    #: see `layer_passes.heat_passes`; `vectors` is empty then
    beyond: np.ndarray = reals(0, 0)
    traces: np.ndarray = reals(0)  # (places,): contributions of the layers to the traces of the stresses


@reads("heat")
def step_thermal_strains(thread, stage, sums, tables, inputs, step, number):
    """Advance the strains to the next step."""
    heat = tables.heat
    first, last = chunk_of(thread, heat.rate.size)
    for i in range(first, last):
        heat.thermal_strain[i] += heat.rate[i]
    barrier(thread)


@njit(error_model="numpy", cache=True)
def add_traces(traces, level, components, block, material, bonds, vectors):
    """Add to `traces`, for each place, half the sum over the present bonds of their relative displacement along
    `vectors`: the factor of the node's thermal strain in the energy. This is the adjoint of the thermal forces: the sum
    of strain times trace over all nodes equals that of displacement times force.
    """
    zone, coefficient, apart = bonds.zone, material.coefficient, level.size // components
    width = zone[END + 2] - zone[FIRST + 2]
    for i0 in range(zone[FIRST], zone[END]):
        for i1 in range(zone[FIRST + 1], zone[END + 1]):
            node = block[0] + i0 * block[4] + i1 * block[5] + zone[FIRST + 2]
            sums = traces[node : node + width]
            for k in range(vectors.shape[0]):
                distance, bit, unity = bonds.places[k, 0], np.uint64(k & 63), np.uint64(1)
                alive = bonds.alive[k >> 6, node : node + width]
                for a in range(components):
                    half = 0.5 * np.float64(vectors[k, a])
                    if half == 0:
                        continue
                    near, far = level[node + a * apart :], level[node + distance + a * apart :]
                    if coefficient.size > 1:
                        for i in range(width):
                            at = node + i
                            factor = bond_factor(material.rule, coefficient[at], coefficient[at + distance])
                            stretch = half * factor * (np.float64(far[i]) - np.float64(near[i]))
                            sums[i] += stretch * np.float64((alive[i] >> bit) & unity)
                    else:
                        for i in range(width):
                            stretch = half * (np.float64(far[i]) - np.float64(near[i]))
                            sums[i] += stretch * np.float64((alive[i] >> bit) & unity)


@njit(error_model="numpy", cache=True)
def add_traces_of_states(traces, values, block, bonds, units):
    """Add to `traces` the product of the law's results with the sum of `units` over the present bonds, where `units` is
    the contribution of each bond to the state of a unit strain in all directions.
    """
    zone, size = bonds.zone, values.size // units.shape[1]
    width = zone[END + 2] - zone[FIRST + 2]
    for i0 in range(zone[FIRST], zone[END]):
        for i1 in range(zone[FIRST + 1], zone[END + 1]):
            node = block[0] + i0 * block[4] + i1 * block[5] + zone[FIRST + 2]
            sums = traces[node : node + width]
            for k in range(units.shape[0]):
                bit, unity = np.uint64(k & 63), np.uint64(1)
                alive = bonds.alive[k >> 6, node : node + width]
                for row in range(units.shape[1]):
                    unit, result = units[k, row], values[row * size + node :]
                    if unit != 0:
                        for i in range(width):
                            sums[i] += unit * np.float64(result[i]) * np.float64((alive[i] >> bit) & unity)


@reads("bonds", "heat")
def add_thermal_forces(thread, stage, sums, tables, inputs, step, number):
    """Subtract the forces of thermal strains from those of the present springs.

    Nodes outside the zone of the bonds have no thermal strain, like the medium far away.
    """
    block, material, bonds, heat = sums.sweep.block, sums.liquid, tables.bonds, tables.heat
    zone, thermal_strain, vectors, coefficient = bonds.zone, heat.thermal_strain, heat.vectors, material.coefficient
    planes, rows, width = zone[END] - zone[FIRST], zone[END + 1] - zone[FIRST + 1], zone[END + 2] - zone[FIRST + 2]
    apart, chunk = stage.out.size // stage.components, chunk_of(thread, planes * rows)
    for number in range(chunk[0], chunk[1]):
        i0, i1 = zone[FIRST] + number // rows, zone[FIRST + 1] + number % rows
        node = block[0] + i0 * block[4] + i1 * block[5] + zone[FIRST + 2]
        for k in range(vectors.shape[0]):
            distance, bit = bonds.places[k, 0], np.uint64(k & 63)
            alive, unity = bonds.alive[k >> 6, node:], np.uint64(1)
            near, far = thermal_strain[node:], thermal_strain[node + distance :]
            for a in range(stage.components):
                push, out = stage.scale * vectors[k, a] / 2, stage.out[node + a * apart :]
                for i in range(width):
                    factor = coefficient[0]
                    if coefficient.size > 1:
                        at = node + i
                        factor = bond_factor(material.rule, coefficient[at], coefficient[at + distance])
                    if (alive[i] >> bit) & unity != 0:
                        out[i] -= push * factor * (near[i] + far[i])
    barrier(thread)


@reads("bonds", "heat")
def add_thermal_forces_beyond(thread, stage, sums, tables, inputs, step, number):
    """Subtract the forces of thermal strains, on all nodes of the box, from those of the present bonds without a law of
    their own, or of the springs of state-based media.
    """
    block, material, bonds, heat = sums.sweep.block, sums.liquid, tables.bonds, tables.heat
    vectors, coefficient, thermal_strain = heat.beyond, material.coefficient, heat.thermal_strain
    apart, chunk = stage.out.size // stage.rows, chunk_of(thread, block[1] * block[2])
    for number in range(chunk[0], chunk[1]):
        i0, i1 = number // block[2], number % block[2]
        node = block[0] + i0 * block[4] + i1 * block[5]
        for k in range(vectors.shape[0]):
            distance, mask = bonds.places[k, 0], np.uint64(1) << np.uint64(k & 63)
            alive = bonds.alive[k >> 6, node:]
            start, stop = range_under_law(bonds.zone, i0, i1, bonds.places[k], 0, block[3]) if bonds.forces else (0, 0)
            for first, end in ((0, start), (stop, block[3])):
                for a in range(stage.rows):
                    push, out = stage.scale * vectors[k, a] / 2, stage.out[node + a * apart :]
                    for i in range(first, end):
                        at = node + i
                        factor = coefficient[0]
                        if coefficient.size > 1:
                            factor = bond_factor(material.rule, coefficient[at], coefficient[at + distance])
                        if alive[i] & mask != 0:
                            out[i] -= push * factor * (thermal_strain[at] + thermal_strain[at + distance])
    barrier(thread)


def _beyond(tables: Tables, operation: Operation) -> list[Operation]:
    return in_layers(tables, PUSHES, [operation])


HEAT = Feature(
    "heat",
    [
        Step(OPERATOR, add_thermal_forces, lambda tables, *_: tables.heat.vectors.size),
        Step(
            OPERATOR,
            add_thermal_forces_beyond,
            lambda tables, *_: tables.heat.beyond.size,
            around=_beyond,
            which=PUSHES,
        ),
        Step(DONE, step_thermal_strains, lambda tables, *_: tables.heat.rate.size),
    ],
    table=ThermalStrains,
    more=lambda heat: {"thermal_strain": heat.thermal_strain},
)


def set_thermal_strain(engine: Field, spacing: float) -> None:
    """Let nodes, a spacing apart in the unit of the field, have thermal strains from now on, whose values
    `give_thermal_strain` sets; requires `BondZone.set` with `warm`.
    """
    tables, thermal_strain = engine.tables, engine.tables.bonds.thermal_strain
    arms = spacing * engine.offsets[:, 3 - engine.components :].astype(float)
    if engine.passes is not None:
        gradient_pass = tables.gradient_pass
        law = gradient_pass.sweep.law._replace(
            thermal_strain=thermal_strain, spacing=engine.dtype.type(spacing), arms=arms.astype(engine.dtype)
        )
        engine.replace(gradient_pass=gradient_pass._replace(sweep=gradient_pass.sweep._replace(law=law)))
    springs = engine.passes is not None and engine.weights.any() and not engine.heat_passes
    vectors = np.einsum("kab,kb->ka", engine.weights, arms) if springs else np.zeros((0, 0))
    heat = ThermalStrains(
        thermal_strain=thermal_strain,
        rate=np.zeros_like(thermal_strain),
        vectors=vectors.astype(engine.dtype),
        beyond=engine.heat_vectors.astype(engine.dtype),
        traces=aligned_zeros(engine.layout.size if engine.heat_passes else 0, engine.dtype),
    )
    engine.replace(heat=heat)


def give_thermal_strain(engine: Field, strain: np.ndarray, rate: np.ndarray, steps: int = 0) -> None:
    """Set the thermal strains of the nodes of the core as of some steps ago, and their change per step; all processes
    that exchange halos call this together.
    """
    heat = engine.tables.heat
    heat.thermal_strain[:] = engine.spread(strain, jointly=True) * engine.absent.exists
    heat.rate[:] = engine.spread(rate, jointly=True) * engine.absent.exists
    for _ in range(steps):
        heat.thermal_strain[:] += heat.rate


def give_thermal_strain_beyond(engine: Field, places: np.ndarray, strains: np.ndarray) -> None:
    """Set the thermal strains of nodes in the layers and in front of them, by their places in a level, after
    `give_thermal_strain`; they stay until the next call. Beyond the outer ends of the layers they are zero.
    """
    thermal_strain, nodes = engine.tables.heat.thermal_strain, engine.layout.box.node_indices()
    thermal_strain[places] = strains * engine.absent.exists[places]
    inside = thermal_strain[nodes]
    thermal_strain[:] = 0
    thermal_strain[nodes] = inside
    copy(thermal_strain, engine.tables.copies, 1)
