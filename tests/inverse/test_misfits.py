"""Misfits: their values where these are known, and their derivatives beside differences."""

import numpy as np
import pytest

import farhorizon as fh

RANDOM = np.random.default_rng(20261130)
TIMES = 0.5 * np.arange(120)


def pulse(delay, width=4.0):
    """Two traces of a wave packet that arrives later by a delay."""
    at = TIMES[:, None] - np.array([25.0, 31.0]) - delay
    return np.exp(-((at / width) ** 2)) * np.cos(2.1 * at / width)


@pytest.mark.parametrize("kind", [fh.LeastSquares, fh.Envelope, fh.TravelTime])
@pytest.mark.parametrize("frequency", [None, 0.3])
def test_the_derivative_is_that_of_differences(kind, frequency):
    """In random directions, by differences of fourth order."""
    receivers = fh.Receivers([[1.0], [2.0]])
    window = (
        0.5 + 0.5 * RANDOM.random((120, 2))
        if kind is not fh.TravelTime
        else np.exp(-(((TIMES[:, None] - 28) / 15) ** 2))
    )
    misfit = kind(receivers, pulse(0.0), window)
    misfit = misfit if frequency is None else misfit.below(frequency)
    records = pulse(np.array([1.3, -0.7])) + 0.02 * RANDOM.standard_normal((120, 2))
    value, slopes = misfit.of({"u": records}, TIMES)
    direction, small = RANDOM.standard_normal(records.shape), 2e-5

    def at(amount):
        return misfit.of({"u": records + amount * direction}, TIMES)[0]

    quotient = (8 * (at(small) - at(-small)) - (at(2 * small) - at(-2 * small))) / (12 * small)
    assert value > 0
    assert float((slopes["u"] * direction).sum()) == pytest.approx(quotient, rel=1e-6)


def test_a_shifted_record_has_its_shift_as_delay():
    misfit = fh.TravelTime(fh.Receivers([[1.0], [2.0]]), pulse(0.0))
    for delay in (0.0, 0.17, -2.41, 7.3):
        value, _ = misfit.of({"u": pulse(delay)}, TIMES)
        assert value == pytest.approx(delay**2, rel=1e-6, abs=1e-16)  # two traces, each half of the square


def test_an_envelope_does_not_know_the_phase():
    """Of a slowly varying packet; the squared differences themselves do."""
    receivers = fh.Receivers([[1.0]])
    at = TIMES[:, None] - 30.0
    packet = [np.exp(-((at / 9) ** 2)) * np.cos(2.0 * at + phase) for phase in (0.0, 1.5)]
    envelope, _ = fh.Envelope(receivers, packet[0]).of({"u": packet[1]}, TIMES)
    squares, _ = fh.LeastSquares(receivers, packet[0]).of({"u": packet[1]}, TIMES)
    assert envelope < 1e-6 * squares


def test_traces_without_motion_have_no_delay():
    misfit = fh.TravelTime(fh.Receivers([[1.0], [2.0]]), pulse(0.0))
    value, slopes = misfit.of({"u": 0 * pulse(0.0)}, TIMES)
    assert value == 0 and not slopes["u"].any()


@pytest.mark.parametrize("kind", [fh.Envelope, fh.TravelTime])
def test_the_gradient_of_a_run_is_of_second_order(kind):
    """|J(m + e p) - J(m) - e g.p| falls as e^2, for the speed of every node."""
    lattice, receivers = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0)), fh.Receivers([(6.0, -3.0), (6.0, 4.0)])
    source = [fh.PointSource((-5.0, 1.0), time=fh.Ricker(0.08))]

    def setup(speed):
        return fh.Setup(lattice, fh.Wave(fh.Kernel(2.0), speed=speed), fh.LatticePML(nodes=8), sources=source, dt=0.4)

    known = fh.Simulation.of(setup(1.0), observe=[receivers])
    known.run(until=40.0)
    misfit = kind(receivers, receivers.data["u"].copy())
    x, y = lattice.coordinates()
    base = 1.0 + 0.1 * np.exp(-(x**2 + y**2) / 20)
    change = np.exp(-((x - 1) ** 2 + (y + 2) ** 2) / 12)
    found = fh.gradient(setup(base), misfit, "speed", until=40.0)
    slope = float((found["speed"] * change).sum())
    sizes = 0.01 * 2.0 ** -np.arange(4)
    left = [
        abs(fh.gradient(setup(base + e * change), misfit, "speed", until=40.0).misfit - found.misfit - e * slope)
        for e in sizes
    ]
    orders = np.log2(np.array(left[:-1]) / left[1:])
    assert np.all(np.abs(orders - 2) < 0.1), orders
