"""Waves of one frequency and the radiation of a point force, against the lattice's Green function and closed forms."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.wave_surface import along, carried_band, outgoing
from farhorizon.medium.stencil import Stencil
from helpers import kernel_stencil

_BONDS = {dim: fh.Elastic(fh.Kernel(2.0, 1, "linear"), 1.0).stencil(1.0, dim) for dim in (2, 3)}
_TOUCHING = fh.Elastic(fh.Kernel(1.5, 1, "linear"), 1.0).stencil(1.0, 3)
_FINITE = fh.Elastic(young=1.0, poisson=0.3, material="finite-element").stencil(1.0, 2)


def _anisotropic():
    """A scalar stencil that is faster along one diagonal than along the other."""
    offsets = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])
    weights = np.array([0.8, 0.6, 0.35, 0.1])
    return Stencil(np.concatenate([offsets, -offsets]), np.concatenate([weights, weights]))


def _green(stencil, squared, points, nodes):
    """Green function of the infinite lattice at a frequency damped so strongly that a torus with `nodes` nodes along
    each axis suffices; shape (P, components, components).
    """
    angles = np.ix_(*[2 * np.pi * np.fft.fftfreq(nodes)] * stencil.dim)
    size = stencil.components
    symbol = stencil.symbol(*angles).reshape(*(nodes,) * stencil.dim, size, size)
    green = np.fft.ifftn(np.linalg.inv(symbol - squared * np.eye(size)), axes=range(stencil.dim))
    return green[tuple(points.T % nodes)]


@pytest.mark.parametrize(
    ("stencil", "squared", "nodes", "distances"),
    [
        (kernel_stencil(2, 3), 0.3 + 0.03j, 768, (10, 20, 40)),
        (kernel_stencil(2, 2).with_reaction(0.2), 0.6 + 0.04j, 768, (10, 20, 40)),
        (_anisotropic(), 0.5 + 0.05j, 768, (10, 20, 40)),
        (_BONDS[2], 0.15 + 0.015j, 768, (15, 30, 60)),
        (_FINITE, 0.2 + 0.018j, 768, (15, 30, 60)),
        (kernel_stencil(3, 1), 0.6 + 0.3j, 108, (6, 12, 24)),
    ],
    ids=["scalar", "reaction", "anisotropic", "bonds", "finite elements", "space"],
)
def test_far_away_a_point_force_sends_these_waves(stencil, squared, nodes, distances):
    """Exact on the lattice except for terms that fall off faster by 1/(k r); vector fields contain beats of P and S.
    The force and the direction are random.
    """
    random = np.random.default_rng(20261123)
    direction = [(3, 4), (4, -3), (-3, 4)][random.integers(3)] if stencil.dim == 2 else (1, 2, 2)
    whole = int(np.linalg.norm(direction))
    unit, force = np.array(direction) / whole, random.normal(size=stencil.components)
    found = outgoing(stencil, squared, unit[None])
    errors, radii = [], []
    for distance in distances:
        place = np.round(distance / whole) * np.array(direction)
        radii.append(r := np.linalg.norm(place))
        phase = found.amplitudes * np.exp(1j * found.wave_vectors @ place) / r ** ((stencil.dim - 1) / 2)
        waves = (phase * (found.projections @ force))[..., None] * found.polarisations
        exact = _green(stencil, squared, place[None].astype(int), nodes)[0] @ force
        # relative to the fastest wave, the least damped: its remainder may be larger than a wave that is damped more
        size = np.abs(phase[0, 0]) * np.linalg.norm(force)
        errors.append(np.linalg.norm(waves.sum((0, 1)) - exact) / size)
    assert errors[-1] < 0.1
    if stencil.components == 1:
        assert -np.polyfit(np.log(radii), np.log(errors), 1)[0] > 0.8, errors
    else:
        assert (np.abs(found.wave_vectors[0, 0] @ unit) * np.array(radii) * errors < 2.5).all(), errors


def _long_waves(dim, speed, k):
    """Amplitude of the long wave of a point force: (i/4) H0(k r) / c^2 far away, or 1 / (4 pi c^2 r)."""
    if dim == 3:
        return 1 / (4 * np.pi * speed**2)
    return 0.25j / speed**2 * np.sqrt(2 / (np.pi * k)) * np.exp(-0.25j * np.pi)


def _directions(dim):
    found = np.random.default_rng(20261123).normal(size=(5, dim))
    return found / np.linalg.norm(found, axis=1)[:, None]


def _second_order(errors):
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (np.abs(rates - 2) < 0.15).all(), rates


@pytest.mark.parametrize("dim", [2, 3])
def test_a_scalar_point_source_converges_to_the_closed_form(dim):
    stencil, errors = kernel_stencil(dim, 2), []
    for k in (0.4, 0.2, 0.1):
        found = outgoing(stencil, k**2, _directions(dim))
        errors.append(np.abs(found.amplitudes / _long_waves(dim, 1.0, k) - 1).max())
    _second_order(errors)


@pytest.mark.parametrize("dim", [2, 3])
def test_point_force_and_centre_of_dilatation_converge_to_aki_and_richards(dim):
    """Aki and Richards (2002), eqs 4.23 and 4.29 far away: P along the direction, S across it, and for a centre of
    dilatation P alone. In two dimensions the same holds with Hankel functions. Central forces have c_P^2 = 3 c_S^2.
    """
    stencil, n = _BONDS[dim], _directions(dim)
    force = np.random.default_rng(2).normal(size=dim)
    errors, dilatations = [], []
    for k in (0.2, 0.1, 0.05):  # wavenumbers of P waves; S waves are shorter by sqrt(3)
        found = outgoing(stencil, k**2, n)
        waves = (found.amplitudes * (found.projections @ force))[..., None] * found.polarisations
        along_n = (n @ force)[:, None] * n
        p, s = _long_waves(dim, 1.0, k) * along_n, _long_waves(dim, 3**-0.5, 3**0.5 * k) * (force - along_n)
        size = np.linalg.norm(force) * abs(_long_waves(dim, 3**-0.5, 3**0.5 * k))
        errors.append(max(np.abs(waves[0] - p).max(), np.abs(waves[1:].sum(0) - s).max()) / size)
        # pairs of opposite forces on the neighbours along each axis
        sums = -1j * np.sin(found.wave_vectors)
        waves = (found.amplitudes * (found.projections * sums).sum(-1))[..., None] * found.polarisations
        p = _long_waves(dim, 1.0, k) * -1j * k * n
        dilatations.append(max(np.abs(waves[0] - p).max(), np.abs(waves[1:].sum(0)).max()) / np.abs(p).max())
    _second_order(errors)
    _second_order(dilatations)


@pytest.mark.parametrize("stencil", [_BONDS[2], _FINITE, _anisotropic(), _BONDS[3]])
def test_energy_travels_along_the_direction(stencil):
    """The gradient of the eigenvalue, by finite differences, points along the direction, and its size is the slope."""
    directions = _directions(stencil.dim)
    found, step = outgoing(stencil, 0.3, directions), 1e-5
    for number, vectors in enumerate(found.wave_vectors.real):
        branch = stencil.components - 1 - number
        np.testing.assert_allclose(stencil.branches(*vectors.T)[:, branch], 0.3, atol=1e-12)
        for n, vector, slope in zip(directions, vectors, found.slopes[number].real, strict=True):
            ends = vector + step * np.concatenate([np.eye(stencil.dim), -np.eye(stencil.dim)])
            up, down = np.split(stencil.branches(*ends.T)[:, branch], 2)
            np.testing.assert_allclose((up - down) / (2 * step), slope * n, atol=1e-8)


def test_along_is_the_wave_whose_phase_travels_so():
    directions = _directions(2)
    found = along(_FINITE, 0.3, directions)
    for number, vectors in enumerate(found.wave_vectors):
        lengths = np.linalg.norm(vectors, axis=1)
        np.testing.assert_allclose(vectors, lengths[:, None] * directions, atol=1e-14)
        np.testing.assert_allclose(_FINITE.branches(*vectors.T)[:, 1 - number], 0.3, atol=1e-12)


def test_s_waves_along_a_plane_of_symmetry_are_at_right_angles():
    """In its planes of symmetry both S waves of this lattice coincide: the polarisations are any two, but not one
    twice.
    """
    turns = 2 * np.pi * np.arange(12) / 12
    directions = np.stack([np.cos(turns), np.sin(turns), np.zeros(12)], -1)
    shapes = along(_TOUCHING, 0.2, directions).polarisations
    dots = np.abs((shapes[1].conj() * shapes[2]).sum(-1))
    np.testing.assert_allclose(dots, 0, atol=1e-12)


def test_s_waves_that_touch_are_one():
    """Along an axis of symmetry both S waves are the same, and their sum is continuous there."""
    axis = np.array([[1.0, 0.0, 0.0], [1.0, 1e-4, 0.0]])
    found = outgoing(_BONDS[3], 0.05, axis / np.linalg.norm(axis, axis=1)[:, None])
    dyads = np.einsum("bd,bdi,bdj->dij", found.amplitudes[1:], found.polarisations[1:], found.projections[1:])
    np.testing.assert_allclose(dyads[0], dyads[1], atol=1e-3 * np.abs(dyads[0]).max())


def test_the_band_of_differences():
    """4 - 2 cos kx - 2 cos ky increases along each ray up to 4, reached at the middle of an edge of the Brillouin
    zone.
    """
    assert carried_band(Stencil.finite_difference(2)) == pytest.approx((0, 4))
    assert carried_band(Stencil.finite_difference(1).with_reaction(0.5)) == pytest.approx((0.5, 4.5))


def test_surfaces_that_are_not_convex_are_refused():
    """Springs that are strong across the axes and weak along them: S waves reach some places on three paths."""
    offsets = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])
    unit = offsets / np.linalg.norm(offsets, axis=1)[:, None]
    weights = np.array([0.1, 0.1, 1.0, 1.0])[:, None, None] * unit[:, :, None] * unit[:, None, :]
    stencil = Stencil(np.concatenate([offsets, -offsets]), np.concatenate([weights, weights]))
    with pytest.raises(fh.InputError, match="not convex"):
        outgoing(stencil, 0.05, np.array([[1.0, 0.0]]))
