r"""The energy that cracks spend on new area, from one that runs after a pair of forces.

Two opposite forces P that move along the faces of a crack at a speed V hold its tip at the distance d ahead of them at
which :math:`K_I = P\sqrt{2/\pi d}` is what the tip wants at that speed: nearer to them K rises and it runs ahead,
farther on K falls. So the crack runs straight and, once it has settled, as fast as the forces do (Freund, 1990, Dynamic
Fracture Mechanics: the stress ahead of a steady tip under forces that move along does not depend on the speed). The
medium has no edges, and no echo comes back. In space it is a slab of one node between periodic sides, in plane strain:
a straight front without end, which all bonds of space cross.

As forces are linear, the energy goes with the square of the critical stretch, and over Young's modulus and the horizon
it is a number that follows from the kernel, the spacings in the horizon and Poisson's ratio: it is found once and kept.
In the plane it is the mean of two cracks, along an axis of the lattice and across it, in space that of one along an
axis.
"""

from __future__ import annotations

import copy
import hashlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.optimize import brentq

from farhorizon.analysis.fracture.interaction import InteractionDomain
from farhorizon.analysis.fracture.near_tip import NearTip
from farhorizon.boundaries import LatticePML, Periodic, Side, Sponge
from farhorizon.engine import damage, release
from farhorizon.errors import InputError
from farhorizon.files.cache import cache_folder, keep, kept
from farhorizon.files.storage import awaited
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Polyline, Rectangle
from farhorizon.inputs.sources import Source
from farhorizon.medium import force_states
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models import Elastic
from farhorizon.simulation.crack_tips import CrackTips
from farhorizon.simulation.host import looked_at
from farhorizon.simulation.setup import Setup
from farhorizon.simulation.team import Team

#: Makes a run of a set-up with what is recorded of it: a `Simulation`, which imports this module.
Runs = Callable[[Setup, Sequence[Any]], Any]
_STRETCH = 0.01  # any: forces are linear in it
SPEED = 0.3  # of Rayleigh waves: below, tips wait at each bond; above, bonds beside the plane break, too
# Angles of cracks to the lattice, in the plane and in space: along an axis the least is spent, across it the most.
TURNS = {2: (0.0, 0.18), 3: (0.0,)}
_TRIES, _AGREES, _MORE = 6, 0.15, 1.15  # runs, until what was expected is spent to this part; more where none runs
# In horizons: how far the crack reaches and runs, and the room around it; breadths of the forces and their distance
# from the plane, and from the tip, at first and with the K that the energy takes; the circles around the tip; the
# thickness of sponges.
_LEFT, _TIP, _WAY, _BESIDE, _HIGH = -20.0, -6.0, 24.0, 9.0, 10.0
_ALONG, _ACROSS, _OFF, _FIRST, _LEAD = 2.0, 1.5, 3.0, 7.0, 5.0
_RINGS = 2.5, 4.5
_SPONGE = 6.0
_SETTLED = 9.0  # horizons of way until a tip runs steadily
_RISE = 10.0  # of the forces, in horizons over the speed of a bar
_COARSEST, _FINEST = 2.0, {2: 12.0, 3: 5.0}  # spacings in the horizon, in the plane and in space
_DIGITS = 12  # of what decides the number: units that differ make the same run
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
    """A crack in the infinite plane, or in a slab of one node, that runs after a pair of forces.

    Attributes
    ----------
    sim : Simulation
        At its end.
    tips : CrackTips
    ahead : ndarray, shape (2,)
        The way in which the forces move, in the plane across the front.
    horizon : float
    load : Source
        The forces per volume.
    thickness : float
        Of the slab; 1 in the plane.
    """

    sim: Any
    tips: CrackTips
    ahead: np.ndarray
    horizon: float
    load: Source
    thickness: float = 1.0

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
        """Energy of broken bonds for each area of steady way, in the plane for each length."""
        return float(np.polyfit(self.way[self.steady], self.tips.dissipated[self.steady], 1)[0]) / self.thickness

    @property
    def speed(self) -> float:
        """Of the tip on its steady way."""
        return float(np.polyfit(self.tips.times[self.steady], self.way[self.steady], 1)[0])

    def flux(self) -> float:
        """Energy that flows into the tip for each new length in the plane, the domain J integral, the median over some
        moments; the run goes on by four horizons. For a crack along an axis.
        """
        sim, model = self.sim, self.sim.model
        assert isinstance(model, Elastic)
        medium, found = NearTip(model.lame, model.shear), []
        apart = round(_ONWARD * self.horizon / _MOMENTS / (self.speed * sim.dt))
        for _ in range(_MOMENTS):
            sim.step(max(1, apart - 2))
            levels = [sim.fields["u"]]
            for _ in range(2):  # of the steps from one moment to the next
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
            held = sim.fields["damage"] < 1
            found.append(domain.energy_release(u, velocity, model.density, force, held))
        return float(np.median(found))  # where the crack changes its row within the circles it is no straight one

    def _straightened(self, inner: float, outer: float) -> np.ndarray:
        """The foremost tip, moved across to the line on which its crack crosses the circles."""
        across = np.array([-self.ahead[1], self.ahead[0]])
        far = float((self.tips.now.tips @ self.ahead).max())
        points = np.concatenate(self.tips.now.paths)
        behind = far - points @ self.ahead
        return far * self.ahead + (points @ across)[(behind > inner) & (behind < outer)].mean() * across


def crack_after_forces(
    runs: Runs,
    model: Elastic,
    spacing: float,
    energy: float,
    speed: float = SPEED,
    turn: float = 0.0,
    push: float = 1.2,
    dim: int = 2,
) -> RunningCrack:
    """A crack that follows a pair of forces.

    Parameters
    ----------
    runs : callable
        Makes a run of a set-up and what observes it.
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
    dim : {2, 3}
        The plane, or a slab of one node.
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
    front = np.zeros(dim - 2)  # no force along it

    def load(*at: Any) -> np.ndarray:
        x, y, t = at[-3:]
        s, n = ahead[0] * x + ahead[1] * y - first - moving * t, across[0] * x + across[1] * y
        sides = [np.exp(-(((n - sign * _OFF * size) / (_ACROSS * size)) ** 2)) for sign in (1, -1)]
        risen = amplitude * (1 - np.exp(-((t / rise) ** 2)))
        shape = risen * np.exp(-((s / (_ALONG * size)) ** 2)) * (sides[0] - sides[1])
        return np.multiply.outer(np.append(front, across), shape)

    tips, source = CrackTips(every=10), Source(load)
    start, tip = _LEFT * size * ahead, _TIP * size * ahead
    around: dict[str, Side] = {"all": LatticePML(nodes=12)}
    crack: Any = [start, tip]
    if dim == 3:
        # layers for the bonds of space take longer than all else here, and the forces hardly make waves
        around = {"x": Periodic(), "all": Sponge(round(_SPONGE * size / spacing))}
        crack = Rectangle([-2 * _HIGH * size, *start], [4 * _HIGH * size, 0.0, 0.0], [0.0, *(tip - start)])
    lattice = Lattice(spacing, (*front, *lower), (*front, *upper))
    found = RunningCrack(
        runs(Setup(lattice, model, around, sources=[source], cracks=[crack]), [tips]),
        tips,
        ahead,
        size,
        source,
        spacing ** (dim - 2),
    )
    sim, latest = found.sim, (_FIRST + _WAY) * size / moving
    while not found.follows and sim.time < latest:
        sim.step(int(size / (moving * sim.dt)))
    return found


def energy_factor(runs: Runs, model: Elastic, spacing: float, dim: int) -> float:
    """What cracks that run at 0.3 of the speed of Rayleigh waves, along an axis of the lattice and in the plane at an
    angle to it, too, spend for each area in the mean, over Young's modulus, the horizon and the square of the critical
    stretch; from the cache of the program if it is there.

    Parameters
    ----------
    runs : callable
        Makes a run of a set-up and what observes it.
    model : Elastic
        With numbers for constants; its own strength does not matter.
    spacing : float
    dim : {2, 3}

    Raises
    ------
    InputError
        No kernel, a lattice that is too coarse or too fine, a material in which no crack runs, or energy is not spent,
        as in a correspondence material without stabilisation.
    """
    if not isinstance(model.kernel, Kernel):
        raise InputError(
            "a critical stretch is calibrated for a material with a kernel", value=model.title, key="model.kernel"
        )
    reach = model.kernel.horizon / spacing
    if not _COARSEST * (1 - 1e-9) <= reach <= _FINEST[dim]:
        raise InputError(
            "what a crack dissipates is found on lattices fine enough to let it run, and no finer than can be computed "
            "in minutes",
            value=f"{reach:.3g} spacings in the horizon",
            limit=f"{_COARSEST:g} to {_FINEST[dim]:g}",
            key="model.fracture_energy",
            remedy="critical_stretch",
        )
    tried = _in_units_of_the_lattice(model, model.kernel, spacing)
    path = _cache_file(tried, dim)
    if (found := kept(path)) is None:
        with awaited(path.with_suffix(".lock")):  # several processes may want the same one
            if (found := kept(path)) is None:
                found = {"factor": np.array(_energy_factor(runs, tried, dim))}
                keep(path, **found)
    return float(found["factor"])


def _in_units_of_the_lattice(model: Elastic, kernel: Kernel, spacing: float) -> Elastic:
    """The same material for a unit of spacing, Young's modulus and density, with linear bonds that break."""
    moduli = {name: getattr(model, name) / model.young for name in ("young", "bulk", "shear")}
    given = moduli | {"poisson": model.poisson}
    tried = model.linearised.with_constants({name: round(value, _DIGITS) for name, value in given.items()})
    unit = spacing * np.sqrt(model.density / model.young)
    width = None if kernel.width is None else round(kernel.width / spacing, _DIGITS)
    tried = tried.with_constants({"density": 1.0})
    tried.kernel = replace(kernel, horizon=round(kernel.horizon / spacing, _DIGITS), width=width)
    tried.damping, tried.drag = round(model.damping * unit, _DIGITS), round(model.drag * unit, _DIGITS)
    tried.critical_stretch = _STRETCH
    return tried


def _energy_factor(runs: Runs, model: Elastic, dim: int) -> float:
    """The same of a material in the units of its lattice, from runs."""
    assert isinstance(model.kernel, Kernel)
    print(
        "farhorizon: simulating a crack to find the energy per area in this material, once: later runs find it on disk",
        file=sys.stderr,
        flush=True,
    )
    unit, spent = model.young * model.kernel.horizon * _STRETCH**2, []
    expected = unit * (12 / (5 * np.pi) if dim == 2 else 6 / 5)  # of bonds, see `farhorizon.medium.fracture`
    for turn in TURNS[dim]:
        expected = _spent(runs, model, dim, turn, expected)
        spent.append(expected)
    return float(np.mean(spent)) / unit


def _spent(runs: Runs, model: Elastic, dim: int, turn: float, expected: float) -> float:
    """What a crack at an angle to the lattice spends for each area, of which some value is expected."""
    stuck = 0.0  # forces by which no crack ran: on coarse lattices it takes more than is spent
    for _ in range(_TRIES):
        found = crack_after_forces(runs, model, 1.0, expected, turn=turn, dim=dim)
        if found.follows and abs(found.spent - expected) <= _AGREES * expected:
            break
        if found.follows and found.spent > 0:
            expected = max(found.spent, _MORE * stuck)  # by which the forces go
        else:
            stuck, expected = expected, _MORE**2 * expected
    if not found.follows or found.spent <= 0:
        raise InputError(
            "bonds that break dissipate no energy" if found.follows else "no crack runs through this material",
            value=found.spent if found.follows else "none",
            key="model.fracture_energy",
            remedy="a larger horizon, or for a correspondence material a stabilisation",
        )
    return found.spent


# what lets a crack run, and decides which bonds break and what is lost with them
_FILES = __file__, damage.__file__, release.__file__, force_states.__file__
_PROGRAM = b"".join(Path(str(file)).read_bytes() for file in _FILES)


def _cache_file(model: Elastic, dim: int) -> Path:
    """File of the number of this very lattice, found by this very program."""
    assert isinstance(model.kernel, Kernel)
    mark = hashlib.sha256(_PROGRAM)
    for table in Stencil.family(model.kernel, 1.0, dim):
        mark.update(np.ascontiguousarray(table).tobytes())
    names = ("material", "plane", "stabilisation", "damping", "drag", "shape_tensor")
    given = (round(model.poisson, _DIGITS - 2), *(getattr(model, name, None) for name in names))
    mark.update(repr((dim, model.kernel.calibrate, *given)).encode())
    return cache_folder() / f"toughness_{mark.hexdigest()[:24]}.npz"


def with_energy_factor(setup: Setup, runs: Runs, team: Team) -> Setup:
    """The set-up, whose fracture energy is one that its bonds know how to turn into a critical stretch.

    Parameters
    ----------
    setup : Setup
    runs : callable
        Makes a run of a set-up and what observes it.
    team : Team
        Processes that compute the run: the first one finds the number.

    Raises
    ------
    InputError
        As `energy_factor`; Poisson's ratio is not the same everywhere.
    """
    law = setup.model.bond_law
    if law is None or law.fracture_energy is None or law.energy_factor is not None or setup.model.bonds:
        return setup
    medium, variation = looked_at(setup, team)
    ratio = np.ones(1) if variation.lame is None else variation.lame[0] / variation.lame[1]
    if team.largest(float(ratio.max())) + team.largest(-float(ratio.min())) > 10.0**-_DIGITS:
        raise InputError(
            "the energy per new area is found for one Poisson's ratio; the other constants may vary",
            value="one that varies",
            key="model.fracture_energy",
            remedy="critical_stretch, by region that of fh.calibrated_stretch",
        )
    lattice, host, model = setup.lattice, cast(Elastic, medium.model), cast(Elastic, copy.copy(setup.model))
    factor = team.by_first(lambda: energy_factor(runs, host, lattice.spacing, lattice.dim))
    model.energy_factor = team.first(factor)
    return replace(setup, model=model)
