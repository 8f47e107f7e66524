"""Sums of lines where faces meet, for one stencil shape. This module is a template: `engine.rows.build` writes it out
once per shape, distance along the first axis and number type.
"""

from farhorizon.engine.rows.compiled import cfunc
from farhorizon.engine.rows.layer_sums import CROSSING_SIGNATURE, crossing_parts

SHAPE = ((1, 1, 0),)
PATTERN = ((True,),)
INSIDE = ((0, 0, 0),)
OUTSIDE = ((0, 0, 0),)
BOTH = (False, False)
REACH = 1
APART = True
DIFFER = False
REAL = "float64"

_parts = crossing_parts(SHAPE, PATTERN, INSIDE, OUTSIDE, BOTH, REACH, APART, DIFFER, REAL)


@cfunc(CROSSING_SIGNATURE)
def crossings(to, source, strides, weights, vectors):
    """Compute the parts of the nodes of a tile of an edge."""
    _parts(to, source, strides, weights, vectors)
