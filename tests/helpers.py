"""Plain numpy counterparts of what the engine computes, and shortcuts for setting it up."""

import itertools

import numpy as np

from farhorizon import Free, Kernel, Lattice, LatticePML, Stencil
from farhorizon.engine.engine import Engine
from farhorizon.medium.integrators import Euler
from farhorizon.studies.compare import compare

#: Factor of a bond as a function of the coefficients at its ends.
RULES = {
    "both": np.minimum,
    "arithmetic": lambda a, b: (a + b) / 2,
    "harmonic": lambda a, b: np.divide(2 * a * b, a + b, out=np.zeros(np.shape(a + b)), where=a + b > 0),
}


def kernel_stencil(dim, reach, exponent=1, **options):
    """Return the stencil of a kernel whose horizon is `reach` nodes of unit spacing."""
    return Stencil.from_kernel(Kernel(horizon=float(reach), exponent=exponent, **options), 1.0, dim)


def lattice_of(shape, spacing=1.0):
    """Return a lattice with the given numbers of nodes that starts at the origin."""
    return Lattice(spacing, lower=np.zeros(len(shape)), upper=spacing * (np.array(shape) - 1))


def roll_apply(u, offsets, weights, coefficient=None, rule="both"):
    """Apply the operator on a periodic lattice, with one np.roll per bond; a vector field has its components first."""
    total = np.zeros(u.shape)
    axes = tuple(range(-offsets.shape[1], 0))
    for o, w in zip(offsets, weights, strict=True):
        shift = tuple(-o)
        factor = 1.0 if coefficient is None else RULES[rule](coefficient, np.roll(coefficient, shift, axes))
        difference = factor * (np.roll(u, shift, axes) - u)
        total += w * difference if np.ndim(w) == 0 else np.tensordot(w, difference, 1)
    return total


def dense_operator(shape, offsets, weights, whole=None, coefficient=None, rule="both"):
    """Return the matrix of the operator without the bonds that leave the lattice.

    `whole(i, j)` tells which bonds between the nodes i and j (rows of indices) exist; `coefficient` has the lattice's
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
    """Fill the halos and apply the engine's operator to values of the core; the result has the shape of u."""
    level = np.zeros(engine.levels.shape[1], engine.dtype)
    view = engine.core.view(level)
    view[...] = np.reshape(u, view.shape)
    engine.complete(level)
    return engine.core.view(engine.apply(level)).reshape(np.shape(u)).astype(float)


def periodic_engine(shape, stencil, stages, dt, coefficient=None, **options):
    """Return an engine on a lattice that is periodic along every axis."""
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
    """Compare the engine's operator on white noise with np.roll, to within the tolerance times the sum of the
    weights, and return the engine.
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
    """Return the order p of errors ~ size^p, fitted by least squares."""
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


def half_space_error(model, nodes, cracks=()):
    """Return the largest error, relative to the initial maximum, of an elastic half-space whose surface runs into
    layers, while a surface wave and all others leave. The reference is a domain so large that nothing returns.
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
