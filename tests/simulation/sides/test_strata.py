"""Solids of several Poisson's ratios beside layers: what the layers are made for, and that nothing grows in them."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.simulation.assembly import shared, survey
from threads_as_processes import on_threads

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))
SEDIMENT = {"bulk": 0.763, "shear": 0.0520, "density": 1.0}  # nu = 0.47: water-saturated ground
ROCK = {"bulk": 2.04, "shear": 1.149, "density": 1.22}  # nu = 0.26


def layered(top, bottom, where, axis=1):
    """Constants of two half-spaces, and a function of the coordinates for each."""
    return {name: lambda *x, a=top[name], b=bottom[name]: np.where(x[axis] > where, a, b) for name in top}


def strata(constants, boundary, half=14, kernel=None, material="state-based", rng=None):
    """White noise in a square."""
    lattice = fh.Lattice(1.0, (-half, -half), (half, half))
    model = fh.Elastic(kernel or fh.Kernel(2.0, exponent=1), material=material, **constants)
    noise = np.random.default_rng(1 if rng is None else rng).standard_normal((2, *lattice.shape))
    return fh.Simulation(lattice, model, boundary, {"u": noise})


def size(sim):
    return float(np.sqrt((sim.fields["u"] ** 2).mean()))


@pytest.mark.parametrize("top", [None, fh.Free(), fh.Fixed()], ids=["open", "free", "fixed"])
def test_noise_in_a_sediment_on_rock_decays(top):
    """With layers that are made for the rock it grows e-fold in about two crossings of the square."""
    boundary = {"all": fh.LatticePML(nodes=16)} | ({} if top is None else {"y+": top})
    sim = strata(layered(SEDIMENT, ROCK, 0.0), boundary)
    sizes = []
    for crossings in (5, 20):
        sim.run(crossings * sim.crossing, allow_unstable=True)
        sizes.append(size(sim))
    assert sizes[1] < sizes[0] < 1, sizes


def test_layers_are_made_for_the_most_nearly_incompressible_medium_at_their_sides():
    """Wherever it is at the sides with layers, on any number of processes; not for one that no layer continues."""
    soft, hard = ({name: solid[name] for name in ("bulk", "shear")} for solid in (SEDIMENT, ROCK))
    alone, rock = (
        fh.Elastic(fh.Kernel(2.0, exponent=1), material="state-based", **solid).medium(1.0, 2) for solid in (soft, hard)
    )
    layers = fh.LatticePML(nodes=8)
    inclusion = {name: lambda x, y, n=name: np.where(x**2 + y**2 < 16, soft[n], hard[n]) for name in soft}
    low = {"all": layers, "y+": fh.Fixed()}
    for constants, boundary, stencil in (
        (layered(soft, hard, 10.0), layers, alone),
        (layered(hard, soft, 10.0), layers, alone),
        (inclusion, layers, rock),
        (layered(soft, hard, 11.0), low | {"x": fh.Fixed()}, rock),
    ):
        sim = strata(constants, boundary)
        assert np.abs(sim.parts.near.continued.weights - stencil.weights).max() < 1e-12 * np.abs(stencil.weights).max()
        for weights in on_threads(2, lambda group, setup=sim.setup: _continued(setup, group)):
            np.testing.assert_allclose(weights, stencil.weights, rtol=0, atol=1e-12 * np.abs(stencil.weights).max())


def _continued(setup, group):
    subdomain, _ = shared(setup, group, None)
    return survey(subdomain.setup, 1.0, group, subdomain).near.continued.weights


def random_strata(rng):
    """Two solids one above the other, with nu from 0 to 0.49 and contrasts up to ten."""
    young, density = 10 ** rng.uniform(-0.5, 0.5, (2, 2))
    poisson = rng.uniform(0, 0.49, 2)
    solids = [{"young": e, "poisson": nu, "density": d} for e, nu, d in zip(young, poisson, density, strict=True)]
    kernel = fh.Kernel(float(rng.choice([2.0, 3.0])), exponent=int(rng.integers(3)))
    tops = {"free": fh.Free(), "fixed": fh.Fixed(), "open": None}
    top = str(rng.choice(list(tops)))
    boundary = {"all": fh.LatticePML(nodes=int(rng.choice([8, 12, 16, 24])))}
    boundary |= {} if tops[top] is None else {"y+": tops[top]}
    words = f"{solids}, {kernel}, {top}, {boundary['all'].nodes} nodes"
    return words, layered(*solids, rng.uniform(-8, 8)), boundary, kernel


@pytest.mark.parametrize("number", [pytest.param(n, marks=[pytest.mark.slow] if n > 1 else []) for n in range(50)])
def test_random_strata_do_not_grow_or_are_refused(number):
    """In a run of a hundred crossings."""
    rng = np.random.default_rng([SEED, number])
    words, constants, boundary, kernel = random_strata(rng)
    print(f"seed {SEED}, {number}: {words}")
    sim = strata(constants, boundary, 10, kernel, rng=rng)
    try:
        sim.run(100 * sim.crossing)
    except fh.InputError as refusal:
        assert "not stable" in str(refusal)
        print(refusal)
        return
    assert size(sim) < 1.0, words
