"""Which waves of the data are significant at a side, against oscillators and the dispersion relation."""

import numpy as np
import pytest
from test_returned import SEED, medium, pulse

import farhorizon as fh
from farhorizon.analysis.layers.short_waves import high_pass, short_share
from farhorizon.analysis.layers.side_data import Datum, frequency_of_slow_waves, hold_backward_waves


@pytest.mark.parametrize("case", range(6))
def test_backward_waves_of_sources_are_as_large_as_oscillators_swing(case):
    """Waves of a source keep swinging after it has become steady. Compared with a source that is switched on at once,
    they are smaller by the same factor as oscillators of their frequencies.
    """
    random = np.random.default_rng([SEED, 4, case])
    model = fh.Wave(fh.Kernel(float(random.integers(3, 7)), int(random.integers(0, 2)), "constant"))
    front, dim = medium(model, 1 + case % 2, random.choice([0.3, 0.5, 0.8])), 1 + case % 2
    first, shape = 0.8 * high_pass(front.stencil).first, (25, 19)[:dim]  # where backward waves begin
    u = pulse(shape, [12.0, 9.0][:dim], random.uniform(0.8, 1.2))
    course = np.minimum(np.arange(1500) * front.dt / random.uniform(0.5, 60.0), 1.0)
    k = np.linspace(first, np.pi, 9)
    squared = front.rate * front.stencil.symbol(k, *[np.zeros_like(k)] * (dim - 1)) * front.dt**2

    def swing(forces):
        old = new = np.zeros_like(squared)
        seen = []
        for force in forces:
            old, new = new, 2 * new - old - squared * (new - force)
            seen.append(new)
        last = np.array(seen[-700:])
        return last.max(0) - last.min(0)

    less = float((swing(course) / swing(np.ones_like(course))).max())
    limit = short_share(u, first) * less / 0.3
    given = [Datum(u, "source", course)]
    assert hold_backward_waves(front, given, 0.8 * limit) and not hold_backward_waves(front, given, 1.25 * limit)


def test_frequencies_from_which_on_waves_are_slow():
    """By the slope of the discrete dispersion relation, on a finer sample of wavenumbers."""
    one, k = medium(fh.Wave(fh.Kernel(3.0, 1, "constant")), 2, 0.9), np.linspace(0, np.pi, 1201)
    turn = one.dt * np.sqrt(np.maximum(one.stencil.symbol(*np.ix_(k, k)), 0.0)) / 2
    omega = 2 / one.dt * np.arcsin(turn)
    speed = np.hypot(*np.gradient(omega, k, k))
    for most in (0.5, 0.2, 0.1):
        found = frequency_of_slow_waves(one, most)
        assert 0 < found < omega.max()
        assert speed[omega > found].max() < 1.05 * most
        assert speed[omega > 0.99 * found].max() > 0.95 * most
    assert frequency_of_slow_waves(one, 1.5) == 0
