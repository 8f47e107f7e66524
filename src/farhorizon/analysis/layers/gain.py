"""What a mode that dies out in the medium gains on its way through a layer: why wide kernels need short entrances.

At a frequency w a stencil of reach K has K modes ahead of a side, of which most die out, ``t = tan(theta / 2)`` with Im
t > 0. In the layer t becomes ``(1 + sigma/(i w + alpha)) t``. Where sigma/w turns it past the real axis, a mode with Re
t > 0 *grows* outwards; the stretch is exact, so nothing comes back before the outer end, but there it does. What a mode
gains from where it begins to grow up to the end depends on the columns in which sigma is of the order of w: on the
width of the entrance, not on how strong it becomes. The narrow kernels have only modes that die out within a node. Wide
ones have such that are nearly waves, and with a long entrance these keep themselves alive inside the layer.
"""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np

from farhorizon.analysis.layers.reflection import chain_weights
from farhorizon.medium.stencil import Stencil

_FREQUENCIES = np.linspace(0.03, 0.6, 20)  # of the largest: higher ones are those of short waves, which are damped
_LONG = 0.005  # tangential wavenumber times spacing
_TRAVELS = 1e-7  # from the unit circle


def largest_gain(stencil: Stencil, kappa: np.ndarray, sigma: np.ndarray, alpha: np.ndarray) -> float:
    """Logarithm of the largest factor by which a mode of low frequency grows inside a layer.

    Parameters
    ----------
    stencil : Stencil
        Its first axis is the normal. Of vectors each component counts by itself: long waves along the side hardly
        couple them.
    kappa, sigma, alpha : ndarray, shape (columns + 1,)
        Stretch of the edges, sigma and alpha in units of speed over spacing.
    """
    found = 0.0
    for frequency, roots in _dying(stencil):
        turned = np.outer(-1j * (roots - 1) / (roots + 1), kappa + sigma / (1j * frequency + alpha))
        steps = np.log(np.abs((1 + 1j * turned) / (1 - 1j * turned)))
        way = np.cumsum(np.pad(steps, ((0, 0), (1, 0))), axis=1)
        found = max(found, float((way - np.minimum.accumulate(way, axis=1)).max(initial=0)))
    return found


@lru_cache(maxsize=8)
def _dying(stencil: Stencil) -> list[tuple[float, np.ndarray]]:
    """Frequencies, and the factors from node to node of the modes that die out in the medium. Those of wide kernels
    take far longer to find than a layer takes to be looked at.
    """
    weights = chain_weights(stencil, [_LONG] * (stencil.dim - 1))
    chains = np.diagonal(weights, axis1=1, axis2=2).T if stencil.components > 1 else weights[None]
    found = []
    for frequency, component in itertools.product(_FREQUENCIES * np.sqrt(stencil.symbol_maximum), chains):
        chain = component.copy()
        chain[len(chain) // 2] += frequency**2
        roots = np.roots(chain)
        found.append((float(frequency), roots[np.abs(roots) < 1 - _TRAVELS]))
    return found
