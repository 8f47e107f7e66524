"""The exact fields around a semi-infinite crack and a semi-infinite rigid line in the square lattice, against the
equations of the nodes.
"""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from farhorizon.validation import lattice_diffraction


def equations(size, omega, obstacle):
    """Axis, matrix and force of ``-omega^2 u - (differences over bonds) = force`` on a square with `size` nodes to
    either side, fixed all around: without the cut bonds, or with held nodes, whose equation is ``u = 0``.
    """
    axis = np.arange(-size, size + 1)
    x, y = (z.ravel() for z in np.meshgrid(axis, axis, indexing="ij"))
    numbers = np.arange(x.size).reshape(axis.size, axis.size)
    right = numbers[:-1].ravel(), numbers[1:].ravel()
    above = numbers[:, :-1].ravel(), numbers[:, 1:].ravel()
    whole = ~((y[above[0]] == -1) & (x[above[0]] <= 0)) if obstacle == "crack" else np.ones(above[0].size, bool)
    start, end = (np.concatenate([a, b[whole]]) for a, b in zip(right, above, strict=True))
    bonds = sparse.coo_array((np.ones(start.size), (start, end)), shape=(x.size, x.size)).tocsr()
    ends = 4.0 * np.ones(x.size) - np.bincount(np.concatenate([a[~whole] for a in above]), minlength=x.size)
    force = ((x, y) == np.array(lattice_diffraction.SOURCE)[:, None]).all(0).astype(float)
    matrix = sparse.diags_array(ends - omega**2) - bonds - bonds.T
    if obstacle == "line":
        held = ((y == 0) & (x <= 0)).astype(float)
        matrix = sparse.diags_array(1 - held) @ matrix + sparse.diags_array(held)
    return axis, matrix, force


def exact(axis, omega, obstacle):
    added = {"crack": lattice_diffraction.from_crack, "line": lattice_diffraction.from_line}[obstacle]
    return lattice_diffraction.from_source(axis, axis, omega) + added(axis, axis, omega)


@pytest.mark.parametrize("obstacle", ["crack", "line"])
@pytest.mark.parametrize("omega", [0.75, 1.25])
def test_every_node_obeys_its_equation(omega, obstacle):
    axis, matrix, force = equations(16, omega, obstacle)
    left = (matrix @ exact(axis, omega, obstacle).ravel() - force).reshape(axis.size, axis.size)
    assert np.abs(left[1:-1, 1:-1]).max() < 1e-10


@pytest.mark.parametrize("obstacle", ["crack", "line"])
def test_a_damped_wave_is_that_of_a_lattice_so_large_that_nothing_comes_back(obstacle):
    """The frequency has an imaginary part: over the 22 nodes from the source to the edge waves decay to 1e-9."""
    omega = 0.7 + 1.0j
    axis, matrix, force = equations(31, omega, obstacle)
    wanted = spsolve(matrix.tocsc(), force.astype(complex)).reshape(axis.size, axis.size)
    assert np.abs(exact(axis, omega, obstacle) - wanted).max() < 1e-8 * np.abs(wanted).max()
