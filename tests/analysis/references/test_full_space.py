"""Displacements of point sources, against the equation of motion, each other and the static solution."""

import os

import numpy as np
import pytest

from farhorizon import Ricker, Step
from farhorizon.analysis.references.full_space import FullSpace, scalar_wave_in_the_plane

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))
ROCK = FullSpace(p_speed=1.9, s_speed=1.1, density=2.3)
LAME, SHEAR = ROCK.density * (ROCK.p_speed**2 - 2 * ROCK.s_speed**2), ROCK.density * ROCK.s_speed**2


@pytest.fixture
def drawn():
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    moment = rng.standard_normal((3, 3))
    at = rng.standard_normal(3)  # far enough from the source for differences over a few steps to be accurate
    return at * rng.uniform(1.5, 3.0) / np.linalg.norm(at), rng.standard_normal(3), moment + moment.T


def differences(function, at, step):
    """First and second derivatives of a function of position by fourth-order central differences, (3, ...) and (3, 3,
    ...).
    """
    weights = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
    unit = step * np.eye(3)
    first = [sum(w * function(at + n * u) for n, w in weights.items()) / step for u in unit]
    second = [
        [
            sum(v * w * function(at + n * u + m * e) for n, v in weights.items() for m, w in weights.items()) / step**2
            for u in unit
        ]
        for e in unit
    ]
    return np.array(first), np.array(second)


def test_a_force_solves_the_equation_of_motion(drawn):
    """``rho u_tt = (lam + mu) grad div u + mu laplace u`` away from it."""
    at, force, _ = drawn
    times, signal, step = np.linspace(1.0, 8.0, 15), Ricker(0.5), 0.02
    _, second = differences(lambda x: ROCK.of_force(x, times, force, signal), at, step)
    stress = (LAME + SHEAR) * np.einsum("ijjn->in", second) + SHEAR * np.einsum("jjin->in", second)
    u = [ROCK.of_force(at, times + n * step, force, signal) for n in (-2, -1, 0, 1, 2)]
    inertia = ROCK.density * (-u[0] + 16 * u[1] - 30 * u[2] + 16 * u[3] - u[4]) / (12 * step**2)
    assert np.abs(stress - inertia).max() < 1e-4 * np.abs(inertia).max()  # (w step)^4 / 90


def test_a_moment_tensor_is_the_derivative_of_forces(drawn):
    """``u_n = -M_pq d/dx_q G_np``."""
    at, _, moment = drawn
    times, signal = np.linspace(0.5, 9.0, 30), Ricker(0.5)
    found = ROCK.of_moment(at, times, moment, signal, scale=1.0)
    known = np.zeros_like(found)
    for p, force in enumerate(np.eye(3)):
        first, _ = differences(lambda x, force=force: ROCK.of_force(x, times, force, signal), at, 0.01)
        known -= np.einsum("q,qin->in", moment[p], first)
    assert np.abs(found - known).max() < 1e-6 * np.abs(known).max()


def test_what_stays_is_the_solution_of_kelvin(drawn):
    """``u = ((3 - 4 nu) F + g (g.F)) / (16 pi mu (1 - nu) r)``; for an explosion ``M g / (4 pi rho alpha^2 r^2)``."""
    at, force, _ = drawn
    r = np.linalg.norm(at)
    g, nu = at / r, LAME / (2 * (LAME + SHEAR))
    kelvin = ((3 - 4 * nu) * force + g * (g @ force)) / (16 * np.pi * SHEAR * (1 - nu) * r)
    late, load = np.array([50.0]), Step(1.0)
    np.testing.assert_allclose(ROCK.of_force(at, late, force, load)[:, 0], kelvin, rtol=1e-12)
    spread = g / (4 * np.pi * ROCK.density * ROCK.p_speed**2 * r**2)
    np.testing.assert_allclose(ROCK.of_moment(at, late, np.eye(3), load, 1.0)[:, 0], spread, rtol=1e-12)


def test_a_wave_in_the_plane_is_that_of_a_line_in_space():
    """The sum of spherical waves ``s(t - r/c) / (4 pi c^2 r)`` over a line."""
    speed, distance, signal = 1.4, 2.0, Ricker(0.6)
    times = np.linspace(0.0, 12.0, 40)
    found = scalar_wave_in_the_plane(distance, times, signal, speed)
    z, step = np.linspace(-30.0, 30.0, 60_001, retstep=True)
    r = np.hypot(distance, z)
    known = [(signal(t - r / speed) / (4 * np.pi * speed**2 * r)).sum() * step for t in times]
    assert np.abs(found - known).max() < 1e-6 * np.abs(found).max()
