"""Receivers: recording of the field at points between the nodes, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Self

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Makes, OneOf, Points
from farhorizon.errors import InputError
from farhorizon.geometry.interpolation import (
    INTERPOLATIONS,
    Blocks,
    another_point,
    as_points,
    interpolation_blocks,
    points_on_grid,
    points_on_line,
)
from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.recorders.quantities import QUANTITIES, LocalModuli, Reading
from farhorizon.simulation.recorders.recorder import Arrays, RecordRequest, RowRecorder, StepValues
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Setup

#: Keys of a case file that give points.
POINT_KEYS = {
    "points": Annotated[Points, "Points, on nodes or between them."],
    "line": Annotated[Any, Makes(points_on_line), "Points along a line."],
    "grid": Annotated[Any, Makes(points_on_grid), "Points on a grid."],
}


class Receivers(RowRecorder):
    """Points at which a run is recorded in every step of the compiled loop, or every few steps.

    They are passed to a run in ``observe=[...]``.

    Parameters
    ----------
    points : array_like, shape (n, dim), or (n,) in 1D
        Anywhere in the near field; `line` and `grid` create regular arrangements.
    record : str or sequence of str
        What is recorded: "u", the field; for waves "v", the velocity; "gradient", the derivatives along the axes; for
        elastic media "strain", "stress", "pressure" (minus the mean of the normal stresses, in two dimensions of those
        in the plane), "divergence", "curl" and "rotation" (half the curl); for waves "energy_flux", the Poynting vector
        ``- stress . v``, for scalar waves ``- c^2 v grad u``.
    every : int
        Steps from one record to the next.
    interpolation : {"sinc", "linear"}
        Interpolation between nodes: by a windowed sinc that uses eight nodes to either side, accurate to some 1e-5 for
        waves of four nodes per wavelength and more; or linear, with an error of second order, which also works within
        eight nodes of an edge, a hole or a crack. A point that coincides with a node takes its value. Derivatives are
        those of the sinc, or central differences.
    name : str
        Name that distinguishes several of them in one run, in files and pictures.

    Attributes
    ----------
    points : ndarray, shape (n, dim)
    times : ndarray, shape (rows,)
        Time at which each row was recorded. "v" and "energy_flux" refer to half a step earlier, as in the energies.
    data : dict of str to ndarray
        Recorded values, each of shape (rows, n), for vectors (rows, n, dim), for tensors (rows, n, dim, dim); gradients
        of displacements have the component first.
    doubts : list of str
        Which waves are aliased if not every step is recorded; a `ValidityWarning` when the simulation is created.
    shared : bool
        They can also record runs on several processes, with the same result on each: sums over nodes of several boxes
        agree to rounding error.

    Raises
    ------
    InputError
        No points, an unknown quantity. When the simulation is created: points outside the near field, in a hole, or too
        close to an edge, a hole or a crack for the interpolation; quantities that the model does not have.

    Notes
    -----
    The interpolation is that of Hicks (2002), see `farhorizon.geometry.interpolation`. Where a material changes, the
    sinc shows ringing, as Fourier sums do; stress and energy flux use the moduli at the nearest node.

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

    shared = True

    def __init__(
        self,
        points: Annotated[Any, OneOf(**POINT_KEYS)],
        record: str | Sequence[str] = ("u",),
        every: int = 1,
        interpolation: str = "sinc",
        name: str = "receivers",
    ) -> None:
        super().__init__(name)
        self.points = kinds.array(points, "receivers.points")
        wanted = [record] if isinstance(record, str) else kinds.sequence(record, "receivers.record", "quantities")
        if not wanted:
            raise InputError(
                "nothing is to be recorded",
                value=wanted,
                limit=", ".join(QUANTITIES),
                key="receivers.record",
                remedy="one of these, or leave the receivers out",
            )
        for one in wanted:
            kinds.one_of(one, "receivers.record", QUANTITIES, "unknown quantity")
        self.record = tuple(dict.fromkeys(wanted))
        self.every = kinds.integer(every, "receivers.every", least=1)
        self.interpolation = kinds.one_of(
            interpolation, "receivers.interpolation", INTERPOLATIONS, "unknown interpolation"
        )

    @classmethod
    def line(cls, start: Any, end: Any, count: int, **options: Any) -> Self:
        """Create receivers at equal distances along a line, including both ends.

        Parameters
        ----------
        start, end : array_like, shape (dim,)
        count : int
        **options
            Options of the constructor.
        """
        return cls(points_on_line(start, end, count), **options)

    @classmethod
    def grid(cls, lower: Any, upper: Any, counts: Any, **options: Any) -> Self:
        """Create receivers on a grid, including both corners; the last axis varies fastest.

        Parameters
        ----------
        lower, upper : array_like, shape (dim,)
        counts : sequence of int
            Number of receivers along each axis.
        **options
            Options of the constructor.
        """
        return cls(points_on_grid(lower, upper, counts), **options)

    def __repr__(self) -> str:
        return f"Receivers({len(self.points)} points, record={list(self.record)}, every={self.every})"

    # --- in a run ----------------------------------------------------------------------------------------------

    def begin(self, setup: Setup, parts: Parts) -> RecordRequest:
        near = parts.whole.near
        lattice = near.lattice
        self._check_model(near)
        self.points = as_points(self.points, lattice.dim, "receivers.points")
        derived = any(QUANTITIES[name].derived for name in self.record)
        axes = [None, *range(lattice.dim)] if derived else [None]
        options = self.points, self.interpolation
        blocks = [interpolation_blocks(lattice, *options, axis, "receivers.points") for axis in axes]
        for axis, one in zip(axes, blocks, strict=True):
            check_blocks(setup, parts, self.points, one, self.interpolation, axis is not None, "receivers.points")
        self._medium, self._background, self._dt = moduli_at(parts, self.points), near.background, near.dt
        self.doubts = self._aliased(near)
        self._moving = any(QUANTITIES[name].moving for name in self.record)  # these need the previous step as well
        self._warm = near.model.warm and any(QUANTITIES[name].stressed for name in self.record)
        every = 1 if self._moving else self.every
        return RecordRequest(np.zeros(0, np.int64), tuple(blocks), every, heat=self._warm)

    def start(self, step: int, step_values: StepValues) -> None:
        rows = np.stack(step_values.blocks, axis=-1)
        self._before = rows[:1]
        self._begin_rows(self._read(rows[:0], rows[:0]))
        self._look(step, rows[1:])

    def add(self, step: int, step_values: StepValues) -> None:
        one = step_values.blocks[0][..., None]  # no copy: every quantity computes a new array
        self._look(step, one if len(step_values.blocks) == 1 else np.stack(step_values.blocks, axis=-1))

    def _look(self, step: int, rows: np.ndarray) -> None:
        """Record the field, its derivatives and the thermal strain, laid out as in `Reading`, after the steps from
        number `step` on.
        """
        kept = slice(-step % self.every, None, self.every)
        now = rows[kept]
        if len(now):
            before = np.concatenate([self._before, rows[:-1]])[kept] if self._moving else now
            self._keep(np.arange(step, step + len(rows))[kept], self._read(now, before))
        self._before = rows[-1:].copy()

    def _read(self, now: np.ndarray, before: np.ndarray) -> dict[str, np.ndarray]:
        """Return all quantities from the field and its derivatives now and one step before."""
        reading = Reading(now, before, self._dt, self._background, self._medium, self._warm)
        return reading.of(self.record)

    def state(self) -> Arrays:
        return {**super().state(), "before": self._before}

    def take(self, state: Arrays) -> None:
        super().take(state)
        self._before = state["before"].copy()

    # --- what is refused ---------------------------------------------------------------------------------------

    def _check_model(self, near: NearField) -> None:
        has = [name for name, quantity in QUANTITIES.items() if quantity.has(near.model)]
        for name in self.record:
            kinds.one_of(name, "receivers.record", has, f"{near.model.title} has no such quantity")

    def _aliased(self, near: NearField) -> list[str]:
        """Return warnings about waves whose frequencies are aliased because not every step is recorded."""
        if near.model.order == 1 or self.every == 1:
            return []
        most = int(0.5 / (near.highest_frequency * near.dt) * (1 + 1e-9))
        if self.every <= most:
            return []
        limit = 0.5 / (self.every * near.dt)
        return [
            f"{self.name} are recorded every {self.every} steps: frequencies above {limit:.4g} "
            f"are aliased to lower ones, and the lattice carries waves up to {near.highest_frequency:.4g}; "
            f"every = {max(most, 1)} or less records "
            "all of them correctly"
        ]


def moduli_at(parts: Parts, points: np.ndarray) -> LocalModuli:
    """Return the constants of the medium at points: those of the nearest nodes."""
    lattice = parts.near.lattice.whole
    last = np.array(lattice.shape) - 1  # points outside are refused elsewhere
    nearest = np.clip(np.round((points - lattice.lower) / lattice.spacing), 0, last).astype(int)
    return LocalModuli(*parts.at(parts.near.lame, np.ravel_multi_index(tuple(nearest.T), lattice.shape)))


def check_blocks(
    setup: Setup, parts: Parts, points: np.ndarray, blocks: Blocks, method: str, derived: bool, key: str
) -> None:
    """Refuse interpolations that use nodes whose values do not belong to the field around the point.

    Raises
    ------
    InputError
        Nodes lie beyond a wall, where they are images of those inside, or beyond a crack, where the field jumps.
    """
    remedy = another_point(method, derived)
    nodes, weights = blocks.entries()
    wrong = ((weights != 0) & parts.hides(nodes)).any(axis=1)
    if wrong.any():
        raise InputError(
            "the point needs nodes beyond a wall, which are images of those inside",
            value=points[wrong][0],
            limit=f"interpolation = {method!r}",
            key=key,
            remedy=remedy,
        )
    lattice = parts.near.lattice.whole
    for number in np.flatnonzero(np.count_nonzero(weights, axis=1) > 1) if setup.cracks else ():
        used = nodes[number][weights[number] != 0]
        ends = lattice.lower + lattice.spacing * np.stack(np.unravel_index(used, lattice.shape), -1)
        if any(crack.cut.cuts(points[number], ends).any() for crack in setup.cracks):
            raise InputError(
                "a crack lies between the point and nodes that its interpolation takes",
                value=points[number],
                limit=f"interpolation = {method!r}",
                key=key,
                remedy=remedy,
            )
