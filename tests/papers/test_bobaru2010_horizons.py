"""Tables of a measure over horizons and nodes in the horizon: rates, increments, crossings."""

import numpy as np
import pytest

from farhorizon import InputError
from farhorizon.papers.bobaru2010 import Study, over_horizons


def test_the_table_has_every_horizon_and_ratio():
    found = over_horizons(lambda h, m: {"a": h * m, "b": h**2 / m}, [0.4, 0.2, 0.1], [2, 4], workers=2)
    assert found["a"].values == pytest.approx(np.outer([0.4, 0.2, 0.1], [2, 4]))
    assert found["b"].rates() == pytest.approx([2, 2])
    assert found["b"].rates(2) == pytest.approx([2, 2])
    assert found["a"].increments() == pytest.approx(np.array([[0.8], [0.4], [0.2]]))


def test_crossing():
    """Two lines in log m."""
    place = np.log([1.0, 2.0, 4.0])
    study = Study(np.array([2.0, 1.0]), np.array([1, 2, 4]), np.array([3 + 2 * (place - 1), 3 + (place - 1)]))
    at, value = study.crossing()
    assert (at, value) == pytest.approx((np.e, 3.0))
    assert np.isnan(Study(study.horizons, study.ratios, study.values + np.array([[9], [0]])).crossing()[0])


@pytest.mark.parametrize(("gap", "expected"), [([-1, 0, 2], 2.0), ([-2, -1, 0], 4.0), ([0, 1, 0], 1.0)])
def test_curves_that_meet_at_a_measured_ratio_cross_there(gap, expected):
    study = Study(np.array([2.0, 1.0]), np.array([1, 2, 4]), np.array([gap, np.zeros(3)]))
    assert study.crossing() == (expected, 0.0)


def test_rates_over_more_horizons_than_there_are_take_all():
    study = Study(np.array([4.0, 2.0, 1.0]), np.array([1]), np.array([[16.0], [4.0], [3.0]]))
    assert study.rates(5) == study.rates() != study.rates(2)


def test_bad_input():
    one = Study(np.array([2.0]), np.array([1, 2]), np.array([[1.0, -1.0]]))
    for asked in (one.rates, one.crossing):
        with pytest.raises(InputError, match="needs two horizons"):
            asked()
    with pytest.raises(InputError, match="positive horizons"):
        over_horizons(lambda h, m: {}, [0.0], [2])
    with pytest.raises(InputError, match="positive values"):
        Study(np.array([2.0, 1.0]), np.array([1]), np.array([[1.0], [-1.0]])).rates()
