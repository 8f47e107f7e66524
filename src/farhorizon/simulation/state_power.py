"""Power through surfaces of materials whose forces follow from states: what the law of each node makes of its state, as
a matrix, and what the bonds between two nodes carry by it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.flux import is_cut


class NodeStates(NamedTuple):
    """The states of some nodes as sums over displacements, after the law of each node.

    Attributes
    ----------
    nodes : ndarray of int, shape (E,)
        Flat numbers in the lattice, in order.
    known : ndarray of bool, shape (E, dim)
        Whether all that a state follows from is in the near field, along each axis.
    owners : ndarray of int, shape (T,)
        Of each term the number of its node among these.
    places : ndarray of int, shape (T,)
        Of each term the node whose displacement it takes, a flat number.
    terms : ndarray, shape (T, n, components)
    """

    nodes: np.ndarray
    known: np.ndarray
    owners: np.ndarray
    places: np.ndarray
    terms: np.ndarray

    def knows(self, ends: np.ndarray) -> np.ndarray:
        """Of which bonds, ends of shape (bonds, 2), both states are known, along each axis."""
        return np.asarray(self.known[np.searchsorted(self.nodes, ends)].all(1))

    def form(self, nodes: np.ndarray, ends: np.ndarray, pushes: np.ndarray) -> csr_array:
        """The matrix A of ``u . A w = sum over bonds of 2 (w_x . D p_y(u) + w_y . D p_x(u))``.

        Parameters
        ----------
        nodes : ndarray of int, shape (N,)
            On which u and w are, in order; of vectors component by component of each node.
        ends : ndarray of int, shape (bonds, 2)
            x and y of each bond.
        pushes : ndarray, shape (bonds, components, n)
            D of each.
        """
        size, components = pushes.shape[2], pushes.shape[1]
        x, y = np.searchsorted(self.nodes, ends).T
        at_x, at_y = np.searchsorted(nodes, ends).T
        shape = size * len(self.nodes), components * len(nodes)
        made = _blocks(self.owners, np.searchsorted(nodes, self.places), self.terms, shape)
        both, of_state = np.concatenate([at_x, at_y]), np.concatenate([y, x])
        taken = _blocks(of_state, both, np.tile(2 * pushes.swapaxes(1, 2), (2, 1, 1)), shape)
        return csr_array(made.T @ taken)


def _blocks(rows: np.ndarray, columns: np.ndarray, values: np.ndarray, shape: tuple[int, int]) -> csr_array:
    """A matrix of blocks, shape (count, n, c), at their numbers along both axes."""
    _, n, c = values.shape
    row = np.broadcast_to((n * rows)[:, None, None] + np.arange(n)[:, None], values.shape)
    column = np.broadcast_to((c * columns)[:, None, None] + np.arange(c), values.shape)
    return csr_array((values.ravel(), (row.ravel(), column.ravel())), shape=shape)


def states_at(parts: Parts, nodes: np.ndarray) -> NodeStates:
    """The states of some nodes of the lattice (flat numbers, in order); each process looks at its own."""
    engine, near, lattice = parts.grid.engine, parts.near, parts.whole.near.lattice
    passes = engine.passes
    assert passes is not None
    sums, shape = passes.sums, np.array(lattice.shape)
    inside, own = near.lattice.own(nodes)
    here, index = parts.grid.nodes.ravel()[own], np.stack(np.unravel_index(nodes[inside], lattice.shape), -1)
    wraps = np.array([parts.whole.sides[a, -1].periodic for a in range(lattice.dim)])
    dim = sums.shapes.shape[1]
    shapes, known = np.zeros((len(here), dim, dim)), np.ones((len(here), lattice.dim), bool)
    bonds, exists = [], engine.absent.exists
    for k, offset in enumerate(engine.offsets):
        other = here + int(offset @ np.array(engine.core.stride))
        present = exists[here] & exists[other] & ~is_cut(engine.tables.gather.cuts, engine.layout.size, here, other)[0]
        there = index + offset[parts.grid.lead :]
        there = np.where(wraps, there % shape, there)
        within = (there >= 0) & (there < shape)
        known &= within | ~present[:, None]
        shapes += (exists[other] if sums.kept else present)[:, None, None] * sums.shapes[k]
        bonds.append((k, np.flatnonzero(present & within.all(1)), there))
    laws = sums.law(shapes, passes.moduli_at(here)) if len(here) else np.zeros((0, *sums.gradient.shape[1:2] * 2))
    owners, places, terms = [], [], []
    number = np.flatnonzero(inside)
    for k, found, there in bonds:
        term = laws[found] @ sums.gradient[k]
        for sign, ends in ((1.0, there[found]), (-1.0, index[found])):
            owners.append(number[found])
            places.append(np.ravel_multi_index(tuple(ends.T), lattice.shape))
            terms.append(sign * term)
    mine = number, known, *(np.concatenate(one) for one in (owners, places, terms))
    every = [np.concatenate(one) for one in zip(*parts.whole.team.gather(mine), strict=True)]
    found = np.zeros((len(nodes), lattice.dim), bool)
    found[every[0]] = every[1]
    return NodeStates(nodes, found, *every[2:])
