"""What `check` reports about the shortest waves of signals."""

import re

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.checks.report import content

LATTICE = fh.Lattice(1.0, (-10.0, -10.0), (10.0, 10.0))
MODEL = fh.Wave(fh.Kernel(2.0))


def report(signal, **options):
    sources = [fh.PointSource((0.2, 0.3), time=signal)]
    return fh.Simulation(LATTICE, MODEL, fh.Fixed(), sources=sources, threads=1, **options).check(budget=0.1)


def test_a_signal_that_is_resolved():
    """Ten nodes and more give no warning."""
    found = report(fh.Ricker(0.03))
    assert 10 < found.numbers["shortest_wave_nodes"] < 1 / fh.Ricker(0.03).highest_frequency
    assert "nodes, at 0.08625 cycles per time" in dict(found.rows)["shortest wave"]
    assert not any("badly resolved" in warning for warning in found.warnings)


def test_a_signal_that_is_not_resolved():
    """The recommended spacing resolves the signal."""
    found = report(fh.Ricker(0.07))
    assert any("source.time are badly resolved" in warning for warning in found.warnings)
    spacing = found.numbers["resolving_spacing"]
    assert 0.3 < spacing < 1.0
    finer = fh.Lattice(spacing, (-10.0 * spacing,) * 2, (10.0 * spacing,) * 2)
    sources = [fh.PointSource((0.0, 0.0), time=fh.Ricker(0.07))]
    sim = fh.Simulation(finer, fh.Wave(fh.Kernel(2.0 * spacing)), fh.Fixed(), sources=sources, threads=1)
    assert sim.check(budget=0.1).numbers["shortest_wave_nodes"] == pytest.approx(6.0, rel=1e-2)


def test_what_dispersion_does_on_the_longest_way():
    """The way is that to the farthest receiver, or else to the farthest corner or side; the recommended spacing leaves
    what the note says.
    """
    to_corner = report(fh.Ricker(0.05))
    near = report(fh.Ricker(0.05), observe=[fh.Receivers([(3.0, 0.0), (0.0, 5.0)])])
    assert 0 < 2 * near.numbers["trace_error"] < to_corner.numbers["trace_error"]
    [note] = [note for note in to_corner.notes if "dispersion" in note]
    assert "after a way of 14.1" in note and f"{100 * to_corner.numbers['trace_error']:.2g} %" in note
    assert f"{100 * to_corner.numbers['phase_cycles']:.2g} % of a period" in note
    assert note.endswith("leaves less than 1 % of a period and 5 % of a trace, with as many spacings per horizon")
    spacing = float(re.search(r"spacing = (\S+) leaves", note)[1])
    lattice = fh.Lattice(spacing, (-10.0, -10.0), -10.0 + spacing * np.ceil(20 / spacing) * np.ones(2))
    sources = [fh.PointSource((0.2, 0.3), time=fh.Ricker(0.05))]
    finer = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0 * spacing)), fh.Fixed(), sources=sources, threads=1)
    found = finer.check(budget=0.1)
    assert found.numbers["trace_error"] == pytest.approx(0.05, rel=0.1)  # the spacing has two digits
    assert not any("dispersion" in note for note in found.notes)


WAY = 100.0


def measured_delay(sim, receivers, exact, frequency):
    """Periods by which the velocity at a receiver is behind an exact one at a frequency."""
    sim.run(260.0, progress=False)
    times = receivers.times - sim.dt / 2  # velocities are those between two steps
    spectra = [
        (trace * np.exp(-2j * np.pi * frequency * times)).sum() for trace in (receivers.data["v"][:, 0], exact(times))
    ]
    return -np.angle(spectra[0] / spectra[1]) / (2 * np.pi)


@pytest.mark.parametrize(("order", "integrator"), [(2, "verlet"), (4, "verlet"), (2, "modified-equation")])
@pytest.mark.parametrize("given", ["signal", "initial data"])
def test_the_delay_of_a_run_is_the_one_that_check_prints(order, integrator, given):
    """In 1D the velocity is ``s(t - r/c) / (2 c)`` for a point source, and that of half of the initial data."""
    signal, receivers = fh.Ricker(1 / 16), fh.Receivers([(WAY,)], record=["v"])

    def packet(x):
        return np.exp(-(x**2) / 200) * np.cos(2 * np.pi * x / 16)

    def exact(times):
        if given == "signal":
            return np.where(times > WAY, signal(np.maximum(times - WAY, 0.0)), 0.0) / 2
        return (packet(times - WAY + 1e-3) - packet(times - WAY - 1e-3)) / 4e-3

    what = {"sources": [fh.PointSource((0.0,), time=signal)]}
    if given == "initial data":
        what = {"initial": {"u": packet}}
    lattice = fh.Lattice(1.0, -60.0, 140.0)
    model = fh.Wave(fh.Stencil.finite_difference(1, order), integrator=integrator)
    sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=20), observe=[receivers], threads=1, **what)
    found = sim.check(budget=0.1)
    row = dict(found.rows)["dispersion"]
    words = r"of (\S+) cycles per time, arrives (\S+) % of a period .*(late|early)"
    frequency, told, when = re.search(words, row).groups()
    late = measured_delay(sim, receivers, exact, float(frequency))
    assert found.numbers["phase_cycles"] == pytest.approx(late, rel=1e-2)  # the layers reflect up to 1e-4
    assert float(told) / 100 * (1 if when == "late" else -1) == pytest.approx(late, rel=0.06)  # two digits
    assert float(frequency) == pytest.approx(1 / 16, rel=0.1)  # the energy of the packet has k^2


@pytest.mark.parametrize("far", [80.0, 300.0])
def test_the_order_that_is_recommended_is_enough(far):
    """On a long way the steps must be of fourth order, too."""

    def examined(order, integrator="verlet"):
        source, receivers = fh.PointSource((0.0,), time=fh.Ricker(1 / 20)), fh.Receivers([(far,)])
        lattice = fh.Lattice(1.0, -30.0, far + 10)
        model = fh.Wave(fh.Stencil.finite_difference(1, order), integrator=integrator)
        sides, options = fh.LatticePML(nodes=12), {"sources": [source], "observe": [receivers], "threads": 1}
        return fh.Simulation(lattice, model, sides, **options).check(budget=0.1)

    found = examined(2)
    assert found.numbers["phase_cycles"] > 0.01
    [note] = [note for note in found.notes if "dispersion" in note]
    order, integrator = re.search(r"differences of order = (\d)(?: with integrator = \"([a-z-]+)\")?", note).groups()
    assert (integrator is not None) == (far > 100)
    better = examined(int(order), integrator or "verlet")
    assert abs(better.numbers["phase_cycles"]) < 0.01 and better.numbers["trace_error"] < 0.05
    assert not any("dispersion" in note for note in better.notes)


@pytest.mark.parametrize(("unit", "told"), [(1.0, []), (10.0, ["notes"]), (1e3, ["warnings"])])
def test_a_signal_that_goes_on_after_the_run(unit, told):
    """A run as long as the samples in other units covers almost nothing of a longer signal."""
    values = np.sin(2 * np.pi * np.arange(41) / 20) * np.hanning(41)
    sources = [fh.PointSource((0.2, 0.3), time=fh.Samples(values, unit))]
    found = fh.Simulation(LATTICE, MODEL, fh.Fixed(), sources=sources, threads=1).check(50.0, budget=0.1)
    assert [
        name for name in ("notes", "warnings") if any("continues to" in text for text in getattr(found, name))
    ] == told


def test_the_slowest_part_of_the_medium_counts():
    factor = np.ones(LATTICE.shape)
    factor[:5] = 0.25
    found = [report(fh.Ricker(0.03), coefficient=given).numbers["shortest_wave_nodes"] for given in (None, factor)]
    assert found[1] == pytest.approx(found[0] / 2, rel=0.1)  # half the speed, and a little more dispersion


def test_without_a_signal_nothing_is_said():
    """Nothing is known about expressions, nor reported for diffusion."""
    assert "shortest_wave_nodes" not in report("sin(t)").numbers
    source = fh.PointSource((0.0, 0.0), time=fh.Ricker(0.1))
    sim = fh.Simulation(LATTICE, fh.Diffusion(fh.Kernel(2.0)), fh.Fixed(), sources=[source], threads=1)
    assert "shortest_wave_nodes" not in sim.check(budget=0.1).numbers


def test_wavelengths_are_those_of_the_signal():
    """A point source has waves of all lengths; the signal selects those of its frequencies, whether or not the end of
    the run is known.
    """
    signal = fh.Ricker(0.05)
    sim = fh.Simulation(LATTICE, MODEL, fh.Fixed(), sources=[fh.PointSource((0.2, 0.3), time=signal)], threads=1)
    bands = [content(sim, until) for until in (None, 200.0)]
    for band in bands:
        assert 1 / signal.highest_frequency < band.shortest < band.typical < 1.5 / signal.frequency
    assert bands[0].typical == pytest.approx(bands[1].typical, rel=0.1)
    assert content(sim.remade(sources=[fh.PointSource((0.2, 0.3), time="sin(t)")])).typical < 5
