"""Images by records that are sent back."""

from dataclasses import replace

import numpy as np
import pytest

import farhorizon as fh

LATTICE = fh.Lattice(1.0, (-15.0, -15.0), (15.0, 15.0))
RING = [(12.0 * np.cos(a), 12.0 * np.sin(a)) for a in 2 * np.pi * np.arange(24) / 24]
STEPS, DT = 120, 0.45


def line():
    return fh.Receivers(RING, interpolation="linear")


def plate(**options):
    return fh.Setup(LATTICE, fh.Wave(fh.Kernel(2.0)), fh.LatticePML(nodes=8), dt=DT, **options)


def recorded(setup):
    seen = line()
    fh.Simulation.of(setup, observe=[seen]).step(STEPS)
    return seen.data["u"]


def test_a_reflector_is_brightest_in_its_place():
    """A heavy spot of two nodes at (4, -3), known from what it scatters."""
    heavy = np.ones(LATTICE.shape)
    heavy[19:21, 12] = 1.4
    shots = []
    for angle in (0.3, 1.9, 3.4, 5.0):
        at = (13.0 * np.cos(angle), 13.0 * np.sin(angle))
        known = plate(sources=[fh.PointSource(at, time=fh.Ricker(0.1), interpolation="linear")])
        there = replace(known, model=fh.Wave(fh.Kernel(2.0), density=heavy))
        shots.append((known, fh.LeastSquares(line(), recorded(there))))
    found = fh.image(shots, STEPS * DT, region=fh.Disc(radius=10.0))
    place = np.unravel_index(np.abs(found).argmax(), found.shape)
    assert place in [(19, 12), (20, 12)]
    assert found[place] < 0  # more density would reduce the misfit


@pytest.mark.parametrize("model", [fh.Wave(fh.Kernel(2.0)), fh.Elastic(fh.Kernel(2.0), 1.0)])
def test_waves_return_to_their_source(model):
    force = fh.PointSource if isinstance(model, fh.Wave) else fh.PointForce
    size = {} if isinstance(model, fh.Wave) else {"force": (1.0, 0.5)}
    at = (-4.0, 2.0)
    still = replace(plate(), model=model)
    data = recorded(replace(still, sources=[force(at, time=fh.Ricker(0.1), **size)]))
    found = fh.image([(still, fh.LeastSquares(line(), data))], STEPS * DT, show="sources")
    place = np.array(np.unravel_index(found.argmax(), found.shape)) - 15
    assert np.abs(place - at).max() <= 1


def test_refused():
    nothing = fh.LeastSquares(line(), np.zeros((STEPS + 1, len(RING))))
    with pytest.raises(fh.InputError, match="unknown image"):
        fh.image([(plate(), nothing)], STEPS * DT, show="all")
    with pytest.raises(fh.InputError, match="density"):
        fh.image([(replace(plate(), model=fh.Diffusion(fh.Kernel(2.0))), nothing)], STEPS * DT)
    with pytest.raises(fh.InputError, match="no shot"):
        fh.image([], 1.0)
