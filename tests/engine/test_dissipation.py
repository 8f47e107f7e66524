"""What relaxation dissipates: the energy of lossy media is conserved together with it."""

import numpy as np
import pytest
from tests.helpers import fitted_rate

import farhorizon as fh

UNEVEN = "1 + 0.5*(x > 1)"
LOSSY = fh.Attenuation(8.0, (0.02, 0.2))
PLANE = fh.Lattice(0.5, (-4.0, -3.0), (4.0, 3.5))
SIDES = {"periodic": fh.Periodic(), "free and fixed": {"x": fh.Free(), "y-": fh.Fixed(), "y+": fh.Free()}}
MODELS = {
    "wave": fh.Wave(fh.Kernel(1.5), attenuation=LOSSY),
    "states": fh.Elastic(fh.Kernel(1.5), 1.0, 0.3, density=UNEVEN, material="state-based", attenuation=LOSSY),
}


def drift(model, sides, dt, **more):
    """Largest change of the sum of all energies, over the first one, and the last energies."""
    bump = "exp(-(x**2 + y**2)/2)"
    initial = {"u": [bump, "0"] if model.mechanical else bump}
    sim = fh.Simulation(PLANE, model, sides, initial, dt=dt, threads=1, balance=True, **more)
    sums = []
    for _ in range(20):
        now = sim.energies()
        sums.append(now["kinetic"] + now["strain"] + now["dissipated"] - now["work"])
        sim.run(sim.time + 0.8)
    assert now["dissipated"] > 0.5 * sums[0] and now["strain"] > 0
    return np.ptp(sums) / sums[0]


@pytest.mark.parametrize("sides", SIDES.values(), ids=SIDES)
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_all_energies_together_are_conserved(model, sides):
    """To the square of the step."""
    steps = np.array([0.2, 0.1, 0.05])
    errors = [drift(model, sides, dt) for dt in steps]
    assert abs(fitted_rate(steps, errors) - 2) < 0.2, errors
    assert errors[-1] < 1e-3


def test_the_work_of_sources_is_found_again():
    """In the balance, what is lost is the error of the step."""
    errors = []
    for dt in (0.1, 0.05):
        source = fh.Source("exp(-x**2 - y**2)", "sin(t)**2*(t < 6.283185307179586)")
        sim = fh.Simulation(PLANE, MODELS["wave"], fh.Periodic(), {}, sources=[source], dt=dt, threads=1, balance=True)
        found = sim.run(12.0).balance()
        assert found["work"] > 0 and found["dissipated"] > 0.3 * found["work"]
        errors.append(abs(found["lost"]) / found["work"])
    assert errors[1] < 0.3 * errors[0] < 0.01
