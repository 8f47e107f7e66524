"""The error that damped layers make next to walls, which the waves of the unbounded medium do not show.

A wave that has left the near field runs along the continuation of a wall. Where it is reflected there, a part of it
becomes backward waves of the same frequency and of the same wavenumber along the wall. Their energy travels the other
way, and into the near field again. A layer that continued the medium exactly would return them; the damping that keeps
backward waves from growing in the layer absorbs them. What is missing therefore grows with the share of the data in
waves that have the frequencies of backward waves, appears once these have had the time to cross a part of the layer and
return, and then does not depend on the number of nodes. Its size is known from trials (docs/limits.md).
"""

from __future__ import annotations

import numpy as np
from scipy import fft

from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.short_waves import HighPass
from farhorizon.analysis.layers.side_data import Datum, briskness
from farhorizon.engine.engine import Layer
from farhorizon.medium.stencil import Stencil

# Error of a layer of 20 nodes for smooth data, over the largest value, where its filter stops waves from the wavenumber
# times spacing _STOPPED on. It falls as a power of the number of nodes, and as the first power in _BY_STOPPED of that
# wavenumber, beyond _STOPPED as the second; for vectors it does not fall any further there.
_SMOOTH, _STOPPED, _BY_NODES, _BY_STOPPED = 1.8e-5, 1.94, 3.5, (5.5, 14.0)
_BRIEF, _FEW = 6.0, 4  # factor for vectors where the filter reads at most this number of neighbours
# Waves count from _AS_FAST times the smallest eigenvalue of the backward waves on. Of these the part _LACKING is
# missing, times a power of the stencil's reach, once long waves have travelled _DELAY times the thickness of the layer;
# before that, it grows as a power of the distance they have travelled.
_AS_FAST, _LACKING, _BY_REACH, _DELAY, _BY_WAY = 0.8, 1e-3, 2.5, 5.0, 6.0
_EIGENVALUES = 17  # at which the waves radiated by a source are evaluated


def lacking_beside_walls(layer: Layer, damped: HighPass, stencil: Stencil, way: float, held: float) -> float:
    """Estimate the error of a damped layer next to walls, relative to the largest value; in one of forty trials the
    error was larger, by up to a factor of three.

    Parameters
    ----------
    layer : Layer
    damped : HighPass
        The damping of short waves that the stencil requires.
    stencil : Stencil
    way : float
        Nodes that long waves travel in the run.
    held : float
        Share of the data in waves with the frequencies of backward waves, see `as_fast_as_backward`.
    """
    vectors, longer = stencil.components > 1, damped.first / _STOPPED
    if vectors:
        longer = min(longer, 1.0)
    brief = _BRIEF if vectors and len(layer.taps) - 1 <= _FEW else 1.0
    smooth = brief * _SMOOTH * longer ** -_BY_STOPPED[longer > 1] * (20 / layer.columns) ** _BY_NODES
    # with nearest neighbours alone a wall is a mirror; where the waves themselves are damped, some waves of any length
    # are slow
    if damped.whole or (not vectors and max(stencil.reach) == 1):
        return float(smooth)
    turned = min(1.0, _LACKING * max(stencil.reach) ** _BY_REACH)
    return float(smooth + turned * held * min(1.0, way / (_DELAY * layer.columns)) ** _BY_WAY)


def as_fast_as_backward(medium: LatticeMedium, damped: HighPass, datum: Datum) -> float:
    """Return the share of a datum in waves with the frequencies of backward waves; for a source, of the waves it
    radiates.

    Parameters
    ----------
    medium : LatticeMedium
        Scalar, or of vectors in the plane; for vectors in space there is no estimate, and 0 is returned.
    damped : HighPass
    datum : Datum
        With its images behind walls; its values are taken to be periodic.
    """
    stencil, values = medium.stencil, datum.values
    if not values.any() or stencil.components > 2:
        return 0.0
    symbol = stencil.symbol(*np.ix_(*[2 * np.pi * np.fft.fftfreq(n) for n in values.shape]))
    spectrum, least = fft.fftn(values), _AS_FAST * damped.lowest
    if stencil.components == 1:
        parts = [np.where(symbol >= least, spectrum, 0)]
    else:  # both components of each branch, separately
        squared, shapes = np.linalg.eigh(symbol)
        sent = np.where(squared >= least, shapes[..., datum.component, :].conj() * spectrum[..., None], 0)
        parts = [shapes[..., c, branch] * sent[..., branch] for branch in range(2) for c in range(2)]
    share = max(np.abs(fft.ifftn(part).real).max() for part in parts) / np.abs(values).max()
    eigenvalues = np.linspace(least, max(least, stencil.symbol_maximum), _EIGENVALUES)
    return float(share * briskness(medium, eigenvalues, datum.time))
