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
    """The way is that to the farthest receiver, or else to the farthest corner; the recommended spacing leaves what the
    note says.
    """
    to_corner = report(fh.Ricker(0.05))
    near = report(fh.Ricker(0.05), observe=[fh.Receivers([(3.0, 0.0), (0.0, 5.0)])])
    assert 0 < 2 * near.numbers["trace_error"] < to_corner.numbers["trace_error"]
    [note] = [note for note in to_corner.notes if "dispersion" in note]
    assert "after a way of 14.1" in note and f"{100 * to_corner.numbers['trace_error']:.2g} %" in note
    spacing = float(re.search(r"spacing = (\S+) leaves 5 %", note)[1])
    lattice = fh.Lattice(spacing, (-10.0, -10.0), -10.0 + spacing * np.ceil(20 / spacing) * np.ones(2))
    sources = [fh.PointSource((0.2, 0.3), time=fh.Ricker(0.05))]
    finer = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0 * spacing)), fh.Fixed(), sources=sources, threads=1)
    assert finer.check(budget=0.1).numbers["trace_error"] == pytest.approx(0.05, rel=0.1)  # the spacing has two digits


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
