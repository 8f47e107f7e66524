"""Choice of a lattice PML for waves: the thinnest layer of a family that sends back less than a target, from the exact reflection of a layer.

In the layer a mode zeta of the chain gains ``(1 + g w)/(1 - g w)`` over an edge, ``w = (zeta - 1)/(zeta + 1)``, with the stretch
``g = kappa + sigma/(s + alpha)`` and the discrete ``s = 2/dt (z - 1)/(z + 1)`` of the trapezoidal rule. Beyond the last column all continued values
are zero, which on the last edge reads ``U(k + 1) = rho U(k)``, ``rho = (g - 1)/(g + 1)``: K conditions for the K modes that go back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from farhorizon.analysis.chain import Recursion
from farhorizon.analysis.reflection import Modes, chain_modes, chain_weights, factor_of_wave
from farhorizon.errors import InputError
from farhorizon.stencil import Stencil

_MOST = 120  # nodes of a layer
_SHIFT = 1e-3  # alpha in units of speed / spacing: bounds the drift at zero frequency; ten times as much spoils long waves
_STRENGTHS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)  # largest sigma in units of 2 speed / spacing: stronger, and waves near cut-off come back
_STRETCHES = (1.0, 2.0, 4.0)  # largest kappa
_SHIFTS = (0.0, 0.5, 1.0)  # largest alpha, see `Profile`
_WAVES, _ANGLES = 5, 6  # sample of the band and of the angles
_BEYOND = (1.05, 1.3, 2.0)  # tangential over whole wavenumber of waves that die out towards a side and come back from it, too
_MARGIN = 0.8  # of the target is aimed at: between the samples it can be a little more


@dataclass(frozen=True)
class Profile:
    """A member of the family: sigma rises to ``strength 2 speed / spacing``, kappa to `stretch` and alpha to ``12 shift strength / nodes``.

    Attributes
    ----------
    strength, stretch : float
    power : int
        Of the ramp in sigma; kappa rises linearly, alpha as the seventh power: waves near cut-off are turned by the outer end alone.
    shift : float
    smooth : bool
        Whether sigma rises as a power of `smooth_ramp`, else of the depth: where short waves are damped, the damping must not begin with a kink.
    """

    strength: float
    stretch: float
    power: int
    shift: float = 0.0
    smooth: bool = False

    def ramp(self, depth: np.ndarray) -> np.ndarray:
        """sigma in units of its largest value."""
        return (smooth_ramp(depth) if self.smooth else depth) ** self.power

    def edges(self, nodes: int, speed: float, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """kappa, sigma and alpha on the edges of a layer, arrays (nodes + 1,)."""
        depth = (np.arange(nodes + 1) + 0.5) / (nodes + 1)
        sigma = self.strength * 2 * speed / spacing * self.ramp(depth)
        alpha = _SHIFT + 12 / nodes * self.shift * self.strength * depth**7
        return 1 + (self.stretch - 1) * depth, sigma, alpha * speed / spacing

    def __str__(self) -> str:
        rise = "smooth" if self.smooth else {1: "linear", 2: "square", 3: "cubic"}[self.power]
        others = (f", kappa to {self.stretch:g}" if self.stretch > 1 else "") + (f", alpha rising by {self.shift:g}" if self.shift else "")
        return f"sigma {rise} to {self.strength:g} 2c/spacing{others}"


def smooth_ramp(depth: np.ndarray) -> np.ndarray:
    """From 0 to 1 as a sine that ends short of its crest: on a plateau waves of zero frequency would grow in a wide stencil's layer."""
    return np.sin(0.4 * np.pi * depth) / np.sin(0.4 * np.pi)


@dataclass(frozen=True)
class Wave:
    """A plane wave that meets a side.

    Attributes
    ----------
    modes : Modes
    s : complex
        Discrete frequency of the trapezoidal rule, ``2/dt (z - 1)/(z + 1)``.
    """

    modes: Modes
    s: complex


@dataclass(frozen=True)
class Choice:
    """A layer and what it sends back.

    Attributes
    ----------
    profile : Profile
    nodes : int
    amplitude : float
        Largest reflected amplitude over the band and the angles.
    """

    profile: Profile
    nodes: int
    amplitude: float

    def __str__(self) -> str:
        return f"{self.profile}: at most {20 * np.log10(max(self.amplitude, 1e-16)):.0f} dB"


def plane_wave(stencil: Stencil, rate: float, recursion: Recursion, dt: float, wavelength: float, angle: float) -> Wave:
    """The wave of a wavelength in spacings under an angle in degrees to the first axis, in the plane of the first two.

    Raises
    ------
    InputError
        No such wave comes to the side.
    """
    number = 2 * np.pi / wavelength
    normal = number * np.cos(np.radians(angle))
    along = [number * np.sin(np.radians(angle)), 0.0][: stencil.dim - 1]
    factor = factor_of_wave(-rate * float(stencil.symbol(normal, *along)), recursion)
    return Wave(chain_modes(rate * chain_weights(stencil, along), factor, recursion, np.exp(1j * normal)), 2 / dt * (factor - 1) / (factor + 1))


def layer_reflection(wave: Wave, kappa: np.ndarray, sigma: np.ndarray, alpha: np.ndarray) -> float:
    """Reflected amplitude of a layer, exactly.

    Parameters
    ----------
    wave : Wave
    kappa, sigma, alpha : ndarray, shape (nodes + 1,)
        Stretch on the edges from the near field outwards.
    """
    stretch = kappa + sigma / (wave.s + alpha)
    modes = np.append(wave.modes.leaving, wave.modes.incoming)
    gain = ((modes + 1)[:, None] + np.outer(modes - 1, stretch[:-1])) / ((modes + 1)[:, None] - np.outer(modes - 1, stretch[:-1]))
    through = np.log(gain).sum(1)  # logarithms: what evanescent modes gain overflows
    rho = (stretch[-1] - 1) / (stretch[-1] + 1)
    powers = np.arange(1, len(wave.modes.leaving) + 1)[:, None]
    conditions = modes**powers - rho**powers
    back = np.linalg.solve(conditions[:, :-1], -conditions[:, -1])
    travels = wave.modes.travels
    return float(np.sqrt((np.abs(back[travels] * np.exp(through[-1] - through[:-1][travels])) ** 2).sum()))


def family(reach: int, dim: int) -> list[Profile]:
    """Profiles that are tried: a strong entrance makes wide stencils grow; alpha rises for waves along the side, which a line does not have."""
    wide = reach > 3
    powers = (1, 2, 3) if not wide else (2, 3) if reach < 6 else (3,)
    most = 2.0 if not wide else 1.0 if reach < 8 else 0.5
    shifts = _SHIFTS if dim > 1 and not wide else _SHIFTS[:1]
    return [Profile(s, k, p, a) for p in powers for k in _STRETCHES for a in shifts for s in _STRENGTHS if s <= most]


def worst(waves: Sequence[Wave], profile: Profile, nodes: int, speed: float, spacing: float, above: float = np.inf) -> float:
    """Largest reflected amplitude of a layer over some waves; it stops at the first that is larger than `above`."""
    edges, largest = profile.edges(nodes, speed, spacing), 0.0
    for wave in waves:
        largest = max(largest, layer_reflection(wave, *edges))
        if largest > above:
            break
    return largest


def choose(
    stencil: Stencil,
    rate: float,
    recursion: Recursion,
    dt: float,
    target: float,
    band: tuple[float, float],
    angle: float,
    speed: float,
    spacing: float,
) -> Choice:
    """The thinnest layer of the family whose reflection stays below a target; of several, that which sends least of all other waves back.

    Parameters
    ----------
    stencil : Stencil
        Its first axis is the side's normal.
    rate : float
        ``coefficient / spacing^2``.
    recursion : Recursion
    dt : float
    target : float
        Largest reflected amplitude of a plane wave of amplitude 1.
    band : tuple of float
        Shortest and longest wavelength, in spacings.
    angle : float
        Largest angle of incidence in degrees; without meaning on a line.
    speed, spacing : float

    Raises
    ------
    InputError
        No layer of up to 120 nodes meets the target.
    """
    waves = sample(stencil, rate, recursion, dt, band, angle)
    aim, thinnest = _MARGIN * target, _MOST
    found: list[Profile] = []
    for profile in family(stencil.reach[0], stencil.dim):
        if worst(waves, profile, thinnest, speed, spacing, aim) > aim:
            continue
        low, high = 0, thinnest
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if worst(waves, profile, middle, speed, spacing, aim) <= aim else (middle, high)
        found = [profile] if high < thinnest else [*found, profile]
        thinnest = high
        edges = profile.edges(high, speed, spacing)
        waves = sorted(waves, key=lambda wave, edges=edges: -layer_reflection(wave, *edges))  # type: ignore[misc]  # the hardest first
    if not found:
        waves_text = f"waves of {band[0]:.3g} to {band[1]:.3g} spacings up to {angle:g} degrees"
        raise InputError(f"no layer of up to {_MOST} nodes meets the target", value=target, key="boundary.target", limit=waves_text,
                         remedy="a smaller angle or a larger target")  # fmt: skip
    others = beyond(stencil, rate, recursion, dt, band, angle) or waves

    def rest(profile: Profile) -> float:
        edges = profile.edges(thinnest, speed, spacing)
        return float(sum(np.log(max(layer_reflection(wave, *edges), 1e-30)) for wave in others))

    best = min(found, key=rest)
    return Choice(best, thinnest, worst(waves, best, thinnest, speed, spacing))


def beyond(stencil: Stencil, rate: float, recursion: Recursion, dt: float, band: tuple[float, float], angle: float) -> list[Wave]:
    """Waves that a choice does not bound: under larger angles, and of larger tangential wavenumber than they can travel with. None on a line."""
    if stencil.dim == 1:
        return []
    found = []
    for wavelength in np.geomspace(*band, 3):
        number = 2 * np.pi / wavelength
        for share in (*np.sin(np.radians([(2 * angle + 90) / 3, (angle + 180) / 3])), *_BEYOND):
            if share * number >= np.pi:
                continue
            along = [share * number, 0.0][: stencil.dim - 1]
            normal = number * np.sqrt(complex(1 - share**2))
            factor = factor_of_wave(-rate * float(stencil.symbol(number, *[0.0] * (stencil.dim - 1))), recursion)
            modes = chain_modes(rate * chain_weights(stencil, along), factor, recursion, np.exp(1j * normal))
            found.append(Wave(modes, 2 / dt * (factor - 1) / (factor + 1)))
    return found


def sample(stencil: Stencil, rate: float, recursion: Recursion, dt: float, band: tuple[float, float], angle: float) -> list[Wave]:
    """Waves of a band and up to an angle; what does not come to the side is left out.

    Raises
    ------
    InputError
        None comes to the side.
    """
    angles = np.linspace(0, angle, _ANGLES) if stencil.dim > 1 else [0.0]
    found = []
    for wavelength in np.geomspace(*band, _WAVES):
        for theta in angles:
            try:
                found.append(plane_wave(stencil, rate, recursion, dt, float(wavelength), float(theta)))
            except InputError:
                continue
    if not found:
        raise InputError("no wave of the band comes to the side", value=band, key="boundary.wavelengths")
    return found
