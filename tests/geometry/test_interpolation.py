"""Values and derivatives between nodes: against the functions themselves, with fitted orders; edges and holes."""

import itertools

import numpy as np
import pytest

from farhorizon import Box, Disc, InputError, Lattice
from farhorizon.geometry.interpolation import HALF_WIDTH, as_points, interpolation_blocks


def sums(lattice, points, values, **options):
    """Return a function of the coordinates at points, from its values at nodes."""
    nodes, weights = interpolation_blocks(lattice, np.asarray(points, float), **options).entries()
    return (weights * values.ravel()[nodes]).sum(1)


def drawn_points(lattice, count, seed, margin=HALF_WIDTH):
    low, high = lattice.lower + margin * lattice.spacing, lattice.upper - margin * lattice.spacing
    return np.random.default_rng(seed).uniform(low, high, (count, lattice.dim))


@pytest.mark.parametrize("length", [4.0, 6.0, 20.0])
def test_windowed_sinc_of_plane_waves(length):
    """Hicks (2002) chooses the window for waves of four nodes and more; by Kaiser's rule its ripple is exp(-shape),
    3.5e-6 per axis, and the division by the sum of the weights, which has the same ripple, doubles it.
    """
    lattice = Lattice(0.5, (0.0, 0.0), (20.0, 15.0))
    x, y = lattice.coordinates()
    k = 2 * np.pi / (length * lattice.spacing) * np.array([np.cos(0.4), np.sin(0.4)])
    points = drawn_points(lattice, 200, 1)
    for of in (np.cos, np.sin):
        found = sums(lattice, points, of(k[0] * x + k[1] * y))
        assert np.abs(found - of(points @ k)).max() < 4 * np.exp(-4 * np.pi)


@pytest.mark.parametrize("derivative", [None, 0, 1])
def test_linear_is_of_second_order(derivative):
    """Errors at the same points on successively finer lattices."""
    errors, steps = [], np.array([0.4, 0.2, 0.1, 0.05])
    for spacing in steps:
        lattice = Lattice(spacing, (0.0, 0.0), (8.0, 4.0))
        x, y = lattice.coordinates()
        points = drawn_points(lattice, 400, 2, margin=0.8 / spacing)
        found = sums(lattice, points, np.sin(x) * np.cos(y), method="linear", derivative=derivative)
        p, q = points.T
        exact = {None: np.sin(p) * np.cos(q), 0: np.cos(p) * np.cos(q), 1: -np.sin(p) * np.sin(q)}[derivative]
        errors.append(np.abs(found - exact).max())
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("axis", [0, 1])
def test_derivatives_of_the_windowed_sinc(axis):
    """They are compared with those of waves of six nodes in space, and with differences of the interpolated values."""
    lattice = Lattice(0.5, (0.0, 0.0), (15.0, 12.0))
    x, y = lattice.coordinates()
    k = 2 * np.pi / 3.0 * np.array([0.6, 0.8])
    drawn, step = np.random.default_rng(3).uniform(8.1, 8.9, (50, 2)), 1e-4 * np.eye(2)[axis]
    points = lattice.spacing * (drawn + np.random.default_rng(4).integers(0, 6, (50, 2)))  # a node away from the cuts
    values = np.sin(k[0] * x + k[1] * y)
    found = sums(lattice, points, values, derivative=axis)
    assert np.abs(found - k[axis] * np.cos(points @ k)).max() < 2e-5 * np.linalg.norm(k)
    difference = (sums(lattice, points + step, values) - sums(lattice, points - step, values)) / 2e-4
    # central differences: 1e-8 k^2 / 6, and the rounding of values divided by the step
    np.testing.assert_allclose(found, difference, atol=1e-7 * np.linalg.norm(k))


@pytest.mark.parametrize("method", ["sinc", "linear"])
def test_constants_are_kept(method):
    """Weights sum to one, those of derivatives to zero."""
    lattice = Lattice(0.1, (0, 0, 0), (2.0, 1.8, 1.7))
    points = drawn_points(lattice, 7, 4)
    for derivative in (None, 0, 1, 2):
        nodes, weights = interpolation_blocks(lattice, points, method, derivative).entries()
        assert nodes.shape == weights.shape
        np.testing.assert_allclose(weights.sum(1), derivative is None, atol=1e-12 / lattice.spacing)


@pytest.mark.parametrize("method", ["sinc", "linear"])
def test_a_point_on_a_node_is_that_node(method):
    """This holds in a corner, too, and together with points between nodes: the other weights are exactly zero."""
    lattice = Lattice(0.1, (0, 0), (3.0, 2.9))
    on = np.array([(0.0, 0.0), (3.0, 2.9), (0.3, 1.1)])
    for points in (on, np.concatenate([on, [(1.234, 1.567)]])):
        nodes, weights = interpolation_blocks(lattice, points, method).entries()
        for point, places, values in zip(on, nodes, weights, strict=False):
            assert values.max() == 1 and np.count_nonzero(values) == 1
            assert places[values.argmax()] == np.ravel_multi_index(lattice.index(point), lattice.shape)


def test_blocks_are_products():
    """Entries have the weights of a plain loop over the block."""
    lattice = Lattice(1.0, (0, 0, 0), (20, 19, 21))
    blocks = interpolation_blocks(lattice, drawn_points(lattice, 2, 6), derivative=1)
    nodes, weights = blocks.entries()
    for first, along, places, values in zip(
        blocks.first, zip(*blocks.weights, strict=True), nodes, weights, strict=True
    ):
        for i, at in enumerate(itertools.product(*(range(len(w)) for w in along))):
            assert places[i] == np.ravel_multi_index(tuple(first + at), lattice.shape)
            assert values[i] == pytest.approx(np.prod([w[n] for w, n in zip(along, at, strict=True)]), rel=1e-14)


def test_mirrored_points_have_mirrored_weights():
    """Reciprocity between two points requires this."""
    lattice = Lattice(0.25, -6.0, 6.0)
    for derivative, sign in ((None, 1), (0, -1)):
        left, right = interpolation_blocks(lattice, np.array([[-0.33], [0.33]]), derivative=derivative).entries()[1]
        np.testing.assert_allclose(left, sign * right[::-1], rtol=1e-9, atol=1e-14)


BODY = {"body": Box((0, 0), (30, 30)) - Disc(3.2, (15, 15))}


@pytest.mark.parametrize(
    ("point", "method", "region", "message"),
    [
        ((30.5, 3.0), "sinc", {}, "outside"),
        ((3.5, 15.0), "sinc", {}, "close to the edge"),
        ((15.0, 26.5), "sinc", {}, "close to the edge"),
        ((15.0, 14.6), "linear", BODY, "outside"),
        ((11.45, 14.4), "linear", BODY, "close to the edge"),
        ((9.5, 15.0), "sinc", BODY, "close to the edge"),
        ((15.0, 15.0), "cubic", {}, "unknown interpolation"),
    ],
)
def test_refused(point, method, region, message):
    """Points outside, in a hole, or so close to an edge that nodes are missing; unknown methods."""
    lattice = Lattice(1.0, (0, 0), (30, 30), **region)
    with pytest.raises(InputError, match=message):
        interpolation_blocks(lattice, np.array([point]), method)


@pytest.mark.parametrize("point", [(0.5, 15.0), (30.0, 29.5), (11.0, 14.5), (0.0, 7.25)])
def test_linear_reaches_the_edge(point):
    """It is possible as long as both nodes exist."""
    lattice = Lattice(1.0, (0, 0), (30, 30), **BODY)
    x, y = lattice.coordinates()
    assert sums(lattice, [point], 2 * x - y, method="linear")[0] == pytest.approx(2 * point[0] - point[1], rel=1e-12)


@pytest.mark.parametrize("given", [[], [(1.0, 2.0, 3.0)], "here", [(np.nan, 1.0)]])
def test_what_are_no_points(given):
    with pytest.raises(InputError):
        as_points(given, 2)


def test_points_of_a_line():
    """In 1D a point is a number; a single point counts as a list of one."""
    assert as_points([1.0, 2.0], 1).shape == (2, 1)
    assert as_points(3.0, 1).shape == (1, 1)
    assert as_points((1.0, 2.0), 2).shape == (1, 2)


@pytest.mark.parametrize("method", ["sinc", "linear"])
def test_boxes_have_parts_of_the_sums(method):
    """Together they are the sums over the whole lattice, even if a box is narrower than a block."""
    lattice = Lattice(1.0, (0.0, 0.0), (39.0, 30.0))
    points = np.array([[12.3, 10.0], [15.0, 14.6], [20.0, 15.0], [9.1, 21.7]])
    whole = interpolation_blocks(lattice, points, method, 0)
    field = np.random.default_rng(3).standard_normal(lattice.shape)
    total, count = np.zeros(len(points)), np.zeros(len(points), int)
    for (left, right), (low, high) in itertools.product([(0, 11), (11, 17), (17, 40)], [(0, 15), (15, 31)]):
        blocks, which = whole.within((left, low), (right - left, high - low))
        nodes, weights = blocks.entries()
        total[which] += (field[left:right, low:high].ravel()[nodes] * weights).sum(1)
        count[which] += 1
    nodes, weights = whole.entries()
    np.testing.assert_allclose(total, (field.ravel()[nodes] * weights).sum(1), rtol=0, atol=1e-14)
    assert count.max() > 1
