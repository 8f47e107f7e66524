"""Inversion: the maps of a medium whose runs agree with data."""

from __future__ import annotations

import itertools
import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import PYTHON_ONLY, Duration, InFile, Length, Toml, Unit
from farhorizon.engine.engine import at_most, available_threads
from farhorizon.errors import InputError
from farhorizon.files.hdf5 import directory_of
from farhorizon.geometry.shapes import Shape
from farhorizon.inverse.checks import asked_for, check_linear, check_region, shots_of
from farhorizon.inverse.files import Stored, digest_of, read_inversion, write_inversion
from farhorizon.inverse.gradient import Gradient, gradient, receivers_of
from farhorizon.inverse.medium import constants_at_nodes, rule_of
from farhorizon.inverse.misfits import Arrays, DataMisfit, Misfit
from farhorizon.inverse.smoothing import Smoothing, roughness
from farhorizon.machine import progress as progress_line
from farhorizon.rounding import MARGIN
from farhorizon.simulation.setup.setup import Setup
from farhorizon.simulation.simulation import Simulation
from farhorizon.simulation.time.outer_loop import checked_end

_SMALL = 0.01  # differences between neighbours, relative to a map's mean, that a total variation counts as none
_DARK = 1e-3  # of the mean illumination: nodes that have seen less are not moved more


class Step(NamedTuple):
    """An accepted step of an inversion.

    Attributes
    ----------
    stage, iteration : int
        Iterations count through all stages.
    misfit : float
    """

    stage: int
    iteration: int
    misfit: float


@dataclass(frozen=True, eq=False)
class Inversion:
    """What an inversion has found.

    Attributes
    ----------
    maps : dict of str to ndarray
        Constants of the medium at the nodes.
    history : list of Step
        The first one of each stage is its start. Misfits of different stages are those of other frequencies.
    models : list of dict of str to ndarray
        The maps after each of these steps.
    records : list of list of dict
        For each shot and misfit, the records of the last run.
    setups : list of Setup
        Those of the shots, with the maps that were found and all choices made.
    message : str
        Why it ended.

    Examples
    --------
    >>> import farhorizon as fh
    >>> fh.Inversion.__dataclass_fields__.keys() >= {"maps", "history", "models"}
    True
    """

    maps: Arrays
    history: list[Step]
    models: list[Arrays]
    records: list[list[Arrays]]
    setups: list[Setup]
    message: str

    @property
    def misfit(self) -> float:
        """The last misfit."""
        return self.history[-1].misfit


def invert(
    shots: Annotated[Sequence[tuple[Setup, Misfit | Sequence[Misfit]]], PYTHON_ONLY],
    wrt: str | Sequence[str],
    until: Duration,
    *,
    bounds: Mapping[str, tuple[float, float]],
    region: Annotated[Any, Toml(Shape)] = None,
    iterations: int = 20,
    tolerance: float = 1e-6,
    smooth: Length = 0.0,
    tikhonov: float = 0.0,
    variation: float = 0.0,
    frequencies: Annotated[Sequence[float | None], Toml(list[float | Literal[False]]), Unit("1/s"), InFile([False])] = (
        None,
    ),
    illumination: bool = True,
    output: Annotated[str | Path | None, PYTHON_ONLY] = None,
    callback: Annotated[Callable[[Inversion], None] | None, PYTHON_ONLY] = None,
    jobs: int = 1,
    memory: float | None = None,
    precision: str = "float64",
    progress: Annotated[bool | None, PYTHON_ONLY] = None,
) -> Inversion:
    r"""Find maps of a medium for which the runs of several shots agree with their data, by SciPy's L-BFGS-B.

    The sum over the shots of their misfits is divided by that of the first run, so that penalties and tolerances are
    plain numbers.

    Parameters
    ----------
    shots : sequence of (Setup, Misfit or sequence of Misfit)
        Runs of one medium, from which the maps start, with what was recorded of them.
    wrt : str or sequence of str
        Constants of the medium whose maps are unknown, such as "speed".
    until : float
        End of the runs.
    bounds : mapping of str to (float, float)
        Least and largest value of each map; the time step must be stable at all of them.
    region : Shape or ndarray of bool, optional
        Nodes at which the maps are unknown; elsewhere the medium is known. By default all that are more than one reach
        inside of sides that absorb.
    iterations : int
        Largest number of iterations in each stage.
    tolerance : float
        A stage ends when an iteration reduces the misfit by less than this fraction.
    smooth : float
        Length of the Gaussian means of which maps consist; 0 leaves each node to itself.
    tikhonov : float
        Weight of the mean square of the differences between neighbours, relative to the mean of a map.
    variation : float
        Weight of the mean of their magnitudes, which allows edges.
    frequencies : sequence of float or None
        One stage for each: the highest frequency of records and data that counts, the lowest one first; None, in a file
        false, for all.
    illumination : bool
        Move nodes by as much more as they have seen less of the sources' waves.
    output : str or Path, optional
        HDF5 file of the maps and misfits of all steps, written after each of them. An inversion of the same problem
        continues from the file: one that was killed, or one with more `iterations`.
    callback : callable, optional
        Called with the `Inversion` so far after each step.
    jobs : int
        Number of processes among which the shots are shared out.
    memory : float, optional
        Bytes for the history of the run of a shot; half of what the machine has available unless given. A history that
        does not fit is computed a second time, piece by piece.
    precision : {"float64", "float32"}
        Number type of the history.
    progress : bool, optional
        Show a progress line; by default only on terminals.

    Returns
    -------
    Inversion

    Raises
    ------
    InputError
        As `gradient`; shots of different media or lattices, bounds that no medium has, that the start violates, or at
        which the time step is unstable; a file of another inversion. All before any step.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> def bar(speed):
    ...     pulse = fh.PointSource(-10.0, time=fh.Ricker(0.06))
    ...     model = fh.Wave(fh.Kernel(2.0), speed)
    ...     return fh.Setup(fh.Lattice(1.0, -15, 15), model, fh.LatticePML(nodes=12), sources=[pulse], dt=0.5)
    >>> [x] = bar(1.0).lattice.axes
    >>> ends = fh.Receivers([-12.0, 12.0])
    >>> run = fh.Simulation.of(bar(1 + 0.1 * np.exp(-x**2 / 8)), observe=[ends])
    >>> run.step(120)
    >>> shot = bar(np.ones(31)), fh.LeastSquares(ends, ends.data["u"])
    >>> found = fh.invert([shot], "speed", until=60.0, bounds={"speed": (0.8, 1.2)}, smooth=2.0, iterations=8)
    >>> bool(found.misfit < 0.01 * found.history[0].misfit), bool(found.maps["speed"][15] > 1.05)
    (True, True)
    """
    asked = _Problem.of(shots, wrt, until, bounds, region)
    limits = {"tolerance": tolerance, "smooth": smooth, "tikhonov": tikhonov, "variation": variation}
    for name, value in limits.items():
        kinds.number(value, name, least=0)
    kinds.integer(iterations, "iterations", least=0)
    kinds.integer(jobs, "jobs", least=1)
    kinds.flag(illumination, "illumination")
    show = None if progress is None else kinds.flag(progress, "progress")
    if callback is not None:
        kinds.function(callback, "callback", "inversion")
        if isinstance(callback, np.ufunc):
            raise InputError("a function of numbers", value=callback, limit="one of an Inversion", key="callback")
    given = kinds.sequence(frequencies, "frequencies", "frequencies")
    if not given:
        raise InputError("there is no stage", value=given, limit=">= 1", key="frequencies", remedy="[None] for all")
    stages = [limit if limit is None else kinds.number(limit, "frequencies", above=0) for limit in given]
    for limit, (_, misfits) in itertools.product(stages, asked.shots):
        _ = [misfit if limit is None else misfit.below(limit) for misfit in misfits]
    path = None if output is None else kinds.path(output, "output")
    if path is not None:
        directory_of(path)
    solver = _Solver(asked, smooth, tikhonov, variation, illumination, {"memory": memory, "precision": precision})
    with _evaluating(jobs, len(asked.shots)) as evaluate:
        return solver.solve(stages, iterations, tolerance, path, callback, evaluate, show)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Shots of one medium, with the maps from which an inversion starts."""

    shots: list[tuple[Setup, list[Misfit]]]
    names: tuple[str, ...]
    until: float
    bounds: dict[str, tuple[float, float]]
    region: np.ndarray
    start: Arrays

    @classmethod
    def of(cls, shots: Any, wrt: Any, until: float, bounds: Any, region: Any) -> _Problem:
        """Check what is given, and settle the time steps and the sides of the shots for the start."""
        given = shots_of(shots)
        first = given[0][0]
        asked = asked_for(first, wrt)
        if not asked.constants or asked.initial or asked.sources or asked.parameters:
            raise InputError(
                "an inversion finds maps of the medium",
                value=wrt,
                limit=", ".join(first.model.wave_constants),
                key="wrt",
                remedy="gradient gives the derivatives by sources and initial data, for scipy.optimize.minimize",
            )
        start = {name: constants_at_nodes(first)[name] for name in asked.constants}
        for i, (setup, _) in enumerate(given):
            check_linear(setup, asked)
            if not _alike(constants_at_nodes(first), constants_at_nodes(setup)):
                raise InputError(
                    "all shots have one lattice and one medium",
                    value=f"shot {i}",
                    limit="those of shot 0",
                    key=f"shots[{i}]",
                    remedy="replace(setup, sources=...) for each shot",
                )
        sims = [Simulation.of(setup, observe=receivers_of(misfits)) for setup, misfits in given]
        inside = check_region(region, sims[0], asked)
        limits = {name: _bounds(name, bounds, start[name], first) for name in asked.constants}
        for sim, (setup, misfits) in zip(sims, given, strict=True):
            _check_step(replace(setup, dt=sim.dt), limits, start)
            checked_end(until, sim.dt)
            for misfit in misfits:
                steps = int(np.ceil(until / sim.dt - MARGIN))
                misfit.check(steps // misfit.receivers.every + 1, sim.stencil.components)
            sim.prepare(until)
        settled = [(sim.settled, misfits) for sim, (_, misfits) in zip(sims, given, strict=True)]
        return cls(settled, asked.constants, until, limits, inside, start)

    @property
    def data(self) -> Iterator[np.ndarray]:
        """What the shots were recorded as, and the weights of that."""
        for misfit in (misfit for _, misfits in self.shots for misfit in misfits):
            if isinstance(misfit, DataMisfit):
                yield from (*misfit.data.values(), misfit.weights)

    def with_maps(self, maps: Arrays, frequency: float | None = None) -> list[tuple[Setup, list[Misfit]]]:
        """Return the shots in a medium with other maps."""
        shots = []
        for setup, misfits in self.shots:
            medium = replace(setup, model=setup.model.with_constants(maps), rule=rule_of(setup))
            shots.append((medium, misfits if frequency is None else [one.below(frequency) for one in misfits]))
        return shots


def _alike(first: Arrays, other: Arrays) -> bool:
    """Whether two media have the same constants at the same nodes."""
    return first.keys() == other.keys() and all(np.array_equal(values, other[name]) for name, values in first.items())


def _bounds(name: str, given: Any, start: np.ndarray, setup: Setup) -> tuple[float, float]:
    """Return the bounds of a map; refuse those that no medium has, or that the start violates."""
    key = f"bounds.{name}"
    pairs = kinds.instance(given, "bounds", Mapping, "a mapping of names to (least, largest)")
    if name not in pairs:
        raise InputError(
            "an unknown map needs bounds",
            value=sorted(pairs),
            limit=name,
            key="bounds",
            remedy=f"{{{name!r}: (low, high)}}",
        )
    low, high = kinds.array(pairs[name], key, shape=(2,))
    setup.model.check_constant(name, np.array([low, high]), key)
    if not low < high:
        raise InputError("the bounds are out of order", value=(low, high), limit="least < largest", key=key)
    if start.min() < low or start.max() > high:
        raise InputError(
            "the start lies outside the bounds",
            value=(float(start.min()), float(start.max())),
            limit=(float(low), float(high)),
            key=key,
            remedy="wider bounds, or another start",
        )
    return float(low), float(high)


def _check_step(setup: Setup, bounds: Mapping[str, tuple[float, float]], start: Arrays) -> None:
    """Refuse a time step that is unstable in a uniform medium at some of the bounds."""
    for ends in itertools.product(*bounds.values()):
        maps = {name: np.full(start[name].shape, end) for name, end in zip(bounds, ends, strict=True)}
        trial = replace(setup, model=setup.model.with_constants(maps), initial={}, sources=(), loads=(), constraints=())
        try:
            Simulation.of(trial)
        except InputError as error:
            if error.key != "run.dt":
                raise
            raise InputError(
                "the time step is unstable within the bounds",
                value=error.value,
                limit=error.limit,
                key="bounds",
                remedy="narrower bounds, or a shorter dt in the set-ups and the data",
            ) from None


Evaluate = Callable[[list[tuple[Setup, list[Misfit]]], dict[str, Any]], Iterator[Gradient]]


@contextmanager
def _evaluating(jobs: int, shots: int) -> Iterator[Evaluate]:
    """Yield what takes the gradients of shots, in this process or in several."""
    jobs = min(jobs, shots)
    if jobs <= 1:
        yield lambda given, options: (_gradient_of(*one, options, None) for one in given)
        return
    threads = max(1, available_threads() // jobs)
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:

        def evaluate(given: list[tuple[Setup, list[Misfit]]], options: dict[str, Any]) -> Iterator[Gradient]:
            waiting = [pool.submit(_gradient_of, *one, options, threads) for one in given]
            return (one.result() for one in waiting)

        yield evaluate


def _gradient_of(setup: Setup, misfits: list[Misfit], options: dict[str, Any], threads: int | None) -> Gradient:
    with at_most(threads):
        return gradient(setup, misfits, **options)


@dataclass(eq=False)
class _Solver:
    """An inversion on its way.

    Its unknowns are changes of the maps at the nodes of the region, relative to the mean of each map, before they are
    smoothed; the optimiser sees them divided by a scale.
    """

    problem: _Problem
    smooth: float
    tikhonov: float
    variation: float
    illumination: bool
    options: dict[str, Any]
    history: list[Step] = field(default_factory=list)
    models: list[Arrays] = field(default_factory=list)
    records: list[list[Arrays]] = field(default_factory=list)

    def __post_init__(self) -> None:
        lattice, problem = self.problem.shots[0][0].lattice, self.problem
        exists = np.ones(lattice.shape, bool) if lattice.existing is None else lattice.existing
        self.means = Smoothing(self.smooth / lattice.spacing, exists)
        self.middle = {name: float(values[exists].mean()) for name, values in problem.start.items()}
        self.count = int(problem.region.sum())
        self.change = np.zeros(len(problem.names) * self.count)
        self._scale, self._first = np.ones(self.change.size), 0.0
        self._frequency: float | None = None
        self._last: list[tuple[np.ndarray, float]] = []  # unknowns of the last runs, and their misfits

    def maps(self, change: np.ndarray) -> Arrays:
        """Return the maps of the unknowns."""
        maps, problem = {}, self.problem
        for name, part in zip(problem.names, np.split(change, len(problem.names)), strict=True):
            given = np.zeros(problem.region.shape)
            given[problem.region] = part
            moved = problem.start[name] + self.middle[name] * self.means.mean(given)
            # rounding may leave the bounds, and so may means beside a start that is rough
            maps[name] = np.where(problem.region, np.clip(moved, *problem.bounds[name]), problem.start[name])
        return maps

    def slope(self, derivatives: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the derivative by the unknowns, from that by the maps."""
        region = self.problem.region
        found = [
            self.means.transposed(np.where(region, derivatives[name], 0.0) * self.middle[name])[region]
            for name in self.problem.names
        ]
        return np.concatenate(found)

    def limits(self) -> np.ndarray:
        """Return the bounds of the unknowns, shape (n, 2)."""
        problem = self.problem
        ends = [
            np.concatenate(
                [
                    (problem.bounds[name][end] - problem.start[name][problem.region]) / self.middle[name]
                    for name in problem.names
                ]
            )
            for end in (0, 1)
        ]
        return np.stack(ends, axis=1)

    def misfit(self, change: np.ndarray, evaluate: Evaluate, light: bool = False) -> tuple[float, np.ndarray]:
        """Return the objective and its derivative by the unknowns; if `light`, begin a stage, with its own scale."""
        maps, problem = self.maps(change), self.problem
        options = {"wrt": problem.names, "until": problem.until, "region": problem.region, **self.options}
        total, seen, records = 0.0, np.zeros(problem.region.shape), []
        slopes = {name: np.zeros(problem.region.shape) for name in problem.names}
        for shot in evaluate(problem.with_maps(maps, self._frequency), {**options, "illumination": light}):
            total += shot.misfit
            seen += 0.0 if shot.illumination is None else shot.illumination
            slopes = {name: slopes[name] + shot[name] for name in problem.names}
            records.append(shot.records)
        self.records = records
        self._last = [*([] if light else self._last[-2:]), (change.copy(), total)]
        if light:
            self._first = total
            self._scale = self._scale_for(seen[problem.region])
        unit = self._first or 1.0
        value, rates = total / unit, {name: slope / unit for name, slope in slopes.items()}
        for name, values in maps.items():
            of = self.middle[name]
            more, steep = roughness(values / of, problem.region, self.tikhonov, self.variation, _SMALL)
            value, rates[name] = value + more, rates[name] + steep / of
        return value, self.slope(rates)

    def _scale_for(self, bright: np.ndarray) -> np.ndarray:
        """Return the scale of the unknowns from the illumination of their nodes."""
        if not (self.illumination and bright.any()):
            return np.ones(self.change.size)
        each = 1 / np.sqrt(bright / bright.mean() + _DARK)
        return np.tile(each / each.mean(), len(self.problem.names))

    def solve(
        self,
        stages: Sequence[float | None],
        iterations: int,
        tolerance: float,
        path: Path | None,
        callback: Callable[[Inversion], None] | None,
        evaluate: Evaluate,
        show: bool | None,
    ) -> Inversion:
        """Go through the stages, each from where the one before has ended."""
        problem = self.problem
        settings = (stages, self.smooth, self.tikhonov, self.variation)
        digest = digest_of(problem.start, problem.bounds, problem.region, problem.until, settings, problem.data)
        stored = None if path is None else read_inversion(path, digest)
        if stored is not None:
            self.history, self.models = [Step(*step) for step in stored.history], stored.models
            self.change = stored.change

        def keep(stage: int) -> None:
            self._keep(stage, path, digest)
            if callback is not None:
                callback(self._so_far("on its way"))

        message = "nothing was left to do"
        with progress_line(len(stages) * iterations, "iteration", show) as bar:
            for stage, frequency in enumerate(stages):
                done = sum(step.stage == stage for step in self.history) - 1
                if done >= iterations or any(step.stage > stage for step in self.history):
                    continue
                self._frequency = frequency
                message = self._stage(stage, iterations - max(done, 0), tolerance, evaluate, done < 0, keep, bar)
        if not self.records:
            self.misfit(self.change, evaluate)
        return self._so_far(message)

    def _stage(
        self, stage: int, iterations: int, tolerance: float, evaluate: Evaluate, new: bool, keep: Any, bar: Any
    ) -> str:
        """Iterate at one highest frequency; returns why it ended."""
        from scipy.optimize import minimize

        value, _ = self.misfit(self.change, evaluate, light=True)
        if new:
            keep(stage)
        if self._first == 0:
            return "the start agrees with the data"
        scale = self._scale

        def objective(x: np.ndarray) -> tuple[float, np.ndarray]:
            minimum, slope = self.misfit(x * scale, evaluate)
            return minimum, slope * scale

        def kept(x: np.ndarray) -> None:
            self.change = x * scale
            keep(stage)
            bar.set_postfix_str(f"misfit {self.history[-1].misfit:.4g}")
            bar.update(1)

        minimum = minimize(
            objective,
            self.change / scale,
            jac=True,
            method="L-BFGS-B",
            bounds=self.limits() / scale[:, None],
            callback=kept,
            options={"maxiter": iterations, "ftol": tolerance, "gtol": 0.0},
        )
        self.change = minimum.x * scale
        return f"{minimum.message}; the objective fell from {value:.4g} to {minimum.fun:.4g} in the last stage"

    def _keep(self, stage: int, path: Path | None, digest: str) -> None:
        """Keep an accepted step, in memory and in the file."""
        near = [float(np.abs(change - self.change).max(initial=0)) for change, _ in self._last]
        self.history.append(Step(stage, len(self.history), self._last[int(np.argmin(near))][1]))
        self.models.append(self.maps(self.change))
        if path is not None:
            write_inversion(path, Stored(digest, [tuple(one) for one in self.history], self.models, self.change))

    def _so_far(self, message: str) -> Inversion:
        maps = self.models[-1]
        setups = [setup for setup, _ in self.problem.with_maps(maps)]
        return Inversion(maps, list(self.history), list(self.models), list(self.records), setups, message)
