"""The operator of a medium that ends at a free side, against the forces in a run."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.medium.stratified_medium import StratifiedMedium

_SOLIDS = {
    "bonds": fh.Elastic(fh.Kernel(2.5), 1.0),
    "states": fh.Elastic(fh.Kernel(2.0), 1.0, poisson=0.4, material="state-based"),
    "correspondence": fh.Elastic(fh.Kernel(2.0), 1.0, poisson=0.3, material="correspondence"),
    "stabilised": fh.Elastic(fh.Kernel(2.0), 1.0, poisson=0.1, material="correspondence", stabilisation=0.5),
}


@pytest.mark.parametrize(
    ("dim", "axis", "side"), [(2, 0, -1), (2, 1, 1), pytest.param(3, 1, 1, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("name", _SOLIDS)
def test_forces_are_those_of_a_run(name, dim, axis, side):
    """For random displacements, zero near all other sides."""
    model, half = _SOLIDS[name], 7 if dim == 2 else 6
    lattice = fh.Lattice(1.0, (-half,) * dim, (half,) * dim)
    end = StratifiedMedium(
        model.stencil(1.0, dim), axis, side, 2 * half if side > 0 else 0, model.force_states(1.0, dim)
    )
    far = np.max([side * x if a == axis else np.abs(x) for a, x in enumerate(lattice.coordinates())], axis=0)
    inner = np.max([-side * x if a == axis else np.abs(x) for a, x in enumerate(lattice.coordinates())], axis=0) <= 2
    assert far.max() == half
    u = np.random.default_rng(20261125).normal(size=(dim, *lattice.shape)) * inner
    sides = {"all": fh.Free()}
    sim = fh.Simulation(lattice, model, sides, {"u": u}, threads=1)
    wanted = sim.engine.core.view(sim.engine.apply(sim.engine.current.copy())).reshape(u.shape)
    nodes = np.argwhere(inner)
    around = nodes[:, None] + end.offsets
    there = ((around >= 0) & (around < np.array(lattice.shape))).all(-1)
    at = np.where(there[..., None], around, 0)
    stretch = np.where(there, u[:, *np.moveaxis(at, -1, 0)], 0) - u[:, *nodes.T][:, :, None]
    found = model.coefficient * np.einsum("nkab,bnk->an", end.weights_at(nodes), stretch)
    np.testing.assert_allclose(found, wanted[:, *nodes.T], rtol=0, atol=1e-13 * np.abs(wanted).max())


@pytest.mark.parametrize("name", _SOLIDS)
def test_what_one_node_feels_of_another_this_feels_of_it(name):
    """The operator is symmetric, row by row."""
    model = _SOLIDS[name]
    end = StratifiedMedium(model.stencil(1.0, 2), 1, 1, 0, model.force_states(1.0, 2))
    known = {tuple(o): k for k, o in enumerate(end.offsets.tolist())}
    last = len(end.weights) - 1
    for row in range(last + 1):
        for (x, y), k in known.items():
            if row - y >= 0:
                back = end.weights[min(row - y, last), known[-x, -y]]
                np.testing.assert_allclose(back, end.weights[row, k].T, rtol=0, atol=1e-14)
            else:
                assert not end.weights[row, k].any()
