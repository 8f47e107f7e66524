"""The gradient of a misfit by the medium, the sources and the initial data, from two runs."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.geometry.interpolation import interpolation_blocks
from farhorizon.inverse.adjoint import Residuals, adjoint_run
from farhorizon.inverse.checks import asked_for, check_linear, check_misfits, check_region, misfits_of, source_slopes
from farhorizon.inverse.history import PatchRecorder, Piece, Remade, Rows, WholeHistory, advance, on_all_nodes
from farhorizon.inverse.medium import Medium
from farhorizon.inverse.misfits import Arrays, Misfit
from farhorizon.inverse.patch import Patch
from farhorizon.machine import available_memory
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.recorders.receivers import Receivers
from farhorizon.simulation.recorders.recorder import StepValues
from farhorizon.simulation.recorders.recording import Recording
from farhorizon.simulation.setup.setup import Setup
from farhorizon.simulation.simulation import Simulation
from farhorizon.simulation.time.outer_loop import checked_end
from farhorizon.simulation.time.steps import last_step


@dataclass(frozen=True, eq=False)
class Gradient(Mapping[str, np.ndarray]):
    """A misfit and its derivatives, by name of what they are taken by.

    Attributes
    ----------
    misfit : float
    derivatives : dict of str to ndarray
        By a constant of the medium, or initial data: of the shape of the lattice or field, zero outside the region. By
        "source" or "source[i]": by the factor of time of the source at each step, shape (steps,). By a parameter of a
        source, such as "source.at": of the shape of this parameter.
    records : list of dict of str to ndarray
        For each misfit, the records of the run.
    setup : Setup
        That of the run, with its time step and its sides as chosen: a gradient of it makes none of these choices again.
    illumination : ndarray or None
        Sum of ``u . u`` over the steps, of the lattice's shape, zero outside the region; None if it was not asked for.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> bar = fh.Setup(fh.Lattice(1.0, -30, 30), fh.Wave(fh.Kernel(2.0)), initial={"u": "exp(-x**2/8)"}, dt=0.5)
    >>> found = fh.gradient(bar, fh.LeastSquares(fh.Receivers([9.0]), np.zeros((41, 1))), ["speed", "u"], until=20.0)
    >>> list(found), found.records[0]["u"].shape
    (['speed', 'u'], (41, 1))
    """

    misfit: float
    derivatives: dict[str, np.ndarray]
    records: list[Arrays]
    setup: Setup
    illumination: np.ndarray | None = None

    def __getitem__(self, name: str) -> np.ndarray:
        return self.derivatives[name]

    def __iter__(self) -> Any:
        return iter(self.derivatives)

    def __len__(self) -> int:
        return len(self.derivatives)


def gradient(
    setup: Setup | Simulation,
    misfit: Misfit | Sequence[Misfit],
    wrt: str | Sequence[str],
    until: float,
    *,
    region: Any = None,
    memory: float | None = None,
    precision: str = "float64",
    illumination: bool = False,
) -> Gradient:
    """Return a misfit of what receivers record, and its gradient: exact for the discrete run, at the cost of two runs.

    Parameters
    ----------
    setup : Setup or Simulation
        A linear run, with any sides of the infinite lattice, and walls; a Simulation of several processes shares the
        work out among these, all of which return the gradient.
    misfit : Misfit or sequence of Misfit
        Several are added.
    wrt : str or sequence of str
        Constants of the medium, as the model names them ("speed", "density", "young", "diffusivity", ..), by their
        values at every node; initial data, "u" and "v"; "source" or "source[i]", by the factor of time of a source;
        "source.at" (or "source[i].at"), by the place of a source at a point, and "source.strength", "source.force",
        "source.moment", as these are given: for a symmetric tensor, the sum over all entries of derivative times change
        is that of the misfit; "source.strike", "source.dip" and "source.rake" of a double couple, per degree.
    until : float
        End of the run.
    region : Shape or ndarray of bool, optional
        Nodes at which the medium is unknown; elsewhere it is known, and the derivative zero. By default all that are
        more than one reach inside of sides that absorb, which continue the medium as it is at their edge.
    memory : float, optional
        Bytes for the history of the run; half of what the machine has available unless given. A history that does not
        fit is computed a second time, piece by piece, from states that are kept on the way.
    precision : {"float64", "float32"}
        Number type of the history.
    illumination : bool
        Also return how much of the run each node has seen, by which a gradient may be divided.

    Returns
    -------
    Gradient

    Raises
    ------
    InputError
        A run that is not linear or sides that are not reciprocal; constants that the model lacks; a region within one
        reach of sides that absorb; data of another length than the records; fewer nodes in the region than processes.
        All before any step.

    Notes
    -----
    Bonds combine the constants of their ends by the "harmonic" rule unless the set-up says "arithmetic"; "both" has no
    derivative. The derivation is in ``docs/explanation/gradients.md``.

    The derivative by a place is that of the weights which spread the source over nodes, and exact between nodes. On a
    node, where other nodes enter the window of the sinc, it is that beside the node to some 1e-5; "linear" weights have
    none there, which is refused.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> lattice = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0))
    >>> pulse = fh.PointSource((-6.0, 0.0), time=fh.Ricker(0.08))
    >>> plate = fh.Setup(lattice, fh.Wave(fh.Kernel(2.0)), fh.LatticePML(nodes=10), sources=[pulse])
    >>> listening = fh.Receivers([(6.0, -3.0), (6.0, 3.0)])
    >>> misfit = fh.LeastSquares(listening, np.zeros((61, 2)))
    >>> found = fh.gradient(plate, misfit, ["speed", "source"], until=60 * fh.Simulation.of(plate).dt)
    >>> found["speed"].shape, found["source"].shape
    ((25, 25), (60,))
    """
    team, topology = (setup.team, setup.topology) if isinstance(setup, Simulation) else (ALONE, None)
    given = setup.setup if isinstance(setup, Simulation) else kinds.instance(setup, "setup", Setup, "a Setup")
    misfits = misfits_of(misfit)
    return _Gradient(given, misfits, wrt, until, region, memory, precision, team, topology).found(
        kinds.flag(illumination, "illumination")
    )


class Returning(NamedTuple):
    """A run that has been made, and what drives its adjoint; `shift` is the sum of the steps of both."""

    setup: Setup
    residuals: Residuals
    shift: int


def residuals_of(setup: Setup, misfits: Sequence[Misfit], until: float) -> Returning:
    """Make a run, and return what its misfits send back; raises InputError as `gradient` does."""
    run = _Gradient(setup, misfits, "u", until, None, None, "float64")
    run.sim.step(run.steps)
    _, residuals = run._residuals([dict(one.receivers.data) for one in misfits])
    return Returning(run.setup, residuals, run.steps + run.sim.model.order - 1)


def receivers_of(misfits: Sequence[Misfit]) -> list[Receivers]:
    """Return the receivers of some misfits, each once."""
    return list({id(one.receivers): one.receivers for one in misfits}.values())


class _Gradient:
    """One gradient, from what is asked to what is found."""

    def __init__(
        self,
        setup: Setup,
        misfits: Sequence[Misfit],
        wrt: str | Sequence[str],
        until: float,
        region: Any,
        memory: float | None,
        precision: str,
        team: ProcessGroup = ALONE,
        topology: Sequence[int] | None = None,
    ) -> None:
        self.team, self.topology = team, topology
        self.misfits, self.asked = misfits, asked_for(setup, wrt)
        kinds.one_of(precision, "precision", ("float64", "float32"), "unknown number type")
        budget = available_memory() / 2 if memory is None else kinds.number(memory, "memory", above=0)
        check_linear(setup, self.asked)
        sim = Simulation.of(setup, receivers_of(misfits), team, topology)
        whole = self._whole(sim, setup)
        inside = check_region(region, whole, self.asked)
        end = checked_end(until, sim.dt)
        check_misfits(misfits, last_step(end, sim.dt), sim.stencil.components)
        self.slopes = {name: source_slopes(whole, name) for name in self.asked.parameters}
        self.steps = sim.prepare(end)  # chooses layers, by trials
        self.whole = whole = self._whole(sim, setup) if team else sim
        self.setup = whole.settled
        reach = whole.stencil.reach
        periodic = frozenset(axis for (axis, _), side in whole.sides.items() if side.periodic)
        self.of_all = np.unique(Patch.around(inside, whole.lattice, reach, periodic).nodes) if team else None
        self.inside = inside = self._part_of(inside) if team and self.asked.constants else inside
        self.patch = Patch.around(inside, whole.lattice, reach, periodic)
        self.medium = (
            Medium(self.setup, whole.parts, self.patch, inside, self.asked.constants) if self.asked.constants else None
        )
        walls = self.patch.held(whole.sides, whole.background)
        self.rows = Rows(self.patch, walls, precision, self.of_all)
        self.sim, self.history = self._with_history(sim, -team.largest(-budget), end)

    def _whole(self, sim: Simulation, setup: Setup) -> Simulation:
        """Return the run on all nodes, which is made by no process alone if there are several."""
        if sim.subdomain is None:
            return sim
        return Simulation.of(replace(setup, boundary=sim.subdomain.boundary, dt=sim.dt))

    def _part_of(self, inside: np.ndarray) -> np.ndarray:
        """Return the nodes of a region whose derivatives this process sums: as many as each other one, side by side."""
        nodes = np.flatnonzero(inside)
        if nodes.size < self.team.size:
            raise InputError(
                "each process sums the derivatives at some nodes of the region",
                value=f"{nodes.size} nodes",
                limit=f">= {self.team.size} processes",
                key="region",
                remedy="fewer processes",
            )
        found = np.zeros_like(inside)
        found.flat[np.array_split(nodes, self.team.size)[self.team.number]] = True
        return found

    def _with_history(self, sim: Simulation, budget: float, end: float) -> tuple[Simulation, Any]:
        """Return the run, at its start, and what keeps its history."""
        if self.medium is None:
            return sim, None
        row = sim.stencil.components * self.patch.places * np.dtype(self.rows.real).itemsize
        row = int(self.team.largest(row))
        if (self.steps + 2) * row <= budget:
            if self.team:
                sim = Simulation.of(self.setup, [*receivers_of(self.misfits), self.rows], self.team, self.topology)
                sim.prepare(end)
                return sim, WholeHistory(sim, self.rows, self.steps)
            sim.recorders.append(self.rows)  # in place of a simulation that differs by this recorder alone
            sim._recording = Recording(sim.setup, sim.parts, sim.recorders)
            return sim, WholeHistory(sim, self.rows, self.steps)
        return sim, Remade.within(budget, row, sim, self.setup, self.rows, self.steps)

    def found(self, illumination: bool) -> Gradient:
        """Make the two runs."""
        sim, shift = self.sim, self.steps + self.sim.model.order - 1
        if self.history is None:
            sim.step(self.steps)
        else:
            self.history.run()
        records = [dict(one.receivers.data) for one in self.misfits]
        value, residuals = self._residuals(records)
        seen = _Correlation(self, shift)
        back = adjoint_run(self.setup, residuals, shift, [seen], self.team, self.topology)
        seen_by_nodes = np.zeros(self.patch.places)
        for piece in [Piece(0, self.steps, self.rows)] if self.history is None else self.history.backward():
            seen.piece = piece
            if illumination and self.history is not None:
                seen_by_nodes += piece.energy()
            advance(back, seen.patch, shift - piece.first - back.step_count)
        derivatives: dict[str, np.ndarray] = {}
        light = None
        if illumination:
            light = self.team.summed(np.where(self.inside, self.patch.onto(seen_by_nodes * self.patch.own), 0.0))
        if self.medium is not None:
            derivatives |= {name: self.team.summed(one) for name, one in self.medium.derivatives().items()}
        derivatives |= seen.by_source | {
            name: one.reshape(seen.shapes[name]) for name, one in seen.by_parameter.items()
        }
        if self.asked.initial:
            derivatives |= self._by_initial(back)
        return Gradient(value, derivatives, records, self.setup, light)

    def _residuals(self, records: list[Arrays]) -> tuple[float, Residuals]:
        """Return the sum of the misfits, and their derivatives by the field.

        The first record of a velocity lies half a step before the start, ``(1 + d dt) v[0] - dt a[0] / 2``: its
        derivative, `first_rate`, acts by the multiplier of step 0 and by the initial data.
        """
        self.first_rate = np.zeros((self.sim.stencil.components, int(np.prod(self.whole.lattice.shape))))
        total, residuals = 0.0, Residuals(self.steps, self.whole.field_shape)
        for misfit, found in zip(self.misfits, records, strict=True):
            receivers = misfit.receivers
            value, slopes = misfit.of(found, receivers.times)
            total += value
            nodes, weights = interpolation_blocks(
                self.whole.lattice, receivers.points, receivers.interpolation, key="receivers.points"
            ).entries()
            rates = np.zeros((self.steps + 1, len(receivers.points), self.sim.stencil.components))
            for name, slope in slopes.items():
                by_row = slope.reshape(len(slope), len(receivers.points), -1)
                rows = np.arange(len(slope)) * receivers.every
                if name == "u":
                    rates[rows] += by_row
                else:  # v = (u - u before) / dt
                    rates[rows[1:]] += by_row[1:] / self.sim.dt
                    rates[rows[1:] - 1] -= by_row[1:] / self.sim.dt
                    for component in range(self.sim.stencil.components):
                        np.add.at(self.first_rate[component], nodes, weights * by_row[0, :, component, None])
            residuals.add(nodes, weights, rates)
        return total, residuals

    def _by_initial(self, back: Simulation) -> Arrays:
        """Return the derivatives by the initial data, from an adjoint run that has reached the start of the run."""
        near, dt, damping = back.parts.near, back.dt, back.model.damping * back.dt
        density = (1.0 if near.density is None else near.density) / near.model.source_factor
        first = back.fields["u"]
        if near.model.order == 1:
            back.step(1)
            return {"u": self._free(back, density / dt * back.fields["u"])}
        here: tuple[Any, ...] = (slice(None), *back.lattice.within)
        rate = self.first_rate.reshape(-1, *back.lattice.whole.shape)[here].reshape(first.shape)
        found = {"v": self._free(back, (1 + damping) * (density / dt * (1 - damping) * first + rate))}
        if "u" in self.asked.initial:
            back.step(1)
            before = back.fields["u"]
            moved = _first_acceleration(self.setup, back, (1 - damping) / 2 * first + dt / 2 * rate / density)
            rest = (1 + damping) * (before + first) - 2 * first
            found["u"] = self._free(back, density / dt**2 * rest - density * moved)
        return {name: found[name] for name in self.asked.initial}

    def _free(self, back: Simulation, values: np.ndarray) -> np.ndarray:
        """Return values of this part on all nodes, zero on those that are not free to begin as they are told."""
        found = np.where(np.isfinite(values), values, 0.0)
        for held in back.prescribed._held:
            found.flat[held.places] = 0
        return on_all_nodes(back, found)


def _first_acceleration(setup: Setup, back: Simulation, u: np.ndarray) -> np.ndarray:
    """Return the acceleration of the medium at the start of a run from rest with the values u, sources left out."""
    still = adjoint_run(setup, Residuals(0, back.field_shape), 0, [], back.team, back.topology)
    grid = still.parts.grid
    grid.put("u", np.nan_to_num(u))
    still.engine.begin("u")
    found = still.time_loop.motion.acceleration(0.0)
    return grid.view(found).reshape(back.field_shape).astype(float)


class _Correlation(PatchRecorder, offered=False):
    """The adjoint run as it passes: correlated with the history of the run, and with the sources."""

    def __init__(self, of: _Gradient, shift: int) -> None:
        self._sources = {
            key: [np.reshape(space, (of.sim.stencil.components, -1)) for space in spaces]
            for key, spaces in of.asked.spaces(of.whole).items()
        }
        slopes, components = of.slopes, of.sim.stencil.components
        fields = {name: np.reshape(one.fields, (len(one.fields), components, -1)) for name, one in slopes.items()}
        busy = np.zeros(int(np.prod(of.whole.lattice.shape)), bool)
        for space in itertools.chain(*self._sources.values(), *fields.values()):
            busy |= (space != 0).any(0)
        patch = of.patch if of.medium is not None else replace(of.patch, shape=(0,) * of.whole.lattice.dim)
        super().__init__(patch, np.flatnonzero(busy), None if of.medium is None else of.of_all)
        self._spaces = {key: sum(space[:, self.nodes] for space in spaces) for key, spaces in self._sources.items()}
        self.by_source = {key: np.zeros(of.steps) for key in self._spaces}
        self._fields = {name: field[:, :, self.nodes] for name, field in fields.items()}
        times = of.sim.dt * np.arange(of.steps)
        self._factors = {name: np.array([one.time(t) for t in times]) for name, one in slopes.items()}
        self.by_parameter = {name: np.zeros(len(field)) for name, field in fields.items()}
        self.shapes = {name: one.shape for name, one in slopes.items()}
        self._of, self._shift = of, shift
        near, dt = of.whole.parts.near, of.sim.dt
        self._start_weight = (1 + near.model.damping * dt) / 2 if near.model.order == 2 else 1.0
        density = (1.0 if near.density is None else near.density.ravel()) / near.model.source_factor
        first = -dt / 2 * of.first_rate / density
        self._start_more = np.concatenate([first[:, self.patch.nodes], first[:, self.nodes]], axis=1)
        self.piece: Piece | None = None

    def add(self, step: int, heard: StepValues) -> None:
        rows, of = self.rows(heard), self._of
        n = self._shift - step - np.arange(len(rows))
        used = np.flatnonzero((n >= 0) & (n < of.steps))
        if not used.size:
            return
        n, rows = n[used], rows[used[0] : used[-1] + 1]
        if n[-1] == 0:
            rows = rows.copy()
            rows[-1] = self._start_weight * rows[-1] + self._start_more
        places = self.patch.places
        for key, space in self._spaces.items():
            self.by_source[key][n] = np.einsum("tcn,cn->t", rows[:, :, places:], space)
        for name, field in self._fields.items():
            weighted = np.einsum("t,tcn->cn", self._factors[name][n], rows[:, :, places:])
            self.by_parameter[name] += np.einsum("cn,kcn->k", weighted, field)
        if of.medium is not None:
            assert self.piece is not None
            waves = np.ascontiguousarray(rows[:, :, :places])
            for beyond, _ in of.rows.walls:
                waves[:, :, beyond] = 0
            of.medium.correlate(self.piece.rows, int(n[0]), waves)
