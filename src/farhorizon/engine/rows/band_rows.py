"""Sums over slots in the bands, for one stencil shape. This module is a template: `engine.rows.build` writes it out
once per shape and number type.
"""

from farhorizon.engine.rows.compiled import cfunc
from farhorizon.engine.rows.layer_sums import BAND_SIGNATURE, band_sums

SHAPE = ((0, 0, 1),)
PATTERN = ((True,),)
INSIDE = ((0, 0, 0),)
OUTSIDE = ((0, 0, 0),)
DIFFER = False
REAL = "float64"

_add = band_sums(SHAPE, PATTERN, INSIDE, OUTSIDE, DIFFER, REAL)


@cfunc(BAND_SIGNATURE)
def bands(to, source, strides, weights, extent):
    """Add the sums of some lines of a plane."""
    _add(to, source, strides, weights, extent)
