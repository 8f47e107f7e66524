"""Power through surfaces in materials whose forces follow from states: the state of each node, after its law, as a
matrix, and the power that bonds carry by it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.recorders.flux import is_cut


class NodeStates(NamedTuple):
    """States of some nodes, after the law of each node, as sums over displacements.

    Attributes
    ----------
    nodes : ndarray of int, shape (E,)
        Flat numbers in the lattice, sorted.
    known : ndarray of bool, shape (E, dim)
        Whether all displacements that a state depends on lie in the near field, along each axis.
    owners : ndarray of int, shape (T,)
        For each term, the index in `nodes` of the node whose state it belongs to.
    places : ndarray of int, shape (T,)
        For each term, the flat number of the node whose displacement it multiplies.
    terms : ndarray, shape (T, n, components)
        Matrices that multiply these displacements.
    """

    nodes: np.ndarray
    known: np.ndarray
    owners: np.ndarray
    places: np.ndarray
    terms: np.ndarray

    def knows(self, ends: np.ndarray) -> np.ndarray:
        """For bonds with ends of shape (bonds, 2), whether the states of both ends are known, along each axis."""
        return np.asarray(self.known[np.searchsorted(self.nodes, ends)].all(1))

    def form(self, nodes: np.ndarray, ends: np.ndarray, pushes: np.ndarray) -> csr_array:
        """Return the matrix A of ``u . A w = sum over bonds of 2 (w_x . D p_y(u) + w_y . D p_x(u))``.

        Parameters
        ----------
        nodes : ndarray of int, shape (N,)
            Nodes on which u and w are given, sorted; vectors are ordered node by node.
        ends : ndarray of int, shape (bonds, 2)
            The nodes x and y of each bond.
        pushes : ndarray, shape (bonds, components, n)
            The matrix D of each bond.
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
    """Return a sparse matrix of blocks, given their values, of shape (count, n, c), and their block rows and
    columns.
    """
    _, n, c = values.shape
    row = np.broadcast_to((n * rows)[:, None, None] + np.arange(n)[:, None], values.shape)
    column = np.broadcast_to((c * columns)[:, None, None] + np.arange(c), values.shape)
    return csr_array((values.ravel(), (row.ravel(), column.ravel())), shape=shape)


def states_at(parts: Parts, nodes: np.ndarray) -> NodeStates:
    """Return the states of some nodes of the lattice, given by their sorted flat numbers; each process contributes
    those of its own nodes.
    """
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
        present = (
            exists[here] & exists[other] & ~is_cut(engine.tables.gradient_pass.cuts, engine.layout.size, here, other)[0]
        )
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
