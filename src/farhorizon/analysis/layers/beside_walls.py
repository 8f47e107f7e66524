"""The error that damped layers make next to walls, which the waves of the unbounded medium do not show.

A wave that has left the near field runs along the continuation of a wall. Where it is reflected there, a part of it
becomes backward waves of the same frequency and of the same wavenumber along the wall. Their energy travels the other
way, and into the near field again. A layer that continued the medium exactly would return them; the damping that keeps
backward waves from growing in the layer absorbs them. What is missing is therefore proportional to the amplitude of
these waves (`mode_conversion`), appears once they have had the time to cross a part of the layer and return, and then
does not depend on the number of nodes. The factors are known from trials (docs/limits.md).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.mode_conversion import conversion
from farhorizon.analysis.layers.short_waves import HighPass
from farhorizon.analysis.layers.side_data import Datum, briskness
from farhorizon.engine.engine import Layer
from farhorizon.medium.stencil import Stencil

# Error of a layer of 20 nodes for smooth data, over the largest value, where its filter stops waves from the wavenumber
# times spacing _STOPPED on. It falls as a power of the number of nodes, and as the first power in _BY_STOPPED of that
# wavenumber, beyond _STOPPED as the second; for vectors it does not fall any further there.
_SMOOTH, _STOPPED, _BY_NODES, _BY_STOPPED = 1.8e-5, 1.94, 3.5, (5.5, 14.0)
_BRIEF, _FEW = 6.0, 4  # factor for vectors where the filter reads at most this number of neighbours
# Of the waves that a wall turns, the part _IN_PHASE of the largest amplitude that they can have is missing at most. By
# the time they return they have spread over a distance in proportion to the thickness of the layer: of the amplitude
# that their energy then has, the part _SPREAD. The second values hold between two walls, where waves are turned again
# each time they cross. Long waves travel _EARLY times the thickness until they return; before that, the error grows as
# a power of the distance travelled.
_IN_PHASE, _SPREAD, _EARLY, _BY_WAY = (0.15, 1.5), (0.4, 1.0), 6.0, 6.0
_AS_FAST = 0.8  # sources count from this part of the smallest eigenvalue of the backward waves on
_EIGENVALUES = 17  # at which the waves radiated by a source are evaluated


class Turned(NamedTuple):
    """Backward waves that walls make of data.

    Attributes
    ----------
    amplitude : float
        Their amplitude if all of them meet in phase, relative to the largest value of the data.
    root : float
        Root of the sum of their squares over all nodes, relative to that value.
    across : int
        Number of nodes between two walls that face each other, or 0.
    """

    amplitude: float = 0.0
    root: float = 0.0
    across: int = 0


def lacking_beside_walls(
    layer: Layer, damped: HighPass, stencil: Stencil, way: float, turned: Turned, kept: float = 1.0
) -> float:
    """Estimate the error of a damped layer next to walls, relative to the largest value.

    Parameters
    ----------
    layer : Layer
    damped : HighPass
        The damping of short waves that the stencil requires.
    stencil : Stencil
    way : float
        Nodes that long waves travel in the run.
    turned : Turned
    kept : float, optional
        Part of a wave that the damping of the model leaves while long waves travel from one node to the next.
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
    across, strip, columns = turned.across, bool(turned.across), layer.columns
    often = max(1.0, way / across) if strip else 1.0
    room = across * columns ** (stencil.dim - 1) if strip else columns**stencil.dim
    returned = min(1.0, _IN_PHASE[strip] * turned.amplitude, _SPREAD[strip] * turned.root * np.sqrt(often / room))
    early = min(1.0, way / (_EARLY * columns))
    return float(smooth + returned * early**_BY_WAY * kept ** (_EARLY * columns))


def turned_by_wall(medium: LatticeMedium, damped: HighPass, datum: Datum) -> Turned:
    """Backward waves that a wall makes of a datum, or of the waves that a source radiates.

    Parameters
    ----------
    medium : LatticeMedium
        With the normal of the wall first, and that of the layer second. For vectors in space there is no estimate.
    damped : HighPass
    datum : Datum
        Turned alike, with its images behind walls.
    """
    stencil, values = medium.stencil, datum.values
    if not values.any() or stencil.components > 2:
        return Turned()
    least = _AS_FAST * damped.lowest
    eigenvalues = np.linspace(least, max(least, stencil.symbol_maximum), _EIGENVALUES)
    brisk = briskness(medium, eigenvalues, datum.time)
    amplitude, root = conversion(stencil).turned(values, datum.component)
    return Turned(amplitude * brisk, root * brisk)
