"""How much a mode that is evanescent in the medium grows on its way through a layer: why wide kernels need short
entrances.

At a frequency w a stencil of reach K has K modes ahead of a side, most of them evanescent, ``t = tan(theta / 2)`` with
Im t > 0. In the layer t becomes ``(1 + sigma/(i w + alpha)) t``. Where sigma/w turns t past the real axis, a mode with
Re t > 0 *grows* outwards. As the stretch is exact, nothing is reflected before the outer end, but there it is. The gain
of a mode between the point where it begins to grow and the end depends on the columns in which sigma is of the order of
w: on the width of the entrance, not on the peak of sigma. Narrow kernels have only modes that decay within a node. Wide
kernels have some that are nearly waves, and with a long entrance these sustain themselves inside the layer.
"""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np

from farhorizon.analysis.layers.reflection import chain_weights
from farhorizon.medium.stencil import Stencil

_FREQUENCIES = np.linspace(0.03, 0.6, 20)  # over the largest; higher ones belong to short waves, which are damped
_LONG = 0.005  # tangential wavenumber times spacing
_TRAVELS = 1e-7  # distance from the unit circle below which a mode travels


def largest_gain(stencil: Stencil, kappa: np.ndarray, sigma: np.ndarray, alpha: np.ndarray) -> float:
    """Logarithm of the largest factor by which a mode of low frequency grows inside a layer.

    Parameters
    ----------
    stencil : Stencil
        Its first axis is the normal. The components of a vector are treated separately: long waves along the side
        hardly couple them.
    kappa, sigma, alpha : ndarray, shape (columns + 1,)
        Stretch of the edges, with sigma and alpha in units of speed over spacing.
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
    """Frequencies, and for each the factors per node of the modes that are evanescent in the medium. They are cached,
    because for wide kernels they take far longer to compute than the gain of a layer.
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
