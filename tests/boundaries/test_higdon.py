"""Higdon's condition and the first-order one: exact cases, orders, and the infinite lattice."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.studies.compare import compare


def bar(boundary, spacing=0.25, damping=0.0, share=1.0):
    """Classical bar on -6 .. 6 with a smooth pulse; the step is `share` of the limit, which is the spacing over the
    speed.
    """
    model = fh.Wave(fh.Stencil.finite_difference(1), 2.0, damping)
    return {
        "lattice": fh.Lattice(spacing, (-6.0,), (6.0,)),
        "model": model,
        "boundary": boundary,
        "dt": share * spacing / 2.0,
        "initial": {"u": lambda x: np.exp(-2 * x**2)},
    }


def error(setup, until, relative="error_rel_initial"):
    curves = compare(setup, until, times=np.linspace(until / 5, until, 5), beside=False).curves
    return max(next(iter(curves.values()))[relative])


@pytest.mark.parametrize("boundary", [fh.Higdon((0.0,), 0.0), fh.Higdon((0.0, 0.0), 0.0), fh.FirstOrder()])
def test_exact_where_waves_move_one_node_a_step(boundary):
    """At dt = spacing / speed, every wave of the classical bar moves one node per step, as in the box scheme and with
    lumped elements.
    """
    assert error(bar(boundary), 12.0) < 1e-12


@pytest.mark.parametrize(
    "boundary, order", [(fh.Higdon((0.0,), 0.0), 2), (fh.Higdon((0.0, 0.0), 0.0), 4), (fh.FirstOrder(), 2)]
)
def test_order(boundary, order):
    """The reflection of a wave along the normal decreases with the spacing; a second factor squares it."""
    spacings = np.array([0.2, 0.1, 0.05])
    errors = [error(bar(boundary, h, share=0.5), 8.0) for h in spacings]
    assert np.polyfit(np.log(spacings), np.log(errors), 1)[0] > order - 0.3


def test_first_order_with_damping_is_better_than_without():
    """Without the term d u of eq A13, slow fields come back."""
    setup = bar(fh.FirstOrder(), damping=0.2, share=0.5)
    assert error(setup, 8.0) < 0.3 * error({**setup, "boundary": fh.Higdon((0.0,), 0.0)}, 8.0)


def one_step_map(sim):
    """Return the matrix of one step of a simulation without sources, on its near field, halo and memory."""
    engine, columns = sim.engine, []
    history = engine.tables.outline_stencil.history.T
    state = [engine.levels, history]
    places = [np.concatenate([sim.parts.grid.indices, sim.closure.unmoved]), np.arange(history.shape[1])]
    levels = [engine.current, engine.older]
    for part, level in [(0, 0), (0, 1), *[(1, row) for row in range(history.shape[0])]]:
        for place in places[part]:
            phase = engine.phase
            for array in state:
                array[...] = 0
            target = levels[level] if part == 0 else history[level]
            target[place] = 1.0
            engine.advance(1)
            columns.append(np.concatenate([engine.current[places[0]], engine.older[places[0]], history.ravel()]))
            engine.phase = phase
    return np.array(columns).T


@pytest.mark.parametrize("stencil", [fh.Stencil.finite_element(2), fh.Stencil.finite_difference(2)])
def test_first_order_never_grows(stencil):
    """Spectral radius of the complete step of a small box, corners included."""
    sim = fh.Simulation(
        fh.Lattice(1.0, (0.0, 0.0), (4.0, 4.0)), fh.Wave(stencil, damping=0.01), fh.FirstOrder(), dt=0.5
    )
    assert np.abs(np.linalg.eigvals(one_step_map(sim))).max() <= 1 + 1e-10


# example 1 of Hermann et al. (2023), with 20 times its step
HERMANN = {"initial": {"u": lambda x, y: np.exp(-np.log(2) / 9 * (x**2 + y**2))}, "dt": 0.01}


@pytest.mark.parametrize(
    "boundary, printed",
    [(fh.FirstOrder(), (2.1e-4, 5.6e-3, 1.3e-2, 4.9e-3)), (fh.Higdon((0, 45), 0.03), (5.1e-5, 1.2e-3, 1.4e-3, 7.1e-4))],
)
def test_finite_elements_of_hermann(boundary, printed):
    """Largest errors at t = 20, 30, 40, 50, within a factor 2 of what an independent program found on the same mesh."""
    half = 25.5  # the paper's absorbing nodes lie at 26
    model = fh.Wave(fh.Stencil.finite_element(2), damping=0.0125)
    setup = {"lattice": fh.Lattice(0.5, (-half, -half), (half, half)), "model": model, "boundary": boundary, **HERMANN}
    curves = compare(setup, 50.0, times=[20, 30, 40, 50], beside=False).curves
    found = np.array(next(iter(curves.values()))["error"])
    assert (found < 2 * np.array(printed)).all()


def test_refused():
    for angles in ((), (90.0,), (0.0,) * 5):
        with pytest.raises(fh.InputError, match="angle"):
            fh.Higdon(angles)
    with pytest.raises(fh.InputError, match="negative"):
        fh.Higdon(shift=-1.0)


def test_growth_is_laid_to_the_condition():
    """Finite elements closed by Higdon's condition grow, and there is no layer to blame."""
    lattice = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0))
    sim = fh.Simulation(lattice, fh.Wave(fh.Stencil.finite_element(2)), fh.Higdon(), {"u": "exp(-4*(x**2 + y**2))"})
    with pytest.raises(
        fh.UnstableError, match=r"likely cause: Higdon grows on this outline, which `check` tells.*--tune.*LatticePML"
    ):
        sim.run(until=3000.0, allow_unstable=True)
