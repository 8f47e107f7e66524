"""Every name of the public interface, see `farhorizon.__all__`."""

from farhorizon.boundaries import Auto, Exact, Extended, FirstOrder, Fixed, Free, Higdon, LatticePML, NonlocalPML, Periodic, PlaneWave, Sponge
from farhorizon.certificate import Certificate
from farhorizon.conditions import Convection, Flux, Insulated, Temperature
from farhorizon.constraints import Prescribed
from farhorizon.correspondence import Body
from farhorizon.cracks import Crack
from farhorizon.errors import FarhorizonError, FileFormatError, InputError, UnstableError, ValidityWarning
from farhorizon.expressions import Expression
from farhorizon.incidence import IncidentWave
from farhorizon.integrators import RungeKuttaChebyshev
from farhorizon.kernel import Kernel
from farhorizon.lattice import Lattice
from farhorizon.loads import BodyForce, Traction
from farhorizon.models import Beam, Corrosion, Diffusion, Elastic, Heat, Wave, speed_of_current
from farhorizon.outlines import ImageMask, Text
from farhorizon.probes import Probes
from farhorizon.results import open_results
from farhorizon.shapes import Ball, Box, Disc, DiscCut, PointCut, Polygon, PolygonCut, Polyline, Rectangle
from farhorizon.simulation import Simulation
from farhorizon.sources import Source
from farhorizon.specimens import Specimen
from farhorizon.stencil import Stencil
from farhorizon.steps import WholeSteps
from farhorizon.tuning import tuned

__all__ = [
    "Auto", "Ball", "Beam", "Body", "BodyForce", "Box", "Certificate", "Convection", "Corrosion", "Crack", "Diffusion", "Disc", "DiscCut", "Elastic",
    "Exact", "Expression", "Extended", "FarhorizonError", "FileFormatError", "FirstOrder", "Fixed", "Flux", "Free", "Heat", "Higdon", "ImageMask",
    "IncidentWave", "InputError", "Insulated", "Kernel", "Lattice", "LatticePML", "NonlocalPML", "Periodic", "PlaneWave", "PointCut", "Polygon",
    "PolygonCut", "Polyline", "Prescribed", "Probes", "Rectangle", "RungeKuttaChebyshev", "Simulation", "Source", "Specimen", "Sponge", "Stencil",
    "Temperature", "Text", "Traction", "UnstableError", "ValidityWarning", "Wave", "WholeSteps", "open_results", "speed_of_current", "tuned",
]  # fmt: skip
