"""Balance of a diffusion: what flows into the free nodes of the near field, and from where."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from farhorizon.engine.features.flows import FlowBonds, record_flows
from farhorizon.errors import InputError
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.medium.integrators import stage_effects
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.recorders.flux import check_drift
from farhorizon.simulation.setup.setup import Setup, side_name
from farhorizon.simulation.time.of_field import Conduction
from farhorizon.simulation.time.source_table import Batch, SourceTable


class FlowBalance:
    """Accounts of the flow into the free nodes, those whose values nothing prescribes: one for each condition, one for
    each side that the field flows through, one for the fixed edge of a body, and one for what a reaction consumes.

    Sources come first in the source table, then conditions, and then what depends on the field. Each process counts the
    flow into the nodes of its box. Raises InputError unless the equation is of first order in time.
    """

    def __init__(self, setup: Setup, parts: RunParts, source_table: SourceTable, team: ProcessGroup = ALONE) -> None:
        near, sides = parts.near, parts.layered.sides
        if near.model.order != 1:
            raise InputError(
                "a balance is recorded for equations of first order in time, and for elasticity",
                value=type(near.model).__name__,
                key="balance",
                remedy="leave it out: the energy is recorded without it",
            )
        check_drift(near, "balance")
        self.near, self.sides, self.grid, self.phases, self.ends = near, sides, parts.grid, parts.phases, parts.ends
        self.source_table, self._setup, self._team = source_table, setup, team
        outer = [side_name(*key) for key, side in sides.items() if not (side.periodic or side.shared)]
        outer_of_all = [name for names in team.gather(outer) for name in names]
        self._outer = [side_name(*key) for key in sides if side_name(*key) in outer_of_all]
        self._owners = [f"source[{i}]" for i in range(len(parts.source_terms.sources))]
        self._owners += [f"constraint[{i}]" for i, _ in near.conditions.sources]
        self._owners += [name for name, _ in parts.of_field]
        self._conductions = {name: term for name, (_, term) in parts.of_field if isinstance(term, Conduction)}
        self._prescribing = [i for i, given in enumerate(setup.constraints) if isinstance(given, Prescribed)]
        self._holding = near.prescribed.holding(0)
        self._open()
        self.powers = np.zeros(len(source_table.source_terms))  # amount that each has supplied on this process
        self.first = team.total(self._amounts())  # at the start, over all processes

    def reopen(self) -> None:
        """Set the accounts up again for the present bonds, after a crack has opened; the sums so far are kept."""
        so_far = self.grid.engine.get("flows.totals")
        self._open()
        self.grid.engine.put("flows.totals", so_far)

    def hold(self, step: int) -> None:
        """Count nodes that follow a prescribed value no longer, from a step on, among the free ones; what they have
        then is no gain.
        """
        holding = self.near.prescribed.holding(step)
        if holding == self._holding:
            return
        before, self._holding = self._team.total(self._amounts()), holding
        self.reopen()
        after = self._team.total(self._amounts())
        self.first = {name: first + after[name] - before[name] for name, first in self.first.items()}

    def _places(self) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Return the names of the accounts, the number of the account of each place of a level (from 1; 0 for free
        nodes), and the free nodes of the near field.
        """
        near, grid, engine, lead = self.near, self.grid, self.grid.engine, self.grid.lead
        lattice, rim = near.lattice, self._setup.rim
        names = [f"constraint[{i}]" for i in range(len(self._setup.constraints))] + self._outer
        core = np.zeros(grid.core.nodes)
        beyond = {}
        for (axis, side), boundary in self.sides.items():
            if boundary.periodic or boundary.shared:
                continue
            number = names.index(side_name(axis, side)) + 1
            beyond[lead + axis, side] = float(number)
            width = grid.margins[axis, side]
            strip = slice(0, width) if side < 0 else slice(core.shape[lead + axis] - width, None)
            core[tuple(strip if a == lead + axis else slice(None) for a in range(3))] = number
        inner = core[grid.near].reshape(lattice.shape)
        inner.flat[near.conditions.nodes] = near.conditions.owner + 1  # also if it is not contiguous
        for i in self._holding:
            inner.flat[near.prescribed.nodes[i]] = self._prescribing[i] + 1
        ends = lattice.existing if near.closed is None else lattice.mask
        if ends is not None:
            number = -1  # bonds to the free edge of a body are absent and need no account
            if rim == "fixed" or near.closed is not None:
                names.append("rim" if rim == "fixed" else "outline")
                number = len(names)
            inner[~ends] = number
        core[grid.near] = inner.reshape(core[grid.near].shape)
        return names, np.round(engine.spread(core, beyond, jointly=True)).astype(int), inner == 0

    def _open(self) -> None:
        """Tell the engine to which account each bond belongs."""
        near, grid, engine = self.near, self.grid, self.grid.engine
        self.names, where, self._free = self._places()
        block = grid.core
        flat = block.node_indices()
        flowing = []
        for offset, weight in zip(engine.offsets, engine.weights, strict=True):
            neighbour_places = flat + int(offset @ np.array(block.stride))
            flows = (where[flat] == 0) & (where[neighbour_places] != 0)
            flowing.append(
                (
                    where[neighbour_places[flows]] - 1,
                    flat[flows],
                    neighbour_places[flows],
                    np.full(int(flows.sum()), weight),
                )
            )
        accounts, nodes, neighbours, weights = (np.concatenate([f[i] for f in flowing]) for i in range(4))
        weights = weights - engine.absent.lost(nodes, neighbours, weights)
        for number, leak in near.conditions.leaks:
            lossy = np.flatnonzero((leak > 0) & self._free)
            accounts = np.append(accounts, np.full(lossy.size, number))
            nodes, neighbours = np.append(nodes, grid.indices[lossy]), np.append(neighbours, np.full(lossy.size, -1))
            weights = np.append(weights, near.model.source_factor * leak.ravel()[lossy])
        if engine.reaction:
            self.names.append("reaction")
            free = grid.indices[self._free.ravel()]
            accounts = np.append(accounts, np.full(free.size, len(self.names) - 1))
            nodes, neighbours = np.append(nodes, free), np.append(neighbours, np.full(free.size, -1))
            weights = np.append(weights, np.full(free.size, float(engine.reaction)))
        layers = {}
        for axis, side in engine.layers:
            reach = grid.layout.reach[axis]
            beside = np.take(flat, np.arange(reach) - (reach if side > 0 else 0), axis).ravel()
            number = self.names.index(side_name(axis - grid.lead, side))
            layers[axis, side] = number, beside[where[beside] == 0]
        kept = weights != 0
        if self.ends is None:
            ends = np.zeros((0, 0), np.int64)
        else:
            numbers = np.array([[self.names.index(name)] for name in self.ends.names])
            ends = np.where(where[self.ends.nodes] == 0, numbers, -1)
        effects = stage_effects(engine.stages) * np.array([n[2] for n in engine.stages.numbers])
        bonds = FlowBonds(accounts[kept], nodes[kept], neighbours[kept], weights[kept])
        record_flows(engine, bonds, effects, len(self.names), ends, layers)

    def _amounts(self) -> dict[str, float]:
        """Sums of the field over the free nodes in the box of this process: "stored", and for corrosion "metal" and
        "dissolved".
        """
        values = self.grid.get("u").astype(float)
        if self.near.density is not None:
            values = values * self.near.density

        def total(where: np.ndarray, level: float = 0.0) -> float:
            return math.fsum(values[self._free & where] + level)

        solid = None if self.phases is None else self.phases.solid
        phases = {} if solid is None else {"metal": solid, "dissolved": ~solid}
        background = self.near.background
        return {"stored": total(self._free)} | {name: total(where, background) for name, where in phases.items()}

    def add(self, batch: Batch) -> None:
        """Add what the sources supplied in a batch of steps."""
        stages = self.grid.engine.stages
        effects = stage_effects(stages) * np.array([n[3] for n in stages.numbers])
        totals = np.einsum("p,npj->j", effects, batch.amplitudes) * batch.fields[
            :, self._free.ravel()[batch.places]
        ].sum(1)
        row, samples = 0, len(self.near.model.integrator.source_samples(self.near.dt)[0])
        for number, (space, _) in enumerate(self.source_table.source_terms):
            count = samples if space is None else 1
            self.powers[number] += totals[row : row + count].sum()
            row += count
        for conduction in self._conductions.values():
            self._conduct(conduction.level)

    def _conduct(self, level: np.ndarray) -> None:
        """Add what flowed along bonds in the last step because the conductivity is not that at the background."""
        engine = self.grid.engine
        along = np.flatnonzero(engine.get("flows.neighbours") >= 0)
        accounts, nodes, neighbours, weights = (
            engine.get(f"flows.{name}", along) for name in ("accounts", "nodes", "neighbours", "weights")
        )
        gains = engine.get("flows.effects")[0] * weights * engine.factors(nodes, neighbours)
        gains *= level[neighbours].astype(float) - level[nodes]
        engine.add("flows.totals", np.bincount(accounts, gains, len(self.names)), 0)

    def sums(self) -> dict[str, float]:
        """Return the amount that each source term has supplied on this process, by name."""
        return {f"power/{number}": float(power) for number, power in enumerate(self.powers)}

    def take_sums(self, given: Mapping[str, float], first: Mapping[str, float]) -> None:
        """Continue from sums that `sums` returned, and from the amounts at the start."""
        self.powers[:] = [given[f"power/{number}"] for number in range(len(self.powers))]
        self.first = dict(first)

    def balance(self) -> dict[str, float]:
        """Return what the near field has gained, and from where; see `farhorizon.Simulation.balance`."""
        lattice = self.near.lattice
        unit = lattice.spacing**lattice.dim / self.near.model.source_factor
        flows, powers = self._team.summed(self.grid.engine.get("flows.totals").sum(0)), self._team.summed(self.powers)
        inflow = {name: unit * float(value) for name, value in zip(self.names, flows, strict=True)}
        for name, power in zip(self._owners, powers, strict=True):
            if name in self._conductions:
                continue  # counted along the bonds
            inflow[name] = inflow.get(name, 0.0) + unit * float(power)
        amounts = self._team.total(self._amounts())
        gains = {name: unit * (amount - self.first[name]) for name, amount in amounts.items()}
        return {**gains, **inflow, "residual": gains["stored"] - math.fsum(inflow.values())}
