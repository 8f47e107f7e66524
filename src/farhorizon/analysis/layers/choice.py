"""The steep profiles of lattice PMLs for waves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
_HARDLY, _CROWDED = 0.1, 0.38  # group velocity over the long waves' speed; share of slower waves above which they crowd


@dataclass(frozen=True)
class Profile:
    """A member of the family: sigma rises to ``strength 2 speed / spacing``, kappa to `stretch` and alpha to ``12 shift
    strength / nodes``.

    Attributes
    ----------
    strength, stretch : float
    power : int
        Power of the ramp in sigma. kappa rises linearly, alpha as the seventh power, so that waves near cut-off are
        affected by the outer end alone.
    shift : float
    smooth : bool
        Whether sigma rises as a power of `smooth_ramp` instead of the depth: where short waves are damped, the damping
        must not begin with a kink.
    rate : float
        Damping of short waves over that required by first order in sigma.
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
        """The layer, with the damping of short waves that the stencil requires."""
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
        others = (f", kappa to {self.stretch:g}" if self.stretch > 1 else "") + (
            f", alpha rising by {self.shift:g}" if self.shift else ""
        )
        return f"sigma {rise} to {self.strength:g} 2c/spacing{others}"


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
