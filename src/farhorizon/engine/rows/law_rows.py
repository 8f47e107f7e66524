"""The law of nodes that are neighbours in memory. This text is a template: `engine.rows.build` writes it out once per
pattern of its matrix and number type.
"""

from farhorizon.engine.rows.compiled import cfunc
from farhorizon.engine.rows.laws import LAW_SIGNATURE, linear_law

ENTRIES = ((0,),)
REAL = "float64"

_law = linear_law(ENTRIES, REAL)


@cfunc(LAW_SIGNATURE)
def law(place, apart, matrix, nodes):
    """The law of a run of nodes, in place."""
    _law(place, apart, matrix, nodes)
