"""The tables of a case file and their keys, from which its JSON Schema is generated."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from functools import lru_cache, reduce
from inspect import isabstract, signature
from operator import or_
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeAlias, Union, get_args, get_origin, get_type_hints

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
from farhorizon.boundaries import Side
from farhorizon.case.units import QUANTITY, Units, measured, without_units
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Shape
from farhorizon.inputs.conditions import Constraint
from farhorizon.inputs.incidence import Incident
from farhorizon.inputs.local_sources import LocalSource
from farhorizon.inputs.signals import Signal
from farhorizon.medium.materials import Fluid
from farhorizon.medium.materials import named as named_materials
from farhorizon.models import LatticeModel


class Part(BaseModel):
    """A table. The string below a key is its description in the JSON Schema and at the prompt (`farhorizon keys`)."""

    model_config = ConfigDict(extra="forbid", strict=False, use_attribute_docstrings=True)

    @model_validator(mode="before")
    @classmethod
    def _in_units_of_the_case(cls, data: Any, info: ValidationInfo) -> Any:
        context = info.context or {}
        if not isinstance(data, dict) or "units" not in context:
            return data
        if "of" in cls.model_fields and isinstance(data.get("of"), str):
            data = _named_constants(data, context["units"], cls.model_fields) | data
        return without_units(cls.__name__, data, context["units"])


def _no_truth_value(wanted: Literal["float_type", "int_type"]) -> BeforeValidator:
    """Refuse true and false, which Python would take for 1 and 0."""

    def check(value: Any) -> Any:
        if isinstance(value, bool):
            raise PydanticKnownError(wanted)
        return value

    return BeforeValidator(check)


Number = Annotated[float, _no_truth_value("float_type"), Field(allow_inf_nan=False)]
Whole = Annotated[int, _no_truth_value("int_type")]
Flag = Annotated[bool, Strict()]  # neither "yes" nor 1 passes
Value = str | Number | list[str | Number]  # an expression or a number; for vectors one per component
_OF_TIME = "a function of t"
Named: TypeAlias = Literal[*named_materials()]  # type: ignore[valid-type]
_PLAIN = "expression"
_OF_TIMES = "functions of t, one a component, false where one is free"
Factor = Annotated[str | Number, _OF_TIME]  # or a table with a signal
Factors = Annotated[Any, _OF_TIMES]  # a `Factor`, or a list of factors and false


def _named_constants(data: Mapping[str, Any], units: Units | None, keys: Iterable[str]) -> dict[str, float]:
    """Constants, in the units of the case, of the material named in a table that knows the given keys."""
    material = named_materials().get(data["of"])
    if material is None:
        return {}  # the table refuses the name
    fits = [name for name, one in named_materials().items() if one.constants.keys() <= set(keys)]
    if data["of"] not in fits:
        raise InputError(
            f"such a model has no {' and no '.join(sorted(material.constants.keys() - set(keys)))}",
            value=data["of"],
            limit=", ".join(fits) or "none of the named materials",
            key="of",
            remedy='one of these, or type = "wave", whose field is the pressure of a fluid'
            if isinstance(material, Fluid)
            else 'one of these, or type = "elastic" for a solid',
        )
    if units is None:
        raise InputError(
            "the constants of a named material need a case that states its own units",
            value=data["of"],
            key="of",
            remedy='[units] with length = "m", time = "s", mass = "kg"',
        )
    si = {"young": "Pa", "poisson": "", "speed": "m/s", "density": "kg/m^3"}
    if isinstance(material, Fluid):
        si["density"] = "1/Pa"  # the compressibility
    return {
        name: units.number(value, si[name], si[name], "of") if si[name] else value
        for name, value in material.constants.items()
    }


def _beside_the_case(name: str, info: ValidationInfo) -> str:
    return str((info.context or {}).get("folder", Path()) / name)


FilePath = Annotated[str, AfterValidator(_beside_the_case)]  # relative to the case file


class DiscPart(Part):
    radius: Number
    """Radius."""
    centre: list[Number] | None = None
    """Centre; the origin unless given."""


class BoxPart(Part):
    lower: list[Number]
    """Smallest coordinate along each axis."""
    upper: list[Number]
    """Largest coordinate along each axis."""


class PolygonPart(Part):
    points: list[list[Number]]
    """Corners, in order."""


class TextPart(Part):
    text: str
    """The text, on one line."""
    height: Number
    """Height of a capital letter."""
    centre: list[Number] | None = None
    """Centre of the bounding box of the drawn text; the origin unless given."""
    font: str = "DejaVu Sans"
    """Name of a font family that matplotlib can find."""
    bold: Flag = False
    """Bold letters."""


class ImagePart(Part):
    file: FilePath
    """Path of an image (PNG, JPEG), relative to the case file; its dark pixels are the region."""
    width: Number
    """Width of the whole image."""
    centre: list[Number] | None = None
    """Centre of the whole image; the origin unless given."""
    threshold: Number = 0.5
    """Brightness from 0 (black) to 1 (white); darker pixels belong to the region."""


class VoxelsPart(Part):
    file: FilePath
    """Path of an NPY array, or of a TIFF image or stack of images, relative to the case file."""
    size: Number
    """Edge length of a voxel."""
    lower: list[Number] | None = None
    """Lower corner of the whole grid; unless given, the grid is centred at the origin."""
    labels: list[Whole] | None = None
    """Values of the voxels that belong to the region; all except 0 unless given."""


class MeshPart(Part):
    file: FilePath
    """Path of a closed surface (STL, OBJ, PLY), relative to the case file."""
    scale: Number = 1.0
    """Factor on its coordinates."""
    centre: list[Number] | None = None
    """Point to which the centre of its bounding box is moved; not moved unless given."""


class ElementsPart(Part):
    file: FilePath
    """Path of a Gmsh mesh (MSH 4.1), relative to the case file."""
    group: str | None = None
    """Name of the physical group that is the region; the whole mesh unless given."""
    scale: Number = 1.0
    """Factor on its coordinates."""


#: Shapes of a region; the keys of each table are in the order of the arguments.
_SHAPES: dict[str, Callable[..., Shape]] = {
    "disc": fh.Disc,
    "ball": fh.Ball,
    "box": fh.Box,
    "polygon": fh.Polygon,
    "text": fh.Text,
    "image": fh.ImageMask,
    "voxels": fh.Voxels,
    "mesh": fh.Mesh,
    "elements": fh.Elements,
}


class RegionPart(Part):
    """One shape, optionally with regions taken out of it."""

    disc: DiscPart | None = None
    """A disc (2D)."""
    ball: DiscPart | None = None
    """A ball (3D)."""
    box: BoxPart | None = None
    """An interval, a rectangle or a box."""
    polygon: PolygonPart | None = None
    """A polygon (2D)."""
    text: TextPart | None = None
    """The letters of a text (2D)."""
    image: ImagePart | None = None
    """The dark pixels of an image (2D)."""
    voxels: VoxelsPart | None = None
    """Voxels of an array, a label image or a stack of images (1D, 2D, 3D)."""
    mesh: MeshPart | None = None
    """The region enclosed by a closed surface (3D)."""
    elements: ElementsPart | None = None
    """The region covered by the triangles (2D) or tetrahedra (3D) of a mesh."""
    without: list[RegionPart] = []
    """Regions that are taken out of it."""

    def build(self, key: str) -> Shape:
        """The shape; an InputError names the key."""
        try:
            return self._shape(key)
        except InputError as error:
            raise error.at(under(key, error.key)) from None

    def _shape(self, key: str) -> Shape:
        given = [(make, part) for name, make in _SHAPES.items() if (part := getattr(self, name)) is not None]
        if len(given) != 1:
            raise InputError(f"give exactly one of {', '.join(_SHAPES)}", key=key)
        [(make, part)] = given
        region = make(*dict(part).values())
        for hole in self.without:
            region = region - hole.build(key + ".without")
        return region


class UnitsPart(Part):
    """Units of the plain numbers of the case, which allow other numbers to have units of their own ("5 mm")."""

    length: str | None = None
    """Unit of length, such as "mm"."""
    time: str | None = None
    """Unit of time, such as "us"."""
    mass: str | None = None
    """Unit of mass, such as "kg"; it may follow instead from one of force, pressure, density and energy."""
    force: str | None = None
    """Unit of force instead of mass, such as "N"."""
    pressure: str | None = None
    """Unit of pressure instead of mass, such as "GPa"."""
    density: str | None = None
    """Unit of density instead of mass, such as "g/cm^3"."""
    energy: str | None = None
    """Unit of energy instead of mass, such as "J"."""
    temperature: str | None = None
    """Unit of temperature, such as "degC" or "K"."""
    amount: str | None = None
    """Unit of amount of substance, such as "mol"."""


class LatticePart(Part):
    spacing: Number
    """Distance between neighbouring nodes, the same along every axis."""
    lower: list[Number] | None = None
    """Smallest coordinate of the near field along each axis, at which a node lies."""
    upper: list[Number] | None = None
    """Largest coordinate of the near field along each axis, a whole number of spacings from lower."""
    window: RegionPart | None = None
    """Window on the medium, instead of lower and upper; the medium continues beyond its edge."""
    body: RegionPart | None = None
    """Body of finite extent within lower and upper; nodes outside it do not exist."""


class KernelPart(Part):
    horizon: Number
    """Radius within which nodes interact; three spacings are usual."""
    exponent: Whole = 2
    """Exponent p in the weight w(r)/r^p of a bond, 0 to 3."""
    influence: str = "constant"
    """Influence function w(r): constant, linear (1 - r/horizon) or gaussian (exp(-(r/width)^2))."""
    width: Number | None = None
    """Width of the Gaussian; a third of the horizon unless given."""
    volume: str = "ramp"
    """Volume of a neighbour: ramp (partial at the edge of the family) or full (if its centre is within the horizon)."""
    calibrate: Flag = True
    """Rescale the weights so that the speed or diffusivity of long waves is exactly the given one."""


class WeibullPart(Part):
    """A random constant, with a different value in each cell of a grid."""

    type: Literal["weibull"]
    """A Weibull distribution."""
    scale: Number
    """Value that a fraction 1/e, 37 %, exceeds."""
    modulus: Number
    """Weibull modulus: the larger it is, the smaller the scatter."""
    cell: Number
    """Edge length of the cells, such as the grain size; if it is the spacing, each node has its own value."""
    seed: Whole = 0
    """A different seed gives a different sample."""


class MaterialPart(Part):
    """Constants of the medium in a region, instead of those of the model."""

    region: RegionPart
    """Where the constants apply; later regions take precedence over earlier ones."""
    of: Named | None = None
    """Named material whose constants it has (`fh.materials`); those given in addition take precedence."""
    name: str | None = None
    """Name in results, pictures and reports; that of a named material unless given."""
    young: str | Number | WeibullPart | None = None
    """Young's modulus there."""
    poisson: str | Number | WeibullPart | None = None
    """Poisson's ratio there."""
    bulk: str | Number | WeibullPart | None = None
    """Bulk modulus there."""
    shear: str | Number | WeibullPart | None = None
    """Shear modulus there."""
    speed: str | Number | WeibullPart | None = None
    """Wave speed there."""
    density: str | Number | WeibullPart | None = None
    """Density there."""
    diffusivity: str | Number | WeibullPart | None = None
    """Diffusivity there."""
    specific_heat: str | Number | WeibullPart | None = None
    """Specific heat there."""
    conductivity: str | Number | WeibullPart | None = None
    """Thermal conductivity there."""
    critical_stretch: str | Number | WeibullPart | None = None
    """Critical stretch there; a bond breaks when its weaker end would."""
    fracture_energy: str | Number | WeibullPart | None = None
    """Fracture energy there."""


class CutPart(Part):
    points: list[list[Number]] | None = None
    """Points of a polyline (2D), corners of a polygon (3D), or a position (1D)."""
    rectangle: dict[Literal["corner", "edge1", "edge2"], list[Number]] | None = None
    """Rectangle in 3D: one corner and the two edges from it."""
    disc: dict[Literal["centre", "normal", "radius"], list[Number] | Number] | None = None
    """Disc in 3D: centre, normal and radius."""


class CrackPart(CutPart):
    factor: Number = 0.0
    """Remaining fraction of the bonds across it: 0 removes them, 1 has no effect."""
    opens: Number = 0.0
    """Time at which it opens."""


#: Classes of conditions by type name.
CONDITIONS: dict[str, type] = {kinds.hyphened(kind.__name__): kind for kind in get_args(Constraint)}


class ConstraintPart(Part):
    """A condition on a scalar field, on a side or in a region."""

    type: Literal[*CONDITIONS]  # type: ignore[valid-type]
    """Condition on a scalar field: temperature, flux, insulation or convection."""
    side: str | None = None
    """Side on which it is imposed, such as "x-"; or give a region."""
    region: RegionPart | None = None
    """Region that takes the temperature, or whose surface (a hole or the body) has flux or convection; or a side."""
    value: str | Number | None = None
    """Temperature, flux into the body or, for convection, ambient temperature; may depend on the coordinates and t."""
    kind: str | None = None
    """For a side: node, volume or mirror (temperature), source, layer or mirror (flux), layer or mirror (insulated).
    With volume, layer and mirror, the outermost nodes, as many as the stencil reaches, lie beyond the wall."""
    transfer: Number | None = None
    """Heat transfer coefficient of convection, power / (area temperature)."""
    within: RegionPart | None = None
    """Region to whose nodes the condition is restricted."""


class SpecimenPart(Part):
    region: RegionPart
    """Region of the metal."""
    concentration: Number = 1.0
    """Concentration of the metal, in the units of the saturation."""


class SourcePart(Part):
    """A term on the right-hand side of the equation, at all nodes."""

    type: Literal["source"] = "source"
    """A term on the right-hand side of the equation, at all nodes."""
    field: Literal["u", "T"] = "u"
    """Field that it drives; for a thermoelastic solid it may be T, the temperature, driven by a power per volume."""
    value: Value
    """The term, a function of the coordinates and t; for vectors a list with one entry per component."""
    time: Factor = 1.0
    """Factor as a function of t: an expression, or a table with a signal."""


class TractionPart(Part):
    """A force per area on a free side of an elastic medium."""

    type: Literal["traction"]
    """A force per area on a free side."""
    side: str
    """Free side on which it acts, such as "x-" or "y+"."""
    value: list[Number]
    """Force per area, one component per axis."""
    between: list[tuple[Number, Number]] | None = None
    """Range in which it acts, along each of the other axes; the whole side unless given."""
    time: Factor = 1.0
    """Factor as a function of t: an expression, or a table with a signal."""


class PressurePart(CutPart):
    """A pressure on the faces of a crack or on the rim of a hole in an elastic medium."""

    type: Literal["pressure"]
    """A pressure in a crack, given by points, rectangle or disc as under crack, or in a hole."""
    region: RegionPart | None = None
    """The hole, instead of a crack: a region without nodes of the body."""
    value: Number | list[list[Number]]
    """Force per area that presses the faces apart, or a symmetric matrix P: the traction is -P n, where n points away
    from the body."""
    time: Factor = 1.0
    """Factor as a function of t: an expression, or a table with a signal."""


class BodyForcePart(Part):
    """A force per volume on an elastic medium."""

    type: Literal["body-force"]
    """A force per volume."""
    value: list[str | Number]
    """Force per volume, one component per axis, each a function of the coordinates and t."""
    time: Factor = 1.0
    """Factor as a function of t: an expression, or a table with a signal."""


class ThermalPart(Part):
    """A temperature that strains an elastic medium."""

    type: Literal["thermal"]
    """A temperature that strains the solid."""
    temperature: str | Number
    """Temperature, a function of the coordinates and t."""
    expansion: str | Number
    """Coefficient of linear expansion; a function of the coordinates where it varies."""
    reference: Number
    """Temperature at which the solid is free of stress."""
    every: Number | None = None
    """Sampling interval of the temperature, which is linear in between; each time step unless given."""


class PrescribedPart(Part):
    """Nodes that follow a prescribed value, permanently or for a limited time."""

    type: Literal["prescribed"]
    """Nodes that follow a prescribed value."""
    points: list[list[Number]] | None = None
    """Points, each replaced by the nearest node; or give a region."""
    region: RegionPart | None = None
    """Region that contains the nodes; or give points."""
    value: Factors = None
    """Value as a function of t: an expression, or a table with a signal; for displacements a list with one entry per
    axis, false for a free component."""
    velocity: Factors = None
    """Velocity with which the nodes move from their initial values, instead of a value and given like it."""
    until: Number | None = None
    """Time after which the nodes are released; never unless given."""
    rate: str | Number | list[str | Number | Literal[False]] | None = None
    """Velocity with which they are released, for waves; the derivative of value unless given."""


class LinePart(Part):
    """Evenly spaced points along a line."""

    start: list[Number]
    """First point."""
    end: list[Number]
    """Last point."""
    count: Whole
    """Number of points, both ends included."""


class GridPart(Part):
    """Points on a grid."""

    lower: list[Number]
    """Smallest coordinates."""
    upper: list[Number]
    """Largest coordinates."""
    counts: list[Whole]
    """Number of points along each axis, both ends included."""


class ReceiversPart(Part):
    """Points, on nodes or between them, at which a run is recorded in every step or every few steps."""

    points: list[list[Number]] | None = None
    """Points; or give a line or a grid."""
    line: LinePart | None = None
    """Points along a line."""
    grid: GridPart | None = None
    """Points on a grid."""
    record: list[str] = ["u"]
    """Quantities: u, v, gradient, strain, stress, pressure, divergence, curl, rotation, energy_flux."""
    every: Whole = 1
    """Steps from one record to the next."""
    interpolation: str = "sinc"
    """Interpolation between nodes: sinc, accurate to 1e-5, or linear, which needs only the nodes next to the point."""
    name: str | None = None
    """Name in files and pictures; receivers, or receivers_0, receivers_1, ... unless given."""


class SpectraPart(Part):
    """Places where the spectrum of the field is accumulated during the run."""

    points: list[list[Number]] | None = None
    """Points; or give a line, a grid, a region, or a plane by axis and position."""
    line: LinePart | None = None
    """Points along a line."""
    grid: GridPart | None = None
    """Points on a grid."""
    region: RegionPart | None = None
    """Region all of whose nodes are recorded."""
    axis: str | None = None
    """Normal of a plane (x, y or z); all nodes of the layer of nodes nearest to it are recorded."""
    position: Number | None = None
    """Coordinate of the plane along its normal."""
    frequencies: list[Number]
    """Frequencies, in cycles per unit of time."""
    record: list[str] = ["u"]
    """Quantities: u, gradient, strain, stress, pressure, divergence, curl, rotation."""
    every: Whole = 1
    """Steps from one term of the sums to the next; a time step of half the stable limit allows 3."""
    interpolation: str = "sinc"
    """Interpolation between nodes: sinc or linear."""
    name: str | None = None
    """Name in files and pictures; spectra, or spectra_0, spectra_1, ... unless given."""


class StressIntensityPart(Part):
    """Stress intensity factors at crack tips, in every step or every few steps."""

    tips: list[list[Number]] | None = None
    """Crack tips; all that lie in the near field unless given."""
    radii: list[Number] | None = None
    """Radii of the two circles between which the field is evaluated; as large as possible unless given."""
    every: Whole = 1
    """Steps from one record to the next."""
    name: str | None = None
    """Name in files and pictures; stress_intensity, or stress_intensity_0, stress_intensity_1, ... unless given."""


class CrackTipsPart(Part):
    """Positions of crack tips while bonds break."""

    every: Whole = 20
    """Steps from one record to the next."""
    most: Whole = 7
    """Largest number of tips that are followed."""
    name: str | None = None
    """Name in files and pictures; crack_tips, or crack_tips_0, crack_tips_1, ... unless given."""


class FarFieldPart(Part):
    """Waves that a run radiates into the surrounding medium, computed from records around a box."""

    box: BoxPart | None = None
    """Box around everything that radiates or scatters; the near field less one reach of the stencil unless given."""
    frequencies: list[Number] = []
    """Frequencies of the pattern of waves, in cycles per time."""
    points: list[list[Number]] | None = None
    """Receivers outside the box, at any distance."""
    directions: Whole = 180
    """Number of directions of the pattern, evenly spaced from the x axis; in 3D in each of the planes xy, yz and zx."""


class PowerPart(Part):
    """A surface through which the power of waves is recorded in every step."""

    region: RegionPart | None = None
    """Region whose outgoing power is recorded; or give an axis and a position."""
    axis: str | None = None
    """Normal of a plane: x, y or z."""
    position: Number | None = None
    """Coordinate of the plane along its normal, moved to the nearest mid-point between two nodes."""
    frequencies: list[Number] = []
    """Frequencies, in cycles per time, at which the transmitted energy is computed."""
    name: str | None = None
    """Name in files and pictures; power, or power_0, power_1, ... unless given."""


class ShellPart(Part):
    """The field around a box, recorded in every step for another run (`[[incident]]`, `type = "incident-record"`)."""

    box: BoxPart | None = None
    """The box; the near field less two reaches of the stencil unless given."""
    name: str | None = None
    """Name in the results file; shell, or shell_0, shell_1, ... unless given."""


class RunPart(Part):
    until: Number | Literal["static"]
    """End of the run; "static": when the field has come to rest."""
    tolerance: Number | None = None
    """With until = "static": fraction of their largest value below which velocities must fall; 1e-3 unless given."""
    limit: Number | None = None
    """With until = "static", where it is required: the latest end, for which layers are chosen."""
    dt: Number | None = None
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
    every: Number | None = None
    """Time between two outputs; a fortieth of the run unless given."""
    probes: list[list[Number]] = []
    """Points at whose nearest nodes u is recorded."""
    probe_every: Number | None = None
    """Time between two records of the probes; every step unless given."""
    dtype: Literal["float32", "float64"] | None = None
    """Precision of the fields in the results file; that of the run unless given."""
    compress: Flag = False
    """Compress the fields in the results file without loss; ParaView can still read them."""
    pictures: list[Number] | None = None
    """Times of the pictures; four evenly spaced outputs unless given."""
    balance: Flag = False
    """Record energies and work (elastic media), or what has flowed into the near field (diffusion, heat, corrosion)."""


_LOADS = (TractionPart, PressurePart, BodyForcePart, ThermalPart)
_CONSTRAINTS = (ConstraintPart, PrescribedPart)


class CasePart(Part):
    units: UnitsPart | None = None
    """Units of the plain numbers; any consistent units unless given."""
    lattice: LatticePart
    """The near field and its nodes."""
    model: Any
    """The physics: an equation and its constants."""
    material: list[MaterialPart] = []
    """Regions of the medium with constants of their own."""
    initial: dict[Literal["u", "v", "T"], Value] = {}
    """Values at t = 0, functions of the coordinates: u, for waves also v = u_t, for a thermoelastic solid also T."""
    boundary: dict[str, Any] = {}
    """Conditions on the sides: all, "x", "x-", "x+", ...; a lattice-pml on every side unless given."""
    boundary_T: dict[str, Any] = {}
    """For a thermoelastic solid: conditions for the temperature on sides where they differ from boundary."""
    specimen: list[SpecimenPart] = []
    """Pieces of metal, for corrosion."""
    crack: list[CrackPart] = []
    """Cracks, which remove or weaken the bonds across them."""
    source: list[SourcePart] = []
    """Terms on the right-hand side of the equation."""
    incident: list[Any] = []
    """Waves that come from outside."""
    load: list[Any] = []
    """Forces on an elastic medium."""
    constraint: list[Any] = []
    """Conditions on nodes: temperature, flux, insulation, convection, prescribed values."""
    coefficient: str | Number | dict[Literal["u", "T"], str | Number] | None = None
    """Factor on the bonds, a function of the coordinates; for a thermoelastic solid by field: under u on the stiffness,
    under T on the conductivity."""
    rule: str | None = None
    """How a bond combines the factors or stiffnesses of its ends: both (the smaller one), arithmetic or harmonic."""
    rim: str = "free"
    """Condition on the surface of a body: free, or fixed at the background."""
    background: Number = 0.0
    """Uniform state of the infinite medium."""
    receivers: list[ReceiversPart] = []
    """Points at which a run is recorded step by step."""
    spectra: list[SpectraPart] = []
    """Spectra at chosen frequencies, accumulated during the run."""
    far_field: FarFieldPart | None = None
    """Waves beyond the near field: receivers at any distance, patterns by direction and frequency."""
    power: list[PowerPart] = []
    """Surfaces through which the power of waves is recorded."""
    crack_tips: list[CrackTipsPart] = []
    """Positions and speeds of crack tips while bonds break."""
    stress_intensity: list[StressIntensityPart] = []
    """Stress intensity factors at crack tips."""
    shell: list[ShellPart] = []
    """Boxes around which the field is recorded for another run."""
    run: RunPart
    """End of the run, time step and computing resources."""
    output: OutputPart = OutputPart()
    """Fields, probes and pictures, and when they are recorded."""


# --- sides and models ------------------------------------------------------------------------------------------


def side_kinds() -> dict[str, Any]:
    """Classes of sides by type name, user-defined ones included; the recommended one first."""
    known = [kind for kind in Side.known.values() if is_dataclass(kind) and not isabstract(kind)]
    return {kind.tag: kind for kind in sorted(known, key=lambda kind: (kind.__name__ != "LatticePML", kind.__name__))}


def model_kinds() -> dict[str, Any]:
    """Classes of models by type name, user-defined ones included; the wave equation first."""
    known = [kind for kind in LatticeModel.known.values() if not isabstract(kind)]
    return {kind.tag: kind for kind in sorted(known, key=lambda kind: (kind.__name__ != "Wave", kind.__name__))}


def signal_kinds() -> dict[str, Any]:
    """Classes of signals by type name, user-defined ones included."""
    return _kinds_of(Signal)


def source_kinds() -> dict[str, Any]:
    """Classes of local sources by type name, user-defined ones included."""
    return _kinds_of(LocalSource)


def incident_kinds() -> dict[str, Any]:
    """Classes of incident waves by type name, user-defined ones included."""
    return _kinds_of(Incident)


def _kinds_of(base: type[Signal] | type[LocalSource] | type[Incident]) -> dict[str, Any]:
    known = [kind for kind in base.known.values() if is_dataclass(kind) and not isabstract(kind)]
    return {kind.tag: kind for kind in sorted(known, key=lambda kind: kind.__name__)}


@lru_cache(maxsize=64)
def part_of(kind: Any) -> type[Part]:
    """The table of a side, a signal, a source or an incident wave: its keys are the fields of the dataclass."""
    return _table(kind, {one.name: _key(_hints(kind).get(one.name, Any), one.default) for one in fields(kind)})


@lru_cache(maxsize=64)
def model_part(kind: Any) -> type[Part]:
    """The table of a model: the parameters of its class, with two keys for an operator, one more for an integrator, and
    those of a named material.
    """
    hints = _hints(kind.__init__)
    keys: dict[str, Any] = {}
    for name, one in signature(kind).parameters.items():
        if isinstance(hints.get(name), type) and issubclass(hints[name], LatticeModel):
            keys[name] = (_of_both(kind, hints[name]), Field(description=explained(kind)[1].get(name)))
        elif name in ("operator", "kernel"):
            words = "The horizon and the weights of the bonds within it."
            keys["kernel"] = (KernelPart | None, Field(None, description=words))
        else:
            keys[name] = _key(hints.get(name, Any), MISSING if one.default is one.empty else one.default)
        if name == "operator":
            words = "Stencil of the classical operator, instead of a kernel."
            given = Literal["finite-difference", "finite-element"] | None
            keys["stencil"] = (given, Field(None, description=words))
        if name == "integrator":
            words = "Number of stages of the integrator rkc; 20 unless given."
            keys["stages"] = (Whole | None, Field(None, description=words))
    if "density" in keys and {"young", "speed"} & keys.keys():
        words = "Named material whose constants it has (`fh.materials`); those given in addition take precedence."
        keys["of"] = (Named | None, Field(None, description=words))
        words = "Name of the medium in results, pictures and reports; that of a named material unless given."
        keys["name"] = (str | None, Field(None, description=words))
    return _table(kind, keys)


def _of_both(kind: Any, part: Any) -> Any:
    """The table of a model that is part of another one, which determines its `type`."""
    table = model_part(part)
    given = {"type": (Literal[part.tag], Field(part.tag, description=table.model_fields["type"].description))}
    return _made(f"{kind.__name__}{part.__name__}Part", table, given, table.__doc__)


def _made(name: str, base: Any, keys: dict[str, Any], doc: str | None = None) -> Any:
    """A table with additional keys, which bring their own descriptions: it has no source to read docstrings from."""
    settings = {"use_attribute_docstrings": False}
    return create_model(name, __base__=base, __doc__=doc, __cls_kwargs__=settings, **keys)


def _table(kind: Any, keys: dict[str, Any]) -> type[Part]:
    """A table with these keys, described by the docstring of the class."""
    brief, says = explained(kind)
    for name in says.keys() & keys.keys():
        hint, default = keys[name]
        if not isinstance(default, FieldInfo):  # which has a description
            keys[name] = (hint, Field(default, description=says[name]))
    given: dict[str, Any] = {"type": (Literal[kind.tag], Field(description=brief)), **keys}
    return _made(f"{kind.__name__}Part", Part, given)


def explained(kind: type) -> tuple[str, dict[str, str]]:
    """First paragraph of a class docstring; and for each parameter, its choice of values and its description."""
    text = inspect.cleandoc(kind.__doc__ or "")
    listed = re.search(r"^Parameters\n-+\n(.*?)(?=^\w+\n-+$|\Z)", text, re.DOTALL | re.MULTILINE)
    says: dict[str, str] = {}
    one = re.compile(r"^(\w[\w, ]*?)(?: : ([^\n]*))?\n((?:[ \t]+[^\n]*\n|\n)*)", re.MULTILINE)
    for names, given, below in one.findall(f"{listed[1]}\n" if listed else ""):
        choice = re.match(r"\{(.*)\}", given)
        words = f"{choice[1]}. {_line(below)}".strip() if choice else _line(below)
        says |= {name.strip(): words for name in names.split(",") if words}
    return _line(text.split("\n\n")[0]), says


def _line(text: str) -> str:
    """A paragraph of a docstring as one line, without formulas and backquotes."""
    return " ".join(re.sub(r",? :math:`[^`]*`|`", "", text).split())


def _hints(given: Any) -> dict[str, Any]:
    try:
        return get_type_hints(given)
    except NameError:  # types that are known only within a function
        return {}


def _key(hint: Any, default: Any) -> tuple[Any, Any]:
    """Type and default of a key. TOML has no None: the key is omitted, or false where None is not the default. A type
    without a counterpart in TOML is checked by the class itself.
    """
    options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    found = [kind for option in options if (kind := _of_toml(option)) is not None]
    if found and NoneType in options:
        found.append(None if default is None else Literal[False])
    if isinstance(default, tuple):  # as TOML writes it
        default = list(default)
    return reduce(or_, found) if found else Any, ... if default is MISSING else default


def _of_toml(hint: Any) -> Any:
    """The counterpart of a type in TOML; None if there is none."""
    inner, origin = get_args(hint), get_origin(hint)
    if origin is Literal:
        return hint
    if origin in (tuple, list, Sequence):
        return list[_of_toml(inner[0]) or Any]  # type: ignore[misc]
    if isinstance(origin, type) and issubclass(origin, Mapping):
        values = reduce(or_, map(_of_toml, get_args(inner[1]) or inner[1:]))
        return dict[str, values]  # type: ignore[valid-type]
    plain = {float: Number, int: Whole, bool: Flag, str: str, np.ndarray: list[Number], Path: FilePath}
    return (plain | {fh.Weibull: WeibullPart}).get(hint)


def case_part() -> type[CasePart]:
    """The table of a complete case file, with the sides, models, sources and signals that are currently registered."""
    known = (side_kinds(), model_kinds(), source_kinds(), signal_kinds(), incident_kinds())
    return _case_part(*(tuple(kinds.values()) for kinds in known))


@lru_cache(maxsize=64)
def _case_part(
    sides: tuple[Any, ...],
    models: tuple[Any, ...],
    sources: tuple[Any, ...],
    signals: tuple[Any, ...],
    waves: tuple[Any, ...],
) -> type[CasePart]:
    factor = _tagged({_PLAIN: str | Number, **{kind.tag: part_of(kind) for kind in signals}}, _PLAIN)
    side: Any = _one_of([*map(part_of, sides)])
    load, constraint = (_one_of([_timed(part, factor) for part in parts]) for parts in (_LOADS, _CONSTRAINTS))
    local = {kind.tag: _timed(part_of(kind), factor, "time") for kind in sources}
    lists = {
        "source": _tagged({"source": _timed(SourcePart, factor), **local}, "source"),
        "incident": _tagged({kind.tag: _incident(kind, factor) for kind in waves}, fh.IncidentWave.tag),
        "load": load,
        "constraint": constraint,
    }
    words = {name: one.description for name, one in CasePart.model_fields.items()}
    given: dict[str, Any] = {name: (list[one], Field([], description=words[name])) for name, one in lists.items()}  # type: ignore[valid-type]
    for name in ("boundary", "boundary_T"):
        given[name] = (dict[str, side], Field({}, description=words[name]))
    given["model"] = (_one_of([*map(model_part, models)]), Field(description=words["model"]))
    return _made("CasePart", CasePart, given)


def _one_of(parts: Sequence[type[Part]]) -> Any:
    """One of several tables, selected by `type`."""
    return Annotated[reduce(or_, parts), Field(discriminator="type")]


def _tagged(options: Mapping[str, Any], plain: str) -> Any:
    """One of several tables, selected by `type`; `plain` where the value is not a table or has no type."""

    def tag(value: Any) -> Any:
        return value.get("type", plain) if isinstance(value, Mapping) else getattr(value, "type", plain)

    return Annotated[reduce(or_, [Annotated[one, Tag(name)] for name, one in options.items()]), Discriminator(tag)]


def _incident(kind: Any, factor: Any) -> type[Part]:
    """The table of an incident wave; plane waves may omit `type`, and the box is a table as well."""
    part, plain = part_of(kind), kind is fh.IncidentWave
    keys = part.model_fields
    given: dict[str, Any] = {"within": (BoxPart | None, keys["within"])}
    if plain:
        given["type"] = (Literal[kind.tag], Field(kind.tag, description=keys["type"].description))
    return _made(part.__name__, _timed(part, factor, "signal"), given, part.__doc__)


def _timed(part: type[Part], factor: Any, *names: str) -> type[Part]:
    """The same table with signals allowed as functions of time, for the given keys and those marked as such."""
    given = {
        name: (factor | None if one.default is None else factor, one)
        for name, one in part.model_fields.items()
        if name in names or _OF_TIME in one.metadata
    }
    lists = factor | list[factor | Literal[False]] | None
    given |= {name: (lists, one) for name, one in part.model_fields.items() if _OF_TIMES in one.metadata}
    return _made(part.__name__, part, given, part.__doc__)


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
    whole = case.model_json_schema()
    for name, table in {"CasePart": whole, **whole["$defs"]}.items():
        for key, found in table.get("properties", {}).items():
            if (si := measured(name, key)) is not None:
                _take_units(found)
                found["unit"] = si
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **whole,
        "title": "farhorizon case",
        "description": f"A case file of farhorizon {__version__}.",
    }


def _take_units(found: Any) -> None:
    """Allow the numbers of a schema to be strings with a unit, too."""
    if isinstance(found, dict):
        if found.get("type") == "number":
            found |= {"type": ["number", "string"], "pattern": f"^{QUANTITY}$"}
        for name, inner in found.items():
            if name != "default":
                _take_units(inner)
    elif isinstance(found, list):
        for inner in found:
            _take_units(inner)
