"""What cracks spend as they run, over the fracture energy that the material was given, in the infinite plane.

A growing pressure in a straight crack drives both its ends. In a medium without edges nothing comes back to them, and
the intensity of a pressed crack falls as it grows, so that it runs straight, at a speed that follows the pressure, and
slower than Rayleigh waves, the limit of cracks in mode I (Freund, 1990, Dynamic Fracture Mechanics). The energy of the
bonds that break per area of new crack must be the fracture energy: of bond-based materials by the sum over the bonds
across a plane, of others by `fh.calibrated_stretch`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.medium.kernel import Kernel
from farhorizon.models import Elastic
from farhorizon.studies.collection import Outcome, Row
from farhorizon.studies.toughness import calibrated_stretch, pressed_crack, steady_energy
from farhorizon.validation.validations import validation

GRIFFITH = "Griffith (1921), The phenomena of rupture and flow in solids"
ENERGY = 1e-4
HORIZON, NODES = 0.75, 3  # and nodes in it
HALF = 6.0  # half length of the crack, in horizons
RATES = (0.05, 0.08)  # of the pressure: cracks at about a third and two fifths of the Rayleigh speed
MATERIALS: dict[str, dict[str, Any]] = {
    "bond-based": {},
    "state-based": {"poisson": 0.3},
    "correspondence": {"poisson": 0.3, "stabilisation": 1.0},
}


def solid(material: str) -> Elastic:
    """A material with the fracture energy."""
    kernel, options = Kernel(HORIZON, exponent=1), MATERIALS[material]
    if material == "bond-based":
        return Elastic(kernel, young=1.0, fracture_energy=ENERGY)
    plain = Elastic(kernel, young=1.0, material=material, **options)
    stretch = calibrated_stretch(plain, HORIZON / NODES, ENERGY)
    return Elastic(kernel, young=1.0, material=material, critical_stretch=stretch, **options)


def rayleigh_speed(model: Elastic) -> float:
    """Of waves along a free face, by the cubic equation of their squared speed over that of S waves."""
    k = 1 / model.speed_ratio**2
    roots = np.roots([1, -8, 24 - 16 * k, -16 * (1 - k)])
    real = roots[np.abs(roots.imag) < 1e-9].real
    return float(np.sqrt(real[(real > 0) & (real < 1)][0])) * model.s_speed


@validation(
    "fracture-energy", GRIFFITH, "energy that running cracks spend, of each material, and their speeds", "a minute"
)
def fracture_energy(folder: Path) -> Outcome:
    """Two growing pressures for each material."""
    from farhorizon.pictures.curves import curve_panels

    rows, spent, speeds = [], [], []
    for material in MATERIALS:
        model = solid(material)
        limit = rayleigh_speed(model)
        for rate in RATES:
            tips = pressed_crack(model, HORIZON / NODES, rate, HALF)
            way, steady = np.nansum(tips.data["advance"], axis=1), steady_energy(tips, HORIZON)
            fastest = float(np.nanmax(tips.data["speed"])) / limit
            case = f"{material}, pressure grows by {rate:g}"
            rows += [
                Row(f"energy per new area over the fracture energy, {case}", tips.energy_release() / ENERGY, 1.0),
                Row(f"the same without the first two horizons, {case}", (steady or np.nan) / ENERGY, 1.0),
                Row(f"largest speed over that of Rayleigh waves, {case}", fastest, note="below 1"),
            ]
        spent.append((material, way / HORIZON, (tips.dissipated - tips.dissipated[0]) / (ENERGY * HORIZON)))
        speeds.append((material, tips.times, tips.data["speed"][:, 0] / limit))
    most = max(float(way[-1]) for _, way, _ in spent)
    spent.append(("fracture energy", np.array([0.0, most]), np.array([0.0, most])))
    picture = folder / "fracture-energy.png"
    curve_panels(
        [("energy spent", spent), ("one tip", speeds)],
        picture,
        xlabel=("way of both tips / horizon", "t"),
        ylabel=("energy / (fracture energy x horizon)", "speed / Rayleigh speed"),
    )
    return Outcome(rows, pictures=[picture])
