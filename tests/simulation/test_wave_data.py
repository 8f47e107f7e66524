"""Data of waves in parts."""

import numpy as np

from farhorizon.analysis.layers.side_data import Datum
from farhorizon.simulation.wave_data import by_time, depth_of, largest_along

SEED = 20261122


def test_each_moment_of_a_source_is_whole_in_one_part():
    """And no part is switched on or off at once, but with the source."""
    random = np.random.default_rng(SEED)
    half, course, still = 20, random.uniform(0.5, 1.0, 130), Datum(np.ones(3), "v")
    course[55:] *= np.where(np.arange(75) < 60, 0.0, 1.0)  # the part around 80 holds nothing
    parts = list(by_time([still, Datum(np.ones(3), "source", course)], half, 1e-3))
    assert parts[0][1][0] is still and [len(data) for _, data in parts] == [2, 1, 1, 1, 1, 1]
    whole = np.zeros(130)
    for middle, (before, data) in zip((0, 20, 40, 60, 100, 120), parts, strict=True):
        assert before == min(middle, half)
        places = np.arange(len(data[-1].time)) + middle - before
        whole[places] = np.maximum(whole[places], data[-1].time)
        assert not middle or data[-1].time[0] < 1e-30
        assert places[-1] == 129 or data[-1].time[-1] < 0.05
    np.testing.assert_array_equal(whole, course)


def test_the_middle_of_the_data_and_their_largest_values_along_an_axis():
    values = np.zeros((9, 5, 4))
    values[6, 2, 1], values[6, 4, 1], values[2, 2, 3] = -3.0, 2.0, 0.0
    assert depth_of([Datum(values, "u")]) == (2,)
    assert depth_of([Datum(0 * values, "u")]) == ()
    np.testing.assert_array_equal(
        largest_along(values, [1])[:, 0], np.where(np.arange(36) == 25, -3.0, 0.0).reshape(9, 4)
    )
