"""The exact solution for a crack running through the square lattice, against limits, published formulas and a plain
program.
"""

import numpy as np
import pytest
from scipy.integrate import quad

from farhorizon.validation import lattice_fracture as lf
from helpers import fitted_rate


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.5, 0.8])
def test_load_against_speed_is_the_integral_of_slepyan(speed):
    """exp((2/pi) times the integral of arg L over k), for L with a small damping; without damping its argument is
    known piecewise.
    """
    damping = 1e-7

    def argument(k):
        square = 4 * np.sin(k / 2) ** 2 + (damping + 1j * speed * k) ** 2
        return np.angle(np.sqrt(square + 4) / np.sqrt(square))

    k = np.linspace(1e-4, 3 / speed, 400001)
    integral = np.sum((argument(k[1:]) / k[1:] + argument(k[:-1]) / k[:-1]) * np.diff(k)) / 2
    # each edge of a piece is known to a step of 3e-5 / v
    assert lf.ratio(speed) == pytest.approx(np.exp(2 / np.pi * integral), rel=2e-3)


def test_limits_of_load_against_speed():
    """A crack that hardly moves is like one that begins to: ``sqrt(2) - 1`` (Slepyan). Near the speed of waves all
    energy is radiated, and some energy always is.
    """
    slow = np.mean([lf.ratio(v) for v in np.geomspace(0.004, 0.008, 40)])
    assert slow == pytest.approx(np.sqrt(2) - 1, abs=0.005)  # the ripples of the curve fall in proportion to the speed
    near = np.array([0.99, 0.999, 0.9999])
    falling = np.array([lf.ratio(v) for v in near])
    assert (np.diff(falling) < 0).all() and falling[-1] < 0.1
    speeds = np.linspace(0.03, 0.99, 97)
    assert all(0 < lf.ratio(v) < 1 for v in speeds)


def test_short_steps_are_continuous_time():
    """The error is of second order in the step."""
    steps = np.array([10, 20, 40])
    errors = [abs(lf.ratio_of_steps(0.5, n) - lf.ratio(0.5)) for n in steps]
    assert fitted_rate(1 / steps, errors) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("speed", [0.4, 0.6])
def test_a_load_far_behind_is_that_of_the_continuum(speed):
    """The difference falls with the square of the distance."""
    steps, errors, distances = 6, [], np.array([10.0, 20.0, 40.0])
    for distance in distances:
        load = lf.load(np.arange(int(7 * distance) * steps) / steps, distance)
        behind, ahead = lf.history(speed, steps, load, 2)
        found = 2 * behind[0] * ahead[0] / lf.release_rate(speed, distance)
        errors.append(abs(found / lf.ratio_of_steps(speed, steps) - 1))
    assert errors[0] < 1e-3
    assert fitted_rate(1 / distances, errors) > 1.7


def test_the_load_has_the_moments_that_are_said():
    """Integrals of the load over the distance to the powers 1/2 and 3/2, by quadrature."""
    moments = [quad(lambda s, p=p: float(lf.load(np.array(s))) * s**-p, 0, 70.0, limit=200)[0] for p in (0.5, 1.5)]
    assert lf.release_rate(0.6) == pytest.approx(moments[0] ** 2 / (np.pi * 0.8), rel=1e-5)  # the load ends at 1e-6
    assert abs(moments[1]) < 1e-5 * moments[0]


@pytest.mark.parametrize(("speed", "steps"), [(0.5, 4), (0.7, 5)])
def test_a_plain_program_comes_to_the_exact_history(speed, steps):
    """Row 0 in a lattice so large that nothing returns to the tip before the end; the rows below are the mirror image
    with the opposite sign.

    The load rises slowly over 40 and is near the tip: the load 30 behind, 1e-10 of the largest, reaches the tip 30/(1
    - v) later.
    """
    dt, until = 1 / (speed * steps), 40 + 30 / (1 - speed)
    bonds, high = int(speed * until), int(until / 2) + 5
    left = high
    x = np.arange(-left, bonds + high)

    def load(behind):
        s = np.maximum(behind, 0.0) / 3
        return s**3 * np.exp(-3 * s)

    u = np.zeros((x.size, high))
    older = u.copy()
    rows = []
    for n in range(bonds * steps + 1):
        rows.append(u[:, 0].copy())
        pull = -4 * u
        pull[1:] += u[:-1]
        pull[:-1] += u[1:]
        pull[:, 1:] += u[:, :-1]
        pull[:, :-1] += u[:, 1:]
        intact = x * steps > n
        pull[:, 0] += np.where(intact, -u[:, 0], u[:, 0])  # row -1 is at -u, or there is no bond
        rise = np.sin(np.pi / 2 * min(n * dt / 40, 1.0)) ** 4
        pull[:, 0] += load(n / steps - x) * rise
        u, older = 2 * u - older + dt**2 * pull, u
    behind, ahead = lf.history(speed, steps, load(np.arange(60 * steps) / steps), 3 * steps)
    wanted = np.concatenate([ahead[::-1], behind[: 2 * steps]])
    place = bonds - 2
    found = np.array(rows)[(place - 3) * steps : (place + 2) * steps, place + left]
    assert np.abs(found - wanted).max() < 1e-4 * wanted.max()  # short waves of the start leave slowly
