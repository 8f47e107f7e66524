"""Comparison of what several processes compute together with what one computes: `mpiexec -n 2 python on_processes.py
FOLDER SIZE PART ...`.

The first process prints a line of JSON for each case; files go into the folder. The set-ups are tiny; SIZE is `few`
for one of each kind, `all`, or `slow`, which has more of them, some larger.
"""

import io
import json
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

import farhorizon as fh
from farhorizon.cli import main
from farhorizon.simulation.processes.parallel_prediction import halo_bytes, halo_numbers

WORLD, FOLDER, SIZE = MPI.COMM_WORLD, Path(sys.argv[1]), sys.argv[2]
#: The first two processes of four, and the first one.
FEWER = {n: WORLD.Split(0 if WORLD.rank < n else MPI.UNDEFINED) for n in (2, 1) if n < WORLD.size}
KERNEL, FOUR = fh.Kernel(0.6), fh.LatticePML(nodes=4)
WAVE = fh.Wave(KERNEL)
ALONG_X = {2: [[2, 1]], 4: [[4, 1]]}[WORLD.size]
ALONG_Y = {2: [[1, 2]], 4: [[2, 2]]}[WORLD.size]
SPACE = {2: [[2, 1, 1], [1, 2, 1], [1, 1, 2]], 4: [[2, 2, 1], [1, 2, 2]]}[WORLD.size]


def lattice(*shape):
    """Return a box around the origin."""
    first = [-0.3 * (n // 2) for n in shape]
    return fh.Lattice(0.3, first, [low + 0.3 * (n - 1) for low, n in zip(first, shape, strict=True)])


def pulse(dim):
    return f"exp(-2*({'+'.join(f'{axis}**2' for axis in 'xyz'[:dim])}))"


def plane(model=WAVE, sides=FOUR, shape=(47, 49), **more):
    """Return a set-up in the plane."""
    given = {"initial": {"u": pulse(2)}} | more
    return fh.Setup(lattice(*shape), model, sides, **given)


def drawn(shape):
    return np.random.default_rng(7).standard_normal(shape) * (np.arange(shape[0]) % 40 > 5)[:, None]


def bell(shape):
    """Return an array with a pulse, of which each process takes its part."""
    return np.exp(-sum((i - n // 2) ** 2 for i, n in zip(np.indices(shape), shape, strict=True)) / 9)


def uneven(shape):
    return np.random.default_rng(7).uniform(0.5, 2, shape)


#: Set-ups and the grids of boxes on which they are computed.
CASES = {
    "a source that depends on the field": (
        plane(fh.Diffusion(KERNEL), fh.Free(), sources=["u*(1 - u)*(2 + x/9)"]),
        ALONG_X + ALONG_Y,
    ),
    "a conductivity that depends on the field": (
        plane(fh.Heat(KERNEL, density="1 + x**2/99", conductivity="1 + where(u > 0.2, 5*(u - 0.2)**2, 0)")),
        ALONG_X + ALONG_Y,
    ),
    "wave": (plane(), ALONG_Y),
    "single precision": (plane(dtype="float32"), ALONG_X),
    "layers that choose themselves": (plane(sides=fh.LatticePML(target=1e-4, until=20.0)), [None]),
    "periodic beside layers": (
        plane(
            sides={"x": fh.Periodic(), "y": FOUR},
            initial={"u": "exp(-2*y**2)*(1 + x)"},
            cracks=[[(-99.0, 1.1), (99.0, 1.1)]],
        ),
        ALONG_X + ALONG_Y,
    ),
    "sources": (
        plane(
            initial={},
            sources=[
                fh.PointSource((0.1, 0.2), time=fh.Ricker(0.3)),
                fh.Source(pulse(2), "cos(t)"),
                "exp(-((x - 0.1*t)**2 + y**2)*4)",
            ],
        ),
        ALONG_Y,
    ),
    "diffusion": (plane(fh.Diffusion(KERNEL)), ALONG_Y),
    "elastic": (
        plane(
            fh.Elastic(KERNEL, 1.0),
            initial={"u": [pulse(2), 0.0]},
            loads=[fh.BodyForce([0.0, pulse(2)], "sin(t)")],
            shape=(79, 81),
        ),
        ALONG_X,
    ),
    "elastic, by target": (
        plane(
            fh.Elastic(KERNEL, 1.0), fh.LatticePML(target=1e-3, until=20.0), (79, 81), initial={"u": [pulse(2), 0.0]}
        ),
        ALONG_X + ALONG_Y,
    ),
    "space, by target": (
        fh.Setup(lattice(21, 22, 23), WAVE, fh.LatticePML(target=1e-4, until=8.0), {"u": pulse(3)}),
        SPACE[:1],
    ),
    "space": (fh.Setup(lattice(21, 22, 23), WAVE, fh.LatticePML(nodes=3), {"u": pulse(3)}), SPACE[:1]),
    "space, with dampers": (
        fh.Setup(lattice(21, 22, 23), WAVE, fh.LatticePML(nodes=3, target=1e-4), {"u": pulse(3)}),
        SPACE[:1],
    ),
}
CRACKS = [[(-1.0, 0.1), (1.3, 0.7)], fh.Crack([(-2.0, -1.4), (2.0, -1.4)], opens=1.5)]
SOLID = fh.Elastic(KERNEL, 1.0)
WIDE = {"initial": {"u": [pulse(2), 0.0]}, "shape": (79, 81)}
ARRIVES = "sin(2*t)*sin(pi*t/6)**2"


def torn(shape=(79, 81), **model):
    """Return a set-up with a short crack between two bands that are pulled apart."""
    pull = fh.BodyForce([0.0, "0.02*(exp(-(y - 2)**2) - exp(-(y + 2)**2))*exp(-x**2/4)"], "1 - exp(-t)")
    cracks = [[(-2.0, 0.13), (0.7, 0.13)]]
    return plane(fh.Elastic(KERNEL, **{"young": 1.0} | model), initial={}, cracks=cracks, loads=[pull], shape=shape)


WARM = plane(fh.Heat(KERNEL), sources=["exp(-((x - 0.1*t)**2 + y**2)*4)"], cracks=[[(-1.0, 0.1), (1.3, 0.7)]])


def torn_and_heated(**model):
    """Return a set-up with bonds that break between a hot spot and the rest of its heat, which has longer bonds."""
    heat = fh.Heat(fh.Kernel(0.9), conductivity=0.05)
    hot = plane(heat, fh.Free(), initial={"u": "exp(-4*((x - 1)**2 + (y - 1)**2))"}, shape=(51, 47))
    load = fh.ThermalLoad(hot, expansion=0.002, reference=0.0, contact_conductance=0.01)
    setup = torn(**model)
    return replace(setup, loads=[*setup.loads, load])


BAND = [[(-5.0, y), (5.0, y)] for y in (-5.9, -5.0, -4.1)]
CASES |= {
    "a band of cracks": (plane(cracks=BAND), [[1, WORLD.size]]),
    "cracks in a solid": (plane(SOLID, initial={"u": [pulse(2), 0.0]}, cracks=CRACKS, balance=True), ALONG_Y),
    "strata": (plane(fh.Wave(KERNEL, "where(y > 0.4, 1.5, 1)", density="1 + 0.5*(x > 1)")), ALONG_Y),
    "strata that conduct": (
        plane(fh.Heat(KERNEL, "1 + 0.5*(x > 1)", 2.0, "where(y > 0.4, 1.5, 1)", "rk4"), {"x": FOUR, "y": fh.Free()}),
        ALONG_X + ALONG_Y,
    ),
    "constants in arrays": (
        plane(fh.Wave(KERNEL, uneven((47, 49)), density=uneven((47, 49))), fh.Periodic()),
        ALONG_X + ALONG_Y,
    ),
    "a coefficient beyond a held rim": (
        fh.Setup(
            fh.Lattice(0.3, (-7.2, -7.2), (7.2, 7.2), body=fh.Disc(6.5, (0.0, 0.0))),
            WAVE,
            fh.Fixed(),
            {"u": pulse(2)},
            coefficient=uneven((49, 49)),
            rim="fixed",
        ),
        ALONG_X + ALONG_Y,
    ),
    "a body": (
        fh.Setup(
            fh.Lattice(0.3, (-7.2, -7.2), (7.2, 7.2), body=fh.Disc(6.5, (0.0, 0.0)) - fh.Disc(1.0, (0.5, 0.2))),
            SOLID,
            fh.Free(),
            {"u": ["exp(-2*((x - 3)**2 + y**2))", 0.0]},
        ),
        ALONG_Y,
    ),
    "held and pulled": (
        plane(
            SOLID,
            {"x": FOUR, "y": fh.Free()},
            initial={},
            constraints=[
                fh.Prescribed(fh.Disc(1.0, (0.4, 0.3)), [None, "0.1*sin(t)"], until=2.0),
                fh.Prescribed([(3.1, -2.0), (-3.0, 2.0)], [0.0, 0.0]),
            ],
            loads=[fh.Traction("y+", (0.0, 1.0), between=[(-2.0, 2.0)], time="1 - exp(-t)")],
            shape=(79, 49),
        ),
        ALONG_Y,
    ),
    "pumped and heated": (
        plane(
            fh.Elastic(KERNEL, "where(y > 1, 1.2, 1)"),
            initial={},
            cracks=[[(-1.0, 0.1), (1.3, 0.7)]],
            loads=[
                fh.Pressure([(-1.0, 0.1), (1.3, 0.7)], 0.01, fh.Step(3.0)),
                fh.ThermalLoad("0.01*exp(-2*(x**2 + y**2))*sin(t)", expansion=1.0, reference=0.0),
            ],
            shape=(79, 81),
        ),
        ALONG_X + ALONG_Y,
    ),
    "heated by a run": (  # with fewer nodes and different boxes
        plane(SOLID, initial={}, loads=[fh.ThermalLoad(WARM, expansion=0.01, reference=0.0)], shape=(79, 81)),
        ALONG_X + ALONG_Y,
    ),
    "breaking, heated by a run": (  # along whose broken bonds no heat flows, except where they touch
        torn_and_heated(critical_stretch=0.005),
        ALONG_X + ALONG_Y,
    ),
    "a window": (
        fh.Setup(fh.Lattice(0.3, window=fh.Disc(6.5, (0.0, 0.0))), WAVE, FOUR, {"u": pulse(2)}),
        ALONG_X + ALONG_Y,
    ),
    "breaking, nonlinear": (torn(critical_stretch=0.005, nonlinear=True, contact=True), ALONG_X),
    "bonds that soften": (
        torn(critical_stretch=0.004, fracture_energy="6e-5*(1.2 + 0.1*sin(x))", softening="linear", nonlinear=True),
        ALONG_X,
    ),
    "viscoelastic bonds": (torn(law=fh.ViscoelasticBond(0.4, 0.5), nonlinear=True), ALONG_X),
    "bonds that soften by a function": (torn(law=fh.ExponentialSoftening(0.004, 0.02), nonlinear=True), ALONG_Y),
    "states that break": (  # four boxes along x, each wider than the filter of the layers, which takes 24 nodes
        torn((99, 81), critical_stretch=0.005, poisson=0.3, material="state-based"),
        ALONG_Y,
    ),
    "held at temperatures": (
        plane(
            fh.Diffusion(KERNEL),
            {"x": FOUR, "y": fh.Free()},
            initial={},
            constraints=[
                fh.Temperature(fh.Disc(1.0, (0.4, 0.3)), "1 - exp(-t)"),
                fh.Temperature("y-", "exp(-x**2)*t", kind="mirror", within=fh.Box((-3.0, -8.0), (3.0, 0.0))),
                fh.Convection("y+", 1.0, "sin(t)", within=fh.Box((-3.0, 0.0), (3.0, 8.0))),
            ],
            sources=["exp(-((x - 0.1*t)**2 + y**2)*4)"],
            cracks=[[(-1.0, 2.1), (1.3, 2.7)], fh.Crack([(-2.0, -1.4), (2.0, -1.4)], opens=1.5)],
            balance=True,
        ),
        ALONG_Y,
    ),
    "metal that corrodes": (
        plane(
            fh.Corrosion(KERNEL, saturation=0.8),
            initial={},
            specimens=[
                fh.Specimen(fh.Disc(4.0, (0.3, 0.2)) - fh.Disc(1.0, (2.0, 2.0))),
                fh.Specimen(fh.Disc(0.9, (-5.0, -5.0)), 1.1),  # within the box of one process
            ],
            sources=[fh.Source("where((x + 5)**2 + (y - 5)**2 < 1, 0.02, 0)", "sin(t)**2")],
            balance=True,
        ),
        ALONG_X + ALONG_Y,
    ),
    "an incident wave": (
        plane(initial={}, cracks=CRACKS, sources=[fh.IncidentWave((1.0, 0.4), ARRIVES, 6.0)]),
        ALONG_Y,
    ),
    "an incident wave in strata": (
        plane(
            fh.Wave(KERNEL, speed="where(y > 2.5, 0.8, 1)", density="where(y > 2.5, 0.9, 1)"),
            initial={},
            cracks=CRACKS,
            sources=[fh.IncidentWave((1.0, 1.4), ARRIVES, 6.0)],
        ),
        ALONG_X + ALONG_Y,
    ),
}
#: One case of each kind.
FEW = ("wave", "breaking, nonlinear", "metal that corrodes", "space")
STATES = fh.Elastic(KERNEL, young=1.0, poisson=0.3, material="state-based")
CORRESPONDENCE = fh.Correspondence(KERNEL, 1.0, 0.3, stabilisation=0.3)
SLOW = {
    "cracks": (plane(cracks=CRACKS), ALONG_X),
    "a crack into a layer": (plane(cracks=[[(-99.0, 0.13), (0.7, 0.13)]]), ALONG_X + ALONG_Y),
    "breaking": (torn(critical_stretch=0.005), ALONG_X),
    "breaking strata": (torn(critical_stretch="where(y > 1, 0.004, 0.005)", density="where(x > 1, 1.5, 1)"), ALONG_Y),
    "breaking along a weld": (
        torn(fracture_energy="where(abs(y) < 0.9, 3e-6, 1e-5)", young="where(y > 0.13, 1, 2)"),
        ALONG_Y,
    ),
    "an incident wave below a surface": (
        plane(
            SOLID,
            {"all": FOUR, "y+": fh.Free()},
            initial={},
            sources=[fh.IncidentWave((1.0, 1.0), ARRIVES, 6.0, "S", fh.Box((-5.0, -5.0), (5.0, 7.2)))],
        ),
        ALONG_Y,
    ),
    "states with a crack": (plane(CORRESPONDENCE, cracks=CRACKS, **WIDE), ALONG_Y),
    "states with a crack, by target": (
        plane(
            fh.Elastic(KERNEL, 1.0, 0.45, material="state-based"),
            fh.LatticePML(target=1e-2, until=5.0),
            (99, 81),
            initial={"u": [pulse(2), 0.0]},
            cracks=[[(-99.0, 0.13), (0.7, 0.13)]],
        ),
        ALONG_X + ALONG_Y,
    ),
    "faces that slide": (
        plane(
            fh.Elastic(KERNEL, "where(y > 1, 2, 1)", contact=True),
            fh.Free(),
            initial={"v": ["-0.1*x*exp(-2*(x**2 + y**2))", "-0.1*y*exp(-2*(x**2 + y**2))"]},
            cracks=CRACKS,
            balance=True,
        ),
        ALONG_X + ALONG_Y,
    ),
    "states that close": (  # faces of two different solids that are pressed together
        plane(
            fh.Elastic(KERNEL, "where(y > 1, 2, 1)", 0.3, material="state-based", contact=True),
            initial={"v": ["-0.1*x*exp(-2*(x**2 + y**2))", "-0.1*y*exp(-2*(x**2 + y**2))"]},
            cracks=CRACKS,
            shape=(99, 81),
            balance=True,
        ),
        ALONG_Y,
    ),
    "states that break by energy": (
        torn(
            (99, 81),
            young="1 + 0.5*(x > 0.2)",
            critical_stretch=0.003,
            poisson=0.3,
            material="correspondence",
            stabilisation=0.3,
        ),
        ALONG_Y,
    ),
    "states that break and close": (
        torn((99, 81), critical_stretch=0.005, poisson=0.3, material="state-based", contact=True),
        ALONG_Y,
    ),
    # only one of the processes lacks bonds
    "states at one free side": (plane(STATES, {"x": FOUR, "y-": FOUR, "y+": fh.Free()}, **WIDE), ALONG_Y),
    "states at free sides": (plane(CORRESPONDENCE, {"x": FOUR, "y": fh.Free()}, **WIDE), ALONG_Y),
    "states that are heated": (
        plane(
            fh.Correspondence(KERNEL, 1.0, 0.3, stabilisation=0.3),
            initial={},
            loads=[fh.ThermalLoad("0.01*exp(-2*(x**2 + y**2))", expansion=1.0, reference=0.0)],
            shape=(79, 81),
        ),
        ALONG_Y,
    ),
    "a hole under pressure": (
        fh.Setup(
            fh.Lattice(0.3, (-7.2, -7.2), (7.2, 7.2), body=fh.Box((-9.0, -9.0), (9.0, 9.0)) - fh.Disc(1.5, (0.5, 0.2))),
            SOLID,
            {"x": fh.Periodic(), "y": fh.Free()},
            loads=[fh.Pressure(fh.Disc(1.5, (0.5, 0.2)), 0.01, fh.Step(3.0))],
        ),
        ALONG_X + ALONG_Y,
    ),
    "states that vary": (
        plane(fh.Correspondence(KERNEL, "where(y > 1, 2, 1)", 0.3, stabilisation=0.3), **WIDE),
        ALONG_Y,
    ),
    "attenuation": (
        plane(
            fh.Wave(KERNEL, "1 + (y > 1)", attenuation=fh.Attenuation(20.0, (0.05, 0.5))),
            sides={"x": FOUR, "y-": FOUR, "y+": fh.Free()},
        ),
        ALONG_X + ALONG_Y,
    ),
    "attenuation by region": (
        plane(
            fh.Wave(
                KERNEL,
                attenuation=fh.Attenuation(40.0, (0.05, 0.5), regions=[fh.LossyRegion(fh.Disc(2.0, (0.4, 0.7)), 8.0)]),
            ),
            sides={"x": FOUR, "y-": FOUR, "y+": fh.Free()},
        ),
        ALONG_X + ALONG_Y,
    ),
    "states with drag": (
        plane(fh.Correspondence(KERNEL, 1.0, 0.3, drag=0.1), **(WIDE | {"shape": (119, 81)})),
        ALONG_X + ALONG_Y,
    ),
    "a body in space": (
        fh.Setup(
            fh.Lattice(0.3, (-3.0, -3.3, -3.6), (3.0, 3.3, 3.6), body=fh.Ball(3.2, (0.0, 0.0, 0.0))),
            SOLID,
            fh.Free(),
            {"u": [pulse(3), 0.0, 0.0]},
            cracks=[fh.Rectangle((-1.0, -1.0, 0.1), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0))],
        ),
        SPACE,
    ),
    "wave along x": (plane(), ALONG_X),
    "single precision along y": (plane(dtype="float32"), ALONG_Y),
    "an array, periodic": (plane(sides=fh.Periodic(), initial={"u": drawn((47, 49)), "v": 1.0}), ALONG_X + ALONG_Y),
    "periodic beside layers, along x": (
        plane(sides={"x": fh.Periodic(), "y": FOUR}, initial={"u": "exp(-2*y**2)*(1 + x)"}),
        ALONG_X,
    ),
    "sponge, free, fixed": (plane(sides={"x": fh.Sponge(6), "y-": fh.Free(), "y+": fh.Fixed()}), ALONG_Y),
    "springs and dashpots": (
        plane(
            fh.Elastic(KERNEL, 1.0, density="1 + 0.2*sin(x)"),
            {"x": FOUR, "y-": fh.Impedance(1.0, 0.5, 0.2), "y+": fh.Free()},
            initial={"u": [pulse(2), 0.0]},
            shape=(79, 81),
        ),
        ALONG_X + ALONG_Y,
    ),
    "reaction": (plane(fh.Wave(fh.Stencil.from_kernel(KERNEL, 0.3, 2).with_reaction(0.2))), ALONG_X),
    "elastic along y": (plane(fh.Elastic(KERNEL, 1.0), initial={"u": [pulse(2), 0.0]}, shape=(79, 81)), ALONG_Y),
    "space, other boxes": (fh.Setup(lattice(21, 22, 23), WAVE, fh.LatticePML(nodes=3), {"u": pulse(3)}), SPACE[1:]),
    "elastic in space": (
        fh.Setup(lattice(39, 40, 41), fh.Elastic(KERNEL, 1.0), FOUR, {"u": [pulse(3), 0.0, 0.0]}),
        SPACE,
    ),
    "elastic in space, by target": (
        fh.Setup(
            lattice(39, 40, 41),
            fh.Elastic(KERNEL, 1.0),
            fh.LatticePML(target=1e-3, until=20.0),
            {"u": [pulse(3), 0.0, 0.0]},
        ),
        SPACE,
    ),
    "state-based in space": (fh.Setup(lattice(53, 54, 55), STATES, FOUR, {"u": [pulse(3), 0.0, 0.0]}), SPACE),
    "state-based, periodic": (fh.Setup(lattice(21, 22, 23), STATES, fh.Periodic(), {"u": [pulse(3), 0.0, 0.0]}), SPACE),
    "heat": (plane(fh.Heat(KERNEL)), ALONG_Y),
    "diffusion in a body, counted": (
        fh.Setup(
            fh.Lattice(0.3, (-7.2, -7.2), (7.2, 7.2), body=fh.Disc(6.5, (0.0, 0.0)) - fh.Disc(1.0, (0.5, 0.2))),
            fh.Diffusion(KERNEL),
            fh.Free(),
            {"u": pulse(2)},
            rim="fixed",
            balance=True,
        ),
        ALONG_X + ALONG_Y,
    ),
    "metal that corrodes, across a periodic side": (
        plane(
            fh.Corrosion(KERNEL, saturation=0.8, limited=True, integrator="euler"),
            {"x": fh.Periodic(), "y": FOUR},
            initial={},
            specimens=[fh.Specimen(np.hypot(*(np.indices((47, 49)) - np.array([[[0]], [[24]]]))) < 15)],
            balance=True,
        ),
        ALONG_X + ALONG_Y,
    ),
    "metal that corrodes in space": (
        fh.Setup(
            lattice(21, 22, 23),
            fh.Corrosion(KERNEL, saturation=0.3, integrator=fh.RungeKuttaChebyshev(3)),
            fh.LatticePML(nodes=3),
            specimens=[fh.Specimen(fh.Ball(2.0, (0.0, 0.0, 0.1)))],
        ),
        SPACE,
    ),
    "stages": (
        plane(fh.Diffusion(KERNEL, integrator=fh.RungeKuttaChebyshev(5)), initial={"u": bell((47, 49))}),
        ALONG_Y,
    ),
    "beam": (fh.Setup(lattice(241), fh.Beam(), fh.Fixed(), {"u": pulse(1)}), [None]),
}


def asleep_until_all_are_here():
    """Sleep until all processes are here: one computes alone meanwhile, and there may be fewer processors."""
    waiting = WORLD.Ibarrier()
    while not waiting.Test():
        time.sleep(0.001)


def really_sent(engine):
    """Return the number of bytes of the messages of a step, without those of the layers' filter."""
    numbers, values = halo_numbers(engine), [messages.volume for messages in engine.exchange.messages]
    stages = len(engine.stages.numbers)
    return engine.dtype.itemsize * (values[0] * sum(numbers) + sum(values[1:-1]) * stages)


def apart(energies, reference):
    """Return the largest difference between energies, relative to the largest energy."""
    assert energies.keys() == reference.keys()
    return max(abs(energies[name] - value) for name, value in reference.items()) / max(map(abs, reference.values()))


def relative(field, reference):
    """Return the largest difference between two fields, relative to the largest value."""
    return float(np.nanmax(np.abs(field - reference)) / max(np.nanmax(np.abs(reference)), 1e-300))


def sums_of(run):
    """Return the energies, and the terms of the balance if there is one."""
    return run.energies() | (run.balance() if run.setup.balance else {})


def compared():
    """Compare each case with one process: whether the fields are equal to the last bit, and the error of the energy."""
    names = {"few": FEW, "all": CASES, "slow": CASES | SLOW}[SIZE]
    for name in names:
        setup, grids = (CASES | SLOW)[name]
        for topology in grids:
            together = fh.Simulation.of(setup, communicator=WORLD, topology=topology)
            together.run(4.0)
            joined = {key: together.team.joined(together.lattice, field) for key, field in together.fields.items()}
            energies, sent = sums_of(together), WORLD.gather(really_sent(together.engine))
            broken = together.broken_bonds
            if WORLD.rank == 0:
                alone = fh.Simulation.of(setup)
                alone.run(4.0)
                pairs = [(joined[key], field) for key, field in alone.fields.items()]
                same = all(np.array_equal(*pair, equal_nan=True) for pair in pairs)
                off = max(relative(*pair) for pair in pairs)
                moves = float(np.nanmax(np.abs(alone.fields["u"])))
                boxes = together.subdomain.decomposition
                yield {
                    "case": name,
                    "bytes": [sum(sent), sum(halo_bytes(boxes, number, alone) for number in range(WORLD.size))],
                    "cuts": boxes.cuts,
                    "same": same,
                    "off": off,
                    "moves": moves,
                    "energy": apart(energies, sums_of(alone)),
                    "broken": [broken, alone.broken_bonds],
                }
            asleep_until_all_are_here()


#: Points between the nodes, on both sides of all cuts; one is a node.
POINTS = [(0.0, 0.0), (0.1, 0.13), (-2.2, 1.9), (2.15, -2.0)]


def files():
    """Compare results files, receivers and probes of runs on all processes with those of runs on one."""
    strata = plane(fh.Elastic(KERNEL, "where(y > 1, 1.5, 1)"), dt=0.1, **WIDE)
    kinds = {"waves": (plane(dt=0.1), POINTS), "solid": (SMALL_SOLID, [(*point, 0.1) for point in POINTS[:2]])}
    kinds |= {"strata": (strata, POINTS)}
    if SIZE != "few":  # stresses beside cracks, broken bonds, holes and heating
        kinds |= {
            name: (replace(CASES[name][0], dt=0.1), POINTS[2:3])
            for name in ("breaking, nonlinear", "a body", "pumped and heated")
        }
    for name, (setup, points) in list(kinds.items())[: 1 if SIZE == "few" else None]:
        records = []
        for together in (True, False) if WORLD.rank == 0 else (True,):
            record = ["u", "v", "gradient", *["stress"] * setup.model.mechanical]
            receivers = fh.Receivers(points, record=record, interpolation="linear")
            run = fh.Simulation.of(setup, [receivers], communicator=WORLD if together else None)
            run.record(points)
            path = FOLDER / f"{name}-{'together' if together else 'alone'}.h5"
            for until in (0.5, 1.5):  # the file is continued
                run.run(until, every=0.5, output=path)
            run.write(path.with_suffix(".now.h5"), ["v", *["stress"] * setup.model.mechanical])
            records.append({"probes": run.probes.values, **receivers.data})
        if WORLD.rank == 0:
            apart = [float(np.abs(v - records[1][key]).max() / np.abs(v).max()) for key, v in records[0].items()]
            yield {"files": name, "probes": apart[0], "receivers": max(apart[1:])}
        asleep_until_all_are_here()


def with_receiver(setup, communicator=None, topology=None):
    """Return a run with a receiver in the middle."""
    return fh.Simulation.of(setup, [fh.Receivers(np.zeros((1, setup.lattice.dim)))], communicator, topology)


def kept():
    """Compare runs that are continued from checkpoints, on other boxes and on fewer processes, with uninterrupted
    ones; the checkpoints are those of several processes and of one.
    """
    for name in {"few": KEPT[:1], "all": KEPT, "slow": KEPT + KEPT_SLOWLY}[SIZE]:
        setup, path = (CASES | SLOW)[name][0], FOLDER / f"{name}.ckpt"
        first, second = OTHER_BOXES[WORLD.size, setup.lattice.dim]
        start = with_receiver(setup, WORLD, first).run(2.0)
        start.save(path, answer=42)
        broken = start.broken_bonds
        if WORLD.rank == 0:
            with_receiver(setup).run(2.0).save(path.with_suffix(".one.ckpt"), answer=42)
        asleep_until_all_are_here()
        runs = {"as it was": (start.run(4.0), None), "other boxes": (with_receiver(setup, WORLD, second), path)}
        for boxes in (first, second):
            runs[f"{boxes} from one"] = with_receiver(setup, WORLD, boxes), path.with_suffix(".one.ckpt")
        for size, group in FEWER.items():
            if WORLD.rank < size:
                runs[f"{size} processes"] = with_receiver(setup, group), path
        if WORLD.rank == 0:
            runs["one from one"] = with_receiver(setup), path.with_suffix(".one.ckpt")
        values, sums, steps, answers = {}, {}, set(), set()
        for how, (run, kept) in runs.items():
            if kept is not None:
                answers.add(run.load(kept)["answer"])
                run.run(4.0)
            steps.add(run.step_count)
            fields = [run.team.joined(run.lattice, field) for field in run.fields.values()]
            values[how] = *fields, run.recorders[0].data["u"]
            sums[how] = {**sums_of(run), "broken bonds": run.broken_bonds}
        if WORLD.rank == 0:
            expected, summed = values.pop("as it was"), sums.pop("as it was")
            same = {
                how: all(np.array_equal(*pair, equal_nan=True) for pair in zip(of_run, expected, strict=True))
                for how, of_run in values.items()
            }
            off = max(relative(*pair) for of_run in values.values() for pair in zip(of_run, expected, strict=True))
            energy = max(apart(energies, summed) for energies in sums.values())
            line = {"kept": name, "same": same, "off": off, "energy": energy, "broken": broken}
            yield line | {"answers": list(answers), "steps": list(steps)}
        asleep_until_all_are_here()
    if SIZE == "few":
        return
    yield from adopted()
    unlike, message = fh.Simulation.of(plane(dt=0.01), [], WORLD), ""
    try:
        unlike.load(FOLDER / "wave.ckpt")
    except fh.InputError as error:
        message = str(error)
    yield {"unlike": WORLD.gather(message)}


def adopted():
    """Compare runs that are continued with the layers that were chosen for their length, by one process or by
    several; a restored run takes them from the file.
    """
    setup, path = plane(sides=fh.LatticePML(target=1e-4, until=4.0)), FOLDER / "adopted.ckpt"
    if WORLD.rank == 0:
        alone = with_receiver(setup).run(12.0)
        alone.save(path)
    asleep_until_all_are_here()
    first, second = (with_receiver(setup, WORLD, boxes) for boxes in OTHER_BOXES[WORLD.size, 2])
    restored = fh.Simulation.restore(path, communicator=WORLD).run(14.0)
    again = restored.team.joined(restored.lattice, restored.fields["u"])
    first.load(path)
    first.run(13.0).save(path)
    second.load(path)
    joined = second.team.joined(second.lattice, second.run(14.0).fields["u"])
    if WORLD.rank == 0:
        back = with_receiver(setup)
        back.load(path)
        expected = alone.run(14.0).fields["u"]
        nodes = alone.engine.layout.low[2], with_receiver(setup).engine.layout.low[2]
        same = [np.array_equal(field, expected) for field in (joined, again, back.run(14.0).fields["u"])]
        yield {"adopted": same, "nodes": nodes}
    asleep_until_all_are_here()


def tips():
    """Compare the path of a crack recorded by all processes with that recorded by one."""
    setup, records = torn(critical_stretch=0.005, nonlinear=True), []
    for together in (True, False) if WORLD.rank == 0 else (True,):
        tips = fh.CrackTips(every=5)
        run = fh.Simulation.of(setup, [tips], WORLD if together else None, ALONG_X[0] if together else None)
        run.run(5.0)
        records.append([tips.data["position"], tips.length, tips.dissipated])
    of_processes = WORLD.gather(records[0])
    if WORLD.rank == 0:
        pairs = list(zip(*records, strict=True))
        alike = np.array_equal(*pairs[0], equal_nan=True)
        alike &= all(np.array_equal(records[0][0], record[0], equal_nan=True) for record in of_processes)
        off = max(float(np.abs(values - expected).max() / expected.max()) for values, expected in pairs[1:])
        yield {"tips": alike, "sums": off, "length": [float(records[0][1][0]), float(records[0][1][-1])]}
    asleep_until_all_are_here()


def recorded():
    """Compare the data of recorders in runs on all processes with those in runs on one."""
    pull = fh.Source("0.5*y*exp(-y**2 - x**2/4)", fh.Step(2.0))
    crack = [(-2.0, 0.13), (1.9, 0.13)]
    disc = fh.Disc(2.5, (0.4, 0.3))
    strata = {"initial": {"u": pulse(2)}, "cracks": [crack]}
    for name, setup, make in (
        (
            "a wave",
            plane(fh.Wave(KERNEL, "where(x**2 + y**2 < 4, 1.5, 1)"), **strata),
            lambda: [
                fh.Spectra(disc, [0.1, 0.3]),
                fh.Spectra(("y", 0.7), [0.2], name="plane"),
                fh.Spectra([(0.31, 0.92), (-3.0, 2.0)], [0.2], ["gradient"], interpolation="linear", name="points"),
                fh.PowerThrough([disc, ("x", 0.1)], [0.2]),
                fh.FarField(frequencies=[0.1, 0.3], points=[(9.0, 4.0)]),
            ],
        ),
        (
            "across a periodic side",
            plane(sides={"x": fh.Periodic(), "y": FOUR}, initial={"u": "exp(-2*y**2)*(1 + x)"}),
            lambda: [fh.PowerThrough([fh.Box((-9.0, -1.0), (9.0, 1.0)), ("x", 1.1), ("y", -0.2)])],
        ),
        ("a crack", plane(initial={}, sources=[pull], cracks=[crack]), lambda: [fh.StressIntensity(every=3)]),
        (
            "a solid",
            plane(STATES, initial={"u": [pulse(2), 0.0]}, shape=(79, 81)),
            lambda: [fh.PowerThrough(disc), fh.Spectra(disc, [0.2])],
        ),
        (
            "held and pulled",
            CASES["held and pulled"][0],
            lambda: [fh.Reaction(), fh.Reaction(fh.Box((-9.0, -9.0), (0.5, 9.0)), every=3, name="left")],
        ),
        (
            "a record for another run",
            plane(initial={}, sources=[fh.Source("exp(-9*(x + 5)**2 - 9*y**2)", fh.Ricker(0.4))]),
            lambda: [fh.ShellRecorder(fh.Box((-3.0, -4.0), (5.0, 4.0)))],
        ),
    ):
        for topology in ALONG_Y if name == "a solid" else ALONG_X + ALONG_Y:
            data = []
            for together in (True, False) if WORLD.rank == 0 else (True,):
                recorders, communicator = make(), WORLD if together else None
                run = fh.Simulation.of(setup, recorders, communicator, topology if together else None)
                run.run(20.0 if name == "a wave" else 4.0)
                records = [part for recorder in run.recorders for part in (recorder.recorded, *recorder.concluded())]
                data.append({(r.name, key): v for r in records for key, v in [*r.data.items(), *r.spectra.items()]})
            of_processes = WORLD.gather(list(data[0].values()))
            if WORLD.rank == 0:
                off = {" ".join(key): relative(data[0][key], value) for key, value in data[1].items()}
                first, *others = of_processes
                alike = all(np.array_equal(*pair) for values in others for pair in zip(first, values, strict=True))
                size = min(float(np.abs(value).max()) for value in data[1].values())
                yield {"recorded": name, "off": off, "alike": alike, "least": size, "keys": len(data[0])}
            asleep_until_all_are_here()


#: Boxes of a run, and those on which it is continued, by number of processes and of dimensions.
OTHER_BOXES = {
    (2, 2): ([2, 1], [1, 2]),
    (4, 2): ([2, 2], [4, 1]),
    (2, 3): ([1, 2, 1], [1, 1, 2]),
    (4, 3): ([2, 2, 1], [1, 2, 2]),
}
KEPT = (
    *("wave", "space", "held and pulled", "breaking, nonlinear", "held at temperatures", "metal that corrodes"),
    *("bonds that soften", "states that break"),
)
KEPT_SLOWLY = (
    *("single precision", "diffusion", "strata", "pumped and heated", "heated by a run", "state-based in space"),
    *("breaking, heated by a run", "attenuation by region"),
    *("states that close", "states that break by energy", "elastic, by target", "elastic in space, by target"),
)
SMALL_SOLID = fh.Setup(
    lattice(13, 22, 14), fh.Elastic(fh.Kernel(0.3), 1.0), fh.Fixed(), {"u": [pulse(3), 0.0, 0.0]}, dt=0.1
)


def commands():
    """Yield what the command line prints and returns on each process."""
    for words in (
        ["run", "case.toml", "--out", "together", "--no-report", "--json", "together.json"],
        ["run", "case.toml", "--out", "together"],
        ["run", "refused.toml"],
        ["run", "breaks.toml", "--out", "together", "--no-report"],
        ["run", "nowhere.toml"],
        ["run", "case.toml", "--out", "blocked"],
        ["run", "case.toml", "--set", "run.topology=[3, 5]", "--force"],
        ["run", "case.toml", "--resume"],
        ["run", "case.toml", "--until", "0.25", "--force", "--out", "goes_on", "--no-report"],
        ["run", "case.toml", "--until", "0.5", "--resume", "--out", "goes_on", "--no-report"],
        ["run", "case.toml", "--resume", "--out", "goes_on", "--set", f"run.topology=[1, {WORLD.size}]", "--no-report"],
        ["run", "case.toml", "--until", "0.5", "--out", "one", "--no-report"],
        ["run", "case.toml", "--resume", "--out", "from_one", "--no-report"],
        ["run", "case.toml", *STATIC, "--out", "static", "--no-report"],
        ["check", "case.toml"],
    ):
        paths = [word for word in words if word in PLACES or word.endswith((".toml", ".json"))]
        given = [str(FOLDER / word) if word in paths else word for word in words]
        out, errors = io.StringIO(), io.StringIO()
        with redirect_stdout(out), redirect_stderr(errors):
            code = main(given)
        of_processes = WORLD.gather((code, out.getvalue(), errors.getvalue()))
        if WORLD.rank == 0:
            yield {"command": " ".join(words), "told": of_processes}


STATIC = [word for end in ("until=static", "limit=60.0", "tolerance=0.1") for word in ("--set", f"run.{end}")]
STATIC += ["--set", "output.every=10"]
PLACES = ("static", "together", "blocked", "goes_on", "one", "from_one")


class Unshared(fh.Spectra):
    """A recorder that works on one process only."""

    shared = False


def refused():
    """Yield the messages with which each process refuses a set-up."""
    for what, make in {
        "wet": lambda: plane(
            fh.Corrosion(KERNEL, saturation=0.8),
            initial={},
            specimens=[fh.Specimen(fh.Disc(2.0, (3.0, 2.0)))],
            sources=["where((x - 3)**2 + (y - 2)**2 < 1, t, 0)"],
        ),
        "no metal": lambda: plane(
            fh.Corrosion(KERNEL, saturation=0.8), initial={}, specimens=[fh.Specimen(fh.Disc(0.1, (0.15, 0.15)))]
        ),
        "no node": lambda: plane(constraints=[fh.Prescribed(fh.Disc(0.1, (0.15, 0.15)), 1.0)]),
        "no load": lambda: plane(SOLID, fh.Free(), initial={}, loads=[fh.Traction("x+", (1, 0), between=[(0.1, 0.2)])]),
        "unshared": plane,
        "too many": lambda: plane(shape=(7, 7)),
        "one alone": lambda: plane(initial={"u": lambda x, y: np.where(x > 0, np.nan, 0.0) + 0 * y}),
        "hot": lambda: plane(
            SOLID, initial={}, loads=[fh.ThermalLoad("0.01*x", expansion=1.0, reference=0.0)], shape=(79, 81)
        ),
        "heat of deformation": lambda: plane(fh.Thermoelastic(SOLID, fh.Heat(KERNEL), 0.01, 300.0), initial={}),
        "load steps": lambda: replace(plane(SOLID, fh.Free(), initial={}), dt=fh.LoadSteps(1.0)),
        "k(u)": lambda: plane(fh.Heat(KERNEL, conductivity="0.5 - u"), fh.Free()),
        "w(u)": lambda: plane(fh.Diffusion(KERNEL), fh.Free(), sources=["where(x > 3, 1/u, 0)"]),
        "window, closed": lambda: fh.Setup(fh.Lattice(0.3, window=fh.Disc(5.0, (0.0, 0.0))), WAVE, fh.Higdon(2)),
        "layers": lambda: plane(sides=fh.Higdon(2)),
        "exact": lambda: fh.Setup(lattice(61), WAVE, fh.Exact(), {"u": pulse(1)}),
        "extended": lambda: plane(sides=fh.Extended()),
        "auto": lambda: plane(sides=fh.Auto()),
        "derivatives": lambda: fh.Setup(
            fh.Lattice(0.3, (-3, -3), (3, 3)), fh.Correspondence(KERNEL, 1.0, 0.3), fh.NonlocalPML(6)
        ),
    }.items():
        message = ""
        observe = [Unshared([(0.0, 0.0)], [0.1])] if what == "unshared" else []
        try:
            setup = make()
            topology = [WORLD.size, 1][: setup.lattice.dim]
            fh.Simulation.of(setup, observe, communicator=WORLD, topology=topology).step(3)
        except fh.InputError as error:
            message = str(error)
        yield {"refused": what, "told": WORLD.gather(message)}


def uneven_plane(model, sides=FOUR, **more):
    """Return a plane of some nodes, driven at a point and by initial data, whose time step is given."""
    push = fh.PointForce((0.4, -0.7), (0.3, 1.0), fh.Ricker(0.3), "linear")
    source = push if model.mechanical else fh.PointSource((0.4, -0.7), 1.0, fh.Ricker(0.3), "linear")
    initial = {"u": [pulse(2), 0.0] if model.mechanical else pulse(2)}
    setup = fh.Setup(lattice(27, 31), model, sides, initial, sources=[source], threads=1, **more)
    return replace(setup, dt=fh.Simulation.of(setup).dt)


def gradients():
    """Compare gradients by runs on all processes with those by runs on one, the history whole and in pieces."""
    maps = {name: uneven((27, 31)) for name in ("speed", "young", "density", "diffusivity")}
    cut = [[(-2.2, -1.0), (1.3, 1.2)]]
    solid = fh.Elastic(KERNEL, young=maps["young"], density=maps["density"])
    states = fh.Elastic(KERNEL, bulk=maps["young"], shear=0.5, material="state-based")
    cases = [
        ("wave", uneven_plane(fh.Wave(KERNEL, maps["speed"], 0.02, density=maps["density"])), ["speed", "density"]),
        ("solid", uneven_plane(solid, {"x": fh.Periodic(), "y": fh.Free()}, cracks=cut), ["young", "density"]),
        ("states", uneven_plane(states, {"x": fh.Fixed(), "y": fh.Free()}, cracks=cut), ["bulk", "shear"]),
        ("diffusion", uneven_plane(fh.Diffusion(KERNEL, maps["diffusivity"])), ["diffusivity"]),
        ("initial data alone", uneven_plane(WAVE), []),
        ("layers that choose themselves", uneven_plane(WAVE, fh.LatticePML(target=1e-3)), ["speed"]),
    ]
    for name, setup, wrt in cases[: 2 if SIZE == "few" else None]:
        names = [*wrt, *("u", "v")[: setup.model.order], "source", "source.at"]
        line = fh.Receivers([(2.1, 1.0), (-1.9, -2.2), (-2.0, 1.5)], interpolation="linear")
        misfit = fh.LeastSquares(line, np.full((61, 3, 2) if setup.model.mechanical else (61, 3), 0.01))
        for memory in (None, 2.5e5):  # bytes; a history takes 3e5 and more
            options = {"wrt": names, "until": 60 * setup.dt, "memory": memory, "illumination": bool(wrt)}
            together = fh.gradient(fh.Simulation.of(setup, [], WORLD, ALONG_Y[0]), misfit, **options)
            same = WORLD.gather([together[key].tobytes() for key in names])
            if WORLD.rank == 0:
                alone = fh.gradient(setup, misfit, **options)
                off = {key: relative(together[key], alone[key]) for key in names}
                if wrt:
                    off["illumination"] = relative(together.illumination, alone.illumination)
                off["misfit"] = abs(together.misfit / alone.misfit - 1)
                yield {"gradient": f"{name} {memory}", "off": off, "same": same == same[:1] * WORLD.size}
            asleep_until_all_are_here()
    tiny, message = np.zeros((27, 31), bool), ""
    tiny[13, 15] = True
    run = fh.Simulation.of(uneven_plane(WAVE), [], WORLD)
    try:
        fh.gradient(
            run, fh.LeastSquares(fh.Receivers([(2.1, 1.2)]), np.zeros((61, 1))), "speed", 60 * run.dt, region=tiny
        )
    except fh.InputError as error:
        message = str(error)
    yield {"tiny": WORLD.gather(message)}


def unstable():
    """Yield the messages of all processes after a run has diverged on one of them."""
    run = fh.Simulation.of(plane(sides=fh.Fixed()), communicator=WORLD)
    if WORLD.rank == WORLD.size - 1:
        run.engine.current[run.engine.core.origin] = np.inf
    message = ""
    try:
        run.step(3)
    except fh.UnstableError as error:
        message = str(error)
    yield {"unstable": WORLD.gather(message)}


PARTS = {
    "fields": (compared, refused, unstable),
    "files": (files,),
    "kept": (kept,),
    "records": (tips, recorded),
    "gradients": (gradients,),
    "commands": (commands,),
}

if __name__ == "__main__":
    for name in sys.argv[3:]:
        for part in PARTS[name]:
            for line in part():
                if WORLD.rank == 0:
                    print(json.dumps(line), flush=True)
