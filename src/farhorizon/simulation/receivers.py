"""Receivers: what a field does at points between the nodes, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError, shown
from farhorizon.files.records import Recorded
from farhorizon.geometry.interpolation import INTERPOLATIONS, Blocks, as_points, interpolation_blocks
from farhorizon.geometry.lattice import Lattice
from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.near_field import NearField
from farhorizon.simulation.quantities import QUANTITIES, LocalModuli, Reading
from farhorizon.simulation.recorder import Arrays, Heard, Recorder, Wanted, recorder_name
from farhorizon.simulation.setup import Setup


class Receivers(Recorder):
    """Points at which a run is recorded in every step of the compiled loop, or in every few.

    They are given to a run in ``observe=[...]``.

    Parameters
    ----------
    points : array_like, shape (n, dim), or (n,) in 1D
        Anywhere in the near field; `line` and `grid` make regular ones.
    record : str or sequence of str
        What is recorded: "u", the field; of waves "v", the velocity; "gradient", the derivatives along the axes; of
        elastic media "strain", "stress", "pressure" (minus the mean of the normal stresses, in two dimensions of those
        in the plane), "divergence", "curl" and "rotation" (half the curl); of waves "energy_flux", the Poynting vector
        ``- stress . v``, of scalar waves ``- c^2 v grad u``.
    every : int
        Steps from one record to the next.
    interpolation : {"sinc", "linear"}
        Between nodes: a windowed sinc that reads eight nodes to either side, good to some 1e-5 for waves of four nodes
        and more; or linearly, with an error of second order, which serves within eight nodes of an edge, a hole or a
        crack, too. A point on a node is that node. Derivatives are those of the sinc, or central differences.
    name : str
        Tells several of one run apart, in files and pictures.

    Attributes
    ----------
    points : ndarray, shape (n, dim)
    times : ndarray, shape (rows,)
        When each row was recorded. "v" and "energy_flux" are those of half a step before, as in the energies.
    data : dict of str to ndarray
        What was recorded, each of shape (rows, n), of vectors (rows, n, dim), of tensors (rows, n, dim, dim); gradients
        of displacements have the component first.
    notes : list of str
        What is to be known: which waves are recorded falsely where not every step is.

    Raises
    ------
    InputError
        No points, an unknown quantity. When a run is made: points outside the near field, in a hole, or too close to
        an edge, a hole or a crack for the interpolation; what the model does not have.

    Notes
    -----
    The interpolation is that of Hicks (2002), see `farhorizon.geometry.interpolation`. Where a material changes, the
    sinc rings as Fourier sums do; stress and energy flux take the moduli at the nearest node.

    Examples
    --------
    >>> import farhorizon as fh
    >>> line = fh.Receivers.line((1.3, 0.2), (6.3, 0.2), 6, record=["u", "v"])
    >>> lattice = fh.Lattice(0.5, (-12.0, -6.0), (12.0, 6.0))
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), initial={"u": "exp(-x**2 - y**2)"}, observe=[line])
    >>> _ = sim.run(until=4.0)
    >>> line.data["u"].shape == (sim.step_count + 1, 6)
    True
    """

    def __init__(
        self,
        points: Any,
        record: str | Sequence[str] = ("u",),
        every: int = 1,
        interpolation: str = "sinc",
        name: str = "receivers",
    ) -> None:
        self.points = kinds.array(points, "receivers.points")
        wanted = [record] if isinstance(record, str) else kinds.sequence(record, "receivers.record", "quantities")
        if not wanted:
            raise InputError("nothing is to be recorded", key="receivers.record", limit=", ".join(QUANTITIES))
        for one in wanted:
            kinds.one_of(one, "receivers.record", QUANTITIES, "unknown quantity")
        self.record = tuple(dict.fromkeys(wanted))
        self.every = kinds.integer(every, "receivers.every", least=1)
        self.interpolation = kinds.one_of(
            interpolation, "receivers.interpolation", INTERPOLATIONS, "unknown interpolation"
        )
        self.name = recorder_name(name)
        self.notes: list[str] = []
        self._steps: list[np.ndarray] = []
        self._rows: dict[str, list[np.ndarray]] = {}
        self._dt = 0.0

    @classmethod
    def line(cls, start: Any, end: Any, count: int, **options: Any) -> Self:
        """Receivers at even distances along a line, both ends included.

        Parameters
        ----------
        start, end : array_like, shape (dim,)
        count : int
        **options
            Of the constructor.
        """
        count = kinds.integer(count, "receivers.count", least=1)
        ends = [np.atleast_1d(kinds.array(one, "receivers.line")) for one in (start, end)]
        if ends[0].ndim != 1 or ends[0].shape != ends[1].shape:
            raise InputError(
                "both ends of a line have one coordinate an axis",
                value=[one.shape for one in ends],
                key="receivers.line",
            )
        return cls(np.linspace(ends[0], ends[1], count), **options)

    @classmethod
    def grid(cls, lower: Any, upper: Any, counts: Any, **options: Any) -> Self:
        """Receivers on a grid, both corners included; the last axis runs fastest.

        Parameters
        ----------
        lower, upper : array_like, shape (dim,)
        counts : sequence of int
            Receivers along each axis.
        **options
            Of the constructor.
        """
        corners = [np.atleast_1d(kinds.array(one, "receivers.grid")) for one in (lower, upper)]
        numbers = [kinds.integer(n, "receivers.counts", least=1) for n in np.atleast_1d(np.asarray(counts, object))]
        if not len(corners[0]) == len(corners[1]) == len(numbers):
            raise InputError(
                "corners and counts of a grid have one entry an axis",
                value=[len(corners[0]), len(corners[1]), len(numbers)],
                key="receivers.grid",
            )
        axes = [np.linspace(a, b, n) for a, b, n in zip(*corners, numbers, strict=True)]
        return cls(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(axes)), **options)

    def __repr__(self) -> str:
        return f"Receivers({len(self.points)} points, record={list(self.record)}, every={self.every})"

    # --- what was recorded -------------------------------------------------------------------------------------

    @property
    def times(self) -> np.ndarray:
        """When each row was recorded, shape (rows,)."""
        return np.concatenate([np.zeros(0, int), *self._steps]) * self._dt

    @property
    def data(self) -> dict[str, np.ndarray]:
        """What was recorded, by quantity."""
        return {name: np.concatenate(rows) for name, rows in self._rows.items()}

    @property
    def recorded(self) -> Recorded:
        """What was recorded, apart from the run: it writes tables and arrays, and traces of ObsPy."""
        return Recorded(self.name, self.points, self.times, self.data)

    def forget(self) -> None:
        """Keep no rows of the past."""
        self._steps, self._rows = [], {name: [rows[0][:0]] for name, rows in self._rows.items()}

    # --- in a run ----------------------------------------------------------------------------------------------

    def begin(self, setup: Setup, parts: Parts) -> Wanted:
        near = parts.near
        lattice = near.lattice
        self._check_model(near)
        self.points = as_points(self.points, lattice.dim, "receivers.points")
        derived = any(QUANTITIES[name].derived for name in self.record)
        axes = [None, *range(lattice.dim)] if derived else [None]
        options = self.points, self.interpolation
        blocks = [interpolation_blocks(lattice, *options, axis, "receivers.points") for axis in axes]
        for one in blocks:
            self._check_hidden(near, one)
            self._check_cracks(setup, lattice, one)
        self._medium, self._background, self._dt = _medium(near, self.points), near.background, near.dt
        self.notes = self._aliased(near)
        return Wanted(np.zeros(0, np.int64), tuple(blocks))

    def start(self, step: int, heard: Heard) -> None:
        rows = np.stack(heard.blocks, axis=-1)
        self._before = rows[:1]
        empty = self._recorded(rows[:0], rows[:0])
        self._steps, self._rows = [], {name: [values] for name, values in empty.items()}
        self._keep(step, rows[1:])

    def add(self, step: int, heard: Heard) -> None:
        self._keep(step, np.stack(heard.blocks, axis=-1))

    def _keep(self, step: int, rows: np.ndarray) -> None:
        """Take the field and its derivatives after the steps from number `step` on, shape (steps, n, components, 1 or 1
        + dim).
        """
        earlier = np.concatenate([self._before, rows[:-1]])
        steps = step + np.arange(len(rows))
        kept = steps % self.every == 0
        self._before = rows[-1:].copy()
        if kept.any():
            self._steps.append(steps[kept])
            for name, values in self._recorded(rows[kept], earlier[kept]).items():
                self._rows[name].append(values)

    def _recorded(self, now: np.ndarray, before: np.ndarray) -> dict[str, np.ndarray]:
        """All quantities from the field and its derivatives now and a step before."""
        reading = Reading(now, before, self._dt, self._background, self._medium)
        found = {name: QUANTITIES[name].of(reading) for name in self.record}
        if now.shape[2] > 1:
            return found
        # a scalar has no component
        return {n: values[:, :, 0] if n in ("u", "v", "gradient") else values for n, values in found.items()}

    def state(self) -> Arrays:
        steps = np.concatenate([np.zeros(0, np.int64), *self._steps])
        return {"steps": steps, "before": self._before, **self.data}

    def take(self, state: Arrays) -> None:
        self._steps, self._before = [np.asarray(state["steps"])], state["before"].copy()
        self._rows = {name: [state[name]] for name in self.record}

    # --- what is refused ---------------------------------------------------------------------------------------

    def _check_model(self, near: NearField) -> None:
        has = [name for name, quantity in QUANTITIES.items() if quantity.has(near.model)]
        for name in self.record:
            kinds.one_of(name, "receivers.record", has, f"{near.model.title} has no such quantity")

    def _check_hidden(self, near: NearField, blocks: Blocks) -> None:
        """InputError where a sum takes nodes that are images beyond a wall, whose values are not the field's."""
        if near.hidden is None:
            return
        nodes, weights = blocks.entries()
        wrong = ((weights != 0) & near.hidden.ravel()[nodes]).any(axis=1)
        if wrong.any():
            raise InputError(
                "the receiver needs nodes beyond a wall, which are images of those inside",
                value=self.points[wrong][0],
                key="receivers.points",
                remedy=self._nearer,
            )

    @property
    def _nearer(self) -> str:
        return "interpolation = 'linear', or a point on a node" if self.interpolation == "sinc" else "a point on a node"

    def _check_cracks(self, setup: Setup, lattice: Lattice, blocks: Blocks) -> None:
        """InputError where a crack lies between a receiver and nodes that its sum takes: there the field jumps."""
        if not setup.cracks:
            return
        nodes, weights = blocks.entries()
        between = np.count_nonzero(weights, axis=1) > 1
        for number in np.flatnonzero(between):
            used = nodes[number][weights[number] != 0]
            ends = lattice.lower + lattice.spacing * np.stack(np.unravel_index(used, lattice.shape), -1)
            if any(crack.cut.cuts(self.points[number], ends).any() for crack in setup.cracks):
                raise InputError(
                    "a crack lies between the receiver and nodes that its interpolation takes",
                    value=self.points[number],
                    limit=f"interpolation = {self.interpolation!r}",
                    key="receivers.points",
                    remedy=self._nearer,
                )

    def _aliased(self, near: NearField) -> list[str]:
        """What is to be known of waves whose frequencies not every step but every few cannot tell apart."""
        if near.model.order == 1 or self.every == 1:
            return []
        fastest = 2 * np.arcsin(min(1.0, near.dt * np.sqrt(near.rate_limit) / 2))  # phase in a step, of Verlet
        most = int(np.pi / fastest * (1 + 1e-9))
        if self.every <= most:
            return []
        limit, highest = 0.5 / (self.every * near.dt), fastest / (2 * np.pi * near.dt)
        return [
            f"{self.name} are recorded every {self.every} steps: what has frequencies above {shown(limit)} "
            f"appears at lower ones, and the lattice carries waves up to {highest:.4g}; every = {max(most, 1)} or less "
            "records all of them truly"
        ]


def _medium(near: NearField, points: np.ndarray) -> LocalModuli:
    """Constants of the medium at points: those of the nearest nodes."""
    factor = np.ones(len(points))
    if near.factor is not None:
        nearest = np.round((points - near.lattice.lower) / near.lattice.spacing).astype(int)
        factor = near.factor[tuple(np.clip(nearest, 0, np.array(near.lattice.shape) - 1).T)]
    lame, shear = near.model.moduli or (0.0, 0.0)
    return LocalModuli(lame * factor, shear * factor)
