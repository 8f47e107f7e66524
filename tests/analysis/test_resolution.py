"""Nodes per shortest wave, against closed forms of the dispersion, and the spacing that resolves it."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.resolution import ENOUGH, resolution

LINE = fh.Stencil.finite_difference(1)


@pytest.mark.parametrize("frequency", [0.01, 0.1, 0.2])
@pytest.mark.parametrize("dt", [0.3, 0.9])
def test_a_line(frequency, dt):
    """``sin(k/2) dt = sin(w dt/2)``."""
    number = 2 * np.arcsin(np.sin(np.pi * frequency * dt) / dt)
    # interpolated between 512 samples of the dispersion
    assert resolution(LINE, 1.0, dt, frequency).nodes == pytest.approx(2 * np.pi / number, rel=1e-4)


def test_the_slowest_wave_counts():
    """The slowest wave is a shear wave, and its long-wave limit that of the continuum."""
    model = fh.Elastic(fh.Kernel(2.0), young=1.0)
    found = resolution(model.medium(1.0, 2), model.coefficient, 0.1, 1e-3)
    assert found.nodes == pytest.approx(model.s_speed / 1e-3, rel=1e-3)


def test_what_the_lattice_does_not_carry():
    assert resolution(LINE, 1.0, 0.5, 0.4).nodes == 0  # above 1/pi
    assert resolution(LINE, 1.0, 0.5, 5.0).nodes == 0  # above half a cycle a step
    assert resolution(LINE.with_reaction(1.0), 1.0, 0.5, 0.1).nodes == np.inf  # below 1 / (2 pi)


@pytest.mark.parametrize(
    "stencil", [LINE, fh.Stencil.finite_difference(2), fh.Elastic(fh.Kernel(2.0), 1.0).medium(1.0, 2)]
)
@pytest.mark.parametrize("frequency", [0.05, 0.7])
def test_the_spacing_that_resolves(stencil, frequency):
    """At the spacing that is returned the shortest wave has exactly the required number of nodes."""
    _, scale = resolution(stencil, 1.0, 0.5, frequency)
    assert resolution(stencil, 1.0 / scale**2, 0.5 * scale, frequency).nodes == pytest.approx(ENOUGH, rel=1e-4)
