"""What `check` reports about the shortest waves of signals."""

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
