"""The tables of a case file: those of classes and functions are made from their parameters, by `Tables.of`.

A parameter is a key of the same name. Its type, its default and what its annotation states in addition
(`farhorizon.arguments`) determine what the key takes, its docstring is the explanation. So a new class, or a new
parameter of a class, is in case files, in their schema and at the prompt without another line.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from functools import cached_property, lru_cache, reduce
from operator import or_
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeAlias, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Strict,
    Tag,
    ValidationInfo,
    create_model,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import PydanticKnownError

from farhorizon import __version__, kinds
from farhorizon import public as fh
from farhorizon.arguments import (
    FIELD,
    PYTHON_ONLY,
    RATE,
    REQUIRED,
    Function,
    InFile,
    Makes,
    OfRegions,
    OneOf,
    Toml,
    Unit,
)
from farhorizon.boundaries import Side
from farhorizon.case.units import BASES, MASS_BY, QUANTITY, Units, plain
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Shape
from farhorizon.inputs.conditions import Constraint
from farhorizon.inputs.incidence import Incident
from farhorizon.inputs.loads import Load
from farhorizon.inputs.local_sources import LocalSource
from farhorizon.inputs.signals import Signal
from farhorizon.medium.materials import Fluid
from farhorizon.medium.materials import named as named_materials
from farhorizon.models import LatticeModel
from farhorizon.simulation.recorders.recorder import Recorder


class Option(NamedTuple):
    """Keys that together give an argument, the function of which their value is an expression, and what they make."""

    keys: tuple[str, ...]
    function: Function | None = None
    makes: Any = None

    @property
    def name(self) -> str:
        """The keys in words."""
        return " and ".join(self.keys)


class Argument(NamedTuple):
    """How a table gives an argument: by which keys, whether it must, and what it is if it does not."""

    options: tuple[Option, ...]
    needed: bool
    default: dict[str, Any]


class Part(BaseModel):
    """A table. The string below a key is its description in the JSON Schema and at the prompt (`farhorizon keys`).

    `MAKER` is the class or the function whose arguments the keys give, `ARGUMENTS` how, by argument.
    """

    model_config = ConfigDict(extra="forbid", strict=False, use_attribute_docstrings=True)
    MAKER: ClassVar[Any] = None
    ARGUMENTS: ClassVar[Mapping[str, Argument]] = {}

    @model_validator(mode="before")
    @classmethod
    def _in_units_of_the_case(cls, data: Any, info: ValidationInfo) -> Any:
        context = info.context or {}
        if not isinstance(data, dict) or "units" not in context:
            return data
        units, known = context["units"], cls.model_fields
        if "of" in known and isinstance(data.get("of"), str):
            data = _named_constants(data["of"], units, known) | data
        return {
            key: plain(value, unit_of(known[key]) if key in known else None, units, key) for key, value in data.items()
        }

    @classmethod
    def __get_pydantic_json_schema__(cls, core: Any, handler: Any) -> Any:
        schema = handler(core)
        keys = handler.resolve_ref_schema(schema)["properties"]
        for name, key in cls.model_fields.items():
            if (si := unit_of(key)) is not None:
                _take_units(keys[name])
                keys[name]["unit"] = si
        return schema


def unit_of(key: FieldInfo) -> str | None:
    """The SI unit of the values of a key, or `ANY`, `FIELD` or `RATE`; None if it takes no unit."""
    return next((mark.si for mark in key.metadata if isinstance(mark, Unit)), None)


def _take_units(schema: Any) -> None:
    """Allow the numbers of a schema to be strings with a unit, too."""
    if isinstance(schema, dict):
        if schema.get("type") == "number":
            schema |= {"type": ["number", "string"], "pattern": f"^{QUANTITY}$"}
        for name, inner in schema.items():
            if name != "default":
                _take_units(inner)
    elif isinstance(schema, list):
        for inner in schema:
            _take_units(inner)


def _no_truth_value(error: Literal["float_type", "int_type"]) -> BeforeValidator:
    """Refuse true and false, which Python would take for 1 and 0."""

    def check(value: Any) -> Any:
        if isinstance(value, bool):
            raise PydanticKnownError(error)
        return value

    return BeforeValidator(check)


def _beside_the_case(name: str, info: ValidationInfo) -> str:
    return str((info.context or {}).get("folder", Path()) / name)


Number = Annotated[float, _no_truth_value("float_type"), Field(allow_inf_nan=False)]
Whole = Annotated[int, _no_truth_value("int_type")]
Flag = Annotated[bool, Strict()]  # neither "yes" nor 1 passes
FilePath = Annotated[str, AfterValidator(_beside_the_case)]  # relative to the case file
Value = str | Number | list[str | Number]  # an expression or a number; for vectors one per component
Named: TypeAlias = Literal[*named_materials()]  # type: ignore[valid-type]
_TOML = {float: Number, int: Whole, bool: Flag, str: str, np.ndarray: list[Number], Path: FilePath}
_PLAIN = "expression"  # the tag of a function of t that is no signal
_SI = {"young": "Pa", "poisson": "", "speed": "m/s", "density": "kg/m^3"}  # of the constants of named materials


def _named_constants(name: str, units: Units | None, keys: Iterable[str]) -> dict[str, float]:
    """Constants, in the units of the case, of a named material for a table that knows the given keys."""
    material = named_materials().get(name)
    if material is None:
        return {}  # the table refuses the name
    fitting = [name for name, known in named_materials().items() if known.constants.keys() <= set(keys)]
    if name not in fitting:
        fluid, solid = 'type = "wave", whose field is the pressure of a fluid', 'type = "elastic" for a solid'
        raise InputError(
            f"such a model has no {' and no '.join(sorted(material.constants.keys() - set(keys)))}",
            value=name,
            limit=", ".join(fitting) or "none of the named materials",
            key="of",
            remedy=f"one of these, or {fluid if isinstance(material, Fluid) else solid}",
        )
    if units is None:
        raise InputError(
            "the constants of a named material need a case that states its own units",
            value=name,
            key="of",
            remedy='[units] with length = "m", time = "s", mass = "kg"',
        )
    si = _SI | ({"density": "1/Pa"} if isinstance(material, Fluid) else {})  # the compressibility
    return {
        key: units.number(value, si[key], si[key], "of") if si[key] else value
        for key, value in material.constants.items()
    }


def _unit_keys() -> dict[str, Any]:
    """The keys of the table of units."""
    quantities = f"{', '.join([*MASS_BY][:-1])} and {[*MASS_BY][-1]}"
    texts = {name: f'Unit of {name}, such as "{si}".' for name, si in BASES.items()}
    texts["mass"] = f'Unit of mass, such as "kg"; it may follow instead from one of {quantities}.'
    texts |= {name: f'Unit of {name} instead of mass, such as "{si}".' for name, si in MASS_BY.items()}
    return {name: (str | None, Field(None, description=text)) for name, text in texts.items()}


class InitialPart(Part):
    """Values at t = 0, functions of the coordinates."""

    u: Annotated[Value | None, Unit(FIELD)] = None
    """The field."""
    v: Annotated[Value | None, Unit(RATE)] = None
    """For waves: its velocity u_t."""
    T: Annotated[str | Number | None, Unit("K")] = None
    """For a thermoelastic solid: the temperature."""


class RunPart(Part):
    until: Annotated[Number | Literal["static"], Unit("s")]
    """End of the run; "static": when the field has come to rest."""
    tolerance: Number | None = None
    """With until = "static": fraction of their largest value below which velocities must fall; 1e-3 unless given. With
    load_steps: fraction of their size by which displacements may still change; 1e-6 unless given."""
    limit: Annotated[Number | None, Unit("s")] = None
    """With until = "static", where it is required: the latest end, for which layers are chosen."""
    load_steps: Whole | None = None
    """Number of load steps until the end: quasi-static loading of a solid, each step of which ends in equilibrium."""
    dt: Annotated[Number | None, Unit("s")] = None
    """Time step; unless given, at most half of the largest stable one."""
    dtype: str = "float64"
    """Precision of the run: float64, or float32 for half the memory."""
    threads: Whole | None = None
    """Threads of the time loop; all that are available unless given."""
    topology: list[Whole] | None = None
    """Boxes of the lattice along each axis, one per process (mpiexec); those that communicate least unless given."""


class OutputPart(Part):
    fields: list[Literal["u", "v", "T", "damage", "solid", "dissolved", "stress", "thermal_strain"]] | None = None
    """Fields in the results file; unless given, u and, where the model has them, T, dissolved and damage; "stress" of
    elastic media stands for its components and the von Mises stress."""
    every: Annotated[Number | None, Unit("s")] = None
    """Time between two outputs; a fortieth of the run unless given."""
    probes: Annotated[list[list[Number]], Unit("m")] = []
    """Points at whose nearest nodes u is recorded."""
    probe_every: Annotated[Number | None, Unit("s")] = None
    """Time between two records of the probes; every step unless given."""
    dtype: Literal["float32", "float64"] | None = None
    """Precision of the fields in the results file; that of the run unless given."""
    compress: Flag = False
    """Compress the fields in the results file without loss; ParaView can still read them."""
    pictures: Annotated[list[Number] | None, Unit("s")] = None
    """Times of the pictures; four evenly spaced outputs unless given."""
    balance: Flag = False
    """Record energies and work (elastic media), or what has flowed into the near field (diffusion, heat, corrosion)."""


UnitsPart = create_model(
    "UnitsPart",
    __base__=Part,
    __doc__='Units of the plain numbers of the case, which allow other numbers to have units of their own ("5 mm").',
    __cls_kwargs__={"use_attribute_docstrings": False},
    **_unit_keys(),
)


class CasePart(Part):
    """A complete case; `Tables` states the tables of classes, and adds those of recorders."""

    units: Any = None
    """Units of the plain numbers; any consistent units unless given."""
    lattice: Any
    """The near field and its nodes."""
    model: Any
    """The physics: an equation and its constants."""
    material: Any = []
    """Regions of the medium with constants of their own."""
    initial: InitialPart = InitialPart()
    """Values at t = 0, functions of the coordinates: u, for waves also v = u_t, for a thermoelastic solid also T."""
    boundary: Any = {}
    """Conditions on the sides: all, "x", "x-", "x+", ...; a lattice-pml on every side unless given."""
    boundary_T: Any = {}
    """For a thermoelastic solid: conditions for the temperature on sides where they differ from boundary."""
    specimen: Any = []
    """Pieces of metal, for corrosion."""
    crack: Any = []
    """Cracks, which remove or weaken the bonds across them."""
    source: Any = []
    """Terms on the right-hand side of the equation."""
    incident: Any = []
    """Waves that come from outside."""
    load: Any = []
    """Forces on an elastic medium."""
    constraint: Any = []
    """Conditions on nodes: temperature, flux, insulation, convection, prescribed values."""
    coefficient: str | Number | dict[Literal["u", "T"], str | Number] | None = None
    """Factor on the bonds, a function of the coordinates; for a thermoelastic solid by field: under u on the stiffness,
    under T on the conductivity."""
    rule: Annotated[str | None, Field(examples=["harmonic"])] = None
    """How a bond combines the factors or stiffnesses of its ends: both (the smaller one), arithmetic or harmonic."""
    rim: Annotated[str, Field(examples=["fixed"])] = "free"
    """Condition on the surface of a body: free, or fixed at the background."""
    background: Annotated[Number, Unit(FIELD)] = 0.0
    """Uniform state of the infinite medium."""
    run: RunPart
    """End of the run, time step and computing resources."""
    output: OutputPart = OutputPart()
    """Fields, probes and pictures, and when they are recorded."""


class Known(NamedTuple):
    """The classes that a case file can name, user-defined ones included, by family."""

    models: tuple[Any, ...]
    sides: tuple[Any, ...]
    shapes: tuple[Any, ...]
    signals: tuple[Any, ...]
    sources: tuple[Any, ...]
    waves: tuple[Any, ...]
    loads: tuple[Any, ...]
    recorders: tuple[Any, ...]
    laws: tuple[Any, ...]
    constraints: tuple[Any, ...] = (*get_args(Constraint), fh.Prescribed)


#: Bases of the families, and the class of each that is named first.
_FAMILIES: dict[Any, Any] = {
    LatticeModel: fh.Wave,
    Side: fh.LatticePML,
    Shape: fh.Disc,
    Signal: fh.Ricker,
    LocalSource: fh.PointSource,
    Incident: fh.IncidentWave,
    Load: fh.Traction,
    Recorder: fh.Receivers,
    fh.BondLaw: fh.BilinearSoftening,
}
_OTHERS = (LatticeModel, Shape, Recorder)  # classes that need not be dataclasses

#: Keys that give the operator of a model, by the name of the parameter.
_KERNEL = Annotated[fh.Kernel, "The horizon and the weights of the bonds within it."]
_STENCIL = Annotated[
    Literal["finite-difference", "finite-element"], "Stencil of the classical operator, instead of a kernel."
]
_OPERATORS: dict[str, dict[str, Any]] = {
    "operator": {"kernel": _KERNEL, "stencil": _STENCIL},
    "kernel": {"kernel": _KERNEL},
}


def tables() -> Tables:
    """The tables of case files with the classes that are currently registered."""
    return _tables(Known(*(_family(base, first) for base, first in _FAMILIES.items())))


def _family(base: Any, first: Any) -> tuple[Any, ...]:
    """The classes of a family that can be made: one first, the others by name."""
    any_class = base in _OTHERS
    concrete = [maker for maker in base.known.values() if not inspect.isabstract(maker)]
    known = [maker for maker in concrete if any_class or is_dataclass(maker)]
    return tuple(sorted(known, key=lambda maker: (maker is not first, maker.__name__)))


@lru_cache(maxsize=16)
def _tables(known: Known) -> Tables:
    return Tables(known)


def tag_of(maker: Any) -> str:
    """The `type` of a class in a case file."""
    return getattr(maker, "tag", None) or kinds.hyphened(maker.__name__)


def key_of(maker: Any) -> str:
    """The key of a table of a class that is named by its key: of a shape or a recorder."""
    return tag_of(maker).replace("-", "_")


class Tables:
    """The tables of case files for some known classes."""

    def __init__(self, known: Known) -> None:
        self.known = known
        self._made: dict[Any, type[Part]] = {}

    def of(self, maker: Any, typed: bool | None = None) -> type[Part]:
        """The table of a class or a function; it has a `type` unless `typed` is None, which is required if true."""
        if (maker, typed) not in self._made:
            self._made[maker, typed] = _table(maker, *self._keys(maker), typed)
        return self._made[maker, typed]

    def _keys(self, maker: Any) -> tuple[dict[str, Any], dict[str, Argument]]:
        """Keys of a class or a function with their types and fields, and how they give its arguments."""
        texts, units = explained(maker)[1], self._units(maker)
        keys: dict[str, Any] = {}
        arguments: dict[str, Argument] = {}
        for parameter in parameters(maker):
            if PYTHON_ONLY in parameter.marks:
                continue
            name, stated = parameter.name, parameter.mark(InFile)
            default = stated.default if stated else parameter.default
            needed = default is MISSING or default is REQUIRED
            options = []
            for given in _ways(parameter, default, is_model(maker)):
                option, its_keys = self._option(given, texts.get(name, ""), units)
                options.append(option)
                keys |= its_keys
            arguments[name] = Argument(tuple(options), needed, {name: default} if stated and not needed else {})
        if is_model(maker) and "integrator" in keys and not issubclass(maker, fh.Wave | fh.Elastic):
            words = "Number of stages of the integrator rkc; 20 unless given."
            keys["stages"] = (Whole | None, Field(None, description=words))
        if is_model(maker) and issubclass(maker, fh.Wave) and "stencil" in keys:
            words = "Order of accuracy of the finite differences: 2, unless given, 4, 6 or 8."
            keys["order"] = (Whole | None, Field(None, description=words))
        if is_model(maker) and "density" in keys and {"young", "speed"} & keys.keys():
            keys |= _of_material("the medium")
        return keys, arguments

    def _option(self, given: Parameter, text: str, units: Mapping[str, str]) -> tuple[Option, dict[str, Any]]:
        """One way to give an argument, and its keys with their types and fields."""
        name, default = given.name, given.default
        if hasattr(given.hint, "_fields"):  # a named tuple
            inner = self._keys(given.hint)[0].items()
            keys = {key: (takes, Field(None, description=field.description)) for key, (takes, field) in inner}
            return Option(tuple(keys), None, given.hint), keys
        takes = self._takes(given.hint, given.marks, default)
        unit = given.mark(Unit) or (Unit(units[name]) if name in units else None)
        default = list(default) if isinstance(default, tuple) else default  # as TOML writes it
        needed = default is MISSING or default is REQUIRED
        field = Field(... if needed else default, description=given.mark(str) or text)
        return Option((name,), given.mark(Function)), {name: (Annotated[takes, unit] if unit else takes, field)}

    def _units(self, maker: Any) -> dict[str, str]:
        """Units of parameters in all classes of the family of a class that state them; others need not state them."""
        family: Sequence[Any] = next((classes for classes in self.known if maker in classes), ())
        marked = [parameter for member in family for parameter in parameters(member) if parameter.mark(Unit)]
        stated = {(parameter.name, parameter.mark(Unit).si) for parameter in marked}
        names = [name for name, _ in stated]
        return {name: si for name, si in stated if names.count(name) == 1}

    def _takes(self, hint: Any, marks: Sequence[Any], default: Any) -> Any:
        """What a key takes: TOML has no None, so that the key is omitted, or false where None is not the default. A
        type without a counterpart in TOML is checked by the class itself.
        """
        options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        stated = [takes for mark in marks if (takes := self._stated(mark)) is not None]
        types = stated[:1] or [takes for option in options if (takes := self._of_toml(option)) is not None]
        if types and NoneType in options and default is not REQUIRED:
            types.append(None if default is None else Literal[False])
        return reduce(or_, types) if types else Any

    def _stated(self, mark: Any) -> Any:
        """What a key takes by one of the annotations of its parameter; None if it does not say."""
        match mark:
            case Toml():
                return self._takes(*declared(mark.hint), MISSING)
            case Makes():
                return self.of(mark.function)
            case Function(place=False):
                factor = self.factor
                return factor | list[factor | Literal[False]] if mark.components else factor  # type: ignore[valid-type]
            case Function(time=False):
                return str | Number | self.of(fh.Weibull, True)
            case Function():
                return Value if mark.components else str | Number
        return None

    def _of_toml(self, hint: Any) -> Any:
        """The counterpart of a type in TOML; None if there is none."""
        inner, origin = get_args(hint), get_origin(hint)
        if origin is Literal:
            return hint
        if origin in (tuple, list, Sequence):
            return list[self._takes(*declared(inner[0]), MISSING)]  # type: ignore[misc]
        if isinstance(origin, type) and issubclass(origin, Mapping):
            return dict[str, self._takes(*declared(inner[1]), MISSING)]  # type: ignore[misc]
        if hint is Shape:
            return self.region
        if isinstance(hint, type) and issubclass(
            hint, Shape | fh.Kernel | fh.Attenuation | fh.LossyRegion | fh.Rectangle | fh.DiscCut
        ):
            return self.of(hint)
        if hint is fh.BondLaw:
            return _one_of([self.of(maker, True) for maker in self.known.laws])
        if is_model(hint) or hint is fh.Weibull:
            return self.of(hint, not is_model(hint))
        return _TOML.get(hint)

    @cached_property
    def factor(self) -> Any:
        """A function of t: an expression, or the table of a signal."""
        signals: dict[str, Any] = {tag_of(maker): self.of(maker, True) for maker in self.known.signals}
        return _tagged({_PLAIN: str | Number, **signals}, _PLAIN)

    @cached_property
    def region(self) -> type[Part]:
        """The table of a region."""
        keys: dict[str, Any] = {
            key_of(maker): (self.of(maker) | None, Field(None, description=explained(maker)[0].partition(";")[0]))
            for maker in self.known.shapes
        }
        keys["without"] = (list["RegionPart"], Field([], description="Regions that are taken out of it."))  # type: ignore[name-defined]  # noqa: F821
        table = _made("RegionPart", Part, keys, "One shape, optionally with regions taken out of it.")
        table.MAKER = Shape
        return table

    @cached_property
    def material(self) -> type[Part]:
        """The table of a region of the medium: the constants of the models of one field."""
        text = "Where the constants apply; later regions take precedence over earlier ones."
        keys: dict[str, Any] = {"region": (self.region, Field(description=text)), **_of_material("the region")}
        for model in self.known.models:
            of_model = self._keys(model)[0]
            for name in [parameter.name for parameter in parameters(model) if parameter.mark(OfRegions)]:
                takes, field = of_model[name]
                keys.setdefault(name, (takes, Field(None, description=field.description)))
        return _made("MaterialPart", Part, keys, "Constants of the medium in a region, instead of those of the model.")

    @cached_property
    def case(self) -> type[CasePart]:
        """The table of a complete case file."""
        known = self.known
        sides: Any = dict[str, _one_of([self.of(maker, True) for maker in known.sides])]  # type: ignore[misc]
        words = "Field that it drives; for a thermoelastic solid it may be T, driven by a power per volume."
        field: dict[str, Any] = {"field": (Literal["u", "T"], Field("u", description=words))}
        sources = {tag_of(maker): self.of(maker, True) for maker in known.sources}
        sources["source"] = _made("SourcePart", self.of(fh.Source, False), field, explained(fh.Source)[0])
        waves = {tag_of(maker): self.of(maker, maker is not fh.IncidentWave) for maker in known.waves}
        takes: dict[str, Any] = {
            "units": UnitsPart | None,
            "lattice": self.of(fh.Lattice),
            "model": _one_of([self.of(maker, True) for maker in known.models]),
            "material": list[self.material],  # type: ignore[name-defined]
            "boundary": sides,
            "boundary_T": sides,
            "specimen": list[self.of(fh.Specimen)],  # type: ignore[misc]
            "crack": list[self.of(fh.Crack)],  # type: ignore[misc]
            "source": list[_tagged(sources, "source")],  # type: ignore[misc]
            "incident": list[_tagged(waves, tag_of(fh.IncidentWave))],  # type: ignore[misc]
            "load": list[_one_of([self.of(maker, True) for maker in known.loads])],  # type: ignore[misc]
            "constraint": list[_one_of([self.of(maker, True) for maker in known.constraints])],  # type: ignore[misc]
        }
        keys: dict[str, Any] = {}
        for name, hint in takes.items():
            base = CasePart.model_fields[name]
            keys[name] = (hint, Field(... if base.is_required() else base.default, description=base.description))
        for recorder in known.recorders:
            name, table = key_of(recorder), self.of(recorder)
            if name in CasePart.model_fields:
                raise InputError("a case file has such a table already", key=name, remedy="another name or tag")
            default: Any = Field([] if recorder.several else None, description=explained(recorder)[0])
            keys[name] = (list[table] if recorder.several else table | None, default)  # type: ignore[valid-type]
        return _made("CasePart", CasePart, keys)


class Parameter(NamedTuple):
    """A parameter of a class or a function: its type without annotations, and these."""

    name: str
    hint: Any
    marks: tuple[Any, ...]
    default: Any

    def mark(self, mark_type: type) -> Any:
        """The first of its annotations of a type; None if there is none."""
        return next((mark for mark in self.marks if isinstance(mark, mark_type)), None)


@lru_cache(maxsize=256)
def parameters(maker: Any) -> tuple[Parameter, ...]:
    """The parameters of a class or a function."""
    if "__dataclass_fields__" in vars(maker):
        hints, defaults = _hints(maker), [(field.name, field.default) for field in fields(maker)]
    else:
        plain = not isinstance(maker, type) or hasattr(maker, "_fields")  # a function or a named tuple
        hints = _hints(maker if plain else getattr(maker, "__init__"))  # noqa: B009 (mypy)
        signature = inspect.signature(maker).parameters.items()
        defaults = [(name, MISSING if given.default is given.empty else given.default) for name, given in signature]
    return tuple(Parameter(name, *declared(hints.get(name, Any)), default) for name, default in defaults)


def _ways(parameter: Parameter, default: Any, of_model: bool) -> list[Parameter]:
    """The ways in which a case file gives a parameter: as it is, or by the keys of a `OneOf`."""
    stated: Any = parameter.mark(OneOf)
    keys: dict[str, Any] = stated.keys if stated else _OPERATORS.get(parameter.name, {}) if of_model else {}
    default = None if len(keys) > 1 else default
    ways = [Parameter(key, *declared(hint), default) for key, hint in keys.items()]
    return ways or [parameter._replace(default=default)]


def declared(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """A type without its annotations, and these."""
    if get_origin(hint) is Annotated:
        bare, marks = declared(hint.__origin__)
        return bare, (*marks, *hint.__metadata__)
    if get_origin(hint) in (Union, UnionType):
        options = [declared(option) for option in get_args(hint)]
        return reduce(or_, [bare for bare, _ in options]), tuple(mark for _, marks in options for mark in marks)
    return hint, ()


def is_model(maker: Any) -> bool:
    """Whether something is the class of a model."""
    return isinstance(maker, type) and issubclass(maker, LatticeModel)


def _hints(given: Any) -> dict[str, Any]:
    try:
        return get_type_hints(given, include_extras=True)
    except NameError:  # types that are known only within a function
        return {}


def _of_material(what: str) -> dict[str, Any]:
    """Keys of a named material."""
    of = "Named material whose constants it has (`fh.materials`); those given in addition take precedence."
    name = f"Name of {what} in results, pictures and reports; that of a named material unless given."
    return {"of": (Named | None, Field(None, description=of)), "name": (str | None, Field(None, description=name))}


def _made(name: str, base: Any, keys: dict[str, Any], doc: str | None = None) -> Any:
    """A table with additional keys, which bring their own descriptions: it has no source to read docstrings from."""
    settings = {"use_attribute_docstrings": False}
    return create_model(name, __base__=base, __doc__=doc, __cls_kwargs__=settings, **keys)


def _table(maker: Any, keys: dict[str, Any], arguments: Mapping[str, Argument], typed: bool | None) -> type[Part]:
    """The table of a class or a function with these keys; see `Tables.of`."""
    brief = explained(maker)[0]
    if typed is not None:
        tag = tag_of(maker)
        keys = {"type": (Literal[tag], Field(... if typed else tag, description=brief)), **keys}
    inner = "Inner" if is_model(maker) and not typed else ""
    table: type[Part] = _made(f"{inner}{maker.__name__}Part", Part, keys, brief)
    table.MAKER, table.ARGUMENTS = maker, arguments
    return table


def _one_of(parts: Sequence[type[Part]]) -> Any:
    """One of several tables, selected by `type`."""
    return Annotated[reduce(or_, parts), Field(discriminator="type")]


def _tagged(options: Mapping[str, Any], plain: str) -> Any:
    """One of several tables, selected by `type`; `plain` where the value is not a table or has no type."""

    def tag(value: Any) -> Any:
        return value.get("type", plain) if isinstance(value, Mapping) else getattr(value, "type", plain)

    tagged = [Annotated[takes, Tag(name)] for name, takes in options.items()]
    return Annotated[reduce(or_, tagged), Discriminator(tag)]


def explained(maker: Any) -> tuple[str, dict[str, str]]:
    """First paragraph of a docstring; and for each parameter, its choice of values and its description."""
    bases = maker.__mro__[1:] if isinstance(maker, type) else ()
    texts = explained(bases[0])[1] if bases else {}
    docstring = inspect.cleandoc(maker.__doc__ or "")
    section = re.search(r"^Parameters\n-+\n(.*?)(?=^\w+\n-+$|\Z)", docstring, re.DOTALL | re.MULTILINE)
    entry = re.compile(r"^(\w[\w, ]*?)(?: : ([^\n]*))?\n((?:[ \t]+[^\n]*\n|\n)*)", re.MULTILINE)
    for names, hint, below in entry.findall(f"{section[1]}\n" if section else ""):
        choice = re.match(r"\{(.*)\}", hint)
        text = f"{choice[1]}. {_line(below)}".strip() if choice else _line(below)
        texts |= {name.strip(): text for name in names.split(",") if text}
    return _line(docstring.split("\n\n")[0]), texts


def _line(text: str) -> str:
    """A paragraph of a docstring as one line, without formulas and backquotes."""
    return " ".join(re.sub(r",? :math:`[^`]*`|`", "", text).split())


def case_part() -> type[CasePart]:
    """The table of a complete case file, with the classes that are currently registered."""
    return tables().case


def under(place: str, key: str) -> str:
    """Place in the case of a key named as in Python: its last part below `place`, unless it begins with `place`."""
    if not key:
        return place
    return key if key.startswith(place) else f"{place}.{key.rpartition('.')[2]}"


def schema() -> dict[str, Any]:
    """JSON Schema of case files: keys, kinds of values and defaults; further conditions are checked when a case is
    read. Keys that accept a unit have the SI unit as `unit`.
    """
    return schema_of(case_part())


def schema_of(case: type[Part]) -> dict[str, Any]:
    """JSON Schema of the table of a case."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **case.model_json_schema(),
        "title": "farhorizon case",
        "description": f"A case file of farhorizon {__version__}: a table for each part of the set-up. Keys that are "
        "not tables come before the first table.",
    }
