"""Nodes per shortest wave, against closed forms of the dispersion, and the spacing that resolves it."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.resolution import ENOUGH, band, delay, gain_of_time, lines_along, resolution, trace_error

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


@pytest.mark.parametrize("kernel", [LINE, fh.Kernel(2.0)], ids=["finite differences", "kernel"])
@pytest.mark.parametrize("nodes", [12, 24, 48])
def test_the_error_of_a_trace(kernel, nodes):
    """In 1D the velocity far from a point source is the signal, at the speed of long waves ``s(t - r/c) / (2 c)``.

    The tolerance of a tenth is for the amplitudes, which the lattice changes by up to ``(k spacing)^2 / 8``.
    """
    signal, way = fh.Ricker(1.0 / nodes), 6 * nodes
    receivers = fh.Receivers([(way,)], record=["v"])
    source = fh.PointSource((0.0,), time=signal)
    lattice, until = fh.Lattice(1.0, -5.0, way + 5.0), way + 2 * signal.end
    sim = fh.Simulation(lattice, fh.Wave(kernel), fh.Exact(), sources=[source], observe=[receivers])
    sim.run(until, progress=False)
    times = receivers.times - sim.dt / 2
    exact = np.where(times > way, signal(np.maximum(times - way, 0.0)), 0.0) / 2
    frequencies = np.linspace(0.0, signal.highest_frequency, 257)
    lines = lines_along(sim.stencil, np.array([1.0]))
    found = trace_error(lines, 1.0, sim.dt, frequencies, np.abs(signal.spectrum(frequencies)), way)
    measured = np.abs(receivers.data["v"][:, 0] - exact).max() / np.abs(exact).max()
    assert found == pytest.approx(measured, rel=0.1)
    # the phase of the trace at the frequency of the signal, to the four digits that the samples of the branch have
    spectra = [(trace * np.exp(-2j * np.pi * times / nodes)).sum() for trace in (receivers.data["v"][:, 0], exact)]
    late = -np.angle(spectra[0] / spectra[1]) / (2 * np.pi)
    assert delay(lines, 1.0, sim.dt, 1.0 / nodes, way) == pytest.approx(late, rel=1e-3, abs=1e-5)


def test_waves_along_a_diagonal_are_less_late():
    """Along the axis ``k (k^2 / 24)``, along the diagonal of a square lattice half of it, per node of the way."""
    stencil, number = fh.Stencil.finite_difference(2), 0.2
    for way, part in (((3.0, 0.0), 1.0), ((0.0, -2.0), 1.0), ((1.0, 1.0), 0.5), ((1.0, 0.5), 17 / 25)):
        lines = lines_along(stencil, np.array(way))
        late = delay(lines, 1.0, 1e-3, number / (2 * np.pi), 100.0)
        # the next term of the series is smaller by k^2 / 10
        assert late == pytest.approx(part * 100 * number**3 / 24 / (2 * np.pi), rel=1e-2)


def test_band_of_a_packet():
    """A wave of 12 nodes under an envelope: half of the energy lies near its wavelength, hardly any beyond half and
    twice the wavelength.
    """
    x = 0.5 * np.arange(400)
    found = band([np.exp(-((x - 100) ** 2) / 800) * np.cos(2 * np.pi * x / 6)], 0.5, [1])
    assert found.typical == pytest.approx(6.0, rel=0.02)
    assert 3 < found.shortest < 6 < found.longest < 12
    assert band([np.zeros(10)], 1.0, [0]) is None


def test_the_time_of_a_source_picks_its_waves():
    """A point source of one frequency radiates one wavelength, 2 pi speed / frequency, whatever its size."""
    point = np.exp(-((np.arange(200) - 100.0) ** 2) / 2)
    gain = gain_of_time(lambda t: np.sin(0.6 * t) * np.exp(-(((t - 100) / 30) ** 2)), 200.0, 2.0 / 0.5)
    found = band([point], 0.5, [0], [gain])
    assert found.typical == pytest.approx(2 * np.pi * 2.0 / 0.6, rel=0.05)
    assert found.longest < 1.5 * found.typical and found.shortest > 0.6 * found.typical
