"""The tables of a case file and their keys, from which its JSON Schema follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import lru_cache, reduce
from inspect import isabstract, signature
from operator import or_
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, create_model, field_validator

from farhorizon import __version__
from farhorizon import public as fh
from farhorizon.boundaries import Side
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Shape
from farhorizon.models import LatticeModel


class Part(BaseModel):
    """A table."""

    model_config = ConfigDict(extra="forbid", strict=False)


Number = Annotated[float, Field(allow_inf_nan=False)]
Value = str | Number | list[str | Number]  # an expression or a number, of vectors one a component


class DiscPart(Part):
    radius: Number
    centre: list[Number] | None = None


class BoxPart(Part):
    lower: list[Number]
    upper: list[Number]


class PolygonPart(Part):
    points: list[list[Number]]


class TextPart(Part):
    text: str
    height: Number
    centre: list[Number] | None = None
    font: str = "DejaVu Sans"
    bold: bool = False


class ImagePart(Part):
    file: str
    width: Number
    centre: list[Number] | None = None
    threshold: Number = 0.5

    @field_validator("file")
    @classmethod
    def _beside_the_case(cls, name: str, info: ValidationInfo) -> str:
        return str((info.context or {}).get("folder", Path()) / name)


class RegionPart(Part):
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
            raise error.at(under(key, error.key)) from None

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


class LatticePart(Part):
    spacing: Number
    lower: list[Number] | None = None
    upper: list[Number] | None = None
    window: RegionPart | None = None
    body: RegionPart | None = None


class KernelPart(Part):
    horizon: Number
    exponent: int = 2
    influence: str = "constant"
    width: Number | None = None
    volume: str = "ramp"
    calibrate: bool = True


class BodyPart(Part):
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


class MaterialPart(Part):
    """Constants of a body in a region, in place of the model's."""

    region: RegionPart
    young: str | Number | None = None
    poisson: str | Number | None = None
    density: str | Number | None = None


class CrackPart(Part):
    points: list[list[Number]] | None = None
    rectangle: dict[Literal["corner", "edge1", "edge2"], list[Number]] | None = None
    disc: dict[Literal["centre", "normal", "radius"], list[Number] | Number] | None = None
    factor: Number = 0.0
    opens: Number = 0.0


class ConstraintPart(Part):
    """A condition on a side, or in a region."""

    type: Literal["temperature", "flux", "insulated", "convection"]
    side: str | None = None
    region: RegionPart | None = None
    value: str | Number | None = None
    kind: str | None = None
    transfer: Number | None = None
    within: RegionPart | None = None


class SpecimenPart(Part):
    region: RegionPart
    concentration: Number = 1.0


class SourcePart(Part):
    field: Literal["u"] = "u"
    value: Value


class IncidentPart(Part):
    """A plane wave that comes from far away."""

    direction: list[Number]
    signal: str
    duration: Number
    polarisation: Literal["P", "S"] | list[Number] = "P"
    within: BoxPart | None = None


class TractionPart(Part):
    """A force per area on a free side of an elastic medium."""

    type: Literal["traction"]
    side: str
    value: list[Number]
    between: list[tuple[Number, Number]] | None = None
    time: str | Number = 1.0


class BodyForcePart(Part):
    """A force per volume on an elastic medium."""

    type: Literal["body-force"]
    value: list[str | Number]
    time: str | Number = 1.0


class PrescribedPart(Part):
    """Nodes that follow a value for a while."""

    type: Literal["prescribed"]
    points: list[list[Number]] | None = None
    region: RegionPart | None = None
    value: str | Number
    until: Number | None = None
    rate: str | Number | None = None


class RunPart(Part):
    until: Number
    dt: Number | None = None
    dtype: str = "float64"
    threads: int | None = None


class OutputPart(Part):
    fields: list[Literal["u", "v", "damage", "solid", "dissolved"]] | None = None
    every: Number | None = None
    probes: list[list[Number]] = []
    probe_every: Number | None = None
    pictures: list[Number] | None = None
    balance: bool = False


AnyLoad = TractionPart | BodyForcePart
AnyConstraint = ConstraintPart | PrescribedPart


class CasePart(Part):
    lattice: LatticePart
    model: Any
    material: list[MaterialPart] = []
    initial: dict[Literal["u", "v"], Value] = {}
    boundary: dict[str, Any] = {}
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


# --- sides and models ------------------------------------------------------------------------------------------


def side_kinds() -> dict[str, Any]:
    """The sides by what they are called, the recommended one first, those that users define among them."""
    known = [kind for kind in Side.known.values() if is_dataclass(kind) and not isabstract(kind)]
    return {kind.tag: kind for kind in sorted(known, key=lambda kind: (kind.__name__ != "LatticePML", kind.__name__))}


def model_kinds() -> dict[str, Any]:
    """The models by what they are called, those that users define among them."""
    known = [kind for kind in LatticeModel.known.values() if not isabstract(kind)]
    return {kind.tag: kind for kind in sorted(known, key=lambda kind: (kind.__name__ != "Wave", kind.__name__))}


@lru_cache(maxsize=64)
def side_part(kind: Any) -> type[Part]:
    """The table of a side: its keys are the fields of the dataclass."""
    return _table(kind, {one.name: _key(_hints(kind).get(one.name, Any), one.default) for one in fields(kind)})


@lru_cache(maxsize=64)
def model_part(kind: Any) -> type[Part]:
    """The table of a model: its keys are the parameters of the class, with two for an operator and one more for an
    integrator.
    """
    hints = _hints(kind.__init__)
    keys: dict[str, Any] = {}
    for name, one in signature(kind).parameters.items():
        if name in ("operator", "kernel"):
            keys["kernel"] = (KernelPart | None, None)
        else:
            keys[name] = _key(hints.get(name, Any), MISSING if one.default is one.empty else one.default)
        if name == "operator":
            keys["stencil"] = (Literal["finite-difference", "finite-element"] | None, None)
        if name == "integrator":
            keys["stages"] = (int | None, None)
    return _table(kind, keys)


def _table(kind: Any, keys: dict[str, Any]) -> type[Part]:
    given: dict[str, Any] = {"type": (Literal[kind.tag], ...), **keys}
    return create_model(f"{kind.__name__}Part", __base__=Part, **given)


def _hints(given: Any) -> dict[str, Any]:
    try:
        return get_type_hints(given)
    except NameError:  # of types that are known in a function alone
        return {}


def _key(hint: Any, default: Any) -> tuple[Any, Any]:
    """Type and default of a key. TOML has no None: the key is left out, or false where None is not the default. Where a
    type has no counterpart the class itself sees what it is given.
    """
    options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    found = [kind for option in options if (kind := _of_toml(option)) is not None]
    if found and NoneType in options:
        found.append(None if default is None else Literal[False])
    return reduce(or_, found) if found else Any, ... if default is MISSING else default


def _of_toml(hint: Any) -> Any:
    """The counterpart of one type; None where there is none."""
    inner, origin = get_args(hint), get_origin(hint)
    if origin is Literal:
        return hint
    if origin in (tuple, list):
        return list[_of_toml(inner[0]) or Any]  # type: ignore[misc]
    if isinstance(origin, type) and issubclass(origin, Mapping):
        values = reduce(or_, map(_of_toml, get_args(inner[1]) or inner[1:]))
        return dict[str, values]  # type: ignore[valid-type]
    return {float: Number, int: int, bool: bool, str: str, np.ndarray: list[Number]}.get(hint)


def case_part() -> type[CasePart]:
    """A whole case file, with the sides and models that are known now."""
    return _case_part(tuple(side_kinds().values()), tuple(model_kinds().values()))


@lru_cache(maxsize=64)
def _case_part(sides: tuple[Any, ...], models: tuple[Any, ...]) -> type[CasePart]:
    side: Any = Annotated[reduce(or_, map(side_part, sides)), Field(discriminator="type")]
    model: Any = Annotated[reduce(or_, map(model_part, models), BodyPart), Field(discriminator="type")]
    return create_model("CasePart", __base__=CasePart, boundary=(dict[str, side], {}), model=(model, ...))


def under(place: str, key: str) -> str:
    """The key that an error has in Python, at its place in the case: the last part of it, unless it has the place
    already.
    """
    if not key:
        return place
    return key if key.startswith(place) else f"{place}.{key.rpartition('.')[2]}"


def schema() -> dict[str, Any]:
    """JSON Schema of case files: keys, kinds of values and defaults; what else must hold is told when a case is
    read."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **case_part().model_json_schema(),
        "title": "farhorizon case",
        "description": f"A case file of farhorizon {__version__}.",
    }
