"""Shape tensors of nodes whose bonds break: faces, and a bound on the remaining stiffness."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine.shape_tensors import FACE, SINGULAR, harmonic_eigenvalue, inverse_shapes, stress_left

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))


def bonds(dim, reach=3.0, exponent=1):
    """The bonds of a node, and the contribution of each to its shape tensor."""
    model = fh.Elastic(fh.Kernel(reach, exponent), 1.0, 0.25, material="correspondence")
    states = model.force_states(1.0, dim)
    return states.offsets, states.shapes


@pytest.mark.parametrize("dim", [2, 3])
def test_nodes_on_flat_faces_bear_all_of_their_stress(dim):
    """For any orientation of a face through the node, either a bond or its opposite is present, so that half of the
    tensor remains.
    """
    rng = np.random.default_rng(SEED)
    print(f"seed {SEED}")
    offsets, shapes = bonds(dim)
    assert harmonic_eigenvalue(shapes.sum(0)[None]) == pytest.approx(1.0)
    for normal in rng.normal(size=(20, dim)):
        face = shapes[offsets @ normal < 0].sum(0)[None]
        assert harmonic_eigenvalue(face) == pytest.approx(FACE)
        np.testing.assert_allclose(stress_left(face, np.ones(1)), 1.0, rtol=1e-12)
        assert stress_left(face / 2, np.ones(1)) == pytest.approx(0.25)
        assert stress_left(face / 2, harmonic_eigenvalue(face)) == pytest.approx(
            1.0
        )  # a face that was there from the start


@pytest.mark.parametrize("dim", [2, 3])
def test_no_node_becomes_stiff_as_it_loses_its_bonds(dim):
    """The stress acts through the inverse shape tensor twice, which grows without bound; the factor on the stress
    compensates for that.
    """
    rng = np.random.default_rng(SEED)
    print(f"seed {SEED}")
    offsets, shapes = bonds(dim)
    most, bare = 0.0, 0.0
    for _ in range(20):
        order = rng.permutation(len(offsets))
        left = np.cumsum(shapes[order], axis=0)[dim:]  # from few bonds to all of them
        twice = np.linalg.norm(inverse_shapes(left), 2, axis=(1, 2)) ** 2
        factor = stress_left(left, np.ones(len(left)))
        spans = np.linalg.det(left) > SINGULAR
        assert (np.diff(factor[spans]) >= -1e-12).all() and ((factor >= 0) & (factor <= 1)).all()
        assert (twice[~spans] == 0).all()  # no gradient, no stress
        most, bare = max(most, (factor * twice).max()), max(bare, twice.max())
    assert most <= (dim / FACE) ** 2 * (1 + 1e-12) < bare
