"""Inversions of data that runs have made: what they find, keep, continue and refuse."""

import os
from dataclasses import replace

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.inverse.smoothing import Smoothing, roughness

SEED = int(os.environ.get("FARHORIZON_SEED", 770078))
STEPS, DT = 110, 0.45
LATTICE = fh.Lattice(1.0, (-10.0, -10.0), (10.0, 10.0))
PLACES = [(-7.0, 0.0), (0.0, 7.0), (7.0, -1.0), (1.0, -7.0)]
AROUND = [(6.0 * np.cos(a), 6.0 * np.sin(a)) for a in np.linspace(0.2, 6.4, 9)]


def bell(height=0.12):
    x, y = np.meshgrid(*LATTICE.axes, indexing="ij")
    return 1 + height * np.exp(-((x - 1) ** 2 + (y + 0.5) ** 2) / 6)


def plate(speed, place, **options):
    source = fh.PointSource(place, time=fh.Ricker(0.09))
    return fh.Setup(LATTICE, fh.Wave(fh.Kernel(2.0), speed), fh.LatticePML(nodes=8), sources=[source], dt=DT, **options)


def block_sums():
    return fh.Receivers(AROUND, interpolation="linear")


def shots(count=4, noise=0.0, truth=None, start=None):
    rng, found = np.random.default_rng(SEED), []
    for place in PLACES[:count]:
        line = block_sums()
        run = fh.Simulation.of(plate(bell() if truth is None else truth, place), observe=[line])
        run.step(STEPS)
        data = line.data["u"]
        data = data + noise * np.abs(data).max() * rng.standard_normal(data.shape)
        begin = np.ones(LATTICE.shape) if start is None else start
        found.append((plate(begin, place), fh.LeastSquares(block_sums(), data)))
    return found


def found(given, **options):
    asked = {"bounds": {"speed": (0.9, 1.3)}, "iterations": 6, "smooth": 1.5, **options}
    return fh.invert(given, "speed", STEPS * DT, **asked)


@pytest.mark.slow
def test_a_bump_is_found():
    one = found(shots(), iterations=25)
    truth = bell()
    error = np.linalg.norm(one.maps["speed"] - truth) / np.linalg.norm(truth - 1)
    print(one.message, error)
    assert one.misfit < 1e-3 * one.history[0].misfit
    assert error < 0.25  # the map consists of means over 1.5 spacings, and starts at an error of 1
    assert np.all(np.diff([step.misfit for step in one.history]) < 0)


def test_an_inversion_reduces_the_misfit_within_its_bounds():
    given = shots(2)
    one = found(given, bounds={"speed": (0.98, 1.04)})
    assert one.misfit < 0.6 * one.history[0].misfit
    assert one.maps["speed"].min() >= 0.98 and one.maps["speed"].max() <= 1.04
    assert len(one.models) == len(one.history) and one.models[-1]["speed"] is one.maps["speed"]
    [again] = [fh.gradient(s, m, "speed", STEPS * DT) for s, (_, m) in zip(one.setups[:1], given, strict=False)]
    np.testing.assert_allclose(again.records[0]["u"], one.records[0][0]["u"], atol=1e-12)
    still = one.maps["speed"][[0, 1, 2, -3, -2, -1]]
    assert (still == 1).all()  # the medium beside the layers is known


def test_an_inversion_that_was_killed_continues(tmp_path):
    """After each step the file holds all of it; what follows is as good as if nothing had happened."""

    class Killed(Exception):
        pass

    def stop(so_far):
        if len(so_far.history) == 4:
            raise Killed

    given, file = shots(1), tmp_path / "inversion.h5"
    with pytest.raises(Killed):
        found(given, output=file, callback=stop)
    one = found(given, output=file)
    assert [step.iteration for step in one.history] == list(range(7))
    assert one.misfit < one.history[3].misfit
    assert np.all(np.diff([step.misfit for step in one.history]) <= 0)
    more = found(given, output=file, iterations=8)
    assert len(more.history) == 9 and more.history[:7] == one.history
    same = found(given, output=file, iterations=8)
    assert same.history == more.history and np.array_equal(same.maps["speed"], more.maps["speed"])
    with pytest.raises(fh.FileFormatError, match="not the file of this inversion"):
        found(given, output=file, smooth=2.0)
    (tmp_path / "other.h5").write_bytes(b"nothing")
    with pytest.raises(fh.FileFormatError):
        found(given, output=tmp_path / "other.h5")


def test_low_frequencies_first():
    given = shots(1)
    one = found(given, frequencies=[0.05, None], iterations=2, illumination=False)
    assert [step.stage for step in one.history] == [0, 0, 0, 1, 1, 1]
    every = fh.gradient(*given[0], "speed", STEPS * DT)
    assert one.history[0].misfit < every.misfit  # fewer frequencies
    assert one.history[2].misfit < one.history[0].misfit and one.history[5].misfit < one.history[3].misfit


@pytest.mark.slow
def test_shots_on_several_processes_give_the_same():
    given = shots(2)
    one, other = found(given, iterations=2), found(given, iterations=2, jobs=2)
    np.testing.assert_allclose(one.maps["speed"], other.maps["speed"], rtol=1e-12)


def test_penalties_prefer_smooth_maps():
    given = shots(1, noise=0.05)
    rough, smooth, flat = (
        found(given, smooth=0.0, iterations=4, **more) for more in ({}, {"tikhonov": 300.0}, {"variation": 3.0})
    )

    def size(one):
        return np.abs(np.diff(one.maps["speed"], axis=0)).sum()

    assert size(smooth) < 0.8 * size(rough) and size(flat) < 0.8 * size(rough)


def test_roughness_and_means_have_the_derivatives_that_they_say():
    rng = np.random.default_rng(SEED)
    values, direction = rng.standard_normal((2, 9, 7))
    region = rng.random((9, 7)) > 0.4
    given = {"region": region, "tikhonov": 0.7, "variation": 0.3, "floor": 0.2}
    slope = roughness(values, **given)[1]
    step = 1e-5
    difference = (
        roughness(values + step * direction, **given)[0] - roughness(values - step * direction, **given)[0]
    ) / (2 * step)
    assert abs(difference - (slope * direction).sum()) < 1e-8 * abs(difference)  # step^2 and rounding / step
    means = Smoothing(1.7, region)
    other = rng.standard_normal((9, 7)) * region
    one = (means.mean(values) * other).sum()
    assert abs(one - (values * means.transposed(other)).sum()) < 1e-12
    assert means.mean(values)[region].max() <= values[region].max()
    np.testing.assert_allclose(means.mean(np.ones((9, 7)))[region], 1)


def test_frequencies_are_left_out_by_a_symmetric_filter():
    rng = np.random.default_rng(SEED)
    line = block_sums()
    times = DT * np.arange(80)
    misfit = fh.LeastSquares(line, rng.standard_normal((80, len(AROUND)))).below(0.05)
    records = {"u": rng.standard_normal((80, len(AROUND)))}
    direction = rng.standard_normal((80, len(AROUND)))
    _, slope = misfit.of(records, times)
    ends = [misfit.of({"u": records["u"] + h * direction}, times)[0] for h in (1.0, -1.0)]
    assert abs((ends[0] - ends[1]) / 2 - (slope["u"] * direction).sum()) < 1e-10  # quadratic
    slow = fh.LeastSquares(line, np.zeros((80, len(AROUND))))
    wave = {"u": np.tile(np.sin(2 * np.pi * 0.02 * times) ** 2 * np.hanning(80), (len(AROUND), 1)).T}
    fast = {"u": np.tile(np.sin(2 * np.pi * 0.4 * times) * np.hanning(80), (len(AROUND), 1)).T}
    assert abs(slow.below(0.15).of(wave, times)[0] / slow.of(wave, times)[0] - 1) < 1e-3
    assert slow.below(0.15).of(fast, times)[0] < 1e-4 * slow.of(fast, times)[0]


def given_shot(**options):
    setup = plate(np.ones(LATTICE.shape), PLACES[0])
    return replace(setup, **options), fh.LeastSquares(block_sums(), np.zeros((STEPS + 1, len(AROUND))))


REFUSED = {
    "no shot": ([], {}, "shots"),
    "no pair": ([1.0], {}, "shots[0]"),
    "no misfit": ([(given_shot()[0], 3)], {}, "shots[0].misfit"),
    "two media": ([given_shot(), given_shot(model=fh.Wave(fh.Kernel(2.0), bell()))], {}, "shots[1]"),
    "no bounds": ([given_shot()], {"bounds": {}}, "bounds"),
    "negative": ([given_shot()], {"bounds": {"speed": (-1.0, 1.2)}}, "bounds.speed"),
    "out of order": ([given_shot()], {"bounds": {"speed": (1.2, 0.9)}}, "bounds.speed"),
    "a start outside": ([given_shot()], {"bounds": {"speed": (1.1, 1.3)}}, "bounds.speed"),
    "an unstable step": ([given_shot()], {"bounds": {"speed": (0.9, 5.0)}}, "bounds"),
    "no map": ([given_shot()], {"wrt": "u"}, "wrt"),
    "negative weight": ([given_shot()], {"tikhonov": -1.0}, "tikhonov"),
    "no frequency": ([given_shot()], {"frequencies": [0.0]}, "frequencies"),
    "own misfit": (
        [(given_shot()[0], fh.OwnMisfit(block_sums(), lambda records, times: (0.0, {})))],
        {"frequencies": [0.1]},
        "frequencies",
    ),
    "published sides": ([given_shot(boundary=fh.Higdon())], {}, "boundary.x-"),
    "short data": ([(given_shot()[0], fh.LeastSquares(block_sums(), np.zeros((9, 9))))], {}, "misfit.data.u"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case, monkeypatch):
    given, options, key = REFUSED[case]

    def never(self, count=1):
        raise AssertionError("a step was made")

    monkeypatch.setattr(fh.Simulation, "step", never)
    options = {"wrt": "speed", "bounds": {"speed": (0.9, 1.2)}, **options}
    with pytest.raises(fh.InputError) as told:
        fh.invert(given, until=STEPS * DT, **options)
    assert told.value.key == key
