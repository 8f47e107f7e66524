"""The commutator of a stencil with a box, against its two products computed separately."""

import numpy as np
import pytest

from farhorizon.medium.shell import Shell
from farhorizon.medium.stencil import Stencil
from farhorizon.medium.stratified_medium import StratifiedMedium
from helpers import kernel_stencil, roll_apply


def _vectors():
    """Random matrices without any symmetry except that of a stencil."""
    random = np.random.default_rng(20261123)
    offsets = np.array([(1, 0), (0, 1), (2, -1)])
    weights = random.normal(size=(3, 2, 2))
    return Stencil(np.concatenate([offsets, -offsets]), np.concatenate([weights, weights.swapaxes(1, 2)]))


@pytest.mark.parametrize("stencil", [kernel_stencil(2, 3), _vectors(), kernel_stencil(3, 1), kernel_stencil(1, 2)])
def test_forces_are_those_of_both_products(stencil):
    shape, first = (17, 15, 13)[: stencil.dim], np.array((5, 4, 5)[: stencil.dim])
    last = first + (5, 6, 2)[: stencil.dim]
    shell = Shell(stencil, first, last)
    inside = np.zeros(shape)
    inside[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))] = 1
    u = np.random.default_rng(1).normal(size=(stencil.components, *shape))
    field = u if stencil.components > 1 else u[0]
    force = roll_apply(inside * field, stencil.offsets, stencil.weights)
    force -= inside * roll_apply(field, stencil.offsets, stencil.weights)
    at = (..., *shell.nodes.T)
    found = (shell.commutator @ u[at].ravel()).reshape(-1, len(shell.nodes))
    np.testing.assert_allclose(found, force.reshape(u.shape)[at], atol=1e-13)
    force[at] = 0
    assert np.abs(force).max() < 1e-13
    np.testing.assert_array_equal(shell.inside, inside[tuple(shell.nodes.T)] == 1)


def test_of_nodes_that_do_not_exist_nothing_is_asked():
    """A box that extends beyond the last row is open there: the forces are those without the bonds through it."""
    stencil, shape = kernel_stencil(2, 2), (14, 12)
    shell = Shell(stencil, (4, 5), (9, 13), StratifiedMedium(stencil, 1, 1, 11))
    assert shell.nodes.max(0).tolist() == [11, 11] and (shell.nodes >= 0).all()
    inside = np.zeros(shape)
    inside[4:10, 5:] = 1
    u = np.random.default_rng(2).normal(size=shape)

    def applied(field):
        """The operator with absent bonds, node by node."""
        found = np.zeros(shape)
        for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
            for node in np.ndindex(shape):
                other = np.add(node, offset)
                if ((other >= 0) & (other < shape)).all():
                    found[node] += weight * (field[tuple(other)] - field[node])
        return found

    force = applied(inside * u) - inside * applied(u)
    at = tuple(shell.nodes.T)
    np.testing.assert_allclose(shell.commutator @ u[at], force[at], atol=1e-13)
    force[at] = 0
    assert np.abs(force).max() < 1e-13
