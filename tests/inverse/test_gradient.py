"""Gradients against the runs themselves: Taylor remainders in random directions, for every kind of side."""

import os
from dataclasses import replace

import numpy as np
import pytest

import farhorizon as fh

SEED = int(os.environ.get("FARHORIZON_SEED", 770077))
STEPS = 90


def drawn(case):
    """Generator of a case; its seed is printed, so that FARHORIZON_SEED repeats it."""
    print(f"FARHORIZON_SEED={SEED}, case {case}")
    return np.random.default_rng([SEED, *map(ord, case)])


def changed(setup, name, values):
    """The set-up with other values of what `fh.gradient` names."""
    if name in ("u", "v"):
        return replace(setup, initial={**setup.initial, name: values})
    if name == "source":
        [source] = setup.sources
        course = lambda t: values[min(round(t / setup.dt), len(values) - 1)]  # noqa: E731
        return replace(setup, sources=[fh.Source(source.value, course)])
    return replace(setup, model=setup.model.with_constants({name: values}))


def given(setup, name, steps):
    if name in ("u", "v"):
        return setup.initial[name]
    if name == "source":
        return np.array([setup.sources[0].time(n * setup.dt) for n in range(steps)])
    return setup.model.wave_constants[name]


def remainders(setup, misfit, name, until, direction, sizes, **options):
    """The misfit, its derivative in a direction, and ``J(m + e v) - J(m) - e g.v`` for some e."""
    found = fh.gradient(setup, misfit, name, until, **options)
    here = found.setup
    values = given(here, name, round(until / here.dt))
    slope = float((found[name] * direction).sum())

    def at(size):
        run = fh.Simulation.of(changed(here, name, values + size * direction), observe=[misfit.receivers])
        run.step(round(until / here.dt))
        return misfit.of(misfit.receivers.data, misfit.receivers.times)[0]

    return found.misfit, slope, [at(size) - found.misfit - size * slope for size in sizes], at


def check_taylor(setup, misfit, name, until, rng, **options):
    """The remainder falls as e^2, fitted order 2 within 0.1, until 1e-10 of the misfit; and the derivative agrees with
    an extrapolated central difference to 1e-8.
    """
    direction = fh.gradient(setup, misfit, name, until, **options)[name] != 0
    direction = direction * rng.standard_normal(direction.shape)
    if name in ("u", "v"):  # data end inside of layers
        within = tuple(slice(4, -4) for _ in direction.shape)
        inner = np.zeros_like(direction)
        inner[within] = direction[within]
        direction = inner
    scale = 1 if name not in ("u", "v", "source") else np.abs(given(setup, name, round(until / setup.dt))).max()
    direction *= scale / np.abs(direction).max()
    sizes = 2.0 ** -np.arange(4, 16, 2)
    misfit_here, slope, found, at = remainders(setup, misfit, name, until, direction, sizes, **options)
    found = np.abs(found)
    clear = found > 1e-10 * misfit_here
    print(name, misfit_here, slope, found)
    assert clear.sum() >= 3, "the direction changes nothing"
    order = np.polyfit(np.log(sizes[clear][1:]), np.log(found[clear][1:]), 1)[0]
    assert abs(order - 2) < 0.1
    step = 2.0**-8
    one, two = ((at(h) - at(-h)) / (2 * h) for h in (step, 2 * step))
    three = (at(4 * step) - at(-4 * step)) / (8 * step)
    first, second = (4 * one - two) / 3, (4 * two - three) / 3
    # differences lose digits where the misfit is much larger than its change
    rounding = 1e-14 * misfit_here / step
    assert abs((16 * first - second) / 15 - slope) < 1e-8 * abs(slope) + rounding


def smooth(rng, lattice, size=0.05):
    """Values around 1 that vary at random from node to node."""
    return 1 + size * rng.uniform(-1, 1, lattice.shape)


BODY = fh.Box((-9.0, -9.0), (9.0, 9.0)) - fh.Disc(radius=2.5, centre=(1.0, -3.0))


def bar(rng, sides):
    lattice = fh.Lattice(0.5, -10.0, 10.0)
    model = fh.Wave(fh.Kernel(1.0), smooth(rng, lattice), density=smooth(rng, lattice))
    [x] = lattice.axes
    bell = np.exp(-((x + 3) ** 2))
    return fh.Setup(lattice, model, sides, {"u": bell, "v": 0.3 * bell}, [fh.Source(bell, fh.Ricker(0.1))], dt=0.2)


def block(rng, sides):
    lattice = fh.Lattice(1.0, (-5.0, -5.0, -4.0), (5.0, 4.0, 5.0))
    model = fh.Wave(fh.Kernel(1.5), smooth(rng, lattice), density=smooth(rng, lattice))
    at = np.meshgrid(*lattice.axes, indexing="ij")
    bell = np.exp(-sum(x**2 for x in at) / 2)
    bell[bell < 1e-4] = 0
    return fh.Setup(lattice, model, sides, {"u": bell, "v": 0.3 * bell}, [fh.Source(bell, fh.Ricker(0.1))], dt=0.3)


def plate(rng, sides, body=None, cracks=(), damping=0.0, constraints=(), rule=None, dtype="float64"):
    lattice = fh.Lattice(1.0, (-9.0, -8.0), (9.0, 9.0), body=body)
    model = fh.Wave(fh.Kernel(2.0), smooth(rng, lattice), damping, density=smooth(rng, lattice))
    x, y = np.meshgrid(*lattice.axes, indexing="ij")
    bell = np.exp(-((x + 3) ** 2 + (y - 2) ** 2) / 2)
    if body is not None:
        bell *= lattice.mask
    initial = {"u": 0.5 * bell, "v": 0.3 * np.roll(bell, 2, 0)}
    source = fh.Source(np.roll(bell, 1, 1), fh.Ricker(0.08))
    return fh.Setup(
        lattice, model, sides, initial, [source], cracks, dt=0.4, constraints=constraints, rule=rule, dtype=dtype
    )


LISTENING = [(5.0, 4.0), (-4.3, -5.6), (6.2, -6.0)]
CASES = {
    "layers": lambda rng: plate(rng, fh.LatticePML(nodes=8)),
    "arithmetic": lambda rng: plate(rng, fh.LatticePML(nodes=8), rule="arithmetic"),
    "free and fixed": lambda rng: plate(rng, {"x": fh.Free(), "y-": fh.Fixed(0.2), "y+": fh.Fixed()}),
    "free beside layers": lambda rng: plate(
        rng, {"x": fh.LatticePML(nodes=8), "y-": fh.LatticePML(nodes=8), "y+": fh.Free()}
    ),
    "periodic": lambda rng: plate(rng, {"x": fh.Periodic(), "y": fh.LatticePML(nodes=8)}),
    "periodic throughout": lambda rng: plate(rng, fh.Periodic()),
    "sponge": lambda rng: plate(rng, fh.Sponge(5)),
    "extended": lambda rng: plate(rng, fh.Extended(nodes=8)),
    "crack": lambda rng: plate(
        rng, fh.LatticePML(nodes=8), cracks=[[(-2.2, -4.0), (3.3, 2.0)], fh.Crack([(0.5, 4.0), (4.0, 4.3)], factor=0.3)]
    ),
    "hole": lambda rng: plate(
        rng, fh.LatticePML(nodes=8), body=fh.Box((-99.0, -99.0), (99.0, 99.0)) - fh.Disc(radius=2.5, centre=(1.0, -3.0))
    ),
    "exact ends": lambda rng: bar(rng, fh.Exact()),
    "a bar with layers": lambda rng: bar(rng, {"x-": fh.LatticePML(nodes=12), "x+": fh.Free()}),
    "space": lambda rng: block(
        rng, {"x": fh.LatticePML(nodes=6), "y": fh.Periodic(), "z-": fh.Fixed(), "z+": fh.Free()}
    ),
    "damping": lambda rng: plate(rng, fh.LatticePML(nodes=8), damping=0.05),
    "held nodes": lambda rng: plate(
        rng, fh.LatticePML(nodes=8), constraints=[fh.Prescribed([(2.0, 1.0), (3.0, 1.0)], "0.1*sin(t)")]
    ),
}


@pytest.mark.parametrize("name", ["speed", "density", "u", "v", "source"])
@pytest.mark.parametrize("case", CASES)
def test_the_remainder_of_scalar_waves_falls_as_the_square(case, name):
    rng = drawn(f"{case} {name}")
    setup = CASES[case](rng)
    dim, steps = setup.lattice.dim, STEPS if setup.lattice.dim < 3 else 30
    points = np.array(LISTENING) if dim == 2 else [[3.0], [-4.2]] if dim == 1 else [(2.3, 0.4, -1.0), (1.0, -2.0, 1.7)]
    listening = fh.Receivers(points, ["u", "v"], interpolation="linear")
    data = {one: 0.05 * rng.standard_normal((steps + 1, len(points))) for one in ("u", "v")}
    check_taylor(setup, fh.LeastSquares(listening, data), name, steps * setup.dt, rng)
