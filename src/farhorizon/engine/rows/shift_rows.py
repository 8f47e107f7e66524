"""Stretched shifts of one reach. This module is a template: `engine.rows.build` writes it out once per reach, form and
number types.
"""

from farhorizon.engine.rows.compiled import cfunc
from farhorizon.engine.rows.shifts import SHIFTS_SIGNATURE, stretched_shifts
from farhorizon.engine.rows.vectors import PARTS_SIGNATURE, weighted_parts

REACH = 1
NESTED = True
VARIED = False
REAL = "float64"
KEPT = "float64"

_outwards = stretched_shifts(REACH, NESTED, True, REAL, KEPT)
_inwards = stretched_shifts(REACH, NESTED, False, REAL, KEPT)
_parts = weighted_parts(REACH if NESTED else 1, VARIED, REAL)


@cfunc(SHIFTS_SIGNATURE)
def outwards(parts, found, memory, edges, columns, vectors):
    """Shift outwards: columns go from the outer end inwards."""
    _outwards(parts, found, memory, edges, columns, vectors)


@cfunc(SHIFTS_SIGNATURE)
def inwards(parts, found, memory, edges, columns, vectors):
    """Shift inwards: columns go from the core outwards."""
    _inwards(parts, found, memory, edges, columns, vectors)


@cfunc(PARTS_SIGNATURE)
def parts(to, source, tables, vectors, least, more):
    """Compute the sums across the lines that are shifted; only one if they are not nested."""
    _parts(to, source, tables, vectors, least, more)
