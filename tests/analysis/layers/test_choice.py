"""The reflection of a layer in closed form, and its profiles."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.choice import Profile
from farhorizon.analysis.layers.layer import LatticeMedium, layer_amplitudes
from farhorizon.analysis.layers.spectrum import band, gain_of_time
from farhorizon.case.case import Case
from farhorizon.checks.side_modes import Strip, pinned


def medium_of(sim):
    recursion = Recursion.of(sim.model.integrator, sim.dt, sim.model.damping)
    return LatticeMedium(sim.stencil, sim.model.coefficient, sim.lattice.spacing, recursion, sim.dt)


def box(*nodes):
    return fh.Lattice(1.0, (0.0,) * len(nodes), [n - 1.0 for n in nodes])


@pytest.mark.sampled(2)
@pytest.mark.parametrize("dim, reach, exponent", [(1, 3, 0), (2, 1, 2), (2, 3, 2), (2, 4, 1), (3, 2, 2)])
def test_reflection_is_what_the_half_infinite_problem_gives(dim, reach, exponent):
    """Amplitudes of the travelling modes, against the engine's own map with all evanescent modes."""
    profile = {"kappa": np.linspace(1, 3, 9), "sigma": 0.9 * np.linspace(0.05, 1, 9), "alpha": 0.02}
    sim = fh.Simulation(
        box(*[2 * reach + 3] * dim),
        fh.Wave(fh.Kernel(float(reach), exponent), damping=0.01),
        boundary=fh.LatticePML(nodes=8, profile=profile),
    )
    strip = Strip(sim, 0, 2 * reach + 2, (fh.Fixed(), pinned(sim)[0, 1]))
    layer = next(iter(sim.engine.layers.values()))
    for wavelength, angle in ((7.0, 0.0), (11.0, 40.0), (30.0, 70.0)):
        wave = medium_of(sim).plane_wave(wavelength, angle if dim > 1 else 0.0)
        found = np.linalg.norm(layer_amplitudes(wave, layer)[wave.modes.travels])
        assert found == pytest.approx(abs(strip.reflection(wavelength, angle if dim > 1 else 0.0)), rel=1e-6, abs=1e-13)


def test_band_of_a_packet():
    """A wave of 12 nodes under an envelope: half of the energy lies near its wavelength, hardly any beyond half and
    twice the wavelength.
    """
    x = 0.5 * np.arange(400)
    found = band([np.exp(-((x - 100) ** 2) / 800) * np.cos(2 * np.pi * x / 6)], 0.5, [1])
    assert found.typical == pytest.approx(6.0, rel=0.02)
    assert 3 < found.shortest < 6 < found.longest < 12
    assert band([np.zeros(10)], 1.0, [0]) is None


def test_the_time_of_a_source_picks_its_waves():
    """A point source of one frequency radiates one wavelength, 2 pi speed / frequency, whatever its size."""
    point = np.exp(-((np.arange(200) - 100.0) ** 2) / 2)
    gain = gain_of_time(lambda t: np.sin(0.6 * t) * np.exp(-(((t - 100) / 30) ** 2)), 200.0, 2.0 / 0.5)
    found = band([point], 0.5, [0], [gain])
    assert found.typical == pytest.approx(2 * np.pi * 2.0 / 0.6, rel=0.05)
    assert found.longest < 1.5 * found.typical and found.shortest > 0.6 * found.typical


def test_profile_reads_as_it_is():
    kappa, sigma, alpha = Profile(1.5, 4.0, 2).edges(3, 2.0, 0.5)
    assert str(Profile(1.5, 1.0, 1, 0.5)) == "sigma linear to 1.5 2c/spacing, alpha rising by 0.5"
    assert str(Profile(1.5, 4.0, 2)) == "sigma square to 1.5 2c/spacing, kappa to 4"
    assert (
        sigma[-1] == pytest.approx(1.5 * 2 * 2.0 / 0.5 * (3.5 / 4) ** 2)
        and kappa[0] == pytest.approx(1 + 3 * 0.5 / 4)
        and (alpha > 0).all()
    )


@pytest.mark.parametrize("options", [{"angle": 60}, {"angle": 0.0, "target": 1e-6}, {"wavelengths": (3.0, 20.0)}])
def test_whoever_asks_for_an_angle_is_told_what_to_give(options):
    with pytest.raises(fh.InputError, match=r"no longer chosen by angle.*target=\.\.\.") as refused:
        fh.LatticePML(**options)
    assert refused.value.key == f"boundary.{next(iter(options))}"
    text = """
        [lattice]
        spacing = 1.0
        lower = -5.0
        upper = 5.0
        [model]
        type = "wave"
        kernel = { horizon = 1.0 }
        [boundary]
        all = { type = "lattice-pml", angle = 60 }
        [run]
        until = 1.0
    """
    with pytest.raises(fh.InputError, match=r"boundary.all.*no longer chosen by angle.*target = \.\.\."):
        Case(text)
