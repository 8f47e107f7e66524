"""Numbers of nodes beyond sides that extend the domain, given together with a target."""

import os
import re

import numpy as np
import pytest

import farhorizon as fh

SEED = int(os.environ.get("FARHORIZON_SEED", 20261128))
LATTICE = fh.Lattice(1.0, (-9.0, -6.0), (9.0, 6.0))
WAVE = fh.Wave(fh.Kernel(2.0))
BLOB = {"u": "exp(-((x - 1)**2 + y**2)/4)"}


def drawn(number):
    """A pulse off the centre of a box, its model and the end of the run."""
    random = np.random.default_rng([SEED, number])
    dim = int(random.integers(1, 3))
    lattice = fh.Lattice(1.0, (0.0,) * dim, random.integers(16, 40, dim) - 1.0)
    kernel = fh.Kernel(float(random.integers(2, 5)), int(random.integers(0, 3)))
    model = [fh.Wave(kernel), fh.Diffusion(kernel, 1.0), fh.Elastic(kernel, 1.0)][number % (2 if dim == 1 else 3)]
    centre = random.uniform(0.35, 0.65, dim) * np.array(lattice.shape)
    away = sum((x - c) ** 2 for x, c in zip(lattice.coordinates(), centre, strict=True))
    bell = np.where(away < 200, np.exp(-away / random.uniform(2.0, 4.0) ** 2), 0.0)
    data = np.stack([bell, -0.4 * bell]) if isinstance(model, fh.Elastic) else bell
    return lattice, model, {"u": data}, random.uniform(2, 4) * fh.Simulation(lattice, model, fh.Fixed()).crossing


@pytest.mark.sampled(3)
@pytest.mark.parametrize("number", range(12))
def test_what_returns_from_too_near_an_end_is_told(number):
    """With a part of the nodes that the target needs, against a domain from which nothing returns. What is told is for
    one side, rounded to one digit, and an upper bound where the field spreads along the side.
    """
    print(f"seed {SEED}, number {number}")
    lattice, model, data, until = drawn(number)
    share = np.random.default_rng([SEED, number, 1]).uniform(0.5, 0.9)
    needed = fh.Simulation(lattice, model, fh.Extended(1e-4, until=until), data).extents
    sides = {
        "xyz"[axis] + ("+" if side > 0 else "-"): fh.Extended(1e-4, int(share * extent.nodes), until)
        for (axis, side), extent in needed.items()
    }
    near, far = (
        fh.Simulation(lattice, model, boundary, data, threads=1)
        for boundary in (sides, fh.Extended(1e-11, until=until))
    )
    predicted = [float(re.search(r"up to (\S+) of the largest value may return", text)[1]) for text in near.doubts]
    worst = 0.0
    while near.time < until:
        near.step(2)
        far.step(2)
        exact = np.array(far.fields["u"])
        size = np.abs(exact).max() if model.order == 1 else np.abs(data["u"]).max()
        worst = max(worst, float(np.abs(near.fields["u"] - exact).max() / size))
    assert worst < 1.5 * 2 * lattice.dim * max(predicted)
    assert lattice.dim > 1 or worst > max(predicted) / 10  # the front of a wave is steep


def test_the_number_that_a_warning_names_meets_the_target():
    sides = {"x": fh.Extended(1e-4, 3, 30.0), "y": fh.Extended(1e-4, until=30.0)}
    sim = fh.Simulation(LATTICE, WAVE, sides, BLOB)
    (doubt,) = sim.doubts
    assert doubt in sim.notes and "extended domain of 3 nodes (x-, x+)" in doubt and "the target 0.0001" in doubt
    enough = int(re.search(r"; (\d+) nodes would meet it", doubt)[1])
    assert not fh.Simulation(LATTICE, WAVE, sides | {"x": fh.Extended(1e-4, enough, 30.0)}, BLOB).doubts


def test_nodes_are_taken_where_no_domain_meets_the_target():
    """The domain that the target needs would be refused; the one that is given is small."""
    sim = fh.Simulation(LATTICE, WAVE, fh.Extended(1e-4, 3, 1e5), BLOB)
    (doubt,) = sim.doubts
    assert doubt.endswith("no domain that fits into memory meets it")


@pytest.mark.parametrize("side", [fh.Extended(nodes=3, until=30.0), fh.Extended(1e-4, 3)])
def test_nodes_without_a_target_or_an_end_are_taken_as_they_are(side):
    sim = fh.Simulation(LATTICE, WAVE, side, BLOB)
    assert not sim.doubts and {extent.nodes for extent in sim.extents.values()} == {3}
