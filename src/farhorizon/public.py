"""Every name of the public interface, see `farhorizon.__all__`."""

from farhorizon.body.body import Body
from farhorizon.boundaries import (
    Auto,
    Exact,
    Extended,
    FirstOrder,
    Fixed,
    Free,
    Higdon,
    LatticePML,
    NonlocalPML,
    Periodic,
    PlaneWave,
    Side,
    Sponge,
)
from farhorizon.checks.certificate import Certificate
from farhorizon.errors import FarhorizonError, FileFormatError, InputError, UnstableError, ValidityWarning
from farhorizon.files.results import open_results
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.masks import ImageMask, Text
from farhorizon.geometry.shapes import Ball, Box, Disc, DiscCut, PointCut, Polygon, PolygonCut, Polyline, Rectangle
from farhorizon.inputs.conditions import Convection, Flux, Insulated, Temperature
from farhorizon.inputs.cracks import Crack
from farhorizon.inputs.expressions import Expression
from farhorizon.inputs.incidence import IncidentWave
from farhorizon.inputs.loads import BodyForce, Traction
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.inputs.sources import Source
from farhorizon.inputs.specimens import Specimen
from farhorizon.medium.integrators import RungeKuttaChebyshev
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models import Beam, Corrosion, Diffusion, Elastic, Heat, LatticeModel, Wave, speed_of_current
from farhorizon.simulation.probes import Probes
from farhorizon.simulation.setup import Setup
from farhorizon.simulation.simulation import Simulation
from farhorizon.simulation.steps import WholeSteps
from farhorizon.studies.tuning import tuned

__all__ = [
    "Auto",
    "Ball",
    "Beam",
    "Body",
    "BodyForce",
    "Box",
    "Certificate",
    "Convection",
    "Corrosion",
    "Crack",
    "Diffusion",
    "Disc",
    "DiscCut",
    "Elastic",
    "Exact",
    "Expression",
    "Extended",
    "FarhorizonError",
    "FileFormatError",
    "FirstOrder",
    "Fixed",
    "Flux",
    "Free",
    "Heat",
    "Higdon",
    "ImageMask",
    "IncidentWave",
    "InputError",
    "Insulated",
    "Kernel",
    "Lattice",
    "LatticeModel",
    "LatticePML",
    "NonlocalPML",
    "Periodic",
    "PlaneWave",
    "PointCut",
    "Polygon",
    "PolygonCut",
    "Polyline",
    "Prescribed",
    "Probes",
    "Rectangle",
    "RungeKuttaChebyshev",
    "Setup",
    "Side",
    "Simulation",
    "Source",
    "Specimen",
    "Sponge",
    "Stencil",
    "Temperature",
    "Text",
    "Traction",
    "UnstableError",
    "ValidityWarning",
    "Wave",
    "WholeSteps",
    "open_results",
    "speed_of_current",
    "tuned",
]
