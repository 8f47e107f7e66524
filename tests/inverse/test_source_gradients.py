"""Gradients by the places and strengths of sources: Taylor remainders of the runs themselves."""

import os
from dataclasses import replace

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.geometry.interpolation import interpolation_blocks

SEED = int(os.environ.get("FARHORIZON_SEED", 770080))
STEPS, DT = 60, 0.4

PULSE = fh.Ricker(0.1)


def drawn(case):
    """Generator of a case; its seed is printed, so that FARHORIZON_SEED repeats it."""
    print(f"FARHORIZON_SEED={SEED}, case {case}")
    return np.random.default_rng([SEED, *map(ord, case)])


def tensor(rng, dim):
    half = rng.standard_normal((dim, dim))
    return (half + half.T).tolist()


def sources(rng):
    """Each kind of source at a place drawn at random, which no step moves past a node, with its model."""
    at, solid = rng.integers(-1, 1, 2) + rng.uniform(0.3, 0.7, 2), fh.Elastic(fh.Kernel(2.0), young=1.0)
    varied = fh.Elastic(fh.Kernel(2.0), bulk=1.1, shear=0.5, material="state-based", density=1.3)
    return {
        "point": (fh.PointSource(at, 1.3, PULSE), fh.Wave(fh.Kernel(2.0), density=1.2)),
        "linear": (fh.PointSource(at, 0.7, PULSE, "linear"), fh.Wave(fh.Kernel(2.0), damping=0.03)),
        "of heat": (fh.PointSource(at, 1.0, "sin(t)"), fh.Diffusion(fh.Kernel(2.0))),
        "force": (fh.PointForce(at, rng.standard_normal(2), PULSE), solid),
        "linear force": (fh.PointForce(at, rng.standard_normal(2), None, "linear"), varied),
        "moment": (fh.MomentTensor(at, tensor(rng, 2), PULSE), solid),
        "linear moment": (fh.MomentTensor(at, tensor(rng, 2), PULSE, interpolation="linear"), varied),
        "explosion": (fh.MomentTensor((0.4, 1.6), 0.8, PULSE), solid),
        "line": (fh.LineSource([at, at + 3.2], 0.8, PULSE), fh.Wave(fh.Kernel(2.0))),
    }


CASES = [
    (name, parameter)
    for name, parameters in {
        **dict.fromkeys(["point", "linear", "of heat"], ("at", "strength")),
        **dict.fromkeys(["force", "linear force"], ("at", "force")),
        **dict.fromkeys(["moment", "linear moment", "explosion"], ("at", "moment")),
        "line": ("strength",),
    }.items()
    for parameter in parameters
]


def measured(setup, misfit):
    run = fh.Simulation.of(setup, observe=[misfit.receivers])
    run.step(STEPS)
    return misfit.of(misfit.receivers.data, misfit.receivers.times)[0]


def extrapolated(at, step, levels=5):
    """The derivative at 0 of a smooth function, from central differences of steps that are halved (Romberg)."""
    row = []
    for level in range(levels):
        size, before = step / 2**level, row
        row = [(at(size) - at(-size)) / (2 * size)]
        for power, coarse in enumerate(before, 1):
            row.append((4**power * row[-1] - coarse) / (4**power - 1))
    return row[-1]


@pytest.mark.parametrize(("name", "parameter"), CASES)
def test_the_remainder_falls_as_the_square(name, parameter):
    """By a place the misfit is no polynomial; by a strength it is a parabola, and the remainder exactly a square."""
    rng = drawn(f"{name} {parameter}")
    source, model = sources(rng)[name]
    lattice = fh.Lattice(1.0, (-13.0, -13.0), (14.0, 13.0))
    sides = {"x-": fh.Free(), "all": fh.LatticePML(nodes=6)}
    given = {"dt": DT} if model.order == 2 else {}
    setup = fh.Setup(lattice, model, sides, sources=[source], **given)
    setup = replace(setup, dt=fh.Simulation.of(setup).dt)
    points = [(6.0, 4.0), (-4.3, -5.6), (5.2, -6.0)]
    shape = (STEPS + 1, len(points)) if not model.mechanical else (STEPS + 1, len(points), 2)
    line = fh.Receivers(points, interpolation="linear")
    misfit = fh.LeastSquares(line, 0.01 * rng.standard_normal(shape))
    until = STEPS * setup.dt
    found = fh.gradient(setup, misfit, f"source.{parameter}", until)
    slopes = found[f"source.{parameter}"]
    value = np.asarray(getattr(source, parameter))
    assert slopes.shape == value.shape
    direction = rng.uniform(-1, 1, value.shape)
    if value.ndim == 2:
        direction = direction + direction.T
    slope, sizes = float((slopes * direction).sum()), 2.0 ** -np.arange(4, 14)

    def at(size):
        moved = (value + size * direction).tolist()
        return measured(replace(found.setup, sources=[replace(source, **{parameter: moved})]), misfit)

    remainders = np.abs([at(size) - found.misfit - size * slope for size in sizes])
    print(name, parameter, found.misfit, slope, remainders)
    clear = remainders > 1e-10 * found.misfit
    assert clear.sum() >= 3
    order = np.polyfit(np.log(sizes[clear][-4:]), np.log(remainders[clear][-4:]), 1)[0]
    assert abs(order - 2) < 0.1
    # a quarter of a spacing moves no place past a node; the smallest differences lose digits of the misfit
    rounding = 1e-14 * found.misfit / (0.25 / 16)
    assert abs(extrapolated(at, 0.25) - slope) < 1e-8 * abs(slope) + rounding


def test_a_double_couple_in_space():
    """The moment, angles and place of one of two sources, together with the medium."""
    rng = drawn("double couple")
    lattice = fh.Lattice(1.0, (-9.0, -9.0, -9.0), (9.0, 9.0, 9.0))
    quake = fh.MomentTensor((0.2, -0.4, 0.1), 1.5, PULSE, 20.0, 70.0, -30.0, "linear")
    push = fh.PointForce((3.0, 2.0, 1.0), (0.1, 0.2, -0.1), PULSE)
    setup = fh.Setup(
        lattice, fh.Elastic(fh.Kernel(1.5), young=1.0), fh.LatticePML(nodes=4), sources=[push, quake], dt=0.4
    )
    line = fh.Receivers([(4.0, 3.0, 1.0), (-4.0, 1.0, -2.0)])
    misfit = fh.LeastSquares(line, 0.01 * rng.standard_normal((STEPS // 2 + 1, 2, 3)))
    found = fh.gradient(
        setup,
        misfit,
        ["young", "source[0].force", *(f"source[1].{name}" for name in ("at", "moment", "strike", "dip", "rake"))],
        STEPS // 2 * 0.4,
    )
    assert found["source[1].moment"].shape == () and found["source[0].force"].shape == (3,)

    def at(**changes):
        run = fh.Simulation.of(replace(found.setup, sources=[push, replace(quake, **changes)]), observe=[line])
        run.step(STEPS // 2)
        return misfit.of(line.data, line.times)[0]

    for name in ("moment", "strike", "dip", "rake"):
        value = getattr(quake, name)
        slope = extrapolated(lambda size, name=name, value=value: at(**{name: value * (1 + size)}) / value, 0.05, 3)
        assert abs(slope - found[f"source[1].{name}"]) < 1e-8 * abs(slope), name
    for axis, slope in enumerate(found["source[1].at"]):
        along = np.eye(3)[axis]
        difference = extrapolated(lambda size, along=along: at(at=np.array(quake.at) + size * along), 0.09, 3)
        assert abs(difference - slope) < 1e-8 * np.abs(found["source[1].at"]).max()


@pytest.mark.parametrize("derivative", [None, 0, 1])
@pytest.mark.parametrize("method", ["sinc", "linear"])
def test_weights_of_a_point_that_moves(method, derivative):
    """Their derivatives are those of the weights by the place; the window of the sinc ends at 3e-5 of its middle, so
    that a node which enters it makes a kink of some 1e-5 where the point passes a node.
    """
    lattice = fh.Lattice(0.5, (-8.0, -8.0), (8.0, 8.0))

    def weights(x, **more):
        nodes, values = interpolation_blocks(lattice, np.array([[x, 0.2]]), method, derivative, **more).entries()
        return np.bincount(nodes[0], values[0], int(np.prod(lattice.shape)))

    step = 1e-5
    difference = (weights(0.13 + step) - weights(0.13 - step)) / (2 * step)
    exact = weights(0.13, moving=0)
    assert np.abs(exact - difference).max() < 1e-7 * np.abs(exact).max()
    if method == "sinc" and derivative != 0:
        difference = (weights(0.5 + step) - weights(0.5 - step)) / (2 * step)
        assert np.abs(weights(0.5, moving=0) - difference).max() < 1e-5 * np.abs(exact).max()


REFUSED = {
    "a kink": (fh.PointSource((1.0, 0.3), interpolation="linear"), "source.at", "source.at", "sinc"),
    "no force": (fh.PointSource((1.0, 0.3)), "source.force", "wrt", "source.strength"),
    "no place": (fh.LineSource([(0.0, 0.0), (1.0, 1.0)], 1.0), "source.at", "wrt", "source.strength"),
    "no number": (fh.PointSource((1.0, 0.3)), "source[1].at", "wrt", "source.at"),
    "an expression": ("exp(-x**2)", "source.at", "wrt", "source"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case, monkeypatch):
    source, wrt, key, remedy = REFUSED[case]
    lattice = fh.Lattice(1.0, (-13.0, -13.0), (13.0, 13.0))
    setup = fh.Setup(lattice, fh.Wave(fh.Kernel(2.0)), fh.LatticePML(nodes=6), sources=[source], dt=DT)

    def never(self, count=1):
        raise AssertionError("a step was made")

    monkeypatch.setattr(fh.Simulation, "step", never)
    with pytest.raises(fh.InputError) as told:
        fh.gradient(setup, fh.LeastSquares(fh.Receivers([(3.0, 2.0)]), np.zeros((11, 1))), wrt, 10 * DT)
    assert told.value.key == key and remedy in str(told.value)


def test_an_inversion_finds_no_places():
    setup = fh.Setup(fh.Lattice(1.0, -20.0, 20.0), fh.Wave(fh.Kernel(2.0)), sources=[fh.PointSource(0.3)], dt=DT)
    misfit = fh.LeastSquares(fh.Receivers([3.0]), np.zeros((11, 1)))
    with pytest.raises(fh.InputError, match=r"wrt: an inversion finds maps of the medium"):
        fh.invert([(setup, misfit)], ["speed", "source.at"], 10 * DT, bounds={"speed": (0.5, 2.0)})
