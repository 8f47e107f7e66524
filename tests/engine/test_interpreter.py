"""The compiled loop against the plain numpy program that interprets the same table of operations."""

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine.state import sums_of
from interpreter import Interpreter

SEED = 20261122
WAVE, SLOW = fh.Wave(fh.Kernel(2.0)), fh.LatticePML(nodes=3)
ELASTIC = {"young": 1.0, "critical_stretch": 0.02}


def lattice(*shape, **more):
    """A box whose first node is at the origin."""
    return fh.Lattice(spacing=1.0, lower=[0.0] * len(shape), upper=[n - 1.0 for n in shape], **more)


def bump(shape, components=0):
    """Random values on a few nodes in the middle, so that the memory of the layers is zero at the start."""
    values = np.zeros((components, *shape) if components else shape)
    middle = tuple(slice(n // 2 - 1, n // 2 + 2) for n in shape)
    at = (..., *middle)
    values[at] = np.random.default_rng([SEED, components, *shape]).standard_normal(values[at].shape)
    return values


def source(shape, components=0):
    """Two sources with different functions of time."""
    return [fh.Source(bump(shape, components), "sin(2*t)"), fh.Source(bump(shape, components) ** 2, "cos(t)")]


def waves(shape, sides=SLOW, model=WAVE, **more):
    return fh.Simulation(lattice(*shape), model, sides, {"u": bump(shape)}, **more)


def drawn_back(dim):
    """Waves of a stencil with a reaction."""
    return fh.Wave(fh.Stencil.from_kernel(fh.Kernel(2.0), 1.0, dim).with_reaction(0.2))


def lossy(horizon=2.0, regions=(), **more):
    """Waves with a low quality factor, so that relaxation shows."""
    return fh.Wave(fh.Kernel(horizon), attenuation=fh.Attenuation(5.0, (0.02, 0.2), regions=regions), **more)


def half(shape):
    """A coefficient that varies in the middle."""
    values = np.ones(shape)
    values[tuple(slice(n // 2, n // 2 + 2) for n in shape)] = 0.5
    return values


def heated(material, poisson, **more):
    """A body with a hole and a crack under thermal strain, until it breaks."""
    return fh.Simulation(
        fh.Lattice(1.0, (0.0, 0.0), (16.0, 15.0), body=fh.Box((-1.0, -1.0), (17.0, 16.0)) - fh.Disc(2.2, (12.0, 4.0))),
        fh.Elastic(fh.Kernel(2.0), 1.0, poisson, material=material, critical_stretch=0.006, **more),
        fh.Free(),
        {"v": 0.02 * bump((17, 16), 2)},
        cracks=[fh.Crack([(6.1, 9.3), (9.2, 9.3)])],
        loads=[fh.ThermalLoad("2*sin(x)*cos(y)*(1 + t)", expansion="1e-3*(1 + (x > 8))", reference=0.0)],
        balance=True,
    )


def closing(material, poisson, shape=(21, 22), sides=None, cracks=(), **more):
    """A solid with states, full of cracks that close, open and meet others."""
    model = fh.Elastic(fh.Kernel(1.5 if len(shape) > 2 else 2.0), 1.0, poisson, material=material, contact=True, **more)
    v = 0.03 * bump(shape, len(shape))
    return fh.Simulation(lattice(*shape), model, sides or fh.Free(), {"v": v}, cracks=cracks, balance=True)


ACROSS = [fh.Crack([(7.2, 9.4), (14.1, 11.6)]), fh.Crack([(10.6, 7.3), (10.6, 13.2)], opens=2.0)]
CASES = {
    "1D": lambda: waves((23,)),
    "1D, source": lambda: waves((23,), sources=source((23,))),
    "2D": lambda: waves((15, 16)),
    "2D, corner, periodic": lambda: waves((15, 16), {"x": fh.Periodic(), "y": SLOW}, sources=source((15, 16))),
    "2D, free and sponge": lambda: waves((15, 16), {"x-": fh.Free(), "x+": fh.Sponge(4), "y": SLOW}),
    "2D, coefficient": lambda: waves((17, 18), coefficient=half((17, 18)), rule="harmonic"),
    "1D, attenuation": lambda: waves((23,), model=lossy(), sources=source((23,))),
    "2D, attenuation, coefficient, free and sponge": lambda: waves(
        (17, 18), {"x-": fh.Free(), "x+": fh.Sponge(4), "y": SLOW}, lossy(), coefficient=half((17, 18))
    ),
    "2D, attenuation, damping, density": lambda: waves(
        (17, 18), {"x": fh.Periodic(), "y": SLOW}, lossy(damping=0.1, density=1 + half((17, 18)))
    ),
    "1D, attenuation, balance": lambda: waves((23,), model=lossy(), sources=source((23,)), balance=True),
    "2D, attenuation by region": lambda: waves(
        (17, 18),
        {"x-": fh.Free(), "x+": SLOW, "y": SLOW},
        lossy(regions=[fh.LossyRegion(fh.Disc(3.0, (8.0, 9.0)), 20.0)]),
    ),
    "3D, attenuation": lambda: waves((7, 8, 9), SLOW, lossy(1.5)),
    "solid of states with attenuation": lambda: fh.Simulation(
        lattice(15, 16),
        fh.Elastic(fh.Kernel(2.0), 1.0, 0.3, material="state-based", attenuation=fh.Attenuation(5.0, (0.02, 0.2))),
        {"x-": fh.Free(), "x+": SLOW, "y": SLOW},
        {"u": bump((15, 16), 2)},
        cracks=[fh.Crack([(6.1, 9.3), (9.2, 9.3)])],
    ),
    "1D, reaction": lambda: waves((23,), model=drawn_back(1)),
    "1D, reaction, coefficient": lambda: waves((23,), model=drawn_back(1), coefficient=half((23,))),
    "2D, reaction": lambda: waves((15, 16), model=drawn_back(2)),
    "2D, reaction, coefficient": lambda: waves((17, 18), model=drawn_back(2), coefficient=half((17, 18))),
    "2D, density": lambda: waves(
        (17, 18),
        {"x": SLOW, "y-": fh.Sponge(3), "y+": fh.Free()},
        fh.Wave(fh.Kernel(2.0), "1 + (x < 8)", damping=0.1, density="2 - (y > 8)"),
        sources=source((17, 18)),
    ),
    "2D, receivers": lambda: waves((21, 22), observe=[fh.Receivers([(10.2, 11.7), (9.0, 12.5)], ["u", "gradient"])]),
    "2D, crack into a layer": lambda: waves((15, 16), cracks=[[(8.5, 8.2), (8.5, 40.0)]]),
    "2D, body": lambda: fh.Simulation(
        lattice(15, 16, body=fh.Disc(6.0, (7.0, 8.0))), WAVE, fh.Free(), {"u": bump((15, 16))}
    ),
    "2D, ground": lambda: fh.Simulation(
        lattice(15, 18, body=fh.Polygon([(-99, -99), (99, -99), (99, 15.2), (-99, 15.2)])),
        WAVE,
        {"x": SLOW, "y-": SLOW, "y+": fh.Free()},
        {"u": bump((15, 18))},
    ),
    "2D, held for a while": lambda: fh.Simulation(
        lattice(15, 16), WAVE, SLOW, constraints=[fh.Prescribed([(7.0, 8.0)], "sin(t)", until=4.0)]
    ),
    "2D, window": lambda: fh.Simulation(
        fh.Lattice(1.0, window=fh.Disc(7.0)), WAVE, fh.Higdon(), {"u": "exp(-(x**2+y**2)*2)"}
    ),
    "3D": lambda: waves(
        (17, 18, 19),
        observe=[fh.Receivers([(8.3, 9.4, 9.5), (8.0, 9.0, 9.0)]), fh.Spectra(fh.Box((3, 4, 5), (9, 9, 9)), 0.1)],
    ),
    "3D, reach 1 and 2": lambda: waves((11, 12, 13), {"x": SLOW, "y-": fh.Fixed(0.0), "y+": SLOW, "z": fh.Periodic()}),
    "modified equation": lambda: waves(
        (17, 18, 19), model=fh.Wave(fh.Kernel(1.5), integrator="modified-equation"), sources=source((17, 18, 19))
    ),
    "modified equation, solid": lambda: fh.Simulation(
        lattice(19, 20),
        fh.Elastic(fh.Kernel(2.0), 1.0, 0.3, material="state-based", integrator="modified-equation"),
        {"x": SLOW, "y-": SLOW, "y+": fh.Free()},
        {"u": bump((19, 20), 2)},
        sources=source((19, 20), 2),
        cracks=[[(8.5, 8.2), (8.5, 11.3)]],
    ),
    "exact ends": lambda: waves((40,), fh.Exact(), sources=source((40,))),
    "diffusion, Chebyshev": lambda: waves(
        (15, 16), SLOW, fh.Diffusion(fh.Kernel(2.0), integrator=fh.RungeKuttaChebyshev(4)), sources=source((15, 16))
    ),
    "diffusion, balance": lambda: waves((15, 16), SLOW, fh.Diffusion(fh.Kernel(2.0)), balance=True),
    "heat, conditions": lambda: fh.Simulation(
        lattice(15, 16),
        fh.Heat(fh.Kernel(2.0)),
        {"x": fh.Free(), "y": fh.Periodic()},
        constraints=[fh.Temperature("x-", "sin(t)", kind="mirror"), fh.Convection("x+", 0.4, 1.0)],
        balance=True,
    ),
    "elastic": lambda: fh.Simulation(
        lattice(13, 14),
        fh.Elastic(fh.Kernel(2.0), 1.0),
        fh.LatticePML(nodes=5),
        {"u": 1e-3 * bump((13, 14), 2)},
        observe=[
            fh.Receivers([(2.3, 7.0), (10.4, 6.2)], ["stress"], every=2, interpolation="linear"),
            fh.Spectra(fh.Box((0, 0), (12, 12)), [0.1, 0.2], every=2),
        ],
    ),
    "breaking bonds": lambda: fh.Simulation(
        lattice(13, 14),
        fh.Elastic(fh.Kernel(2.0), **ELASTIC),
        {"x": SLOW, "y": fh.Free()},
        {"v": 0.03 * bump((13, 14), 2)},
        sources=[fh.Source(1e-3 * bump((13, 14), 2), "sin(t)")],
        balance=True,
    ),
    "broken bonds that carry compression": lambda: fh.Simulation(
        lattice(13, 14),
        fh.Elastic(fh.Kernel(2.0), 1.0, critical_stretch=0.02, contact=True),
        fh.Free(),
        {"v": 0.05 * bump((13, 14), 2)},
        balance=True,
    ),
    "bonds that soften, cut and heated": lambda: fh.Simulation(
        lattice(13, 14),
        fh.Elastic(fh.Kernel(2.0), 1.0, critical_stretch=0.01, softening="linear", fracture_energy="1e-3 + 1e-4*x"),
        {"x": fh.Periodic(), "y": fh.Free()},
        {"v": 0.05 * bump((13, 14), 2)},
        cracks=[fh.Crack([(4.3, 7.4), (8.5, 7.4)])],
        loads=[fh.ThermalLoad("exp(-(y - 7)**2)*cos(x)*(1 + t)", expansion=-4e-3, reference=0.0, every=1.0)],
        balance=True,
        coefficient=half((13, 14)),
    ),
    "bonds that soften exponentially and carry compression": lambda: fh.Simulation(
        lattice(9, 8, 7),
        fh.Elastic(
            fh.Kernel(1.5),
            1.0,
            critical_stretch=fh.Weibull(0.02, 5, 1.0),
            softening="exponential",
            fracture_energy=5e-3,
            contact=True,
            nonlinear=True,
        ),
        fh.Free(),
        {"v": 0.05 * bump((9, 8, 7), 3)},
        balance=True,
    ),
    "breaking bonds of many strengths": lambda: fh.Simulation(
        lattice(13, 14),
        fh.Elastic(fh.Kernel(2.0), 1.0, critical_stretch=fh.Weibull(0.02, 5, 1.0)),
        {"x": SLOW, "y": fh.Free()},
        {"v": 0.03 * bump((13, 14), 2)},
        balance=True,
    ),
    "breaking bonds of many energies": lambda: fh.Simulation(
        lattice(13, 14),
        fh.Elastic(fh.Kernel(2.0), "1 + (x > 6)", nonlinear=True, fracture_energy=fh.Weibull(6e-4, 5, 1.0)),
        {"x": SLOW, "y": fh.Free()},
        {"v": 0.03 * bump((13, 14), 2)},
        balance=True,
    ),
    "stresses of a body with a crack": lambda: fh.Simulation(
        fh.Lattice(1.0, (0.0, 0.0), (16.0, 15.0), body=fh.Box((-1.0, -1.0), (17.0, 16.0)) - fh.Disc(2.2, (12.0, 4.0))),
        fh.Elastic(fh.Kernel(2.0), young=1.0, poisson=0.3, material="correspondence", stabilisation=0.3),
        {"x-": SLOW, "x+": fh.Fixed(), "y": fh.Free()},
        {"v": 0.03 * bump((17, 16), 2)},
        cracks=[fh.Crack([(6.1, 9.3), (9.2, 9.3)])],
    ),
    "dilatations in a corner": lambda: fh.Simulation(
        lattice(13, 14),
        fh.Elastic(fh.Kernel(2.0), young=1.0, poisson=0.1, material="state-based"),
        {"x": SLOW, "y-": SLOW, "y+": fh.Free()},
        {"v": 0.03 * bump((13, 14), 2)},
    ),
    "stresses as bonds break": lambda: fh.Simulation(
        fh.Lattice(1.0, (0.0, 0.0), (20.0, 21.0)),
        fh.Elastic(fh.Kernel(2.0), 1.0, 0.3, material="correspondence", stabilisation=0.4, critical_stretch=0.006),
        {"x-": SLOW, "x+": fh.Free(), "y": fh.Free()},
        {"v": 0.03 * bump((21, 22), 2)},
        cracks=[fh.Crack([(15.3, 10.4), (25.0, 10.4)])],
        balance=True,
    ),
    "stresses of two solids as bonds break": lambda: fh.Simulation(
        fh.Lattice(1.0, (0.0, 0.0), (20.0, 21.0)),
        fh.Elastic(
            fh.Kernel(2.0),
            "1 + (x > 9.5)",
            "0.3 - 0.1*(x > 9.5)",
            density="1 + (y > 9.5)",
            material="correspondence",
            stabilisation=0.4,
            critical_stretch="0.006 + 0.004*(y > 9.5)",
        ),
        {"x-": SLOW, "x+": fh.Free(), "y": fh.Free()},
        {"v": 0.03 * bump((21, 22), 2)},
        balance=True,
    ),
    "dilatations of two solids as bonds break": lambda: fh.Simulation(
        fh.Lattice(1.0, (0.0, 0.0), (20.0, 21.0)),
        fh.Elastic(fh.Kernel(2.0), "1 + (x > 9.5)", 0.4, material="state-based", critical_stretch=0.006),
        fh.Free(),
        {"v": 0.03 * bump((21, 22), 2)},
        balance=True,
    ),
    "dilatations as bonds break": lambda: fh.Simulation(
        fh.Lattice(1.0, (0.0, 0.0), (20.0, 21.0)),
        fh.Elastic(fh.Kernel(2.0), 1.0, 0.4, material="state-based", critical_stretch=0.006),
        {"x": fh.Fixed(), "y": fh.Periodic()},
        {"v": 0.03 * bump((21, 22), 2)},
        balance=True,
    ),
    "dilatations of cracks that close": lambda: closing(
        "state-based", 0.35, sides={"x-": SLOW, "x+": fh.Free(), "y": fh.Periodic()}, cracks=ACROSS
    ),
    "dilatations of two solids that break and close": lambda: closing(
        "state-based", "0.3 - 0.1*(y > 9.5)", cracks=ACROSS, critical_stretch=0.006, density="1 + (x > 9.5)"
    ),
    "stresses of cracks that close": lambda: closing(
        "correspondence",
        "0.3 - 0.1*(y > 9.5)",
        sides={"x": fh.Periodic(), "y-": fh.Fixed(), "y+": fh.Free()},
        cracks=ACROSS,
        stabilisation=0.3,
    ),
    "faces that rub": lambda: closing("bond-based", 0.25, cracks=ACROSS, critical_stretch=0.02, friction=0.4),
    "faces of two solids that rub": lambda: closing(
        "state-based", "0.3 - 0.1*(y > 9.5)", cracks=ACROSS, density="1 + (x > 9.5)", friction=0.2
    ),
    "stresses in space as bonds break and close": lambda: closing(
        "correspondence",
        0.2,
        (11, 12, 13),
        cracks=[fh.Rectangle([-1.0, -1.0, 6.4], [20.0, 0.0, 0.0], [0.0, 20.0, 0.0])],
        stabilisation=0.4,
        critical_stretch=0.006,
    ),
    "bonds that heat breaks": lambda: fh.Simulation(
        lattice(13, 14),
        fh.Elastic(fh.Kernel(2.0), **ELASTIC, contact=True),
        {"x": fh.Periodic(), "y": fh.Free()},
        {"v": 0.02 * bump((13, 14), 2)},
        cracks=[fh.Crack([(4.3, 7.4), (8.5, 7.4)])],
        loads=[fh.ThermalLoad("exp(-(y - 7)**2)*cos(x)*(1 + t)", expansion=1e-2, reference=0.0, every=1.0)],
        balance=True,
    ),
    "stresses of heat as bonds break": lambda: heated("correspondence", 0.3, stabilisation=0.4),
    "dilatations of heat as bonds break": lambda: heated("state-based", "0.4 - 0.1*(y > 9.5)"),
    "stresses of heat as bonds break and close": lambda: heated("correspondence", 0.3, stabilisation=0.4, contact=True),
    "drag in layers that meet, and run into a free side and a crack": lambda: fh.Simulation(
        lattice(15, 16),
        fh.Correspondence(fh.Kernel(2.0), 1.0, 0.3, drag=0.4, stabilisation=0.3),
        {"x": fh.LatticePML(nodes=4), "y-": fh.LatticePML(nodes=3), "y+": fh.Free()},
        {"u": 1e-3 * bump((15, 16), 2)},
        cracks=[fh.Crack([(-99.0, 7.5), (5.0, 7.5)])],
        balance=True,
    ),
    "drag in layers in space": lambda: fh.Simulation(
        lattice(11, 8, 11),
        fh.Correspondence(fh.Kernel(1.5, 1), 1.0, 0.3, drag=0.4, stabilisation=0.3),
        {"x": fh.LatticePML(nodes=3), "y": fh.Periodic(), "z": fh.LatticePML(nodes=3)},
        {"u": 1e-3 * bump((11, 8, 11), 3)},
    ),
    "stretched derivatives": lambda: fh.Simulation(
        lattice(13, 14),
        fh.Correspondence(fh.Kernel(2.0), 1.0, 0.3, drag=0.4),
        {"x-": fh.NonlocalPML(4, strength=2.0, cross=0.2), "x+": fh.NonlocalPML(3, shift=0.3), "y": fh.Free()},
        {"u": 1e-3 * bump((13, 14), 2)},
        cracks=[fh.Crack([(-9.0, 6.5), (99.0, 6.5)])],
        balance=True,
    ),
    "stretched derivatives as bonds break": lambda: fh.Simulation(
        fh.Lattice(1.0, (0.0, 0.0), (20.0, 21.0)),
        fh.Correspondence(
            fh.Kernel(2.0), 1.0, 0.3, density="1 + (y > 9.5)", critical_stretch=0.006, shape_tensor="kept", drag=0.4
        ),
        {"x": fh.NonlocalPML(4), "y": fh.Free()},
        {"v": 0.03 * bump((21, 22), 2)},
        cracks=[fh.Crack([(8.3, 10.4), (15.0, 10.4)])],
        balance=True,
    ),
    "nonlinear bonds": lambda: fh.Simulation(
        lattice(13, 14),
        fh.Elastic(fh.Kernel(2.0), nonlinear=True, **ELASTIC),
        fh.Periodic(),
        {"v": 0.03 * bump((13, 14), 2)},
        balance=True,
        coefficient=half((13, 14)),
    ),
}


def interpreted(sim):
    """The same run, computed from its start by the plain program."""
    return fh.Simulation.of(sim.setup, sim.recorders, engine=Interpreter)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("make", CASES.values(), ids=CASES)
def test_both_compute_the_same(make):
    """Levels, flows, damage and work agree to rounding."""
    print("seed", SEED)
    compiled, plain = make(), interpreted(make())
    for sim in (compiled, plain):
        sim.step(13)
    loop, interpreter = compiled.engine, plain.engine
    assert np.abs(loop.current).max() > 1e-6
    for a, b in ((loop.current, interpreter.current), (loop.older, interpreter.older)):
        np.testing.assert_allclose(loop.core.view(b), loop.core.view(a), rtol=0, atol=1e-12 * np.abs(a).max())
    np.testing.assert_allclose(
        *(engine.get("flows.totals").sum(0) for engine in (interpreter, loop)), rtol=1e-10, atol=1e-13
    )
    np.testing.assert_array_equal(interpreter.tables.bonds.alive, loop.tables.bonds.alive)
    np.testing.assert_allclose(
        interpreter.tables.bonds.residual_stiffness, loop.tables.bonds.residual_stiffness, rtol=0, atol=1e-10
    )
    assert loop.bonds.softening is None or (loop.tables.bonds.residual_stiffness < 1).sum() > 20
    for recorder, second in zip(compiled.recorders, plain.recorders, strict=True):
        for name, values in recorder.data.items():
            np.testing.assert_allclose(second.data[name], values, rtol=0, atol=1e-12 * np.abs(values).max())
    sums = [
        {name: value for name, value in sums_of(engine).items() if not name.startswith(("flows", "broken"))}
        for engine in (interpreter, loop)
    ]
    assert sums[0] == pytest.approx(sums[1], rel=1e-10, abs=1e-18)
    if loop.bonds:
        assert loop.bonds.broken[1] == interpreter.bonds.broken[1]
        assert interpreter.bonds.broken[0] == pytest.approx(loop.bonds.broken[0], rel=1e-10)


def test_corrosion():
    """The same nodes dissolve at the same steps."""
    shape = (21, 22)
    solid = np.zeros(shape, bool)
    solid[8:14, 8:14] = True
    model = fh.Corrosion(fh.Kernel(2.0), saturation=0.5, interface=0.3)
    given = lattice(*shape), model, {"x": SLOW, "y": fh.Periodic()}
    sims = [fh.Simulation(*given, specimens=[fh.Specimen(solid, 1.0)], engine=made) for made in (None, Interpreter)]
    for sim in sims:
        sim.step(60)
    one, two = (sim.fields for sim in sims)
    assert 0 < np.isfinite(one["dissolved"]).sum() and (one["dissolved"] > 0).any()
    for name in one:
        np.testing.assert_allclose(two[name], one[name], rtol=0, atol=1e-12)


def test_layers_that_remember_are_refused():
    """The interpreter keeps their memory in another form."""
    sim = waves((15, 16))
    sim.step(60)
    with pytest.raises(ValueError, match="memory"):
        sim.engine.loop = Interpreter(sim.engine)


@pytest.mark.parametrize("model", [WAVE, fh.Diffusion(fh.Kernel(2.0)), fh.Elastic(fh.Kernel(2.0), 1.0)])
def test_a_run_chooses_its_layers_and_ends(model):
    """A run with all its choices and checks: its layers are chosen by compiled trials, and its steps interpreted."""
    shape, dim = (15, 16), 2 if isinstance(model, fh.Elastic) else 0
    given = lattice(*shape), model, fh.LatticePML(target=1e-3), {"u": 1e-3 * bump(shape, dim)}
    compiled, plain = (fh.Simulation(*given, engine=made).run(until=6.0) for made in (None, Interpreter))
    u = compiled.fields["u"]
    assert compiled.beyond == plain.beyond and compiled.step_count == plain.step_count > 5
    np.testing.assert_allclose(plain.fields["u"], u, rtol=0, atol=1e-12 * np.abs(u).max())
    assert plain.energy() == pytest.approx(compiled.energy(), rel=1e-10)
    assert plain.certificate().verdict == compiled.certificate().verdict


def test_what_reads_the_memory_of_layers_is_refused(tmp_path):
    sim = waves((15, 16), engine=Interpreter)
    for act in (lambda: sim.save(tmp_path / "state"), lambda: sim.load(tmp_path / "state"), sim.seconds_per_step):
        with pytest.raises(fh.InputError, match="engine"):
            act()
    with pytest.raises(fh.InputError, match="engine"):
        waves((15, 16), engine="interpreter")
