"""The reflection of a layer in closed form, and the layer that is chosen by it."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.chain import Recursion
from farhorizon.analysis.choice import Profile, choose, family, layer_reflection, sample, worst
from farhorizon.analysis.layer import Medium
from farhorizon.analysis.short_waves import high_pass
from farhorizon.analysis.spectrum import band, gain_of_time
from farhorizon.certificate import certify
from farhorizon.compare import compare
from farhorizon.strip import Strip, pinned


def medium_of(sim):
    return Medium(sim.stencil, sim.model.coefficient, sim.lattice.spacing, Recursion.of(sim.model.integrator, sim.dt, sim.model.damping), sim.dt)


def box(*nodes):
    return fh.Lattice(1.0, (0.0,) * len(nodes), [n - 1.0 for n in nodes])


@pytest.mark.parametrize("dim, reach, exponent", [(1, 3, 0), (2, 1, 2), (2, 3, 2), (2, 4, 1), (3, 2, 2)])
def test_closed_form_is_what_the_half_infinite_problem_gives(dim, reach, exponent):
    """Products over the edges and K conditions at the outer end, against the engine's own map with all evanescent modes."""
    profile = {"kappa": np.linspace(1, 3, 9), "sigma": 0.9 * np.linspace(0.05, 1, 9), "alpha": 0.02}
    sim = fh.Simulation(box(*[2 * reach + 3] * dim), fh.Wave(fh.Kernel(float(reach), exponent), damping=0.01),
                        boundary=fh.LatticePML(nodes=8, profile=profile))  # fmt: skip
    strip = Strip(sim, 0, 2 * reach + 2, (fh.Fixed(), pinned(sim)[0, 1]))
    layer = next(iter(sim.engine.layers.values()))
    for wavelength, angle in ((7.0, 0.0), (11.0, 40.0), (30.0, 70.0)):
        wave = medium_of(sim).plane_wave(wavelength, angle if dim > 1 else 0.0)
        found = layer_reflection(wave, layer)
        assert found == pytest.approx(abs(strip.reflection(wavelength, angle if dim > 1 else 0.0)), rel=1e-6, abs=1e-13)


@pytest.mark.parametrize("reach, target, angle", [(1, 1e-6, 75), (3, 1e-4, 60), (4, 1e-5, 45)])
def test_no_thinner_layer_of_the_family(reach, target, angle):
    """Less the tenth to spare and one node, and no profile meets the target; the choice itself does, between the waves that it looked at, too."""
    stencil = fh.Stencil.from_kernel(fh.Kernel(float(reach)), 1.0, 2)
    dt = 0.5 * fh.Simulation(box(2 * reach + 3, 2 * reach + 3), fh.Wave(stencil)).step_limit
    medium, damped = Medium(stencil, 1.0, 1.0, Recursion.of(fh.Wave(stencil).integrator, dt), dt), high_pass(stencil)
    found = choose(medium, target, (6.0, 50.0), angle)
    waves = sample(medium, (6.0, 50.0), angle)
    thinnest = next(n for n in range(found.nodes + 1) if n + n // 10 == found.nodes)
    assert all(worst(waves, p.layer(thinnest - 1, 1.0, 1.0, damped)) > 0.8 * target for p in family(stencil, damped))
    random = np.random.default_rng(0)
    between = [medium.plane_wave(*at) for at in zip(random.uniform(6, 50, 50), random.uniform(0, angle, 50), strict=True)]
    assert worst(between, found.profile.layer(found.nodes, 1.0, 1.0, damped)) <= target


@pytest.mark.parametrize("operator, options", [(fh.Kernel(2.0, 1), {}), (None, {"poisson": 0.3, "material": "finite-element"})])
def test_choice_of_vectors(operator, options):
    """P and S waves between those that the choice looked at, by the engine's own map; and a run that has both, against the infinite lattice.

    What is bounded leaves under no larger angle than the waves that come do.
    """
    target, angle, half = 1e-4, 60.0, 22.0
    model = fh.Elastic(operator, 1.0, **options)

    def push(x, y):
        return np.exp(-(x**2 + y**2) / 16)

    setup = {"lattice": box(45, 45), "model": model, "boundary": fh.LatticePML(target=target, angle=angle, wavelengths=(8.0, 80.0)), "threads": 1,
             "initial": {"u": [lambda x, y: push(x - half, y - half), 0.0]}}  # fmt: skip
    sim = fh.Simulation(**setup)
    strip, random, speeds = Strip(sim, 0, 9), np.random.default_rng(0), {"P": model.p_speed, "S": model.s_speed}
    for incoming in strip.types:
        for wavelength, at in zip(random.uniform(8, 80, 25), random.uniform(0, angle, 25), strict=True):
            back = strip.reflections(float(wavelength), float(at), incoming=incoming)
            steep = [name for name in back if speeds[name] / speeds[incoming] * np.sin(np.radians(at)) > np.sin(np.radians(angle))]  # not bounded
            assert np.linalg.norm([abs(a) for name, a in back.items() if name not in steep]) <= target
    (curve,) = compare(setup, 3 * half / model.p_speed, beside=False).curves.values()
    assert max(curve["error_rel_initial"]) <= target


def test_thickness_grows_with_target_and_angle():
    pulse = {"u": lambda x, y: np.exp(-((x - 20) ** 2 + (y - 20) ** 2) / 16)}

    def nodes(**options):
        sim = fh.Simulation(box(41, 41), fh.Wave(fh.Kernel(2.0)), boundary=fh.LatticePML(**options), initial=pulse)
        return sim.engine.layers[1, 1].columns

    assert nodes(target=1e-4, angle=60) < nodes(target=1e-6, angle=60) < nodes(target=1e-6, angle=80)


def test_a_chosen_layer_in_a_run():
    """A pulse in the plane: target 1e-6 up to 70 degrees holds in the run, the layer is stable, and `check` says what was chosen."""
    setup = {
        "lattice": fh.Lattice(0.5, (-12.0, -12.0), (12.0, 12.0)), "model": fh.Wave(fh.Kernel(1.5)), "boundary": fh.LatticePML(target=1e-6, angle=70),
        "initial": {"u": lambda x, y: np.exp(-((x - 2) ** 2 + y**2) / 2)},
    }  # fmt: skip
    sim = fh.Simulation(**setup)
    assert max(next(iter(compare(setup, 60.0, beside=False).curves.values()))["error_rel_initial"]) <= 1e-6
    assert certify(sim, 5.0).parts[0].growth.stable
    assert "chosen up to 70 degrees" in str(sim.check(budget=0.0))
    assert set(sim.choices) == {"x-", "x+", "y-", "y+"} and len(set(map(str, sim.choices.values()))) == 1


def test_wavelengths_of_the_data_or_given(tmp_path):
    """A wider pulse needs no thicker layer; given wavelengths need no data; a restored run has the same layers."""
    lattice, model = box(61), fh.Wave(fh.Kernel(3.0))
    given = fh.Simulation(lattice, model, boundary=fh.LatticePML(target=1e-6, angle=0, wavelengths=(5.0, 60.0)))
    assert given.choices
    data = {"u": lambda x: np.exp(-((x - 30) ** 2) / 20)}
    sim = fh.Simulation(lattice, model, boundary=fh.LatticePML(target=1e-6, angle=0), initial=data)
    sim.step(10)
    sim.save(tmp_path / "x.ckpt")
    again = fh.Simulation.restore(tmp_path / "x.ckpt")
    assert again.choices == sim.choices and np.array_equal(again.fields["u"], sim.fields["u"])


@pytest.mark.parametrize("options, words", [
    ({"angle": 95}, "angle"), ({"angle": 60, "nodes": 5}, "nodes"), ({"wavelengths": (1, 2)}, "angle"),
    ({"angle": 60, "wavelengths": (3, 2)}, "longest"),
])  # fmt: skip
def test_impossible_choices(options, words):
    with pytest.raises(fh.InputError, match=words):
        fh.LatticePML(**options)


def test_what_cannot_be_chosen():
    """No data to read the wavelengths from, diffusion, a target that no layer meets."""
    with pytest.raises(fh.InputError, match="wavelengths"):
        fh.Simulation(box(30), fh.Wave(fh.Kernel(2.0)), boundary=fh.LatticePML(angle=0))
    with pytest.raises(fh.InputError, match="only for waves"):
        fh.Simulation(box(30), fh.Diffusion(fh.Kernel(2.0)), boundary=fh.LatticePML(angle=0))
    with pytest.raises(fh.InputError, match="no layer of up to"):
        fh.Simulation(box(20, 20), fh.Wave(fh.Kernel(2.0)), boundary=fh.LatticePML(target=1e-13, angle=89, wavelengths=(5, 50)))


def test_band_of_a_packet():
    """A wave of 12 nodes under an envelope: half of the energy beside its wavelength, hardly any beyond half and twice of it."""
    x = 0.5 * np.arange(400)
    found = band([np.exp(-((x - 100) ** 2) / 800) * np.cos(2 * np.pi * x / 6)], 0.5, [1])
    assert found.typical == pytest.approx(6.0, rel=0.02)
    assert 3 < found.shortest < 6 < found.longest < 12
    assert band([np.zeros(10)], 1.0, [0]) is None


def test_the_time_of_a_source_picks_its_waves():
    """A point that shakes at one frequency sends one wavelength, whatever its size: 2 pi times the speed over the frequency."""
    point = np.exp(-((np.arange(200) - 100.0) ** 2) / 2)
    gain = gain_of_time(lambda t: np.sin(0.6 * t) * np.exp(-(((t - 100) / 30) ** 2)), 200.0, 2.0 / 0.5)
    found = band([point], 0.5, [0], [gain])
    assert found.typical == pytest.approx(2 * np.pi * 2.0 / 0.6, rel=0.05)
    assert found.longest < 1.5 * found.typical and found.shortest > 0.6 * found.typical


def test_profile_reads_as_it_is():
    kappa, sigma, alpha = Profile(1.5, 4.0, 2).edges(3, 2.0, 0.5)
    assert str(Profile(1.5, 1.0, 1, 0.5)) == "sigma linear to 1.5 2c/spacing, alpha rising by 0.5"
    assert str(Profile(1.5, 4.0, 2)) == "sigma square to 1.5 2c/spacing, kappa to 4"
    assert sigma[-1] == pytest.approx(1.5 * 2 * 2.0 / 0.5 * (3.5 / 4) ** 2) and kappa[0] == pytest.approx(1 + 3 * 0.5 / 4) and (alpha > 0).all()


def test_a_chosen_layer_damps_the_short_waves_that_would_grow():
    """Reach 4 has weak backward waves: the exact reflection with their damping still meets the target."""
    lattice = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0))
    boundary = fh.LatticePML(target=1e-6, angle=70.0, wavelengths=(8.0, 40.0))
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(4.0)), boundary=boundary)
    assert all(layer.damping.max() > 0 for layer in sim.engine.layers.values())
    side = Strip(sim, 0, 10, (fh.Fixed(), pinned(sim)[0, 1]))
    assert max(abs(side.reflection(wavelength, angle)) for wavelength in (8.0, 17.0, 40.0) for angle in (0.0, 35.0, 70.0)) <= 1e-6


@pytest.mark.parametrize("dim, reach, exponent, target", [(1, 3, 0, 1e-7), (1, 5, 1, 1e-6), (2, 2, 0, 1e-5), (2, 4, 1, 1e-5)])
def test_a_layer_that_damps_strong_backward_waves_is_chosen(dim, reach, exponent, target):
    """The engine's own map sends back less than the target, nothing grows between the sides, and a run keeps the target."""
    damped = high_pass(fh.Stencil.from_kernel(fh.Kernel(float(reach), exponent), 1.0, dim))
    width = 6.66 / min(np.pi / 4, 0.6 * damped.first)  # exp(-(k width / 2)^2) = 1.5e-5
    half = np.ceil(width * np.sqrt(np.log(1e3 / target))) + reach
    lattice = fh.Lattice(1.0, (-half,) * dim, (half,) * dim)
    setup = {
        "lattice": lattice, "model": fh.Wave(fh.Kernel(float(reach), exponent)), "boundary": fh.LatticePML(target=target, angle=70.0),
        "initial": {"u": lambda *x: np.exp(-sum(a**2 for a in x) / width**2)},
    }  # fmt: skip
    sim = fh.Simulation(**setup)
    (layer, *_), (chosen, *_) = sim.engine.layers.values(), sim.choices.values()
    assert layer.damping.max() > 0.06 * layer.sigma.max()  # strong: it shares in what comes back
    side = Strip(sim, 0, 2 * reach + 2, (fh.Fixed(), pinned(sim)[0, 1]))
    for wavelength, angle in ((14.0, 0.0), (20.0, 35.0), (60.0, 70.0)):
        wave = medium_of(sim).plane_wave(wavelength, angle if dim > 1 else 0.0)
        found = abs(side.reflection(wavelength, angle if dim > 1 else 0.0))
        assert found <= target and found == pytest.approx(layer_reflection(wave, layer), rel=1e-6, abs=1e-13)
    between = Strip(sim, 0, max(8, 2 * reach + 1))
    assert all(between.growth(*angles).stable for angles in ([()] if dim == 1 else [(0.01,), (0.5,), (1.5,), (np.pi,)]))
    assert chosen.nodes < 40 and ("smooth" in str(chosen)) == (reach < 5)
    assert max(next(iter(compare(setup, 4 * half, np.linspace(0.5, 4, 12) * half, beside=False).curves.values()))["error_rel_initial"]) <= target


def test_the_waves_of_vector_sources_are_read():
    """A body force makes the same choice as an initial velocity of its shape."""
    model, lattice = fh.Elastic(None, 1.0, 0.3, material="finite-element"), box(31, 31)

    def push(x, y):
        return np.exp(-((x - 15) ** 2 + (y - 15) ** 2) / 9)

    layer = fh.LatticePML(target=1e-3, angle=30.0)
    start = fh.Simulation(lattice, model, layer, {"v": [push, 0.0]})
    driven = fh.Simulation(lattice, model, layer, sources=[fh.Source([push, 0.0], lambda t: np.exp(-t))])
    assert start.choices["x-"] == driven.choices["x-"]
