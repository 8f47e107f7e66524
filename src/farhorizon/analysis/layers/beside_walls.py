"""What layers lack beside walls, and no wave of the medium tells: what a wall outside the near field turns round.

A wave that has left runs along a wall. Where it is reflected there, a part of it goes on as backward waves of the same
frequency and of the same wavenumber along the wall. Their energy runs the other way, and into the near field again. A
layer that continued the medium exactly would send them back; the damping that keeps backward waves from growing in it
takes them. So what is missing grows with what the data hold of waves that are as fast in time as backward ones, comes
when these have had the time to go through a part of the layer and back, and then depends on no number of nodes. How
much that is, is known from trials (docs/limits.md).
"""

from __future__ import annotations

import numpy as np
from scipy import fft

from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.short_waves import HighPass
from farhorizon.analysis.layers.side_data import Datum, briskness
from farhorizon.engine.engine import Layer
from farhorizon.medium.stencil import Stencil

# What 20 nodes whose filter stops waves from a wavenumber times spacing on lack of smooth data, over the largest value;
# it falls as a power of their number, and of the wavenumber, beyond it as another power, of vectors not at all.
_SMOOTH, _STOPPED, _BY_NODES, _BY_STOPPED = 1.8e-5, 1.94, 3.5, (5.5, 14.0)
_BRIEF, _FEW = 6.0, 4  # times as much of vectors beside filters that read so many neighbours at most
# Of the least eigenvalue of backward waves, from which on waves count. Of these so much is lacking, times a power of
# the stencil's reach, once long waves have gone so many times the thickness of the layer; before a power of their way.
_AS_FAST, _LACKING, _BY_REACH, _DELAY, _BY_WAY = 0.8, 1e-3, 2.5, 5.0, 6.0
_EIGENVALUES = 17  # at which it is looked what a source sends


def lacking_beside_walls(layer: Layer, damped: HighPass, stencil: Stencil, way: float, held: float) -> float:
    """What a layer lacks of what comes back beside walls, over the largest value; in one of forty trials it was more,
    up to three times as much.

    Parameters
    ----------
    layer : Layer
    damped : HighPass
        What its filter stops.
    stencil : Stencil
    way : float
        Nodes that long waves go in the run.
    held : float
        Of the data, the waves that are as fast in time as backward ones, see `as_fast_as_backward`.
    """
    vectors, longer = stencil.components > 1, damped.first / _STOPPED
    if vectors:
        longer = min(longer, 1.0)
    brief = _BRIEF if vectors and len(layer.taps) - 1 <= _FEW else 1.0
    smooth = brief * _SMOOTH * longer ** -_BY_STOPPED[longer > 1] * (20 / layer.columns) ** _BY_NODES
    # of neighbours alone a wall is a mirror; of media whose waves are damped themselves some of any length are slow
    if damped.whole or (not vectors and max(stencil.reach) == 1):
        return float(smooth)
    turned = min(1.0, _LACKING * max(stencil.reach) ** _BY_REACH)
    return float(smooth + turned * held * min(1.0, way / (_DELAY * layer.columns)) ** _BY_WAY)


def as_fast_as_backward(medium: LatticeMedium, damped: HighPass, datum: Datum) -> float:
    """How much of a datum are waves that are as fast in time as backward ones; of a source, in what it sends.

    Parameters
    ----------
    medium : LatticeMedium
        Of a scalar, or of vectors in the plane; of vectors in space nothing is told.
    damped : HighPass
    datum : Datum
        With its images behind walls; its values are taken to repeat themselves.
    """
    stencil, values = medium.stencil, datum.values
    if not values.any() or stencil.components > 2:
        return 0.0
    symbol = stencil.symbol(*np.ix_(*[2 * np.pi * np.fft.fftfreq(n) for n in values.shape]))
    spectrum, least = fft.fftn(values), _AS_FAST * damped.lowest
    if stencil.components == 1:
        parts = [np.where(symbol >= least, spectrum, 0)]
    else:  # of each branch by itself, what it has of either component
        squared, shapes = np.linalg.eigh(symbol)
        sent = np.where(squared >= least, shapes[..., datum.component, :].conj() * spectrum[..., None], 0)
        parts = [shapes[..., c, branch] * sent[..., branch] for branch in range(2) for c in range(2)]
    share = max(np.abs(fft.ifftn(part).real).max() for part in parts) / np.abs(values).max()
    eigenvalues = np.linspace(least, max(least, stencil.symbol_maximum), _EIGENVALUES)
    return float(share * briskness(medium, eigenvalues, datum.time))
