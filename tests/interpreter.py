"""Plain numpy program that executes the same table of operations as the compiled loop (`farhorizon.engine.loop`): the
reference of the tests, and a model for implementations on other machines.

It follows the definitions: each bond by itself, and each stretched shift written out, with its own memory for every
offset of the stencil. It is slow, and keeps the layers' memory to itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from farhorizon.engine import feature_list
from farhorizon.engine import passes as op
from farhorizon.engine.bonds import LAW_EXTENT, LAW_FIRST, PHASES, Bonds, factors_of
from farhorizon.engine.damage import STATES_AGAIN
from farhorizon.engine.engine import Engine
from farhorizon.engine.exchange import LEVEL
from farhorizon.engine.features.filter import Filter
from farhorizon.engine.features.impactors import BOX, DIFFERENCE, ROUND, UNION, Impactors
from farhorizon.engine.shape_tensors import stress_left
from farhorizon.engine.tables import Inputs, Material, Stage, Tables
from farhorizon.engine.two_pass import TwoPassOperator
from farhorizon.geometry.shapes import Polygon
from stretched_shifts import StretchedShifts


class Interpreter:
    """Advances an engine whose layers have no memory yet.

    Parameters
    ----------
    engine : Engine
        As the argument `engine` of a `Simulation` is called with.
    """

    def __init__(self, engine: Engine) -> None:
        if engine.memory.any():
            raise ValueError("the layers' memory is not empty")
        self.engine, self.components = engine, engine.components
        self.box = engine.layout.box
        self.places = self.box.node_indices()
        self.nodes = self.places.ravel()
        self.matrices = engine.weights.reshape(len(engine.offsets), self.components, self.components)
        self.memory: dict[object, np.ndarray] = {}
        self.shifts = StretchedShifts(engine, self.memory)
        self.states = None if engine.passes is None else _States(self, engine.passes)
        self.heat = _Heat(self)
        self.methods: dict[str, Callable[..., None]] = {
            op.COPY: self._copy,
            op.SEND: lambda number: None,  # `receive` reads the values where they are
            op.RECEIVE: self.receive,
            op.AHEAD: lambda: None,  # `_sweep` sweeps all rows
            op.LINES: lambda: None,  # `_stretch` continues the field itself
            op.SWEEP: self._sweep,
            op.CUT: self._cut,
            op.STRETCH: self._stretch,
        }

    def __call__(self, steps: int, phase: int, levels: np.ndarray, tables: Tables, inputs: Inputs) -> None:
        """Advance as `loop.run` does; given a memory other than the engine's, leave that of the layers as it was."""
        kept = (
            None
            if np.shares_memory(tables.layers.memory, self.engine.memory)
            else {k: a.copy() for k, a in self.memory.items()}
        )
        self.tables, self.inputs = tables, inputs
        whole = {step.name for step in feature_list.steps() if step.whole}
        for self.step in range(steps):
            for part in range(tables.rotation.shape[1]):
                src, base, out = (levels[i] for i in tables.rotation[phase, part])
                a, a_difference, b, scale, _ = tables.numbers[part]
                self.shifts.stage = part
                self.stage = Stage(
                    src, base, out, part, a, a_difference, b, scale, tables.increments, self.components, self.components
                )
                for operation, number, which in tables.operations[part]:
                    if operation in whole:  # of the increments of the whole step
                        self.stage = self.stage._replace(src=levels[tables.rotation[phase, 0, 0]])
                    if which in (op.PUSHES, op.TRACES) and operation == op.STRETCH:
                        self.heat.stretch(number, which)
                    elif which == op.NEIGHBOURS and operation == op.STRETCH:
                        self._stretch_neighbours(number)
                    elif which == op.INFLOW:
                        self._flow_of_layers(operation, number)
                    elif which in (op.GRADIENT, op.DIVERGENCE):
                        assert self.states is not None
                        self.states.run(operation, number, which)
                    else:
                        of_feature = getattr(self, operation, None) or getattr(self.heat, operation, None)
                        method = self.methods.get(operation, of_feature)
                        method(*[number] * (operation in (op.STRETCH, op.SEND, op.RECEIVE)))
            phase = (phase + 1) % len(tables.rotation)
        if kept is not None:
            self.memory.clear()
            self.memory.update(kept)

    # --- levels ------------------------------------------------------------------------------------------------

    def split(self, level: np.ndarray) -> np.ndarray:
        """Return a level by component, as a view."""
        return level.reshape(self.components, -1)

    def _set(self, nodes: np.ndarray, values: np.ndarray) -> None:
        """Set nodes to their values at the new step."""
        stage = self.stage
        stage.out[nodes] = values
        if stage.increments:
            stage.base[nodes] = stage.out[nodes] - stage.src[nodes]

    def hold(self) -> None:
        stage, nodes, values = self.stage, self.inputs.held, self.inputs.held_values[self.step]
        mobility = (
            np.tile(self.tables.mobility, self.components) if self.tables.mobility.size else np.ones(stage.out.size)
        )
        force = (values - stage.out[nodes]) / (stage.scale * mobility[nodes])
        if self.tables.work.size:
            self.tables.work[0] += 0.5 * force @ (values - stage.base[nodes])
        if len(self.inputs.held_forces):
            self.inputs.held_forces[self.step] = force
        self._set(nodes, values)

    def add(self, values: np.ndarray, nodes: np.ndarray | None = None) -> None:
        """Add increments of shape (components, nodes) to the new step, at all nodes unless some are given."""
        nodes = self.nodes if nodes is None else nodes
        for level in (self.stage.out, self.stage.base)[: 1 + self.stage.increments]:
            for component, gains in zip(self.split(level), values, strict=True):
                np.add.at(component, nodes, gains)

    def _copy(self) -> None:
        levels = self.split(self.stage.src)
        _copy(levels, self.tables.copies)

    def receive(self, number: int, levels: np.ndarray | None = None) -> None:
        """Copy values where a process is its own neighbour: there are no other processes here. Slots are not used."""
        assert self.engine.exchange is not None
        levels, (which, axis) = self.split(self.stage.src) if levels is None else levels, divmod(number, 3)
        messages = self.engine.exchange.messages[which].along(axis)
        for to, source, sent, filled, _ in messages.rows if which == LEVEL else ():
            assert to == source == messages.link.rank
            levels[:, filled] = levels[:, sent]

    def _is_recorded(self) -> bool:
        return (self.inputs.before[0] + self.step + 1) % self.inputs.stride == 0

    def record_nodes_last(self) -> None:
        for _, place, column, count in self.inputs.recorded_nodes.tolist() if self._is_recorded() else ():
            self.inputs.node_values[self.step, column : column + count] = self.stage.out[place : place + count]

    def record_blocks_last(self) -> None:
        block_sums = self.tables.block_sums
        sizes = np.repeat(block_sums.sets[:, 1:], block_sums.sets[:, 0], axis=0).tolist()
        rows = zip(block_sums.rows.tolist(), sizes, strict=True) if self._is_recorded() else ()
        for (_, place, *first, column), nodes in rows:
            along = [block_sums.weights[a : a + count] for a, count in zip(first, nodes, strict=True)]
            block = np.lib.stride_tricks.as_strided(
                self.stage.out[place:], nodes, block_sums.stride * self.stage.out.itemsize
            )
            self.inputs.block_values[self.step, column] = np.einsum("ijk,i,j,k", block, *along)

    # --- bonds -------------------------------------------------------------------------------------------------

    def factors(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Return the factors of bonds from the coefficients at their ends."""
        return factors_of(self.tables.material, nodes, neighbours)

    def _gaps(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Return the differences between the values at the ends of bonds, shape (components, bonds)."""
        src, material = self.split(self.stage.src), self.tables.material
        u_nodes, u_neighbours = src[:, nodes], src[:, neighbours]
        if material.rule == PHASES:
            between = material.coefficient[nodes] * material.coefficient[neighbours] < 0
            u_nodes, u_neighbours = (
                np.where(between, np.minimum(u, material.ceiling), u) for u in (u_nodes, u_neighbours)
            )
        return np.asarray(u_neighbours - u_nodes)

    def _sweep(self) -> None:
        stage, nodes, forces = self.stage, self.nodes, self.tables.bonds.forces
        total = np.zeros((self.components, nodes.size))
        for distance, weight in zip(self.engine.offsets @ self.box.stride, self.matrices, strict=True):
            gaps = self.factors(nodes, nodes + distance) * self._gaps(nodes, nodes + distance)
            total += weight @ (gaps if forces else gaps * self.present(nodes, nodes + distance))
        if np.ndim(self.engine.reaction):
            total -= self.engine.reaction @ self.split(stage.src)[:, nodes]
        if forces:
            total += self._released()
        total *= stage.scale
        if self.tables.bonds.places.size and forces:
            self._pull_bonds(total)
        src, base, out = (self.split(level) for level in stage[:3])
        if stage.increments:
            base[:, nodes] = stage.a_difference * src[:, nodes] + stage.b * base[:, nodes] + total
            out[:, nodes] = src[:, nodes] + base[:, nodes]
        else:
            out[:, nodes] = stage.a_difference * src[:, nodes] + stage.b * base[:, nodes] + total

    def _released(self) -> np.ndarray:
        """Return the contributions of bonds to places without a node, which the sweep has included."""
        exists, nodes = self.engine.absent.exists, self.nodes
        total = np.zeros((self.components, nodes.size))
        zone = self.zone() if self.tables.bonds.places.size else np.zeros(nodes.size, bool)
        for distance, weight in zip(self.engine.offsets @ self.box.stride, self.matrices, strict=True):
            bare = exists[nodes] & ~exists[nodes + distance] & ~zone
            total -= bare * (weight @ (self.factors(nodes, nodes + distance) * self._gaps(nodes, nodes + distance)))
        return total

    def zone(self) -> np.ndarray:
        """Return which nodes have bonds that are handled one by one."""
        zone = self.tables.bonds.zone
        at = np.indices(self.box.nodes).reshape(3, -1)
        return np.asarray(((at >= zone[6:9, None]) & (at < zone[9:, None])).all(0))

    def stretches(self) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Yield for each bond of the nodes in the zone: its number, the nodes, at which of them it is present, where
        it follows the law, its vector, deformed where the law is nonlinear, and its strain e.
        """
        bonds, src, d = self.tables.bonds, self.split(self.stage.src), self.components
        inside = np.flatnonzero(self.zone())
        nodes, at = self.nodes[inside], np.indices(self.box.nodes).reshape(3, -1)[:, inside]
        for bond, (place, *offset) in enumerate(bonds.places):
            xi, inverse = bonds.table[bond, :d, None], bonds.table[bond, d]
            curved = _follow_law(bonds.zone, at) & _follow_law(bonds.zone, at + np.array(offset)[:, None])
            eta = src[:, nodes + place] - src[:, nodes]
            bent = np.where(curved & bonds.nonlinear, eta, 0)
            alive = bonds.alive[bond >> 6, nodes] & np.uint64(1) << np.uint64(bond & 63) != 0
            warm = curved * self.thermal_strain(nodes, nodes + place)
            yield bond, nodes, alive, curved, xi + bent, (eta * (2 * xi + bent)).sum(0) * inverse - 2 * warm

    def thermal_strain(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Return the thermal strains of bonds: the mean over their ends."""
        thermal_strain = np.broadcast_to(self.tables.bonds.thermal_strain, self.engine.layout.size)
        return np.asarray((thermal_strain[nodes] + thermal_strain[neighbours]) / 2)

    def limits(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Return the largest strain e at which bonds do not break."""
        bonds = self.tables.bonds
        strength = np.broadcast_to(bonds.strength, self.engine.layout.size)
        strength = np.minimum(strength[nodes], strength[neighbours])
        if bonds.stiffness.size == 1:
            return np.asarray(bonds.limit[0] * strength)
        stiffness = factors_of(self.tables.material._replace(coefficient=bonds.stiffness), nodes, neighbours)
        limit = np.sqrt(1 + bonds.limit[0]) - 1 if bonds.nonlinear else bonds.limit[0]
        limit = limit * np.sqrt(strength / stiffness)
        return np.asarray(limit * (2 + limit) if bonds.nonlinear else limit)

    def clear(self, bond: int, nodes: np.ndarray) -> None:
        """Remove a bond at some nodes."""
        self.tables.bonds.alive[bond >> 6, nodes] &= ~(np.uint64(1) << np.uint64(bond & 63))

    def _pull_bonds(self, total: np.ndarray) -> None:
        """Replace the forces of the stencil by those of bonds with a law of their own, and break bonds."""
        bonds, d = self.tables.bonds, self.components
        inside = np.flatnonzero(self.zone())
        total[:, inside] = 0
        for bond, nodes, alive, curved, ahead, e in self.stretches():
            place, xi, stiffness = bonds.places[bond, 0], bonds.table[bond, :d, None], bonds.table[bond, d + 1]
            limit = self.limits(nodes, nodes + place)
            over = alive & curved & (e > limit)
            before = bonds.residual_stiffness[bond, nodes] if bonds.residual_stiffness.size else np.ones(len(nodes))
            now = _shares(bonds, self.engine.bonds.softening, nodes, nodes + place, e, limit)
            left = np.where(over, np.minimum(before, now), before)
            gone = over & (left <= 0)
            self.clear(bond, nodes[gone])
            if bonds.residual_stiffness.size:
                bonds.residual_stiffness[bond, nodes] = left
            c = stiffness * self.factors(nodes, nodes + place)
            self._count_broken(nodes[over], place, xi, ((before - left) * c)[over])
            bonds.broken[0, 0, 1] += 0.5 * gone.sum()
            pull = np.where(curved & bonds.nonlinear, 1 / (1 + e + np.sqrt(np.maximum(1 + e, 0))), 0.5)
            pushes = _lasts(bonds, bond, nodes) & curved & (e < 0)
            total[:, inside] += np.where(pushes, 1.0, (alive & ~gone) * left) * c * e * pull * ahead

    def _count_broken(self, nodes: np.ndarray, place: int, xi: np.ndarray, stiffness: np.ndarray) -> None:
        """Add half the energy that bonds lose with this stiffness, from their elongations now and a step ago."""
        length = np.sqrt((xi**2).sum())
        stretched = []
        for level in (self.stage.src, self.stage.base):
            u = self.split(level)
            eta = u[:, nodes + place] - u[:, nodes]
            longer = np.sqrt(((xi + eta) ** 2).sum(0)) - length if self.tables.bonds.nonlinear else xi.T @ eta / length
            stretched.append(np.ravel(longer) - length * self.thermal_strain(nodes, nodes + place))
        self.tables.bonds.broken[0, 0, 0] += 0.25 * (stiffness * stretched[0] * stretched[1]).sum()

    def _cut(self) -> None:
        if not self.tables.bonds.forces:
            return  # the sums are those over the bonds that are there
        cuts, d = self.tables.cuts, self.components
        lost = self.factors(cuts.nodes, cuts.neighbours) * self._gaps(cuts.nodes, cuts.neighbours)
        weights = cuts.weights.reshape(-1, d, d)
        self.add(-self.stage.scale * np.einsum("iab,bi->ai", weights, lost), cuts.nodes)

    def touch(self) -> None:
        """Push the faces of cracks apart along their normals; friction draws them back until it slips."""
        faces, kept = self.tables.faces, self.stage
        if not len(faces.nodes):
            return

        def moved(level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            u = self.split(level)
            apart = (u[:, faces.neighbours] - u[:, faces.nodes]).T
            apart = apart - np.reshape(self.thermal_strain(faces.nodes, faces.neighbours), (-1, 1)) * faces.arms
            gap = np.einsum("ic,ic->i", apart, faces.normals)[:, None] * faces.normals
            return gap, apart - gap

        gap, along = moved(kept.src)
        depth = np.where((gap * faces.normals).sum(1, keepdims=True) < 0, gap, 0)
        force = depth
        if len(faces.slips):
            friction, ratio = faces.constants
            trial, grip = along - faces.slips, friction / ratio * np.linalg.norm(depth, axis=1)
            size = np.linalg.norm(trial, axis=1)
            held = trial * np.minimum(1, np.divide(grip, size, out=np.ones_like(size), where=size > 0))[:, None]
            force = depth + ratio * held
            if faces.moving:
                both = moved(kept.base)[1] - faces.slips + held
                faces.rubbed[:] += 0.25 * ratio * faces.stiffness * (both * (trial - held)).sum(1)
                faces.slips[:] = along - held
        self.add((faces.stiffness[:, None] * force).T, faces.nodes)

    # --- layers ------------------------------------------------------------------------------------------------

    def _stretch(self, axis: int) -> None:
        self.add(self.stage.scale * self._springs(axis).reshape(self.components, -1))

    def _springs(self, axis: int) -> np.ndarray:
        return self.stretched(axis, self.split(self.stage.src), self.matrices, op.BOND_STENCIL)

    def stretched(self, axis: int, level: np.ndarray, matrices: np.ndarray, number: int) -> np.ndarray:
        """Return stretched less plain shifts along an axis, with later axes stretched, as sums of a pass over a
        level.
        """
        engine = self.engine
        if axis == max(a for a in range(3) if self.shifts.serve(a)):
            self.shifts.begin(number, level)
        total = np.zeros((matrices.shape[1], *self.box.nodes))
        for offset, weight in zip(engine.offsets.tolist(), matrices, strict=True):
            if offset[axis]:
                more = self.shifts.at_nodes(self.shifts.along(tuple(offset), axis), offset, axis)
                later = next((a for a in range(axis + 1, 3) if self.shifts.serve(a)), 3)
                less = self.shifts.at_nodes(self.shifts.along(tuple(offset), later), offset, later)
                at = self.nodes + int(np.dot(offset, self.box.stride))
                weights_of_bonds = self.present(self.nodes, at) * self._factors_of_pass(number, at)
                total += np.tensordot(weight, (more - less) * weights_of_bonds.reshape(self.box.nodes), 1)
        return total

    def _factors_of_pass(self, number: int, neighbours: np.ndarray) -> np.ndarray | float:
        """Return the factors of the bonds of all nodes in a pass; those of states and of drag have none."""
        return 1.0 if number in (op.GRADIENT, op.DIVERGENCE, op.NEIGHBOURS) else self.factors(self.nodes, neighbours)

    def present(self, nodes: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
        """Return which bonds are present, considering absent bonds and places without a node."""
        engine, tables = self.engine, self.tables
        cuts = tables.cuts if engine.passes is None else tables.gradient_pass.cuts
        size = engine.layout.size
        present = ~np.isin(nodes * size + neighbours, cuts.nodes * size + cuts.neighbours)
        if not tables.bonds.forces and len(nodes):
            bond = int(np.flatnonzero(tables.bonds.places[:, 0] == neighbours[0] - nodes[0])[0])
            present &= tables.bonds.alive[bond >> 6, nodes] & np.uint64(1) << np.uint64(bond & 63) != 0
        return np.asarray(present & (engine.absent.exists[nodes] == engine.absent.exists[neighbours]))

    # --- the rest of a stage -----------------------------------------------------------------------------------

    def damp_old(self) -> None:
        stage, (nodes, before, _, _) = self.stage, self.tables.damping
        if stage.increments:
            stage.base[nodes] *= before
        else:
            stage.base[nodes] = stage.src[nodes] - (stage.src[nodes] - stage.base[nodes]) * before

    def scale_by_mobility(self) -> None:
        stage, nodes = self.stage, self.engine.all_components(self.nodes)
        src, mobile = stage.src[nodes], np.tile(self.tables.mobility[self.nodes], self.components)
        free = src - stage.b * (src - stage.base[nodes])
        stage.out[nodes] = free + mobile * (stage.out[nodes] - free)

    def relax_all_forces(self) -> None:
        """Filter what the forces have done, in the recursive form."""
        stage, nodes = self.stage, self.engine.all_components(self.nodes)
        relaxations, src = self.tables.relaxations, stage.src[nodes]
        spectra = np.tile(relaxations.numbers[self.nodes], self.components)
        keep, now, later = (factors[spectra].T for factors in relaxations[:3])
        force = stage.out[nodes] - (src - stage.b * (src - stage.base[nodes]))
        relaxed = relaxations.memory[:, nodes] + now * force
        weaker = relaxations.total[spectra] - now.sum(0)  # of the unrelaxed forces
        stage.out[nodes] -= relaxed.sum(0) + weaker * force
        relaxations.memory[:, nodes] = keep * relaxed + (later - keep * now) * force

    def dissipate(self) -> None:
        """Move the dashpots, which follow from the history of the displacement, and accumulate their power."""
        stage, nodes, dissipation = self.stage, self.engine.all_components(self.nodes), self.tables.dissipation
        share, rate, keep, before, now = (factors[:, None] for factors in dissipation[:5])
        src, kept = stage.src[nodes], self.tables.relaxations.memory[:, nodes]
        left = stage.out[nodes] - (src - stage.b * (src - stage.base[nodes]))
        force = (left + (kept / keep).sum(0)) / (1 + (share * before / keep).sum())
        dashpots = dissipation.slid[:, nodes] + now * src
        power = -rate * (src - dashpots) * (share * force - (kept - share * before * force) / keep)
        inside = tuple(slice(a, b) for a, b in zip(dissipation.first, dissipation.end, strict=True))
        shown = power.sum(0).reshape(self.components, *self.box.nodes)[(slice(None), *inside)]
        dissipation.lost[inside[:2]] += shown.sum((0, 3))
        dissipation.slid[:, nodes] = keep * dashpots + before * src

    def keep_increments(self) -> None:
        self.tables.drag.moved[:] = self.stage.src - self.stage.base

    def _stretch_neighbours(self, axis: int) -> None:
        drag, drag_pass = self.tables.drag, self.engine.drag_pass
        assert drag_pass is not None
        sums = self.stretched(axis, self.split(drag.moved), drag_pass.weights, op.NEIGHBOURS)
        self.split(drag.beyond)[:, self.nodes] += sums.reshape(self.components, -1)

    def drag_nodes(self) -> None:
        drag, stage = self.tables.drag, self.stage
        nodes = self.nodes[self.engine.absent.exists[self.nodes]]
        increments, beyond = self.split(drag.moved), self.split(drag.beyond)
        total, number = beyond[:, nodes], np.zeros(len(nodes))
        beyond[:] = 0
        for distance in drag.distances:
            present = self.present(nodes, nodes + distance)
            total += present * increments[:, nodes + distance]
            number += present
        pull = drag.rate * np.where(number, total / np.maximum(number, 1) - increments[:, nodes], 0)
        self.add(pull, nodes)
        at = np.array(np.unravel_index(np.searchsorted(self.nodes, nodes), self.box.nodes))
        near = ((at >= drag.first[:, None]) & (at < drag.end[:, None])).all(0)
        change = (self.split(stage.out) - self.split(stage.base))[:, nodes]
        mobility = self.tables.mobility[nodes] if self.tables.mobility.size else 1.0
        drag.lost[0, 0] -= 0.5 * (near * pull * change / mobility).sum()

    def push_with_shapes(self) -> None:
        impactors, stage, d = self.tables.impactors, self.stage, self.components
        spacing, dt = impactors.scales
        box = tuple(slice(a, b) for a, b in zip(impactors.first, impactors.end, strict=True))
        places = self.places[box].ravel()
        at = np.indices(self.places[box].shape).reshape(3, -1)[3 - d :].T * spacing + impactors.lower
        at, places = at[impactors.exists[places] > 0], places[impactors.exists[places] > 0]
        at = at + self.split(stage.src)[:, places].T
        mobility = self.tables.mobility[places] if self.tables.mobility.size else np.ones(len(places))
        for number, (x, v) in enumerate(impactors.state):
            stiffness, friction, lightness = impactors.constants[number]
            depth, normal = depths(impactors, number, at - x)
            force = stiffness * np.maximum(depth, 0)[:, None] * normal
            for gains, component in zip(
                (stage.scale * mobility[:, None] * force).T, self.split(stage.out), strict=True
            ):
                component[places] += gains
            path = self.inputs.impactor_paths[self.step, number]
            moves = dt * (v - lightness * dt * force.sum(0)) if lightness else path - x
            slip = (self.split(stage.out)[:, places] - self.split(stage.src)[:, places]).T - moves
            slip -= (slip * normal).sum(1, keepdims=True) * normal
            size = np.linalg.norm(slip, axis=1)
            share = 1 / (1 + lightness * (1 / mobility)[depth > 0].sum())
            most = np.minimum(friction * stiffness * np.maximum(depth, 0), share * size / (stage.scale * mobility))
            rubbed = -(most / np.where(size > 0, size, 1))[:, None] * slip
            for gains, component in zip(
                (stage.scale * mobility[:, None] * rubbed).T, self.split(stage.out), strict=True
            ):
                component[places] += gains
            self.split(impactors.forces)[:, places] += (force + rubbed).T
            total = (force + rubbed).sum(0)
            after = v - lightness * dt * total if lightness else moves / dt
            if len(self.inputs.impactor_values):
                stored = 0.5 * stiffness * (np.maximum(depth, 0) ** 2).sum()
                self.inputs.impactor_values[self.step, number] = [*x, *(v + after) / 2, *total, stored]
            v[:] = after
            x[:] = x + dt * after if lightness else path

    def sum_work_of_pushes(self) -> None:
        forces, stage = self.tables.impactors.forces, self.stage
        if self.tables.work.size:
            self.tables.work[0] += 0.5 * forces @ (stage.out - stage.base)
        forces[:] = 0

    def damp_new(self) -> None:
        stage, (nodes, _, after, leak) = self.stage, self.tables.damping
        u = stage.src[nodes]
        self._set(nodes, u + (stage.out[nodes] - u) * after - stage.scale * leak * u)

    def add_exact_ends(self) -> None:
        stage, ends = self.stage, self.tables.ends
        step, reach, half = int(ends.clock[0]), ends.nodes.shape[1], ends.poles.shape[2]
        ends.clock[0] += 1
        for end, nodes in enumerate(ends.nodes):
            sample = (ends.first if step == 0 else 1.0) * stage.src[nodes]
            ends.history[end, step] = sample
            ends.forces[end] = ends.outputs[end] @ ends.states[end]
            y = ends.states[end] + sample @ ends.inputs[end, :reach]
            z = (ends.poles[end, 0] + 1j * ends.poles[end, 1]) * (y[:half] + 1j * y[half:])
            ends.states[end] = np.concatenate([z.real, z.imag])
            if ends.heads.shape[1]:
                place = step % ends.heads.shape[1]
                ends.forces[end, :reach] += ends.past[end, place]
                for lag in range(1, place + 1):
                    ends.forces[end, :reach] += ends.heads[end, lag] @ ends.history[end, step - lag]
            self.add(stage.scale * ends.forces[end : end + 1, :reach], nodes)
            counted = self.tables.flows.ends[end] >= 0 if len(self.tables.flows.ends) else np.zeros(reach, bool)
            flows = self.tables.flows
            gains = flows.effects[stage.part] * ends.forces[end, :reach][counted]
            np.add.at(flows.totals[0], flows.ends[end][counted] if counted.any() else nodes[:0], gains)

    def add_sources(self) -> None:
        stage, inputs = self.stage, self.inputs
        amplitudes = self.tables.numbers[stage.part, 4] * inputs.source_times[self.step, stage.part]
        for level in (stage.out, stage.base)[: 1 + stage.increments]:
            level[inputs.source_nodes] += amplitudes @ inputs.source_fields

    def filter_layers(self) -> None:
        stage, tables = self.stage, self.tables.filter
        if (self.inputs.before[0] + self.step + 1) % tables.every:
            return
        for c in range(self.components):
            src, base, out = (self.split(level)[c] for level in stage[:3])
            if tables.whole:
                for level in (out, base if stage.increments else src):
                    level -= _passed(self.tables.filter, level)
            else:
                taken = _passed(self.tables.filter, out - src)
                out -= taken
                if stage.increments:
                    base -= taken

    def advance_hanging_masses(self) -> None:
        stage, tables = self.stage, self.tables.dampers
        last, p, q = tables.states.reshape(3, self.components, -1)
        for node, strength, state, count, number in tables.runs:
            (keep, pull), places = tables.springs[number], slice(state, state + count)
            here = slice(node, node + count)
            src, base, out = (self.split(level)[:, here] for level in stage[:3])
            increment = base if stage.increments else out - src
            moved = keep * q[:, places] - pull * p[:, places] + increment - last[:, places]
            gained = tables.strengths[strength : strength + count] * (moved - q[:, places])
            last[:, places], q[:, places] = increment + gained, moved
            p[:, places] += moved
            for level in (out, base)[: 1 + stage.increments]:
                level += gained

    def sum_work(self) -> None:
        stage, inputs = self.stage, self.inputs
        change = stage.out[inputs.source_nodes] - stage.base[inputs.source_nodes]
        fields, times = inputs.source_fields, inputs.source_times[self.step, stage.part]
        self.tables.work[0] += 0.5 * (times @ fields) @ change

    def add_flow(self) -> None:
        flows, src = self.tables.flows, self.stage.src
        inner = flows.neighbours >= 0
        neighbours = np.where(inner, flows.neighbours, flows.nodes)
        gaps = self.factors(flows.nodes, neighbours) * self._gaps(flows.nodes, neighbours)[0]
        gaps = np.where(inner, gaps, -src[flows.nodes])
        np.add.at(flows.totals[0], flows.accounts, flows.effects[self.stage.part] * flows.weights * gaps)

    def _flow_of_layers(self, operation: str, axis: int) -> None:
        """Compute what the layers along an axis contribute, and then add it to the flows."""
        if operation == op.STRETCH:
            self.inflow = np.zeros(self.engine.layout.size)
            self.inflow[self.nodes] = self._springs(axis).ravel()
            return
        flows = self.tables.flows
        for at, account, first, last in flows.sides:
            if at == axis:
                gains = flows.effects[self.stage.part] * self.inflow[flows.beside[first:last]]
                np.add.at(flows.totals[0], np.full(last - first, account), gains)

    def set_dependent_nodes(self) -> None:
        nodes, starts, sources, weights = self.tables.dependents
        added = self.inputs.dependent_times[self.step, self.stage.part] @ self.inputs.dependent_fields
        for i, node in enumerate(nodes):
            at = slice(starts[i], starts[i + 1])
            value = weights[at] @ self.stage.out[sources[at]] + (added[i] if np.ndim(added) else 0.0)
            self._set(np.array([node]), np.array([value]))

    def fill_halo_of_outline(self) -> None:
        stage, outline_stencil = self.stage, self.tables.outline_stencil
        if outline_stencil.history.shape[1]:
            outline_stencil.history[:, 1:] = outline_stencil.history[:, :-1].copy()
            outline_stencil.history[:, 0] = stage.src[outline_stencil.nodes]
        for first, last in outline_stencil.outside:
            for level in (stage.out, stage.base)[: 1 + stage.increments]:
                level[first:last] = 0
        places = outline_stencil.places.reshape(-1, outline_stencil.owners.shape[1])
        values = np.append(outline_stencil.history.ravel(), np.zeros(outline_stencil.table.shape[1]))
        window = np.arange(outline_stencil.table.shape[1])
        for bundle, owners in enumerate(outline_stencil.owners):
            start, stop = int(outline_stencil.starts[bundle]), int(outline_stencil.starts[bundle + 1])
            for i, owner in enumerate(owners):
                seen = values[places[start:stop, i, None].astype(int) // 8 + window]
                first, number = int(outline_stencil.kinds[bundle, i]), len(owners) * bundle + i
                new = slice(int(outline_stencil.new_starts[number]), int(outline_stencil.new_starts[number + 1]))
                total = (outline_stencil.table[first : first + stop - start] * seen).sum()
                total += outline_stencil.new_weights[new] @ stage.out[outline_stencil.new_nodes[new]]
                self._set(np.array([owner]), np.array([total]))

    def dissolve_nodes(self) -> None:
        material: Material = self.tables.material
        phases, nodes = self.tables.phases, self.nodes
        gone = nodes[(material.coefficient[nodes] <= 0) & (self.stage.out[nodes] < phases.saturation)]
        material.coefficient[gone] = 1
        phases.dissolved[gone] = self.inputs.before[0] + self.step + 1
        phases.total[0] += len(gone)
        _copy(material.coefficient, self.tables.copies)

    def dissolve_halo(self) -> None:
        halo, coefficient = self.tables.phases.halo[:, 0], self.tables.material.coefficient
        coefficient[halo[self.stage.src[halo] < self.tables.phases.saturation]] = 1


def _copy(values: np.ndarray, copies: np.ndarray) -> None:
    """Copy values across periodic axes; shape (..., places)."""
    for to, source, count in copies.T:
        values[..., to : to + count] = values[..., source : source + count]


def _passed(tables: Filter, values: np.ndarray) -> np.ndarray:
    """Return what a filter takes from the values of one component."""
    taps, steps, box, strengths, runs, copies, cut_nodes, cut_ends, cut_places, cut_weights, *_ = tables
    index = [(place + i, node + i, first + i) for place, node, first, count in runs[:, :4] for i in range(count)]
    places, nodes, entries = np.array(index).T
    weighed = np.zeros_like(box)
    weighed[places] = strengths[entries] * values[nodes]
    weighed[copies[0]] = copies[2] * weighed[copies[1]]
    passed = np.zeros(len(places))
    for distance in steps:
        passed += taps[0] * weighed[places]
        for k, tap in enumerate(taps[1:], 1):
            passed += tap * (weighed[places + k * distance] + weighed[places - k * distance])
    taken = np.zeros_like(values)
    taken[nodes] = strengths[entries] * passed
    for node, first, last in zip(cut_nodes, cut_ends[:-1], cut_ends[1:], strict=True):
        taken[node] += cut_weights[first:last] @ weighed[cut_places[first:last]]
    return taken


class _Heat:
    """Operations of thermal strains.

    Parameters
    ----------
    loop : Interpreter
    """

    def __init__(self, loop: Interpreter) -> None:
        self.loop = loop

    def add_thermal_forces(self) -> None:
        """Subtract the thermal strains of the springs of state-based media."""
        loop = self.loop
        bonds, nodes = loop.tables.bonds, loop.nodes[loop.zone()]
        for vector, distance in zip(loop.tables.heat.vectors, bonds.places[:, 0], strict=False):  # none if left out
            present = loop.present(nodes, nodes + distance) * loop.factors(nodes, nodes + distance)
            self._push(vector, present * loop.thermal_strain(nodes, nodes + distance), nodes)

    def add_thermal_forces_beyond(self) -> None:
        """Do so at all nodes for springs, and for bonds without a law of their own."""
        loop = self.loop
        bonds, at = loop.tables.bonds, np.indices(loop.box.nodes).reshape(3, -1)
        for bond in range(len(loop.tables.heat.beyond)):
            distance, *offset = bonds.places[bond]
            curved = _follow_law(bonds.zone, at) & _follow_law(bonds.zone, at + np.array(offset)[:, None])
            nodes = loop.nodes[~(curved & bonds.forces)]
            alive = bonds.alive[bond >> 6, nodes] & np.uint64(1) << np.uint64(bond & 63) != 0
            present = alive * loop.factors(nodes, nodes + distance)
            self._push(loop.tables.heat.beyond[bond], present * loop.thermal_strain(nodes, nodes + distance), nodes)

    def _push(self, vector: np.ndarray, strains: np.ndarray, nodes: np.ndarray) -> None:
        self.loop.add(-self.loop.stage.scale * np.multiply.outer(vector, strains), nodes)

    def stretch(self, axis: int, which: int) -> None:
        """Add the contribution of the layers to thermal forces, or to traces."""
        loop = self.loop
        weights, heat = loop.engine.heat_passes[which - op.PUSHES].weights, loop.tables.heat
        read = heat.thermal_strain[None] if which == op.PUSHES else loop.split(loop.stage.src)
        sums = loop.stretched(axis, read, weights, which).reshape(len(weights[0]), -1)
        if which == op.PUSHES:
            loop.add(loop.stage.scale * sums)
        else:
            heat.traces[loop.nodes] += sums[0]

    def step_thermal_strains(self) -> None:
        """Advance the thermal strains to the next step."""
        self.loop.tables.heat.thermal_strain[:] += self.loop.tables.heat.rate


class _States:
    """Operations of materials whose forces take two passes; the sums are over the bonds that are present.

    Parameters
    ----------
    loop : Interpreter
    passes : Passes
    """

    def __init__(self, loop: Interpreter, passes: TwoPassOperator) -> None:
        self.loop, self.passes, self.raw = loop, passes, False

    def _distances(self) -> np.ndarray:
        """Return the distances between nodes and their neighbours in a level."""
        return np.asarray(self.loop.engine.offsets @ self.loop.box.stride)

    def run(self, operation: str, number: int, which: int) -> None:
        """Execute an operation of the two passes; the sums are over the bonds that are present: no bonds are cut."""
        law, passes, scale = self.loop.tables.gradient_pass.sweep.law, self.passes, self.loop.stage.scale
        states = law.values.reshape(len(law.intact), -1)
        levels = (self.loop.split(self.loop.stage.src), states, self.loop.split(self.loop.stage.out))
        # the loop may have done so node by node
        if self.raw and (which == op.DIVERGENCE or operation == op.RELEASE):
            states[:, self.loop.nodes] -= self._strained(self.loop.nodes).T
            odd = np.einsum("sab,bs->as", law.matrices[law.numbers], states[:, law.nodes])
            if not self.loop.tables.bonds.forces:
                lost = self._lost_bonds()
                damaged = np.einsum("sab,bs->as", self._laws(lost), states[:, lost])
            states[...] = (
                np.einsum("cs,cab,bs->as", law.local, law.bases, states) if law.local.size else law.intact @ states
            )
            states[:, law.nodes], self.raw = odd, False
            if not self.loop.tables.bonds.forces:
                states[:, lost] = damaged
        if operation == op.COPY:
            _copy(states, self.loop.tables.copies)
        elif operation == op.RECEIVE:
            self.loop.receive(number, states)
        elif operation == op.SWEEP:
            read, sign, nodes = levels[which - op.GRADIENT], (-1, 1)[which - op.GRADIENT], self.loop.nodes
            total = np.zeros((len(levels[which]), nodes.size))
            for distance, weight in zip(self._distances(), passes.weights[which - 1], strict=True):
                present = self.loop.present(nodes, nodes + distance) & self.loop.engine.absent.exists[nodes]
                total += weight @ (present * (read[:, nodes + distance] + sign * read[:, nodes]))
            if which == op.GRADIENT:
                states[:, nodes], self.raw = 0, True
            levels[which][:, nodes] += total * (1 if which == op.GRADIENT else scale)
        elif operation == op.BREAK:
            self._break_bonds(lambda b, nodes, e: e > self.loop.limits(nodes, nodes + self._distances()[b]))
        elif operation == op.RELEASE:
            gone = self._break_bonds(lambda b, nodes, e: (e > 0) & (self._released(b, nodes, states) > 0))
            for bond, nodes in gone:  # their springs have been swept
                neighbours = nodes + self._distances()[bond]
                pull = self.loop.matrices[bond] @ (levels[0][:, neighbours] - levels[0][:, nodes])
                levels[2][:, nodes] -= scale * self.loop.factors(nodes, neighbours) * pull
        elif operation == op.DAMAGED and number == STATES_AGAIN:
            lost = np.intersect1d(self._lost_bonds(), self.loop.nodes[self.loop.zone()])
            states[:, lost] = np.einsum("sab,sb->as", self._laws(lost), self._states_at(lost))
        elif operation == op.DAMAGED and which == op.DIVERGENCE:
            self._push_apart()
        elif operation == op.STRETCH_STATES:
            places = self.loop.tables.stretches.places
            states[:, places] += self._remembered(states[:, places], "states", begins=number == 1)
        elif operation == op.STRETCH_FORCES:
            places = self.loop.tables.stretches.places
            added = self._remembered(scale * self._parts(states, places), "forces", begins=number == 1)
            levels[2][:, places] += added.reshape(self.loop.components, self.loop.components, -1).sum(1)
        elif operation == op.STRETCH:
            added = self.loop.stretched(number, levels[which - op.GRADIENT], passes.weights[which - 1], which)
            levels[which][:, self.loop.nodes] += (1 if which == op.GRADIENT else scale) * added.reshape(len(added), -1)

    def _remembered(self, values: np.ndarray, key: str, begins: bool) -> np.ndarray:
        """Return what stretching adds to derivatives, shape (dim^2, nodes), by the trapezoidal rule."""
        keep, gain = (
            np.tile(table, (self.loop.components, 1))
            for table in (self.loop.tables.stretches.keep, self.loop.tables.stretches.gain)
        )
        added, old = self.loop.memory.get(key, np.zeros((2, *values.shape)))
        added = 0 * values if begins else keep * added + gain * (old + values)
        # if the memory begins here, the next step, which has the same values, adds nothing
        self.loop.memory[key] = np.stack([added, -values if begins else values])
        return added

    def _parts(self, states: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Return the forces on some nodes by component and axis of the derivative, from the bonds present."""
        sums = np.zeros((len(states), len(nodes)))
        for distance, weight in zip(self._distances(), self.passes.sums.divergence, strict=True):
            both = self.loop.present(nodes, nodes + distance) * (states[:, nodes + distance] + states[:, nodes])
            sums += weight.sum(0)[:, None] * both
        return sums

    def _strained(self, nodes: np.ndarray) -> np.ndarray:
        """Return the states of nodes whose strain is the thermal strain, shape (S, n)."""
        law, shapes = self.loop.tables.gradient_pass.sweep.law, self._shapes(nodes)
        units = np.trace(shapes, axis1=1, axis2=2)[:, None] if len(law.unit) == 1 else shapes.reshape(len(nodes), -1)
        return np.asarray(law.spacing * self.loop.thermal_strain(nodes, nodes)[:, None] * units)

    def _given_way(self, nodes: np.ndarray, distances: np.ndarray) -> np.ndarray:
        """Return the thermal elongations of bonds, shape (K, dim, nodes), from the mean strain of nodes at
        `distances`.
        """
        arms = self.loop.tables.gradient_pass.sweep.law.arms
        thermal_strain = np.stack([self.loop.thermal_strain(nodes, nodes + distance) for distance in distances])
        return np.asarray(arms[:, :, None] * thermal_strain[:, None] if arms.size else 0 * thermal_strain[:, None])

    def _lost_bonds(self) -> np.ndarray:
        """Return the nodes that exist and lack bonds, which are cut, broken or beyond an edge."""
        bonds, nodes = self.loop.tables.bonds, self.loop.nodes[self.loop.engine.absent.exists[self.loop.nodes]]
        return np.asarray(nodes[(bonds.alive[:, nodes] != bonds.full[:, None]).any(0)])

    def _laws(self, nodes: np.ndarray) -> np.ndarray:
        """Return the matrices of the law, by which the states are multiplied, of nodes that lack bonds."""
        passes, law = self.passes, self.loop.tables.gradient_pass.sweep.law
        moduli, numbers = passes.moduli_at(nodes), np.zeros(law.values.size // len(law.intact), np.int64)
        numbers[law.nodes] = law.numbers
        first = numbers[nodes]  # 0 for nodes that had all their bonds
        if law.kept:
            return np.where(first[:, None, None] > 0, law.matrices[first], self._whole_laws(moduli))
        shapes = self._shapes(nodes)
        if len(law.unit) > 1:  # otherwise the law does not depend on the shape tensor
            moduli[:, :2] *= stress_left(shapes, law.harmonic_eigenvalue[first])[:, None]
        return passes.sums.law(shapes, moduli)

    def _whole_laws(self, moduli: np.ndarray) -> np.ndarray:
        """Return the matrices of nodes with all their bonds."""
        dim = self.passes.sums.shapes.shape[1]
        return self.passes.sums.law(np.broadcast_to(np.eye(dim), (len(moduli), dim, dim)), moduli)

    def _shapes(self, nodes: np.ndarray) -> np.ndarray:
        """Return the shape tensors of nodes."""
        present = np.stack([self.loop.present(nodes, nodes + distance) for distance in self._distances()])
        return np.einsum("ks,kab->sab", present, self.passes.sums.shapes)

    def _states_at(self, nodes: np.ndarray) -> np.ndarray:
        """Return the states of some nodes, summed over their bonds, shape (S, n)."""
        u, distances = self.loop.split(self.loop.stage.src), self._distances()
        present = np.stack([self.loop.present(nodes, nodes + distance) for distance in distances])
        eta = np.stack([u[:, nodes + distance] - u[:, nodes] for distance in distances])
        eta -= self._given_way(nodes, 0 * distances)
        return np.asarray(np.einsum("ks,kqa,kas->sq", present, self.passes.weights[0], eta))

    def _released(self, bond: int, nodes: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Return by how much the energy lost with a bond of some nodes exceeds the energy at which it breaks."""
        passes, bonds, scale = self.passes, self.loop.tables.bonds, self.loop.stage.scale
        distance, u = self._distances()[bond], self.loop.split(self.loop.stage.src)
        xi = bonds.table[bond, : self.loop.components, None]
        eta = u[:, nodes + distance] - u[:, nodes] - self.loop.thermal_strain(nodes, nodes + distance) * xi
        of_bond = passes.weights[0][bond] @ eta
        moduli = passes.moduli_at(nodes) + passes.moduli_at(nodes + distance)
        firm = np.broadcast_to(bonds.harmonic_eigenvalue, self.loop.engine.layout.size)
        stress = firm[nodes] * states[:, nodes] + firm[nodes + distance] * states[:, nodes + distance]
        stress -= np.einsum("sab,bs->as", self._whole_laws(moduli), of_bond) / 2
        energy = np.einsum("as,as->s", eta, scale * passes.weights[1][bond] @ stress)
        springs = scale / 2 * self.loop.factors(nodes, nodes + distance)
        energy += springs * np.einsum("as,ab,bs->s", eta, self.loop.matrices[bond], eta)
        critical = self.loop.limits(nodes, nodes + distance) / 2
        return np.asarray(energy - critical**2 * (moduli @ bonds.released[bond]))

    def _break_bonds(self, breaks: Callable[[int, np.ndarray, np.ndarray], np.ndarray]) -> list[tuple[int, np.ndarray]]:
        """Break the bonds that are beyond their limit, add up the energy that their nodes lose, and return these
        bonds and nodes. `breaks` tells, for a bond of some nodes and its strains there, where it breaks.
        """
        bonds, before = self.loop.tables.bonds, self.loop.tables.bonds.alive.copy()
        gone = [
            (b, nodes[alive & curved & breaks(b, nodes, e)]) for b, nodes, alive, curved, _, e in self.loop.stretches()
        ]
        nodes = np.unique(np.concatenate([np.zeros(0, np.int64), *(nodes for _, nodes in gone)]))
        stored = self._energies(nodes)
        for bond, broken in gone:
            self.loop.clear(bond, broken)
            bonds.broken[0, 0, 1] += 0.5 * len(broken)
        if (bonds.alive != before).any():
            bonds.broken[0, 0, 0] += stored - self._energies(nodes)
        return gone

    def _push_apart(self) -> None:
        """Let absent bonds push their ends apart where they are shorter than initially."""
        bonds, d = self.loop.tables.bonds, self.loop.components
        hard = self.loop.tables.material._replace(coefficient=bonds.contact_stiffness)
        for bond, nodes, alive, curved, ahead, e in self.loop.stretches():
            pushes = _lasts(bonds, bond, nodes) & ~alive & curved & (e < 0)
            c = bonds.table[bond, d + 1] * factors_of(hard, nodes, nodes + bonds.places[bond, 0])
            self.loop.split(self.loop.stage.out)[:, nodes] += pushes * c * e / 2 * ahead

    def _energies(self, nodes: np.ndarray) -> float:
        """Return the energy of some nodes, from the displacements now and a step ago, in units of the update."""
        passes, total = self.passes, np.zeros(len(nodes))
        now, ago = self.loop.split(self.loop.stage.src), self.loop.split(self.loop.stage.base)
        distances = self._distances()
        present = np.stack([self.loop.present(nodes, nodes + distance) for distance in distances])
        (eta, old) = (np.stack([u[:, nodes + d] - u[:, nodes] for d in distances]) for u in (now, ago))
        at_node, both = self._given_way(nodes, 0 * distances), self._given_way(nodes, distances)
        last = np.einsum("sab,sb->sa", self._laws(nodes), self._states_at(nodes))
        total += np.einsum("ks,kaq,sq,kas->s", present, passes.weights[1], last, old - at_node)
        springs = present * np.stack([self.loop.factors(nodes, nodes + d) for d in distances])
        total += np.einsum("ks,kab,kas,kbs->s", springs, self.loop.matrices, old - both, eta - both) / 2
        return float(self.loop.stage.scale * total.sum() / 2)


def _follow_law(zone: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the places, shape (3, n), at which bonds within the zone follow the law."""
    within = at - zone[LAW_FIRST : LAW_FIRST + 3, None]
    return ((within >= 0) & (within < zone[LAW_EXTENT : LAW_EXTENT + 3, None])).all(0)


def _lasts(bonds: Bonds, bond: int, nodes: np.ndarray) -> np.ndarray:
    """Return at which nodes a bond carries compression even when absent."""
    bits = bonds.closing[bond >> 6, nodes] if bonds.closing.size else np.zeros(len(nodes), np.uint64)
    return np.asarray(bits & np.uint64(1) << np.uint64(bond & 63) != 0)


def _shares(
    bonds: Bonds, softening: str | None, nodes: np.ndarray, neighbours: np.ndarray, e: np.ndarray, limit: np.ndarray
) -> np.ndarray:
    """Return the fractions of the bonds' stiffness that remain at strains beyond the limit."""
    if softening is None:
        return np.zeros(len(nodes))
    final = np.minimum(bonds.final[nodes], bonds.final[neighbours])
    with np.errstate(divide="ignore", invalid="ignore"):  # for bonds below the limit, whose values are not used
        stretch, onset = (np.sqrt(1 + x) - 1 if bonds.nonlinear else x / 2 for x in (e, limit))
        if softening == "linear":
            falls = (final - stretch) / (final - onset)
        else:
            falls = np.exp(-2 * (stretch - onset) / (final - onset))
        return np.asarray(np.fmax(onset / stretch * falls, 0))


def depths(impactors: Impactors, number: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depths of points in an impactor where it starts, and the outward normals there."""
    stack: list[tuple[np.ndarray, np.ndarray]] = []
    for what, first, count in impactors.terms[impactors.starts[number] : impactors.starts[number + 1]]:
        numbers, normal = impactors.numbers[first:], np.zeros(at.shape)
        if what >= UNION:
            (a, normal_a), (b, normal_b) = stack[-2:]
            if what == DIFFERENCE:
                b, normal_b = -b, -normal_b
            second = (b > a) == (what == UNION)
            stack[-2:] = [(np.where(second, b, a), np.where(second[:, None], normal_b, normal_a))]
            continue
        if what == ROUND:
            arm = at[:, :count] - numbers[:count]
            distance = np.linalg.norm(arm, axis=1)
            normal[:, :count] = arm / distance[:, None]
            depth = numbers[count] - distance
        elif what == BOX:
            faces = np.hstack([at[:, :count] - numbers[:count], numbers[count : 2 * count] - at[:, :count]])
            nearest, depth = faces.argmin(1), faces.min(1)
            normal[np.arange(len(at)), nearest % count] = np.where(nearest < count, -1.0, 1.0)
        else:
            corners = numbers[: 2 * count].reshape(-1, 2)
            edges, arms = np.roll(corners, -1, 0) - corners, at[:, None, :2] - corners
            share = np.clip((arms * edges).sum(2) / (edges**2).sum(1), 0, 1)
            to = share[..., None] * edges - arms
            distances = np.linalg.norm(to, axis=2)
            nearest = distances.argmin(1)
            sign = np.where(Polygon(corners).contains(at[:, :2]), 1.0, -1.0)
            depth = sign * distances.min(1)
            normal[:, :2] = to[np.arange(len(at)), nearest] / depth[:, None]
        stack.append((depth, normal))
    return stack[0]
