"""The reflection of a layer from its own equations, against the engine's complete map."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.layer import LatticeMedium, LayerSide, amplitudes_of, layer_amplitudes
from farhorizon.checks.side_modes import Strip, pinned
from farhorizon.studies.compare import compare

SCALAR = [(1, fh.Kernel(3.0, 0)), (2, fh.Kernel(3.0, 1)), (2, fh.Stencil.finite_element(2)), (3, fh.Kernel(2.0))]
VECTORS = [
    (2, fh.Elastic(fh.Kernel(3.0, 1), young=1.0)),
    (2, fh.Elastic(fh.Kernel(2.0, 1), young=1.0, poisson=0.3, material="state-based")),
    (2, fh.Elastic(young=1.0, poisson=0.3, material="finite-element")),
    # the waves themselves are damped
    (2, fh.Elastic(fh.Kernel(1.5, 0, "gaussian", volume="full"), young=1.0, poisson=0.25, material="correspondence")),
    (3, fh.Elastic(fh.Kernel(1.0, 1), young=1.0)),
]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("dim, model", [(dim, fh.Wave(operator, damping=0.01)) for dim, operator in SCALAR] + VECTORS)
def test_the_layers_equations_are_what_the_engine_steps(dim, model):
    """Reflections between all types of waves, with damped short waves included."""
    reach = max(model.stencil(1.0, dim).reach)
    lattice = fh.Lattice(1.0, (0.0,) * dim, (2.0 * reach + 2,) * dim)
    sim = fh.Simulation(lattice, model, boundary=fh.LatticePML(nodes=9))
    layer = sim.engine.layers[3 - dim, 1]
    assert layer.damping.max() > 0
    strip = Strip(sim, 0, 2 * reach + 2, (fh.Fixed(), pinned(sim)[0, 1]))
    side = LayerSide(strip.medium, layer)
    for wavelength, angle in ((9.0, 0.0), (14.0, 35.0), (40.0, 75.0)):
        if dim == 1 and angle:
            continue
        for incoming in side.types:
            given, azimuth = (wavelength, angle), 30.0 if dim == 3 else 0.0
            expected = strip.reflections(*given, azimuth, incoming=incoming)
            found = side.reflections(*given, azimuth, incoming=incoming)
            assert found.keys() == expected.keys()
            assert all(abs(found[k] - expected[k]) <= 1e-6 * abs(expected[k]) + 1e-12 for k in expected), (
                incoming,
                found,
                expected,
            )


@pytest.mark.parametrize("dim, reach", [(1, 1), (1, 3), (2, 2)])
def test_what_comes_back_of_a_diffusion_wave(dim, reach):
    """A source of one frequency in front of a layer: the engine's operator with the layer against the infinite lattice
    by FFT.
    """
    # nodes from the source and from the probe to the side, and of a ring so long that nothing travels around it
    place, inside, count = 30, 12, 4096
    lattice = fh.Lattice(1.0, (0.0,) * dim, (79.0,) * dim)
    sim = fh.Simulation(
        lattice, fh.Diffusion(fh.Kernel(float(reach)), integrator="euler"), boundary=fh.LatticePML(nodes=8)
    )
    strip = Strip(sim, 0, 80)
    side = LayerSide(
        LatticeMedium(sim.stencil, 1.0, 1.0, Recursion(0.0, sim.dt, 1.0), sim.dt),
        sim.engine.layers[3 - dim, 1],
        diffusive=True,
    )
    nodes = strip.near[0]
    distance = np.abs(np.arange(len(nodes)) - (len(nodes) - 1 - place))
    for wavelength, angle in ((40.0, 0.0), (60.0, 45.0), (60.0, 75.0)):
        if dim == 1 and angle:
            continue
        wave = side.medium.diffusion_wave(wavelength, angle)
        source = np.zeros(strip.size)
        source[nodes[-1 - place]] = 1
        change = (strip.matrix(*wave.along) - np.eye(strip.size)) / sim.dt
        field = np.linalg.solve(wave.eigenvalue * np.eye(strip.size) - change, source)[nodes]
        around = 2 * np.pi * np.arange(count) / count
        endless = np.fft.ifft(
            1 / (wave.eigenvalue + sim.stencil.symbol(around, *[np.full(count, a) for a in wave.along]))
        )
        expected = endless[distance]
        found = side.reflections(wavelength, angle)[""]
        # where modes that are short-lived at the face have died out
        back, away = (field - expected)[-1 - inside], wave.modes.incoming**inside
        assert found * away == pytest.approx(back / expected[-1], rel=1e-4)
        assert 1e-9 < abs(found) < 1


def test_a_frequency_is_a_wavelength():
    """Long waves on the lattice: omega = 2 D k^2, and at 45 degrees b^2 = omega cos / 2 D and a = b / cos, so that (a
    + i b)^2 = q^2 + i omega / D.
    """
    medium = LatticeMedium(fh.Stencil.finite_difference(2), 3.0, 0.5, Recursion(0.0, 1e-3, 1.0), 1e-3)
    wave = medium.diffusion_wave(2000.0, 45.0)
    number = 2 * np.pi / 2000.0
    assert wave.eigenvalue == pytest.approx(2j * 3.0 * (number / 0.5) ** 2, rel=1e-12)
    decay = -np.log(wave.modes.incoming)
    assert decay**2 == pytest.approx(wave.along[0] ** 2 + wave.eigenvalue / 12.0, rel=1e-5)
    assert decay.real > 0 and decay.imag == pytest.approx(wave.along[0], rel=1e-5)


def test_prediction_and_run_of_a_diffusive_layer():
    """The error against the infinite lattice, relative to the current maximum, is of the order of the prediction for
    the period of the run, and not above it.
    """
    half = 20.0
    for nodes in (8, 12):
        setup = {
            "lattice": fh.Lattice(1.0, (-half,), (half,)),
            "model": fh.Diffusion(fh.Kernel(2.0)),
            "boundary": fh.LatticePML(nodes=nodes),
            "initial": {"u": lambda x: np.exp(-(x**2) / 9)},
        }
        until = 10 * half**2
        report = fh.Simulation(**setup).check(until, budget=0.0)
        (found,) = report.reflections
        predicted = found.tables[2 * np.sqrt(np.pi * until)][0, 0]  # the diffusion wave whose period is the run
        error = next(iter(compare(setup, until, [until], beside=False).curves.values()))["error_rel_current"][-1]
        assert predicted / 10 < error < predicted
        assert "diffusion waves" in report.details


@pytest.mark.parametrize("model", [VECTORS[0][1], VECTORS[3][1], fh.Wave(fh.Kernel(3.0, 1))])
def test_waves_are_reflected_together_as_one_by_one(model):
    sim = fh.Simulation(fh.Lattice(1.0, (0.0, 0.0), (8.0, 8.0)), model, boundary=fh.LatticePML(nodes=7))
    medium, layer = Strip(sim, 0, 8, (fh.Fixed(), pinned(sim)[0, 1])).medium, sim.engine.layers[1, 1]
    waves = [medium.plane_wave(length, angle) for length, angle in ((9.0, 0.0), (14.0, 35.0), (40.0, 75.0))]
    for together, wave in zip(amplitudes_of(waves, layer), waves, strict=True):
        np.testing.assert_allclose(together, layer_amplitudes(wave, layer), rtol=1e-6, atol=1e-12)
