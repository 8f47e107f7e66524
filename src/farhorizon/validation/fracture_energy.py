r"""Energy that running cracks spend on new area, relative to the specified fracture energy.

In the infinite plane a crack follows a pair of forces, straight and as fast as they move
(`farhorizon.studies.toughness`). The energy of the broken bonds per new length should be the fracture energy of the
material, for any forces and at any angle of the crack to the lattice; the critical stretch is that of
`calibrated_stretch`, determined from two cracks. The energy increases with the speed, because released nodes oscillate
and break bonds beside the plane of the crack. It is compared with the energy flux into the tip, computed by the domain
J integral of displacements, velocities and accelerations around it. No tip in mode I is faster than Rayleigh waves, at
whose speed no energy flows into it (Freund, 1990, Dynamic Fracture Mechanics).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from farhorizon import Elastic, Kernel, calibrated_stretch
from farhorizon.studies.collection import Outcome, Row
from farhorizon.studies.toughness import RunningCrack, rayleigh_speed, running_crack
from farhorizon.validation import validation

FREUND = "Freund (1990), Dynamic Fracture Mechanics; Griffith (1921)"
ENERGY = 2e-4
START = 3.0  # of the curves: distance travelled by the tip, in horizons
#: Materials with the number of nodes in their horizon; cracks in a correspondence material need one more to spend as
#: much at all angles. A stronger stabilisation would make short waves faster than long ones.
MATERIALS: dict[str, tuple[int, dict[str, Any]]] = {
    "bond-based": (3, {}),
    "state-based": (3, {"material": "state-based", "poisson": 0.3}),
    "correspondence": (4, {"material": "correspondence", "poisson": 0.3, "stabilisation": 0.2}),
}
#: Speed relative to the Rayleigh wave speed, angle to the lattice, forces relative to those expected.
SLOW = ((0.2, 0.0, 1.3), (0.3, 0.4, 1.2))
FINER = (0.3, 0.0, 1.3)  # with one more node in the horizon
FAST = (0.4, 0.0, 1.2)


def material(name: str, nodes: int) -> tuple[Elastic, float]:
    """A material whose cracks spend the fracture energy, and the spacing of its lattice."""
    kernel, spacing = Kernel(1.0, exponent=1), 1.0 / nodes
    stretch = calibrated_stretch(Elastic(kernel, young=1.0, **MATERIALS[name][1]), spacing, ENERGY)
    return Elastic(kernel, young=1.0, critical_stretch=stretch, **MATERIALS[name][1]), spacing


def pulled(model: Elastic, spacing: float, speed: float, turn: float, push: float) -> tuple[RunningCrack, float]:
    """A crack that has run, and the largest speed of its tips relative to the Rayleigh wave speed."""
    crack = running_crack(model, spacing, ENERGY, speed, turn, push)
    fastest = float(np.nanmax(crack.tips.data["speed"]))
    return crack, fastest / rayleigh_speed(model.lame, model.shear, model.density)


@validation(
    "fracture-energy",
    FREUND,
    "what cracks that run spend, of three materials in the infinite plane",
    "a minute",
    full="minutes",
)
def fracture_energy(folder: Path, full: bool = False) -> Outcome:
    """Energy of broken bonds per new length, flux into the tip, and speeds; with `full` also on a finer lattice."""
    from farhorizon.pictures.curves import curve_panels

    rows, panels, largest = [], [], 0.0
    for name, (reach, _) in MATERIALS.items():
        cases = [(reach, *SLOW[0]), (reach, *SLOW[1]), *([(reach + 1, *FINER)] if full else []), (reach, *FAST)]
        models = {nodes: material(name, nodes) for nodes in {nodes for nodes, *_ in cases}}
        curves = [("fracture energy", np.array([START, 22.0]), np.ones(2))]
        for nodes, speed, turn, push in cases:
            crack, fastest = pulled(*models[nodes], speed, turn, push)
            largest = max(largest, fastest)
            what = f"{name}, {nodes} nodes in the horizon, {speed:g} c_R" + (f", at {turn:g} rad" if turn else "")
            rows.append(Row(f"spent over the fracture energy: {what}", crack.spent / ENERGY, 1.0))
            some = crack.way > START
            used = crack.tips.dissipated[some] / (ENERGY * crack.way[some])
            curves.append((f"{nodes} nodes, {speed:g} $c_R$, {turn:g} rad", crack.way[some], used))
            if speed == FAST[0]:
                rows.append(Row(f"flux into the tip over what is spent: {what}", crack.flux() / crack.spent))
        panels.append((name, curves))
    rows.append(Row("largest speed of a tip over that of Rayleigh waves", largest))
    picture = folder / "fracture-energy.png"
    curve_panels(panels, picture, xlabel="way of the tip / horizon", ylabel="spent / fracture energy")
    return Outcome(rows, pictures=[picture])
