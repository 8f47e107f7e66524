"""The exact field around a semi-infinite crack in the square lattice, against the equations of its nodes."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from farhorizon.validation import lattice_crack


def equations(size, omega):
    """Matrix of ``-omega^2 u - (differences over bonds)`` on a square of so many nodes to either side, fixed around,
    without the cut bonds.
    """
    axis = np.arange(-size, size + 1)
    x, y = (z.ravel() for z in np.meshgrid(axis, axis, indexing="ij"))
    numbers = np.arange(x.size).reshape(axis.size, axis.size)
    right = numbers[:-1].ravel(), numbers[1:].ravel()
    above = numbers[:, :-1].ravel(), numbers[:, 1:].ravel()
    whole = ~((y[above[0]] == -1) & (x[above[0]] <= 0))
    start, end = (np.concatenate([a, b[whole]]) for a, b in zip(right, above, strict=True))
    bonds = sparse.coo_array((np.ones(start.size), (start, end)), shape=(x.size, x.size)).tocsr()
    ends = 4.0 * np.ones(x.size) - np.bincount(np.concatenate([a[~whole] for a in above]), minlength=x.size)
    force = ((x, y) == np.array(lattice_crack.SOURCE)[:, None]).all(0).astype(float)
    return axis, sparse.diags_array(ends - omega**2) - bonds - bonds.T, force


@pytest.mark.parametrize("omega", [0.75, 1.25])
def test_every_node_obeys_its_equation(omega):
    axis, matrix, force = equations(16, omega)
    field = lattice_crack.from_source(axis, axis, omega) + lattice_crack.from_crack(axis, axis, omega)
    left = (matrix @ field.ravel() - force).reshape(axis.size, axis.size)
    assert np.abs(left[1:-1, 1:-1]).max() < 1e-10


def test_a_damped_wave_is_that_of_a_lattice_so_large_that_nothing_comes_back():
    """The frequency has an imaginary part: over the 22 nodes from the source to the edge waves fall to 1e-9."""
    omega = 0.7 + 1.0j
    axis, matrix, force = equations(31, omega)
    wanted = spsolve(matrix.tocsc(), force.astype(complex)).reshape(axis.size, axis.size)
    field = lattice_crack.from_source(axis, axis, omega) + lattice_crack.from_crack(axis, axis, omega)
    assert np.abs(field - wanted).max() < 1e-8 * np.abs(wanted).max()
