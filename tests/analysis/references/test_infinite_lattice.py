"""Driven infinite lattices, against the scheme run node by node before anything reaches an edge."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.references.infinite_lattice import DrivenLattice, Scheme
from farhorizon.medium.integrators import Euler, RungeKutta4, Verlet
from helpers import kernel_stencil, roll_apply

_STEPS = 12
_BONDS = fh.Elastic(fh.Kernel(2.0, 1, "linear"), 1.0).stencil(1.0, 2)


def _by_nodes(scheme, start, nodes, forces):
    """The recursion node by node, on a periodic lattice whose ends nothing reaches."""
    stencil, recursion = scheme.stencil, scheme.recursion
    u = np.zeros((stencil.components, *(61,) * stencil.dim))
    d, history = np.zeros(u.shape), [u.copy()]
    for step, force in enumerate(forces):
        applied = roll_apply(u if stencil.components > 1 else u[0], stencil.offsets, stencil.weights).reshape(u.shape)
        total = scheme.rate * (applied - stencil.reaction * u)
        total[:, *(nodes - start).T] += force.reshape(stencil.components, -1) * (1 if step else recursion.first)
        d = recursion.keep * d + recursion.scale * total
        u = u + d
        history.append(u)
    return np.stack(history)


@pytest.mark.parametrize(
    ("stencil", "integrator", "damping"),
    [
        (kernel_stencil(2, 2), Verlet(), 0.0),
        (kernel_stencil(2, 2).with_reaction(0.3), Verlet(), 0.1),
        (_BONDS, Verlet(), 0.0),
        (kernel_stencil(2, 2), Euler(), 0.0),
        (kernel_stencil(1, 3), Verlet(), 0.0),
        (kernel_stencil(3, 1), Verlet(), 0.0),
    ],
)
def test_receivers_are_the_nodes_of_the_scheme(stencil, integrator, damping):
    random, start = np.random.default_rng(20261123), np.full(stencil.dim, -30)
    rate = 0.7
    scheme = Scheme.of(stencil, rate, integrator, 0.5 * integrator.step_limit(rate * stencil.symbol_maximum), damping)
    nodes = np.unique(random.integers(-3, 4, (5, stencil.dim)), axis=0)
    receivers = random.integers(-5, 6, (4, stencil.dim))
    forces = random.normal(size=(_STEPS, stencil.components * len(nodes)))
    found = DrivenLattice(scheme, _STEPS, nodes, receivers).field(forces)
    exact = _by_nodes(scheme, start, nodes, forces)[:, :, *(receivers - start).T]
    exact = exact[:, 0] if stencil.components == 1 else exact.swapaxes(1, 2)
    assert np.abs(exact).max() > 1e-3
    np.testing.assert_allclose(found, exact, atol=1e-13 * np.abs(exact).max())


@pytest.mark.parametrize("integrator", [RungeKutta4(), fh.RungeKuttaChebyshev(3)], ids=lambda one: one.name)
def test_a_step_of_several_stages_is_one_of_a_wider_stencil(integrator):
    stencil, rate = kernel_stencil(2, 2).with_reaction(0.2), 0.7
    dt = 0.5 * integrator.step_limit(rate * (stencil.symbol_maximum))
    scheme = Scheme.of(stencil, rate, integrator, dt)
    angles = np.ix_(np.linspace(-3, 3, 7), np.linspace(0, 3, 5))
    np.testing.assert_allclose(
        1 - scheme.stencil.symbol(*angles), integrator.growth(rate * stencil.symbol(*angles), dt), atol=1e-13
    )


def test_a_step_of_too_many_stages_is_refused():
    with pytest.raises(fh.InputError, match=r"model\.integrator: a step of so many stages couples too many nodes"):
        Scheme.of(kernel_stencil(2, 3), 1.0, fh.RungeKuttaChebyshev(60), 1.0)


def test_a_run_that_does_not_fit_into_memory_is_refused():
    scheme = Scheme.of(kernel_stencil(3, 1), 1.0, Verlet(), 0.5)
    with pytest.raises(fh.InputError, match=r"far_field\.points: .*does not fit into memory"):
        DrivenLattice(scheme, 10**6, np.zeros((1, 3), int), np.full((1, 3), 10**5))
