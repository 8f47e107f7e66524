"""Sweeps of grid rows for one stencil shape. This text is a template: `engine.build` writes it out once per shape and number type."""

from numba import cfunc

from farhorizon.engine.simd import row_group_sweep, sweep_signature

SHAPE = ((0, 0, 1),)
CLASSES = (0,)
GROUP = (1, 1)
REAL = "float64"
INCREMENTS = False

sweep = row_group_sweep(SHAPE, CLASSES, GROUP, REAL, INCREMENTS)


@cfunc(sweep_signature(REAL), cache=True)
def rows(src, base, out, weights, a, b, n, s0, s1, s2, t0, t1):
    """One row, or a group of neighbouring rows whose nodes along a row are neighbours in memory."""
    sweep(src, base, out, weights, a, b, n, s0, s1, s2 if GROUP == (1, 1) else 1, t0, t1)
