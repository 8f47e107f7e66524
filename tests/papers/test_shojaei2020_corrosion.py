"""Examples 2 and 3 of Shojaei et al. (2020): constants and nodes, and the layer against the infinite medium."""

from dataclasses import replace

import numpy as np
import pytest

from farhorizon import Kernel
from farhorizon.papers import REPRODUCTIONS
from farhorizon.papers.shojaei2020_corrosion import (
    CLOSURES,
    INTERFACE,
    LETTERS,
    LIQUID,
    SPHERE,
    asymmetry,
    follow,
    last_dissolution,
    outward_share,
)


def test_constants_are_those_of_exponent_two():
    """c_int is 4 / (pi horizon^2), the constant of a unit diffusivity in the plane (table 1, p = 2, to the digits
    printed); c_liq is ten times as large.
    """
    assert Kernel(0.04, 2).scaling_constant(2) == pytest.approx(INTERFACE, abs=0.01)
    assert LIQUID / INTERFACE == pytest.approx(10, rel=1e-6)


@pytest.mark.parametrize("example, printed", [(LETTERS, 31417), (SPHERE, 523155)])
def test_nodes(example, printed):
    """The near fields have the numbers of nodes printed in sections 5.2 and 5.3."""
    assert CLOSURES[0][1](example.spacing, example.region)["lattice"].nodes == printed


def test_small_letters():
    """At four times the spacing the layer meets its target, and nodes dissolve at the same steps as in the infinite
    medium; closed rims do neither.
    """
    example = replace(LETTERS, coarser=4)
    runs = example.closed()
    times = [0.0, 0.005, 0.01, 0.03, 0.1, 0.266]
    course = follow(example, runs, times, (0.1,))
    assert max(course.errors["LatticePML"]) < 1e-6  # the target
    assert course.shifted["LatticePML"] == (0, 0)
    assert course.errors["zero flux at the surface"][-1] > 1 and course.errors["zero value at the surface"][-1] > 0.5
    assert (np.diff(course.energies["LatticePML"]) < 0).all()
    balance = runs["LatticePML"].balance()
    assert abs(balance["residual"]) < 1e-12 * abs(balance["metal"])
    assert len(course.fields["infinite medium"]) == len(course.fields["LatticePML"]) == 1


def test_letters_dissolve_in_time_with_exponent_two_only():
    """They do so before t = 0.085, when the near field in the paper is almost empty; at four times the spacing."""
    times = [last_dissolution(replace(LETTERS, coarser=4, exponent=p)) for p in (2, 1)]
    assert times[0] < 0.085 < times[1]


def test_outward_share():
    """The share is 1 for a hill about 0, 0 for a bowl, and half for a slope."""
    axes = [np.arange(-10, 11) * LETTERS.spacing] * 2
    x, y = np.meshgrid(*axes, indexing="ij")
    disc = np.hypot(x, y) <= 9.5 * LETTERS.spacing
    shares = [
        outward_share(np.where(disc, u, np.nan), axes, LETTERS) for u in (-(x**2) - y**2, x**2 + y**2, x + 1e-3 * y)
    ]
    assert shares == [1.0, 0.0, 0.5]


def test_asymmetry():
    """A radial field has none; one with a bump has the height of the bump."""
    x = np.linspace(-1, 1, 9)
    u = np.add.outer(x**2, x**2)
    assert asymmetry(u) == 0
    u[1, 2] += 0.5
    assert asymmetry(u) == pytest.approx(0.5)


@pytest.mark.slow
def test_full_letters(tmp_path):
    """Example 2 at full size: 1e-5 of the current maximum at 0.076 and 0.266, and no node dissolves at another step."""
    outcome = REPRODUCTIONS.find("shojaei2020-ex2").run(tmp_path)
    found = {row.what: row.ours for row in outcome.rows}
    for time in ("0.076", "0.266"):
        assert found[f"t = {time}, LatticePML, largest error / largest concentration"] < 1e-5
    assert found["LatticePML, nodes that dissolve at another step than in the infinite medium"] == 0
    assert all(path.stat().st_size > 20_000 for path in outcome.pictures)


@pytest.mark.slow
def test_sphere(tmp_path):
    """Example 3 at twice the spacing: symmetric, and within the layer's target."""
    outcome = REPRODUCTIONS.find("shojaei2020-ex3").run(tmp_path)
    found = {row.what: row.ours for row in outcome.rows}
    assert found["LatticePML, largest asymmetry at the end"] < 1e-12
    assert outcome.infinite_error["LatticePML"] < 1e-6 < 1e-2 < outcome.infinite_error["zero flux at the surface"]
    assert all(path.stat().st_size > 20_000 for path in outcome.pictures)


@pytest.mark.slow
def test_full_sphere():
    """523 155 nodes with a layer: symmetric to 1e-12, with a mass balance, while a third of the metal dissolves."""
    sim = SPHERE.closed(1)["LatticePML"]
    sim.run(0.005, progress=False)
    assert asymmetry(sim.fields["u"]) < 1e-12
    balance = sim.balance()
    assert abs(balance["residual"]) < 1e-12 * abs(balance["metal"])
    assert sim.engine.nbytes < 2e9
