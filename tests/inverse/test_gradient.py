"""Gradients against the runs themselves: Taylor remainders in random directions, for every kind of side."""

import os
import re
from dataclasses import replace
from pathlib import Path

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


def check_taylor(setup, misfit, name, until, rng, agreement=1e-8, **options):
    """The remainder falls as e^2, fitted order 2 within 0.1, until 1e-10 of the misfit; and the derivative agrees with
    an extrapolated central difference.
    """
    direction = fh.gradient(setup, misfit, name, until, **options)[name] != 0
    direction = direction * rng.standard_normal(direction.shape)
    if name in ("u", "v"):  # data end inside of layers
        dim = setup.lattice.dim
        within = (..., *[slice(4, -4) if dim < 3 else slice(3, -3)] * dim)
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
    step = 2.0**-9
    one, two = ((at(h) - at(-h)) / (2 * h) for h in (step, 2 * step))
    three = (at(4 * step) - at(-4 * step)) / (8 * step)
    first, second = (4 * one - two) / 3, (4 * two - three) / 3
    # differences lose digits where the misfit is much larger than its change
    rounding = 1e-14 * misfit_here / step
    assert abs((16 * first - second) / 15 - slope) < agreement * abs(slope) + rounding


def smooth(rng, lattice, size=0.05):
    """Values around 1 that vary at random from node to node."""
    return 1 + size * rng.uniform(-1, 1, lattice.shape)


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


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", ["speed", "density", "u", "v", "source"])
@pytest.mark.parametrize("case", CASES)
def test_the_remainder_of_scalar_waves_falls_as_the_square(case, name):
    rng = drawn(f"{case} {name}")
    setup = CASES[case](rng)
    dim, steps = setup.lattice.dim, STEPS if setup.lattice.dim < 3 else 30
    points = np.array(LISTENING) if dim == 2 else [[3.0], [-4.2]] if dim == 1 else [(2.3, 0.4, -1.0), (1.0, -2.0, 1.7)]
    block_sums = fh.Receivers(points, ["u", "v"], interpolation="linear")
    data = {one: 0.05 * rng.standard_normal((steps + 1, len(points))) for one in ("u", "v")}
    check_taylor(setup, fh.LeastSquares(block_sums, data), name, steps * setup.dt, rng)


def solid(rng, sides, cracks=(), constants=("young",), dim=2, body=None, **options):
    """A solid whose constants vary at random, with a pulse, a force and an explosion."""
    shape = {1: (40,), 2: (18, 17), 3: (10, 9, 9)}[dim]
    lattice = fh.Lattice(1.0, [-(n // 2) for n in shape], [n - 1 - n // 2 for n in shape], body=body)
    base = {"young": 1.0, "bulk": 1.1, "shear": 0.5, "poisson": 0.2}
    maps = {name: base[name] * smooth(rng, lattice) for name in constants}
    density = smooth(rng, lattice)
    model = fh.Elastic(fh.Kernel(2.0 if dim < 3 else 1.5), density=density, **maps, **options)
    at = np.meshgrid(*lattice.axes, indexing="ij")
    bell = np.exp(-sum(x**2 for x in at) / 2)
    bell[bell < 1e-3] = 0
    if body is not None:
        bell *= lattice.mask
    unit = np.arange(1.0, dim + 1).reshape(-1, *[1] * dim)
    return fh.Setup(
        lattice,
        model,
        sides,
        {"u": bell * unit, "v": 0.3 * bell * unit[::-1]},
        [fh.Source(bell * unit, fh.Ricker(0.1))],
        cracks,
        dt=0.3,
    )


HOLE = fh.Box((-99.0, -99.0), (99.0, 99.0)) - fh.Disc(radius=2.5, centre=(3.0, -2.0))
SOLIDS = {
    "layers": lambda rng: solid(rng, fh.LatticePML(nodes=8)),
    "free and fixed": lambda rng: solid(rng, {"x": fh.Free(), "y-": fh.Fixed(), "y+": fh.Free()}),
    "periodic": lambda rng: solid(rng, {"x": fh.Periodic(), "y": fh.LatticePML(nodes=8)}),
    "crack": lambda rng: solid(rng, fh.LatticePML(nodes=8), [[(-2.2, -4.0), (3.3, 2.0)]]),
    "hole": lambda rng: solid(rng, {"x": fh.Sponge(5), "y": fh.LatticePML(nodes=8)}, body=HOLE),
    "sponge": lambda rng: solid(rng, fh.Sponge(5)),
    "extended": lambda rng: solid(rng, fh.Extended(nodes=8)),
    "damping": lambda rng: solid(rng, {"x": fh.Sponge(5), "y": fh.Free()}, damping=0.05),
    "space": lambda rng: solid(rng, {"x": fh.LatticePML(nodes=5), "y": fh.Free(), "z": fh.Fixed()}, dim=3),
}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", ["young", "density", "u", "v", "source"])
@pytest.mark.parametrize("case", SOLIDS)
def test_the_remainder_of_bonds_falls_as_the_square(case, name):
    rng = drawn(f"bonds {case} {name}")
    check_solid(SOLIDS[case](rng), name, rng)


def check_solid(setup, name, rng, **options):
    dim, steps = setup.lattice.dim, 60 if setup.lattice.dim < 3 else 25
    points = np.array([(4.0, 3.2, 0.0), (-3.3, -5.0, 1.0)])[:, :dim] * (1 if dim < 3 else 0.6)
    block_sums = fh.Receivers(points, ["u", "v"], interpolation="linear")
    data = {one: 0.05 * rng.standard_normal((steps + 1, len(points), dim)) for one in ("u", "v")}
    # Layers of solids filter short waves, by displacements instead of momenta; beside them runs are reciprocal to 1e-6.
    filtered = any(side.stretched for side in setup.sides.values())
    agreement = 1e-6 if filtered else 1e-8
    check_taylor(setup, fh.LeastSquares(block_sums, data), name, steps * setup.dt, rng, agreement, **options)


def diffusing(rng, sides, model, **options):
    lattice = fh.Lattice(1.0, (-9.0, -8.0), (9.0, 9.0))
    x, y = np.meshgrid(*lattice.axes, indexing="ij")
    bell = np.exp(-((x + 1) ** 2 + (y - 1) ** 2) / 2)
    source = fh.Source(np.roll(bell, 1, 1), fh.Expression("sin(t)"))
    return fh.Setup(lattice, model(rng, lattice), sides, {"u": 0.3 + bell}, [source], background=0.3, **options)


def matter(rng, lattice):
    return fh.Diffusion(fh.Kernel(2.0), smooth(rng, lattice))


def metal(rng, lattice):
    maps = {name: smooth(rng, lattice) for name in ("density", "specific_heat", "conductivity")}
    return fh.Heat(fh.Kernel(2.0), **maps)


def rod(rng, sides, model):
    lattice = fh.Lattice(1.0, -20.0, 20.0)
    [x] = lattice.axes
    bell = np.exp(-((x - 1) ** 2) / 2)
    source = fh.Source(np.roll(bell, 1), fh.Expression("sin(t)"))
    return fh.Setup(lattice, model(rng, lattice), sides, {"u": 0.3 + bell}, [source], background=0.3)


FLOWS = {
    "layers": lambda rng, model: diffusing(rng, fh.LatticePML(nodes=12), model),
    "walls": lambda rng, model: diffusing(rng, {"x": fh.Periodic(), "y-": fh.Fixed(0.5), "y+": fh.Free()}, model),
    "crack": lambda rng, model: diffusing(rng, fh.LatticePML(nodes=12), model, cracks=[[(-2.2, -4.0), (3.3, 2.0)]]),
    "sponge": lambda rng, model: diffusing(rng, fh.Sponge(5), model),
    "extended": lambda rng, model: diffusing(rng, fh.Extended(nodes=8), model),
    "exact ends": lambda rng, model: rod(rng, fh.Exact(), model),
}


@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    ("model", "name"),
    [(matter, name) for name in ("diffusivity", "u", "source")]
    + [(metal, name) for name in ("conductivity", "density", "specific_heat", "u", "source")],
)
@pytest.mark.parametrize("case", FLOWS)
def test_the_remainder_of_diffusion_falls_as_the_square(case, model, name):
    rng = drawn(f"{case} {model.__name__} {name}")
    setup = FLOWS[case](rng, model)
    setup = replace(setup, dt=fh.Simulation.of(setup).dt)
    points = LISTENING if setup.lattice.dim == 2 else [5.0, -4.3]
    block_sums = fh.Receivers(points, interpolation="linear", every=3)
    data = 0.3 + 0.05 * rng.standard_normal((STEPS // 3 + 1, len(points)))
    check_taylor(setup, fh.LeastSquares(block_sums, data), name, STEPS * setup.dt, rng)


STATES = {
    "state-based": {"material": "state-based", "constants": ("bulk", "shear")},
    "young and poisson": {"material": "state-based", "constants": ("young", "poisson")},
    "correspondence": {"material": "correspondence", "constants": ("bulk", "shear"), "stabilisation": 0.1},
}
SIDES_OF_STATES = {
    "layers": lambda rng, **given: solid(rng, fh.LatticePML(nodes=8), **given),
    "walls": lambda rng, **given: solid(rng, {"x": fh.Fixed(), "y-": fh.Free(), "y+": fh.Extended(nodes=6)}, **given),
    "periodic": lambda rng, **given: solid(rng, {"x": fh.Periodic(), "y": fh.Free()}, **given),
    "crack": lambda rng, **given: solid(rng, fh.Sponge(5), [[(-2.2, -4.0), (3.3, 2.0)]], **given),
    "sponge": lambda rng, **given: solid(rng, fh.Sponge(5), damping=0.03, **given),
    "hole": lambda rng, **given: solid(rng, {"x": fh.Periodic(), "y": fh.Sponge(5)}, body=HOLE, **given),
    "space": lambda rng, **given: solid(rng, {"x": fh.Free(), "y": fh.Fixed(), "z": fh.Periodic()}, dim=3, **given),
}


@pytest.mark.sampled(7)
@pytest.mark.parametrize("number", [0, 1, "density", "u", "source"])
@pytest.mark.parametrize("material", STATES)
@pytest.mark.parametrize("case", SIDES_OF_STATES)
def test_the_remainder_of_states_falls_as_the_square(case, material, number):
    rng = drawn(f"{material} {case} {number}")
    given = STATES[material]
    if material == "correspondence" and case == "layers":
        pytest.skip("layers of correspondence materials filter the waves themselves: see the test below")
    name = given["constants"][number] if isinstance(number, int) else number
    check_solid(SIDES_OF_STATES[case](rng, **given), name, rng)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", ["young", "u", "source"])
@pytest.mark.parametrize("shape_tensor", ["recomputed", "published", "kept"])
def test_the_remainder_with_shape_tensors_of_cut_bonds_falls_as_the_square(shape_tensor, name):
    rng = drawn(f"{shape_tensor} {name}")
    setup = solid(rng, {"x": fh.Free(), "y": fh.Fixed()}, [[(-2.2, -4.0), (3.3, 2.0)]], body=HOLE)
    young = smooth(rng, setup.lattice)
    model = fh.Correspondence(fh.Kernel(2.0), young, 0.2, shape_tensor=shape_tensor, stabilisation=0.1)
    check_solid(replace(setup, model=model), name, rng)


@pytest.mark.parametrize("name", ["u", "v"])
def test_the_remainder_of_beams_falls_as_the_square(name):
    rng = drawn(f"beam {name}")
    lattice = fh.Lattice(0.3, -6.0, 6.0)
    bell = np.exp(-4 * lattice.axes[0] ** 2)
    setup = fh.Setup(lattice, fh.Beam(), fh.Fixed(), {"u": bell, "v": 0.3 * bell})
    setup = replace(setup, dt=fh.Simulation.of(setup).dt)
    data = 0.05 * rng.standard_normal((STEPS + 1, 2))
    line = fh.Receivers([2.0, -1.3], interpolation="linear")
    check_taylor(setup, fh.LeastSquares(line, data), name, STEPS * setup.dt, rng)


def test_layers_of_correspondence_materials_are_reciprocal_up_to_their_filter():
    """They damp zero-energy modes by a filter of both levels, which is not symmetric; what passes it is small."""
    rng = drawn("correspondence layers")
    setup = solid(rng, fh.LatticePML(nodes=8), **STATES["correspondence"])
    block_sums = fh.Receivers([(3.0, 2.0)], interpolation="linear")
    misfit = fh.LeastSquares(block_sums, 0.05 * rng.standard_normal((61, 1, 2)))
    direction = rng.standard_normal(setup.lattice.shape)
    direction *= fh.gradient(setup, misfit, "bulk", 60 * setup.dt)["bulk"] != 0
    *_, slope, _, at = remainders(setup, misfit, "bulk", 60 * setup.dt, direction, [])
    step = 2.0**-10
    difference = (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step)
    assert abs(difference - slope) < 1e-4 * abs(slope)


def test_the_how_to_computes_what_it_says(capsys):
    """Its blocks are one program; the remainders of its Taylor test fall by four for half the step."""
    text = (Path(__file__).parents[2] / "docs/howto/invert.md").read_text(encoding="utf-8")
    exec("\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL)), {})
    *_, coarse, middle, fine = (float(line.split()[1]) for line in capsys.readouterr().out.splitlines()[-3:])
    assert 3 < coarse / middle < 5 and 3.5 < middle / fine < 4.5
