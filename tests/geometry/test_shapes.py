"""Shapes that select nodes, and cuts that sever bonds, against counts by hand."""

import math
from fractions import Fraction

import numpy as np
import pytest

from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Ball, Box, Disc, DiscCut, PointCut, Polygon, Polyline, Rectangle, segments_cross


def lattice(spacing, count, dim):
    axis = spacing * np.arange(-count, count + 1)
    return np.stack(np.meshgrid(*[axis] * dim, indexing="ij"), axis=-1)


# Regions


def test_disc_holds_the_nodes_on_its_rim():
    nodes = lattice(0.25, 110, 2)
    i = np.arange(-110, 111)
    expected = i[:, None] ** 2 + i**2 <= 104**2
    assert expected.sum() == 33949  # integer offsets with i^2 + j^2 <= 104^2, 104 = 26 / 0.25
    np.testing.assert_array_equal(Disc(26).contains(nodes), expected)
    # The same lattice, shifted and scaled by numbers that are not exactly representable.
    np.testing.assert_array_equal(Disc(26 / 0.7, centre=(0.1, -0.3)).contains(nodes / 0.7 + [0.1, -0.3]), expected)


def test_ball():
    i = np.arange(-7, 8)
    expected = i[:, None, None] ** 2 + i[:, None] ** 2 + i**2 <= 36
    np.testing.assert_array_equal(
        Ball(0.6, (0.1, 0.2, 0.3)).contains(lattice(0.1, 7, 3) + np.array([0.1, 0.2, 0.3])), expected
    )


def test_surface_tolerance():
    assert Disc(2).contains([2 * (1 + 0.9e-9), 0]) and not Disc(2).contains([2 * (1 + 1.1e-9), 0])
    assert Box(0, 2).contains([2 + 1.9e-9]) and not Box(0, 2).contains([2 + 2.1e-9])
    square = Polygon([(0, 0), (2, 0), (2, 2), (0, 2)])
    assert square.contains([1, -1.9e-9]) and not square.contains([1, -2.1e-9])


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_box_is_closed(dim):
    assert Box([-0.3] * dim, [0.2] * dim).contains(lattice(0.1, 5, dim)).sum() == 6**dim  # -3 ... 2 on each axis
    lower, upper = Box([-0.3] * dim, [0.2] * dim).bounds()
    assert lower.tolist() == [-0.3] * dim and upper.tolist() == [0.2] * dim


def test_polygon_agrees_with_picks_theorem():
    # A concave polygon with corners on lattice points: area = inner + rim/2 - 1, so nodes = area + rim/2 + 1.
    corners = np.array([(-4, -3), (4, -3), (4, 4), (1, 0), (-2, 4), (-4, 1)])
    following = np.roll(corners, -1, axis=0)
    area = Fraction(int(np.sum(corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0])), 2)
    rim = sum(math.gcd(*step) for step in (following - corners).tolist())
    expected = area + Fraction(rim, 2) + 1
    for points in (corners, corners[::-1], np.vstack([corners, corners[:1]])):
        assert Polygon(0.1 * points).contains(lattice(0.1, 6, 2)).sum() == expected
    assert [b.tolist() for b in Polygon(corners).bounds()] == [[-4, -3], [4, 4]]


def test_set_algebra():
    nodes = lattice(0.5, 12, 2)
    a, b = Disc(3), Box((0, -1), (5, 1))
    in_a, in_b = a.contains(nodes), b.contains(nodes)
    np.testing.assert_array_equal((a | b).contains(nodes), in_a | in_b)
    np.testing.assert_array_equal((a & b).contains(nodes), in_a & in_b)
    np.testing.assert_array_equal((a - b).contains(nodes), in_a & ~in_b)
    assert [v.tolist() for v in (a | b).bounds()] == [[-3, -3], [5, 3]]
    assert [v.tolist() for v in (a & b).bounds()] == [[0, -1], [3, 1]]
    assert [v.tolist() for v in (a - b).bounds()] == [[-3, -3], [3, 3]]
    assert not (Disc(3) - Disc(1)).contains([1.0, 0.0])  # the rim of a hole belongs to the hole
    assert (
        repr(a - b)
        == "Difference(first=Disc(radius=3.0, centre=[0.0, 0.0]), second=Box(lower=[0.0, -1.0], upper=[5.0, 1.0]))"
    )
    with pytest.raises(TypeError):
        a | 3


@pytest.mark.parametrize(
    "make",
    [
        lambda: Disc(0),
        lambda: Disc(-1),
        lambda: Disc(math.nan),
        lambda: Disc("wide"),
        lambda: Disc([1, 2]),
        lambda: Disc(1, (0, 0, 0)),
        lambda: Disc(1, (0, math.inf)),
        lambda: Ball(1, (0, 0)),
        lambda: Box((0, 0), (1,)),
        lambda: Box((0, 0), (1, 0)),
        lambda: Box([0] * 4, [1] * 4),
        lambda: Box((0, math.nan), (1, 1)),
        lambda: Polygon([(0, 0), (1, 0)]),
        lambda: Polygon([(0, 0), (1, 0), (0, 0)]),
        lambda: Polygon([(0, 0), (1, 1), (2, 2)]),
        lambda: Polygon([(0, 0), (0, 0), (1, 0), (1, 1)]),
        lambda: Polygon([(0, 0, 0), (1, 0, 0), (1, 1, 0)]),
        lambda: Disc(1) | Ball(1),
        lambda: Disc(1) & Disc(1, (3, 0)),
        lambda: Disc(1).contains([1, 2, 3]),
        lambda: Disc(1).contains(3.0),
        lambda: PointCut(math.nan),
        lambda: PointCut([1, 2]),
        lambda: Polyline([(0, 0)]),
        lambda: Polyline([(0, 0), (0, 0)]),
        lambda: Rectangle((0, 0, 0), (1, 0, 0), (0, 0, 0)),
        lambda: Rectangle((0, 0, 0), (1, 0, 0), (1, 1, 0)),
        lambda: Rectangle((0, 0), (1, 0), (0, 1)),
        lambda: DiscCut((0, 0, 0), (0, 0, 0), 1),
        lambda: DiscCut((0, 0, 0), (0, 0, 1), 0),
        lambda: segments_cross((0, 0), (1, 1), (2, 2), (2, 2)),
        lambda: PointCut(0).cuts((0, 0), (1, 1)),
    ],
)
def test_refuses(make):
    with pytest.raises(InputError):
        make()


# Cuts

# each bond of a horizon of 3 once
OFFSETS = [(i, j) for i in range(-3, 4) for j in range(0, 4) if i * i + j * j <= 9 and (j > 0 or i > 0)]


def count(cut, nodes, spacing):
    inside = np.abs(nodes).max() * (1 + 1e-9)
    total = 0
    for offset in OFFSETS:
        ends = nodes + spacing * np.array(offset)
        kept = (np.abs(ends) <= inside).all(axis=-1)
        total += int(cut.cuts(nodes[kept], ends[kept]).sum())
    return total


@pytest.mark.parametrize("row", [Fraction(1, 2), Fraction(0)])
@pytest.mark.parametrize(
    "ends", [(Fraction(-100), Fraction(100)), (Fraction(-5, 3), Fraction(22, 7)), (Fraction(-2), Fraction(3))]
)
def test_bonds_across_a_horizontal_crack(row, ends):
    """A bond (i, j), j > 0, that starts `depth` below the crack meets it i*depth/j beside its start, and there are j
    such depths.
    """
    size, spacing = 10, 0.1
    left, right = ends
    expected = 0
    for i, j in OFFSETS:
        # A node on the crack (left to right) counts as above: depths 1, ..., j on a row, halves between rows.
        for k in range(1, j + 1):
            depth = k if row == 0 else k - Fraction(1, 2)
            shift = Fraction(i) * depth / j
            first, last = max(-size, -size - i, math.ceil(left - shift)), min(size, size - i, math.floor(right - shift))
            expected += max(0, last - first + 1)
    nodes = lattice(spacing, size, 2).reshape(-1, 2)
    crack = spacing * np.array([[float(left), float(row)], [float(right), float(row)]])
    assert count(Polyline(crack), nodes, spacing) == expected
    # Neither a joint along the crack nor the reversed direction changes anything: a reflection turns one rule into
    # the other.
    middle = np.array([[0.5 * spacing, float(row) * spacing]])
    assert count(Polyline(np.vstack([crack[:1], middle, crack[1:]])), nodes, spacing) == expected
    if row == 0:
        assert count(Polyline(crack[::-1]), nodes, spacing) == expected
    if left == -100:
        assert expected == sum(j * (2 * size + 1 - abs(i)) for i, j in OFFSETS)


def test_points_cut_the_bonds_that_span_them():
    x = np.arange(-5, 6)[:, None] * 0.1
    for at in (0.0, 0.04):  # a node on the point is to its left, so that both lie between nodes 0 and 1
        for reach in (1, 2, 3):
            assert PointCut(at).cuts(x[:-reach], x[reach:]).sum() == reach
        np.testing.assert_array_equal(np.flatnonzero(PointCut(at).cuts(x[:-1], x[1:])), [5])
    assert [b.tolist() for b in PointCut(0.2).bounds()] == [[0.2], [0.2]]


def test_rules_on_the_line_and_at_the_tips():
    def crossed(start, end):
        return bool(segments_cross(start, end, (0, 0), (2, 0)))

    assert crossed((1, 1), (1, -1))
    assert crossed((1, 0), (1, -1)) and not crossed((1, 0), (1, 1))  # a node on the crack is to its left
    assert crossed((1, 1e-12), (1, -1)) and crossed((1, -1e-12), (1, -1))
    assert not crossed((0.5, 0), (1.5, 0)) and not crossed((-1, 0), (3, 0))  # along the crack
    assert (
        crossed((2, 1), (2, -1))
        and crossed((2 + 1e-9, 1), (2 + 1e-9, -1))
        and not crossed((2 + 1e-8, 1), (2 + 1e-8, -1))
    )
    assert not crossed((3, 1), (3, -1)) and not crossed((1, 3), (1, 1))
    assert not crossed((1, 1), (1, 1))


def test_joints_shift_with_the_curve():
    # Right turn: the left side is all but the wedge x < 0, y < 0. Left turn (reversed): the left side is that wedge.
    crack = [(-2, 0), (0, 0), (0, -2)]
    angles = np.radians(np.arange(15, 360, 30))
    around = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    wedge = (around < 0).all(axis=-1)
    np.testing.assert_array_equal(Polyline(crack).cuts((0, 0), around), wedge)
    np.testing.assert_array_equal(Polyline(crack[::-1]).cuts((0, 0), around), ~wedge)


@pytest.mark.parametrize("turn", [1, -1])
def test_closed_curve_through_nodes_separates_inside_from_outside(turn):
    corners = np.array([(0, 0), (4, 0), (4, 3), (2, 1), (0, 3), (0, 0)])[::turn]
    nodes = lattice(1.0, 7, 2).reshape(-1, 2)
    # Anticlockwise the left is the inside and holds the nodes on the curve; clockwise they are outside. The reference
    # is shifted by hand.
    shifted = np.array([(0, 0), (4, 0), (4, 3), (2, 1), (0, 3)]) + turn * 1e-3 * np.array(
        [(-1, -1), (1, -1), (1, 3), (0, 1.5), (-1, 3)]
    )
    inside = Polygon(shifted).contains(nodes)
    for offset in OFFSETS:
        ends = nodes + offset
        separated = inside != Polygon(shifted).contains(ends)
        cut = Polyline(corners).cuts(nodes, ends)
        assert cut[separated].all()
        # A curve that is not convex may also meet a bond twice.
        exact = Polyline(np.vstack([shifted, shifted[:1]])[::turn]).cuts(nodes, ends)
        np.testing.assert_array_equal(cut, exact)


CUTS = [
    PointCut(0.1),
    Polyline([(-1, -0.5), (0.3, 0.2), (1, -1)]),
    Polyline([(-1, -1), (1, -1), (0, 1), (-1, -1)]),
    Rectangle((-1, -0.5, -0.7), (1.2, 1.2, 0), (0, 0, 1.5)),
    DiscCut((0.1, 0.2, 0.3), (1, 2, -1), 1.3),
]


@pytest.mark.parametrize("cut", CUTS, ids=lambda c: type(c).__name__)
def test_reversal_changes_nothing(cut):
    rng = np.random.default_rng(2)
    start, end = rng.uniform(-2, 2, (2, 50, 40, cut.dim))
    for a, b in ((start, end), (np.round(2 * start) / 2, np.round(2 * end) / 2)):
        result = cut.cuts(a, b)
        assert result.shape == (50, 40) and 0 < result.sum() < result.size
        np.testing.assert_array_equal(result, cut.cuts(b, a))
    # A bond that stays beyond one of the bounds is not cut.
    lower, upper = cut.bounds()
    beside = (np.maximum(start, end) < lower).any(axis=-1) | (np.minimum(start, end) > upper).any(axis=-1)
    assert not cut.cuts(start, end)[beside].any()
    assert cut.cuts(start[0], end[0, 0]).shape == (40,) and cut.cuts(start[0, 0], end[0, 0]).shape == ()
    assert cut.cuts(start[:0], end[:0]).shape == (0, 40)
    assert repr(cut).startswith(type(cut).__name__ + "(")


def test_rectangle_extruded_from_a_segment_cuts_the_same_bonds():
    rng, rim = np.random.default_rng(3), np.array([0, 0, 1])
    nodes = rng.integers(-6, 7, (2, 4000, 2)) * 0.25  # many lie on the crack or meet its tips
    for a, b in (((-1, 0), (1, 0)), ((1, 0.5), (-0.5, -1)), ((0.25, -1), (0.25, 1))):
        tall = Rectangle((*a, -1), (b[0] - a[0], b[1] - a[1], 0), (0, 0, 2))
        start, end = np.concatenate([nodes, np.zeros((2, 4000, 1))], axis=-1)
        flat = segments_cross(*nodes, a, b)
        assert 0 < flat.sum() < flat.size
        np.testing.assert_array_equal(tall.cuts(start, end), flat)
        np.testing.assert_array_equal(tall.cuts(start + rim, end + rim), flat)
        assert not tall.cuts(start + 1.01 * rim, end + 1.01 * rim).any()


def test_penny_crack():
    start = np.insert(lattice(0.5, 4, 2).reshape(-1, 2), 2, -0.25, axis=1)
    end = start + np.array([0, 0, 0.5])
    # Offsets with i^2 + j^2 <= 4 on a square lattice: 13, the rim included.
    assert DiscCut((0, 0, 0), (0, 0, 5), 1).cuts(start, end).sum() == 13
    # If the plane passes through the upper nodes, these are on the side of the normal.
    assert DiscCut((0, 0, 0.25), (0, 0, 1), 1).cuts(start, end).sum() == 13
    assert DiscCut((0, 0, 0.25), (0, 0, -1), 1).cuts(start, end).sum() == 0
    lower, upper = DiscCut((1, 2, 3), (0, 0, 5), 1).bounds()
    np.testing.assert_allclose([lower, upper], [[0, 1, 3], [2, 3, 3]])
