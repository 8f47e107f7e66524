"""Representative waves and their reflections, against the exact reflections of the individual waves."""

import numpy as np
import pytest
from test_returned import medium, rising

import farhorizon as fh
from farhorizon.analysis.layers import samples
from farhorizon.analysis.layers.layer import LatticeMedium, layer_amplitudes
from farhorizon.analysis.layers.samples import Sample, reflected


@pytest.mark.parametrize("angle", [0.0, 40.0, 75.0])
def test_reflection_is_the_exact_one_of_a_single_mode(angle):
    front = medium(fh.Wave(fh.Stencil.finite_difference(2), 1.0), 2)
    wave, layer = front.plane_wave(9.0, angle), rising(6)
    found = reflected(np.array([wave.modes.incoming]), np.array([wave.s]), layer)
    # with a reach of one node a wave returns as one mode and passes the last edge once: the exact reflection passes
    # each edge twice but the end
    assert abs(found[0]) == pytest.approx(np.abs(layer_amplitudes(wave, layer)[wave.modes.travels]).max(), rel=1e-9)


def test_modes_of_one_frequency_and_wavenumber_are_found_once(monkeypatch):
    """Both incoming waves of a solid are picked from the same modes, and judged together as individually."""
    front = medium(fh.Elastic(fh.Kernel(2.0), 1.0, 0.3, material="state-based"), 2)
    calls, every = [], LatticeMedium.waves
    swings, along = front.plane_wave(30.0, 10.0, number=1), np.array([2 * np.pi / 30 * np.sin(np.radians(10.0))])
    near = [np.exp(1j * number) for number in (0.08, 0.2)]
    shapes = np.array([[1.0, 0.0], [0.0, 1.0]])
    alone = [front.wave(along, swings.factor, *one) for one in zip(near, shapes, strict=True)]
    monkeypatch.setattr(LatticeMedium, "waves", lambda *given: calls.append(given) or every(*given))
    sample, layer = Sample(front), rising(6)
    waves = [sample.wave(root, swings.factor, along, shape) for root, shape in zip(near, shapes, strict=True)]
    assert len(calls) == 1 and waves[0].modes.incoming != waves[1].modes.incoming
    for wave, one in zip(waves, alone, strict=True):
        assert wave.modes.incoming == one.modes.incoming and np.array_equal(wave.modes.vector, one.modes.vector)
    together = samples._judged(waves, layer)
    assert together == pytest.approx(np.hstack([samples._judged([wave], layer) for wave in waves]), rel=1e-9)
