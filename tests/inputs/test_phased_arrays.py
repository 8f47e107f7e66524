"""Phased arrays: delays, radiated fields, and what is refused."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.geometry.interpolation import interpolation_blocks

BURST = fh.ToneBurst(0.08, 4)


def test_delays_towards_a_focus():
    """All waves arrive at the same time; the element with the longest path starts first."""
    array = fh.PhasedArray((-3.0, 1.0), (5.0, 1.0), 9, 1.0, BURST, speed=2.0, focus=(1.5, -6.0))
    arrivals = array.delays + np.linalg.norm(array.centres - [1.5, -6.0], axis=1) / 2.0
    np.testing.assert_allclose(arrivals, arrivals[0], rtol=1e-14)
    assert array.delays.min() == 0


def test_delays_at_an_angle():
    """The front is plane: the paths along its direction compensate the delays."""
    array = fh.PhasedArray((0.0, 0.0, 0.0), (3.0, 4.0, 0.0), 6, 1.0, BURST, speed=2.0, angle=-35.0)
    along = array.centres @ np.array([3.0, 4.0, 0.0]) / 5
    front = array.delays - along * np.sin(np.radians(-35.0)) / 2.0
    np.testing.assert_allclose(front, front[0], atol=1e-14)
    assert fh.PhasedArray((0, 0), (3, 0), 2, 1.0, BURST).delays.tolist() == [0, 0]


def test_the_sum_of_its_elements():
    """The reference has one line source per element, each with its own function of a delayed signal."""
    lattice, model = fh.Lattice(1.0, (-16.0, -14.0), (16.0, 14.0)), fh.Wave(fh.Kernel(2.0))
    array = fh.PhasedArray((-4.2, -2.0), (4.2, -2.0), 3, 0.7, BURST, speed=1.0, angle=40.0, width=3.0)
    half = np.array([1.5, 0.0])
    lines = [
        fh.LineSource([c - half, c + half], 0.7, lambda t, d=d: float(BURST(t - d)))
        for c, d in zip(array.centres, array.delays, strict=True)
    ]
    runs = []
    for sources in ([array], lines):
        sim = fh.Simulation(lattice, model, fh.Fixed(), sources=sources, threads=1)
        runs.append(sim.run(until=30.0).fields["u"])
    assert np.abs(runs[0]).max() > 0.1
    np.testing.assert_allclose(runs[0], runs[1], rtol=0, atol=1e-13)


def test_its_elements_have_signals():
    """Elements have the spectrum of the delayed signal; functions of t are zero before their delay."""
    for time in (BURST, lambda t: np.sin(t)):
        array = fh.PhasedArray((0.0, 0.0), (4.0, 0.0), 3, 1.0, time, speed=0.5, angle=30.0)
        sources = array.placed(fh.Lattice(0.5, (-6.0, -6.0), (10.0, 6.0)), 1, "source")
        for source, delay in zip(sources, array.delays, strict=True):
            assert [float(source.time(t)) for t in (delay - 0.1, delay + 7.0)] == [0.0, float(time(7.0))]
    frequencies = np.array([0.03, 0.08, 0.2])
    last = array.delays[-1]
    delayed = fh.PhasedArray((0.0, 0.0), (4.0, 0.0), 3, 1.0, BURST, speed=0.5, angle=30.0).placed(
        fh.Lattice(0.5, (-6.0, -6.0), (10.0, 6.0)), 1, "source"
    )[-1]
    known = BURST.spectrum(frequencies) * np.exp(-2j * np.pi * frequencies * last)
    np.testing.assert_allclose(delayed.time.spectrum(frequencies), known)
    assert delayed.time.highest_frequency == pytest.approx(BURST.highest_frequency, rel=0.05)


def test_it_focuses():
    """The largest amplitude along the line below lies at the focus, for two focal points."""
    lattice, model = fh.Lattice(1.0, (-24.0, -20.0), (24.0, 10.0)), fh.Wave(fh.Kernel(2.0))
    line = np.column_stack([np.linspace(-12, 12, 49), np.full(49, -8.0)])
    nodes, weights = interpolation_blocks(lattice, line).entries()
    for focus in (-6.0, 5.0):
        array = fh.PhasedArray((-12, 0), (12, 0), 17, 1.0, BURST, speed=1.0, focus=(focus, -8.0))
        sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=10), sources=[array], threads=1)
        largest = np.zeros(len(line))
        while sim.time < 70.0:
            sim.step(2)
            largest = np.maximum(largest, np.abs((weights * sim.fields["u"].ravel()[nodes]).sum(-1)))
        # within a third of the wavelength of 12
        assert abs(line[np.argmax(largest), 0] - focus) < 4


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"angle": 10.0}, r"source\.speed: delays follow from the speed"),
        ({"angle": 10.0, "focus": (0.0, -5.0), "speed": 1.0}, r"source\.angle: either a focus or an angle"),
        ({"angle": 95.0, "speed": 1.0}, r"source\.angle: is out of range"),
        ({"width": 2.5}, r"source\.width: the elements overlap; value: 2.5; limit: 2"),
        ({"elements": 1}, r"source\.elements: .*limit: 2 to"),
        ({"last": (0.0, 0.0)}, r"source\.first: the first and the last element differ"),
        ({"focus": (0.0, 0.0, 1.0), "speed": 1.0}, "one coordinate per axis"),
        ({"time": "cos(t)", "angle": 10.0, "speed": 1.0}, r"source\.time: .* begin at rest.*value: 1 at t = 0.*remedy"),
        ({"strength": [[1.0]]}, r"source\.strength: must be a number"),
    ],
)
def test_what_is_refused(changes, message):
    given = {"first": (0.0, 0.0), "last": (6.0, 0.0), "elements": 4, "strength": 1.0, "time": BURST}
    with pytest.raises(fh.InputError, match=message):
        fh.PhasedArray(**{**given, **changes})
