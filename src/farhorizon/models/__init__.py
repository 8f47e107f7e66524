"""The physics, one file each."""

from farhorizon.models.beam import Beam
from farhorizon.models.correspondence import Correspondence
from farhorizon.models.corrosion import Corrosion, speed_of_current
from farhorizon.models.diffusion import Diffusion
from farhorizon.models.elastic import Elastic
from farhorizon.models.heat import Heat
from farhorizon.models.model import LatticeModel
from farhorizon.models.thermoelastic import Thermoelastic
from farhorizon.models.wave import Wave

__all__ = [
    "Beam",
    "Correspondence",
    "Corrosion",
    "Diffusion",
    "Elastic",
    "Heat",
    "LatticeModel",
    "Thermoelastic",
    "Wave",
    "speed_of_current",
]
