"""The critical stretch of a fracture energy, where no formula has it: from cracks that run."""

from __future__ import annotations

import copy

import numpy as np

from farhorizon import kinds
from farhorizon.boundaries import Free, LatticePML
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.loads import Traction
from farhorizon.inputs.pressure import Pressure
from farhorizon.medium.kernel import Kernel
from farhorizon.models import Elastic
from farhorizon.simulation.crack_tips import CrackTips
from farhorizon.simulation.simulation import Simulation

_STRETCH = 0.01  # any: forces are linear in it
_HALF, _HIGH, _NOTCH = 13.0, 6.5, 6.5  # in horizons: half length and half height of the strip, length of the notch
_RISE, _LATEST = 40.0, 110.0  # of the load, in horizons over the speed of a bar
_FROM, _TO = 0.75, 5.5  # how far the crack has run, in horizons, where it is looked at
_STRESSES = 0.1, 0.13, 0.17, 0.22, 0.29, 0.38  # of the sides, over Young's modulus and critical stretch
# Of the crack in the plane, in horizons: half its length, how far beyond its tips and beside it the near field goes on,
# and how near to the edge it runs.
_CRACK, _AHEAD, _BESIDE, _NEAR = 5.0, 11.0, 7.0, 4.0
_RATE = 0.05  # of the pressure, over one at which it would run, in horizons over the speed of a bar
_ENERGY = 0.75  # of a crack in bonds, over Young's modulus, horizon and squared critical stretch: sets the pressure
_STEADY = 2.0  # horizons that tips have run together before the energy is looked at


def calibrated_stretch(model: Elastic, spacing: float, fracture_energy: float) -> float:
    r"""The critical stretch with which a running crack spends a fracture energy, in state-based and correspondence
    materials in the plane.

    The energy that such a material loses with a bond goes by all bonds of the two nodes, so that what a crack spends
    depends on how it breaks them, one after the other. It is found from two cracks that run, and is the mean of both: a
    notched strip of 26 by 13 horizons is pulled apart, and a crack in the infinite plane is pressed open. The energy of
    the bonds that break is fitted by the way of the tips. As forces are linear, that energy goes with the square of the
    critical stretch, and one run of each is enough. It takes some twenty seconds with three nodes in the horizon.

    Parameters
    ----------
    model : Elastic
        The material; its own critical stretch does not matter. The crack runs along an axis.
    spacing : float
        Of the lattice.
    fracture_energy : float
        Energy per area of a new crack.

    Returns
    -------
    float

    Raises
    ------
    InputError
        A bond-based material, whose `fracture_energy` is known; constants that vary; a strip in which no crack runs, or
        energy is not spent, as in a correspondence material without stabilisation.

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
    if model.material not in ("state-based", "correspondence") or not isinstance(model.kernel, Kernel):
        raise InputError(
            "only state-based and correspondence materials have to be calibrated",
            value=model.title,
            key="model.material",
            remedy="fracture_energy of the model, for bonds",
        )
    if model.uneven:
        raise InputError(
            "a critical stretch is calibrated for one set of constants",
            value=", ".join(sorted(model.uneven)),
            key="model",
            remedy="numbers; once for each material",
        )
    for stress in _STRESSES:
        spent = spent_energy(model, spacing, stress)
        if spent is not None:
            break
    if spent is not None and spent > 0:
        pressed = steady_energy(pressed_crack(_breaking(model), spacing), model.kernel.horizon)
        spent = None if pressed is None else (spent + pressed) / 2
    if spent is None or spent <= 0:
        raise InputError(
            "no crack runs through this material" if spent is None else "bonds that break spend no energy",
            value="none" if spent is None else spent,
            key="model",
            remedy="a larger horizon, or of a correspondence material a stabilisation",
        )
    return float(_STRETCH * np.sqrt(wanted / spent))


def spent_energy(
    model: Elastic, spacing: float, stress: float, half: float = _HALF, high: float = _HIGH
) -> float | None:
    """Energy per area that a crack spends with a critical stretch of 0.01, or None where none runs.

    Parameters
    ----------
    model : Elastic
    spacing : float
    stress : float
        On the long sides, over Young's modulus and the critical stretch.
    half, high : float
        Half length and half height of the strip, in horizons.
    """
    assert isinstance(model.kernel, Kernel)
    horizon = model.kernel.horizon
    end, edge = (spacing * (np.floor(n * horizon / spacing) + 0.5) for n in (half, high))
    lattice = Lattice(spacing, (-end, -edge), (end, edge))
    notch = _NOTCH * horizon - end
    unit = horizon / np.sqrt(model.young / model.density)
    pull = stress * model.young * _STRETCH
    sim = Simulation(
        lattice,
        _breaking(model),
        Free(),
        loads=[
            Traction(f"y{sign}", (0.0, force), time=lambda t: min(t / (_RISE * unit), 1.0))
            for sign, force in (("+", pull), ("-", -pull))
        ],
        cracks=[[(-end - spacing, 0.0), (notch, 0.0)]],
    )
    middle, rows = lattice.shape[1] // 2, []
    for time in np.arange(0.5 * _RISE, _LATEST, 2 / 3) * unit:
        sim.run(time, progress=False)
        gone = sim.fields["damage"][:, middle]
        ahead = lattice.axes[0][gone > 0.5 * gone[: lattice.shape[0] // 8].max()].max() - notch
        if ahead > _TO * horizon:
            break
        if ahead > _FROM * horizon:
            rows.append((ahead, sim.energies()["broken"]))
    else:
        return None
    if len(rows) < 4:
        return None
    tip, spent = np.array(rows).T
    return float(np.polyfit(tip, spent, 1)[0])


def _breaking(model: Elastic) -> Elastic:
    """The material with a critical stretch of 0.01."""
    breaking = copy.copy(model)
    breaking.critical_stretch, breaking.fracture_energy = _STRETCH, None
    return breaking


def pressed_crack(model: Elastic, spacing: float, rate: float = _RATE, half: float = _CRACK) -> CrackTips:
    """Tips of a crack in the infinite plane that a growing pressure in it drives, along an axis, up to the edge of the
    near field or its first branch.

    Its intensity falls as it grows, so that its speed follows the pressure.

    Parameters
    ----------
    model : Elastic
        With bonds that break.
    spacing : float
    rate : float
        Of the pressure, over the one at which the crack would run, in horizons over the speed of a bar.
    half : float
        Half the length of the crack, in horizons.
    """
    assert isinstance(model.kernel, Kernel)
    horizon = model.kernel.horizon
    unit = horizon / np.sqrt(model.young / model.density)
    wide, high = (spacing * (np.ceil(n * horizon / spacing) - 0.5) for n in (half + _AHEAD, _BESIDE))
    stretch = model.critical_stretch_on(spacing, 2)
    press = stretch * model.young * np.sqrt(_ENERGY / (1 - model.poisson**2) / (np.pi * half))
    crack, tips = [(-half * horizon, 0.0), (half * horizon, 0.0)], CrackTips(every=5)
    pressure = Pressure(crack, press, time=lambda t: rate * t / unit)
    sim = Simulation(
        Lattice(spacing, (-wide, -high), (wide, high)),
        model,
        LatticePML(nodes=16),
        loads=[pressure],
        cracks=[crack],
        observe=[tips],
    )
    for time in np.arange(0.5 / rate, 10 / rate) * unit:
        sim.run(time, progress=False)
        places = tips.data["position"][-1]
        if np.isfinite(places[2:]).any() or np.nanmax(np.abs(places)) > wide - _NEAR * horizon:
            break
    return tips


def steady_energy(tips: CrackTips, horizon: float) -> float | None:
    """Energy per area of new crack that tips spend once they run; None where they hardly do."""
    way = np.nansum(tips.data["advance"], axis=1)
    run = way > _STEADY * horizon
    return float(np.polyfit(way[run], tips.dissipated[run], 1)[0]) if run.sum() >= 4 else None
