"""Which short waves a layer must damp, and by how much: what makes the lattice PML stable for every kernel.

In a layer a wave is stretched along its phase velocity. One whose group velocity points the other way, a *backward
wave*, then grows where it should decay: by ``sigma gamma`` per unit time, to first order in the layer's strength sigma,
with gamma from the symbol (`Stencil.layer_growth`). On a lattice such waves are short, and no run with a resolved field
needs them. So the layer damps the velocity of what a high-pass filter lets through, at a rate nu that follows sigma. A
wave of which the filter passes the share f then decays by ``nu f / 2`` per unit time, and ``nu f >= 2 sigma gamma``
stops it.

The filter is a maximally flat polynomial of ``y = sin^2(k spacing / 2)`` along each axis, the regularised incomplete
beta function ``I_y(rise, fall)``: it is 0 to the order `rise` at k = 0, 1 to the order `fall` at the shortest wave, and
between 0 and 1 everywhere, so it never feeds a wave.

Materials with zero-energy modes (correspondence without stabilisation) have short waves that hardly move. Damping of
the velocity turns these into still slower ones, which the layer stretches all the more: they would need more than twice
sigma, and grow even then. Of such stencils the waves themselves are damped (`whole`), so that s becomes ``s + rate``
for what passes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import special

from farhorizon.medium.stencil import Stencil

_BACKWARD = 1e-6  # growth over sigma from which on a wave counts as a backward one
# neighbours that a filter reads to either side along an axis: so many, and more for each node of the stencil's reach,
# for wide stencils have longer backward waves, which take sharper filters
_TAPS, _TAPS_PER_REACH = 6, 2
# the larger of these on a line, where they cost nothing, of filters for the waves themselves, and of stencils that
# reach so far: beside reaches of 6 and more long waves along a side grew by 0.01 c/spacing with fewer
_SHARP, _SHARP_PER_REACH, _FAR = 17, 6, 5
_RESOLVED = 0.6  # share of the first backward wavenumber up to which waves are to pass unharmed
_MARGIN = 1.25  # on the rate: between the wavenumbers that are looked at more may be needed
# waves that stand still: their group velocity, sine of their wavenumber, and growth over sigma that counts
_PACE, _INNER, _SECOND = 1e-3, 0.2, 0.01
# rate over sigma beyond which the shortest waves hardly move: 2 where they are at rest, much more if longer ones are,
# too
_SLOW = 1.7
_STILL = 50.0  # beyond that waves longer than two nodes are at rest
# of both: half passes at so many times the first backward wavenumber; rate over sigma
_WHOLE = ((1.21, 2.5), (1.45, 20.0))
_SHORT = 3, 1  # orders of a filter of three neighbours
# damping rate over sigma below which a layer does not feel the damping: there a short filter is steep enough
_WEAK = 0.06
# largest damping rate over sigma that is wanted, or over the least that is enough: a layer sends back the more the
# stronger its damping is, and the steepest filters, which need more, let waves grow between those looked at; where
# filters are sharp, waves that stand still take more
_MOST, _MOST_SHARP, _OVER_LEAST = 0.6, 0.95, 1.3


@dataclass(frozen=True)
class HighPass:
    """Damping of short waves in a layer.

    Attributes
    ----------
    rise, fall : int
        Orders of the filter ``I_y(rise, fall)``.
    strength : float
        Damping rate over sigma.
    first : float
        Least wavenumber times spacing of the waves that it stops.
    lowest : float
        Least eigenvalue of the symbol of these.
    whole : bool
        Whether waves are damped themselves, not their velocity alone.
    """

    rise: int
    fall: int
    strength: float
    first: float
    lowest: float = 0.0
    whole: bool = False

    @property
    def weak(self) -> bool:
        """Whether so little is damped that the ramps of stencils without backward waves serve."""
        return self.strength <= _WEAK

    @property
    def still(self) -> bool:
        """Whether waves longer than two nodes are at rest, too."""
        return self.whole and self.strength == _WHOLE[1][1]

    def passed(self, angle: np.ndarray | float) -> np.ndarray:
        """Share of a wave of given wavenumbers times spacing along one axis that the filter lets through."""
        return np.asarray(special.betainc(self.rise, self.fall, np.sin(np.asarray(angle) / 2) ** 2))

    def taps(self) -> np.ndarray:
        """The filter on the lattice: its weight of the node itself, of both neighbours, and so on, shape (rise +
        fall,).
        """
        count = 8 * (self.rise + self.fall)
        return np.fft.ifft(self.passed(2 * np.pi * np.arange(count) / count)).real[: self.rise + self.fall]


@lru_cache(maxsize=64)  # each side, and each copy of a set-up, asks again
def high_pass(stencil: Stencil) -> HighPass | None:
    """The filter that stops all backward waves of a stencil and touches resolved ones least; None if there are none.

    Parameters
    ----------
    stencil : Stencil

    Returns
    -------
    HighPass or None
        Waves that stand still count as backward ones. Of all filters of one length that need a rate of at most 0.6
        sigma (a sharp one 0.95), or little more than the least that is enough, the one that damps waves of 60 % of the
        first such wavenumber least. Where very little is enough a filter of three neighbours, which costs less and does
        less to the waves that a thin layer must absorb. Of materials with zero-energy modes a filter for the waves
        themselves.
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
        return float((2 * worst[backward] / np.maximum(passed, 1e-300)).max())

    filters = [HighPass(rise, count + 1 - rise, 1.0, first, lowest) for rise in range(1, count + 1)]
    rates = [rate_of(one) for one in filters]
    enough = max(most, _OVER_LEAST * min(rates))
    gentle = [(one, rate) for one, rate in zip(filters, rates, strict=True) if rate <= enough]
    chosen, rate = min(gentle, key=lambda pair: pair[1] * float(pair[0].passed(min(_RESOLVED * first, 1.0))))
    if rate > _SLOW:
        share, strength = _WHOLE[rate > _STILL]
        rise = round((sharp + 1) * float(np.sin(min(share * first, np.pi) / 2) ** 2))
        return HighPass(rise, sharp + 1 - rise, strength, first, lowest, True)
    if _MARGIN * rate <= _WEAK:
        short = HighPass(*_SHORT, 1.0, first, lowest)
        return replace(short, strength=_MARGIN * rate_of(short))
    return replace(chosen, strength=_MARGIN * rate)


def short_share(values: np.ndarray, first: float) -> float:
    """Largest value of what a field holds from a wavenumber times spacing on, over that of the field.

    Parameters
    ----------
    values : ndarray
        Not zero everywhere; taken to repeat itself.
    first : float
    """
    axes = np.ix_(*[2 * np.pi * np.fft.fftfreq(n) for n in values.shape])
    short = sum(axis**2 for axis in axes) >= first**2
    part = np.fft.ifftn(np.where(short, np.fft.fftn(values), 0)).real
    return float(np.abs(part).max() / np.abs(values).max())


def _standing(stencil: Stencil) -> np.ndarray:
    """Growth over sigma that is taken for waves of a line that stand still between others that run forward.

    To first order they keep their size in a layer, to second order a steep entrance makes them grow. On the line
    exponent 1 with constant influence has them: its group velocity touches zero inside the zone. In the plane waves
    under an angle would be backward where one along an axis stands.
    """
    (angle,), value, (slope,) = stencil.zone_branches
    sine = np.sin(angle)
    pace = slope[:, 0] * sine / (2 * np.maximum(value[:, 0], 1e-300))
    return np.where((pace < _PACE * sine**2) & (sine > _INNER), _SECOND * sine**2, 0.0)
