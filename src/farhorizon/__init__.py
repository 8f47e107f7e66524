"""farhorizon: peridynamic and classical waves, elasticity, diffusion, heat and corrosion in an unbounded medium, on a
small grid.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from farhorizon.case.case import read_case
    from farhorizon.public import *

__version__ = "0.1.0"

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
    "read_case",
    "speed_of_current",
    "tuned",
]


def __getattr__(name: str) -> Any:
    """Load names when they are wanted: NumPy, SciPy and the rest take a second, in which the command line must hear an
    interrupt.
    """
    from importlib import import_module
    from importlib.util import find_spec

    if name == "read_case":  # case files know every public name
        return import_module("farhorizon.case.case").read_case
    if name in __all__:
        return getattr(import_module("farhorizon.public"), name)
    if not name.startswith("_") and find_spec(f"farhorizon.{name}"):
        return import_module(f"farhorizon.{name}")
    raise AttributeError(f"module 'farhorizon' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
