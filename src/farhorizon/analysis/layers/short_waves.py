"""Which short waves a layer must damp, and by how much: this makes the lattice PML stable for every kernel.

In a layer a wave is stretched along its phase velocity. A *backward wave*, whose group velocity points the other way,
then grows where it should decay: at the rate ``sigma gamma`` to first order in the layer's strength sigma, with gamma
from the symbol (`Stencil.layer_growth`). On a lattice such waves are short, and no run with a resolved field needs
them. The layer therefore damps the high-pass filtered velocity at a rate nu that follows sigma. A wave of which the
filter passes the fraction f then decays at the rate ``nu f / 2``, so that ``nu f >= 2 sigma gamma`` prevents growth.

The filter is a maximally flat polynomial of ``y = sin^2(k spacing / 2)`` along each axis, the regularised incomplete
beta function ``I_y(rise, fall)``: it is 0 to the order `rise` at k = 0, 1 to the order `fall` at the shortest wave, and
between 0 and 1 everywhere, so that it never feeds a wave.

Materials with zero-energy modes (correspondence without stabilisation) have short waves that hardly move. Damping of
the velocity turns these into still slower ones, which the layer stretches all the more: they would require a rate of
more than twice sigma, and would grow even then. For such stencils the waves themselves are damped (`whole`), so that s
becomes ``s + rate`` for what the filter passes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import special

from farhorizon.medium.stencil import Stencil
from farhorizon.rounding import TINY

_BACKWARD = 1e-6  # growth over sigma from which on a wave counts as a backward one
# neighbours that a filter reads to either side along an axis: a base number, and more for each node of the stencil's
# reach, because wide stencils have longer backward waves, which require sharper filters
_TAPS, _TAPS_PER_REACH = 6, 2
# the larger of the first two on a line, where they cost nothing, for filters of the waves themselves, and for stencils
# whose reach is the third or more: with fewer, long waves along a side grew by 0.01 c/spacing at reaches of 6 and more
_SHARP, _SHARP_PER_REACH, _FAR = 17, 6, 5
_RESOLVED = 0.6  # part of the first backward wavenumber up to which waves should remain undamped
_MARGIN = 1.25  # on the rate: between the sampled wavenumbers more may be needed
# waves that stand still: largest group velocity, smallest sine of the wavenumber, and the growth over sigma assigned to
# them
_PACE, _INNER, _SECOND = 1e-3, 0.2, 0.01
# rate over sigma beyond which the shortest waves hardly move: 2 where they are at rest, much more if longer ones are at
# rest, too
_SLOW = 1.7
_STILL = 50.0  # beyond that waves longer than two nodes are at rest
# for each of these two cases: wavenumber at which half passes, over the first backward one; rate over sigma
_WHOLE = ((1.21, 2.5), (1.45, 20.0))
_SHORT = 3, 1  # orders of a filter of three neighbours
# damping rate over sigma below which a layer is not disturbed by the damping: there a short filter is steep enough
_WEAK = 0.06
# largest admissible damping rate over sigma (the second for sharp filters, with which waves that stand still require
# more), or over the smallest sufficient one: the stronger the damping, the more a layer reflects, and the steepest
# filters, which require higher rates, let waves grow between the sampled ones
_MOST, _MOST_SHARP, _OVER_LEAST = 0.6, 0.95, 1.3


@dataclass(frozen=True)
class HighPass:
    """Damping of short waves in a layer."""

    #: Orders of the filter ``I_y(rise, fall)``.
    rise: int
    fall: int
    #: Damping rate over sigma.
    strength: float
    #: Smallest wavenumber times spacing of the waves that it stops.
    first: float
    #: Smallest eigenvalue of the symbol for these waves.
    lowest: float = 0.0
    #: Whether the waves themselves are damped, not only their velocity.
    whole: bool = False

    @property
    def weak(self) -> bool:
        """Whether so little damping is needed that the ramps of stencils without backward waves can be used."""
        return self.strength <= _WEAK

    @property
    def still(self) -> bool:
        """Whether waves longer than two nodes are at rest, too."""
        return self.whole and self.strength == _WHOLE[1][1]

    def passed(self, angles: np.ndarray | float) -> np.ndarray:
        """Fraction of a wave that the filter passes, for wavenumbers times spacing along one axis."""
        shortness = np.sin(np.asarray(angles) / 2) ** 2
        if self.rise == 0 or self.fall == 0:  # steps, for which not every version of SciPy has the limit
            return np.asarray(shortness > 0 if self.rise == 0 else shortness >= 1, float)
        return np.asarray(special.betainc(self.rise, self.fall, shortness))

    def taps(self) -> np.ndarray:
        """Weights of the filter on the lattice: of the node itself, of its two nearest neighbours, and so on, shape
        (rise + fall,).
        """
        count = 8 * (self.rise + self.fall)
        return np.fft.ifft(self.passed(2 * np.pi * np.arange(count) / count)).real[: self.rise + self.fall]


@lru_cache(maxsize=64)  # called for each side, and for each copy of a set-up
def high_pass(stencil: Stencil) -> HighPass | None:
    """The filter that stops all backward waves of a stencil and damps resolved waves least; None if there are no
    backward waves.

    Waves that stand still count as backward waves. Among all filters of one length that require a rate of at most 0.6
    sigma (sharp ones 0.95), or little more than the smallest sufficient one, the filter that least damps waves at 60 %
    of the first such wavenumber. Where a very low rate is sufficient, a filter of three neighbours, which costs less
    and disturbs the waves that a thin layer must absorb less. For materials with zero-energy modes, a filter for the
    waves themselves.
    """
    zone, growth = stencil.layer_growth
    worst = growth.max(-1)
    if not worst.any() and stencil.dim == 1:
        worst = _standing(stencil)
    backward = np.nonzero(worst > _BACKWARD)
    if not backward[0].size:
        return None
    first = float(np.sqrt(sum(axis**2 for axis in zone))[backward].min())
    values = stencil.zone_branches[1]
    lowest = float(values[growth > _BACKWARD].min(initial=values[backward].max()))
    reach = max(stencil.reach)
    sharp = max(_SHARP, _SHARP_PER_REACH * reach)
    count, most = (
        (sharp, _MOST_SHARP) if stencil.dim == 1 or reach >= _FAR else (_TAPS + _TAPS_PER_REACH * reach, _MOST)
    )

    def rate_of(filtered: HighPass) -> float:
        passed = sum(filtered.passed(axis).ravel()[index] for axis, index in zip(zone, backward, strict=True))
        return float((2 * worst[backward] / np.maximum(passed, TINY)).max())

    filters = [HighPass(rise, count + 1 - rise, 1.0, first, lowest) for rise in range(1, count + 1)]
    rates = [rate_of(candidate) for candidate in filters]
    enough = max(most, _OVER_LEAST * min(rates))
    gentle = [(candidate, rate) for candidate, rate in zip(filters, rates, strict=True) if rate <= enough]
    chosen, rate = min(gentle, key=lambda pair: pair[1] * float(pair[0].passed(min(_RESOLVED * first, 1.0))))
    if rate > _SLOW:
        ratio, strength = _WHOLE[rate > _STILL]
        rise = round((sharp + 1) * float(np.sin(min(ratio * first, np.pi) / 2) ** 2))
        return HighPass(rise, sharp + 1 - rise, strength, first, lowest, True)
    if _MARGIN * rate <= _WEAK:
        short = HighPass(*_SHORT, 1.0, first, lowest)
        return replace(short, strength=_rounded(_MARGIN * rate_of(short)))
    return replace(chosen, strength=_rounded(_MARGIN * rate))


def _rounded(rate: float) -> float:
    """A rate to ten digits: in a medium that varies, stencils on several processes differ by a factor of their
    reference medium, and what follows from them by rounding.
    """
    return float(f"{rate:.10g}")


def _standing(stencil: Stencil) -> np.ndarray:
    """Growth over sigma that is assumed for waves on a line that stand still between others that run forward.

    To first order they keep their size in a layer; to second order they grow at a steep entrance. On a line, exponent 1
    with constant influence has such waves: its group velocity touches zero inside the zone. In the plane, where a wave
    along an axis stands still, waves at an angle to it would be backward ones.
    """
    (angle,), value, (slope,) = stencil.zone_branches
    sine = np.sin(angle)
    pace = slope[:, 0] * sine / (2 * np.maximum(value[:, 0], TINY))
    return np.where((pace < _PACE * sine**2) & (sine > _INNER), _SECOND * sine**2, 0.0)
