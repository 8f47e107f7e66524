"""Division of wave data into parts that are followed separately."""

from dataclasses import replace

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.side_data import Datum
from farhorizon.simulation.wave_data import by_time, depth_of, followed_parts, key_of, largest_along

SEED = 20261122


def test_each_moment_of_a_source_is_whole_in_one_part():
    """No part is switched on or off at once, except with the source itself."""
    random = np.random.default_rng(SEED)
    half, course, still = 20, random.uniform(0.5, 1.0, 130), Datum(np.ones(3), "v")
    course[55:] *= np.where(np.arange(75) < 60, 0.0, 1.0)  # the part around 80 holds nothing
    found = list(by_time([still, Datum(np.ones(3), "source", course)], half, 1e-3))
    assert found[0][2][0] is still and [len(data) for _, _, data in found] == [2, 1, 1, 1, 1, 1]
    whole = np.zeros(130)
    for middle, (begin, before, data) in zip((0, 20, 40, 60, 100, 120), found, strict=True):
        assert before == min(middle, half) and begin + before == middle
        places = np.arange(len(data[-1].time)) + middle - before
        whole[places] = np.maximum(whole[places], data[-1].time)
        assert not middle or data[-1].time[0] < 1e-30
        assert places[-1] == 129 or data[-1].time[-1] < 0.05
    np.testing.assert_array_equal(whole, course)


def test_the_middle_of_the_data_and_their_largest_values_along_an_axis():
    values = np.zeros((9, 5, 4))
    values[6, 2, 1], values[6, 4, 1], values[2, 2, 3] = -3.0, 2.0, 0.0
    assert depth_of([Datum(values, "u")]) == (2,)
    assert depth_of([Datum(0 * values, "u")]) == ()
    np.testing.assert_array_equal(
        largest_along(values, [1])[:, 0], np.where(np.arange(36) == 25, -3.0, 0.0).reshape(9, 4)
    )


def plane(model):
    stencil = model.stencil(1.0, 2)
    return LatticeMedium(stencil, 1.0, 1.0, Recursion.of(model.integrator, 0.5), 0.5)


def pulse_at(depth):
    values = np.zeros((2 * depth + 1, 9))
    values[depth] = 1.0
    return [Datum(values, "u")]


@pytest.mark.parametrize(("model", "every"), [("solid", True), ("scalar", True), ("scalar", False)])
def test_short_runs_and_waveguides_are_followed_whole(model, every):
    medium = plane(fh.Elastic(fh.Kernel(2.0), young=1.0) if model == "solid" else fh.Wave(fh.Kernel(2.0)))
    (one,) = followed_parts(medium, pulse_at(15), 200.0, 1e-5, 512, every, 16)
    assert (one.time, one.room, one.smooth, one.limit, one.later) == (200.0, 400, 0.0, np.inf, 1.0)
    (one,) = followed_parts(medium, pulse_at(15), 900.0, 1e-5, np.inf, every, 16)
    assert (one.time, one.later) == (900.0, 1.0)


def test_in_long_runs_all_waves_are_followed_until_images_come():
    """Long waves are followed longer, and for scalars those that travel no farther than the room."""
    scalar = plane(fh.Wave(fh.Kernel(2.0)))
    long_ones, slow, all_ones = followed_parts(scalar, pulse_at(15), 900.0, 1e-5, 512, True, 16)
    assert long_ones.time == 900.0 and long_ones.smooth > 0 and long_ones.limit == np.inf
    assert slow.time == 900.0 and slow.room == 512 and slow.limit == pytest.approx(512 / 900)
    assert all_ones.time == 512.0 and all_ones.room > 512  # the front of an image runs ahead
    assert [one.later for one in (long_ones, slow, all_ones)] == [1.0] * 3
    assert len(followed_parts(scalar, pulse_at(15), 900.0, 1e-5, 512, False, 16)) == 2


def test_slow_waves_of_solids_are_followed_until_they_are_back():
    """In a medium of speed 1, a room of 512 nodes is 512 units of time, within which those from nearby are back."""
    solid = plane(fh.Elastic(fh.Kernel(2.0), young=1.0))
    _, all_ones = followed_parts(solid, pulse_at(15), 2000.0, 1e-5, 512, True, 16)
    assert all_ones.time == 512.0 and all_ones.later == pytest.approx(2000 / 512)
    _, all_ones, slow = followed_parts(solid, pulse_at(80), 2000.0, 1e-5, 512, True, 16)
    assert all_ones.time == 512.0 and all_ones.later == 1.0 and all_ones.limit == np.inf
    assert slow.time == 1120.0 and slow.limit == pytest.approx(512 / 1120) and slow.later == pytest.approx(2000 / 1120)
    assert followed_parts(solid, pulse_at(15), 2000.0, 1e-5, 512, True, 60)[-1].time == 1350.0  # from a thick layer
    source = [replace(pulse_at(80)[0], kind="source", time=np.ones(4000))]
    last = followed_parts(solid, source, 2000.0, 1e-5, 512, True, 16)[-1]
    assert last.time < 600.0 and last.later == 1.0  # a source sends until the end


def test_data_that_send_the_same_waves_are_known_as_one():
    """Fields of either sign, and mirror images where the sides in both directions are alike; no others."""
    random = np.random.default_rng(SEED)
    towards, across = random.normal(size=(2, 7, 5))
    data = [Datum(towards, "u", component=0), Datum(across, "u", component=1)]
    other_sign = [replace(one, values=-one.values) for one in data]
    mirrored = [Datum(towards[:, ::-1], "u", component=0), Datum(-across[:, ::-1], "u", component=1)]
    turned = [Datum(towards[:, ::-1], "u", component=0), Datum(across[:, ::-1], "u", component=1)]
    for mirrors in ((), (1,)):
        known = key_of(data, True, mirrors)
        assert key_of(other_sign, True, mirrors) == known
        assert (key_of(mirrored, True, mirrors) == known) is bool(mirrors)
        assert key_of(turned, True, mirrors) != known
    still = [replace(one, kind="v") for one in data]
    early, late = ([replace(one, kind="source", time=course) for one in data] for course in np.eye(2))
    for together in (False, True):
        assert len({key_of(one, together, [1]) for one in (data, still, early, late)}) == 4


def test_components_that_are_followed_apart_are_known_in_any_order():
    """Each component may have its own sign and mirror image, but data of one component have one sign; in 3D there are
    two axes along a side.
    """
    random = np.random.default_rng(SEED)
    first, second = random.normal(size=(2, 7, 5, 4))
    data = [Datum(first, "u", component=0), Datum(second, "u", component=1)]
    exchanged = [Datum(-second[:, ::-1], "u", component=0), Datum(first[:, ::-1, ::-1], "u", component=2)]
    assert key_of(data, False, [1, 2]) == key_of(exchanged, False, [1, 2])
    assert key_of(data, False, [1]) != key_of(exchanged, False, [1])
    assert key_of(data, False, [1, 2]) != key_of([data[0], replace(data[0], component=1)], False, [1, 2])
    long, wide = (key_of([Datum(np.ones(shape), "u")], False) for shape in ((4, 6, 2), (4, 2, 6)))
    assert long != wide  # the same bytes
    moving = [Datum(first, "u"), Datum(second, "v")]
    assert key_of(moving, False) == key_of([replace(one, values=-one.values) for one in moving], False)
    assert key_of(moving, False) != key_of([moving[0], replace(moving[1], values=-second)], False)
