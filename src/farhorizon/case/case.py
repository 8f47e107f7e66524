"""Case files: TOML with the names of the Python interface, validated before any work is done."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from farhorizon import kinds
from farhorizon import public as fh
from farhorizon.arguments import ANY, FIELD, RATE
from farhorizon.case.build import model_of, models_in, named_materials, recorders_of, setup_of
from farhorizon.case.changes import changed
from farhorizon.case.problems import explain
from farhorizon.case.reading import Reader
from farhorizon.case.schema import UnitsPart, case_part, tables, tag_of, unit_of
from farhorizon.case.toml import document
from farhorizon.case.units import Units, unit
from farhorizon.errors import FileFormatError, InputError
from farhorizon.files.results_layout import Regions
from farhorizon.geometry.lattice import AXES
from farhorizon.simulation.processes.subdomain import checked_topology
from farhorizon.simulation.recorders.quantities import QUANTITIES, fields_of
from farhorizon.simulation.recorders.recorder import Observer
from farhorizon.simulation.setup.setup import check_names
from farhorizon.simulation.time.steady_state import STATIC
from farhorizon.simulation.time.steps import WholeSteps, whole_steps

_OUTPUTS = 40  # outputs of a run if `every` is not given
_MOST_OUTPUTS = 1e6  # each takes milliseconds


class Case:
    """A validated case file; `changes` are values at dotted keys that replace those in the text, and `path` is named in
    messages. Raises an InputError with file, key, value, limit and remedy.
    """

    def __init__(self, text: str, path: str | Path = "case.toml", changes: Mapping[str, Any] | None = None) -> None:
        self.text, self.path = text, Path(path)
        try:
            data = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # also for numbers and nesting beyond Python's limits
            raise InputError(f"{self.path}: not valid TOML: {error}") from None
        if changes:
            with self.naming():
                data = changed(data, changes)
            self.text = document(data)
        try:
            context: dict[str, Any] = {"folder": self.path.parent}
            if _has_readable_units(data):  # otherwise validation reports them
                with self.naming():
                    context["units"] = _units_of(data)
            self.parts = case_part().model_validate(data, context=context)
        except ValidationError as error:
            raise InputError(f"{self.path}: " + explain(error, data)) from None
        self.units: Units | None = context["units"]
        with self.naming():
            self._check_times()
            self._check_moments()
            self.lattice = Reader(0).made(self.parts.lattice, "lattice")
            self.model = model_of(self.parts.model, self.parts.material, self.lattice)
            self._check_absolute()
            self.setup = setup_of(self.parts, self.lattice, self.model, self.end, self._given_step)
            self._check_output()
            recorders_of(self.parts, self.lattice.dim)

    @classmethod
    def read(cls, path: str | Path, changes: Mapping[str, Any] | None = None) -> Case:
        """Read a case file."""
        try:
            text = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot read the case file {path}: {error.strerror}", remedy="check the path") from None
        except UnicodeDecodeError:
            raise FileFormatError(f"{path} is not a text file", remedy="a case file is TOML") from None
        return cls(text, path, changes)

    def refined(self, spacing: float) -> Case:
        """The case at another spacing, with the same number of nodes per horizon; a given time step scales with the
        spacing, for diffusion with its square.
        """
        finer = spacing / self.lattice.spacing
        changes: dict[str, Any] = {"lattice.spacing": spacing}
        if self.parts.lattice.nodes is not None:  # the cells of a box
            changes = {"lattice.nodes": [round(n / finer) for n in self.lattice.shape]}
        inner = {f"model.{name}": table for name, table in models_in(self.parts.model).items()}
        for name, table in ({"model": self.parts.model} | inner).items():
            kernel = getattr(table, "kernel", None)
            if kernel is not None:
                changes[f"{name}.kernel.horizon"] = kernel.horizon * finer
        if self.parts.run.dt is not None:
            changes["run.dt"] = self.parts.run.dt * finer ** (1 if self.model.order == 2 else 2)
        return self.changed(changes)

    def changed(self, changes: Mapping[str, Any]) -> Case:
        """The case with other values at dotted keys."""
        return Case(self.text, self.path, changes)

    def __reduce__(self) -> tuple[Any, ...]:
        return Case, (self.text, self.path)

    @property
    def name(self) -> str:
        """Name of the results: the stem of the file."""
        return self.path.stem

    @property
    def end(self) -> float:
        """End of the run; for a run to its static state, the latest end."""
        run = self.parts.run
        return float(run.limit if run.until == STATIC and run.limit is not None else run.until)

    @property
    def to_rest(self) -> dict[str, float]:
        """Arguments of `Run.run` for a run to its static state."""
        run = self.parts.run
        if run.load_steps is not None:
            return {}
        return {name: value for name in ("tolerance", "limit") if (value := getattr(run, name)) is not None}

    def every(self, dt: float) -> float:
        """Time between two outputs: as given, or a fortieth of the run, rounded to whole time steps."""
        if self.parts.output.every is not None:
            return self.parts.output.every
        return dt * max(1, round(self.end / _OUTPUTS / dt))

    @property
    def _whole_steps(self) -> WholeSteps:
        """Intervals that must be whole numbers of steps."""
        out, until = self.parts.output, self.end
        intervals = {"output.every": out.every, "output.probe_every": out.probe_every, "run.until": until}
        return WholeSteps(**{name: interval for name, interval in intervals.items() if interval is not None})

    def _step(self, default: float) -> float:
        """Time step to use in place of the default one: it divides the given intervals, and also a fortieth of the run
        if that is possible.
        """
        between = self.end / _OUTPUTS
        if self.parts.output.every is None and between >= default:
            try:
                return WholeSteps(**self._whole_steps.intervals, between=between)(default)
            except InputError:  # no common step, as with an odd `probe_every`
                pass
        return self._whole_steps(default)

    @property
    def _given_step(self) -> float | Callable[[float], float] | fh.LoadSteps:
        run = self.parts.run
        if run.load_steps is not None:
            steps = fh.LoadSteps(self.end / run.load_steps)
            try:
                return steps if run.tolerance is None else replace(steps, tolerance=run.tolerance)
            except InputError as error:
                raise error.at("run.tolerance") from None
        return self._step if run.dt is None else run.dt

    def schedule(self, dt: float) -> str:
        """When outputs and probes are recorded, in words."""
        time = "" if self.units is None else self.units.name("s")
        text = _interval(self.every(dt), dt, time)
        if self.parts.output.probes:
            between = self.parts.output.probe_every
            text += f"; probes {'every step' if between is None else _interval(between, dt, time)}"
        return text

    @property
    def _bondwise(self) -> bool:
        return self.model.bond_law is not None

    @property
    def _warms(self) -> bool:
        return self.model.of_temperature is not None

    @property
    def _dissolves(self) -> bool:
        return self.model.dissolution is not None

    @property
    def fields(self) -> tuple[str, ...]:
        """Fields that are written: as given, otherwise u, with T, the times of dissolution and the damage where the
        model has them.
        """
        more = ["T"] * self._warms + ["dissolved"] * self._dissolves + ["damage"] * self._bondwise
        default = ["u", *more]
        return tuple(default if self.parts.output.fields is None else self.parts.output.fields)

    @property
    def polylines(self) -> list[np.ndarray]:
        """Cracks that a picture can show: points and polylines, each of shape (n, dim)."""
        return [
            np.asarray(c.points, float).reshape(-1, self.lattice.dim) for c in self.parts.crack if c.points is not None
        ]

    @property
    def unit_names(self) -> dict[str, str]:
        """Units of length, time, frequency, recorded quantities and varying constants, by name; without those that the
        case does not define.
        """
        if (units := self.units) is None:
            return {}
        si_units = {"length": "m", "time": "s", "frequency": "1/s", "speed": "m/s", "u": FIELD, "v": RATE}
        if self.model.mechanical:
            per = ["/m^2", "/m", ""][self.lattice.dim - 1]  # per area in 1D, per thickness in 2D
            si_units |= {"stress": "Pa", "pressure": "Pa", "energy_flux": "W/m^2", "T": "K", "G": "J/m^2"}
            si_units |= {"energy": f"J{per}", "power": f"W{per}", "force": f"N{per}"}
        for constant in self.model.varying:
            if (si := unit_of(type(self.parts.model).model_fields[constant])) is not None:
                si_units[constant] = si
        names = {quantity: name for quantity, si in si_units.items() if (name := units.name(si))}
        if {"stress", "length"} <= names.keys():
            names |= dict.fromkeys(("K_I", "K_II"), f"{names['stress']} {names['length']}^(1/2)")
        return names

    @property
    def materials(self) -> Regions | None:
        """Nodes by material name, "" where a material has none; None if no material has a name."""
        return named_materials(self.parts.model, self.parts.material, self.lattice)

    @property
    def quantities(self) -> dict[str, str]:
        """Names of quantities in this case, in words."""
        u = self.model.quantity or "displacement" * self.model.mechanical
        energy = "energy" if self.model.order == 2 else r"$\frac{1}{2} \int (u - u_0)^2\,$d$V$, $u_0$ the background"
        return {"energy": energy, **({"u": u} if u else {})}

    def run(self, observe: Sequence[Observer] = (), communicator: Any = None, **changes: Any) -> fh.Simulation:
        """A new simulation of the case with some arguments changed, on the processes of a communicator if given."""
        with self.naming():
            check_names(changes)
            setup, recorders = replace(self.setup, **changes), [*recorders_of(self.parts, self.lattice.dim), *observe]
            simulation = fh.Simulation.of(setup, recorders, communicator, self.parts.run.topology)
            self._whole_steps.check(simulation.dt, "run.dt")
            return simulation

    def completed(self, threads: int | None = None) -> fh.Simulation:
        """A new run, completed, on at most so many threads."""
        limits = [limit for limit in (self.parts.run.threads, threads) if limit is not None]
        simulation = self.run(threads=min(limits, default=None))
        rest: dict[str, Any] = self.to_rest
        return simulation.run(self.parts.run.until, self.every(simulation.dt), progress=False, **rest)

    def figures(self, run: fh.Simulation) -> dict[str, float]:
        """Values of a run for a table of several cases: time step, number of steps, time and energy at the end, the
        largest magnitude of each written field, and the final values at the probes.
        """
        fields = fields_of(run, self.fields)
        figures = {"dt": run.dt, "steps": run.step_count, "time": run.time, "energy": run.energy()}
        figures |= {f"max_{name}": float(np.nanmax(np.abs(values), initial=0.0)) for name, values in fields.items()}
        u = run.fields["u"]
        for i, point in enumerate(self.parts.output.probes):
            node: tuple[Any, ...] = (..., *self.lattice.index(point))
            values = np.atleast_1d(u[node])
            names = [f"probe_{i}"] if len(values) == 1 else [f"probe_{i}_{axis}" for axis in AXES]
            figures |= dict(zip(names, map(float, values), strict=False))
        return figures

    def simulation(self, **changes: Any) -> fh.Simulation:
        """The same as `run`."""
        return self.run(**changes)

    @contextmanager
    def naming(self) -> Iterator[None]:
        """Context in which an InputError names the case file."""
        try:
            yield
        except InputError as error:
            with_path = type(error)(f"{self.path}: {error}")
            with_path.agreed = error.agreed
            raise with_path from None

    def _check_absolute(self) -> None:
        """Refuse temperatures not counted from absolute zero where deformation generates heat."""
        name = "" if self.units is None else self.units.name("K")
        if getattr(self.model, "coupled", False) and name and unit(name).zero:
            raise InputError(
                "the heat of deformation depends on the absolute temperature",
                value=name,
                limit="K",
                key="units.temperature",
                remedy='temperature = "K"; numbers may still be given as "20 degC"',
            )

    def _check_load_steps(self, count: int) -> None:
        if count < 1:
            raise InputError("a run has at least one load step", value=count, limit=1, key="run.load_steps")
        run = self.parts.run
        static = run.until if run.until == STATIC else None
        for name, given in {"until": static, "limit": run.limit, "dt": run.dt}.items():
            if given is not None:
                raise InputError(
                    "load steps divide the time until a given end",
                    value=given,
                    key=f"run.{name}",
                    remedy="leave it out" if static is None else "a number",
                )

    def _check_times(self) -> None:
        out, run = self.parts.output, self.parts.run
        checked_topology(run.topology)
        if run.until == STATIC and run.limit is None:
            raise InputError(
                "a run to the static state needs a latest end, for which its layers are chosen",
                key="run.limit",
                remedy="some tens of the time in which the slowest wave crosses the near field",
            )
        if run.load_steps is not None:
            self._check_load_steps(run.load_steps)
        for name, given in self.to_rest.items() if run.until != STATIC else ():
            raise InputError(
                "only a run to the static state has one", value=given, key=f"run.{name}", remedy='until = "static"'
            )
        for name, value in (
            ("output.every", out.every),
            ("output.probe_every", out.probe_every),
            ("run.until", self.end),
            ("run.tolerance", run.tolerance),
        ):
            if value is not None and value <= 0:
                raise InputError("must be positive", value=value, limit="> 0", key=name)
        if self.end > _MOST_OUTPUTS * (out.every or self.end):
            raise InputError(
                "so many outputs cannot be written",
                value=out.every,
                limit=f">= {self.end / _MOST_OUTPUTS:.3g}",
                key="output.every",
                remedy="fewer outputs; probes record every step",
            )

    def _check_moments(self) -> None:
        """Refuse pictures at times before the start; times after the end are allowed, as it may be postponed."""
        for i, time in enumerate(self.parts.output.pictures or ()):
            if time < 0:
                raise InputError(
                    "the time of the picture lies outside the run",
                    value=time,
                    limit=">= 0",
                    key=f"output.pictures[{i}]",
                    remedy="times within the run",
                )

    def _check_output(self) -> None:
        out = self.parts.output
        known = ["u", *["solid", "dissolved"] * self._dissolves, *["v"] * (self.model.order == 2)]
        known += ["damage"] * self._bondwise + ["stress"] * QUANTITIES["stress"].has(self.model)
        known += ["T", "thermal_strain"] * (self._warms or self.setup.heat is not None)
        if not self.fields:
            raise InputError(
                "a results file has one field or more",
                value="[]",
                limit=", ".join(known),
                key="output.fields",
                remedy="leave it out, or name one",
            )
        for name in self.fields:
            if name not in known:
                raise InputError(
                    f"a medium of type {self.parts.model.type} has no such field",
                    value=name,
                    limit=", ".join(known),
                    key="output.fields",
                )
        for point in out.probes:
            try:
                self.lattice.index(point)
            except InputError as error:
                raise error.at("output.probes") from None


def _interval(time: float, dt: float, unit: str) -> str:
    """An interval of time and its number of steps."""
    steps = whole_steps(time, dt)
    return f"every {f'{time:.6g} {unit}'.strip()} = {steps} step{'s' * (steps != 1)}"


def _has_readable_units(data: Mapping[str, Any]) -> bool:
    """Whether the units of a case that is not yet validated are a table of known keys and strings, or are absent."""
    units = data.get("units", {})
    known = isinstance(units, dict) and units.keys() <= UnitsPart.model_fields.keys()
    return known and all(isinstance(text, str) for text in units.values())


def _units_of(data: Mapping[str, Any]) -> Units | None:
    model = data.get("model")
    tag = model.get("type") if isinstance(model, dict) else None
    unit = next((model.field_unit for model in tables().known.models if tag_of(model) == tag), ANY)
    return Units(data["units"], unit) if "units" in data else None


def read_case(path: str | Path, changes: Mapping[str, Any] | None = None) -> Case:
    """Read and check a case file.

    Parameters
    ----------
    path : str or Path
    changes : mapping of str to values, optional
        Values at dotted keys that replace those in the file.

    Returns
    -------
    Case
        ``simulation()`` creates a new simulation of it, with changes of arguments if desired. ``setup``, ``lattice``
        and ``name`` describe it.

    Raises
    ------
    InputError
        Any error in the file; the message gives file, key, value, limit and remedy.

    Examples
    --------
    >>> import farhorizon as fh
    >>> from pathlib import Path
    >>> _ = Path("pulse.toml").write_text('''
    ... lattice = { spacing = 0.25, lower = [-3.0], upper = [3.0] }
    ... model = { type = "wave", kernel = { horizon = 0.75 } }
    ... initial = { u = "exp(-9*x**2)" }
    ... run = { until = 2.0 }
    ... ''')
    >>> case = fh.read_case("pulse.toml", {"model.speed": 2.0})
    >>> sim = case.simulation()
    >>> _ = sim.run(case.parts.run.until)
    >>> sim.time, sim.model.speed
    (2.0, 2.0)
    """
    changes = (
        {} if changes is None else kinds.instance(changes, "changes", Mapping, "a mapping of dotted keys to values")
    )
    for key in changes:
        kinds.text(key, "changes")
    return Case.read(kinds.path(path, "path"), changes)
