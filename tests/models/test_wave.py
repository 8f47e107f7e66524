"""Scalar waves by differences of higher order, against the wave equation and a domain that nothing leaves."""

import numpy as np
import pytest
from tests.helpers import fitted_rate

import farhorizon as fh
from farhorizon.case.case import Case


@pytest.mark.parametrize("order", [2, 4, 6])
def test_a_travelling_pulse_converges_with_the_order(order):
    """A pulse that passes a periodic box twice, against d'Alembert's solution. The steps are so short that their own
    error, of the second order, is below a tenth of that of the lattice.
    """
    errors, counts = [], np.array([24, 32, 48])
    for count in counts:
        h = 2 * np.pi / count
        lattice = fh.Lattice(h, 0.0, 2 * np.pi - h)
        x, dt = lattice.axes[0], 0.3 * h ** (order / 2) / 4 ** (order / 2)

        def pulse(s):
            return np.exp(np.cos(s) + 0.5 * np.sin(s))

        def slope(s):
            return (-np.sin(s) + 0.5 * np.cos(s)) * pulse(s)

        model = fh.Wave(fh.Stencil.finite_difference(1, order))
        steps = round(4 * np.pi / dt)
        dt = 4 * np.pi / steps
        start = {"u": pulse(x), "v": -slope(x)}
        sim = fh.Simulation(lattice, model, fh.Periodic(), initial=start, dt=dt, threads=1)
        sim.step(steps)
        errors.append(np.abs(sim.fields["u"] - pulse(x)).max())
    assert abs(fitted_rate(1 / counts, errors) - order) < 0.25, errors


@pytest.mark.parametrize("order", [4, 6, 8])
def test_layers_keep_their_target(order):
    """Against a domain so large that nothing returns."""
    model, start = fh.Wave(fh.Stencil.finite_difference(2, order)), {"u": "exp(-(x**2 + y**2)/9)"}
    layers = fh.LatticePML(target=1e-4, until=40.0)
    sim = fh.Simulation(fh.Lattice(1.0, (-15.0, -15.0), (15.0, 15.0)), model, layers, start, threads=1)
    far = fh.Simulation(
        fh.Lattice(1.0, (-40.0, -40.0), (40.0, 40.0)), model, fh.Periodic(), start, dt=sim.dt, threads=1
    )
    worst = 0.0
    for until in (10.0, 20.0, 30.0, 40.0):
        for one in (sim, far):
            one.run(until, progress=False)
        worst = max(worst, np.abs(sim.fields["u"] - far.fields["u"][25:56, 25:56]).max())
    assert worst < 1e-4  # of the largest initial value, 1


def test_a_certificate():
    sim = fh.Simulation(
        fh.Lattice(1.0, (-6.0, -6.0), (6.0, 6.0)), fh.Wave(fh.Stencil.finite_difference(2, 4)), fh.LatticePML(nodes=6)
    )
    assert sim.certificate().verdict == "certified"


CASE = """
lattice = { spacing = 1.0, lower = [-9.0, -9.0], upper = [9.0, 9.0] }
model = { type = "wave", stencil = "finite-difference", order = 4 }
boundary = { all = { type = "lattice-pml", nodes = 8 } }
run = { until = 4.0 }
"""


def test_case_file():
    assert Case(CASE).model.operator == fh.Stencil.finite_difference(2, 4)
    for new, words in (
        ('"finite-difference", order = 3', r"model\.order: central differences of another order"),
        ('"finite-element", order = 4', r"model\.order: the order is that of finite differences"),
    ):
        with pytest.raises(fh.InputError, match=words):
            Case(CASE.replace('"finite-difference", order = 4', new))
    with pytest.raises(fh.InputError, match=r"model\.order: the order is that of finite differences"):
        Case(CASE.replace('stencil = "finite-difference"', "kernel = { horizon = 2.0 }"))
    with pytest.raises(fh.InputError, match=r"unknown key model\.order"):
        Case(CASE.replace('"wave"', '"diffusion"'))


@pytest.mark.parametrize(
    ("options", "key"),
    [
        ({"boundary": {"x": fh.LatticePML(nodes=6), "y": fh.Free()}}, r"boundary\.y-"),
        ({"cracks": [[(-3.0, 0.5), (3.0, 0.5)]]}, "crack"),
        ({"lattice": fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0), body=~np.eye(19, dtype=bool))}, r"lattice\.body"),
    ],
)
def test_a_medium_that_ends_is_refused(options, key):
    lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    for order in (2, 4):
        model = fh.Wave(fh.Stencil.finite_difference(2, order))
        given = {"lattice": lattice, "model": model, "boundary": fh.LatticePML(nodes=6), **options}
        if order == 2:
            fh.Simulation(**given)
            continue
        with pytest.raises(fh.InputError, match=f"^{key}: central differences of a higher order"):
            fh.Simulation(**given)
