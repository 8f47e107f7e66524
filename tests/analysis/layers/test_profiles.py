"""Profiles of layers, and the growth in them of modes that are evanescent in the medium."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.layers.chain_modes import chain_weights
from farhorizon.analysis.layers.profiles import Profile, largest_gain
from farhorizon.case.case import Case
from helpers import kernel_stencil


def test_sigma_rises_as_a_power_and_kappa_linearly():
    kappa, sigma, alpha = Profile(1.5, 4.0, 2).edges(3, 2.0, 0.5)
    assert sigma[-1] == pytest.approx(1.5 * 2 * 2.0 / 0.5 * (3.5 / 4) ** 2)
    assert kappa[0] == pytest.approx(1 + 3 * 0.5 / 4)
    assert (alpha > 0).all()


@pytest.mark.parametrize("options", [{"angle": 60}, {"angle": 0.0, "target": 1e-6}, {"wavelengths": (3.0, 20.0)}])
def test_whoever_asks_for_an_angle_is_told_what_to_give(options):
    with pytest.raises(fh.InputError, match=r"no longer chosen by angle.*target=\.\.\.") as refused:
        fh.LatticePML(**options)
    assert refused.value.key == f"boundary.{next(iter(options))}"
    text = """
        [lattice]
        spacing = 1.0
        lower = -5.0
        upper = 5.0
        [model]
        type = "wave"
        kernel = { horizon = 1.0 }
        [boundary]
        all = { type = "lattice-pml", angle = 60 }
        [run]
        until = 1.0
    """
    with pytest.raises(fh.InputError, match=r"boundary.all.*no longer chosen by angle.*target = \.\.\."):
        Case(text)


def edges(nodes, sigma):
    return np.ones(nodes + 1), sigma * np.ones(nodes + 1), np.zeros(nodes + 1)


def test_one_neighbour_has_no_mode_that_could_gain():
    """The only mode is the travelling wave."""
    assert largest_gain(fh.Stencil.finite_difference(1), *edges(10, 1.0)) == 0


def test_nothing_gains_without_a_stretch_nor_by_kappa():
    """A real stretch leaves tan(theta/2) on its side of the real axis."""
    stencil = kernel_stencil(1, 8, 1)
    assert largest_gain(stencil, *edges(10, 0.0)) == 0
    assert largest_gain(stencil, 3 * np.ones(11), np.zeros(11), np.zeros(11)) == 0


def test_uniform_layer_multiplies_by_the_continued_root():
    """A layer with n uniform edges gains n times the logarithm of the largest root after the stretch, computed root by
    root from the definition.
    """
    stencil, sigma, nodes = kernel_stencil(1, 6, 1), 0.4, 10
    top, largest = np.sqrt(stencil.symbol_maximum), 0.0
    for frequency in np.linspace(0.03, 0.6, 20) * top:  # the frequencies that the function examines
        chain = chain_weights(stencil, [])
        chain[6] += frequency**2
        for root in np.roots(chain):
            if abs(root) < 1 - 1e-7:
                w = (root - 1) / (root + 1)
                g = 1 + sigma / (1j * frequency)
                largest = max(largest, np.log(abs((1 + g * w) / (1 - g * w))))
    assert largest > 0
    assert largest_gain(stencil, *edges(nodes, sigma)) == pytest.approx((nodes + 1) * largest, rel=1e-9)


def test_a_shorter_entrance_lets_modes_gain_less():
    """With the same sum of sigma the gain falls with the power of the ramp."""
    stencil, depth = kernel_stencil(1, 12, 1), (np.arange(49) + 0.5) / 49
    gains = [largest_gain(stencil, np.ones(49), 5 * depth**p / (depth**p).sum(), np.full(49, 1e-3)) for p in (3, 6, 12)]
    assert gains[0] > 1.5 * gains[1] > 2 * gains[2] > 0


def test_vectors_gain_component_by_component():
    """A stencil of two uncoupled scalar fields, the second half as stiff, gains at least as much as either of them."""
    one = kernel_stencil(2, 5, 0)
    layer = (np.ones(21), np.linspace(0.0, 1.4, 21) ** 4, np.full(21, 1e-3))
    both = fh.Stencil(one.offsets, one.weights[:, None, None] * np.diag([1.0, 0.5]))
    alike = fh.Stencil(one.offsets, one.weights[:, None, None] * np.eye(2))
    assert largest_gain(alike, *layer) == pytest.approx(largest_gain(one, *layer), rel=1e-9)
    assert largest_gain(both, *layer) >= largest_gain(one, *layer) * (1 - 1e-9)
