"""The half-infinite lattice against the half-space of the continuum, and its balance of energy."""

import numpy as np
import pytest
from scipy.optimize import brentq

import farhorizon as fh
from farhorizon.analysis.half_space import HalfSpace
from farhorizon.medium.stratified_medium import Strata, StratifiedMedium
from layered_ground import Layer, motion

_SOLID = fh.Elastic(fh.Kernel(2.5, influence="linear", exponent=1), young=1.0)  # P speed 1 in units of the stencil


_SOLIDS = {
    "bonds": _SOLID,
    "states": fh.Elastic(fh.Kernel(2.0), 1.0, 0.4, material="state-based"),
    "correspondence": fh.Elastic(fh.Kernel(2.0), 1.0, 0.1, material="correspondence", stabilisation=0.4),
}


def _half_space(dim=2, side=1, solid=_SOLID):
    return HalfSpace(StratifiedMedium(solid.medium(1.0, dim), dim - 1, side, states=solid.force_states(1.0, dim)))


def _arriving(half_space, wavevector, number):
    """Squared frequency, tangential wavenumbers, factor per node upwards and displacement of a plane wave; type 0 is
    P.
    """
    if half_space.stencil.components == 1:
        up = np.exp(1j * half_space.side * wavevector[0])
        return half_space.stencil.symbol(*wavevector), wavevector[1:], up, np.ones(1, complex)
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


def _materials(name):
    """A medium and one above it; the speed of P waves, or scalar ones, in the former is 1 in units of the stencil."""
    if name in ("differences", "scalar"):
        kernel = fh.Stencil.finite_difference(2) if name == "differences" else fh.Kernel(2.0)
        return fh.Wave(kernel, density=1.0), {"speed": 0.5, "density": 0.75}
    constants = {"density": 0.5, "material": {"bonds": "bond-based", "states": "state-based"}.get(name, name)}
    ratios = {} if name == "bonds" else {"poisson": 0.3}
    below = fh.Elastic(fh.Kernel(2.0), 2.0, **ratios, **constants)
    return below, {"young": 1.0, "density": 0.35} | ({"poisson": 0.35} if ratios else {})


def _ground(name, rows, free):
    """A number of rows of one medium above another, from the free surface down or below as much of the upper one."""
    model, above = _materials(name)
    medium, states = model.medium(1.0, 2), model.force_states(1.0, 2)
    beyond, varying = (
        0 if free else medium.reach[1],
        model.beside({key: np.array([value]) for key, value in above.items()}),
    )

    def column(upper, lower):
        return np.append(np.full(rows + beyond, 1.0 if upper is None else upper[0]), lower)

    moduli = None
    if varying.moduli is not None:
        moduli = np.stack([column(*both) for both in zip(varying.moduli, states.moduli, strict=True)], axis=1)
    rule = "harmonic" if moduli is None else "arithmetic"
    strata = Strata(column(varying.of_bonds, 1.0), column(varying.density, 1.0), moduli, rule)
    return HalfSpace(StratifiedMedium(medium, 1, 1, beyond, states, strata, not free))


def _layers(name, rows):
    """The same as layers of the continuum."""
    model, above = _materials(name)
    if isinstance(model, fh.Wave):
        return [Layer(0, None, 1.0, 1.0), Layer(rows, None, above["speed"], above["density"])]
    upper = fh.Elastic(model.kernel, material=model.material, **above)
    ratio = 1 / model.p_speed
    return [
        Layer(0, 1.0, model.s_speed * ratio, 1.0),
        Layer(rows, upper.p_speed * ratio, upper.s_speed * ratio, upper.density / model.density),
    ]


_GROUNDS = ("differences", "scalar", "bonds", "states", "correspondence")


@pytest.mark.sampled(6)
@pytest.mark.parametrize("free", [True, False], ids=["free", "open"])
@pytest.mark.parametrize("number", [0, 1], ids=["P", "S"])
@pytest.mark.parametrize("name", _GROUNDS)
def test_in_strata_waves_converge_to_those_of_layers(name, number, free):
    """The motion of the highest row, half a spacing below the surface. Refinement is by waves that become longer in
    nodes, in a layer of as many of them.
    """
    if number and name in ("differences", "scalar"):
        pytest.skip("a scalar field has one type of waves")
    for angle in (0.0, 0.4):
        errors, lengths = [], []
        for rows in (40, 80):
            k = 2.0 / rows  # the layer is twice as high as a wave below it is long, over 2 pi
            half_space = _ground(name, rows, free)
            up, across = np.cos(angle), np.sin(angle)
            squared, along, root, vector = _arriving(half_space, k * np.array([up, across]), number)
            first = half_space.end.edge
            found = half_space.total(squared, along, root, vector).rows[first][::-1]
            omega = np.sqrt(squared)
            size = vector[0] if vector.size == 1 else vector @ ((up, across) if number == 0 else (across, -up))
            comes = size * root ** -(first + rows - 0.5)  # the incoming wave at the interface
            expected = comes * motion(_layers(name, rows), along[0] / omega, omega, number, free)(rows - 0.5)
            errors.append(np.abs(found - expected).max())
            lengths.append(k * 2.0)
        # surfaces and interfaces are as those of the continuum within one horizon, of 2 nodes
        assert (np.array(errors) < lengths).all()
        if name == "differences":
            assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("free", [True, False], ids=["free", "open"])
@pytest.mark.parametrize("name", _GROUNDS)
def test_strata_pass_on_all_energy(name, free):
    """The flux through each row is the same, at a random direction: none under a free surface."""
    seed = 20261130
    rng, rows = np.random.default_rng(seed), 9
    half_space = _ground(name, rows, free)
    for _ in range(3):
        k = rng.normal(size=2)
        k *= rng.uniform(0.1, 0.7) / np.linalg.norm(k)
        k[0] = abs(k[0])
        wave = _arriving(half_space, k, rng.integers(half_space.stencil.components))
        count, reach = 40, half_space.reach
        u, blocks = half_space.total(*wave).at(count), half_space._rows(wave[1])
        strata = half_space.end.strata

        def flux(row, u=u, blocks=blocks, strata=strata, reach=reach):
            """Power that the rows from one on receive from those below it, up to a factor."""
            return sum(
                strata.density_at(above)
                * (u[above].conj() @ blocks[min(above, len(blocks) - 1), reach - down] @ u[above + down]).imag
                for down in range(1, reach + 1)
                for above in range(row - down + 1, row + 1)
            )

        fluxes = [flux(row) for row in range(reach, count - reach - 1)]
        scale = (np.abs(u) ** 2).max() * np.sqrt(wave[0])
        assert np.ptp(fluxes) < 1e-12 * scale, f"seed {seed}"
        assert (abs(fluxes[0]) < 1e-12 * scale) == free, f"seed {seed}"


def test_a_wave_that_goes_down_does_not_come():
    half_space = _half_space()
    squared, along, root, vector = _arriving(half_space, np.array([-0.3, 0.2]), 0)
    with pytest.raises(fh.InputError, match="does not come to the surface"):
        half_space.total(squared, along, root, vector)
