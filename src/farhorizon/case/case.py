"""Case files: TOML with the words of the Python interface, validated before any work."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator

from farhorizon import __version__
from farhorizon import public as fh
from farhorizon.boundaries.lattice_pml import BY_TARGET
from farhorizon.errors import FileFormatError, InputError
from farhorizon.geometry.lattice import AXES
from farhorizon.geometry.shapes import Shape
from farhorizon.inputs.expressions import as_given, as_signal
from farhorizon.simulation.run import Run
from farhorizon.simulation.steps import WholeSteps, whole_steps


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=False)


_OUTPUTS = 40  # of a run, unless `every` is given

_MOST_OUTPUTS = 1e6  # each takes milliseconds
Number = Annotated[float, Field(allow_inf_nan=False)]
Value = str | Number | list[str | Number]  # an expression or a number, of vectors one a component


class DiscPart(_Part):
    radius: Number
    centre: list[Number] | None = None


class BoxPart(_Part):
    lower: list[Number]
    upper: list[Number]


class PolygonPart(_Part):
    points: list[list[Number]]


class TextPart(_Part):
    text: str
    height: Number
    centre: list[Number] | None = None
    font: str = "DejaVu Sans"
    bold: bool = False


class ImagePart(_Part):
    file: str
    width: Number
    centre: list[Number] | None = None
    threshold: Number = 0.5

    @field_validator("file")
    @classmethod
    def _beside_the_case(cls, name: str, info: ValidationInfo) -> str:
        return str((info.context or {}).get("folder", Path()) / name)


class RegionPart(_Part):
    """One shape, with shapes taken out of it."""

    disc: DiscPart | None = None
    ball: DiscPart | None = None
    box: BoxPart | None = None
    polygon: PolygonPart | None = None
    text: TextPart | None = None
    image: ImagePart | None = None
    without: list[RegionPart] = []

    def build(self, key: str) -> Shape:
        """The shape itself; InputError names the key."""
        try:
            return self._shape(key)
        except InputError as error:
            raise error.at(_under(key, error.key)) from None

    def _shape(self, key: str) -> Shape:
        shapes: list[Shape] = []
        for kind, part in ((fh.Disc, self.disc), (fh.Ball, self.ball)):
            if part is not None:
                shapes.append(kind(part.radius, part.centre))
        if self.box is not None:
            shapes.append(fh.Box(self.box.lower, self.box.upper))
        if self.polygon is not None:
            shapes.append(fh.Polygon(self.polygon.points))
        if self.text is not None:
            shapes.append(fh.Text(**self.text.model_dump()))
        if self.image is not None:
            shapes.append(fh.ImageMask(self.image.file, self.image.width, self.image.centre, self.image.threshold))
        if len(shapes) != 1:
            raise InputError("give exactly one of disc, ball, box, polygon, text, image", key=key)
        region = shapes[0]
        for hole in self.without:
            region = region - hole.build(key + ".without")
        return region


class LatticePart(_Part):
    spacing: Number
    lower: list[Number] | None = None
    upper: list[Number] | None = None
    window: RegionPart | None = None
    body: RegionPart | None = None


class KernelPart(_Part):
    horizon: Number
    exponent: int = 2
    influence: str = "constant"
    width: Number | None = None
    volume: str = "ramp"
    calibrate: bool = True


class WavePart(_Part):
    type: Literal["wave"]
    speed: Number = 1.0
    damping: Number = 0.0
    kernel: KernelPart | None = None
    stencil: Literal["finite-difference", "finite-element"] | None = None


class BeamPart(_Part):
    type: Literal["beam"]
    stiffness: Number = 1.0
    damping: Number = 0.0


class DiffusionPart(_Part):
    type: Literal["diffusion"]
    diffusivity: Number = 1.0
    integrator: str = "euler"
    kernel: KernelPart | None = None
    stencil: Literal["finite-difference", "finite-element"] | None = None


class HeatPart(_Part):
    type: Literal["heat"]
    density: Number = 1.0
    specific_heat: Number = 1.0
    conductivity: Number = 1.0
    integrator: str = "euler"
    stages: int | None = None
    self_term: str = "centre"
    kernel: KernelPart | None = None
    stencil: Literal["finite-difference", "finite-element"] | None = None


class CorrosionPart(_Part):
    type: Literal["corrosion"]
    diffusivity: Number = 1.0
    saturation: Number
    interface: Number = 0.1
    limited: bool = False
    integrator: str = "euler"
    kernel: KernelPart | None = None
    stencil: Literal["finite-difference", "finite-element"] | None = None


class ElasticPart(_Part):
    type: Literal["elastic"]
    young: Number | None = None
    poisson: Number | None = None
    bulk: Number | None = None
    shear: Number | None = None
    density: Number = 1.0
    material: str = "bond-based"
    plane: str | None = None
    damping: Number = 0.0
    stabilisation: Number = 0.0
    nonlinear: bool = False
    critical_stretch: Number | None = None
    fracture_energy: Number | None = None
    kernel: KernelPart | None = None


class BodyPart(_Part):
    """`fh.Body`: correspondence elasticity with damage."""

    type: Literal["correspondence"]
    young: str | Number
    poisson: str | Number
    density: str | Number = 1.0
    plane: str = "strain"
    critical_stretch: Number | None = None
    shape_tensor: str = "recomputed"
    drag: Number = 0.0
    stabilisation: Number = 0.0
    kernel: KernelPart


class MaterialPart(_Part):
    """Constants of a body in a region, in place of the model's."""

    region: RegionPart
    young: str | Number | None = None
    poisson: str | Number | None = None
    density: str | Number | None = None


class LatticePMLPart(_Part):
    type: Literal["lattice-pml"]
    until: Number | None = None
    target: Number | None = None
    nodes: int | None = None
    profile: dict[str, Number | list[Number]] | None = None


class ExtendedPart(_Part):
    type: Literal["extended"]
    until: Number | None = None
    target: Number | None = None
    nodes: int | None = None


class AutoPart(_Part):
    type: Literal["auto"]
    until: Number | None = None
    target: Number | None = None


class ExactPart(_Part):
    type: Literal["exact"]
    compress: Literal[False] | Number = 1e-12


class FixedPart(_Part):
    type: Literal["fixed"]
    value: Number = 0.0


class FreePart(_Part):
    type: Literal["free"]


class PeriodicPart(_Part):
    type: Literal["periodic"]


class SpongePart(_Part):
    type: Literal["sponge"]
    nodes: int = 40
    strength: Number | None = None


class NonlocalPMLPart(_Part):
    type: Literal["nonlocal-pml"]
    nodes: int = 30
    ramp: str = "cubic"
    strength: Number | None = None
    reflection: Number = 1e-3
    plateau: Number = 1 / 3
    form: str = "displacement"
    cross: Number = 0.0
    shift: Number = 0.0


class PlaneWavePart(_Part):
    type: Literal["plane-wave"]
    fit: str | None = None
    dispersion: str | None = None
    time: str | None = None
    layer: Number | None = None
    radius: Number | None = None
    cone: Number | None = None
    thin: int | None = None
    normals: str | None = None
    angle: Number | None = None
    angles: int = 11
    wavenumber: Number | None = None
    wavenumbers: int | None = None
    smallest: Number | None = None
    regularization: Number | None = None
    rcond: Number = 1e-15
    balanced: bool = True


class HigdonPart(_Part):
    type: Literal["higdon"]
    angles: list[Number] = [0.0, 45.0]
    shift: Number | None = None


class FirstOrderPart(_Part):
    type: Literal["first-order"]


AnyBoundary = (
    LatticePMLPart
    | ExtendedPart
    | AutoPart
    | ExactPart
    | FixedPart
    | FreePart
    | PeriodicPart
    | SpongePart
    | NonlocalPMLPart
    | PlaneWavePart
    | HigdonPart
    | FirstOrderPart
)
BoundaryPart = Annotated[AnyBoundary, Field(discriminator="type")]
_BOUNDARIES = {
    "lattice-pml": fh.LatticePML,
    "extended": fh.Extended,
    "auto": fh.Auto,
    "exact": fh.Exact,
    "fixed": fh.Fixed,
    "free": fh.Free,
    "periodic": fh.Periodic,
    "sponge": fh.Sponge,
    "nonlocal-pml": fh.NonlocalPML,
    "plane-wave": fh.PlaneWave,
    "higdon": fh.Higdon,
    "first-order": fh.FirstOrder,
}


class CrackPart(_Part):
    points: list[list[Number]] | None = None
    rectangle: dict[Literal["corner", "edge1", "edge2"], list[Number]] | None = None
    disc: dict[Literal["centre", "normal", "radius"], list[Number] | Number] | None = None
    factor: Number = 0.0
    opens: Number = 0.0


class ConstraintPart(_Part):
    """A condition on a side, or in a region."""

    type: Literal["temperature", "flux", "insulated", "convection"]
    side: str | None = None
    region: RegionPart | None = None
    value: str | Number | None = None
    kind: str | None = None
    transfer: Number | None = None
    within: RegionPart | None = None


class SpecimenPart(_Part):
    region: RegionPart
    concentration: Number = 1.0


class SourcePart(_Part):
    field: Literal["u"] = "u"
    value: Value


class IncidentPart(_Part):
    """A plane wave that comes from far away."""

    direction: list[Number]
    signal: str
    duration: Number
    polarisation: Literal["P", "S"] | list[Number] = "P"
    within: BoxPart | None = None


class TractionPart(_Part):
    """A force per area on a free side of an elastic medium."""

    type: Literal["traction"]
    side: str
    value: list[Number]
    between: list[tuple[Number, Number]] | None = None
    time: str | Number = 1.0


class BodyForcePart(_Part):
    """A force per volume on an elastic medium."""

    type: Literal["body-force"]
    value: list[str | Number]
    time: str | Number = 1.0


class PrescribedPart(_Part):
    """Nodes that follow a value for a while."""

    type: Literal["prescribed"]
    points: list[list[Number]] | None = None
    region: RegionPart | None = None
    value: str | Number
    until: Number | None = None
    rate: str | Number | None = None


class RunPart(_Part):
    until: Number
    dt: Number | None = None
    dtype: str = "float64"
    threads: int | None = None


class OutputPart(_Part):
    fields: list[Literal["u", "v", "damage", "solid", "dissolved"]] | None = None
    every: Number | None = None
    probes: list[list[Number]] = []
    probe_every: Number | None = None
    pictures: list[Number] | None = None
    balance: bool = False


AnyModel = WavePart | DiffusionPart | HeatPart | CorrosionPart | BeamPart | ElasticPart | BodyPart
AnyLoad = TractionPart | BodyForcePart
AnyConstraint = ConstraintPart | PrescribedPart


class CasePart(_Part):
    lattice: LatticePart
    model: Annotated[AnyModel, Field(discriminator="type")]
    material: list[MaterialPart] = []
    initial: dict[Literal["u", "v"], Value] = {}
    boundary: dict[str, BoundaryPart] = {}
    specimen: list[SpecimenPart] = []
    crack: list[CrackPart] = []
    source: list[SourcePart] = []
    incident: list[IncidentPart] = []
    load: list[Annotated[AnyLoad, Field(discriminator="type")]] = []
    constraint: list[Annotated[AnyConstraint, Field(discriminator="type")]] = []
    coefficient: str | Number | None = None
    rule: str = "both"
    rim: str = "free"
    background: Number = 0.0
    run: RunPart
    output: OutputPart = OutputPart()


def schema() -> dict[str, Any]:
    """JSON Schema of case files: keys, kinds of values and defaults; what else must hold is told when a case is
    read."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **CasePart.model_json_schema(),
        "title": "farhorizon case",
        "description": f"A case file of farhorizon {__version__}.",
    }


class Case:
    """A validated case file.

    Parameters
    ----------
    text : str
        TOML.
    path : Path or str
        Named in messages; its stem names the results.

    Raises
    ------
    InputError
        Anything wrong, with file, key, value, limit and remedy.
    """

    def __init__(self, text: str, path: str | Path = "case.toml") -> None:
        self.text, self.path = text, Path(path)
        try:
            data = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # of numbers and of nesting beyond what Python takes, too
            raise InputError(f"{self.path}: not valid TOML: {error}") from None
        try:
            self.parts = CasePart.model_validate(data, context={"folder": self.path.parent})
        except ValidationError as error:
            raise InputError(f"{self.path}: " + _explain(error, data)) from None
        with self.naming():
            self._check_times()
            self.lattice = self._lattice()
            if isinstance(self.parts.model, BodyPart):
                self.kind: type[Run] = fh.Body
                self.vector = True
                self.setup = self._body_setup(self.parts.model)
            else:
                self.kind = fh.Simulation
                self.model = self._model(self.parts.model)
                self.vector = isinstance(self.model, fh.Elastic)
                self.setup = self._setup()
            self._check_output()

    @classmethod
    def read(cls, path: str | Path) -> Case:
        """Read a case file."""
        try:
            text = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot read the case file {path}: {error.strerror}", remedy="check the path") from None
        except UnicodeDecodeError:
            raise FileFormatError(f"{path} is not a text file", remedy="a case file is TOML") from None
        return cls(text, path)

    @property
    def name(self) -> str:
        """Name of the results: the file's stem."""
        return self.path.stem

    def every(self, dt: float) -> float:
        """Time between two outputs with a time step; a fortieth of the run, or the number of steps next to it, unless
        given.
        """
        if self.parts.output.every is not None:
            return self.parts.output.every
        return dt * max(1, round(self.parts.run.until / _OUTPUTS / dt))

    @property
    def _asked(self) -> WholeSteps:
        """What is to be a whole number of steps."""
        out, until = self.parts.output, self.parts.run.until
        asked = {"output.every": out.every, "output.probe_every": out.probe_every, "run.until": until}
        return WholeSteps(**{name: interval for name, interval in asked.items() if interval is not None})

    def _step(self, default: float) -> float:
        """The time step in place of the default one: it divides what is asked for, and a fortieth of the run if that
        comes for free.
        """
        between = self.parts.run.until / _OUTPUTS
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
        return self.kind is fh.Simulation and isinstance(self.model, fh.Elastic) and self.model.bondwise

    @property
    def fields(self) -> tuple[str, ...]:
        """What is written: u unless given, of a corrosion the times of dissolution too, of what breaks the damage."""
        more = {"corrosion": ["dissolved"], "correspondence": ["damage"]}.get(
            self.parts.model.type, ["damage"] if self._bondwise else []
        )
        default = ["u", *more]
        return tuple(default if self.parts.output.fields is None else self.parts.output.fields)

    def run(self, **changes: Any) -> Run:
        """A new run of the case: a `Simulation` or a `Body`."""
        with self.naming():
            made = self.kind(**{**self.setup, **changes})
            self._asked.check(made.dt, "run.dt")
            return made

    def simulation(self, **changes: Any) -> fh.Simulation:
        """A new simulation of the case.

        Raises
        ------
        InputError
            The case is a body.
        """
        self.must_be_simulation()
        made = self.run(**changes)
        assert isinstance(made, fh.Simulation)
        return made

    def must_be_simulation(self) -> None:
        """Refuse a body where only a `Simulation` serves."""
        if self.kind is not fh.Simulation:
            raise InputError(
                "a body is run, checked, compared and drawn, but nothing of it is tuned",
                value=self.parts.model.type,
                key="model.type",
                remedy='type = "elastic", material = "correspondence"',
            )

    @contextmanager
    def naming(self) -> Iterator[None]:
        """Within it an InputError names the case file."""
        try:
            yield
        except InputError as error:
            raise type(error)(f"{self.path}: {error}") from None

    def _lattice(self) -> fh.Lattice:
        part = self.parts.lattice
        window = part.window.build("lattice.window") if part.window else None
        body = part.body.build("lattice.body") if part.body else None
        return fh.Lattice(part.spacing, part.lower, part.upper, window=window, body=body)

    def _model(self, part: Any) -> fh.Wave | fh.Diffusion | fh.Heat | fh.Corrosion | fh.Beam | fh.Elastic:
        if isinstance(part, BeamPart):
            return fh.Beam(part.stiffness, part.damping)
        if isinstance(part, ElasticPart):
            kernel = None if part.kernel is None else fh.Kernel(**part.kernel.model_dump())
            return fh.Elastic(kernel, **part.model_dump(exclude={"type", "kernel"}))
        if (part.kernel is None) == (part.stencil is None):
            raise InputError("give either [model.kernel] or stencil", key="model")
        operator: fh.Kernel | fh.Stencil
        if part.kernel is not None:
            operator = fh.Kernel(**part.kernel.model_dump())
        else:
            make = fh.Stencil.finite_difference if part.stencil == "finite-difference" else fh.Stencil.finite_element
            operator = make(self.lattice.dim)
        if isinstance(part, WavePart):
            return fh.Wave(operator, part.speed, part.damping)
        if isinstance(part, DiffusionPart):
            return fh.Diffusion(operator, part.diffusivity, part.integrator)
        if isinstance(part, CorrosionPart):
            options = part.model_dump(include={"saturation", "interface", "limited", "integrator"})
            return fh.Corrosion(operator, part.diffusivity, **options)
        if part.stages is not None and part.integrator != "rkc":
            raise InputError(
                "only Runge-Kutta-Chebyshev has stages to choose",
                value=part.integrator,
                limit="rkc",
                key="model.stages",
            )
        integrator = part.integrator if part.stages is None else fh.RungeKuttaChebyshev(part.stages)
        return fh.Heat(operator, part.density, part.specific_heat, part.conductivity, integrator, part.self_term)

    def _expression(self, value: str | float | list[str | float], key: str) -> Any:
        if isinstance(value, list):
            if not self.vector or len(value) != self.lattice.dim:
                limit = f"a list of {self.lattice.dim}" if self.vector else "one"
                raise InputError("not as many entries as the field has components", value=value, limit=limit, key=key)
            return [self._entry(part, f"{key}[{i}]") for i, part in enumerate(value)]
        return self._entry(value, key)

    @staticmethod
    def _of_time(value: str | float, key: str) -> fh.Expression:
        """A function of t alone."""
        return as_signal(value, key)

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
        for side, part in self.parts.boundary.items():
            values = part.model_dump(exclude={"type"}, exclude_none=True)
            if isinstance(part, LatticePMLPart | ExtendedPart | AutoPart):
                values.setdefault("until", self.parts.run.until)
            try:
                boundary[side] = _BOUNDARIES[part.type](**values)
            except InputError as error:
                raise error.at(_under(f"boundary.{side}", error.key)) from None
        allowed = ["all"] + [AXES[a] + s for a in range(self.lattice.dim) for s in ("", "-", "+")]
        for side in boundary:
            if side not in allowed:
                raise InputError(
                    "unknown side", value=side, limit=", ".join(allowed), key="boundary", remedy=_nearest(side, allowed)
                )
        return boundary

    def _setup(self) -> dict[str, Any]:
        parts = self.parts
        if parts.load and not self.vector:
            raise InputError(
                "loads act on an elastic medium",
                value=parts.model.type,
                key="load",
                limit="elastic, correspondence",
                remedy="[[source]]",
            )
        if parts.material:
            raise InputError(
                "a body has materials by region",
                value=parts.model.type,
                key="material",
                limit="correspondence",
                remedy="coefficient",
            )
        coefficient = None
        if parts.coefficient is not None:
            expression = self._expression(parts.coefficient, "coefficient")
            coefficient = np.broadcast_to(
                expression(*self.lattice.coordinates()) if callable(expression) else expression, self.lattice.shape
            )
        return {
            "lattice": self.lattice,
            "model": self.model,
            "initial": self._initial(),
            "boundary": self._boundary() or fh.LatticePML(until=parts.run.until),
            "sources": [self._expression(s.value, "source.value") for s in parts.source]
            + [self._incident(w) for w in parts.incident],
            "specimens": [
                fh.Specimen(s.region.build(f"specimen[{i}].region"), s.concentration)
                for i, s in enumerate(parts.specimen)
            ],
            "cracks": [self._crack(c) for c in parts.crack],
            "constraints": [self._constraint(c, f"constraint[{i}]") for i, c in enumerate(parts.constraint)],
            "coefficient": coefficient,
            "rule": parts.rule,
            "rim": parts.rim,
            "background": parts.background,
            "loads": [self._load(load, f"load[{i}]") for i, load in enumerate(parts.load)],
            "balance": parts.output.balance,
            "dt": self._given_step,
            "dtype": parts.run.dtype,
            "threads": parts.run.threads,
        }

    def _incident(self, part: IncidentPart) -> fh.IncidentWave:
        signal = self._of_time(part.signal, "incident.signal")
        within = None if part.within is None else fh.Box(part.within.lower, part.within.upper)
        return fh.IncidentWave(part.direction, signal, part.duration, part.polarisation, within)

    def _body_setup(self, model: BodyPart) -> dict[str, Any]:
        parts = self.parts
        for name in ("specimen", "source", "incident", "constraint", "coefficient", "rule", "rim", "background"):
            if name in parts.model_fields_set:
                raise InputError(
                    "a body has no such key",
                    key=name,
                    remedy="forces on a body are [[load]]s" if name == "source" else "leave it out",
                )
        if parts.run.dtype != "float64":
            raise InputError(
                "a body computes in double precision", value=parts.run.dtype, limit="float64", key="run.dtype"
            )
        if any(c.factor or c.opens for c in parts.crack):
            raise InputError(
                "cracks of a body are there from the start and carry nothing",
                key="crack",
                remedy="leave factor and opens out",
            )
        return {
            "lattice": self.lattice,
            "operator": fh.Kernel(**model.kernel.model_dump()),
            **model.model_dump(exclude={"type", "kernel"}),
            **{name: self._constant(name, getattr(model, name)) for name in ("young", "poisson", "density")},
            "boundary": self._boundary() or fh.Fixed(),
            "initial": self._initial(),
            "cracks": [self._crack(c) for c in parts.crack],
            "loads": [self._load(load, f"load[{i}]") for i, load in enumerate(parts.load)],
            "balance": parts.output.balance,
            "dt": self._given_step,
            "threads": parts.run.threads,
        }

    def _constant(self, name: str, value: str | float) -> Any:
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

    def _steady(self, value: str | float, key: str) -> Any:
        """An expression of the coordinates alone, or a number."""
        entry = self._entry(value, key)
        if isinstance(entry, fh.Expression) and entry.uses_time:
            raise InputError("a material cannot depend on t", value=value, key=key)
        return entry

    def _load(self, part: TractionPart | BodyForcePart, key: str) -> fh.Traction | fh.BodyForce:
        factor = self._of_time(part.time, f"{key}.time")
        if isinstance(part, TractionPart):
            return fh.Traction(part.side, part.value, part.between, factor)
        return fh.BodyForce(self._expression(part.value, f"{key}.value"), factor)

    def _prescribed(self, part: PrescribedPart, key: str) -> fh.Prescribed:
        if (part.points is None) == (part.region is None):
            raise InputError("give either points or region", key=key)
        where = part.points if part.region is None else part.region.build(f"{key}.region")
        rate = None if part.rate is None else self._expression(part.rate, f"{key}.rate")
        return fh.Prescribed(where, self._expression(part.value, f"{key}.value"), part.until, rate)

    def _crack(self, part: CrackPart) -> Any:
        given = [p for p in (part.points, part.rectangle, part.disc) if p is not None]
        if len(given) != 1:
            raise InputError("give exactly one of points, rectangle, disc", key="crack")
        cut: Any = part.points
        try:
            if part.points is None:
                given_as, cls = (part.disc, fh.DiscCut) if part.rectangle is None else (part.rectangle, fh.Rectangle)
                cut = cls(**given_as)  # type: ignore[arg-type]
        except TypeError:
            raise InputError(
                "a rectangle needs corner, edge1 and edge2; a disc needs centre, normal and radius", key="crack"
            ) from None
        return fh.Crack(cut, part.factor, part.opens) if part.factor or part.opens else cut

    def _constraint(self, part: ConstraintPart | PrescribedPart, key: str) -> Any:
        return self._prescribed(part, key) if isinstance(part, PrescribedPart) else self._condition(part, key)

    def _condition(self, part: ConstraintPart, key: str) -> Any:
        if (part.side is None) == (part.region is None):
            raise InputError("give either a side or a region", key=key)
        options: dict[str, Any] = {}
        takes = {
            "temperature": {"value", "kind"},
            "flux": {"value", "kind"},
            "insulated": {"kind"},
            "convection": {"value", "transfer"},
        }[part.type]
        for name in ("value", "kind", "transfer"):
            value = getattr(part, name)
            if value is not None and name not in takes:
                raise InputError(
                    f"a condition of type {part.type} has no such key",
                    value=value,
                    limit=", ".join(sorted(takes)),
                    key=f"{key}.{name}",
                )
            if value is None and name in takes and name != "kind":
                raise InputError(f"a condition of type {part.type} needs it", key=f"{key}.{name}")
            if value is not None:
                options[name] = self._expression(value, f"{key}.{name}") if name == "value" else value
        if part.type == "convection":
            options["ambient"] = options.pop("value")
        if part.within is not None:
            options["within"] = part.within.build(f"{key}.within")
        where: Any = part.side if part.region is None else part.region.build(f"{key}.region")
        make = {"temperature": fh.Temperature, "flux": fh.Flux, "insulated": fh.Insulated, "convection": fh.Convection}[
            part.type
        ]
        try:
            return make(where, **options)
        except InputError as error:
            raise error.at(_under(key, error.key)) from None

    def _check_times(self) -> None:
        out = self.parts.output
        for name, value in (
            ("output.every", out.every),
            ("output.probe_every", out.probe_every),
            ("run.until", self.parts.run.until),
        ):
            if value is not None and value <= 0:
                raise InputError("must be positive", value=value, key=name)
        if self.parts.run.until > _MOST_OUTPUTS * (out.every or self.parts.run.until):
            raise InputError(
                "so many outputs cannot be written",
                value=out.every,
                limit=f">= {self.parts.run.until / _MOST_OUTPUTS:.3g}",
                key="output.every",
                remedy="fewer outputs; probes record every step",
            )

    def _check_output(self) -> None:
        out = self.parts.output
        known = {"correspondence": ["u", "v", "damage"], "corrosion": ["u", "solid", "dissolved"]}.get(
            self.parts.model.type, ["u"]
        )
        if self.kind is fh.Simulation and self.model.order == 2:
            known = [*known, "v", *(["damage"] if self._bondwise else [])]
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


def _under(place: str, key: str) -> str:
    """The key that an error has in Python, at its place in the case: the last part of it, unless it has the place
    already.
    """
    if not key:
        return place
    return key if key.startswith(place) else f"{place}.{key.rpartition('.')[2]}"


def _nearest(word: str, words: list[str]) -> str:
    near = difflib.get_close_matches(word, words, 1, 0.6)
    return (f"did you mean {near[0]!r}? " if near else "") + f"known: {', '.join(words)}"


_PARTS: dict[str, type[_Part]] = {
    "lattice": LatticePart,
    "window": RegionPart,
    "body": RegionPart,
    "without": RegionPart,
    "region": RegionPart,
    "within": RegionPart,
    "box": BoxPart,
    "ball": DiscPart,
    "polygon": PolygonPart,
    "text": TextPart,
    "image": ImagePart,
    "wave": WavePart,
    "beam": BeamPart,
    "diffusion": DiffusionPart,
    "heat": HeatPart,
    "corrosion": CorrosionPart,
    "elastic": ElasticPart,
    "correspondence": BodyPart,
    "material": MaterialPart,
    "load": TractionPart,
    "traction": TractionPart,
    "body-force": BodyForcePart,
    "nonlocal-pml": NonlocalPMLPart,
    "specimen": SpecimenPart,
    "kernel": KernelPart,
    "lattice-pml": LatticePMLPart,
    "extended": ExtendedPart,
    "auto": AutoPart,
    "exact": ExactPart,
    "fixed": FixedPart,
    "free": FreePart,
    "periodic": PeriodicPart,
    "sponge": SpongePart,
    "plane-wave": PlaneWavePart,
    "higdon": HigdonPart,
    "first-order": FirstOrderPart,
    "crack": CrackPart,
    "source": SourcePart,
    "incident": IncidentPart,
    "constraint": ConstraintPart,
    "temperature": ConstraintPart,
    "flux": ConstraintPart,
    "insulated": ConstraintPart,
    "convection": ConstraintPart,
    "prescribed": PrescribedPart,
    "run": RunPart,
    "output": OutputPart,
}


def _known(location: tuple[Any, ...]) -> list[str]:
    """Keys allowed at a place of the schema, following the data's own path."""
    parts: type[_Part] = CasePart
    for step in location:
        if step == "disc" and parts is RegionPart:
            parts = DiscPart
        elif step in _PARTS:
            parts = _PARTS[step]
    return list(parts.model_fields)


# What pydantic wants, in words, by the types of its errors.
_WANTED = {
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
}


def _types(table: str) -> list[str]:
    """The types that a table of the case may have."""
    union = {"model": AnyModel, "boundary": AnyBoundary, "load": AnyLoad, "constraint": AnyConstraint}[table]
    return [name for part in get_args(union) for name in get_args(part.model_fields["type"].annotation)]


def _explain(error: ValidationError, data: dict[str, Any]) -> str:
    """The first problems in one line: key, value, what is wrong, the nearest known key."""
    # a misspelt key is why another is missing
    problems = sorted(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    by_key: dict[str, list[Any]] = {}
    for problem in problems:
        by_key.setdefault(_key(data, tuple(problem["loc"]), problem["type"] == "missing"), []).append(problem)
    return " | ".join(_problem(key, same) for key, same in list(by_key.items())[:3])


def _key(data: Any, location: tuple[Any, ...], missing: bool) -> str:
    """The path of a problem as it stands in the case: pydantic's has names of types in between, which are nowhere in
    the data.
    """
    found = ""
    for number, step in enumerate(location):
        if isinstance(data, list) and isinstance(step, int) and step < len(data):
            found, data = f"{found}[{step}]", data[step]
        elif isinstance(data, dict) and (step in data or (missing and number == len(location) - 1)):
            found, data = f"{found}.{step}".lstrip("."), data.get(step)
    return found


def _problem(key: str, same: list[Any]) -> str:
    """What is wrong with one key; of what may be of several types there is a problem each."""
    first = same[0]
    location, context = tuple(first["loc"]), first.get("ctx", {})
    match first["type"]:
        case "extra_forbidden" if "lattice-pml" in location and location[-1] in ("angle", "wavelengths"):
            return str(
                InputError("layers are no longer chosen by angle", key=key, remedy=BY_TARGET.replace("=...", " = ..."))
            )
        case "extra_forbidden":
            return f"unknown key {key}; {_nearest(str(location[-1]), _known(location[:-1]))}"
        case "missing":
            return f"missing key {key}"
        case "union_tag_not_found" | "union_tag_invalid":
            types = _types(re.split(r"\W", key)[0])
            message = "unknown type" if "tag" in context else "the type is missing"
            return str(
                InputError(
                    message,
                    value=context.get("tag"),
                    limit=", ".join(types),
                    key=f"{key}.type",
                    remedy=f'type = "{types[0]}"',
                )
            )
    words = [
        _WANTED.get(p["type"], f"one of {p['ctx']['expected']}" if p["type"] == "literal_error" else "") for p in same
    ]
    message = f"must be {' or '.join(dict.fromkeys(words))}" if all(words) else first["msg"]
    value = first["input"]
    return str(InputError(message, value=f"the text {value!r}" if isinstance(value, str) else value, key=key))
