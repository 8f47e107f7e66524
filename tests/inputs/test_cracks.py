"""Cracks: which bonds they cut, and that a cut body conserves what it should."""

import warnings

import numpy as np
import pytest

from farhorizon import (
    Crack,
    Diffusion,
    Disc,
    DiscCut,
    Elastic,
    Free,
    InputError,
    Kernel,
    Lattice,
    LatticePML,
    Periodic,
    PointCut,
    PolygonCut,
    Polyline,
    Rectangle,
    Simulation,
    Stencil,
    ValidityWarning,
    Wave,
)
from farhorizon.inputs.cracks import as_cut, cut_bonds
from helpers import dense_operator, engine_apply, kernel_stencil, lattice_of

SHAPES = {1: (21,), 2: (13, 15), 3: (7, 8, 9)}
SPACING = 0.5


def crossing(axis, at, low, high):
    """Return which bonds do not cross the plane x_axis = at (between nodes) within the box low..high of the other
    axes, as a function of their ends; in index units.
    """

    def whole(i, j):
        start, step = i.astype(float), (j - i).astype(float)
        across = (start[:, axis] - at) * (start[:, axis] + step[:, axis] - at) < 0
        share = np.divide(at - start[:, axis], step[:, axis], out=np.zeros(len(i)), where=step[:, axis] != 0)
        point = start + share[:, None] * step
        others = [a for a in range(i.shape[1]) if a != axis]
        return ~(across & ((point[:, others] >= low) & (point[:, others] <= high)).all(1))

    return whole


# Cracks and the bonds that stay whole; each crack is straight between nodes, and no bond meets its tips.
CRACKS = {
    "1D": (1, [PointCut(4.8)], crossing(0, 9.6, [], [])),
    "1D number": (1, [4.8], crossing(0, 9.6, [], [])),
    "2D across x": (2, [[(3.2, 1.613), (3.2, 4.887)]], crossing(0, 6.4, [3.226], [9.774])),
    "2D across y": (2, [Polyline([(1.613, 3.2), (4.887, 3.2)])], crossing(1, 6.4, [3.226], [9.774])),
    "2D right through": (2, [[(3.2, -9.0), (3.2, 19.0)]], crossing(0, 6.4, [-99], [99])),
    "3D rectangle": (
        3,
        [Rectangle((1.613, 1.713, 2.2), (1.137, 0.0, 0.0), (0.0, 1.337, 0.0))],
        crossing(2, 4.4, [3.226, 3.426], [5.5, 6.1]),
    ),
}
ALL = pytest.mark.parametrize(("dim", "cracks", "whole"), CRACKS.values(), ids=CRACKS)


def cracked(dim, cracks, model=Diffusion, reach=2, boundary=None, **options):
    """Return a simulation of white noise in a cracked free body, and the noise."""
    u = np.random.default_rng(23).uniform(-1, 1, SHAPES[dim])
    lattice = lattice_of(SHAPES[dim], SPACING)
    return Simulation(
        lattice, model(kernel_stencil(dim, reach, 1)), boundary or Free(), {"u": u}, cracks=cracks, **options
    ), u


@ALL
@pytest.mark.parametrize("reach", [1, 2])
def test_cut_bonds_are_absent(dim, cracks, whole, reach):
    """The operator is the matrix without the bonds that cross the crack."""
    sim, u = cracked(dim, cracks, reach=reach)
    weights = sim.stencil.weights / SPACING**2
    matrix = dense_operator(u.shape, sim.stencil.offsets, weights, whole)
    assert np.abs(matrix - dense_operator(u.shape, sim.stencil.offsets, weights)).max() > 0  # something is cut
    np.testing.assert_allclose(engine_apply(sim.engine, u).ravel(), matrix @ u.ravel(), rtol=0, atol=1e-12)


def test_cut_bonds_of_a_composite():
    """A cut bond is removed with its own coefficient, whatever the rule."""
    dim, cracks, whole = CRACKS["2D across x"]
    coefficient = np.random.default_rng(5).uniform(0.2, 2, SHAPES[dim])
    for rule in ("both", "arithmetic", "harmonic"):
        sim, u = cracked(dim, cracks, coefficient=coefficient, rule=rule)
        matrix = dense_operator(
            u.shape, sim.stencil.offsets, sim.stencil.weights / SPACING**2, whole, coefficient, rule
        )
        np.testing.assert_allclose(engine_apply(sim.engine, u).ravel(), matrix @ u.ravel(), rtol=0, atol=1e-12)


def test_cracks_that_share_bonds_cut_them_once():
    """Copies of a crack are one crack."""
    dim, cracks, whole = CRACKS["2D right through"]
    sim, u = cracked(dim, cracks * 3)
    matrix = dense_operator(u.shape, sim.stencil.offsets, sim.stencil.weights / SPACING**2, whole)
    np.testing.assert_allclose(engine_apply(sim.engine, u).ravel(), matrix @ u.ravel(), rtol=0, atol=1e-12)


@ALL
def test_uniform_field_stays_uniform(dim, cracks, whole):
    """A crack transmits nothing and drives nothing."""
    u = np.full(SHAPES[dim], 3.0)
    sim = Simulation(lattice_of(SHAPES[dim], SPACING), Wave(kernel_stencil(dim, 2)), Free(), {"u": u}, cracks=cracks)
    sim.step(200)
    # With two levels the rounding error of a step acts as a change of velocity, and so grows like the square of the
    # steps.
    np.testing.assert_allclose(sim.fields["u"], 3.0, rtol=200**2 * np.finfo(float).eps)


@ALL
@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_diffusion_in_a_cracked_body_conserves_the_sum(dim, cracks, whole, integrator):
    """A bond is cut in both directions."""
    sim, u = cracked(dim, cracks, lambda s: Diffusion(s, 1.0, integrator))
    sim.step(300)
    assert sim.fields["u"].sum() == pytest.approx(u.sum(), abs=1e-13 * u.size)


@ALL
def test_waves_in_a_cracked_body_conserve_energy(dim, cracks, whole):
    """The run has undamped Verlet, free sides and 1000 steps."""
    sim, _ = cracked(dim, cracks, Wave)
    start = sim.energy()
    sim.step(1000)
    assert sim.energy() == pytest.approx(start, rel=1e-12)


@pytest.mark.parametrize("name", ["1D", "2D right through"])
def test_nothing_passes_a_crack_right_through(name):
    """The part behind the crack stays exactly at rest, and each part conserves its content."""
    dim, cracks, _ = CRACKS[name]
    shape = SHAPES[dim]
    half = 10 if dim == 1 else 7  # nodes before the crack: index < 9.6 or 6.4
    u = np.zeros(shape)
    u[2] = 1.0
    sim = Simulation(lattice_of(shape, SPACING), Diffusion(kernel_stencil(dim, 2)), Free(), {"u": u}, cracks=cracks)
    sim.step(500)
    np.testing.assert_allclose(sim.fields["u"][half:], 0, atol=1e-15)
    assert sim.fields["u"][:half].sum() == pytest.approx(u.sum(), rel=1e-13)


def test_number_of_bonds_of_a_straight_crack():
    """A crack of full width between two rows of n nodes cuts n bonds of the 5-point stencil, each listed from both
    ends.
    """
    offsets = Stencil.finite_difference(2).offsets
    nodes, bonds = cut_bonds(Polyline([(-1.0, 2.25), (9.0, 2.25)]), np.zeros(2), 0.5, (11, 12), offsets)
    assert len(nodes) == 2 * 11
    ends = nodes + offsets[bonds]
    assert {tuple(sorted((a, b))) for a, b in zip(nodes[:, 1], ends[:, 1], strict=True)} == {(4, 5)}
    np.testing.assert_array_equal(nodes[:, 0], ends[:, 0])


def test_number_of_bonds_of_a_penny_crack():
    """A penny-shaped crack of radius 2.2 between two layers of nodes cuts the vertical bonds of the 13 integer points
    with r <= 2.2.
    """
    offsets = Stencil.finite_difference(3).offsets
    nodes, _ = cut_bonds(DiscCut((5.0, 5.0, 5.5), (0.0, 0.0, 1.0), 2.2), np.zeros(3), 1.0, (11, 11, 11), offsets)
    assert len(nodes) == 2 * 13


def test_a_crack_elsewhere_cuts_nothing():
    """The crack is far outside the lattice."""
    offsets = kernel_stencil(2, 3).offsets
    nodes, bonds = cut_bonds(Polyline([(50.0, 0.0), (60.0, 1.0)]), np.zeros(2), 0.5, (11, 11), offsets)
    assert nodes.shape == (0, 2) and bonds.shape == (0,)


def test_a_crack_in_an_unbounded_medium_spares_the_layer():
    """A crack inside the near field is accepted with absorbing sides; one across a side that cannot continue it is
    refused.
    """
    lattice = Lattice(0.5, lower=(-8, -8), upper=(8, 8))
    gauss = lambda x, y: np.exp(-((x + 1) ** 2) - y**2)  # noqa: E731
    model = Wave(kernel_stencil(2, 2))
    sim = Simulation(lattice, model, LatticePML(), {"u": gauss}, cracks=[[(0.3, -3.1), (0.3, 3.1)]])
    sim.step(5)
    with pytest.raises(InputError, match=r"across the absorbing side y\+"):
        Simulation(lattice, model, LatticePML(), {"u": gauss}, cracks=[[(0.3, -3.1), (4.3, 19.1)]])
    with pytest.raises(InputError, match="crosses a side that cannot continue it"):
        Simulation(lattice, model, {"x": Periodic(), "y": Free()}, {"u": gauss}, cracks=[[(-8.1, -3.1), (-8.1, 3.1)]])


BONDS = Kernel(1.0, 1)
ACROSS = {
    "scalar": lambda: Wave(BONDS),
    "bonds that break": lambda: Elastic(BONDS, 1.0, critical_stretch=0.01),
    "states": lambda: Elastic(BONDS, 1.0, 0.3, material="state-based", critical_stretch=0.01),
    "correspondence": lambda: Elastic(
        BONDS, 1.0, 0.3, material="correspondence", stabilisation=0.5, critical_stretch=0.01
    ),
}


@pytest.mark.parametrize("material", ACROSS.values(), ids=ACROSS)
@pytest.mark.parametrize("tooth", [0.0, 1.5], ids=["along", "saw"])
def test_a_crack_across_periodic_sides_is_one_of_two_periods(material, tooth):
    """Two periods, through which the same endless crack runs, behave as one period does, to rounding."""
    period, high = 12, 13
    found, broken = [], []
    for periods in (1, 2):
        shape = (period * periods, high)
        lattice = Lattice(0.5, (0.0, 0.0), tuple(0.5 * (n - 1) for n in shape))
        start = 0.02 * np.random.default_rng(4).standard_normal((2, period, high))
        start = np.concatenate([start] * periods, axis=1)
        points = [(3.0 * n, 2.05 + tooth * (n % 2)) for n in range(-4, 9)]  # a period is 6 long
        model = material()
        given = start if isinstance(model, Elastic) else start[0]
        sides = {"x": Periodic(), "y": Free()}
        sim = Simulation(lattice, model, sides, {"v": given}, cracks=[points], dt=0.1)
        sim.step(40)
        found.append(sim.fields["u"][..., :period, :])
        broken.append(sim.broken_bonds / periods)
        assert sim.engine.absent.count or sim.fields["damage"].max() > 0.2
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-12 * np.abs(found[0]).max())
    assert broken[0] == broken[1]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("material", ACROSS.values(), ids=ACROSS)
def test_one_node_is_a_slab_in_plane_strain(material):
    """A lattice of one node across, less than the reach of bonds, with a crack through it near a layer, gives bitwise
    the same as one of five nodes, which is wider than the reach.
    """
    found, broken = [], []
    for thick in (5, 1):
        shape = (thick, 14, 17)
        start = np.zeros((3, *shape))
        start[1:] = 0.02 * np.random.default_rng(3).standard_normal((2, 1, *shape[1:]))
        model = material()
        sim = Simulation(
            Lattice(0.5, (0.0, 0.0, 0.0), tuple(0.5 * (n - 1) for n in shape)),
            model,
            {"x": Periodic(), "y": Free(), "z": LatticePML(nodes=5)},
            {"v": start if isinstance(model, Elastic) else start[1]},
            cracks=[Rectangle([-99.0, 3.3, 2.1], [199.0, 0.0, 0.0], [0.0, 0.0, 3.0])],
            dt=0.05,
        )
        with warnings.catch_warnings(action="ignore", category=ValidityWarning):
            sim.step(50)
        found.append(sim.fields["u"][..., 0, :, :])
        broken.append(sim.broken_bonds / thick)
    np.testing.assert_array_equal(*found)
    assert broken[0] == broken[1] and (isinstance(model, Wave) or broken[0] > 10)


def test_a_crack_that_does_not_come_back_in_is_refused():
    """A crack that leaves through one side and does not enter through the opposite one, or enters at another place,
    or sticks out by less than the reach of bonds, is refused. One that ends at the last nodes stays inside.
    """
    lattice = Lattice(0.5, (0.0, 0.0), (5.5, 6.0))
    for points in ([(3.0, 3.1), (9.0, 3.1)], [(-9.0, 2.1), (9.0, 2.6)], [(-0.6, 3.1), (3.0, 3.1)]):
        with pytest.raises(InputError, match="comes in through the opposite one"):
            Simulation(lattice, Wave(BONDS), {"x": Periodic(), "y": Free()}, cracks=[points])
    Simulation(lattice, Wave(BONDS), {"x": Periodic(), "y": Free()}, cracks=[[(0.0, 3.1), (5.5, 3.1)]])


def test_body_is_cut_from_what_surrounds_it():
    """There are no bonds between nodes inside and outside a body: the operator is the matrix of the bonds inside."""
    lattice = Lattice(SPACING, lower=(0, 0), upper=(6, 7), body=Disc(2.6, centre=(3.0, 3.5)))
    u = np.where(lattice.mask, np.random.default_rng(29).uniform(-1, 1, lattice.shape), 0.0)
    sim = Simulation(lattice, Diffusion(kernel_stencil(2, 2)), Free(), {"u": u})
    inside = lambda i, j: lattice.mask[tuple(i.T)] & lattice.mask[tuple(j.T)]  # noqa: E731
    matrix = dense_operator(lattice.shape, sim.stencil.offsets, sim.stencil.weights / SPACING**2, inside)
    np.testing.assert_allclose(
        (engine_apply(sim.engine, u) * lattice.mask).ravel(), matrix @ u.ravel(), rtol=0, atol=1e-12
    )
    sim.step(300)
    assert np.nansum(sim.fields["u"]) == pytest.approx(u.sum(), abs=1e-12)
    assert np.isnan(sim.fields["u"][~lattice.mask]).all()


@pytest.mark.parametrize(
    ("crack", "dim", "match"),
    [
        (Polyline([(0, 0), (1, 1)]), 3, "differ in dimension"),
        (PointCut(0.0), 2, "differ in dimension"),
        ([(0, 0), (1, 1)], 3, "a crack in 3D is a surface"),
        ([(0, 0)], 2, "at least 2 points"),
        ([(0, 0), (0, 0)], 2, "points: two successive points of the crack are equal"),
        (np.nan, 1, "finite"),
    ],
)
def test_bad_cracks_are_refused(crack, dim, match):
    """The dimension is wrong, points are given for a surface, there are too few or equal points, or nan."""
    with pytest.raises(InputError, match=match):
        as_cut(crack, dim)


# Cracks that conduct partly, cracks that open later, and polygons in 3D


def steps_apart(cracks, dt=0.05, steps=20, boundary=None):
    """Return a simulation of white noise on a free plate after some steps of forward Euler."""
    lattice = lattice_of((13, 15), SPACING)
    noise = np.random.default_rng(3).standard_normal(lattice.shape)
    sim = Simulation(
        lattice, Diffusion(kernel_stencil(2, 2)), boundary or Free(), {"u": noise}, cracks=cracks, dt=dt * SPACING**2
    )
    sim.step(steps)
    return sim


LINE = [(3.2, 1.613), (3.2, 4.887)]


@pytest.mark.parametrize("factor", [0.0, 0.25, 1.0])
def test_a_partly_conducting_crack_scales_its_bonds(factor):
    """The reference is the dense matrix with the cut bonds scaled by the factor; a factor of 1 is no crack."""
    stencil, lattice = kernel_stencil(2, 2), lattice_of((13, 15), SPACING)
    whole = dense_operator(lattice.shape, stencil.offsets, stencil.weights)
    cut = dense_operator(lattice.shape, stencil.offsets, stencil.weights, crossing(0, 6.4, [3.226], [9.774]))
    matrix = factor * whole + (1 - factor) * cut
    sim = steps_apart([Crack(LINE, factor)], steps=1)
    expected = sim.start_u.ravel() + sim.dt / SPACING**2 * matrix @ sim.start_u.ravel()
    np.testing.assert_allclose(sim.fields["u"].ravel(), expected, atol=1e-13)


def test_of_two_cracks_across_a_bond_the_tighter_counts():
    both = steps_apart([Crack(LINE, 0.5), Crack(LINE, 0.2)])
    assert (both.fields["u"] == steps_apart([Crack(LINE, 0.2)]).fields["u"]).all()


def test_a_crack_opens_at_its_time():
    """Seven steps without and thirteen with the crack: the same as two runs, and as single steps."""
    dt = 0.05 * SPACING**2
    late = steps_apart([Crack(LINE, opens=7 * dt)])
    first = steps_apart([], steps=7)
    lattice = lattice_of((13, 15), SPACING)
    second = Simulation(
        lattice, Diffusion(kernel_stencil(2, 2)), Free(), {"u": first.fields["u"]}, cracks=[LINE], dt=dt
    )
    second.step(13)
    np.testing.assert_allclose(late.fields["u"], second.fields["u"], atol=1e-14)
    by_steps = Simulation(
        lattice, Diffusion(kernel_stencil(2, 2)), Free(), {"u": late.start_u}, cracks=[Crack(LINE, opens=7 * dt)], dt=dt
    )
    for _ in range(20):
        by_steps.step()
    assert (by_steps.fields["u"] == late.fields["u"]).all()


def test_polygon_in_space():
    """A rectangle as a polygon in either orientation, and a triangle, which cuts only the bonds through it; points
    that do not lie in a plane are refused.
    """
    corner, one, other = np.array([1.613, 1.713, 2.2]), np.array([1.137, 0, 0]), np.array([0, 1.337, 0])
    points = np.array([corner, corner + one, corner + one + other, corner + other])
    rng = np.random.default_rng(5)
    start, end = rng.uniform(1, 4, (2, 20000, 3))
    expected = Rectangle(corner, one, other).cuts(start, end)
    assert expected.sum() > 100
    for shape in (points, points[::-1], np.concatenate([points, points[:1]])):
        assert (PolygonCut(shape).cuts(start, end) == expected).all()
    turned = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    assert (PolygonCut(points @ turned).cuts(start @ turned, end @ turned) == expected).all()
    triangle = as_cut([[0, 0, 0], [1, 0, 0], [0, 1, 0]], 3)
    place = np.array([[0.2, 0.2, 0.0], [0.6, 0.6, 0.0], [0.49, 0.49, 0.0]])
    up = np.array([0.01, 0.02, 0.3])
    assert triangle.cuts(place - up, place + up).tolist() == [True, False, True]
    with pytest.raises(InputError, match="do not lie in one plane"):
        PolygonCut([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.1]])


def test_bad_cracks_with_factor_and_time():
    with pytest.raises(InputError, match="0 to 1"):
        Crack(LINE, 1.5)
    with pytest.raises(InputError, match="finite"):
        Crack(LINE, 0.0, np.inf)
