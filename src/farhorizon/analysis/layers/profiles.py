"""Profiles of lattice PMLs for waves, and how evanescent modes grow in them: why wide kernels need short entrances.

At a frequency w a stencil of reach K has K modes ahead of a side, most of them evanescent, ``t = tan(theta / 2)`` with
Im t > 0. In the layer t becomes ``(1 + sigma/(i w + alpha)) t``. Where sigma/w turns t past the real axis, a mode with
Re t > 0 *grows* outwards. As the stretch is exact, nothing is reflected before the outer end, but there it is. The gain
of a mode between the point where it begins to grow and the end depends on the columns in which sigma is of the order of
w: on the width of the entrance, not on the peak of sigma. Narrow kernels have only modes that decay within a node. Wide
kernels have some that are nearly waves, and with a long entrance these sustain themselves inside the layer.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from farhorizon.analysis.layers.chain_modes import chain_weights
from farhorizon.analysis.layers.short_waves import HighPass, high_pass
from farhorizon.engine.engine import Layer
from farhorizon.medium.stencil import Stencil

# alpha in units of speed / spacing, which bounds the drift at zero frequency; ten times as much lets long waves through
_SHIFT = 1e-3
_END = 0.15  # alpha over sigma at the outer end of thin layers
# power of the ramp of weak damping, and the factor on its rate, since sigma rises more steeply than it near the
# entrance
_SOFT, _MORE = 4, 3
# added to alpha at the outer end, in speed / spacing, where waves are at rest: those of two nodes, or longer ones, too
_DRIFT = (0.006, 0.03)
_EARLIER = (0.92, 1.0)  # power of sigma's ramp as which their damping rises, for the same two cases
_HARDLY, _CROWDED = (
    0.1,
    0.38,
)  # group velocity over the long waves' speed; fraction of slower waves above which they crowd
_FREQUENCIES = np.linspace(0.03, 0.6, 20)  # over the largest; higher ones belong to short waves, which are damped
_LONG = 0.005  # tangential wavenumber times spacing
_TRAVELS = 1e-7  # distance from the unit circle below which a mode travels


@dataclass(frozen=True)
class Profile:
    """A member of the family: sigma rises to ``strength 2 speed / spacing``, kappa to `stretch` and alpha to ``12 shift
    strength / nodes``.
    """

    strength: float
    stretch: float
    #: Power of the ramp in sigma. kappa rises linearly, alpha as the seventh power, so that waves near cut-off are
    #: affected by the outer end alone.
    power: int
    shift: float = 0.0
    #: Whether sigma rises as a power of `smooth_ramp` instead of the depth: where short waves are damped, the damping
    #: must not begin with a kink.
    smooth: bool = False
    #: Damping of short waves over that required by first order in sigma.
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
        """The layer, with the damping of short waves that the stencil requires."""
        kappa, sigma, alpha = self.edges(nodes, speed, spacing)
        if damped is None:
            return Layer(kappa, sigma, alpha)
        depth = np.arange(1, nodes + 1) / (nodes + 1)
        ramp = _MORE * smooth_ramp(depth) ** _SOFT if weak(damped) else self.ramp(depth)
        if damped.whole:
            ramp = ramp ** _EARLIER[damped.still]
            edges = (np.arange(nodes + 1) + 0.5) / (nodes + 1)
            alpha = alpha + _DRIFT[damped.still] * edges**2 * speed / spacing
        rate = self.rate * damped.strength * self.strength * 2 * speed / spacing
        return Layer(kappa, sigma, alpha, rate * ramp, damped.taps(), damped.whole)


def rising_alpha(sigma: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """alpha of thin layers, which rises as the fourth power of the depth to a fixed part of sigma at the outer end."""
    return np.asarray(_SHIFT + _END * sigma[-1] * depth**4)


def smooth_ramp(depth: np.ndarray) -> np.ndarray:
    """Ramp from 0 to 1: a sine that ends short of its crest, because on a plateau waves of zero frequency would grow in
    the layer of a wide stencil.
    """
    return np.sin(0.4 * np.pi * depth) / np.sin(0.4 * np.pi)


def weak(damped: HighPass | None) -> bool:
    """Whether the ramps of stencils without backward waves can be used."""
    return damped is None or damped.weak


def crowded(stencil: Stencil) -> bool:
    """Whether many of a scalar's waves along the normal hardly move and are not damped; thin profiles then reflect more
    than is predicted, and grow.

    For exponent 1 with linear influence and a reach of 4 nodes, 40 % of the waves travel at less than a tenth of the
    speed of long waves; thin profiles of 10 to 14 nodes caused up to 25 times the predicted error.
    """
    if stencil.components > 1 or not weak(high_pass(stencil)):
        return False
    k = np.linspace(1e-3, np.pi, 500)
    frequency = np.sqrt(np.maximum(stencil.symbol(k, *[np.zeros_like(k)] * (stencil.dim - 1)), 0.0))
    return float((np.abs(np.gradient(frequency, k)) < _HARDLY).mean()) > _CROWDED


def largest_gain(stencil: Stencil, kappa: np.ndarray, sigma: np.ndarray, alpha: np.ndarray) -> float:
    """Logarithm of the largest factor by which a mode of low frequency grows inside a layer, from the stretch of its
    edges, (columns + 1,), in units of speed over spacing, for a stencil whose first axis is the normal. Components are
    treated separately: long waves along the side hardly couple them.
    """
    largest = 0.0
    for frequency, roots in _evanescent_modes(stencil):
        stretched = np.outer(-1j * (roots - 1) / (roots + 1), kappa + sigma / (1j * frequency + alpha))
        steps = np.log(np.abs((1 + 1j * stretched) / (1 - 1j * stretched)))
        size = np.cumsum(np.pad(steps, ((0, 0), (1, 0))), axis=1)
        largest = max(largest, float((size - np.minimum.accumulate(size, axis=1)).max(initial=0)))
    return largest


@lru_cache(maxsize=8)
def _evanescent_modes(stencil: Stencil) -> list[tuple[float, np.ndarray]]:
    """Frequencies, and for each the factors per node of the modes that are evanescent in the medium. They are cached,
    because for wide kernels they take far longer to compute than the gain of a layer.
    """
    weights = chain_weights(stencil, [_LONG] * (stencil.dim - 1))
    chains = np.diagonal(weights, axis1=1, axis2=2).T if stencil.components > 1 else weights[None]
    modes = []
    for frequency, component in itertools.product(_FREQUENCIES * np.sqrt(stencil.symbol_maximum), chains):
        chain = component.copy()
        chain[len(chain) // 2] += frequency**2
        roots = np.roots(chain)
        modes.append((float(frequency), roots[np.abs(roots) < 1 - _TRAVELS]))
    return modes
