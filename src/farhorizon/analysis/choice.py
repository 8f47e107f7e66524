"""Choice of a lattice PML for waves: the thinnest layer of a family that sends back less than a target, from the exact reflection of a layer.

In the layer a mode zeta of the chain gains ``(1 + g w)/(1 - g w)`` over an edge, ``w = (zeta - 1)/(zeta + 1)``, with the stretch
``g = kappa + sigma/(s + alpha)`` and the discrete ``s = 2/dt (z - 1)/(z + 1)`` of the trapezoidal rule. Beyond the last column all continued values
are zero, which on the last edge reads ``U(k + 1) = rho U(k)``, ``rho = (g - 1)/(g + 1)``: K conditions for the K modes that go back. Where the layer
damps short waves its equations are solved, see `farhorizon.analysis.layer`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from farhorizon.analysis.layer import Medium, Wave, layer_amplitudes
from farhorizon.analysis.reflection import factor_of_wave
from farhorizon.analysis.short_waves import HighPass, high_pass
from farhorizon.engine import Layer
from farhorizon.errors import InputError
from farhorizon.machine import one_blas_thread
from farhorizon.stencil import Stencil

_FIRST, _MOST = 8, 120  # nodes of a layer that are tried
_SHIFT = 1e-3  # alpha in units of speed / spacing: bounds the drift at zero frequency; ten times as much spoils long waves
_STRENGTHS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)  # largest sigma in units of 2 speed / spacing: stronger, and waves near cut-off come back
_STRETCHES = (1.0, 2.0, 4.0)  # largest kappa
_SHIFTS = (0.0, 0.5, 1.0)  # largest alpha, see `Profile`
_SHEAR = 0.1  # largest alpha of vectors, see `Profile`
_WAVES, _ANGLES = 7, 6  # sample of the band and of the angles
_BEYOND = (1.05, 1.3, 2.0)  # tangential over whole wavenumber of waves that die out towards a side and come back from it, too
_MARGIN = 0.8  # of the target is aimed at: between the samples it can be a little more
_SPARE = 10  # a layer gets one node more for every so many: a pulse holds some waves beyond the angle and the band
_WEAK = 0.06  # damping rate over sigma up to which the damping is too weak to be felt on the ramps of stencils without backward waves
_SOFT, _MORE = 4, 12  # power of the ramp of such a damping beside a steeper sigma, and how much more of it that takes near the entrance
_DRIFT = (0.006, 0.03)  # alpha at the outer end in speed / spacing where waves are at rest, of two nodes or longer ones, too
_EARLIER = (0.92, 1.0)  # power of sigma's ramp in which their damping rises


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
    rate : float
        Damping of short waves over that which first order in sigma asks for.
    """

    strength: float
    stretch: float
    power: int
    shift: float = 0.0
    smooth: bool = False
    rate: float = 1.0

    def ramp(self, depth: np.ndarray) -> np.ndarray:
        """sigma in units of its largest value."""
        return (smooth_ramp(depth) if self.smooth else depth) ** self.power

    def edges(self, nodes: int, speed: float, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """kappa, sigma and alpha on the edges of a layer, arrays (nodes + 1,)."""
        depth = (np.arange(nodes + 1) + 0.5) / (nodes + 1)
        sigma = self.strength * 2 * speed / spacing * self.ramp(depth)
        alpha = _SHIFT + 12 / nodes * self.shift * self.strength * depth**7
        return 1 + (self.stretch - 1) * depth, sigma, alpha * speed / spacing

    def layer(self, nodes: int, speed: float, spacing: float, damped: HighPass | None) -> Layer:
        """The layer with the damping of short waves that the stencil needs."""
        kappa, sigma, alpha = self.edges(nodes, speed, spacing)
        if damped is None:
            return Layer(kappa, sigma, alpha)
        depth = np.arange(1, nodes + 1) / (nodes + 1)
        share = _MORE * smooth_ramp(depth) ** _SOFT if weak(damped) else self.ramp(depth)
        if damped.whole:
            share = share ** _EARLIER[damped.still]
            edges = (np.arange(nodes + 1) + 0.5) / (nodes + 1)
            alpha = alpha + _DRIFT[damped.still] * edges**2 * speed / spacing
        rate = self.rate * damped.strength * self.strength * 2 * speed / spacing
        return Layer(kappa, sigma, alpha, rate * share, damped.taps(), damped.whole)

    def __str__(self) -> str:
        rise = {1: "linear", 2: "square", 3: "cubic"}.get(self.power, f"to the power {self.power}")
        rise = f"smooth, {rise}," if self.smooth else rise
        others = (f", kappa to {self.stretch:g}" if self.stretch > 1 else "") + (f", alpha rising by {self.shift:g}" if self.shift else "")
        return f"sigma {rise} to {self.strength:g} 2c/spacing{others}"


def smooth_ramp(depth: np.ndarray) -> np.ndarray:
    """From 0 to 1 as a sine that ends short of its crest: on a plateau waves of zero frequency would grow in a wide stencil's layer."""
    return np.sin(0.4 * np.pi * depth) / np.sin(0.4 * np.pi)


def weak(damped: HighPass | None) -> bool:
    """Whether the ramps of stencils without backward waves serve."""
    return damped is None or damped.strength <= _WEAK


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


def layer_reflection(wave: Wave, layer: Layer) -> float:
    """Reflected amplitude of a layer, exactly, of all types together: of scalars in closed form where it does not damp short waves."""
    travels = wave.modes.travels
    if layer.damping.size or wave.weights.ndim > 1:
        return float(np.linalg.norm(layer_amplitudes(wave, layer)[travels]))
    stretch = layer.kappa + layer.sigma / (wave.s + layer.alpha)
    modes = np.append(wave.modes.leaving, wave.modes.incoming)
    gain = ((modes + 1)[:, None] + np.outer(modes - 1, stretch[:-1])) / ((modes + 1)[:, None] - np.outer(modes - 1, stretch[:-1]))
    through = np.log(gain).sum(1)  # logarithms: what evanescent modes gain overflows
    rho = (stretch[-1] - 1) / (stretch[-1] + 1)
    powers = np.arange(1, len(wave.modes.leaving) + 1)[:, None]
    conditions = modes**powers - rho**powers
    back = np.linalg.solve(conditions[:, :-1], -conditions[:, -1])
    return float(np.linalg.norm(back[travels] * np.exp(through[-1] - through[:-1][travels])))


def family(stencil: Stencil, damped: HighPass | None) -> list[Profile]:
    """Profiles that are tried.

    A strong entrance makes wide stencils grow; alpha rises for waves along the side, which a line does not have. A strong damping of short waves
    sends back what its ramp has of kinks and takes alpha's part, and a stretch kappa gains nothing beside it; that of
    vectors needs a little alpha against long waves along two sides.
    """
    reach, dim = stencil.reach[0], stencil.dim
    if not weak(damped):
        most, smooth = (2.0, True) if reach < 4 else (1.0, True) if reach < 5 else (0.7, False)
        powers = (3, 4, 5) if reach < 5 else (4, 5) if reach < 7 else (5,)
        return [Profile(s, 1.0, p, _SHEAR * (stencil.components > 1), smooth) for p in powers for s in _STRENGTHS if s <= most]
    wide = reach > 3
    powers = (1, 2, 3) if not wide else (2, 3) if reach < 6 else (3,)
    most = 2.0 if not wide else 1.0 if reach < 8 else 0.5
    shifts = _SHIFTS if dim > 1 and not wide else _SHIFTS[:1]
    return [Profile(s, k, p, a) for p in powers for k in _STRETCHES for a in shifts for s in _STRENGTHS if s <= most]


def worst(waves: Sequence[Wave], layer: Layer, above: float = np.inf) -> float:
    """Largest reflected amplitude of a layer over some waves; it stops at the first that is larger than `above`."""
    largest = 0.0
    for wave in waves:
        largest = max(largest, layer_reflection(wave, layer))
        if largest > above:
            break
    return largest


@one_blas_thread()
def choose(medium: Medium, target: float, band: tuple[float, float], angle: float) -> Choice:
    """The thinnest layer of the family whose reflection stays below a target, and a tenth more of it for the waves that nobody asked for.

    Of several that are as thin it is the one that sends least of all other waves back.

    Parameters
    ----------
    medium : Medium
    target : float
        Largest reflected amplitude of a plane wave of amplitude 1.
    band : tuple of float
        Shortest and longest wavelength, in spacings.
    angle : float
        Largest angle of incidence in degrees; without meaning on a line.

    Raises
    ------
    InputError
        No layer of up to 120 nodes meets the target.
    """
    waves, damped = sample(medium, band, angle), high_pass(medium.stencil)
    aim, thinnest = _MARGIN * target, _MOST
    found: list[Profile] = []

    def layer(profile: Profile, nodes: int) -> Layer:
        return profile.layer(nodes, medium.speed, medium.spacing, damped)

    for profile in family(medium.stencil, damped):
        nodes = _least(lambda n: worst(waves, layer(profile, n), aim) <= aim, thinnest if found else _FIRST, thinnest)  # noqa: B023
        if nodes is None:
            continue
        found = [profile] if nodes < thinnest else [*found, profile]
        thinnest = nodes
        tried = layer(profile, nodes)
        waves = sorted(waves, key=lambda wave, tried=tried: -layer_reflection(wave, tried))  # type: ignore[misc]  # the hardest first
    if not found:
        waves_text = f"waves of {band[0]:.3g} to {band[1]:.3g} spacings up to {angle:g} degrees"
        raise InputError(f"no layer of up to {_MOST} nodes meets the target", value=target, key="boundary.target", limit=waves_text,
                         remedy="a smaller angle or a larger target")  # fmt: skip
    others = beyond(medium, band, angle) or waves
    nodes = thinnest + thinnest // _SPARE

    def rest(profile: Profile) -> float:
        tried = layer(profile, nodes)
        return float(sum(np.log(max(layer_reflection(wave, tried), 1e-30)) for wave in others))

    best = min(found, key=rest)
    return Choice(best, nodes, worst(waves, layer(best, nodes)))


def _least(meets: Callable[[int], bool], first: int, most: int) -> int | None:
    """The smallest number of nodes that meets a target, None if `most` do not; the larger ones, which cost more, are tried last."""
    low, high = 0, first
    while not meets(high):
        if high == most:
            return None
        low, high = high, min(2 * high, most)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if meets(middle) else (middle, high)
    return high


def beyond(medium: Medium, band: tuple[float, float], angle: float) -> list[Wave]:
    """Waves that a choice does not bound: under larger angles, and, of scalars, of larger tangential wavenumber than they can travel with."""
    dim = medium.stencil.dim
    if dim == 1:
        return []
    angles, wavelengths = ((2 * angle + 90) / 3, (angle + 180) / 3), np.geomspace(*band, 3)
    if medium.stencil.components > 1:
        return _plane_waves(medium, wavelengths, np.array(angles))
    found = []
    for wavelength in wavelengths:
        number = 2 * np.pi / wavelength
        factor = factor_of_wave(-medium.rate * float(medium.stencil.symbol(number, *[0.0] * (dim - 1))), medium.recursion)
        for share in (*np.sin(np.radians(angles)), *_BEYOND):
            if share * number < np.pi:
                found.append(medium.wave([share * number, 0.0][: dim - 1], factor, np.exp(1j * number * np.sqrt(complex(1 - share**2)))))
    return found


def sample(medium: Medium, band: tuple[float, float], angle: float) -> list[Wave]:
    """Waves of a band and up to an angle, of all types; what does not come to the side is left out.

    Raises
    ------
    InputError
        None comes to the side.
    """
    angles = np.linspace(0, angle, _ANGLES) if medium.stencil.dim > 1 else np.zeros(1)
    found = _plane_waves(medium, np.geomspace(*band, _WAVES), angles)
    if not found:
        raise InputError("no wave of the band comes to the side", value=band, key="boundary.wavelengths")
    return found


def _plane_waves(medium: Medium, wavelengths: np.ndarray, angles: np.ndarray) -> list[Wave]:
    """Plane waves of all types that come to the side; of vectors in space along the first tangential axis and between both."""
    components = medium.stencil.components
    found = []
    for wavelength, angle, azimuth, number in itertools.product(wavelengths, angles, (0.0, 45.0)[: max(1, components - 1)], range(components)):
        try:
            wave = medium.plane_wave(float(wavelength), float(angle), azimuth, number)
        except InputError:
            continue
        found.append(wave if components == 1 else _up_to(wave, float(angles.max())))
    return found


def _up_to(wave: Wave, angle: float) -> Wave:
    """A wave of which those of another type that leave under a larger angle do not count: an S wave near the critical one sends P along the side."""
    normal = np.abs(np.angle(wave.modes.leaving))
    counts = np.degrees(np.arctan2(np.linalg.norm(wave.along), normal)) <= angle + 1e-9
    return replace(wave, modes=replace(wave.modes, travels=wave.modes.travels & counts))
