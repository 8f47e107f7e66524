"""The exact motion of the surface of a half-space, against independent derivations."""

import numpy as np
import pytest
from scipy.special import j0

from farhorizon.inputs.signals import Step
from farhorizon.validation import surface_motion

SPEEDS, DENSITY = (np.sqrt(3), 1.0), 1.3


def by_frequencies(x, until, speeds, density):
    """Times, and displacement of the surface by a sum over complex frequencies s and, by the midpoint rule, over
    wavenumbers k.

    A P wave with the potential A exp(ikx + nu z) from below is reflected by a free surface so that the surface moves
    with 4ik nu eta A s^2 / (beta^2 R) and 2 nu (k^2 + eta^2) A s^2 / (beta^2 R) (Achenbach, 1973, section 5.6).
    """
    alpha, beta = speeds
    length, count = 3 * until, 256
    t = np.arange(count) * length / count
    shift = 12 / length  # the rate at which the periodic copies of the sum decay
    moment = np.fft.rfft(Step(surface_motion.RISE)(t) * np.exp(-shift * t))
    s = (shift + 2j * np.pi * np.arange(count // 2 + 1) / length)[:, None]
    highest, n = 60.0, 4000
    k = (np.arange(n) + 0.5) * highest / n
    nu, eta = np.sqrt(k**2 + (s / alpha) ** 2), np.sqrt(k**2 + (s / beta) ** 2)
    bend = k**2 + eta**2
    potential = -np.exp(-nu * surface_motion.DEPTH) / (4 * np.pi * density * alpha**2 * nu)
    share = nu * potential * (s / beta) ** 2 / (bend**2 - 4 * k**2 * eta * nu) * 2 * highest / n
    along = (4j * k * eta * share * 1j * np.sin(k * x)).sum(1)
    up = (2 * bend * share * np.cos(k * x)).sum(1)
    histories = [np.fft.irfft(u * moment, count) * np.exp(shift * t) for u in (along, -up)]
    return t[t < until], np.array(histories)[:, t < until]


@pytest.mark.parametrize("x", [0.0, 1.0, 3.0])
def test_a_buried_blast_moves_the_surface_as_the_sum_of_its_plane_waves(x):
    times, wanted = by_frequencies(x, 7.0, SPEEDS, DENSITY)
    found = surface_motion.buried_blast(x, times, SPEEDS, DENSITY)
    # the sum lacks frequencies above those of its time step, a twelfth of the rise: one in a thousand
    np.testing.assert_allclose(found, wanted, atol=1e-3 * np.abs(found).max())


def test_a_buried_blast_leaves_the_static_field_that_a_free_surface_multiplies_by_4_less_4_nu():
    x, (alpha, _) = 1.5, SPEEDS
    towards = np.array([x, surface_motion.DEPTH]) / (x**2 + surface_motion.DEPTH**2)
    found = surface_motion.buried_blast(x, np.array([2000.0]), SPEEDS, DENSITY)[:, 0]
    np.testing.assert_allclose(found, 3 * towards / (2 * np.pi * DENSITY * alpha**2), rtol=1e-5)


def test_nothing_moves_before_the_p_wave_comes():
    assert not surface_motion.buried_blast(2.0, np.array([0.0, 1.29]), SPEEDS, DENSITY).any()


def test_a_pressed_surface_moves_as_the_sum_of_its_hankel_transforms():
    """Both transformed in time, at s = 1. In a cylindrical wave J0(kr) a pressure p moves the surface by ``p nu s^2 /
    (mu beta^2 R)`` (Achenbach, 1973, section 7.5), in short waves by the static ``3 p / (4 mu k)``.
    """
    r, rise = 1.3, surface_motion.RISE
    k = (np.arange(60000) + 0.5) * 0.005
    nu, eta = np.sqrt(k**2 + 1 / 3), np.sqrt(k**2 + 1)
    move = k * nu / ((k**2 + eta**2) ** 2 - 4 * k**2 * nu * eta) - 0.75
    step = (0.75 / r + (move * j0(k * r)).sum() * 0.005) / (2 * np.pi)
    wanted = step * (1 - np.exp(-rise)) / rise * (1 - 1 / (1 + (2 * np.pi / rise) ** 2))
    last = surface_motion.RAYLEIGH * r + rise
    t = (np.arange(4000) + 0.5) * last / 4000
    found = (surface_motion.pressed(r, t) * np.exp(-t)).sum() * last / 4000 + 3 / (8 * np.pi * r) * np.exp(-last)
    assert found == pytest.approx(wanted, rel=1e-4)


def test_a_pressed_surface_is_still_before_the_p_wave_and_static_after_the_rayleigh_wave():
    r, late = 1.3, surface_motion.RAYLEIGH * 1.3 + surface_motion.RISE
    assert not surface_motion.pressed(r, np.array([0.0, 0.74])).any()
    np.testing.assert_allclose(surface_motion.pressed(r, np.array([late, 9.0])), 3 / (8 * np.pi * r), rtol=1e-9)
