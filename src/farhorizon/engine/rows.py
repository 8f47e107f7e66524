"""Sweeps of grid rows for one stencil shape. This text is a template: `engine.build` writes it out once per shape and number type."""

from numba import cfunc

from farhorizon.engine.simd import line_sweep, strided_sweep, sweep_signature

SHAPE = ((0, 0, 1),)
CLASSES = (0,)
REAL = "float64"
INCREMENTS = False
LINES = True

strided = strided_sweep(SHAPE, CLASSES, REAL, INCREMENTS)
line = line_sweep(SHAPE, CLASSES, REAL) if LINES else strided


@cfunc(sweep_signature(REAL), cache=True)
def rows(src, base, out, weights, a, b, n, count, s0, s1, s2, step, t):
    """Neighbouring rows of one block."""
    if LINES and s2 == 1:
        line(src, base, out, weights, a, b, n, count, s0, s1, s2, step, t)
    else:
        strided(src, base, out, weights, a, b, n, count, s0, s1, s2, step, t)
