"""The error of damped layers beside walls: the damping of backward waves alone causes it, and it depends on the
amplitude of such waves that walls make of the data.
"""

from dataclasses import replace

import numpy as np
import pytest
from test_returned import medium, pulse

import farhorizon as fh
from farhorizon.analysis.layers.beside_walls import Turned, lacking_beside_walls, turned_by_wall
from farhorizon.analysis.layers.short_waves import high_pass
from farhorizon.analysis.layers.side_data import Datum
from farhorizon.engine.engine import Layer

SCALAR, SOLID = fh.Wave(fh.Kernel(3.0, 1, "constant")), fh.Elastic(fh.Kernel(2.0, 1, "constant"), young=1.0)


def largest_error(model, wall, until, damped, monkeypatch):
    """Largest error of 40 layer nodes beside a wall, with or without the damping of backward waves, against a domain
    from which nothing returns.
    """
    made = fh.LatticePML.make_layer
    if not damped:
        bare = {"damping": np.zeros(0), "taps": np.zeros(1)}
        monkeypatch.setattr(fh.LatticePML, "make_layer", lambda self, *a, **k: replace(made(self, *a, **k), **bare))
    lattice = fh.Lattice(1.0, (0.0, 0.0), (26.0, 30.0))
    u = pulse(lattice.shape, (13.0, 14.0), 2.6)
    given = {"threads": 1, "initial": {"u": u if model is SCALAR else np.stack([-0.6 * u, u])}}

    def run(side):
        return fh.Simulation(lattice, model, {"x": side, "y-": wall, "y+": side}, **given)

    near, far = run(fh.LatticePML(nodes=40, until=until)), run(fh.Extended(target=1e-12, until=until + 20))
    monkeypatch.undo()
    assert near.dt == far.dt
    worst = 0.0
    while far.time < until:  # in eight steps at a time, slightly beyond the end
        for sim in (near, far):
            sim.step(8)
        worst = max(worst, float(np.abs(near.fields["u"] - far.fields["u"]).max()))
    return worst


@pytest.mark.parametrize("model, wall, until", [(SCALAR, fh.Free(), 60.0), (SOLID, fh.Fixed(), 60.0)])
def test_damping_alone_takes_what_comes_back(model, wall, until, monkeypatch):
    """Undamped layers are exact beside a wall as long as nothing grows, so what looks like an echo of the wall is an
    error of the damping.
    """
    damped = largest_error(model, wall, until, True, monkeypatch)
    assert largest_error(model, wall, until, False, monkeypatch) < 1e-12 < 1e-9 < damped


def test_the_lowest_backward_wave():
    """By group and phase velocity along both axes, on an independent grid."""
    for model in (SCALAR, SOLID):
        stencil = model.stencil(1.0, 2)
        k = np.linspace(-np.pi, np.pi, 240)
        squared = stencil.symbol(*np.ix_(k, k))
        squared = squared[..., None] if squared.ndim == 2 else np.linalg.eigvalsh(squared)
        slopes = np.gradient(squared, k, k, axis=(0, 1))
        sines = np.sin(k)[:, None, None], np.sin(k)[None, :, None]
        growth = np.max([-sine * slope for sine, slope in zip(sines, slopes, strict=True)], axis=0) / squared
        inside = np.zeros_like(growth, bool)
        inside[2:-2, 2:-2] = True
        lowest = squared[inside & (growth > 1e-3)].min()
        assert high_pass(stencil).lowest == pytest.approx(lowest, rel=0.05)


def test_sources_that_change_slowly_send_few():
    front = medium(SCALAR, 2)
    damped, u = high_pass(front.stencil), pulse((40, 40), (20.0, 20.0), 2.0)

    def share(course):
        return turned_by_wall(front, damped, Datum(u, "source", course)).amplitude

    steps = np.arange(2000)
    at_once, slowly = np.ones(2000), np.exp(-(((steps - 1000) / 200) ** 2))
    assert share(at_once) == pytest.approx(turned_by_wall(front, damped, Datum(u, "u")).amplitude, rel=0.05)
    assert 0 < share(at_once) and share(slowly) < 1e-6 * share(at_once)
    assert share(np.zeros(2000)) == pytest.approx(share(np.ones(1)))


def test_more_is_lacking_of_more_waves_until_all_have_come():
    damped, stencil = high_pass(SCALAR.stencil(1.0, 2)), SCALAR.stencil(1.0, 2)

    def lacking(nodes, way, turned, kept=1.0):
        edges = np.zeros(nodes + 1)
        return lacking_beside_walls(Layer(edges + 1, edges, edges), damped, stencil, way, Turned(*turned), kept)

    smooth = lacking(20, 1e6, (0.0, 0.0))
    assert smooth == lacking(20, 1.0, (0.0, 0.0)) and lacking(40, 1.0, (0.0, 0.0)) < 0.1 * smooth
    waves = 0.1, 0.2
    late = lacking(20, 120.0, waves) - smooth
    assert late == pytest.approx(lacking(20, 1e4, waves) - smooth)
    assert late == pytest.approx(0.1 * (lacking(20, 1e4, (1.0, 2.0)) - smooth))
    assert lacking(20, 60.0, waves) - smooth == pytest.approx(late / 2**6)
    assert lacking(20, 1e4, waves, 0.99) - smooth == pytest.approx(late * 0.99**120)
    # waves spread over a distance in proportion to the thickness, but have no larger amplitude than in phase
    assert lacking(40, 1e4, waves) - lacking(40, 1.0, (0.0, 0.0)) == pytest.approx(late / 2)
    assert lacking(20, 1e4, (1e-4, 10.0)) - smooth == pytest.approx(0.15e-4)
    # between two walls they are turned again and again, and spread along them only
    assert lacking(20, 1e4, (1.0, 0.2, 30)) - smooth == pytest.approx(0.2 * np.sqrt(1e4 / 30 / (30 * 20)))
    assert lacking(20, 1e4, (1e-4, 0.2, 30)) - smooth == pytest.approx(1.5e-4)
    neighbours = fh.Wave(fh.Stencil.finite_element(2)).stencil(1.0, 2)
    edges = np.zeros(21)
    layer = Layer(edges + 1, edges, edges)
    of_neighbours = high_pass(neighbours)
    assert lacking_beside_walls(layer, of_neighbours, neighbours, 1e6, Turned(1.0, 1.0)) == lacking_beside_walls(
        layer, of_neighbours, neighbours, 1e6, Turned()
    )


def test_filters_of_few_neighbours_leave_more_of_solids():
    damped, stencil, edges = high_pass(SOLID.stencil(1.0, 2)), SOLID.stencil(1.0, 2), np.zeros(11)
    brief, long = (Layer(edges + 1, edges, edges, edges[1:] + 1, np.ones(taps)) for taps in (5, 9))
    assert lacking_beside_walls(brief, damped, stencil, 1.0, Turned()) == pytest.approx(
        6 * lacking_beside_walls(long, damped, stencil, 1.0, Turned())
    )


def test_media_whose_waves_are_damped_themselves_have_no_slowest_backward_wave():
    """Correspondence without stabilisation has zero-energy waves, so that all data count as equally fast; the share of
    such waves must not change the result.
    """
    stencil = fh.Correspondence(fh.Kernel(3.0, 0, "gaussian"), young=1.0, poisson=0.25).stencil(1.0, 2)
    damped, edges = high_pass(stencil), np.zeros(13)
    layer = Layer(edges + 1, edges, edges)
    assert damped.whole and damped.lowest < 1e-4 * stencil.symbol_maximum
    assert lacking_beside_walls(layer, damped, stencil, 1e6, Turned(1.0, 1.0)) == lacking_beside_walls(
        layer, damped, stencil, 1.0, 0.0
    )
