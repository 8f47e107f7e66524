"""Warnings about sources whose time dependence the steps of a run do not resolve."""

import os
import warnings

import numpy as np
import pytest

import farhorizon as fh

BELL = "exp(-3*x**2 - 3*y**2)"


def driven(source, model=None):
    lattice = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0))
    return fh.Simulation(lattice, model or fh.Wave(fh.Kernel(1.0)), fh.LatticePML(nodes=6), sources=[source])


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (fh.Source(BELL, time="exp(-((t - 1)/0.02)**2)"), "up to .* between them"),
        (fh.Source(f"{BELL}*exp(-((t - 1.1)/0.02)**2)"), "up to .* between them"),
        (fh.PointSource((0.0, 0.0), time="exp(-((t - 1)/0.02)**2)"), "up to .* between them"),
        (fh.Source(BELL, time=lambda t: float(abs(t - 1.0) < 0.1)), "up to .* between them"),
        (fh.Source(BELL, time="sin(50*t)"), "they alias it"),
    ],
)
def test_what_changes_within_a_step_is_told_once(source, said):
    sim = driven(source)
    assert 0.2 < sim.dt < 0.35
    with pytest.warns(fh.ValidityWarning, match=f"source changes within the steps of .*{said}"):
        sim.run(5.0, progress=False)
    with warnings.catch_warnings(action="error"):
        sim.run(9.0, progress=False)
    assert sum("changes within the steps" in note for note in sim.notes) == 1


@pytest.mark.parametrize(
    "time", ["sin(2*t)", "where(t < 2, 1, 0)", lambda t: float(t > 5), "sin(t)*(1 - exp(-t))", fh.Ricker(0.3), None]
)
def test_what_steps_see_is_not(time):
    """Neither are jumps, of a load that is applied or removed at once."""
    with warnings.catch_warnings(action="error"):
        driven(fh.Source(BELL, time=time)).run(5.1, progress=False).run(12.0, progress=False)


def test_a_pulse_of_heat_between_two_steps_is_told():
    pulse = fh.Source(f"{BELL}*exp(-((t - 0.5)/0.002)**2)")
    with pytest.warns(fh.ValidityWarning, match="changes within the steps"):
        driven(pulse, fh.Diffusion(fh.Kernel(1.0), integrator="rkc")).check(until=2.0)


def test_random_factors_of_time_are_told_by_their_frequency():
    """Sines whose phase advances by up to a sixth of a period per step are accepted, those near or beyond the Nyquist
    limit are reported; random amplitudes, phases and rise times.
    """
    seed = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))
    random = np.random.default_rng(seed)
    print(f"seed {seed}")
    dt = driven(fh.Source(BELL)).dt
    for turn in (*random.uniform(0.01, np.pi / 3, 10), *random.uniform(2.6, 40.0, 10)):
        size, phase, rise = 10.0 ** random.uniform(-6, 6), random.uniform(0, 6), random.uniform(1, 20)
        omega = turn / dt

        def time(t, omega=omega, size=size, phase=phase, rise=rise):
            return size * min(t / rise, 1.0) * np.sin(omega * t + phase)

        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            driven(fh.Source(BELL, time=time)).check_sources(60.0)
        told = any("changes within the steps" in str(one.message) for one in caught)
        assert told == (turn > np.pi / 3), turn
