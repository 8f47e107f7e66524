"""Factors on the bonds of nodes that lack some: energies are those of all bonds."""

import numpy as np
import pytest

from farhorizon import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.medium.surface import excess, products


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("lost", ["a half-space", "a corner", "an oblique half-space"])
def test_energies_of_unit_stretches_are_those_inside_the_solid(dim, lost):
    """Summed over the bonds, for stretches along each axis, and along two at once."""
    offsets, weights = Stencil.family(Kernel(3.0, 1), 1.0, dim)
    energies = weights * (offsets**2).sum(1)
    normal = np.eye(dim)[0] if lost != "an oblique half-space" else np.arange(1.0, dim + 1)
    present = offsets @ normal <= 0
    if lost == "a corner":
        present &= offsets[:, -1] >= 0
    (numbers,) = excess(present[None], energies, products(offsets))
    factors = 1 + products(offsets) @ numbers
    assert factors[present].min() > 0
    directions = (offsets / np.linalg.norm(offsets, axis=1)[:, None]) ** 2
    for first, second in [(a, b) for a in range(dim) for b in range(dim)]:
        strain = np.zeros(dim)
        strain[[first, second]] = 1.0
        of_bonds = energies * (directions @ strain) ** 2
        assert factors[present] @ of_bonds[present] == pytest.approx(of_bonds.sum(), rel=1e-10)


def test_nothing_changes_where_nothing_is_lacking_and_nothing_can_be_done():
    offsets, weights = Stencil.family(Kernel(2.0, 1), 1.0, 2)
    families = np.array([np.ones(len(offsets), bool), np.zeros(len(offsets), bool)])
    np.testing.assert_allclose(excess(families, weights, products(offsets)), 0.0, atol=1e-13)


def test_no_bond_becomes_negative():
    """A node at the tip of a wedge, whose few bonds cannot store what all do."""
    offsets, weights = Stencil.family(Kernel(4.0, 1), 1.0, 2)
    wedge = offsets[:, 0] > 2 * np.abs(offsets[:, 1])
    cosines = products(offsets)
    (numbers,) = excess(wedge[None], weights * (offsets**2).sum(1), cosines)
    assert (1 + cosines[wedge] @ numbers).min() > -1e-12
