"""Cracks that run after a pair of forces, and the critical stretch with which they spend a fracture energy; see
`farhorizon.simulation.running_cracks`.
"""

from __future__ import annotations

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.medium.fracture import stretch_that_spends
from farhorizon.medium.kernel import Kernel
from farhorizon.models import Elastic
from farhorizon.simulation.running_cracks import SPEED, RunningCrack, crack_after_forces, energy_factor
from farhorizon.simulation.running_cracks import rayleigh_speed as rayleigh_speed
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
    """A crack that follows a pair of forces; parameters as of
    `farhorizon.simulation.running_cracks.crack_after_forces`.
    """
    return crack_after_forces(Simulation.of, model, spacing, energy, speed, turn, push, dim)


def calibrated_stretch(model: Elastic, spacing: float, fracture_energy: float, dim: int = 2) -> float:
    r"""The critical stretch with which a running crack spends a fracture energy.

    The energy that a state-based or correspondence material loses with a bond goes by all bonds of the two nodes, so
    that what a crack spends depends on how it breaks them, one after the other; a crack in bonds breaks some beside its
    plane. It is found from cracks that run at 0.3 of the speed of Rayleigh waves after a pair of forces: in the
    infinite plane from two, along an axis of the lattice and at 0.18 rad to it, in space from one along an axis,
    through a slab in plane strain (`running_crack`). As forces are linear, that energy goes with the square of the
    critical stretch. The pair is chosen by the energy, and another crack runs where that is found to be another one.
    With three nodes in the horizon it takes some twenty seconds in the plane and a minute in space, once: the number
    stays in the cache of the program, for any Young's modulus, density and unit.

    A simulation does the same for a state-based or correspondence material that has a `fracture_energy`.

    Parameters
    ----------
    model : Elastic
        The material; its own strength does not matter.
    spacing : float
        Of the lattice.
    fracture_energy : float
        Energy per area of a new crack.
    dim : {2, 3}
        The plane or space.

    Returns
    -------
    float

    Raises
    ------
    InputError
        Constants that vary; less than 2 or more than 12 (in space 5) spacings in the horizon; a material in which no
        crack runs, or energy is not spent, as in a correspondence material without stabilisation.

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
    wanted = kinds.number(fracture_energy, "fracture_energy", above=0)
    dim = kinds.integer(dim, "dim", least=2, most=3)
    if model.uneven:
        raise InputError(
            "a critical stretch is calibrated for one set of constants",
            value=", ".join(sorted(model.uneven)),
            key="model",
            remedy="numbers; once for each material",
        )
    factor = energy_factor(Simulation.of, model, spacing, dim)
    assert isinstance(model.kernel, Kernel)
    return float(stretch_that_spends(wanted, factor, model.young, model.kernel.horizon))
