"""Time step of the near field."""

import os

import numpy as np
import pytest

import farhorizon as fh


@pytest.mark.parametrize("width", [1.0, 2.0, 4.0])
def test_steps_of_chebyshev_follow_the_data(width):
    """A bell that spreads: the step follows its width, so that the error against fourth order in time is below a
    thousandth, although steps a hundred times as long would be stable. With a source, of which nothing is known, the
    step is that of Euler.
    """
    half, bell, found = 4 * width, f"exp(-(x**2 + y**2)/{width**2})", {}
    lattice = fh.Lattice(0.25, (-half, -half), (half, half))
    for integrator in ("rkc", "rk4", "euler"):
        setup = {
            "lattice": lattice,
            "model": fh.Diffusion(fh.Kernel(0.5), integrator=integrator),
            "boundary": fh.Extended(until=0.6),
        }
        left_out = fh.Simulation(**setup, initial={"u": bell}).dt
        sim = fh.Simulation(**setup, initial={"u": bell}, dt=0.5 / np.ceil(0.5 / left_out))
        sim.run(0.5, progress=False)
        driven = fh.Simulation(**setup, initial={"u": bell}, sources=[fh.Source(bell)]).dt
        found[integrator] = sim.fields["u"], left_out, driven
    assert np.abs(found["rkc"][0] - found["rk4"][0]).max() < 1e-3
    assert found["rkc"][1] > width**2 * found["euler"][1]  # the time scale of the data is their width squared
    assert found["rkc"][2] == pytest.approx(found["euler"][2])


def test_steps_of_chebyshev_follow_random_data():
    """Bells of random width, place and sign in media of random reach, smooth enough for steps longer than Euler's,
    against fourth order in time with shorter steps.
    """
    seed = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))
    random = np.random.default_rng(seed)
    print(f"seed {seed}")
    lattice = fh.Lattice(1.0, (-45.0, -45.0), (45.0, 45.0))
    for _ in range(4):
        kernel, u = fh.Kernel(float(random.integers(1, 3)), int(random.integers(0, 3))), np.zeros(lattice.shape)
        bells = (random.uniform(*one) for one in ((8, 11, 3), (-6, 6, (3, 2)), (-1, 1, 3)))
        for width, centre, size in zip(*bells, strict=True):
            u += size * np.exp(
                -sum((x - c) ** 2 for x, c in zip(lattice.coordinates(), centre, strict=True)) / width**2
            )
        ours, exact, euler = (fh.Diffusion(kernel, integrator=one) for one in ("rkc", "rk4", "euler"))
        sim = fh.Simulation(lattice, ours, fh.Fixed(), {"u": u})
        finer = int(np.ceil(sim.dt / fh.Simulation(lattice, exact, fh.Fixed(), {"u": u}).dt))
        other, worst = fh.Simulation(lattice, exact, fh.Fixed(), {"u": u}, dt=sim.dt / finer), 0.0
        assert sim.dt > fh.Simulation(lattice, euler, fh.Fixed(), {"u": u}).dt
        while sim.time < 60:
            sim.step(1)
            other.step(finer)
            worst = max(worst, float(np.abs(sim.fields["u"] - other.fields["u"]).max() / np.abs(u).max()))
        assert 0 < worst < 1e-3


def test_a_side_that_holds_another_value_drives():
    lattice, bell = fh.Lattice(1.0, (-45.0,), (45.0,)), {"u": "exp(-x**2/64)"}
    steps = []
    for integrator, value in (("rkc", 0.0), ("rkc", 1.0), ("euler", 1.0)):
        model = fh.Diffusion(fh.Kernel(2.0), integrator=integrator)
        steps.append(fh.Simulation(lattice, model, {"x-": fh.Fixed(value), "x+": fh.Fixed()}, bell).dt)
    assert steps[0] > 2 * steps[1]
    assert steps[1] == pytest.approx(steps[2])


@pytest.mark.parametrize(("side", "most"), [(fh.LatticePML(nodes=12), 1e-9), (fh.Higdon(), 0.03)])
def test_a_body_is_seen_through_a_window(side, most):
    """A round window on a medium with a hole in it: as in a plane so large that nothing returns; nothing is shown of
    the hole, nor beyond the window. Conditions along the outline have an error of their own.
    """
    body = fh.Box((-1e3, -1e3), (1e3, 1e3)) - fh.Disc(1.2, (1.0, 0.5))
    pulse, model = {"u": "exp(-((x+2)**2+(y+1)**2)*2.5)"}, fh.Wave(fh.Kernel(0.5), damping=0.02)
    window = fh.Lattice(0.25, window=fh.Disc(5.0), body=body)
    plane = fh.Lattice(0.25, (-16.0, -16.0), (16.0, 16.0), body=body)
    assert window.nodes < np.pi * 20**2 - np.pi * 4.8**2 + 100
    small, large = (
        fh.Simulation(lattice, model, sides, pulse, dt=0.05) for lattice, sides in ((window, side), (plane, fh.Fixed()))
    )
    at = tuple(
        slice(round((low + 16) / 0.25), round((high + 16) / 0.25) + 1)
        for low, high in zip(window.lower, window.upper, strict=True)
    )
    for until in (4.0, 9.0):
        small.run(until)
        large.run(until)
        u, exact = small.fields["u"], large.fields["u"][at]
        np.testing.assert_array_equal(np.isnan(u), ~window.mask)
        assert np.abs(u - exact)[window.mask].max() < most
