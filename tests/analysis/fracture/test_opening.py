"""Openings of crack faces in known fields, and the stress intensities that follow from them."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.fracture.near_tip import NearTip
from farhorizon.analysis.fracture.opening import face_jumps, opening_intensity

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))


def test_intensities_of_a_known_field():
    """K_I and K_II of a crack at any angle. The fitted parabolas miss the curvature of the root, a relative error of
    (h/r)^2.
    """
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    medium, wanted = NearTip(1.2, 0.8), rng.uniform(0.5, 2.0, 2) * rng.choice([-1, 1], 2)
    turn, tip = rng.uniform(-np.pi, np.pi), rng.uniform(-0.2, 0.2, 2)
    ahead = np.array([np.cos(turn), np.sin(turn)])
    axes = np.array([ahead, [-ahead[1], ahead[0]]])
    lattice = fh.Lattice(0.125, (-5.0, -5.0), (5.0, 5.0))
    crack = fh.Polyline([tip - 4 * ahead, tip])
    x, y = np.moveaxis((np.stack(lattice.coordinates(), axis=-1) - tip) @ axes.T, -1, 0)
    fields = medium.fields(np.hypot(x, y).ravel(), np.arctan2(y, x).ravel())[0]
    u = (np.einsum("k,knc->nc", wanted, fields) @ axes).T.reshape(2, *lattice.shape)
    r = np.linspace(0.2, 3.0, 30)
    jumps = face_jumps(u, lattice, crack, 4 - r)
    exact = 8 / medium.stiffness * np.sqrt(r / (2 * np.pi))
    assert np.abs(jumps - np.multiply.outer(exact, wanted))[r > 0.5].max() < 0.01 * exact.max() * np.abs(wanted).max()
    for number in range(2):
        found = opening_intensity(r, jumps[:, number], medium.stiffness, (0.5, 2.0))
        assert found == pytest.approx(wanted[number], rel=0.02)


def test_scalar_fields_and_kinks():
    lattice, crack = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0)), fh.Polyline([(-3.0, 0.1), (0.0, 0.1), (3.0, 2.1)])
    x, y = lattice.coordinates()
    above = y > np.where(x < 0, 0.1, 0.1 + 2 * x / 3)
    jumps = face_jumps(above * (1.0 + x), lattice, crack, np.array([1.0, 3.0 + np.hypot(1.5, 1.0)]))
    assert jumps == pytest.approx([-1.0, 2.5])


def test_bad_input_is_refused():
    lattice, crack = fh.Lattice(0.5, (-4.0, -4.0), (4.0, 4.0)), fh.Polyline([(-3.0, 0.1), (3.0, 0.1)])
    with pytest.raises(fh.InputError, match="beyond the ends"):
        face_jumps(np.zeros(lattice.shape), lattice, crack, np.array([7.0]))
    with pytest.raises(fh.InputError, match="too few places"):
        opening_intensity(np.linspace(0, 1, 9), np.zeros(9), 1.0, (0.5, 0.6))
