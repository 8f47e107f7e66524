"""The power that forces on a lattice radiate in each wave, against closed forms."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.radiation import all_around, powers_sent
from farhorizon.analysis.references.infinite_lattice import Scheme
from farhorizon.medium.integrators import Verlet


@pytest.mark.parametrize("dim", [2, 3])
def test_sums_over_all_directions_are_integrals(dim):
    """Sums of polynomials: even powers of a coordinate have the means 1/dim and 3/(dim (dim + 2))."""
    rays, weights = all_around(dim, 6)
    whole = 2 * np.pi * (dim - 1)
    assert weights.sum() == pytest.approx(whole, rel=1e-14)
    np.testing.assert_allclose(weights @ rays**2, whole / dim, rtol=1e-13)
    np.testing.assert_allclose(weights @ rays**4, 3 * whole / (dim * (dim + 2)), rtol=1e-13)


@pytest.mark.parametrize("dim", [2, 3])
def test_powers_of_p_and_s_waves_of_a_point_force_converge_to_the_closed_form(dim):
    """Stokes' solution, with the dyads of P and S averaged over all directions: k / (4 pi c^2), in the plane 1 / (4
    c^2), of which P waves carry one part in dim; central forces have c_P^2 = 3 c_S^2. The convergence is of second
    order in the spacing.
    """
    stencil = fh.Elastic(fh.Kernel(2.0, 1, "linear"), 1.0).stencil(1.0, dim)
    scheme, errors = Scheme.of(stencil, 1.0, Verlet(), 0.1), []
    force = np.random.default_rng(20261123).normal(size=(dim, 1))
    for k in (0.2, 0.1, 0.05):  # wavenumbers of P waves
        found = powers_sent(scheme, k**2, np.zeros((1, dim)), force) / (force**2).sum()
        p, s = (c**-2 * (k / c / (4 * np.pi) if dim == 3 else 0.25) for c in (1.0, 3**-0.5))
        errors.append(np.abs(found / [p / dim, s * (dim - 1) / dim] - 1).max())
    assert -np.polyfit([0, 1, 2], np.log2(errors), 1)[0] == pytest.approx(2, abs=0.15), errors
