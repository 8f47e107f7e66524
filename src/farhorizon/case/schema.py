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
    """Least coordinate along each axis."""
    upper: list[Number]
    """Largest coordinate along each axis."""


class PolygonPart(Part):
    points: list[list[Number]]
    """Corners, in order."""


class TextPart(Part):
    text: str
    """What is written."""
    height: Number
    """Height of a capital letter."""
    centre: list[Number] | None = None
    """Centre of what is drawn; the origin unless given."""
    font: str = "DejaVu Sans"
    """A font family that matplotlib finds."""
    bold: Flag = False
    """Bold letters."""


class ImagePart(Part):
    file: FilePath
    """A picture (PNG, JPEG), by its path from the case file; its dark pixels are the region."""
    width: Number
    """Width of the whole picture."""
    centre: list[Number] | None = None
    """Centre of the whole picture; the origin unless given."""
    threshold: Number = 0.5
    """Between 0 (black) and 1 (white): darker pixels are taken."""


class VoxelsPart(Part):
    file: FilePath
    """An NPY array or a TIFF image or stack of images, by its path from the case file."""
    size: Number
    """Edge of a voxel."""
    lower: list[Number] | None = None
    """Least corner of the whole grid; its middle is the origin unless given."""
    labels: list[Whole] | None = None
    """Values of the voxels that are the region; all but 0 unless given."""


class MeshPart(Part):
    file: FilePath
    """A closed surface (STL, OBJ, PLY), by its path from the case file."""
    scale: Number = 1.0
    """Factor of its coordinates."""
    centre: list[Number] | None = None
    """Middle of its bounding box; where the file has it unless given."""


class ElementsPart(Part):
    file: FilePath
    """A mesh of Gmsh (MSH 4.1), by its path from the case file."""
    group: str | None = None
    """Name of its physical group; all of the mesh unless given."""
    scale: Number = 1.0
    """Factor of its coordinates."""


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
    """One shape, with shapes taken out of it."""

    disc: DiscPart | None = None
    """A disc (2D)."""
    ball: DiscPart | None = None
    """A ball (3D)."""
    box: BoxPart | None = None
    """An interval, a rectangle or a box."""
    polygon: PolygonPart | None = None
    """A polygon (2D)."""
    text: TextPart | None = None
    """Letters (2D)."""
    image: ImagePart | None = None
    """The dark part of a picture (2D)."""
    voxels: VoxelsPart | None = None
    """Cells of a label image or a stack of images (1D, 2D, 3D)."""
    mesh: MeshPart | None = None
    """What a closed surface encloses (3D)."""
    elements: ElementsPart | None = None
    """What triangles (2D) or tetrahedra (3D) of a mesh cover."""
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
    """What plain numbers of the case are counted in, so that others may have units of their own ("5 mm")."""

    length: str | None = None
    """Such as "mm"."""
    time: str | None = None
    """Such as "us"."""
    mass: str | None = None
    """Such as "kg"; or give one of force, pressure, density, energy, from which it follows."""
    force: str | None = None
    """In place of the mass, such as "N"."""
    pressure: str | None = None
    """In place of the mass, such as "GPa"."""
    density: str | None = None
    """In place of the mass, such as "g/cm^3"."""
    energy: str | None = None
    """In place of the mass, such as "J"."""
    temperature: str | None = None
    """Such as "degC" or "K"."""
    amount: str | None = None
    """Of substance, such as "mol"."""


class LatticePart(Part):
    spacing: Number
    """Distance of neighbouring nodes, the same along every axis."""
    lower: list[Number] | None = None
    """Least coordinate of the near field along each axis: a node lies there."""
    upper: list[Number] | None = None
    """Largest coordinate of the near field along each axis, a whole number of spacings from lower."""
    window: RegionPart | None = None
    """Part of the medium that is shown, instead of lower and upper; nothing ends at its edge."""
    body: RegionPart | None = None
    """A body that ends, within lower and upper: nodes outside it do not exist."""


class KernelPart(Part):
    horizon: Number
    """Radius within which nodes interact; three spacings is usual."""
    exponent: Whole = 2
    """p in the weight w(r)/r^p of a bond, 0 to 3."""
    influence: str = "constant"
    """Influence function w(r): constant, linear (1 - r/horizon) or gaussian (exp(-(r/width)^2))."""
    width: Number | None = None
    """Width of the gaussian; a third of the horizon unless given."""
    volume: str = "ramp"
    """ramp: partial volumes at the edge of the family; full: whole cells whose centre lies within the horizon."""
    calibrate: Flag = True
    """Rescale the weights so that long waves have exactly the given speed or diffusivity."""


class WeibullPart(Part):
    """A constant that scatters from cell to cell."""

    type: Literal["weibull"]
    """A Weibull distribution."""
    scale: Number
    """The value that a share 1/e, 37 %, exceeds."""
    modulus: Number
    """The larger, the less it scatters."""
    cell: Number
    """Edge of the cells that have one value each, such as the size of grains; the spacing: each node has its own."""
    seed: Whole = 0
    """Another one, another sample."""


class MaterialPart(Part):
    """Constants of the medium in a region, in place of the model's."""

    region: RegionPart
    """Where; later regions go before earlier ones."""
    of: Named | None = None
    """A named material, whose constants it has (`fh.materials`); what is given beside it goes before."""
    name: str | None = None
    """What it is called in results, pictures and reports; that of a named material unless given."""
    young: str | Number | WeibullPart | None = None
    """Young's modulus there."""
    poisson: str | Number | WeibullPart | None = None
    """Poisson's ratio there."""
    bulk: str | Number | WeibullPart | None = None
    """Bulk modulus there."""
    shear: str | Number | WeibullPart | None = None
    """Shear modulus there."""
    speed: str | Number | WeibullPart | None = None
    """Speed of waves there."""
    density: str | Number | WeibullPart | None = None
    """Density there."""
    critical_stretch: str | Number | WeibullPart | None = None
    """Critical stretch of its bonds; one between two regions breaks as the weaker end does."""
    fracture_energy: str | Number | WeibullPart | None = None
    """Fracture energy there."""


class CutPart(Part):
    points: list[list[Number]] | None = None
    """Polyline (2D), corners of a polygon (3D), or a position (1D)."""
    rectangle: dict[Literal["corner", "edge1", "edge2"], list[Number]] | None = None
    """In 3D: corner and two edges."""
    disc: dict[Literal["centre", "normal", "radius"], list[Number] | Number] | None = None
    """In 3D: centre, normal and radius."""


class CrackPart(CutPart):
    factor: Number = 0.0
    """What is left of the bonds that it crosses: 0 nothing, 1 all."""
    opens: Number = 0.0
    """Time from which on it is there."""


#: Classes of conditions by type name.
CONDITIONS: dict[str, type] = {kinds.hyphened(kind.__name__): kind for kind in get_args(Constraint)}


class ConstraintPart(Part):
    """A condition on a side, or in a region."""

    type: Literal[*CONDITIONS]  # type: ignore[valid-type]
    """Condition of heat conduction or diffusion."""
    side: str | None = None
    """A side, such as "x-"; or give a region."""
    region: RegionPart | None = None
    """The nodes in it; or give a side."""
    value: str | Number | None = None
    """Temperature, flux into the body, or of convection the ambient temperature; may depend on place and time."""
    kind: str | None = None
    """How a side holds it: node, volume or mirror; a flux: source, layer or mirror."""
    transfer: Number | None = None
    """Of convection: power / (area temperature)."""
    within: RegionPart | None = None
    """Only nodes in it."""


class SpecimenPart(Part):
    region: RegionPart
    """Where metal is."""
    concentration: Number = 1.0
    """Of the metal, in the units of the saturation."""


class SourcePart(Part):
    """A right-hand side on all nodes."""

    type: Literal["source"] = "source"
    """A right-hand side on all nodes."""
    field: Literal["u", "T"] = "u"
    """The field that it drives: of a thermoelastic solid T, the temperature, too, by a power per volume."""
    value: Value
    """Right-hand side of the equation, a function of place and time t; of vectors one a component."""
    time: Factor = 1.0
    """Factor of t: an expression, or a table with a signal."""


class TractionPart(Part):
    """A force per area on a free side of an elastic medium."""

    type: Literal["traction"]
    """A force per area on a free side."""
    side: str
    """"x-", "y+", ..."""
    value: list[Number]
    """One component an axis."""
    between: list[tuple[Number, Number]] | None = None
    """Where it acts, along each of the other axes; the whole side unless given."""
    time: Factor = 1.0
    """Factor of t: an expression, or a table with a signal."""


class PressurePart(CutPart):
    """A pressure on the faces of a crack, or on the rim of a hole, of an elastic medium."""

    type: Literal["pressure"]
    """A pressure in a crack, given as under crack by points, rectangle or disc, or in a hole."""
    region: RegionPart | None = None
    """The hole, instead of a crack: a region without nodes of the body."""
    value: Number | list[list[Number]]
    """Force per area that presses the faces apart, or a symmetric matrix P: tractions -P n, n pointing away from the
    body."""
    time: Factor = 1.0
    """Factor of t: an expression, or a table with a signal."""


class BodyForcePart(Part):
    """A force per volume on an elastic medium."""

    type: Literal["body-force"]
    """A force per volume."""
    value: list[str | Number]
    """One component an axis, functions of place and time."""
    time: Factor = 1.0
    """Factor of t: an expression, or a table with a signal."""


class ThermalPart(Part):
    """A temperature that strains an elastic medium."""

    type: Literal["thermal"]
    """A temperature that strains the solid."""
    temperature: str | Number
    """A function of place and time t."""
    expansion: str | Number
    """Coefficient of linear expansion, where it varies a function of place."""
    reference: Number
    """Temperature at which the solid is free of stress."""
    every: Number | None = None
    """Time between two looks at the temperature, which changes evenly between them; each time step unless given."""


class PrescribedPart(Part):
    """Nodes that follow a value for a while."""

    type: Literal["prescribed"]
    """Nodes that follow a value."""
    points: list[list[Number]] | None = None
    """Each stands for the node nearest to it; or give a region."""
    region: RegionPart | None = None
    """The nodes in it; or give points."""
    value: Factors = None
    """Value as a function of t: an expression, or a table with a signal; of displacements a list, one entry an axis,
    false for a component that is free."""
    velocity: Factors = None
    """Instead of a value, as that: from the initial values on the nodes move with it."""
    until: Number | None = None
    """The nodes are released after it; never unless given."""
    rate: str | Number | list[str | Number | Literal[False]] | None = None
    """Of waves: velocity with which they are released; the derivative of value unless given."""


class LinePart(Part):
    """Points at even distances along a line."""

    start: list[Number]
    """The first one."""
    end: list[Number]
    """The last one."""
    count: Whole
    """How many there are, both ends among them."""


class GridPart(Part):
    """Points on a grid."""

    lower: list[Number]
    """The least coordinates."""
    upper: list[Number]
    """The largest coordinates."""
    counts: list[Whole]
    """How many there are along each axis, both ends among them."""


class ReceiversPart(Part):
    """Points, on nodes or between them, at which a run is recorded in every step or in every few."""

    points: list[list[Number]] | None = None
    """Places; or give a line or a grid."""
    line: LinePart | None = None
    """Places along a line."""
    grid: GridPart | None = None
    """Places on a grid."""
    record: list[str] = ["u"]
    """u, v, gradient, strain, stress, pressure, divergence, curl, rotation, energy_flux."""
    every: Whole = 1
    """Steps from one record to the next."""
    interpolation: str = "sinc"
    """Between nodes: sinc, good to 1e-5, or linear, which needs the nodes next to the point alone."""
    name: str | None = None
    """In files and pictures; receivers, or receivers_0, receivers_1, ... unless given."""


class SpectraPart(Part):
    """Where the spectrum of the field is summed up while the run goes on."""

    points: list[list[Number]] | None = None
    """Places; or give a line, a grid, a region, or a plane by axis and position."""
    line: LinePart | None = None
    """Places along a line."""
    grid: GridPart | None = None
    """Places on a grid."""
    region: RegionPart | None = None
    """All nodes in it."""
    axis: str | None = None
    """Normal of a plane, x, y or z: all nodes of the layer of nodes nearest to it."""
    position: Number | None = None
    """Of the plane."""
    frequencies: list[Number]
    """In cycles per unit of time."""
    record: list[str] = ["u"]
    """u, gradient, strain, stress, pressure, divergence, curl, rotation."""
    every: Whole = 1
    """Steps from one term of the sums to the next; half the stable step allows 3."""
    interpolation: str = "sinc"
    """Between nodes: sinc or linear."""
    name: str | None = None
    """In files and pictures; spectra, or spectra_0, spectra_1, ... unless given."""


class StressIntensityPart(Part):
    """Stress intensity factors at the tips of cracks, in every step or in every few."""

    tips: list[list[Number]] | None = None
    """Ends of cracks; all that lie in the near field unless given."""
    radii: list[Number] | None = None
    """Of the two circles between which the field is read; as large as they may be unless given."""
    every: Whole = 1
    """Steps from one record to the next."""
    name: str | None = None
    """In files and pictures; stress_intensity, or stress_intensity_0, stress_intensity_1, ... unless given."""


class CrackTipsPart(Part):
    """Where the tips of cracks are while bonds break."""

    every: Whole = 20
    """Steps from one record to the next."""
    most: Whole = 7
    """Tips that are followed."""
    name: str | None = None
    """In files and pictures; crack_tips, or crack_tips_0, crack_tips_1, ... unless given."""


class FarFieldPart(Part):
    """What a run sends into the medium around it, from what it records around a box."""

    box: BoxPart | None = None
    """Around all that radiates or scatters; the near field less one reach of the stencil unless given."""
    frequencies: list[Number] = []
    """Cycles per time, of waves: those of the pattern."""
    points: list[list[Number]] | None = None
    """Receivers outside the box, at any distance."""
    directions: Whole = 180
    """Those of the pattern: so many from the x axis round, in space in each of the planes xy, yz and zx."""


class PowerPart(Part):
    """A surface through which the power of waves is recorded in every step."""

    region: RegionPart | None = None
    """What leaves it; or give an axis and a position."""
    axis: str | None = None
    """Normal of a plane: x, y or z."""
    position: Number | None = None
    """Of the plane, taken to the nearest middle between two nodes."""
    frequencies: list[Number] = []
    """Cycles per time, at which the energy that goes through is told."""
    name: str | None = None
    """In files and pictures; power, or power_0, power_1, ... unless given."""


class ShellPart(Part):
    """The shell of a box, recorded in every step for another run: `[[incident]]` with `type = "incident-record"`."""

    box: BoxPart | None = None
    """The near field less two reaches of the stencil unless given."""
    name: str | None = None
    """In the results file; shell, or shell_0, shell_1, ... unless given."""


class RunPart(Part):
    until: Number | Literal["static"]
    """End of the run; "static": when the waves have left."""
    tolerance: Number | None = None
    """Of a run to the static state: part of their largest value below which velocities are to fall; 1e-3 unless given.
    """
    limit: Number | None = None
    """Of a run to the static state: its latest end, which it must have; layers are chosen for it."""
    dt: Number | None = None
    """Time step; half of the largest stable one unless given."""
    dtype: str = "float64"
    """float64, or float32 for half the memory."""
    threads: Whole | None = None
    """Threads of the time loop; all that there are unless given."""
    topology: list[Whole] | None = None
    """Of a run on several processes (mpiexec): boxes of the lattice along each axis, as many as processes; those that
    exchange least unless given. One process does without.
    """


class OutputPart(Part):
    fields: list[Literal["u", "v", "T", "damage", "solid", "dissolved", "stress", "thermal_strain"]] | None = None
    """Fields in the results file; u, of a thermoelastic solid T, and what breaks or dissolves, unless given. "stress"
    of elastic media stands for its components and von Mises' stress."""
    every: Number | None = None
    """Time between two outputs; a fortieth of the run unless given."""
    probes: list[list[Number]] = []
    """Places where u is recorded."""
    probe_every: Number | None = None
    """Time between two records of the probes; every step unless given."""
    dtype: Literal["float32", "float64"] | None = None
    """Precision of the fields in the results file; that of the run unless given."""
    compress: Flag = False
    """Pack the fields in the results file, without loss; ParaView reads them still."""
    pictures: list[Number] | None = None
    """Times of the pictures; four even ones unless given."""
    balance: Flag = False
    """Record energies, or what has flowed in and out."""


_LOADS = (TractionPart, PressurePart, BodyForcePart, ThermalPart)
_CONSTRAINTS = (ConstraintPart, PrescribedPart)


class CasePart(Part):
    units: UnitsPart | None = None
    """What its numbers are counted in; any consistent units unless given."""
    lattice: LatticePart
    """The near field and its nodes."""
    model: Any
    """The physics."""
    material: list[MaterialPart] = []
    """Regions with other constants, of a body."""
    initial: dict[Literal["u", "v", "T"], Value] = {}
    """Values at t = 0, functions of place: u, of waves v = u_t too, of a thermoelastic solid T."""
    boundary: dict[str, Any] = {}
    """What stands on the sides: all, "x", "x-", "x+", ...; a lattice-pml all round unless given."""
    boundary_T: dict[str, Any] = {}
    """Of a thermoelastic solid: what stands on sides for the temperature, where that is something else."""
    specimen: list[SpecimenPart] = []
    """Metal, of a corrosion."""
    crack: list[CrackPart] = []
    """Cuts of bonds."""
    source: list[SourcePart] = []
    """Right-hand sides."""
    incident: list[Any] = []
    """Waves from outside."""
    load: list[Any] = []
    """Forces on an elastic medium."""
    constraint: list[Any] = []
    """Conditions on nodes."""
    coefficient: str | Number | dict[Literal["u", "T"], str | Number] | None = None
    """Factor of the bonds, a function of place: another material in part of the medium. Of a thermoelastic solid by
    field: of the stiffness under u, of the conductivity under T."""
    rule: str | None = None
    """Factor of a bond from those of its ends: both (the smaller one), arithmetic or harmonic."""
    rim: str = "free"
    """The surface of a body: free, or fixed at the background."""
    background: Number = 0.0
    """Uniform state of the medium, which the absorbing sides keep."""
    receivers: list[ReceiversPart] = []
    """Points at which a run is recorded step by step."""
    spectra: list[SpectraPart] = []
    """Spectra at chosen frequencies, summed up while the run goes on."""
    far_field: FarFieldPart | None = None
    """What is sent beyond the near field: receivers at any distance, patterns by direction and frequency."""
    power: list[PowerPart] = []
    """Surfaces through which the power of waves is recorded."""
    crack_tips: list[CrackTipsPart] = []
    """Tips of cracks, their ways and speeds, while bonds break."""
    stress_intensity: list[StressIntensityPart] = []
    """Stress intensity factors at the tips of cracks."""
    shell: list[ShellPart] = []
    """Boxes whose shells are recorded for another run."""
    run: RunPart
    """Time."""
    output: OutputPart = OutputPart()
    """What is recorded."""


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
            words = "The family of a node and its weights."
            keys["kernel"] = (KernelPart | None, Field(None, description=words))
        else:
            keys[name] = _key(hints.get(name, Any), MISSING if one.default is one.empty else one.default)
        if name == "operator":
            words = "Instead of a kernel the classical operator."
            given = Literal["finite-difference", "finite-element"] | None
            keys["stencil"] = (given, Field(None, description=words))
        if name == "integrator":
            words = "Of an integrator that has a choice; chosen for it."
            keys["stages"] = (Whole | None, Field(None, description=words))
    if "density" in keys and {"young", "speed"} & keys.keys():
        words = "A named material, whose constants it has (`fh.materials`); what is given beside it goes before."
        keys["of"] = (Named | None, Field(None, description=words))
        words = "What the medium is called in results, pictures and reports; that of a named material unless given."
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
    whole = case_part().model_json_schema()
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
