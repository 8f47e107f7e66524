"""Fourier sums accumulated in a run: against the FFT of the whole record, in any batches, across a checkpoint."""

import numpy as np
import pytest

from farhorizon.simulation.recorders.fourier_sums import FourierSums

DT, STEPS, COUNT = 0.3, 300, 5


def summed(values, frequencies, cuts):
    """Return the sums of values that are added in batches, divided at the cuts."""
    sums = FourierSums(frequencies, DT, values.shape[1])
    for first, last in zip([0, *cuts], [*cuts, len(values)], strict=True):
        sums.add(first, values[first:last])
    return sums


@pytest.mark.parametrize("cuts", [(), (1, 2, 3), (64,), (63, 65, 200), (100, 100, 299)])
def test_as_the_fft_of_the_record(cuts):
    """For any batches, some of them empty, at frequencies of an FFT of 300 steps, including its highest."""
    values = np.random.default_rng(3).normal(size=(STEPS, COUNT))
    numbers = np.array([0, 1, 7, 149, 150])
    found = summed(values, numbers / (STEPS * DT), cuts).values
    exact = DT * np.fft.fft(values, axis=0)[numbers]
    np.testing.assert_allclose(found, exact, atol=1e-13 * np.abs(values).sum() * DT)  # rounding of 300 terms


def test_frequencies_between_those_of_an_fft():
    """A decaying wave, whose sum is a geometric series."""
    w, decay, frequency = 2.0, 0.05, 0.31
    t = DT * np.arange(STEPS)
    found = summed(np.exp(-decay * t)[:, None] * np.cos(w * t)[:, None], np.array([frequency]), (70,)).values
    ratios = [np.exp((-decay + sign * 1j * w - 2j * np.pi * frequency) * DT) for sign in (1, -1)]
    exact = DT * sum((1 - r**STEPS) / (1 - r) for r in ratios) / 2
    np.testing.assert_allclose(found, exact, rtol=1e-12)


def test_taken_up_anywhere_the_sums_are_the_same_bit_by_bit():
    """Saved between two blocks and within one."""
    values = np.random.default_rng(5).normal(size=(STEPS, COUNT))
    frequencies = np.array([0.05, 0.4])
    whole = summed(values, frequencies, ())
    for cut in (0, 1, 64, 130, 299):
        first = summed(values[:cut], frequencies, ())
        second = FourierSums(frequencies, DT, COUNT)
        second.take(first.state())
        second.add(cut, values[cut:])
        np.testing.assert_array_equal(second.values, whole.values)


def test_late_steps_keep_their_phase():
    """After a million steps, the argument of the cosine would have lost seven digits, and the phase with them."""
    sums = FourierSums(np.array([1 / 3]), 1.0, 1)
    sums.add(3_000_000, np.array([[1.0], [1.0], [1.0]]))
    assert abs(sums.values[0, 0]) < 1e-9  # thirds of a cycle cancel, up to the rounding of 1e6 cycles
