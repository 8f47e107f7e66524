"""Plain numpy counterparts of what the engine computes, and short cuts to set it up."""

import itertools

import numpy as np

from farhorizon import Free, Kernel, Lattice, LatticePML, Stencil
from farhorizon.engine.engine import Engine
from farhorizon.medium.integrators import Euler
from farhorizon.studies.compare import compare

#: Factor of a bond from the coefficients of its ends.
RULES = {
    "both": np.minimum,
    "arithmetic": lambda a, b: (a + b) / 2,
    "harmonic": lambda a, b: np.divide(2 * a * b, a + b, out=np.zeros(np.shape(a + b)), where=a + b > 0),
}


def kernel_stencil(dim, reach, exponent=1, **options):
    """Stencil of a kernel whose horizon is `reach` nodes of unit spacing."""
    return Stencil.from_kernel(Kernel(horizon=float(reach), exponent=exponent, **options), 1.0, dim)


def lattice_of(shape, spacing=1.0):
    """Lattice of given node counts that starts at the origin."""
    return Lattice(spacing, lower=np.zeros(len(shape)), upper=spacing * (np.array(shape) - 1))


def roll_apply(u, offsets, weights, coefficient=None, rule="both"):
    """The operator on a periodic lattice, one np.roll a bond; of vectors the components come first."""
    total = np.zeros(u.shape)
    axes = tuple(range(-offsets.shape[1], 0))
    for o, w in zip(offsets, weights, strict=True):
        shift = tuple(-o)
        factor = 1.0 if coefficient is None else RULES[rule](coefficient, np.roll(coefficient, shift, axes))
        difference = factor * (np.roll(u, shift, axes) - u)
        total += w * difference if np.ndim(w) == 0 else np.tensordot(w, difference, 1)
    return total


def dense_operator(shape, offsets, weights, whole=None, coefficient=None, rule="both"):
    """Matrix of the operator with the bonds that leave the lattice absent.

    `whole(i, j)` tells which bonds between the nodes (rows of indices) i and j exist; `coefficient` has the lattice's
    shape.
    """
    nodes = np.array(list(itertools.product(*map(range, shape))))
    matrix = np.zeros((len(nodes), len(nodes)))
    number = np.arange(len(nodes)).reshape(shape)
    for o, w in zip(offsets, weights, strict=True):
        ends = nodes + o
        keep = ((ends >= 0) & (ends < shape)).all(1)
        if whole is not None:
            keep[keep] = whole(nodes[keep], ends[keep])
        i, j = number[tuple(nodes[keep].T)], number[tuple(ends[keep].T)]
        factor = 1.0 if coefficient is None else RULES[rule](coefficient.ravel()[i], coefficient.ravel()[j])
        matrix[i, j] += w * factor
    return matrix - np.diag(matrix.sum(1))


def engine_apply(engine, u):
    """The engine's operator on core values, halos filled first; an array of u's shape."""
    level = np.zeros(engine.levels.shape[1], engine.dtype)
    view = engine.core.view(level)
    view[...] = np.reshape(u, view.shape)
    engine.complete(level)
    return engine.core.view(engine.apply(level)).reshape(np.shape(u)).astype(float)


def periodic_engine(shape, stencil, stages, dt, coefficient=None, **options):
    """Engine on a lattice that closes on itself along every axis."""
    lead = 3 - len(shape)
    offsets = np.pad(stencil.offsets, ((0, 0), (lead, 0)))
    core = (1,) * lead + tuple(shape)
    grown = None if coefficient is None else np.reshape(coefficient, core)
    periodic = frozenset(range(lead, 3))
    return Engine(
        core, offsets, stencil.weights, stages, dt, layers={}, periodic=periodic, coefficient=grown, **options
    )


TOLERANCE = {"float64": 1e-13, "float32": 3e-5}


def check_apply(shape, stencil, stages=None, real="float64", coefficient=None, rule="both", threads=1):
    """The engine's operator on white noise against np.roll; errors relative to the sum of the weights. Returns the
    engine.
    """
    u = np.random.default_rng(3).uniform(-1, 1, shape if stencil.components == 1 else (stencil.components, *shape))
    engine = periodic_engine(
        shape, stencil, stages or Euler.stages(0.1), 0.1, coefficient, rule=rule, real=real, threads=threads
    )
    scale = float(np.abs(stencil.weights).sum()) * (1.0 if coefficient is None else coefficient.max())
    expected = roll_apply(u, stencil.offsets, stencil.weights, coefficient, rule)
    np.testing.assert_allclose(engine_apply(engine, u), expected, rtol=0, atol=TOLERANCE[real] * scale)
    return engine


def fitted_rate(sizes, errors):
    """Order p of errors ~ size^p by least squares."""
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


def half_space_error(model, nodes, cracks=()):
    """Largest error, of the initial maximum, of an elastic half-space whose surface runs into layers: of the surface
    wave that leaves through a side and all others, against a domain so large that nothing returns.
    """
    layer = LatticePML(nodes=nodes)
    setup = {
        "lattice": Lattice(1.0, (-15.0, 0.0), (15.0, 20.0)),
        "model": model,
        "threads": 1,
        "boundary": {"x": layer, "y-": Free(), "y+": layer},
        "initial": {"u": [0.0, lambda x, y: np.exp(-(x**2 + y**2) / 9)]},
        "cracks": cracks,
    }
    found = compare(setup, 40.0, [10.0, 20.0, 30.0, 40.0], beside=False)
    (curve,) = found.curves.values()
    return max(curve["error_rel_initial"])
