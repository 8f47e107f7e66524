"""A source signal defined by users: the one of docs/extending.md."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate, special

import farhorizon as fh
from farhorizon.files.storable import Storable

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")


@pytest.fixture
def module():
    """Names that the page defines."""
    found = {}
    exec(re.search(r"```python\n([^`]*def ricker.*?)```", PAGE, re.S).group(1), found)
    return found


def exact(x, t, ricker):
    """Return u of ``u_tt = u_xx + exp(-x^2) ricker(t)``, from rest: half the integral over the domain of dependence."""

    def over_the_cone(s):
        reach = t - s
        return ricker(s) * 0.5 * (bell(x + reach) - bell(x - reach))

    def bell(y):

        return np.sqrt(np.pi) / 2 * special.erf(y)

    return integrate.quad(over_the_cone, 0.0, t, limit=200)[0]


def test_its_wave_is_that_of_the_exact_solution(module):
    """The error is of second order in the spacing, with a time step in proportion to it."""
    errors = []
    for spacing in (0.5, 0.25, 0.125):
        lattice = fh.Lattice(spacing, -12.0, 12.0)
        model = fh.Wave(fh.Stencil.finite_difference(1))
        sim = fh.Simulation(lattice, model, fh.Exact(), sources=[module["source"]], dt=0.5 * spacing, threads=1)
        sim.run(until=24.0)
        places = (0.0, 5.0, -9.0)
        found = [float(sim.fields["u"][lattice.index(x)]) for x in places]
        known = [exact(x, sim.time, module["ricker"]) for x in places]
        errors.append(np.abs(np.subtract(found, known)).max() / np.abs(known).max())
    slope = np.polyfit(np.log([0.5, 0.25, 0.125]), np.log(errors), 1)[0]
    assert slope > 1.9 and errors[-1] < 0.01, errors


def test_samples_are_a_signal(module):
    """A function that interpolates measured samples acts as the function itself does."""
    times = np.linspace(0.0, 40.0, 4001)
    samples = module["ricker"](times)
    runs = []
    for signal in (module["ricker"], lambda t: float(np.interp(t, times, samples))):
        source = fh.Source("exp(-x**2)", time=signal)
        lattice, model = fh.Lattice(0.5, -12.0, 12.0), fh.Wave(fh.Kernel(1.0))
        sim = fh.Simulation(lattice, model, fh.Exact(), sources=[source], threads=1)
        runs.append(sim.run(until=20.0).fields["u"])
    assert np.abs(runs[0] - runs[1]).max() < 1e-4 * np.abs(runs[0]).max()


def test_a_class_is_known_to_case_files_and_checkpoints(tmp_path):
    """The class is found by its name; its highest frequency follows from its spectrum."""

    @dataclass(frozen=True)
    class Sech(fh.Signal):
        """A hyperbolic secant.

        Parameters
        ----------
        width : float
            Time in which it falls.
        """

        width: float

        @property
        def end(self):
            return 40 * self.width

        def __call__(self, t):
            return 1 / np.cosh((np.asarray(t) - 20 * self.width) / self.width)

        def spectrum(self, frequency):
            f = np.asarray(frequency)
            size = np.pi * self.width / np.cosh(np.pi**2 * self.width * f)
            return size * np.exp(-40j * np.pi * f * self.width)

    try:
        text = """
        lattice = { spacing = 1.0, lower = [-9.0], upper = [9.0] }
        model = { type = "wave", stencil = "finite-difference" }
        boundary = { all = { type = "exact" } }
        source = [{ value = "exp(-x**2)", time = { type = "sech", width = 2.0 } }]
        run = { until = 50.0 }
        """
        (tmp_path / "case.toml").write_text(text)
        sim = fh.read_case(tmp_path / "case.toml").simulation()
        signal = sim.setup.sources[0].time
        assert signal == Sech(2.0)
        # 2 / pi times the integral of sech(x) from pi^2 w F on is a thousandth: exp(-x) = pi / 4000
        assert signal.highest_frequency == pytest.approx(np.log(4000 / np.pi) / (np.pi**2 * 2.0), rel=0.02)
        sim.run(20.0)
        sim.save(tmp_path / "checkpoint.h5")
        assert fh.Simulation.restore(tmp_path / "checkpoint.h5").setup.sources[0].time == signal
    finally:
        del fh.Signal.known["Sech"], Storable.stored_as["Sech"]
