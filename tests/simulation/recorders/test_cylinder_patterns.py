"""Far-field patterns of soft and rigid cylinders hit by a plane wave, by direction, against the Hankel series."""

import numpy as np
import pytest
from scipy import special

import farhorizon as fh
from farhorizon.validation import cross_sections

_RADIUS, _FREQUENCY, _ORDERS = 2.0, 0.12, np.arange(-30, 31)
_K = 2 * np.pi * _FREQUENCY


def _factors(rigid):
    inner, outer = (special.jvp, special.h1vp) if rigid else (special.jv, special.hankel1)
    return -inner(_ORDERS, _K * _RADIUS) / outer(_ORDERS, _K * _RADIUS)


def _scattered(x, y, rigid):
    """Field that a cylinder scatters of exp(i k x), with the time dependence exp(-i omega t)."""
    r, turn = np.hypot(x, y), np.arctan2(y, x)
    waves = special.hankel1(_ORDERS, _K * r[..., None]) * np.exp(1j * _ORDERS * (turn[..., None] + np.pi / 2))
    return (waves * _factors(rigid)).sum(-1)


def _far(turns, rigid):
    """Asymptote of the scattered field at a distance of 1, without the phase of the propagation."""
    sums = (np.exp(1j * np.multiply.outer(turns, _ORDERS)) * _factors(rigid)).sum(-1)
    return np.sqrt(2 / (np.pi * _K)) * np.exp(-0.25j * np.pi) * sums


def _burst(t):
    return np.exp(-1j * _K * (t - 40.0) - ((t - 40.0) / 7.5) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("rigid", [False, True], ids=["soft", "rigid"])
def test_patterns_of_cylinders_converge_by_direction(rigid):
    """Forces on the rim radiate the field of the series outside it and none inside, so that no staircase is involved.
    The pattern recorded by a box around them converges to the series at second order, in amplitude and phase.
    """
    turns, errors, spacings = 2 * np.pi * np.arange(90) / 90, [], (0.5, 0.25, 0.125)
    exact = _far(turns, rigid)
    for spacing in spacings:
        lattice, model = fh.Lattice(spacing, (-7.0, -7.0), (7.0, 7.0)), fh.Wave(fh.Kernel(2 * spacing))
        x, y = lattice.coordinates()
        stencil = model.stencil(spacing, 2)
        outside = np.hypot(x, y) >= _RADIUS
        # outside the rim the series solves the lattice equation to second order: only bonds across it need forces
        near = (np.hypot(x, y) > _RADIUS - 4 * spacing) & (np.hypot(x, y) < _RADIUS + 4 * spacing)
        field = np.zeros(lattice.shape, complex)
        field[near] = _scattered(x[near], y[near], rigid)
        force = np.zeros(lattice.shape, complex)
        for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
            there = np.roll(outside, -offset, (0, 1)).astype(float)
            force -= weight * (there - outside) * np.roll(field, -offset, (0, 1))
        force *= model.coefficient / spacing**2 / model.source_factor

        sources = [fh.Source(force.real, lambda t: _burst(t).real), fh.Source(-force.imag, lambda t: _burst(t).imag)]
        far = fh.FarField(frequencies=[_FREQUENCY], history=False)
        sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=16), sources=sources, observe=[far])
        sim.run(160.0)
        times = sim.dt * np.arange(sim.step_count)
        spectrum = sim.dt * np.exp(1j * _K * times) @ _burst(times) / 2  # taking the real part of the source halves it
        found = far.pattern(90).amplitudes[0, 0].conj() / spectrum
        errors.append(np.abs(found - exact).max() / np.abs(exact).max())
    order = np.polyfit(np.log(spacings), np.log(errors), 1)[0]
    assert order == pytest.approx(2, abs=0.2), errors


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["soft", "rigid"])
def test_rims_that_are_staircases_converge_at_first_order(kind):
    """Differential cross sections of held nodes (soft) and of a hole (rigid), over all directions and frequencies."""
    errors, turns, orders = [], 2 * np.pi * np.arange(90) / 90, cross_sections.ORDERS
    k = 2 * np.pi * cross_sections.FREQUENCIES
    factors = np.array([cross_sections.cylinder(f, kind == "rigid") for f in cross_sections.FREQUENCIES])
    sums = (cross_sections.EVEN * factors) @ np.cos(np.outer(orders, turns))
    exact = 2 / (np.pi * k[:, None]) * np.abs(sums) ** 2
    for spacing in cross_sections.SPACINGS:
        found = cross_sections.run(kind, spacing).pattern(90).cross_sections[:, 0]
        errors.append(np.linalg.norm(found - exact) / np.linalg.norm(exact))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1, abs=0.3), errors
