"""Products of the values of nodes that are neighbours in memory with matrices. This module is a template:
`engine.rows.build` writes it out once per pattern of the matrices, use of the result and number type.
"""

from farhorizon.engine.rows.compiled import cfunc
from farhorizon.engine.rows.linear_maps import MAP_SIGNATURE, linear_map

ENTRIES = ((0,),)
COLUMNS = 1
EACH = False
ADDED = False
REAL = "float64"

_product = linear_map(ENTRIES, COLUMNS, EACH, ADDED, REAL)


@cfunc(MAP_SIGNATURE)
def product(src, read, out, written, matrix, step, nodes, factor):
    """Apply the matrices to a run of nodes."""
    _product(src, read, out, written, matrix, step, nodes, factor)
