"""Case files: TOML with the words of the Python interface, validated before any work."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from farhorizon import kinds
from farhorizon import public as fh
from farhorizon.case.changes import changed
from farhorizon.case.problems import explain, nearest
from farhorizon.case.schema import (
    CONDITIONS,
    BodyForcePart,
    BoxPart,
    ConstraintPart,
    CrackPart,
    CutPart,
    FarFieldPart,
    MaterialPart,
    Part,
    PowerPart,
    PrescribedPart,
    PressurePart,
    ReceiversPart,
    SourcePart,
    SpectraPart,
    ThermalPart,
    TractionPart,
    UnitsPart,
    WeibullPart,
    case_part,
    incident_kinds,
    model_kinds,
    side_kinds,
    signal_kinds,
    source_kinds,
    under,
)
from farhorizon.case.toml import document
from farhorizon.case.units import ANY, FIELD, FIELDS, RATE, Units
from farhorizon.errors import FileFormatError, InputError
from farhorizon.files.region_numbers import Regions
from farhorizon.geometry.interpolation import points_on_grid, points_on_line
from farhorizon.geometry.lattice import AXES
from farhorizon.inputs.expressions import as_given, as_signal
from farhorizon.simulation.nodal_stress import fields_of
from farhorizon.simulation.quantities import QUANTITIES
from farhorizon.simulation.recorder import Observer
from farhorizon.simulation.rest import STATIC
from farhorizon.simulation.setup import keys
from farhorizon.simulation.share import checked_topology
from farhorizon.simulation.steps import WholeSteps, whole_steps

_RECORDED = {"record", "every", "interpolation", "frequencies", "radii", "most"}  # what recorders are told by name
_OUTPUTS = 40  # of a run, unless `every` is given

_MOST_OUTPUTS = 1e6  # each takes milliseconds


class Case:
    """A validated case file.

    Parameters
    ----------
    text : str
        TOML.
    path : Path or str
        Named in messages; its stem names the results.
    changes : mapping of str to values, optional
        What stands at dotted keys in place of what the text has ("model.speed"). `text` is then that of the changed
        case.

    Raises
    ------
    InputError
        Anything wrong, with file, key, value, limit and remedy.
    """

    def __init__(self, text: str, path: str | Path = "case.toml", changes: Mapping[str, Any] | None = None) -> None:
        self.text, self.path = text, Path(path)
        try:
            data = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # of numbers and of nesting beyond what Python takes, too
            raise InputError(f"{self.path}: not valid TOML: {error}") from None
        if changes:
            with self.naming():
                data = changed(data, changes)
            self.text = document(data)
        try:
            context: dict[str, Any] = {"folder": self.path.parent}
            if _has_readable_units(data):  # else these are what is wrong
                with self.naming():
                    context["units"] = _units_of(data)
            self.parts = case_part().model_validate(data, context=context)
        except ValidationError as error:
            raise InputError(f"{self.path}: " + explain(error, data)) from None
        self.units: Units | None = context["units"]
        with self.naming():
            self._check_times()
            self.lattice = self._lattice()
            self.model = self._model(self.parts.model)
            self.vector = self.model.mechanical
            self.setup = self._setup()
            self._check_output()
            self._recorders()

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
        """The case at another spacing, with as many nodes in the horizon; a time step of its own goes with the
        spacing, where something diffuses with its square.
        """
        finer, changes = spacing / self.lattice.spacing, {"lattice.spacing": spacing}
        kernel = getattr(self.parts.model, "kernel", None)
        if kernel is not None:
            changes["model.kernel.horizon"] = kernel.horizon * finer
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
        """Name of the results: the file's stem."""
        return self.path.stem

    @property
    def end(self) -> float:
        """End of the run; of one to its static state the latest."""
        run = self.parts.run
        return float(run.limit if run.until == STATIC and run.limit is not None else run.until)

    @property
    def to_rest(self) -> dict[str, float]:
        """What `Run.run` is told of a run to its static state."""
        run = self.parts.run
        return {name: value for name in ("tolerance", "limit") if (value := getattr(run, name)) is not None}

    def every(self, dt: float) -> float:
        """Time between two outputs with a time step; a fortieth of the run, or the number of steps next to it, unless
        given.
        """
        if self.parts.output.every is not None:
            return self.parts.output.every
        return dt * max(1, round(self.end / _OUTPUTS / dt))

    @property
    def _asked(self) -> WholeSteps:
        """What is to be a whole number of steps."""
        out, until = self.parts.output, self.end
        asked = {"output.every": out.every, "output.probe_every": out.probe_every, "run.until": until}
        return WholeSteps(**{name: interval for name, interval in asked.items() if interval is not None})

    def _step(self, default: float) -> float:
        """The time step in place of the default one: it divides what is asked for, and a fortieth of the run if that
        comes for free.
        """
        between = self.end / _OUTPUTS
        if self.parts.output.every is None and between >= default:
            try:
                return WholeSteps(**self._asked.intervals, between=between)(default)
            except InputError:  # with an odd `probe_every`
                pass
        return self._asked(default)

    @property
    def _given_step(self) -> float | Callable[[float], float]:
        return self._step if self.parts.run.dt is None else self.parts.run.dt

    def schedule(self, dt: float) -> str:
        """When outputs and probes are recorded, in words."""
        every = self.every(dt)
        said = f"every {every:.6g} = {whole_steps(every, dt)} steps"
        if self.parts.output.probes:
            between = self.parts.output.probe_every
            said += "; probes " + (
                "every step" if between is None else f"every {between:.6g} = {whole_steps(between, dt)} steps"
            )
        return said

    @property
    def _bondwise(self) -> bool:
        return self.model.bond_law is not None

    @property
    def _dissolves(self) -> bool:
        return self.model.dissolution is not None

    @property
    def fields(self) -> tuple[str, ...]:
        """What is written: u unless given, of a corrosion the times of dissolution too, of what breaks the damage."""
        more = ["dissolved"] * self._dissolves + ["damage"] * self._bondwise
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
        """The units of length, time, frequency and what is recorded in pictures and files; nothing of those that the
        case does not say.
        """
        if (units := self.units) is None:
            return {}
        named = {"length": "m", "time": "s", "frequency": "1/s", "u": FIELD, "v": RATE}
        if self.vector:
            named |= {"stress": "Pa", "pressure": "Pa", "energy_flux": "W/m^2"}
        return {what: name for what, si in named.items() if (name := units.name(si))}

    @property
    def quantities(self) -> dict[str, str]:
        """What fields are, in words."""
        known = {
            "heat": "temperature u",
            "diffusion": "concentration u",
            "corrosion": "concentration u",
            "beam": "deflection u",
        }
        u = "displacement u" if self.vector else known.get(self.parts.model.type, "")
        words = {"u": u, "v": "velocity v", "damage": "damage: part of the bonds that are broken", "solid": "metal"}
        return {name: text for name, text in words.items() if text}

    def run(self, observe: Sequence[Observer] = (), communicator: Any = None, **changes: Any) -> fh.Simulation:
        """A new simulation of the case, with some arguments changed; on the processes of a communicator, if any."""
        with self.naming():
            setup, recorders = replace(self.setup, **changes), [*self._recorders(), *observe]
            made = fh.Simulation.of(setup, recorders, communicator, self.parts.run.topology)
            self._asked.check(made.dt, "run.dt")
            return made

    def completed(self, threads: int | None = None) -> fh.Simulation:
        """A new run that has come to its end, on so many threads at most."""
        given = self.parts.run.threads
        least = min((one for one in (given, threads) if one is not None), default=None)
        made = self.run(threads=least)
        rest: dict[str, Any] = self.to_rest
        return made.run(self.parts.run.until, self.every(made.dt), progress=False, **rest)

    def figures(self, run: fh.Simulation) -> dict[str, float]:
        """What a table of several cases has of a run: its step, their number, the time and the energy at the end, the
        largest magnitude of each field that is written, and what the probes show then.
        """
        fields = fields_of(run, self.fields)
        found = {"dt": run.dt, "steps": run.step_count, "time": run.time, "energy": run.energy()}
        found |= {f"max_{name}": float(np.nanmax(np.abs(values), initial=0.0)) for name, values in fields.items()}
        u = run.fields["u"]
        for i, point in enumerate(self.parts.output.probes):
            place: tuple[Any, ...] = (..., *self.lattice.index(point))
            values = np.atleast_1d(u[place])
            names = [f"probe_{i}"] if len(values) == 1 else [f"probe_{i}_{axis}" for axis in AXES]
            found |= dict(zip(names, map(float, values), strict=False))
        return found

    def _recorders(self) -> list[Observer]:
        """New recorders, which belong to one run."""
        makers: dict[str, tuple[Callable[..., Observer], Callable[[Any, str], list[Any]]]] = {
            "receivers": (fh.Receivers, lambda part, key: [_where(part, key)]),
            "spectra": (fh.Spectra, lambda part, key: [_where(part, key)]),
            "power": (fh.PowerThrough, lambda part, key: [_surface(part, key)]),
            "stress_intensity": (fh.StressIntensity, lambda part, _: [part.tips]),
            "crack_tips": (fh.CrackTips, lambda *_: []),
            "shell": (fh.ShellRecorder, lambda part, _: [_box(part.box)]),
        }
        found: list[Observer] = []
        for table, (make, places) in makers.items():
            parts = getattr(self.parts, table)
            for i, part in enumerate(parts):
                key = f"{table}[{i}]"
                name = part.name or (f"{table}_{i}" if len(parts) > 1 else table)
                try:
                    found.append(make(*places(part, key), **part.model_dump(include=_RECORDED), name=name))
                except InputError as error:
                    raise error.at(under(key, error.key)) from None
        if self.parts.far_field is not None:
            found.append(_far_field(self.parts.far_field))
        return found

    def simulation(self, **changes: Any) -> fh.Simulation:
        """The same as `run`."""
        return self.run(**changes)

    @contextmanager
    def naming(self) -> Iterator[None]:
        """Within it an InputError names the case file."""
        try:
            yield
        except InputError as error:
            named = type(error)(f"{self.path}: {error}")
            named.agreed = error.agreed
            raise named from None

    def _lattice(self) -> fh.Lattice:
        part = self.parts.lattice
        window = part.window.build("lattice.window") if part.window else None
        body = part.body.build("lattice.body") if part.body else None
        return fh.Lattice(part.spacing, part.lower, part.upper, window=window, body=body)

    def _model(self, part: Any) -> fh.LatticeModel:
        values = part.model_dump(exclude={"type", "kernel", "stencil", "stages", "of", "name"})
        kind = model_kinds()[part.type]
        takes = signature(kind).parameters
        values |= {name: self._steady(one, f"model.{name}") for name, one in part if isinstance(one, WeibullPart)}
        if "operator" in takes:
            values["operator"] = self._operator(part)
        elif "kernel" in takes:
            values["kernel"] = None if part.kernel is None else fh.Kernel(**part.kernel.model_dump())
        if "integrator" in takes and part.stages is not None:
            if part.integrator != "rkc":
                raise InputError(
                    "only Runge-Kutta-Chebyshev has stages to choose",
                    value=part.integrator,
                    limit="rkc",
                    key="model.stages",
                )
            values["integrator"] = fh.RungeKuttaChebyshev(part.stages)
        for i, part in enumerate(self.parts.material):
            if not part.model_fields_set - {"region", "name"}:
                raise InputError(
                    "a region without a material",
                    key=f"material[{i}]",
                    limit=", ".join(sorted(set(MaterialPart.model_fields) - {"region", "name"})),
                    remedy="give it constants, or leave it out",
                )
        named = {name for part in self.parts.material for name in part.model_fields_set - {"region", "of", "name"}}
        for name in sorted(named):
            if values.get(name) is None:
                known = sorted(
                    set(MaterialPart.model_fields) & {one for one, value in values.items() if value is not None}
                )
                raise InputError(
                    "a region has constants that the model has, too",
                    value=name,
                    limit=", ".join(known) or "none",
                    key="material",
                    remedy=f"give [model] its {name}, of what is elsewhere" if name in takes else "leave it out",
                )
            values[name] = self._constant(name, values[name])
        try:
            return kind(**values)
        except InputError as error:
            raise error.at(under("model", error.key)) from None

    def _operator(self, part: Any) -> fh.Kernel | fh.Stencil:
        if (part.kernel is None) == (part.stencil is None):
            raise InputError("give either [model.kernel] or stencil", key="model")
        if part.kernel is not None:
            return fh.Kernel(**part.kernel.model_dump())
        make = fh.Stencil.finite_difference if part.stencil == "finite-difference" else fh.Stencil.finite_element
        return make(self.lattice.dim)

    def _expression(self, value: str | float | list[str | float], key: str) -> Any:
        if isinstance(value, list):
            if not self.vector or len(value) != self.lattice.dim:
                limit = f"a list of {self.lattice.dim}" if self.vector else "one"
                raise InputError("not as many entries as the field has components", value=value, limit=limit, key=key)
            return [self._entry(part, f"{key}[{i}]") for i, part in enumerate(value)]
        return self._entry(value, key)

    @staticmethod
    def _of_time(value: str | float | Part, key: str) -> Any:
        """A function of t alone."""
        return _built(value, signal_kinds(), key) if isinstance(value, Part) else as_signal(value, key)

    def _of_times(self, value: Any, key: str) -> Any:
        """Functions of t alone, one a component, and None where there is none."""
        if value is None or value is False:
            return None
        if isinstance(value, list):
            return [self._of_times(one, f"{key}[{i}]") for i, one in enumerate(value)]
        return self._of_time(value, key) if isinstance(value, Part) else self._entry(value, key)

    def _entry(self, value: str | float, key: str) -> Any:
        return as_given(value, self.lattice.dim, key)

    def _initial(self) -> dict[str, Any]:
        """Initial values, which do not depend on time."""
        found: dict[str, Any] = {}
        for name, value in self.parts.initial.items():
            found[name] = self._expression(value, f"initial.{name}")
            for entry in found[name] if isinstance(found[name], list) else [found[name]]:
                if isinstance(entry, fh.Expression) and entry.uses_time:
                    raise InputError("initial data cannot depend on t", value=value, key=f"initial.{name}")
        return found

    def _boundary(self) -> dict[str, Any]:
        """What stands on the sides that are named."""
        boundary: dict[str, Any] = {}
        kinds = side_kinds()
        for side, part in self.parts.boundary.items():
            values = part.model_dump(exclude={"type"}, exclude_none=True)
            if "until" in type(part).model_fields:
                values.setdefault("until", self.end)
            try:
                boundary[side] = kinds[part.type](**values)
            except InputError as error:
                raise error.at(under(f"boundary.{side}", error.key)) from None
        allowed = ["all"] + [AXES[a] + s for a in range(self.lattice.dim) for s in ("", "-", "+")]
        for side in boundary:
            if side not in allowed:
                raise InputError(
                    "unknown side", value=side, limit=", ".join(allowed), key="boundary", remedy=nearest(side, allowed)
                )
        return boundary

    def _setup(self) -> fh.Setup:
        parts = self.parts
        if parts.load and not self.vector:
            raise InputError(
                "loads act on an elastic medium",
                value=parts.model.type,
                key="load",
                limit="elastic, correspondence",
                remedy="[[source]]",
            )
        coefficient = None
        if parts.coefficient is not None:
            expression = self._expression(parts.coefficient, "coefficient")
            coefficient = np.broadcast_to(
                expression(*self.lattice.coordinates()) if callable(expression) else expression, self.lattice.shape
            )
        return fh.Setup(
            lattice=self.lattice,
            model=self.model,
            initial=self._initial(),
            boundary=self._boundary() or fh.LatticePML(until=self.end),
            sources=[self._source(s, key) for s, key in zip(parts.source, keys("source", parts.source), strict=True)]
            + [self._incident(w, key) for w, key in zip(parts.incident, keys("incident", parts.incident), strict=True)],
            specimens=[
                fh.Specimen(s.region.build(f"specimen[{i}].region"), s.concentration)
                for i, s in enumerate(parts.specimen)
            ],
            cracks=[self._crack(c) for c in parts.crack],
            constraints=[self._constraint(c, f"constraint[{i}]") for i, c in enumerate(parts.constraint)],
            coefficient=coefficient,
            rule=parts.rule,
            rim=parts.rim,
            background=parts.background,
            loads=[self._load(load, f"load[{i}]") for i, load in enumerate(parts.load)],
            balance=parts.output.balance,
            dt=self._given_step,
            dtype=parts.run.dtype,
            threads=parts.run.threads,
        )

    def _source(self, part: Part, key: str) -> Any:
        given = {"time": self._of_time(dict(part)["time"], f"{key}.time")} if "time" in part.model_fields_set else {}
        if not isinstance(part, SourcePart):
            return _built(part, source_kinds(), key, **given)
        value = self._expression(part.value, f"{key}.value")
        return fh.Source(value, **given) if given else value

    def _incident(self, part: Part, key: str) -> Any:
        given = dict(part)
        changes = {"within": _box(given["within"])}
        if "signal" in given:
            changes["signal"] = self._of_time(given["signal"], f"{key}.signal")
        return _built(part, incident_kinds(), key, **changes)

    def _constant(self, name: str, value: Any) -> Any:
        """A constant of the material, with what regions have in its place, later ones before earlier ones."""
        given = [
            (part, f"material[{i}].") for i, part in enumerate(self.parts.material) if getattr(part, name) is not None
        ]
        found = self._steady(value, f"model.{name}")
        if not given:
            return found
        at = self.lattice.coordinates()
        values = np.array(np.broadcast_to(found(*at) if callable(found) else found, self.lattice.shape), float)
        for part, key in given:
            there = part.region.build(f"{key}region").contains(np.stack(at, -1))
            if not there.any():
                raise InputError("the region has no node of the near field", key=f"{key}region")
            inside = self._steady(getattr(part, name), key + name)
            values[there] = inside(*(x[there] for x in at)) if callable(inside) else inside
        return values

    @property
    def materials(self) -> Regions | None:
        """The nodes by what the case calls their materials, "" where that has no name; None where none has."""
        names = [_called(self.parts.model)]
        numbers = np.zeros(self.lattice.shape, np.int32)
        for i, part in enumerate(self.parts.material):
            if name := _called(part):
                names += [] if name in names else [name]
                region = part.region.build(f"material[{i}].region")
                numbers[region.contains(np.stack(self.lattice.coordinates(), -1))] = names.index(name)
        return Regions(numbers, tuple(names)) if any(names) else None

    def _steady(self, value: str | float | WeibullPart, key: str) -> Any:
        """An expression of the coordinates alone, a number, or what scatters."""
        if isinstance(value, WeibullPart):
            try:
                return fh.Weibull(**value.model_dump(exclude={"type"}))
            except InputError as error:
                raise error.at(under(key, error.key)) from None
        entry = self._entry(value, key)
        if isinstance(entry, fh.Expression) and entry.uses_time:
            raise InputError("a material cannot depend on t", value=value, key=key)
        return entry

    def _load(
        self, part: TractionPart | PressurePart | BodyForcePart | ThermalPart, key: str
    ) -> fh.Traction | fh.Pressure | fh.BodyForce | fh.ThermalLoad:
        if isinstance(part, ThermalPart):
            temperature = self._entry(part.temperature, f"{key}.temperature")
            expansion = self._steady(part.expansion, f"{key}.expansion")
            return fh.ThermalLoad(temperature, expansion, part.reference, part.every)
        factor = self._of_time(part.time, f"{key}.time")
        if isinstance(part, TractionPart):
            return fh.Traction(part.side, part.value, part.between, factor)
        if isinstance(part, PressurePart):
            on = self._cut(part, key) if part.region is None else part.region.build(f"{key}.region")
            try:
                return fh.Pressure(on, part.value, factor)
            except InputError as error:
                raise error.at(under(key, error.key.removeprefix("load."))) from None
        return fh.BodyForce(self._expression(part.value, f"{key}.value"), factor)

    def _prescribed(self, part: PrescribedPart, key: str) -> fh.Prescribed:
        if (part.points is None) == (part.region is None):
            raise InputError("give either points or region", key=key)
        where = part.points if part.region is None else part.region.build(f"{key}.region")
        given = {name: self._of_times(getattr(part, name), f"{key}.{name}") for name in ("value", "velocity", "rate")}
        try:
            return fh.Prescribed(where, until=part.until, **given)
        except InputError as error:
            raise error.at(under(key, error.key)) from None

    def _crack(self, part: CrackPart) -> Any:
        cut = self._cut(part, "crack")
        return fh.Crack(cut, part.factor, part.opens) if part.factor or part.opens else cut

    def _cut(self, part: CutPart, key: str) -> Any:
        given = [p for p in (part.points, part.rectangle, part.disc) if p is not None]
        if len(given) != 1:
            raise InputError("give exactly one of points, rectangle, disc", key=key)
        if part.points is not None:
            return part.points
        given_as: Any = given[0]
        cls: Any = fh.DiscCut if part.rectangle is None else fh.Rectangle
        try:
            return cls(**given_as)
        except TypeError:
            raise InputError(
                "a rectangle needs corner, edge1 and edge2; a disc needs centre, normal and radius", key=key
            ) from None

    def _constraint(self, part: ConstraintPart | PrescribedPart, key: str) -> Any:
        return self._prescribed(part, key) if isinstance(part, PrescribedPart) else self._condition(part, key)

    def _condition(self, part: ConstraintPart, key: str) -> Any:
        if (part.side is None) == (part.region is None):
            raise InputError("give either a side or a region", key=key)
        make = CONDITIONS[part.type]
        # "value" is what each is given, whatever the class calls it
        names = {"value" if one.name == "ambient" else one.name: one.name for one in fields(make)}
        options: dict[str, Any] = {}
        for name in ("value", "kind", "transfer"):
            value = getattr(part, name)
            if value is not None and name not in names:
                raise InputError(
                    f"a condition of type {part.type} has no such key",
                    value=value,
                    limit=", ".join(sorted(names.keys() - {"where", "within"})),
                    key=f"{key}.{name}",
                )
            if value is None and name in names and name != "kind":
                raise InputError(f"a condition of type {part.type} needs it", key=f"{key}.{name}")
            if value is not None:
                options[names[name]] = self._expression(value, f"{key}.{name}") if name == "value" else value
        if part.within is not None:
            options["within"] = part.within.build(f"{key}.within")
        where: Any = part.side if part.region is None else part.region.build(f"{key}.region")
        try:
            return make(where, **options)
        except InputError as error:
            raise error.at(under(key, error.key)) from None

    def _check_times(self) -> None:
        out, run = self.parts.output, self.parts.run
        checked_topology(run.topology)
        if run.until == STATIC and run.limit is None:
            raise InputError(
                "a run to the static state has a latest end, for which its layers are chosen",
                key="run.limit",
                remedy="some tens of the time in which the slowest wave crosses the near field",
            )
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
                raise InputError("must be positive", value=value, key=name)
        if self.end > _MOST_OUTPUTS * (out.every or self.end):
            raise InputError(
                "so many outputs cannot be written",
                value=out.every,
                limit=f">= {self.end / _MOST_OUTPUTS:.3g}",
                key="output.every",
                remedy="fewer outputs; probes record every step",
            )

    def _check_output(self) -> None:
        out = self.parts.output
        known = ["u", *["solid", "dissolved"] * self._dissolves, *["v"] * (self.model.order == 2)]
        known += ["damage"] * self._bondwise + ["stress"] * QUANTITIES["stress"].has(self.model)
        known += ["thermal_strain"] * any(isinstance(load, ThermalPart) for load in self.parts.load)
        for name in self.fields:
            if name not in known:
                raise InputError(
                    f"a {self.parts.model.type} has no such field",
                    value=name,
                    limit=", ".join(known),
                    key="output.fields",
                )
        for point in out.probes:
            try:
                self.lattice.index(point)
            except InputError as error:
                raise error.at("output.probes") from None


def _has_readable_units(data: Mapping[str, Any]) -> bool:
    """Whether the units of a case that is not validated yet are a table of known keys and texts, if it has any."""
    given = data.get("units", {})
    known = isinstance(given, dict) and given.keys() <= UnitsPart.model_fields.keys()
    return known and all(isinstance(text, str) for text in given.values())


def _units_of(data: Mapping[str, Any]) -> Units | None:
    model = data.get("model")
    kind = model.get("type") if isinstance(model, dict) else None
    return Units(data["units"], FIELDS.get(str(kind), ANY)) if "units" in data else None


def _built(part: Part, known: Mapping[str, Any], key: str, **changes: Any) -> Any:
    """What a table stands for that has a type and the fields of a dataclass, some of them changed."""
    given = dict(part)
    values = {name: given[name] for name in part.model_fields_set - {"type"}} | changes
    try:
        return known[given["type"]](**values)
    except InputError as error:
        raise error.at(under(key, error.key)) from None


def _called(part: Any) -> str:
    """What a table calls its material; "" where it says nothing."""
    return getattr(part, "name", None) or getattr(part, "of", None) or ""


def _far_field(part: FarFieldPart) -> fh.FarField:
    """A new far field, which belongs to one run; its history is kept for receivers alone."""
    options = part.model_dump(include={"frequencies", "points", "directions"})
    return fh.FarField(_box(part.box), **options, history=part.points is not None or not part.frequencies)


def _surface(part: PowerPart, key: str) -> Any:
    """The region, or the plane, through which power is recorded."""
    if part.region is not None and part.axis is None and part.position is None:
        return part.region.build(f"{key}.region")
    if part.region is not None or part.axis is None or part.position is None:
        raise InputError(
            "give either a region, or axis and position",
            value=", ".join(name for name in ("region", "axis", "position") if getattr(part, name) is not None)
            or "none",
            limit="one surface",
            key=key,
            remedy='axis = "x" and position = 2.0, or region = { ... }',
        )
    return part.axis, part.position


def _box(part: BoxPart | None) -> fh.Box | None:
    """A box that may be left out."""
    return None if part is None else fh.Box(part.lower, part.upper)


def _where(part: ReceiversPart | SpectraPart, key: str) -> Any:
    """The points, or the region, of a recorder."""
    region, plane = (part.region, (part.axis, part.position)) if isinstance(part, SpectraPart) else (None, (None, None))
    given = {"points": part.points, "line": part.line, "grid": part.grid, "region": region, "axis": plane[0]}
    if sum(place is not None for place in given.values()) != 1 or (plane[0] is None) != (plane[1] is None):
        known = [name if name != "axis" else "axis and position" for name in given if name in type(part).model_fields]
        several = ", ".join(name for name, place in given.items() if place is not None)
        raise InputError(
            f"give exactly one of {', '.join(known)}",
            value=several or "none",
            limit="1",
            key=key,
            remedy="leave the others out" if several else f"{known[0]} = ...",
        )
    if plane[0] is not None:
        return plane
    if part.line is not None:
        return points_on_line(**part.line.model_dump())
    if part.grid is not None:
        return points_on_grid(**part.grid.model_dump())
    return part.points if region is None else region.build(f"{key}.region")


def read_case(path: str | Path, changes: Mapping[str, Any] | None = None) -> Case:
    """Read and check a case file.

    Parameters
    ----------
    path : str or Path
    changes : mapping of str to values, optional
        What stands at dotted keys in place of what the file has.

    Returns
    -------
    Case
        ``simulation()`` makes a new simulation of it, and takes changes of arguments. ``setup``, ``lattice`` and
        ``name`` tell what it is.

    Raises
    ------
    InputError
        Anything wrong, with file, key, value, limit and remedy.

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
