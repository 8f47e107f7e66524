"""Attenuation: the fit of the mechanisms, and waves that lose energy by them, against closed forms."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares, newton
from tests.helpers import fitted_rate

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.errors import InputError

TWO_DECADES = (0.005, 0.5)
ROCK = fh.Attenuation(quality=20.0, band=TWO_DECADES)
SMALL = fh.LossyRegion(fh.Disc(1.0), 6.0)
SHARP = fh.Attenuation(quality=8.0, band=(0.02, 0.2), mechanisms=3)


@pytest.mark.parametrize("exponent", [-0.5, 0.0, 0.3])
@pytest.mark.parametrize("quality", [5.5, 20.0, 1000.0])
def test_the_mechanisms_have_the_quality_in_the_band(quality, exponent):
    """Within 2 %, of a constant Q and of power laws, by few mechanisms with non-negative shares."""
    rock = fh.Attenuation(quality * (10 if quality < 10 and exponent else 1), (0.1, 10.0), exponent)
    frequency = np.geomspace(0.1, 10.0, 301)
    asked = rock.quality * frequency**exponent
    np.testing.assert_allclose(rock.quality_at(frequency), asked, rtol=0.021)
    assert len(rock.relaxation.times) <= 6
    assert (rock.relaxation.shares >= 0).all() and rock.relaxation.shares.sum() < 1


def test_waves_of_high_frequency_are_faster_as_causality_demands():
    """Kolsky's law of a constant Q, ``c(f) = c(f0) (1 + log(f / f0) / (pi Q))``, holds inside the band."""
    rock = fh.Attenuation(100.0, (0.01, 100.0), reference=1.0)
    frequency = np.geomspace(0.1, 10.0, 9)
    expected = 1 + np.log(frequency) / (np.pi * 100)
    np.testing.assert_allclose(rock.speed_at(frequency), expected, atol=0.02 * np.log(10) / (np.pi * 100))
    assert rock.speed_at(1.0) == pytest.approx(1, abs=1e-12)
    assert rock.speed_at(1e9) ** 2 == pytest.approx(rock.unrelaxed, rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"quality": 4.9, "band": (1, 2)}, "quality.*>= 5"),
        ({"quality": 50, "band": (2, 1)}, "band"),
        ({"quality": 50, "band": (0, 1)}, "band"),
        ({"quality": 10, "band": (0.01, 100), "exponent": 1}, "exponent.*>= 5|>= 5.*exponent"),
        ({"quality": 50, "band": (1, 2), "mechanisms": 0}, "mechanisms"),
        ({"quality": 50, "band": (1e-9, 1e9)}, "no 16 mechanisms"),
        ({"quality": 156, "band": (11.5, 1e30)}, "no 16 mechanisms"),
        ({"quality": 50, "band": (1, 2), "regions": [fh.Disc(1.0)]}, r"regions\[0\].*LossyRegion"),
        ({"quality": 50, "band": (1, 20), "exponent": 0.5, "regions": [SMALL]}, r"regions\[0\].quality.*>= 5"),
    ],
)
def test_what_no_mechanisms_have_is_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        fh.Attenuation(**arguments)


def frequency_of(rock, squared):
    """Complex angular frequency, with time as exp(i w t), of a mode whose eigenvalue of -L is `squared` at the
    reference frequency: a root of the dispersion relation ``w^2 = squared M(w)``.
    """
    times, shares = rock.relaxation

    def gap(w):
        return w**2 - squared * rock.unrelaxed * (1 - (shares / (1 + 1j * w * times)).sum())

    return newton(gap, np.sqrt(squared) * (1 + 0.5j / rock.quality), tol=1e-13)


def motion(rock, squared, time, velocity=0.0):
    """Amplitude at a time of such a mode, which begins at 1 with nothing relaxed: the exponential of the matrix of the
    equations of motion and relaxation.
    """
    (times, shares), eager = rock.relaxation, squared * rock.unrelaxed
    system = np.zeros((2 + len(times),) * 2)
    system[0, 1], system[1, 0], system[1, 2:] = 1, -eager, eager
    system[2:, 0], system[2:, 2:] = shares / times, -np.diag(1 / times)
    return (expm(time * system) @ [1, velocity, *np.zeros(len(times))])[0]


def decay(rock, t, values):
    """Return what is left of values if the best ``exp(-g t) cos(w t + p)``, and what relaxes without a wave, is taken
    out, as a function of (w, g).
    """
    times = rock.relaxation.times

    def misfit(guess):
        wave = np.exp((1j * guess[0] - guess[1]) * t)
        columns = np.stack([wave.real, wave.imag, *np.exp(-t / times[:, None])], axis=1)
        return values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]

    return misfit


def test_decay_has_the_quality_over_two_decades():
    """Modes on a periodic line, all at once, at frequencies that extend over two decades: their decay is that of the
    root of the dispersion relation, their Q is that of the closed form, and so is the dispersion of their speed.
    """
    count = 2400
    line = fh.Lattice(1 / 12, 0.0, (count - 1) / 12)
    waves = np.unique(np.round(np.geomspace(1, 100, 12)).astype(int))
    start = sum(np.cos(2 * np.pi * m * np.arange(count) / count) for m in waves)
    sim = fh.Simulation(line, fh.Wave(fh.Kernel(1 / 4), attenuation=ROCK), fh.Periodic(), {"u": start}, threads=1)
    series = []
    for _ in range(1200):
        sim.step(8)
        series.append(2 * np.fft.rfft(sim.fields["u"]).real[waves] / count)
    t, series = 8 * sim.dt * np.arange(1, 1201), np.array(series)
    exact, measured, slow = [], [], []
    for number, m in enumerate(waves):
        squared = float(sim.stencil.symbol(2 * np.pi * m / count)) / line.spacing**2
        root = frequency_of(ROCK, squared)
        last = int((t < 12 * 2 * np.pi / root.real).sum())  # a dozen periods
        kept = slice(0, last, max(1, last // 400))
        misfit = decay(ROCK, t[kept], series[kept, number])
        guess = [root.real, root.imag]
        measured.append(complex(*least_squares(misfit, guess, x_scale=guess).x))
        exact.append(root)
        slow.append(np.sqrt(squared))
    exact, measured = np.array(exact), np.array(measured)
    frequency = measured.real / (2 * np.pi)
    assert frequency[0] < TWO_DECADES[0] and frequency[-1] > TWO_DECADES[1]
    np.testing.assert_allclose(measured.imag, exact.imag, rtol=0.005)
    np.testing.assert_allclose(measured.real / (2 * measured.imag), ROCK.quality_at(frequency), rtol=0.02)
    # of modes of given wavelength the frequency changes as the phase velocity does
    np.testing.assert_allclose(measured.real / slow, ROCK.speed_at(frequency), rtol=0.003)
    assert np.ptp(ROCK.speed_at(frequency)) > 0.06


def test_a_mode_converges_to_the_exact_solution_with_the_square_of_the_step():
    """From displacement and velocity at the start."""
    line, m = fh.Lattice(0.25, 0.0, 7.75), 3
    model = fh.Wave(fh.Kernel(0.75), attenuation=SHARP)
    mode = np.cos(2 * np.pi * m * np.arange(32) / 32)
    errors, steps = [], np.array([40, 80, 160])
    for count in steps:
        start = {"u": mode, "v": -0.7 * mode}
        sim = fh.Simulation(line, model, fh.Periodic(), start, dt=4.0 / count, threads=1)
        sim.step(int(count))
        symbol = float(sim.stencil.symbol(2 * np.pi * m / 32)) / 0.25**2
        errors.append(abs(2 * sim.fields["u"] @ mode / 32 - motion(SHARP, symbol, 4.0, -0.7)))
    assert abs(fitted_rate(steps, errors) + 2) < 0.1, errors
    assert errors[-1] < 1e-3


@pytest.mark.parametrize("material", ["bond-based", "state-based"])
def test_both_waves_of_a_solid_have_the_quality(material):
    """Longitudinal and transverse modes against the exact solution."""
    plane = fh.Lattice(1.0, (0.0, 0.0), (47.0, 8.0))
    solid = fh.Elastic(fh.Kernel(2.0), 1.0, 0.25, density=0.8, material=material, attenuation=SHARP)
    wave = np.cos(2 * np.pi * np.arange(48) / 48)[:, None] * np.ones(9)
    for component, speed in enumerate((solid.p_speed, solid.s_speed)):
        u = np.zeros((2, 48, 9))
        u[component] = wave
        sim = fh.Simulation(plane, solid, fh.Periodic(), {"u": u}, dt=0.25, threads=1)
        matrix = sim.stencil.symbol(2 * np.pi / 48, 0.0)
        symbol = np.real(matrix[component, component]) * sim.model.coefficient / SHARP.unrelaxed
        assert symbol == pytest.approx((speed * 2 * np.pi / 48) ** 2, rel=0.01)
        sim.step(200)
        amplitude = 2 * np.mean(sim.fields["u"][component] * wave)
        assert amplitude == pytest.approx(motion(SHARP, symbol, 50.0), abs=2e-3)


def test_without_mechanisms_of_weight_nothing_changes():
    """A quality so high that nothing relaxes leaves the waves of the same speed."""
    start, line = {"u": "exp(-x**2)"}, fh.Lattice(0.25, -8.0, 8.0)
    fields = []
    for rock in (None, fh.Attenuation(1e12, (0.1, 0.8))):
        sim = fh.Simulation(line, fh.Wave(fh.Kernel(0.75), attenuation=rock), fh.Free(), start, dt=0.05)
        sim.step(100)
        fields.append(sim.fields["u"])
    np.testing.assert_allclose(fields[1], fields[0], atol=1e-10)


def test_waves_in_regions_have_their_own_quality():
    """A burst crosses into a half-space of a fifth of Q: its amplitude and phase there are those of the closed form,
    and it is reflected as pressure is where the modulus changes at equal density.
    """
    half = fh.LossyRegion(fh.Box((0.0,), (100.0,)), 12.0)
    rock = fh.Attenuation(60.0, (0.02, 0.2), regions=[half])
    records = []
    for medium in (rock, fh.Attenuation(60.0, (0.02, 0.2))):
        burst = fh.Source("exp(-((x + 20)/0.8)**2)", "exp(-((t - 45)/10)**2)*cos(2*pi*0.1*(t - 45))")
        line = fh.Receivers([(-6.0,), (6.0,), (14.0,)])
        model = fh.Wave(fh.Kernel(0.3), attenuation=medium)
        layers, lattice = fh.LatticePML(nodes=40), fh.Lattice(0.1, -40.0, 40.0)
        sim = fh.Simulation(lattice, model, layers, {}, sources=[burst], observe=[line], dt=0.07, threads=1)
        sim.run(150.0)
        records.append(line.data["u"])
    frequency = np.linspace(0.08, 0.12, 5)
    split, alone = (np.exp(-2j * np.pi * np.outer(frequency, line.times)) @ record for record in records)
    slowness = [spectrum.modulus(frequency) ** -0.5 for spectrum in rock.spectra]
    before, after = (2 * np.pi * frequency * slow for slow in slowness)
    np.testing.assert_allclose(split[:, 2] / split[:, 1], np.exp(-8j * after), rtol=0.005)
    quality = -np.pi * frequency * 8 / np.log(np.abs(split[:, 2] / split[:, 1])) / rock.spectra[1].speed_at(frequency)
    np.testing.assert_allclose(quality, rock.spectra[1].quality_at(frequency), rtol=0.02)
    reflected = (split[:, 0] / alone[:, 0] - 1) * np.exp(12j * before)
    np.testing.assert_allclose(reflected, (slowness[0] - slowness[1]) / (slowness[0] + slowness[1]), rtol=0.1)


def test_a_case_file_gives_regions():
    text = """
    [lattice]
    spacing = 0.5
    lower = [-10.0]
    upper = [10.0]
    [model]
    type = "wave"
    kernel = { horizon = 1.0 }
    [model.attenuation]
    quality = 50.0
    band = [0.02, 0.3]
    [[model.attenuation.regions]]
    region = { box = { lower = [0.0], upper = [5.0] } }
    quality = 8
    [boundary]
    x = { type = "free" }
    [initial]
    u = "exp(-x**2)"
    [run]
    until = 1.0
    """
    assert repr(Case(text).simulation().model.attenuation.regions) == repr((fh.LossyRegion(fh.Box([0.0], [5.0]), 8.0),))
