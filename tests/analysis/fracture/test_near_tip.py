"""Singular fields of a crack tip: they are in equilibrium, leave the faces free, and are normalised to K = 1."""

import numpy as np
import pytest

from farhorizon.analysis.fracture.near_tip import NearTip

MEDIA = [NearTip(1.3, 0.7), NearTip(0.2, 1.9), NearTip(0.0, 0.8, antiplane=True)]


def at(medium, x, y):
    return medium.fields(np.hypot(x, y), np.arctan2(y, x))


@pytest.mark.parametrize("medium", MEDIA)
def test_gradient_is_that_of_the_field(medium):
    x, y = np.random.default_rng(1).uniform(0.2, 2.0, (2, 20)) * np.array([[-1.0], [1.0]])
    d = 1e-5
    _, gradient = at(medium, x, y)
    for axis, (dx, dy) in enumerate(((d, 0.0), (0.0, d))):
        slope = (at(medium, x + dx, y + dy)[0] - at(medium, x - dx, y - dy)[0]) / (2 * d)
        assert np.abs(slope - gradient[..., axis]).max() < 1e-8 * np.abs(gradient).max()


@pytest.mark.parametrize("medium", MEDIA)
def test_stress_is_in_balance_and_leaves_the_faces(medium):
    x, y = np.random.default_rng(2).uniform(-2.0, -0.5, (2, 20))
    d = 1e-5
    stress = [medium.stress(at(medium, x + dx, y + dy)[1]) for dx, dy in ((d, 0), (-d, 0), (0, d), (0, -d))]
    force = (stress[0] - stress[1])[..., 0] + (stress[2] - stress[3])[..., 1]
    assert np.abs(force / (2 * d)).max() < 1e-7 * np.abs(stress[0]).max()
    r = np.array([0.5, 2.0])
    for side in (-np.pi, np.pi):
        on_face = medium.stress(medium.fields(r, np.full(2, side))[1])[..., 1]
        assert np.abs(on_face).max() < 1e-14


@pytest.mark.parametrize("medium", MEDIA)
def test_unit_intensities(medium):
    """``sigma = K / sqrt(2 pi r)`` ahead of the tip, normal to the crack for mode I and along it for the others."""
    ahead = medium.stress(medium.fields(np.array([0.3]), np.zeros(1))[1])[:, 0, :, 1]
    wanted = np.eye(1) if medium.antiplane else np.array([[0.0, 1.0], [1.0, 0.0]])
    assert np.allclose(ahead, wanted / np.sqrt(2 * np.pi * 0.3), rtol=1e-14, atol=1e-14)


def test_stiffness_is_that_of_the_plane():
    young, nu = 2.0, 0.3
    shear, lame = young / (2 * (1 + nu)), young * nu / ((1 + nu) * (1 - 2 * nu))
    assert NearTip(lame, shear).stiffness == pytest.approx(young / (1 - nu**2))
    assert NearTip(2 * lame * shear / (lame + 2 * shear), shear).stiffness == pytest.approx(young)  # plane stress
    assert NearTip(0.0, shear, antiplane=True).release(np.array([3.0])) == pytest.approx(9 / (2 * shear))
