"""Factors by which bonds near surfaces are stiffened: against a count node by node, beside layers, and bad input."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.medium.stencil import Stencil


def counted(lattice, model, exists):
    """Return the factor of each node, counted bond by bond; `exists` tells from its indices whether a node exists."""
    offsets, weights = Stencil.family(model.kernel, lattice.spacing, lattice.dim)
    found = np.ones(lattice.shape)
    for node in np.ndindex(lattice.shape):
        there = [exists(np.array(node) + offset) for offset in offsets]
        if exists(np.array(node)) and any(there):
            found[node] = weights.sum() / weights[there].sum()
    return found


@pytest.mark.parametrize("material", [{}, {"material": "state-based", "poisson": 0.3}], ids=["bonds", "states"])
def test_each_node_is_made_up_for_what_it_lacks(material):
    """A corner of two free sides, and sides beyond which the medium continues, in the plane and in space; a hole."""
    model = fh.Elastic(fh.Kernel(1.0, 1), 1.0, **material)
    plane = fh.Lattice(0.5, (0.0, 0.0), (4.0, 4.5))
    found = fh.surface_factor(plane, model, {"x-": fh.LatticePML(), "x+": fh.Free(), "y-": fh.Fixed(), "y+": fh.Free()})
    np.testing.assert_allclose(found, counted(plane, model, lambda at: (at < plane.shape).all()), rtol=1e-12)
    space = fh.Lattice(0.5, (0.0, 0.0, 0.0), (2.5, 2.0, 2.5))
    found = fh.surface_factor(space, model, {"x": fh.Periodic(), "y": fh.Free(), "z": fh.LatticePML()})
    np.testing.assert_allclose(found, counted(space, model, lambda at: 0 <= at[1] < 5), rtol=1e-12)
    body = fh.Lattice(0.5, (0.0, 0.0), (4.5, 4.5), body=fh.Box((-1, -1), (6, 6)) - fh.Disc(1.1, (2.0, 0.3)))

    def inside(at):
        x, y = at % 10 if 0 <= at[1] < 10 else (0, -1)  # periodic along x
        return y >= 0 and body.mask[x, y]

    found = fh.surface_factor(body, model, {"x": fh.Periodic(), "y": fh.Free()})
    np.testing.assert_allclose(found, counted(body, model, inside), rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("material", [{}, {"material": "state-based", "poisson": 0.3}], ids=["bonds", "states"])
def test_a_corrected_surface_runs_into_layers(material):
    """Against a box three times as wide, a pulse at the corrected surface leaves an error that is at most half as
    large again as at the uncorrected one.
    """
    errors = {}
    for corrected in (False, True):
        found = []
        for half in (15.0, 45.0):
            lattice = fh.Lattice(1.0, (-half, -half), (half, 0.0))
            model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, **material)
            sides = {"all": fh.LatticePML(nodes=20), "y+": fh.Free()}
            young = fh.surface_factor(lattice, model, sides) if corrected else np.ones(lattice.shape)
            start = {"u": [0.0, "exp(-(x**2 + (y + 3)**2)/9)"]}
            sim = fh.Simulation(lattice, model.with_constants({"young": young}), sides, start, dt=0.4)
            sim.run(80.0, allow_unstable=True, progress=False)
            middle = int(half - 15)
            found.append(sim.fields["u"][:, middle : middle + 31, -16:])
        errors[corrected] = np.abs(found[0] - found[1]).max()
    print(errors)
    assert errors[True] < 1.5 * errors[False] < 1e-3


def test_bad_input():
    plane = fh.Lattice(0.5, (0.0, 0.0), (4.0, 4.5))
    for model, words in (
        (fh.Elastic(fh.Kernel(1.0), 1.0, 0.3, material="correspondence"), "not softer"),
        (fh.Wave(fh.Kernel(1.0)), "an Elastic model"),
    ):
        with pytest.raises(fh.InputError, match=words):
            fh.surface_factor(plane, model, fh.Free())
