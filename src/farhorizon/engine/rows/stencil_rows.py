"""Sweeps of grid rows, for one stencil shape. This module is a template: `engine.rows.build` writes it out once per
shape and number type.
"""

from farhorizon.engine.rows.compiled import cfunc
from farhorizon.engine.rows.matrices import matrix_line_sweep, matrix_strided_sweep
from farhorizon.engine.rows.vectors import line_sweep, strided_sweep, sweep_signature

SHAPE = ((0, 0, 1),)
CLASSES = (0,)
REAL = "float64"
INCREMENTS = False
LINES = True
PATTERN = ()
INSIDE = ((0, 0, 0),)
OUTSIDE = ((0, 0, 0),)
FORM = "step"

_matrices = (SHAPE, PATTERN, REAL, INSIDE, OUTSIDE, FORM)
strided = matrix_strided_sweep(*_matrices) if PATTERN else strided_sweep(SHAPE, CLASSES, REAL, INCREMENTS)
line = (matrix_line_sweep(*_matrices) if PATTERN else line_sweep(SHAPE, CLASSES, REAL)) if LINES else strided


@cfunc(sweep_signature(REAL))
def rows(levels, weights, a, b, extent, strides, apart, shifts):
    """Sweep neighbouring rows of one block."""
    if LINES and strides[2] == 1:
        line(levels, weights, a, b, extent, strides, apart, shifts)
    else:
        strided(levels, weights, a, b, extent, strides, apart, shifts)
