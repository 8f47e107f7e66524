"""Boxes of a lattice against counts over all nodes, and by hand."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.geometry.decomposition import decompose


def made(shape, processes, reach=None, more=None, periodic=(), **options):
    reach = [2] * len(shape) if reach is None else reach
    return decompose(shape, processes, reach, more or {}, frozenset(periodic), **options)


@pytest.mark.parametrize(("shape", "processes"), [((31,), 3), ((40, 33), 6), ((20, 21, 22), 8), ((50, 50), 7)])
def test_boxes_cover_the_lattice_once(shape, processes):
    boxes, count = made(shape, processes), np.zeros(shape, int)
    for number in range(processes):
        count[tuple(slice(*ends) for ends in boxes.ranges(number))] += 1
    assert (count == 1).all() and int(np.prod(boxes.topology)) == processes


def test_neighbours_are_those_beside():
    """The relation of neighbours is symmetric."""
    boxes = made((40, 41), 6, periodic=[1], topology=[2, 3])
    for number in range(6):
        for (axis, side), other in boxes.neighbours(number).items():
            assert other == -1 or boxes.neighbours(other)[axis, -side] == number
            if other != -1:
                steps = np.subtract(boxes.place(other), boxes.place(number))
                assert steps[1 - axis] == 0 and (steps[axis] - side) % boxes.topology[axis] == 0
            else:
                assert axis == 0
    assert made((40, 41), 1, periodic=[1]).neighbours(0) == {(1, -1): 0, (1, 1): 0}


@pytest.mark.parametrize(
    ("shape", "processes", "topology"),
    [((400, 100), 4, (4, 1)), ((100, 100), 4, (2, 2)), ((64, 64, 64), 8, (2, 2, 2)), ((64, 64), 2, (2, 1))],
)
def test_least_is_exchanged(shape, processes, topology):
    assert made(shape, processes).topology == topology


def test_what_is_exchanged_is_counted():
    """The middle one of three slabs exchanges two faces, with the nodes beyond them and the edges; likewise four
    columns.
    """
    boxes = made((60, 20), 3, topology=[3, 1])
    assert boxes.exchanged(1, (2, 2), {(1, -1): 5, (1, 1): 4}) == [2 * 2 * (20 + 9 + 4), 0]
    assert boxes.size(1, {(1, -1): 5, (1, 1): 4, (0, 1): 7}) == [20, 29]
    assert made((60, 20), 4, topology=[2, 2]).exchanged(0, (2, 2), {}) == [2 * (10 + 4), 2 * 30]


def test_work_is_balanced():
    """Nodes beyond a side count as work, and no box is thinner than the limit."""
    assert made((100,), 2, more={(0, -1): 20.0}).cuts == ((0, 40, 100),)
    assert made((20,), 4, more={(0, -1): 100.0}).cuts == ((0, 5, 10, 15, 20),)
    assert made((40,), 2, more={(0, 1): 30.0}, least=12).cuts == ((0, 28, 40),)


def test_too_many_processes():
    with pytest.raises(fh.InputError, match="fewer processes"):
        made((9, 9), 4)
    with pytest.raises(fh.InputError, match="multiply"):
        made((90, 90), 4, topology=[3, 1])
    with pytest.raises(fh.InputError, match="so many boxes"):
        made((90, 9), 4, topology=[1, 4])


def test_a_part_has_the_same_coordinates():
    """They are equal to the last bit."""
    lattice = fh.Lattice(0.1, (0.3, -1.7), (4.3, 2.3))
    part = lattice.part([(7, 21), (30, 41)])
    for axis, ends in enumerate(((7, 21), (30, 41))):
        np.testing.assert_array_equal(part.axes[axis], lattice.axes[axis][slice(*ends)])
    assert part.shape == (14, 11) and part.whole is lattice and part.lower[0] == lattice.axes[0][7]
    nodes = np.arange(41 * 41)
    inside, here = part.own(nodes)
    np.testing.assert_array_equal(here, np.arange(14 * 11))
    assert inside.sum() == 14 * 11 and lattice.own(nodes)[0].all()
