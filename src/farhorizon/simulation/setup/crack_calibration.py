r"""Energy that cracks spend per new area, by which critical stretches are calibrated: of a crack that follows a pair of
forces, and of one at rest.

Two opposite forces P that move along the faces of a crack at a speed V hold its tip at the distance d ahead of them at
which :math:`K_I = P\sqrt{2/\pi d}` is what the tip requires at that speed: closer to them K increases and the tip runs
ahead, farther away it decreases. The crack therefore runs straight and, once it has settled, as fast as the forces
(Freund, 1990, Dynamic Fracture Mechanics: the stress ahead of a steady tip under forces that move with it does not
depend on the speed). The medium has no edges and returns no echo. In 3D it is a slab of one node between periodic
sides, in plane strain, with a straight, infinite front that all bonds in space cross.

Because forces are linear, the energy is proportional to the square of the critical stretch. Divided by Young's modulus
and the horizon, it is a number that depends only on the kernel, the horizon in spacings and Poisson's ratio; it is
computed once and stored. In 2D it is the mean of two cracks, one along an axis of the lattice and one at an angle to
it; in 3D that of one along an axis.

A crack at rest begins to grow in a strip that is pulled apart slowly, with a crack half way through. Far ahead of the
crack the strip stores the energy G per area that the crack would open (Rivlin and Thomas 1953, Journal of Polymer
Science 10, 291), whatever the material; it is computed in a strip without a crack. A tip on a lattice waits at each row
of nodes, so that starting a crack takes more than keeping it running.
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
from farhorizon.boundaries import Free, LatticePML, Periodic, Side, Sponge
from farhorizon.engine import damage, release
from farhorizon.errors import InputError
from farhorizon.files.cache import cache_folder, keep, kept
from farhorizon.files.storage import awaited
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Box, Polyline, Rectangle
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.inputs.sources import Source
from farhorizon.medium import force_states
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models import Elastic
from farhorizon.rounding import MARGIN
from farhorizon.simulation.processes.process_group import ProcessGroup
from farhorizon.simulation.recorders.crack_tips import CrackTips
from farhorizon.simulation.setup.reference_medium import reference_and_variation
from farhorizon.simulation.setup.setup import Setup

#: Makes a run of a set-up, given its recorders: a `Simulation`, which is passed in because it imports this module.
Runs = Callable[[Setup, Sequence[Any]], Any]
_STRETCH = 0.01  # arbitrary: forces are linear in it
SPEED = 0.3  # of Rayleigh waves: at lower speeds tips wait at each bond, at higher ones bonds off the plane break, too
# angles of cracks to the lattice, in 2D and 3D: least is spent along an axis, most at this angle to it
TURNS = {2: (0.0, 0.18), 3: (0.0,)}
_TRIES, _AGREES, _MORE = 6, 0.15, 1.15  # most runs, agreement at which they end, factor on forces where no crack runs
# in horizons: both ends of the initial crack, the distance that it runs, and the room around it; widths of the forces
# and their distances from the plane, and from the tip at first and with the K that the energy requires; the circles
# around the tip; the thickness of sponges
_LEFT, _TIP, _WAY, _BESIDE, _HIGH = -20.0, -6.0, 24.0, 9.0, 10.0
_ALONG, _ACROSS, _OFF, _FIRST, _LEAD = 2.0, 1.5, 3.0, 7.0, 5.0
_RINGS = 2.5, 4.5
_SPONGE = 6.0
_SETTLED = 9.0  # horizons that a tip travels until it runs steadily
_RISE = 10.0  # rise time of the forces, in horizons over the speed of waves in a bar
_COARSEST, _FINEST = 2.0, {2: 12.0, 3: 5.0}  # spacings in the horizon, in 2D and 3D
_DIGITS = 12  # of the constants on which the number depends, so that the run is the same in all units
_MOMENTS, _ONWARD = 12, 4.0  # number of moments at which the energy flux is evaluated, over this many horizons


def rayleigh_speed(lame: float, shear: float, density: float) -> float:
    """Return the speed of surface waves on a half-space (Rayleigh, 1885)."""
    p, s = (lame + 2 * shear) / density, shear / density

    def missing(square: float) -> float:
        return 4 * float(np.sqrt((1 - square / p) * (1 - square / s))) - (2 - square / s) ** 2

    return float(np.sqrt(brentq(missing, 0.1 * s, (1 - 1e-12) * s)))


@dataclass(frozen=True)
class RunningCrack:
    """A crack in the infinite plane, or in a slab of one node, that follows a pair of forces."""

    sim: Any  # at its end
    tips: CrackTips
    ahead: np.ndarray  # direction in which the forces move, in the plane across the front, shape (2,)
    horizon: float
    load: Source  # forces per volume
    thickness: float = 1.0  # of the slab; 1 in 2D

    @property
    def way(self) -> np.ndarray:
        """Distance of the foremost tip from the initial one, in the direction of the forces, shape (rows,); -inf where
        no tip is found.
        """
        along = np.nan_to_num(self.tips.data["position"] @ self.ahead, nan=-np.inf)
        return np.asarray(along.max(1) - _TIP * self.horizon)

    @property
    def steady(self) -> np.ndarray:
        """Rows in which the tip has settled, shape (rows,)."""
        return self.way > _SETTLED * self.horizon

    @property
    def follows(self) -> bool:
        """Whether the tip has travelled as far as intended."""
        return bool(self.way[-1] > 0.9 * _WAY * self.horizon)

    @property
    def spent(self) -> float:
        """Energy of broken bonds per new area while the tip runs steadily (per length in 2D)."""
        return float(np.polyfit(self.way[self.steady], self.tips.dissipated[self.steady], 1)[0]) / self.thickness

    @property
    def speed(self) -> float:
        """Speed of the tip while it runs steadily."""
        return float(np.polyfit(self.tips.times[self.steady], self.way[self.steady], 1)[0])

    def flux(self) -> float:
        """Return the energy that flows into the tip per new length in the plane, from the domain J integral: the median
        over some moments, during which the run continues for four horizons. For a crack along an axis.
        """
        sim, model = self.sim, self.sim.model
        assert isinstance(model, Elastic)
        medium, fluxes = NearTip(model.lame, model.shear), []
        apart = round(_ONWARD * self.horizon / _MOMENTS / (self.speed * sim.dt))
        for _ in range(_MOMENTS):
            sim.step(max(1, apart - 2))
            levels = [sim.fields["u"]]
            for _ in range(2):  # counted in `apart`
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
            unbroken = sim.fields["damage"] < 1
            fluxes.append(domain.energy_release(u, velocity, model.density, force, unbroken))
        return float(np.median(fluxes))  # where the crack changes rows within the circles, it is not straight

    def _straightened(self, inner: float, outer: float) -> np.ndarray:
        """Return the foremost tip, moved sideways to the line along which its crack crosses the circles."""
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
    """Run a crack that follows a pair of forces through a model whose bonds break, in the plane or a slab of one node.

    The forces hold the tip five horizons ahead of them if it spends the expected energy per new area; `push` is a
    factor on them, `speed` their speed relative to that of Rayleigh waves, `turn` the angle of the crack to the
    lattice.
    """
    assert isinstance(model.kernel, Kernel)
    size, young, density = model.kernel.horizon, model.young, model.density
    ahead = np.array([np.cos(turn), np.sin(turn)])
    across = np.array([-ahead[1], ahead[0]])
    ends = _LEFT - _BESIDE, _TIP + _WAY + _BESIDE
    corners = size * np.array([x * ahead + y * across for x in ends for y in (-_HIGH, _HIGH)])
    # nodes at half-integer multiples of the spacing: a crack along an axis lies between two rows
    lower, upper = (spacing * (np.floor(corner / spacing) + 0.5) for corner in (corners.min(0), corners.max(0)))
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
    cut: Any = [start, tip]
    if dim == 3:
        # layers in 3D would take most of the time, and the forces hardly emit waves
        around = {"x": Periodic(), "all": Sponge(round(_SPONGE * size / spacing))}
        cut = Rectangle([-2 * _HIGH * size, *start], [4 * _HIGH * size, 0.0, 0.0], [0.0, *(tip - start)])
    lattice = Lattice(spacing, (*front, *lower), (*front, *upper))
    crack = RunningCrack(
        runs(Setup(lattice, model, around, sources=[source], cracks=[cut]), [tips]),
        tips,
        ahead,
        size,
        source,
        spacing ** (dim - 2),
    )
    sim, latest = crack.sim, (_FIRST + _WAY) * size / moving
    while not crack.follows and sim.time < latest:
        sim.step(int(size / (moving * sim.dt)))
    return crack


def energy_factor(runs: Runs, model: Elastic, spacing: float, dim: int, calibrate: str = "running") -> float:
    """Return the energy that cracks spend per new area at 0.3 of the speed of Rayleigh waves, divided by Young's
    modulus, the horizon and the square of the critical stretch; in 2D the mean of cracks along an axis of the lattice
    and at an angle to it. With `calibrate` "static" it is the energy at which a crack at rest along an axis begins to
    grow. It is taken from the cache of the program if it is there.

    The constants of the model are numbers; its own strength does not matter. Raises InputError if there is no kernel,
    the lattice is too coarse or too fine, or no crack runs or spends energy in the material, as in a correspondence
    material without stabilisation.
    """
    if not isinstance(model.kernel, Kernel):
        raise InputError(
            "a critical stretch is calibrated for a material with a kernel", value=model.title, key="model.kernel"
        )
    reach = model.kernel.horizon / spacing
    if not _COARSEST * (1 - MARGIN) <= reach <= _FINEST[dim]:
        raise InputError(
            "what a crack dissipates is found on lattices fine enough to let it run, and no finer than can be computed "
            "in minutes",
            value=f"{reach:.3g} spacings in the horizon",
            limit=f"{_COARSEST:g} to {_FINEST[dim]:g}",
            key="model.fracture_energy",
            remedy="critical_stretch",
        )
    tried = _in_units_of_the_lattice(model, model.kernel, spacing)
    path = _cache_file(tried, dim, calibrate)
    if (stored := kept(path)) is None:
        with awaited(path.with_suffix(".lock")):  # several processes may want the same one
            if (stored := kept(path)) is None:
                found = _energy_factor if calibrate == "running" else _static_factor
                stored = {"factor": np.array(found(runs, tried, dim))}
                keep(path, **stored)
    return float(stored["factor"])


def _in_units_of_the_lattice(model: Elastic, kernel: Kernel, spacing: float) -> Elastic:
    """Return the same material in units of the spacing, Young's modulus and the density, with linear bonds that
    break.
    """
    moduli = {name: getattr(model, name) / model.young for name in ("young", "bulk", "shear")}
    constants = moduli | {"poisson": model.poisson}
    tried = model.linearised.with_constants({name: round(value, _DIGITS) for name, value in constants.items()})
    unit = spacing * np.sqrt(model.density / model.young)
    width = None if kernel.width is None else round(kernel.width / spacing, _DIGITS)
    tried = tried.with_constants({"density": 1.0})
    tried.kernel = replace(kernel, horizon=round(kernel.horizon / spacing, _DIGITS), width=width)
    tried.damping, tried.drag = round(model.damping * unit, _DIGITS), round(model.drag * unit, _DIGITS)
    tried.critical_stretch, tried.surface, tried.calibrate = _STRETCH, None, "running"
    return tried


def _energy_factor(runs: Runs, model: Elastic, dim: int) -> float:
    """The same as `energy_factor` for a material in units of its lattice, computed from runs."""
    assert isinstance(model.kernel, Kernel)
    print(
        "farhorizon: simulating a crack to find the energy per area in this material, once: later runs find it on disk",
        file=sys.stderr,
        flush=True,
    )
    unit, energies, expected = model.young * model.kernel.horizon * _STRETCH**2, [], _of_bonds(model, dim)
    for turn in TURNS[dim]:
        expected = _spent(runs, model, dim, turn, expected)
        energies.append(expected)
    return float(np.mean(energies)) / unit


def _of_bonds(model: Elastic, dim: int) -> float:
    """Return the energy per area of single bonds, see `farhorizon.medium.fracture`."""
    assert isinstance(model.kernel, Kernel)
    return model.young * model.kernel.horizon * _STRETCH**2 * (12 / (5 * np.pi) if dim == 2 else 6 / 5)


def _static_factor(runs: Runs, model: Elastic, dim: int) -> float:
    """The same as `energy_factor` for a crack at rest, for a material in units of its lattice, computed from a run."""
    assert isinstance(model.kernel, Kernel)
    print(
        "farhorizon: pulling a strip with a crack to find the energy at which it grows in this material, once: later "
        "runs find it on disk",
        file=sys.stderr,
        flush=True,
    )
    grown = energies_at_rest(runs, model, dim, _of_bonds(model, dim))[1]
    return grown / (model.young * model.kernel.horizon * _STRETCH**2)


def _spent(runs: Runs, model: Elastic, dim: int, turn: float, expected: float) -> float:
    """Return what a crack at an angle to the lattice spends per new area, given an estimate of it."""
    stuck = 0.0  # estimate for which no crack ran: on coarse lattices a crack needs more energy than it spends
    for _ in range(_TRIES):
        crack = crack_after_forces(runs, model, 1.0, expected, turn=turn, dim=dim)
        if crack.follows and abs(crack.spent - expected) <= _AGREES * expected:
            break
        if crack.follows and crack.spent > 0:
            expected = max(crack.spent, _MORE * stuck)  # determines the forces
        else:
            stuck, expected = expected, _MORE**2 * expected
    if not crack.follows or crack.spent <= 0:
        raise InputError(
            "bonds that break dissipate no energy" if crack.follows else "no crack runs through this material",
            value=crack.spent if crack.follows else "none",
            key="model.fracture_energy",
            remedy="a larger horizon, or for a correspondence material a stabilisation",
        )
    return crack.spent


# the modules that determine how a crack runs, which bonds break and which energy is lost with them
_FILES = __file__, damage.__file__, release.__file__, force_states.__file__
_PROGRAM = b"".join(Path(str(file)).read_bytes() for file in _FILES)


def _cache_file(model: Elastic, dim: int, calibrate: str) -> Path:
    """Return the file that caches the number for this lattice and this version of the program."""
    assert isinstance(model.kernel, Kernel)
    mark = hashlib.sha256(_PROGRAM)
    for table in Stencil.family(model.kernel, 1.0, dim):
        mark.update(np.ascontiguousarray(table).tobytes())
    names = ("material", "plane", "stabilisation", "damping", "drag", "shape_tensor")
    constants = (round(model.poisson, _DIGITS - 2), *(getattr(model, name, None) for name in names))
    mark.update(repr((dim, calibrate, model.kernel.calibrate, *constants)).encode())
    return cache_folder() / f"toughness_{mark.hexdigest()[:24]}.npz"


def with_energy_factor(setup: Setup, runs: Runs, team: ProcessGroup) -> Setup:
    """Return the set-up with a model whose bonds can convert its fracture energy into a critical stretch; the first of
    several processes determines the number. Raises InputError as `energy_factor`, and if Poisson's ratio varies.
    """
    law = setup.model.bond_law
    if law is None or law.fracture_energy is None or law.energy_factor is not None:
        return setup
    if setup.model.bonds and law.calibrate == "running":  # the energy of the bonds across a plane
        return setup
    medium, variation = reference_and_variation(setup, team)
    ratio = np.ones(1) if variation.lame is None else variation.lame[0] / variation.lame[1]
    if team.largest(float(ratio.max())) + team.largest(-float(ratio.min())) > 10.0**-_DIGITS:
        raise InputError(
            "the energy per new area is found for one Poisson's ratio; the other constants may vary",
            value="one that varies",
            key="model.fracture_energy",
            remedy="critical_stretch, by region that of fh.calibrated_stretch",
        )
    lattice, reference, model = setup.lattice, cast(Elastic, medium.model), cast(Elastic, copy.copy(setup.model))
    given = reference, lattice.spacing, lattice.dim
    model.energy_factor = team.first(team.by_first(lambda: energy_factor(runs, *given, law.calibrate)))
    if law.calibrate == "static":
        running = team.first(team.by_first(lambda: energy_factor(runs, *given)))
        model.spent_by_running = running / model.energy_factor
    return replace(setup, model=model)


_HALF = 7.0  # half the height of the strip, in horizons; with twice that the energy changes by at most 3 %
_LONG = 2.0  # half its length, in its half heights: the middle of each half does not feel its ends
# times that a wave takes over half the height, in which the edges move as far as the expected energy requires (thrice
# that changes the energy by 1 %); the time in which waves are damped, in the same unit: what the edges emit dies out
# long before, but what a bond emits as it breaks still shakes its neighbours
_SLOW, _FADES = 80.0, 2.5
_LATEST = 4.0  # of these times until a crack must have grown: sixteen times the expected energy
_LOOKS = 1000  # times in one of them at which bonds are counted: the energy is exact to 0.2 %


def energies_at_rest(
    runs: Callable[[Setup, Sequence[Any]], Any], model: Elastic, dim: int, expected: float
) -> tuple[float, float]:
    """Return the energy per area of a strip when the first bonds ahead of a crack at rest break, and when as many have
    broken as cross its plane at one row of nodes, for an estimate of it.

    The model is in units of its lattice, with a critical stretch; in 3D the strip is a slab of one node, in plane
    strain.
    """
    assert isinstance(model.kernel, Kernel)
    half = float(np.ceil(_HALF * model.kernel.horizon))
    offsets = Stencil.family(model.kernel, 1.0, dim)[0]
    reach, front = int(np.abs(offsets).max()), (0.0,) * (dim - 2)
    tried = model.with_constants({})
    tried.damping = 1.0 / (_FADES * half)
    planned = _SLOW * half  # waves in a bar have the speed 1
    speed = np.sqrt(expected * half / model.p_modulus) / planned
    far = _LONG * half
    pulled = [_clamped(sign, half - reach, far, speed, dim) for sign in (1, -1)]
    around: dict[str, Side] = {"all": Free()} if dim == 2 else {"x": Periodic(), "all": Free()}
    strip = Lattice(1.0, (*front, 0.5 - far, 0.5 - half), (*front, far - 0.5, half - 0.5))
    crack: Any = [(-2 * far, 0.0), (0.0, 0.0)]
    if dim == 3:
        crack = Rectangle([-far, -2 * far, 0.0], [2 * far, 0.0, 0.0], [0.0, 2 * far, 0.0])
    cracked = runs(Setup(strip, tried, around, cracks=[crack], constraints=pulled), [])
    width = 2 * reach + 1
    column = Lattice(1.0, (*front, 0.0, 0.5 - half), (*front, width - 1.0, half - 0.5))
    unbroken = tried.linearised
    sides: dict[str, Side] = {"xy"[a]: Periodic() for a in range(dim - 1)} | {"all": Free()}
    intact = runs(Setup(column, unbroken, sides, constraints=pulled, dt=cracked.dt), [])
    per_row = int(offsets[offsets[:, -1] > 0][:, -1].sum())  # bonds that cross the plane of the crack, for each row
    count, energies = max(1, int(planned / (_LOOKS * cracked.dt))), []
    for broken in (1, per_row):
        while cracked.broken_bonds < broken:
            if cracked.time > _LATEST * planned:
                raise InputError(
                    "no crack grows in a strip of this material",
                    value=model.title,
                    key="model.calibrate",
                    remedy='calibrate = "running", or a larger horizon',
                )
            cracked.step(count)
        intact.run(cracked.time, progress=False)
        energies.append(float(intact.energies()["strain"]) / width)
    return energies[0], energies[1]


def _clamped(sign: int, edge: float, far: float, speed: float, dim: int) -> Prescribed:
    """Return what moves one edge of the strip away from the plane of the crack."""
    low, high = sorted([sign * (edge + 0.1), sign * far])
    region = Box([*[-2 * far] * (dim - 1), low], [*[2 * far] * (dim - 1), high])
    return Prescribed(region, velocity=[*[0.0] * (dim - 1), sign * speed])
