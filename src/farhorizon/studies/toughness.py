r"""The energy that cracks spend on new area: of one that follows a pair of forces, and the critical stretch for it.

Two opposite forces P that move along the faces of a crack at a speed V hold its tip at the distance d ahead of them at
which :math:`K_I = P\sqrt{2/\pi d}` is what the tip wants at that speed: nearer to them K rises and it runs ahead,
farther on K falls. So the crack runs straight and, once it has settled, as fast as the forces do (Freund, 1990, Dynamic
Fracture Mechanics: the stress ahead of a steady tip under forces that move along does not depend on the speed). The
medium has no edges, and no echo comes back.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from farhorizon import kinds
from farhorizon.analysis.fracture.interaction import InteractionDomain
from farhorizon.analysis.fracture.near_tip import NearTip
from farhorizon.boundaries import LatticePML
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Polyline
from farhorizon.inputs.sources import Source
from farhorizon.medium.kernel import Kernel
from farhorizon.models import Elastic
from farhorizon.simulation.crack_tips import CrackTips
from farhorizon.simulation.simulation import Simulation

_STRETCH = 0.01  # any: forces are linear in it
_SPEED = 0.3  # of Rayleigh waves: below, tips wait at each bond; above, bonds beside the plane break, too
_TRIES, _AGREES = 5, 0.15  # runs, until what was expected is spent to this part
# In horizons: how far the crack reaches and runs, and the room around it; breadths of the forces and their distance
# from the plane, and from the tip, at first and with the K that the energy takes; the circles around the tip.
_LEFT, _TIP, _WAY, _BESIDE, _HIGH = -20.0, -6.0, 24.0, 9.0, 10.0
_ALONG, _ACROSS, _OFF, _FIRST, _LEAD = 2.0, 1.5, 3.0, 7.0, 5.0
_RINGS = 2.5, 4.5
_SETTLED = 9.0  # horizons of way until a tip runs steadily
_RISE = 10.0  # of the forces, in horizons over the speed of a bar
_COARSEST, _FINEST = 2.0, 12.0  # spacings in the horizon
_MOMENTS, _ONWARD = 12, 4.0  # at which the flux of energy is looked at, on so many horizons


def rayleigh_speed(lame: float, shear: float, density: float) -> float:
    """Speed of surface waves of a half-space (Rayleigh, 1885).

    Examples
    --------
    >>> round(rayleigh_speed(1.0, 1.0, 1.0), 4)  # Poisson's ratio 1/4
    0.9194
    """
    p, s = (lame + 2 * shear) / density, shear / density

    def missing(square: float) -> float:
        return 4 * float(np.sqrt((1 - square / p) * (1 - square / s))) - (2 - square / s) ** 2

    return float(np.sqrt(brentq(missing, 0.1 * s, (1 - 1e-12) * s)))


@dataclass(frozen=True)
class RunningCrack:
    """A crack in the infinite plane that runs after a pair of forces.

    Attributes
    ----------
    sim : Simulation
        At its end.
    tips : CrackTips
    ahead : ndarray, shape (2,)
        The way in which the forces move.
    horizon : float
    load : callable
        The forces per volume, of coordinates and time.
    """

    sim: Simulation
    tips: CrackTips
    ahead: np.ndarray
    horizon: float
    load: Source

    @property
    def way(self) -> np.ndarray:
        """Of the foremost tip along the way of the forces, from where the crack ended, shape (rows,); -inf where no tip
        is seen.
        """
        along = np.nan_to_num(self.tips.data["position"] @ self.ahead, nan=-np.inf)
        return np.asarray(along.max(1) - _TIP * self.horizon)

    @property
    def steady(self) -> np.ndarray:
        """Rows in which the tip has settled, shape (rows,)."""
        return self.way > _SETTLED * self.horizon

    @property
    def follows(self) -> bool:
        """Whether the tip has come as far as it was to."""
        return bool(self.way[-1] > 0.9 * _WAY * self.horizon)

    @property
    def spent(self) -> float:
        """Energy of broken bonds for each length of steady way."""
        return float(np.polyfit(self.way[self.steady], self.tips.dissipated[self.steady], 1)[0])

    @property
    def speed(self) -> float:
        """Of the tip on its steady way."""
        return float(np.polyfit(self.tips.times[self.steady], self.way[self.steady], 1)[0])

    def flux(self) -> float:
        """Energy that flows into the tip for each new length, the domain J integral, the median over some moments; the
        run goes on by four horizons. For a crack along an axis, beside which no node has lost all of its bonds: such
        nodes fly, and have no part in the field.
        """
        sim, model = self.sim, self.sim.model
        assert isinstance(model, Elastic)
        medium, found = NearTip(model.lame, model.shear), []
        every = max(1, round(_ONWARD * self.horizon / _MOMENTS / (self.speed * sim.dt)))
        for _ in range(_MOMENTS):
            sim.step(every)
            levels = [sim.fields["u"]]
            for _ in range(2):
                sim.step()
                levels.append(sim.fields["u"])
            before, u, after = levels
            velocity, acceleration = (after - before) / (2 * sim.dt), (after - 2 * u + before) / sim.dt**2
            load = self.load.value(*sim.lattice.coordinates(), sim.time - sim.dt)
            radii = _RINGS[0] * self.horizon, _RINGS[1] * self.horizon
            tip = self._straightened(*radii)
            crack = Polyline([tip + 2 * _LEFT * self.horizon * self.ahead, tip])
            domain = InteractionDomain(sim.lattice, tip, self.ahead, radii, [crack], medium)
            force = model.density * acceleration - load
            found.append(domain.energy_release(u, velocity, model.density, force))
        return float(np.median(found))  # where the crack changes its row within the circles it is no straight one

    def _straightened(self, inner: float, outer: float) -> np.ndarray:
        """The foremost tip, moved across to the line on which its crack crosses the circles."""
        across = np.array([-self.ahead[1], self.ahead[0]])
        far = float((self.tips.now.tips @ self.ahead).max())
        points = np.concatenate(self.tips.now.paths)
        behind = far - points @ self.ahead
        return far * self.ahead + (points @ across)[(behind > inner) & (behind < outer)].mean() * across


def running_crack(
    model: Elastic, spacing: float, energy: float, speed: float = _SPEED, turn: float = 0.0, push: float = 1.2
) -> RunningCrack:
    """A crack that follows a pair of forces.

    Parameters
    ----------
    model : Elastic
        Whose bonds break.
    spacing : float
        Of the lattice.
    energy : float
        What it is expected to spend for each area, by which the forces are chosen.
    speed : float
        Of the forces, over that of Rayleigh waves.
    turn : float
        Angle of the crack to the lattice.
    push : float
        The forces over those with which the tip is five horizons ahead of them if it spends what is expected.
    """
    assert isinstance(model.kernel, Kernel)
    size, young, density = model.kernel.horizon, model.young, model.density
    ahead = np.array([np.cos(turn), np.sin(turn)])
    across = np.array([-ahead[1], ahead[0]])
    ends = _LEFT - _BESIDE, _TIP + _WAY + _BESIDE
    corners = size * np.array([x * ahead + y * across for x in ends for y in (-_HIGH, _HIGH)])
    # between two rows of nodes, or right across the lattice
    lower, upper = (spacing * (np.floor(one / spacing) + 0.5) for one in (corners.min(0), corners.max(0)))
    medium = NearTip(model.lame, model.shear)
    total = push * np.sqrt(medium.stiffness * energy * np.pi * _LEAD * size / 2)
    amplitude = total / (np.pi * _ALONG * _ACROSS * size**2)
    moving = speed * rayleigh_speed(model.lame, model.shear, density)
    first, rise = (_TIP - _FIRST) * size, _RISE * size / np.sqrt(young / density)

    def load(x: np.ndarray, y: np.ndarray, t: float) -> np.ndarray:
        s, n = ahead[0] * x + ahead[1] * y - first - moving * t, across[0] * x + across[1] * y
        sides = [np.exp(-(((n - sign * _OFF * size) / (_ACROSS * size)) ** 2)) for sign in (1, -1)]
        risen = amplitude * (1 - np.exp(-((t / rise) ** 2)))
        shape = risen * np.exp(-((s / (_ALONG * size)) ** 2)) * (sides[0] - sides[1])
        return np.multiply.outer(across, shape)

    tips, source = CrackTips(every=10), Source(load)
    sim = Simulation(
        Lattice(spacing, tuple(lower), tuple(upper)),
        model,
        LatticePML(nodes=12),
        sources=[source],
        cracks=[[_LEFT * size * ahead, _TIP * size * ahead]],
        observe=[tips],
    )
    found = RunningCrack(sim, tips, ahead, size, source)
    latest = (_FIRST + _WAY) * size / moving
    while not found.follows and sim.time < latest:
        sim.run(min(sim.time + size / moving, latest), progress=False)
    return found


def calibrated_stretch(model: Elastic, spacing: float, fracture_energy: float) -> float:
    r"""The critical stretch with which a running crack spends a fracture energy, in the plane.

    The energy that a state-based or correspondence material loses with a bond goes by all bonds of the two nodes, so
    that what a crack spends depends on how it breaks them, one after the other; a crack in bonds breaks some beside its
    plane. It is found from a crack that runs along an axis of the lattice at 0.3 of the speed of Rayleigh waves through
    the infinite plane, after a pair of forces (`running_crack`). As forces are linear, that energy goes with the square
    of the critical stretch. The pair is chosen by the energy, and another crack runs where that is found to be another
    one. It takes some ten seconds with three nodes in the horizon.

    Parameters
    ----------
    model : Elastic
        The material; its own critical stretch does not matter.
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
        Constants that vary; less than 2 or more than 12 spacings in the horizon; a material in which no crack runs, or
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
    if not isinstance(model.kernel, Kernel):
        raise InputError(
            "a critical stretch is calibrated for a material with a kernel", value=model.title, key="model.kernel"
        )
    reach = model.kernel.horizon / spacing
    if not _COARSEST * (1 - 1e-9) <= reach <= _FINEST:
        raise InputError(
            "a crack is run on lattices that are fine enough to let it pass, and no finer than takes minutes",
            value=f"{reach:.3g} spacings in the horizon",
            limit=f"{_COARSEST:g} to {_FINEST:g}",
            key="spacing",
        )
    if model.uneven:
        raise InputError(
            "a critical stretch is calibrated for one set of constants",
            value=", ".join(sorted(model.uneven)),
            key="model",
            remedy="numbers; once for each material",
        )
    breaking = copy.copy(model)
    breaking.critical_stretch, breaking.fracture_energy, breaking.nonlinear = _STRETCH, None, False
    # of bonds in plane strain, see `farhorizon.medium.fracture`
    expected = 12 / (5 * np.pi) * model.young * model.kernel.horizon * _STRETCH**2
    for _ in range(_TRIES):
        found = running_crack(breaking, spacing, expected)
        if found.follows and abs(found.spent - expected) <= _AGREES * expected:
            break
        expected = found.spent if found.follows and found.spent > 0 else 1.5 * expected  # by which the forces go
    if not found.follows or found.spent <= 0:
        raise InputError(
            "bonds that break spend no energy" if found.follows else "no crack runs through this material",
            value=found.spent if found.follows else "none",
            key="model",
            remedy="a larger horizon, or of a correspondence material a stabilisation",
        )
    return float(_STRETCH * np.sqrt(wanted / found.spent))
