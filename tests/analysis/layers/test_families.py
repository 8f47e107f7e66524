"""Profiles of layers."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.layers.families import families, gently_damped, long_run_profile, short, steady_rise, thin
from farhorizon.analysis.layers.short_waves import high_pass
from farhorizon.checks.reduced_setups import plain_twin
from farhorizon.engine.state import State

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))


def test_scales_do_not_change_a_layer():
    thin_here, thin_there = thin(6, 2.0), thin(6, 2e-6)
    np.testing.assert_allclose(thin_here.sigma, 1e6 * thin_there.sigma, rtol=1e-14)
    np.testing.assert_allclose(
        long_run_profile(9, 2.0, 50.0, 12.0, 1e-5).alpha,
        1e6 * long_run_profile(9, 2e-6, 50e6, 12.0, 1e-5).alpha,
        rtol=1e-13,
    )


def test_late_layers_absorb_every_wave_of_a_run_as_their_bound_says():
    """On Re s = 1/T an edge reflects |C - a|/(C + a) of a wave with C = 1/(T Re lambda); the product over the edges
    stays below 1e-4.
    """
    until, distance, wanted = 3000.0, 15.0, 1e-4
    layer = long_run_profile(12, 1.0, until, distance, wanted)
    s = 1 / until + 1j * np.geomspace(1e-6, 0.6, 4000)
    for along in (0.0, 0.05, 0.3):
        decay = np.sqrt(s**2 + along**2)
        stretched = (1 + layer.sigma[:, None] / (s + layer.alpha[:, None])) * np.tanh(decay / 2)
        passed = np.abs((1 - stretched) / (1 + stretched)) ** 2
        passed[-1] **= 0.5
        felt = np.prod(passed, axis=0) * np.exp(-distance * decay.real)
        # the bound ignores the 1 of the stretch, which costs less than a factor of ten
        assert felt.max() < 10 * wanted


def test_weak_backward_waves_are_damped_gently():
    stencil = fh.Wave(fh.Kernel(3.0)).stencil(1.0, 3)
    damped = gently_damped(thin(6, 1.0), stencil)
    assert len(damped.taps) == 4 and 0 < damped.damping.max() < 0.1 * damped.sigma[-1]
    assert high_pass(fh.Wave(fh.Kernel(3.0)).stencil(1.0, 2)) is None
    assert not gently_damped(thin(6, 1.0), fh.Wave(fh.Kernel(3.0)).stencil(1.0, 2)).damping.size


def _of_noise_in_corners(kernel, nodes, strength, rise, share, end):
    """Size of the state in the last third of a run from white noise over that in the third before, where three layers
    meet and the other sides are fixed. Sizes are means over several times, because energy goes to and fro.
    """
    model = fh.Wave(kernel)
    reach = model.stencil(1.0, 3).reach[0]
    lattice = fh.Lattice(1.0, (0.0,) * 3, (2.0 * reach,) * 3)
    layer = gently_damped(thin(nodes, 1.0, rise, strength), model.stencil(1.0, 3))
    layers = dict.fromkeys(("x+", "y+", "z+"), fh.LatticePML(nodes=nodes, profile=layer))
    sides = layers | dict.fromkeys(("x-", "y-", "z-"), fh.Fixed())
    dt = share * fh.Simulation(lattice, model, fh.Fixed(), threads=1).step_limit
    state = State(plain_twin(fh.Simulation(lattice, model, sides, dt=dt, threads=1)).engine)
    now, sizes = np.random.default_rng(reach).standard_normal(state.size), []
    for _ in range(24):
        now = state.after_rounds(now, int(end / dt / state.every / 24))
        sizes.append(np.linalg.norm(now))
    return float(np.mean(sizes[16:]) / np.mean(sizes[8:16]))


def test_thick_layers_rise_steadily_where_they_meet_in_space():
    """Waves of the largest frequency stand still, and the corners of thin profiles with many nodes feed them. A ramp
    that begins more slowly prevents this.
    """
    kernel = fh.Kernel(3.0)
    stencil = fh.Wave(kernel).stencil(1.0, 3)
    rises = [steady_rise(stencil, nodes) for nodes in (2, 6, 7, 10, 11, 16, 17, 24, 25)]
    assert rises == [0.75, 0.75, 2.0, 2.0, 2.0, 2.0, None, None, None]
    assert steady_rise(fh.Wave(fh.Kernel(3.0)).stencil(1.0, 2), 40) == 0.75  # no backward waves


@pytest.mark.slow
def test_noise_grows_in_corners_of_thick_layers_unless_they_rise_steadily():
    kernel = fh.Kernel(3.0)
    assert _of_noise_in_corners(kernel, 16, 2.0, 0.75, 0.5, 210.0) > 3.0
    assert _of_noise_in_corners(kernel, 16, 3.0, 2.0, 0.5, 1350.0) < 1.0


#: Kernels in space of reach 2 to 4, three influences and two volumes, with weak backward waves.
WEAKLY_BACKWARD = (
    *(fh.Kernel(reach) for reach in (2.0, 3.0, 4.0)),
    *(fh.Kernel(2.0, 1, "linear", volume=volume) for volume in ("ramp", "full")),
    *(fh.Kernel(reach, 3, volume="full") for reach in (2.0, 3.0)),
    fh.Kernel(4.0, 0, "gaussian", volume="full"),
)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(12))
def test_layers_of_random_thickness_do_not_grow_where_they_meet_in_space(number):
    """Two waves that beat may rise for a third of the run although both decay. A run four times as long then decides,
    in which a growing wave has grown further.
    """
    random = np.random.default_rng([SEED, number])
    kernel, share = WEAKLY_BACKWARD[int(random.integers(len(WEAKLY_BACKWARD)))], float(random.uniform(0.3, 0.95))
    stencil = fh.Wave(kernel).stencil(1.0, 3)
    nodes = int(random.integers(3, 25))
    while (rise := steady_rise(stencil, nodes)) is None:
        nodes -= 1
    strength = float(random.choice([1.4, 2.0, 4.0] + [5.6] * (rise != 0.75)))
    print(f"seed {SEED}, set-up {number}: {kernel}, {nodes} nodes, strength {strength}, step {share:.2f}")
    given = kernel, nodes, strength, rise, share
    assert any(_of_noise_in_corners(*given, end) < 1.0 for end in (1350.0, 5400.0))


BACKWARD = {
    "elements": fh.Elastic(None, young=1.0, poisson=0.3, material="finite-element"),
    "bonds": fh.Elastic(fh.Kernel(2.0, 1), young=1.0),
    "linear": fh.Elastic(fh.Kernel(2.0, 1, "linear"), young=1.0),
    "states": fh.Elastic(fh.Kernel(2.0, 1), young=1.0, poisson=0.3, material="state-based"),
    "correspondence": fh.Elastic(fh.Kernel(2.0), young=1.0, poisson=0.2, material="correspondence", stabilisation=1.0),
}


@pytest.mark.parametrize("name", ["elements", *(pytest.param(n, marks=pytest.mark.slow) for n in list(BACKWARD)[1:])])
@pytest.mark.parametrize("share", [0.5, 0.95])
def test_short_damping_lets_no_noise_grow(name, share):
    """White noise in the whole state, near both ends of the range of steps, decays over the last third of a long
    run.
    """
    model = BACKWARD[name]
    stencil = model.stencil(1.0, 3)
    end = 2.0 * max(stencil.reach) + 2.0
    lattice, steps = fh.Lattice(1.0, (0.0,) * 3, (end,) * 3), 2400
    dt = share * fh.Simulation(lattice, model, fh.Fixed(), threads=1).step_limit
    assert short(4, stencil, 1.0) is not None
    for nodes in (4, 6) if name == "elements" else (4, 8, 12):
        layer = short(nodes, stencil, float(np.sqrt(model.coefficient)))
        if layer is None:
            continue
        sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=nodes, profile=layer), dt=dt, threads=1)
        state = State(plain_twin(sim).engine)
        before = state.after(np.random.default_rng(3).standard_normal(state.size), 2 * steps // 3)
        after = state.after(before, steps // 3)
        assert np.abs(after).max() < 0.9 * np.abs(before).max()


def test_what_short_filters_cannot_damp_has_no_short_layer():
    """Many nodes, and long backward waves, such as those of elements, for which the rate must be large."""
    elements = BACKWARD["elements"].stencil(1.0, 3)
    assert short(6, elements, 1.0) is not None and short(8, elements, 1.0) is None
    assert short(13, BACKWARD["linear"].stencil(1.0, 3), 1.0) is None


def names_of(model, dim, **more):
    given = {"late": None, "dt": 0.1, "steep": lambda nodes: None} | more
    return [family.name for family in families(model.stencil(1.0, dim), 1.0, 1.0, **given)]


def test_which_families_there_are():
    """No more than two for any medium: one that needs few nodes, and one for what this cannot do."""
    wave, late = fh.Wave(fh.Kernel(2.0)), {"late": lambda nodes: None}
    assert names_of(wave, 1) == ["steep"]
    assert names_of(wave, 2) == ["thin", "steep"] and names_of(wave, 2, **late) == ["thin", "late"]
    assert names_of(fh.Wave(fh.Kernel(5.0, influence="gaussian")), 2, **late) == ["thin", "steep"]  # late would grow
    assert names_of(BACKWARD["bonds"], 2) == ["tuned", "steep"]
    assert names_of(BACKWARD["bonds"], 2, dt=None) == ["steep"]
    assert names_of(BACKWARD["bonds"], 3) == ["tuned", "short", "steep"]
    assert names_of(fh.Wave(fh.Kernel(4.0, 1, "linear")), 2) == ["steep"]  # 40 % of its waves hardly move
    bare = fh.Elastic(fh.Kernel(2.0), young=1.0, poisson=0.3, material="correspondence")
    assert names_of(bare, 2) == ["steep"]  # zero-energy modes
