"""farhorizon: peridynamic and classical waves and diffusion in an unbounded medium, on a small grid."""

from farhorizon.boundaries import Exact, FirstOrder, Fixed, Free, Higdon, LatticePML, Periodic, PlaneWave, Sponge
from farhorizon.certificate import Certificate
from farhorizon.conditions import Convection, Flux, Insulated, Temperature
from farhorizon.constraints import Prescribed
from farhorizon.cracks import Crack
from farhorizon.errors import FarhorizonError, FileFormatError, InputError, UnstableError
from farhorizon.expressions import Expression
from farhorizon.integrators import RungeKuttaChebyshev
from farhorizon.kernel import Kernel
from farhorizon.lattice import Lattice
from farhorizon.models import Beam, Diffusion, Heat, Wave
from farhorizon.results import open_results
from farhorizon.shapes import Ball, Box, Disc, DiscCut, PointCut, Polygon, PolygonCut, Polyline, Rectangle
from farhorizon.simulation import Simulation
from farhorizon.sources import Source
from farhorizon.stencil import Stencil

__version__ = "0.1.0"

__all__ = [
    "Ball", "Beam", "Box", "Certificate", "Convection", "Crack", "Diffusion", "Disc", "DiscCut", "Exact", "Expression", "FarhorizonError",
    "FileFormatError", "FirstOrder", "Fixed", "Flux", "Free", "Heat", "Higdon", "InputError", "Insulated", "Kernel", "Lattice", "LatticePML",
    "Periodic", "PlaneWave", "PointCut", "Polygon", "PolygonCut", "Polyline", "Prescribed", "Rectangle", "RungeKuttaChebyshev", "Simulation",
    "Source", "Sponge", "Stencil",
    "Temperature", "UnstableError", "Wave", "open_results",
]  # fmt: skip
