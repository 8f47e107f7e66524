"""Layers with dampers tuned to backward waves: their thickness, and the decay of noise in them."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.layers.families import (
    backward_band,
    gently_damped,
    lightly_tuned,
    steady_rise,
    thin,
    tuned_layer,
)
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice
from farhorizon.checks.reduced_setups import Strip, plain_twin
from farhorizon.engine.state import State

EXAMPLES = Path(__file__).parents[3] / "examples"
SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))


def solid(reach, exponent=1, influence="constant", material="bond-based", **more):
    more |= {} if material == "bond-based" else {"poisson": more.get("poisson", 0.3)}
    return fh.Elastic(fh.Kernel(reach, exponent, influence), young=1.0, material=material, **more)


ELEMENTS = fh.Elastic(None, young=1.0, poisson=0.3, material="finite-element")
MEDIA = {
    "bonds": (solid(2.0), 2),
    "linear": (solid(2.0, influence="linear"), 2),
    "elements": (ELEMENTS, 2),
    "scalar elements": (fh.Wave(fh.Stencil.finite_element(2)), 2),
    "exponent 0": (solid(2.0, 0), 2),
    "exponent 2": (solid(3.0, 2), 2),
    "wide linear": (solid(3.0, influence="linear"), 2),
    "gaussian": (solid(4.0, influence="gaussian"), 2),
    "states": (solid(2.0, material="state-based"), 2),
    "wide bonds": (solid(3.0), 2),
    "wide states": (solid(3.0, material="state-based"), 2),
    "scalar": (fh.Wave(fh.Kernel(3.0, 1)), 2),
    "bonds in space": (solid(2.0), 3),
    "states in space": (solid(2.0, material="state-based", poisson=0.2), 3),
}


def pace_of(model):
    return float(np.sqrt(model.coefficient))


def step_limit(model, dim, nodes=15):
    return fh.Simulation(fh.Lattice(1.0, (0.0,) * dim, (nodes - 1.0,) * dim), model, fh.Fixed(), threads=1).step_limit


@pytest.mark.parametrize("name", MEDIA)
def test_backward_waves_are_among_the_fastest(name):
    """By their definition, the frequency falls as the wavenumber rises, along an axis and at 45 degrees."""
    model, dim = MEDIA[name]
    stencil = model.stencil(1.0, dim)
    band = backward_band(stencil)
    k = np.linspace(0.01, np.pi, 400)
    zero = np.zeros_like(k)
    for along in ([k, *[zero] * (dim - 1)], [k, k, *[zero] * (dim - 2)]):
        frequencies = np.sqrt(np.maximum(stencil.branches(*along), 0))
        backward = np.diff(frequencies, axis=0) < -1e-6
        for branch in np.flatnonzero(backward.any(0)):
            slowest = frequencies[1:, branch][backward[:, branch]].min()
            assert slowest > 0.5 * band.highest
            assert slowest > band.frequency - 1.1 * band.width
    assert frequencies.max() < band.highest * 1.001


def test_media_without_such_a_band():
    """No backward waves; zero-energy modes, which are slow and short; waves with a cut-off."""
    assert backward_band(fh.Wave(fh.Kernel(3.0)).stencil(1.0, 2)) is None
    bare = solid(2.0, material="correspondence").stencil(1.0, 2)
    assert backward_band(bare) is None and tuned_layer(4, bare, 1.0, 0.1) is None
    assert backward_band(fh.Wave(fh.Kernel(3.0, 1)).stencil(1.0, 2).with_reaction(0.1)) is None
    for slow in (solid(5.0), solid(3.0, 0)):  # noise grows, and so do waves along a side
        assert not any(tuned_layer(nodes, slow.stencil(1.0, 2), 1.0, 0.1) for nodes in range(2, 13))


def test_a_step_near_the_limit_has_none():
    """The fastest waves have less mass than the step was made for."""
    stencil = ELEMENTS.stencil(1.0, 2)
    limit, pace = step_limit(ELEMENTS, 2), pace_of(ELEMENTS)
    assert tuned_layer(4, stencil, pace, 0.5 * limit) and not tuned_layer(4, stencil, pace, 0.95 * limit)


def test_units_change_nothing():
    """All quantities scale with speed over spacing."""
    stencil = solid(2.0).stencil(1.0, 2)
    one, other = tuned_layer(5, stencil, 1.0, 0.2), tuned_layer(5, stencil, 1e4, 0.2e-4)
    for part, scale in (("kappa", 1.0), ("sigma", 1e4), ("alpha", 1e4), ("damping", 1e4), ("tuned", 1e4)):
        np.testing.assert_allclose(getattr(other, part), scale * getattr(one, part), rtol=1e-12)


@pytest.mark.parametrize("name", ["bonds", "elements"])
def test_five_nodes_do_what_twelve_did(name):
    """Pulses with waves of eight and sixteen nodes: errors over four crossings against a larger domain."""
    model, dim = MEDIA[name]
    pace = pace_of(model)
    for wave in (8, 16):
        half = 2.0 * wave
        lattice = fh.Lattice(1.0, (-half,) * dim, (half,) * dim)
        x, y = lattice.coordinates()
        g = np.exp(-((x - 0.3 * half) ** 2 + (y + 0.2 * half) ** 2) * (np.pi / wave) ** 2)
        u, until = np.stack([g, 0.5 * g]), 8 * half / pace
        exact = fh.Simulation(lattice, model, fh.Extended(1e-8, until=until), {"u": u}, threads=1)
        stencil = exact.stencil
        layers = {"tuned": tuned_layer(5, stencil, pace, exact.dt), "steep": None}
        runs = {
            name: fh.Simulation(
                lattice, model, fh.LatticePML(nodes=5 if layer else 12, profile=layer), {"u": u}, threads=1
            )
            for name, layer in layers.items()
        }
        errors = dict.fromkeys(runs, 0.0)
        for step in np.linspace(0, until / exact.dt, 12).astype(int)[1:].tolist():
            exact.step(step - exact.step_count)
            for name, run in runs.items():
                run.step(step - run.step_count)
                errors[name] = max(errors[name], float(np.abs(run.fields["u"] - exact.fields["u"]).max()))
        print(wave, errors)
        assert errors["tuned"] < 1e-4
        assert errors["steep"] > 0.3 * errors["tuned"]  # with 12 nodes


def _growth(model, dim, layer, share, time, seed=3, sides=None):
    """Size of the state in the last third of a run from white noise over that in the third before."""
    size = 2.0 * max(model.stencil(1.0, dim).reach) + 2.0
    names = [axis + end for axis in "xyz"[:dim] for end in "-+"]
    dt, boundary = share * step_limit(model, dim), fh.LatticePML(nodes=layer.columns, profile=layer)
    sim = fh.Simulation(
        fh.Lattice(1.0, (0.0,) * dim, (size,) * dim),
        model,
        dict.fromkeys(names, boundary) | (sides or {}),
        dt=dt,
        threads=1,
    )
    state = State(plain_twin(sim).engine)
    steps = int(time / pace_of(model) / dt / 3 / state.every) * state.every
    now, sizes = np.random.default_rng(seed).standard_normal(state.size), []
    for _ in range(3):
        now = state.after(now, steps)
        sizes.append(np.linalg.norm(now))
    return sizes[2] / sizes[1]


@pytest.mark.parametrize(
    "name", ["bonds", "wide bonds", *(pytest.param(n, marks=pytest.mark.slow) for n in MEDIA if "bonds" not in n)]
)
@pytest.mark.parametrize("share", [0.3, 0.65])
def test_noise_decays(name, share):
    """Where layers meet, in a box of few nodes, at both ends of the range of steps."""
    model, dim = MEDIA[name]
    stencil, found = model.stencil(1.0, dim), 0
    for nodes in (3, 5, 8):
        layer = tuned_layer(nodes, stencil, pace_of(model), share * step_limit(model, dim))
        if layer is not None:
            found += 1
            assert _growth(model, dim, layer, share, 3000.0 if dim == 2 else 1200.0) < 1.0
    assert found or backward_band(stencil).highest < 1.1  # where layers would grow


@pytest.mark.parametrize(
    "name", ["elements", *(pytest.param(n, marks=pytest.mark.slow) for n, (_, dim) in MEDIA.items() if dim == 2)]
)
def test_noise_decays_beside_thick_layers_with_filters(name):
    """As beside the long sides of a box."""
    model, dim = MEDIA[name]
    stencil, pace = model.stencil(1.0, dim), pace_of(model)
    thick = dict.fromkeys(("x-", "x+"), fh.LatticePML(nodes=17))
    for nodes in (3, 5, 8):
        if (layer := tuned_layer(nodes, stencil, pace, 0.5 * step_limit(model, dim))) is not None:
            assert _growth(model, dim, layer, 0.5, 3000.0, sides=thick) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("number", range(24))
def test_noise_decays_in_random_media(number):
    """Free and fixed sides are included. Two waves that beat may rise for a third of the run although both decay; a
    run four times as long then decides.
    """
    random = np.random.default_rng([SEED, number])
    dim, end = (3, 1500.0) if number % 4 == 0 else (2, 3000.0)
    reach = float(random.choice([1.5, 2.0, 2.5, 3.0] if dim == 2 else [1.5, 2.0]))
    material = str(random.choice(["bond-based", "state-based"]))
    influence = str(random.choice(["constant", "linear", "gaussian"]))
    poisson = {} if material == "bond-based" else {"poisson": float(random.uniform(0.0, 0.4))}
    model = solid(reach, int(random.integers(0, 4)), influence, material, **poisson)
    share = float(random.uniform(0.3, 0.65))
    dt = share * step_limit(model, dim)
    stencil = model.stencil(1.0, dim)
    every = [tuned_layer(nodes, stencil, pace_of(model), dt) for nodes in range(2, 13)]
    layers = [layer for layer in every if layer is not None]
    print(f"seed {SEED}, number {number}: {model}, {dim}D, step {share:.2f}, {len(layers)} layers")
    for layer in [layers[i] for i in random.permutation(len(layers))[:3]]:
        wall = [None, fh.Free(), fh.Fixed()][int(random.integers(0, 3 if dim == 2 else 1))]
        sides = {} if wall is None else {"y+": wall}
        assert any(_growth(model, dim, layer, share, time, number, sides) < 1.0 for time in (end, 4 * end))


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "name", ["states", *(pytest.param(n, marks=pytest.mark.slow) for n, (_, dim) in MEDIA.items() if dim == 2)]
)
@pytest.mark.parametrize("share", [0.3, pytest.param(0.5, marks=pytest.mark.slow), 0.65])
def test_no_wave_along_a_side_grows(name, share):
    """Eigenvalues of a strip for all layers, at tangential wavenumbers from the longest to the shortest wave; the fast
    tier takes the ends of the range of steps.
    """
    model, dim = MEDIA[name]
    reach, dt = max(model.stencil(1.0, dim).reach), share * step_limit(model, dim)
    lattice = fh.Lattice(1.0, (0.0,) * dim, (2.0 * reach + 4,) * dim)
    found = [tuned_layer(nodes, model.stencil(1.0, dim), pace_of(model), dt) for nodes in range(2, 13)]
    for layer in [layer for layer in found if layer is not None]:
        sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=layer.columns, profile=layer), dt=dt, threads=1)
        strip = Strip(sim, 0, lattice.shape[0])
        rates = [strip.growth(angle).rate for angle in (0.005, 0.3, 1.14, 1.43, 1.71, 2.0, 2.28, 2.57, np.pi)]
        assert max(rates) < 0, layer


def test_an_elastic_half_space_keeps_its_target():
    """Lamb's problem from the examples, against a domain from which nothing returns."""
    case = fh.read_case(EXAMPLES / "half_space.toml")
    far = fh.Extended(1e-9, until=case.end)
    runs = case.simulation(threads=1), case.simulation(boundary={"x": far, "y-": far, "y+": fh.Free()}, threads=1)
    assert max(found.layer.columns for found in runs[0].thickness.values()) <= 8
    error, size = 0.0, 0.0
    for step in range(20, int(case.end / runs[0].dt) + 1, 20):
        for run in runs:
            run.step(step - run.step_count)
        fields = [run.fields["u"] for run in runs]
        error, size = max(error, float(np.abs(fields[0] - fields[1]).max())), max(size, float(np.abs(fields[1]).max()))
    assert 1e-6 < error / size < 1e-4


def test_elastic_targets_are_kept_with_few_nodes():
    """The target of 1e-4 in the plane."""
    lattice = fh.Lattice(1.0, (-25.0, -25.0), (25.0, 25.0))
    x, y = lattice.coordinates()
    g = np.exp(-(x**2 + y**2) / 16)
    until = 250.0
    setup = lattice, solid(2.0), {"u": np.stack([g, 0 * g])}
    exact = fh.Simulation(*setup[:2], fh.Extended(1e-8, until=until), setup[2], threads=1)
    sim = fh.Simulation(*setup[:2], fh.LatticePML(target=1e-4, until=until), setup[2], threads=1)
    assert {found.name[:5] for found in sim.thickness.values()} == {"tuned"}
    assert max(found.layer.columns for found in sim.thickness.values()) <= 7
    worst = 0.0
    for step in np.linspace(0, until / sim.dt, 12).astype(int)[1:].tolist():
        for run in (sim, exact):
            run.step(step - run.step_count)
        worst = max(worst, float(np.abs(sim.fields["u"] - exact.fields["u"]).max()))
    assert 1e-6 < worst <= 1e-4


@pytest.mark.parametrize("other", [fh.Free(), fh.Periodic()])
def test_plates_and_guides_have_none(other):
    """Waves between two sides hardly move at their cut-off, and those of plates run backward at low frequencies."""
    lattice = fh.Lattice(1.0, (-25.0, -15.0), (25.0, 15.0))
    x, y = lattice.coordinates()
    g = np.exp(-(x**2 + y**2) / 16)
    layer = fh.LatticePML(target=1e-3, until=100.0)
    sim = fh.Simulation(lattice, solid(2.0), {"x": layer, "y": other}, {"u": np.stack([g, 0 * g])}, threads=1)
    assert all(not found.layer.tuned.size for found in sim.thickness.values())


#: Scalars in space, whose backward waves are weak.
SCALARS = {
    "reach 2": fh.Kernel(2.0),
    "reach 3": fh.Kernel(3.0),
    "reach 4": fh.Kernel(4.0),
    "linear": fh.Kernel(2.0, 1, "linear"),
    "linear, whole cells": fh.Kernel(2.0, 1, "linear", volume="full"),
    "exponent 3": fh.Kernel(3.0, 3, volume="full"),
    "exponent 3, reach 2": fh.Kernel(2.0, 3, volume="full"),
    "gaussian": fh.Kernel(4.0, 0, "gaussian", volume="full"),
}


def filtered(model, nodes, strength):
    """A thin profile with a short filter."""
    stencil = model.stencil(1.0, 3)
    return gently_damped(thin(nodes, 1.0, steady_rise(stencil, nodes), strength), stencil)


def light(layer, stencil, dt):
    """The layer with light dampers, which must exist; otherwise a filter would be compared with itself."""
    found = lightly_tuned(layer, stencil, 1.0, dt)
    assert found is not None and found.tuned.size
    return found


def fastest_along_a_side(model, layer, dt):
    """Growth rate of the fastest of several waves along two sides 8 nodes apart."""
    lattice, side = fh.Lattice(1.0, (0.0,) * 3, (8.0,) * 3), fh.LatticePML(nodes=layer.columns, profile=layer)
    strip = Strip(fh.Simulation(lattice, model, side, dt=dt, threads=1), 0, lattice.shape[0])
    angles = [(0.01, 0.01), (0.01, 0.5), (1.3, 1.3), (1.9, 2.6), (2.6, np.pi), (np.pi, np.pi)]
    return max(strip.growth(*pair).rate for pair in angles)


def test_light_dampers_take_the_place_of_a_weak_filter():
    """The stretch is unchanged. There are no light dampers with more nodes, in the plane, without backward waves, or
    at a step near the limit.
    """
    model = fh.Wave(SCALARS["reach 3"])
    stencil, dt = model.stencil(1.0, 3), 0.5 * step_limit(model, 3)
    layer = filtered(model, 6, 2.0)
    found = light(layer, stencil, dt)
    assert layer.filtered and not found.filtered and found.taps.size == 1
    for part in ("kappa", "sigma", "alpha"):
        np.testing.assert_array_equal(getattr(found, part), getattr(layer, part))
    band = backward_band(stencil, 0.1)
    assert band.frequency - band.width / 2 < found.tuned[0] <= band.highest
    assert (np.diff(found.damping) > 0).all()
    assert lightly_tuned(filtered(model, 13, 2.0), stencil, 1.0, dt) is None
    assert lightly_tuned(thin(6, 1.0), stencil, 1.0, dt) is None
    assert lightly_tuned(layer, stencil, 1.0, 0.99 * step_limit(model, 3)) is None
    flat = fh.Wave(fh.Kernel(3.0, 1)).stencil(1.0, 2)
    assert backward_band(flat) is not None and lightly_tuned(layer, flat, 1.0, dt) is None


def test_vectors_have_no_light_dampers():
    """This includes solids with weak backward waves."""
    model = solid(3.0, 2)
    stencil, dt = model.stencil(1.0, 3), 0.5 * step_limit(model, 3)
    assert backward_band(stencil, 0.1) is not None
    layer = filtered(fh.Wave(SCALARS["reach 3"]), 4, 2.0)
    assert layer.filtered and lightly_tuned(layer, stencil, pace_of(model), dt) is None


def test_light_dampers_know_no_units():
    model = fh.Wave(SCALARS["reach 2"])
    stencil, dt = model.stencil(1.0, 3), 0.5 * step_limit(model, 3)
    layer = filtered(model, 4, 2.0)
    one = light(layer, stencil, dt)
    scaled = {name: 1e4 * getattr(layer, name) for name in ("sigma", "alpha", "damping")}
    other = lightly_tuned(replace(layer, **scaled), stencil, 1e4, 1e-4 * dt)
    for part in ("damping", "tuned"):
        np.testing.assert_allclose(getattr(other, part), 1e4 * getattr(one, part), rtol=1e-12)


@pytest.mark.parametrize(
    "name",
    ["reach 3", *(pytest.param(n, marks=pytest.mark.slow) for n in SCALARS if n not in ("reach 3", "exponent 3"))],
)
@pytest.mark.parametrize("share", [0.5, pytest.param(0.3, marks=pytest.mark.slow)])
def test_no_wave_along_a_side_grows_faster_than_beside_a_filter(name, share):
    """Eigenvalues of a strip: where all waves decay with a filter, they decay with dampers."""
    model = fh.Wave(SCALARS[name])
    stencil, dt = model.stencil(1.0, 3), share * step_limit(model, 3)
    for nodes, strength in ((3, 1.4), (4, 2.0), (6, 4.0), (8, 2.0)):
        layer = filtered(model, nodes, strength)
        rates = [fastest_along_a_side(model, one, dt) for one in (layer, light(layer, stencil, dt))]
        assert rates[1] <= max(rates[0], 0.0), (nodes, strength, rates)


@pytest.mark.parametrize("share", [0.5, pytest.param(0.3, marks=pytest.mark.slow)])
def test_waves_that_nothing_damps_grow_no_faster_than_beside_filters(share):
    """With exponent 3 and reach 3, waves that stand still along the normal are at the lower end of the band. Beside 3
    to 6 nodes they grow without any damping, too; whether faster with dampers or with a filter depends on thickness
    and strength. The fastest growth of all is beside filters.
    """
    model = fh.Wave(SCALARS["exponent 3"])
    stencil, dt = model.stencil(1.0, 3), share * step_limit(model, 3)
    rates = []
    for nodes, strength in ((3, 1.4), (4, 2.0), (6, 2.0), (6, 4.0), (8, 2.0), (8, 4.0)):
        layer = filtered(model, nodes, strength)
        rates.append([fastest_along_a_side(model, one, dt) for one in (layer, light(layer, stencil, dt))])
    filters, dampers = np.transpose(rates)
    print(filters, dampers)
    assert dampers.max() <= filters.max()


@pytest.mark.slow
@pytest.mark.parametrize("number", range(16))
def test_noise_decays_beside_light_dampers_where_layers_meet_in_space(number):
    """Thin and steep layers on all sides of a box of few nodes."""
    random = np.random.default_rng([SEED, number])
    name, share = str(random.choice(list(SCALARS))), float(random.uniform(0.3, 0.85))
    model = fh.Wave(SCALARS[name])
    stencil = model.stencil(1.0, 3)
    nodes = int(random.integers(2, 13))
    strengths = [1.4, 2.0, 4.0] + [5.6] * (steady_rise(stencil, nodes) not in (None, 0.75))
    steep = fh.LatticePML(nodes=nodes).make_layer(2, stencil, 1.0, 1.0, 0.0)
    layer = steep if random.random() < 0.3 else filtered(model, nodes, float(random.choice(strengths)))
    found = light(layer, stencil, share * step_limit(model, 3))
    print(f"seed {SEED}, number {number}: {name}, {nodes} nodes, step {share:.2f}, {found}")
    assert _growth(model, 3, found, share, 4000.0, number) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("nodes", "most"), [(4, 6e-6), pytest.param(8, 6e-7, marks=pytest.mark.slow)])
def test_light_dampers_send_next_to_nothing_of_resolved_pulses_back(nodes, most):
    """Beyond the error of a layer with a filter they add at most a quarter of the smallest target that uses dampers,
    corners included, over four crossings of waves of eight nodes.
    """
    model, half = fh.Wave(SCALARS["reach 3"]), 12.0
    lattice = fh.Lattice(1.0, (-half,) * 3, (half,) * 3)
    x, y, z = lattice.coordinates()
    u = np.exp(-((x - 3.0) ** 2 + (y + 2.0) ** 2 + z**2) * (np.pi / 8) ** 2)
    layer, dt = filtered(model, nodes, 2.0), 0.5 * step_limit(model, 3)
    sims = [
        fh.Simulation(lattice, model, fh.LatticePML(nodes=nodes, profile=one), {"u": u}, dt=dt, threads=1)
        for one in (layer, light(layer, model.stencil(1.0, 3), dt))
    ]
    last = int(8 * half / dt)
    infinite, errors = InfiniteLattice(sims[0].stencil, 1.0, model.integrator, dt, last, u), [0.0, 0.0]
    for step in np.linspace(0, last, 9).astype(int)[1:].tolist():
        exact = infinite.after(step)
        for i, sim in enumerate(sims):
            sim.step(step - sim.step_count)
            errors[i] = max(errors[i], float(np.abs(sim.fields["u"] - exact).max()))
    print(errors)
    assert errors[0] < most
    assert errors[1] < errors[0] + 1e-5 / 4
