"""Plane pulses of the lattice: the signal at the origin, and the equations of the lattice everywhere."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.references.pulse import PlanePulse

_DT, _SPACING, _COEFFICIENT = 0.2, 0.5, 1.7


def _signal(t):
    return np.sin(t) * np.exp(-(((t - 20) / 4) ** 2))


def _pulse(stencil, direction, polarisation):
    direction = np.array(direction) / np.linalg.norm(direction)
    across = None if polarisation is None else np.array(polarisation) / np.linalg.norm(polarisation)
    return direction, PlanePulse(stencil, _COEFFICIENT, _SPACING, _DT, direction, across, _signal, 40.0, 20.0)


_KERNEL = fh.Kernel(horizon=1.0, influence="linear", exponent=1)
_STENCILS = {
    "line": (fh.Stencil.from_kernel(_KERNEL, _SPACING, 1), (1.0,), None),
    "plane": (fh.Stencil.from_kernel(_KERNEL, _SPACING, 2), (1.0, 0.4), None),
    "P": (fh.Elastic(_KERNEL, young=1.0).stencil(_SPACING, 2), (1.0, 0.4), (1.0, 0.4)),
    "S": (fh.Elastic(_KERNEL, young=1.0).stencil(_SPACING, 2), (0.0, 1.0), (1.0, 0.0)),
    "S in space": (fh.Elastic(_KERNEL, young=1.0).stencil(_SPACING, 3), (1.0, 0.4, 0.3), (-0.4, 1.0, 0.0)),
}


@pytest.mark.parametrize("name", _STENCILS)
def test_the_equations_of_the_lattice(name):
    """``(u(t+dt) - 2 u(t) + u(t-dt)) / dt^2 = L u(t)`` at arbitrary nodes and times."""
    stencil, direction, polarisation = _STENCILS[name]
    direction, pulse = _pulse(stencil, direction, polarisation)
    nodes = np.random.default_rng(1).integers(0, 10, (15, stencil.dim))
    around = np.concatenate([nodes[None], nodes[None] + stencil.offsets[:, None]])
    values = pulse.at((_SPACING * around @ direction).ravel())
    seen = 0.0
    for t in (20.0, 23.4, 27.0):
        before, now, after = (v.reshape(-1, *around.shape[:2]) for v in map(values, (t - _DT, t, t + _DT)))
        weights = stencil.weights if stencil.components > 1 else stencil.weights[:, None, None]
        force = _COEFFICIENT / _SPACING**2 * np.einsum("kab,bkn->an", weights, now[:, 1:] - now[:, :1])
        seen = max(seen, np.abs(force).max())
        np.testing.assert_allclose((after - 2 * now + before)[:, 0] / _DT**2, force, atol=1e-11)
    assert seen > 0.3


@pytest.mark.parametrize("name", _STENCILS)
def test_the_signal_at_the_start(name):
    stencil, direction, polarisation = _STENCILS[name]
    direction, pulse = _pulse(stencil, direction, polarisation)
    values = pulse.at(np.zeros(1))
    times = _DT * np.arange(0, int(pulse.period / _DT), 7)
    found = np.array([values(t)[:, 0] for t in times])
    expected = np.where(times <= 40, _signal(times), 0.0)
    if polarisation is None:
        np.testing.assert_allclose(found[:, 0], expected, atol=1e-10)
    else:
        along = found @ np.array(polarisation) / np.linalg.norm(polarisation)
        np.testing.assert_allclose(along, expected, atol=1e-2)  # less the part that waves of the other type carry
        assert np.abs(along).max() > 0.5


def test_interpolation_in_space():
    """Many places are interpolated, a few of them are not."""
    stencil, direction, polarisation = _STENCILS["P"]
    _, pulse = _pulse(stencil, direction, polarisation)
    places = np.random.default_rng(2).uniform(0, 20, 5000)
    many, few = pulse.at(places)(25.0), pulse.at(places[:20])(25.0)
    np.testing.assert_allclose(many[..., :20], few, atol=1e-13)


def test_repeats_after_its_way():
    """At the end of the period the pulse has left the distance for which it was made."""
    stencil, direction, _ = _STENCILS["line"]
    _, pulse = _pulse(stencil, direction, None)
    places = np.linspace(0, 20, 50)
    assert pulse.period > 40 + 20 / pulse.speed
    assert np.abs(pulse.at(places)(pulse.period)).max() < 1e-9
    assert pulse.speed == pytest.approx(np.sqrt(_COEFFICIENT), rel=1e-4)
