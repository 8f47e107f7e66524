"""Cracks that follow a pair of forces, and the critical stretch for which they spend a given fracture energy; see
`farhorizon.simulation.setup.crack_calibration`.
"""

from __future__ import annotations

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.medium.fracture import stretch_that_spends
from farhorizon.medium.kernel import Kernel
from farhorizon.models import Elastic
from farhorizon.models.elastic import CALIBRATIONS
from farhorizon.simulation.setup.crack_calibration import SPEED, RunningCrack, crack_after_forces, energy_factor
from farhorizon.simulation.setup.crack_calibration import rayleigh_speed as rayleigh_speed
from farhorizon.simulation.simulation import Simulation


def running_crack(
    model: Elastic,
    spacing: float,
    energy: float,
    speed: float = SPEED,
    turn: float = 0.0,
    push: float = 1.2,
    dim: int = 2,
) -> RunningCrack:
    """Run a crack that follows a pair of forces, as
    `farhorizon.simulation.setup.crack_calibration.crack_after_forces`.
    """
    return crack_after_forces(Simulation.of, model, spacing, energy, speed, turn, push, dim)


def calibrated_stretch(
    model: Elastic, spacing: float, fracture_energy: float, dim: int = 2, calibrate: str = "running"
) -> float:
    r"""The critical stretch for which a running crack dissipates a given fracture energy.

    In a state-based or correspondence material, the energy that is lost with a bond depends on all bonds of its two
    nodes, so that the energy spent by a crack depends on the sequence in which it breaks them; in a bond-based material
    a crack also breaks some bonds next to its plane. The energy is determined from cracks that run at 0.3 of the
    Rayleigh wave speed, driven by a pair of forces: in 2D, in the infinite plane, from two of them, one along an axis
    of the lattice and one at 0.18 rad to it; in 3D from one along an axis, through a slab in plane strain
    (`running_crack`). Since forces are linear, this energy is proportional to the square of the critical stretch. The
    pair is chosen on the basis of the energy, and another crack is computed if the energy turns out to be different.
    With three nodes in the horizon this takes some twenty seconds in 2D and a minute in 3D, once: the result is kept in
    the cache of the program, for any Young's modulus, density and units.

    A simulation does the same for a state-based or correspondence material with a `fracture_energy`.

    Parameters
    ----------
    model : Elastic
        The material; its own strength is irrelevant.
    spacing : float
        Spacing of the lattice.
    fracture_energy : float
        Energy per area of new crack.
    dim : {2, 3}
        Number of dimensions.
    calibrate : {"running", "static"}
        "static": the stretch for which a crack at rest, along an axis of the lattice through a slowly pulled strip,
        begins to grow at the fracture energy.

    Returns
    -------
    float

    Raises
    ------
    InputError
        Constants that vary; less than 2 or more than 12 (in 3D 5) spacings in the horizon; a material in which no crack
        runs, or no energy is spent, as in a correspondence material without stabilisation.

    Examples
    --------
    >>> import farhorizon as fh
    >>> rock = fh.Elastic(fh.Kernel(2.0, 1), 50.0, 0.3, material="state-based")
    >>> stretch = fh.calibrated_stretch(rock, 1.0, fracture_energy=1e-2)  # doctest: +SKIP
    >>> round(stretch, 4)  # doctest: +SKIP
    0.0105
    """
    kinds.instance(model, "model", Elastic, "an Elastic model")
    spacing = kinds.number(spacing, "spacing", above=0)
    energy = kinds.number(fracture_energy, "fracture_energy", above=0)
    dim = kinds.integer(dim, "dim", least=2, most=3)
    if model.uneven:
        raise InputError(
            "a critical stretch is calibrated for one set of constants",
            value=", ".join(sorted(model.uneven)),
            key="model",
            remedy="numbers; once for each material",
        )
    kinds.one_of(calibrate, "calibrate", CALIBRATIONS, "unknown calibration")
    factor = energy_factor(Simulation.of, model, spacing, dim, calibrate)
    assert isinstance(model.kernel, Kernel)
    return float(stretch_that_spends(energy, factor, model.young, model.kernel.horizon))
