"""Sweeps of grid rows for one stencil shape. This text is a template: `engine.build` writes it out once per shape and number type."""

from numba import cfunc

from farhorizon.engine.simd import row_group_sweep, sweep_signature

SHAPE = ((0, 0, 1),)
CLASSES = (0,)
GROUP = (1, 1)
REAL = "float64"
INCREMENTS = False

sweep_group = row_group_sweep(SHAPE, CLASSES, GROUP, REAL, INCREMENTS)
sweep_row = row_group_sweep(SHAPE, CLASSES, (1, 1), REAL, INCREMENTS)


@cfunc(sweep_signature(REAL), cache=True)
def row(src, base, out, weights, a, b, n, s0, s1, s2, t0, t1):
    """One row."""
    sweep_row(src, base, out, weights, a, b, n, s0, s1, s2, t0, t1)


if GROUP == (1, 1):
    group = row
else:

    @cfunc(sweep_signature(REAL), cache=True)
    def group(src, base, out, weights, a, b, n, s0, s1, s2, t0, t1):
        """Neighbouring rows together; neighbours along a row are next to each other in memory."""
        sweep_group(src, base, out, weights, a, b, n, s0, s1, 1, t0, t1)
