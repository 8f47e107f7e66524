"""Sums across lines, for one stencil shape. This module is a template: `engine.rows.build` writes it out once per
shape, axis and number type.
"""

from farhorizon.engine.rows.compiled import cfunc
from farhorizon.engine.rows.layer_sums import MIRRORED_SIGNATURE, mirrored_parts

SHAPE = ((1, 0, 1),)
PATTERN = ((True,),)
INSIDE = ((0, 0, 0),)
OUTSIDE = ((0, 0, 0),)
AXIS = 0
BOTH = False
APART = True
DIFFER = False
REAL = "float64"

_parts = mirrored_parts(SHAPE, PATTERN, INSIDE, OUTSIDE, AXIS, BOTH, APART, DIFFER, REAL)


@cfunc(MIRRORED_SIGNATURE)
def tile_parts(to, source, strides, weights, vectors):
    """Compute the parts of the nodes of a tile."""
    _parts(to, source, strides, weights, vectors)
