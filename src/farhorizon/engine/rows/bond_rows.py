"""Sweeps of tiles for one law of bonds. This module is a template: `engine.rows.build` writes it out once per law and
number type.
"""

from farhorizon.engine.rows.bond_sweeps import bond_signature, bond_sweep, steepness, steepness_signature
from farhorizon.engine.rows.compiled import cfunc

COMPONENTS = 2
NONLINEAR = True
REAL = "float64"
RULE = None
STRONG = False
CONTACT = False
WARM = False
SOFTENING = None

intact_tile = bond_sweep(COMPONENTS, NONLINEAR, REAL, RULE, STRONG, CONTACT, WARM, SOFTENING, False)
damaged_tile = bond_sweep(COMPONENTS, NONLINEAR, REAL, RULE, STRONG, CONTACT, WARM, SOFTENING, True)
measure = steepness(COMPONENTS, REAL)


@cfunc(bond_signature(REAL))
def intact(at, shape, a, b, limit):
    """Sweep a tile with all its bonds."""
    return intact_tile(at, shape, a, b, limit)


@cfunc(bond_signature(REAL))
def damaged(at, shape, a, b, limit):
    """Sweep a tile that lacks bonds, or has bonds that leave the zone."""
    return damaged_tile(at, shape, a, b, limit)


@cfunc(steepness_signature())
def steep(src, planes, rows, n, step0, step1, apart):
    """Bound of the stretch in a box of nodes."""
    return measure(src, planes, rows, n, step0, step1, apart)
