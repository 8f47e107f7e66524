"""Lattices: node counts, bounds, windows, bodies, nearest nodes."""

import numpy as np
import pytest

from farhorizon import Ball, Box, Disc, InputError, Lattice


@pytest.mark.parametrize(
    ("spacing", "lower", "upper", "shape"),
    [
        (0.25, -26, 26, (209,)),
        (0.25, (-26, -26), (26, 26), (209, 209)),
        (0.1, (0, 0, 0), (0.3, 0.7, 1.1), (4, 8, 12)),
        (1 / 3, (-1, 2), (1, 2), (7, 1)),
        (1e-7, (0.0,), (1e-4,), (1001,)),
    ],
)
def test_both_bounds_are_nodes(spacing, lower, upper, shape):
    """Nodes lower, lower + dx, ..., upper, although dx is not exactly representable."""
    lattice = Lattice(spacing, lower=lower, upper=upper)
    assert lattice.shape == shape and lattice.dim == len(shape) and lattice.nodes == np.prod(shape)
    for axis, n, low, high in zip(lattice.axes, shape, np.atleast_1d(lower), np.atleast_1d(upper), strict=True):
        np.testing.assert_allclose(axis, np.linspace(low, high, n), rtol=1e-12, atol=1e-12 * spacing)
    np.testing.assert_allclose(lattice.upper, np.atleast_1d(upper), rtol=1e-12)
    assert [c.shape for c in lattice.coordinates()] == [shape] * len(shape)


def test_window_of_the_published_disc():
    """Radius 26 at spacing 0.25 contains 33949 nodes (Hermann et al. 2023, example 2: plane_wave_abc_waves.md section
    2, item 10).
    """
    lattice = Lattice(0.25, window=Disc(26))
    assert lattice.nodes == 33949
    assert lattice.shape == (209, 209)
    np.testing.assert_array_equal(lattice.lower, [-26, -26])


def test_window_lies_on_the_lattice_through_the_origin():
    """A window that is not aligned contains the nodes at integer multiples of the spacing within its bounds."""
    lattice = Lattice(0.5, window=Disc(1.2, centre=(0.3, -10.1)))
    np.testing.assert_allclose(lattice.lower / 0.5, np.round(lattice.lower / 0.5))
    i, j = np.meshgrid(np.arange(-40, 41), np.arange(-40, 41))
    assert lattice.nodes == int(((0.5 * i - 0.3) ** 2 + (0.5 * j + 10.1) ** 2 <= 1.2**2).sum())


def test_window_in_3d():
    """Integer points of the ball r <= 3: 123 (OEIS A117609)."""
    assert Lattice(1.0, window=Ball(3)).nodes == 123


def test_body_with_a_hole():
    """A plate of 11 x 11 nodes less the closed disc r <= 2 of 13 nodes."""
    lattice = Lattice(1.0, lower=(-5, -5), upper=(5, 5), body=Box((-5, -5), (5, 5)) - Disc(2))
    assert lattice.nodes == 121 - 13
    assert not lattice.mask[5, 5] and not lattice.mask[7, 5] and lattice.mask[8, 5] and lattice.mask[0, 0]


@pytest.mark.parametrize("point", [(0.0, 0.0), (1.0, -2.0), (0.13, 0.37), (-1.0, 2.0)])
def test_index_is_the_nearest_node(point):
    """It is compared with a search over all nodes."""
    lattice = Lattice(0.25, lower=(-1, -2), upper=(1, 2))
    x, y = lattice.coordinates()
    distance = (x - point[0]) ** 2 + (y - point[1]) ** 2
    assert distance[lattice.index(point)] == pytest.approx(distance.min(), abs=1e-15)


@pytest.mark.parametrize("point", [(1.2, 0.0), (0.0, -2.2), (np.nan, 0.0), (0.0,), (0.0, 0.0, 0.0)])
def test_index_beyond_the_near_field(point):
    """Points outside, not finite or of another dimension are refused."""
    with pytest.raises(InputError):
        Lattice(0.25, lower=(-1, -2), upper=(1, 2)).index(point)


def test_index_outside_a_window():
    """A corner of the bounding box is no node of a disc."""
    lattice = Lattice(0.25, window=Disc(2))
    assert lattice.index((2.0, 0.0)) == (16, 8)
    with pytest.raises(InputError, match="outside the near field"):
        lattice.index((2.0, 2.0))


@pytest.mark.parametrize(
    ("upper", "nearest"), [((1.1, 1.0), "1, 1"), ((0.5, 1.2), "0.5, 1.25"), ((1.0, 1.0 + 1e-6), "1, 1")]
)
def test_bounds_that_are_no_whole_number_of_spacings_apart(upper, nearest):
    """The message names the nearest bounds that work."""
    with pytest.raises(InputError, match=rf"whole number of spacings.*{nearest}"):
        Lattice(0.25, lower=(0, 0), upper=upper)


def test_the_nearest_bounds_of_the_message_work():
    """Following the advice gives a lattice."""
    with pytest.raises(InputError) as error:
        Lattice(0.3, lower=(-1,), upper=(1.05,))
    nearest = float(error.value.remedy.split("[")[1].rstrip("]"))
    assert nearest == pytest.approx(-1 + 7 * 0.3)
    assert Lattice(0.3, lower=(-1,), upper=(nearest,)).shape == (8,)


def test_rounding_in_the_bounds_is_no_error():
    """Bounds may be off by 1e-9 of a spacing, since 0.1 is not exactly representable."""
    assert Lattice(0.1, lower=0.0, upper=0.1 * 3).shape == (4,)
    assert Lattice(0.1, lower=0.0, upper=0.3 + 0.5e-10).shape == (4,)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"spacing": 0.0, "lower": 0, "upper": 1}, "spacing: must be finite and positive"),
        ({"spacing": np.inf, "lower": 0, "upper": 1}, "spacing: must be finite and positive"),
        ({"spacing": 0.1}, "needs lower and upper"),
        ({"spacing": 0.1, "lower": 0}, "needs lower and upper"),
        ({"spacing": 0.1, "lower": (0, 0), "upper": (1,)}, "a number for each axis"),
        ({"spacing": 0.1, "lower": (0,) * 4, "upper": (1,) * 4}, "one to three"),
        ({"spacing": 0.1, "lower": 1, "upper": 0}, "upper lies below lower along"),
        ({"spacing": 0.1, "lower": 0, "upper": np.nan}, "finite"),
        ({"spacing": 0.1, "lower": 0, "upper": 1, "window": Disc(1)}, "window replaces"),
        ({"spacing": 0.1, "lower": 0, "upper": 1, "body": Disc(1)}, "differ in dimension"),
        ({"spacing": 1.0, "window": Disc(0.1, centre=(0.5, 0.5))}, "no node"),
        ({"spacing": 1.0, "lower": (0, 0), "upper": (4, 4), "body": Disc(0.1, centre=(0.5, 0.5))}, "no node lies in"),
    ],
)
def test_bad_lattices_are_refused(options, match):
    """Each is refused before any work, with the reason."""
    with pytest.raises(InputError, match=match):
        Lattice(**options)


def test_a_window_that_does_not_fit_into_memory_is_refused():
    """It is refused before its mask of 2e11 nodes is made."""
    with pytest.raises(InputError, match=r"lattice\.spacing.*memory.*GiB.*remedy"):
        Lattice(1e-4, window=Disc(20.0))


def test_the_node_of_a_number():
    """In 1D a point is a number, or a list of one."""
    line = Lattice(0.5, -2.0, 2.0)
    assert line.index(0.2) == line.index([0.2]) == line.index(np.float64(0.2)) == (4,)
    with pytest.raises(InputError, match=r"one coordinate per axis; value: \[0, 0\]; limit: one coordinate"):
        line.index([0.0, 0.0])
    with pytest.raises(InputError, match=r"one coordinate per axis; value: 0.*limit: 2 coordinates"):
        Lattice(0.5, (-2.0, -2.0), (2.0, 2.0)).index(0.0)


def test_counts_of_nodes_put_one_into_the_middle_of_each_cell():
    lattice = Lattice.of_counts([60, 30], (-0.025, 0.0), (0.025, 0.025))
    assert lattice.shape == (60, 30)
    centres = [-0.025 + 0.05 * (np.arange(60) + 0.5) / 60, 0.025 * (np.arange(30) + 0.5) / 30]
    for found, wanted in zip(lattice.axes, centres, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-16)
    same = Lattice(lattice.spacing, lattice.lower, lattice.upper)
    assert same.shape == lattice.shape and (same.upper == lattice.upper).all()
    assert Lattice.of_counts(7, 0.0, 1.0).shape == (7,)
    assert Lattice.of_counts([4, 4, 1], [0.0] * 3, [1.0, 1.0, 0.25]).shape == (4, 4, 1)
    hole = Lattice.of_counts([8, 8], [-1.0] * 2, [1.0] * 2, body=~np.eye(8, dtype=bool))
    assert hole.existing.sum() == 56


@pytest.mark.parametrize("seed", range(20))
def test_any_counts_fit_the_box_that_they_fill(seed):
    rng = np.random.default_rng(seed)
    counts, spacing, lower = rng.integers(1, 5000, 3), 10 ** rng.uniform(-9, 9), rng.uniform(-9, 9, 3)
    lower *= spacing
    lattice = Lattice.of_counts(counts, lower, lower + counts * spacing)
    assert lattice.shape == tuple(counts) and np.isclose(lattice.spacing, spacing, rtol=1e-9)
    np.testing.assert_allclose(lattice.upper, lower + (counts - 0.5) * spacing, rtol=1e-9, atol=1e-9 * spacing)


def test_counts_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match=r"do not fit the box.*nodes = \[60, 30\] with box.upper = \[1, 0.5\]"):
        Lattice.of_counts([60, 31], (0.0, 0.0), (1.0, 0.5))
    with pytest.raises(InputError, match=r"lattice\.nodes: as many counts"):
        Lattice.of_counts([60, 31, 2], (0.0, 0.0), (1.0, 0.5))
    for wrong in ([0, 2], [2.5, 2], [-1, 2], ["a", 2]):
        with pytest.raises(InputError, match=r"lattice\.nodes"):
            Lattice.of_counts(wrong, (0.0, 0.0), (1.0, 0.5))
