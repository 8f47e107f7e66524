"""The exact intensities of a crack whose body is hit at the edge, against a numerical solution of the same problem."""

import numpy as np
import pytest

from farhorizon.validation import crack_impact

MODULUS = LAME = 1.0  # Poisson's ratio 1/4: P waves have the slowness 1 / sqrt(3), S waves 1
P, S = 1 / np.sqrt(3), 1.0
OPENING = 2.0  # transform of the gap 2 t at s = 1


def halfline(count):
    """Nodes and weights from 0 to infinity."""
    angle = (np.arange(count) + 0.5) * np.pi / (2 * count)
    return np.tan(angle), np.pi / (2 * count) / np.cos(angle) ** 2


def uncracked(kappa):
    """Normal and shear stress along y = 0 of the solid without a crack, transformed in time, with s = 1, and along x.

    A gap that opens by D is the force ``-div (C D)``. The gap on the half-line is half of one on the whole line, whose
    P wave alone has normal stress there, plus half of one that changes its sign there, which alone has shear stress:
    Green's tensor of the solid, integrated over ky.
    """
    stiff = LAME + 2 * MODULUS
    normal = OPENING / 2 * LAME * (stiff * kappa**2 / (1 + stiff * kappa**2) - 1)
    (ky, step), kx = halfline(800), kappa[:, None]
    square, gap = kx**2 + ky**2, OPENING * 1j / ky
    force = -1j * kx * stiff * gap, -1j * ky * LAME * gap
    along = (kx * force[0] + ky * force[1]) / square
    long, cross = along / (1 + stiff * square), 1 / (1 + MODULUS * square)
    u = [k * long + (f - k * along) * cross for k, f in zip((kx, ky), force, strict=True)]
    return normal, MODULUS * 1j * (kx * u[1] + ky * u[0]) @ step / np.pi


def plus_factor(kappa, slowness):
    """``1 / (sqrt(1 + i kappa) N_+)`` for the stiffness of a half-plane, ``sqrt(1 + kappa^2) N``, whose logarithm is
    split by Cauchy's integral.
    """

    def logarithm(k):
        rayleigh = (S**2 + 2 * k**2) ** 2 - 4 * k**2 * np.sqrt((P**2 + k**2) * (S**2 + k**2))
        return np.log(rayleigh / (2 * (S**2 - P**2) * np.sqrt((slowness**2 + k**2) * (1 + k**2))))

    (other, step), k = halfline(1001), kappa[:, None]
    phase = kappa / np.pi * ((logarithm(other) - logarithm(k)) / (other**2 - k**2) @ step)
    return 1 / (np.sqrt(1 + 1j * kappa) * np.exp(logarithm(kappa) / 2 + 1j * phase))


def test_intensities_of_an_impact_are_those_of_wiener_and_hopf_by_numbers():
    """Both at s = 1. In kappa the stress at the end of the gap, which is sharp in space, does not decay: it is
    smoothed over 0.02 of the length, which changes K by the square of that.
    """
    step, smooth = 0.15, 0.02
    kappa = np.arange(step / 2, 5 / smooth, step)
    share = np.exp(1j * kappa * crack_impact.LENGTH - (kappa * smooth) ** 2 / 2) * step * np.sqrt(2) / np.pi
    wanted = [
        (plus_factor(kappa, slowness) * stress * share).sum().real
        for slowness, stress in zip((P, S), uncracked(kappa), strict=True)
    ]
    nodes, weights = np.polynomial.legendre.leggauss(300)
    first, last = P * crack_impact.LENGTH, 20.0
    t = first + (last - first) * (nodes + 1) / 2
    found = crack_impact.step_intensities(t) @ (weights * np.exp(-t)) * (last - first) / 2
    np.testing.assert_allclose(found, wanted, rtol=2e-3)


def test_the_gap_opens_as_the_edge_moves():
    t = np.linspace(0.0, 2 * crack_impact.RISE, 4001)
    velocity = np.gradient([crack_impact.gap(x) for x in t], t) / 2
    assert velocity[-1] == pytest.approx(1.0)
    rate = np.gradient(velocity, t)
    wanted = np.where(t < crack_impact.RISE, (1 - np.cos(2 * np.pi * t / crack_impact.RISE)) / crack_impact.RISE, 0.0)
    np.testing.assert_allclose(rate, wanted, atol=2e-2)
