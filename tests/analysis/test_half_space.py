"""The half-infinite lattice against the half-space of the continuum, and its balance of energy."""

import numpy as np
import pytest
from scipy.optimize import brentq

import farhorizon as fh
from farhorizon.analysis.half_space import HalfSpace
from farhorizon.medium.free_side import FreeSide

_SOLID = fh.Elastic(fh.Kernel(2.5, influence="linear", exponent=1), young=1.0)  # P speed 1 in units of the stencil


_SOLIDS = {
    "bonds": _SOLID,
    "states": fh.Elastic(fh.Kernel(2.0), 1.0, 0.4, material="state-based"),
    "correspondence": fh.Elastic(fh.Kernel(2.0), 1.0, 0.1, material="correspondence", stabilisation=0.4),
}


def _half_space(dim=2, side=1, solid=_SOLID):
    return HalfSpace(FreeSide(solid.medium(1.0, dim), dim - 1, side, states=solid.force_states(1.0, dim)))


def _arriving(half_space, wavevector, number):
    """Squared frequency, tangential wavenumbers, factor per node upwards and displacement of a plane wave; type 0 is
    P.
    """
    values, vectors = np.linalg.eigh(half_space.stencil.symbol(*wavevector))
    order = np.argsort(-np.abs(vectors.T @ wavevector))
    one = order[0] if number == 0 else np.sort(order[1:])[number - 1]
    up = np.exp(1j * half_space.side * wavevector[0])
    return values[one], wavevector[1:], up, vectors[:, one].astype(complex)


def _sent(column):
    """Sizes of the waves that travel down, the fastest first. The incoming wave, last in the column, has an infinite
    speed.
    """
    travels = np.isfinite(column.speeds)
    sizes = np.linalg.norm(column.vectors[travels], axis=1)
    return sizes[np.argsort(-column.speeds[travels])]


def _aki_richards(p, s_speed):
    """Reflection coefficients P to P, P to S, S to P and S to S of displacements at a slowness, for unit P speed, in
    absolute value: eqs 5.27, 5.28, 5.31, 5.32 (2nd edition).
    """
    squared = s_speed**-2
    fast, slow = np.sqrt(1 - p**2 + 0j), np.sqrt(squared - p**2 + 0j)
    a, b = (squared - 2 * p**2) ** 2, 4 * p**2 * fast * slow
    pp, ps = (-a + b) / (a + b), 4 / s_speed * p * fast * (squared - 2 * p**2) / (a + b)
    sp, ss = 4 * s_speed * p * slow * (squared - 2 * p**2) / (a + b), (a - b) / (a + b)
    return np.abs([pp, ps, sp, ss])


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("number", [0, 1], ids=["P", "S"])
@pytest.mark.parametrize("name", _SOLIDS)
def test_reflection_coefficients_to_second_order(name, number, angle):
    """Refinement is by waves that become longer in nodes."""
    solid = _SOLIDS[name]
    half_space, s_speed = _half_space(solid=solid), 1 / solid.speed_ratio
    speed = (1.0, s_speed)[number]
    pp, ps, sp, ss = _aki_richards(np.sin(angle) / speed, s_speed)
    beyond = number == 1 and np.sin(angle) / speed > 1
    expected = [pp, ps] if number == 0 else [ss] if beyond else [sp, ss]
    errors = []
    # rounding enters the finest, of a thousand nodes, with its square; it adds nothing where nothing converges
    for size in (0.05, 0.025, 0.0125, 0.00625)[: 3 if beyond else 4]:
        wave = _arriving(half_space, size * np.array([np.cos(angle), np.sin(angle)]), number)
        errors.append(np.abs(_sent(half_space.total(*wave)) - expected))
    errors = np.array(errors)
    if beyond:  # no other wave travels: everything is reflected
        assert errors.max() < 1e-10
        return
    for sizes in errors.T:
        if sizes[0] > 1e-12:  # at normal incidence there is no conversion
            assert 1.9 < np.log2(sizes[-2] / sizes[-1]) < 2.1


@pytest.mark.parametrize(("dim", "side"), [(2, 1), (3, -1)])
@pytest.mark.parametrize("name", _SOLIDS)
def test_all_energy_comes_back(name, dim, side):
    """At random directions and wavelengths down to six nodes, the incident flux equals that of the waves that travel
    away.
    """
    seed = 20261125
    rng, half_space = np.random.default_rng(seed), _half_space(dim, side, _SOLIDS[name])
    for _ in range(6):
        k = rng.normal(size=dim)
        k *= rng.uniform(0.1, 1.0) / np.linalg.norm(k)
        k[0] = side * abs(k[0])
        squared, along, root, vector = _arriving(half_space, k, rng.integers(dim))
        column = half_space.total(squared, along, root, vector)
        powers = np.arange(-half_space.reach, half_space.reach + 1)
        blocks = half_space._blocks(along)
        comes = (vector.conj() @ np.einsum("kij,k->ij", blocks, powers * root**powers) @ vector).imag
        travels = np.isfinite(column.speeds)
        roots, vectors = 1 / column.factors[travels], column.vectors[travels]
        # waves of equal wavenumber, as both S waves of a correspondence material have, carry energy together
        alike = np.abs(roots[:, None] - roots) < 1e-6
        flux = np.einsum("ia,kab,jb,jk->ij", vectors.conj(), blocks, vectors, powers * roots[:, None] ** powers)
        goes = -flux[alike].sum().imag
        assert goes == pytest.approx(comes, rel=1e-8), f"seed {seed}"


@pytest.mark.parametrize(("name", "order"), [("bonds", 1), ("states", 1), ("correspondence", 2)])
def test_rayleigh_speed(name, order):
    """The surface of a lattice of bonds or states is softer than that of the continuum within one horizon; that of a
    correspondence material, which has gradients there, is not.
    """
    solid = _SOLIDS[name]
    ratio = solid.speed_ratio**2  # of squared speeds, P over S
    exact = brentq(
        lambda c: (2 - ratio * c**2) ** 2 - 4 * np.sqrt((1 - c**2) * (1 - ratio * c**2)), 0.5 / ratio**0.5, ratio**-0.5
    )
    half_space, errors = _half_space(solid=solid), []
    for size in (0.04, 0.02, 0.01, 0.005):
        number, column = half_space.surface_wave((size * exact) ** 2, np.ones(1), size)
        errors.append(abs(1 - size / number))
        assert abs(column.defect) < 1e-12
        assert np.linalg.norm(column.at(8000)[-1]) < 1e-3 * np.linalg.norm(column.at(1))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 1e-3 and order - 0.1 < rates[-1] < order + 0.1


def test_a_mode_obeys_the_column():
    """The whole column as one banded Hermitian matrix, whose lowest eigenvalue is the surface wave."""
    half_space, wavenumber = _half_space(), 0.6
    rows, d = 60, 2
    matrix = -half_space._system(np.array([wavenumber]), 0.0, rows)
    matrix = matrix[: rows * d, : rows * d]
    assert np.abs(matrix - matrix.conj().T).max() < 1e-14
    lowest = np.linalg.eigvalsh(matrix)[0]
    found, _ = half_space.surface_wave(lowest, np.ones(1), 1.05 * wavenumber)
    assert found == pytest.approx(wavenumber, rel=1e-10)


def test_a_wave_that_goes_down_does_not_come():
    half_space = _half_space()
    squared, along, root, vector = _arriving(half_space, np.array([-0.3, 0.2]), 0)
    with pytest.raises(fh.InputError, match="does not come to the surface"):
        half_space.total(squared, along, root, vector)
