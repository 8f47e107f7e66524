"""Constants that scatter: their distribution, which is a function of place alone."""

import numpy as np
import pytest
from scipy import stats

import farhorizon as fh


@pytest.mark.parametrize("modulus", [1.0, 3.0, 12.0])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_values_have_the_distribution(dim, modulus):
    """Kolmogorov's test at a level of 0.1 % on 4096 cells; neighbouring cells are not correlated."""
    n = {1: 4096, 2: 64, 3: 16}[dim]
    at = np.meshgrid(*[0.25 * np.arange(n)] * dim, indexing="ij")
    values = fh.Weibull(2.0, modulus, 0.25, seed=11)(*at)
    assert stats.kstest(values.ravel(), stats.weibull_min(modulus, scale=2.0).cdf).pvalue > 1e-3
    assert stats.spearmanr(values[:-1].ravel(), values[1:].ravel()).pvalue > 1e-3


@pytest.mark.parametrize("shift", [0.0, 0.05, -0.35])
def test_a_cell_has_one_value_on_any_lattice(shift):
    """Nodes midway between the middles of two cells all belong to the same side."""
    field = fh.Weibull(1.0, 4, 0.1, seed=2)
    x = shift + 0.1 * np.arange(-500, 500)
    one = field(x)
    assert len(np.unique(one)) == len(x)
    np.testing.assert_array_equal(one, field(-50.0 + shift + 0.1 * np.arange(1000)))
    finer = field(shift + 0.1 * np.arange(-500, 500)[:, None] + 0.02 * np.arange(5) * (shift == 0))
    np.testing.assert_array_equal(finer[:, 0], one)
    assert field(0.0, 3.0) != field(3.0, 0.0) and field(0.04) == field(-0.04) != field(0.06)


def test_seeds_give_other_samples():
    x = np.arange(1000.0)
    one, two = (fh.Weibull(1.0, 2, 1.0, seed)(x) for seed in (0, 1))
    assert not np.isin(one, two).any()
    assert stats.spearmanr(one, two).pvalue > 1e-3


@pytest.mark.parametrize("given", [{"scale": 0.0}, {"modulus": -1.0}, {"cell": 0.0}, {"seed": -1}, {"seed": 0.5}])
def test_what_cannot_be(given):
    with pytest.raises(fh.InputError) as caught:
        fh.Weibull(**{"scale": 1.0, "modulus": 2.0, "cell": 1.0, **given})
    assert caught.value.key == next(iter(given))
