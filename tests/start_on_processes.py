"""Work and memory of each process while a run on several is set up: `mpiexec -n 2 python start_on_processes.py`.

The number of nodes per process does not depend on the number of processes. The first one prints a line of JSON for
each set-up: per node of a process, the number of evaluations of functions of the coordinates, the largest number of
bytes held while the whole is shared out, and the largest number held in all.
"""

import json
import tracemalloc

import numpy as np
from mpi4py import MPI

import farhorizon as fh
from farhorizon.geometry import lattice as lattices
from farhorizon.simulation import assembly

WORLD, NODES = MPI.COMM_WORLD, 240
KERNEL = fh.Kernel(2.0)
LAYERS = fh.LatticePML(nodes=6)
BOX = fh.Box((20.0, 20.0), (220.0, 220.0))
lattices._AT_ONCE = 0  # treats bodies and windows as in large lattices


class Counted:
    """A function of the coordinates that counts the points at which it is evaluated."""

    points = 0

    def __init__(self, function):
        self.function = function

    def __call__(self, *at):
        Counted.points += np.broadcast(*at).size
        return self.function(*at)


class CountedDisc(fh.Disc):
    """A disc that counts the points for which it is evaluated."""

    def contains(self, points):
        Counted.points += points[..., 0].size
        return super().contains(points)


def pulse(x, y):
    return 0.01 * np.maximum(1 - ((x - 120) ** 2 + (y - 120) ** 2) / 900, 0) ** 4


def layered(x, y):
    return np.where(y < 90, 1.0, 1.2)


def lattice(**more):
    """Return a lattice with the same number of nodes for each process, along x."""
    return fh.Lattice(1.0, (0.0, 0.0), (NODES * WORLD.size - 1.0, NODES - 1.0), **more)


def hole():
    return fh.Box((-1.0, -1.0), (1e5, 1e5)) - CountedDisc(30.0, (120.0, 120.0))


CASES = {
    "initial data": lambda: fh.Setup(lattice(), fh.Wave(KERNEL), LAYERS, {"u": Counted(pulse)}),
    "sources": lambda: fh.Setup(
        lattice(),
        fh.Wave(KERNEL),
        LAYERS,
        sources=[fh.Source(Counted(pulse), "sin(t)"), fh.PointSource((50.2, 60.1), time=fh.Ricker(0.1))],
    ),
    "cracks in bonds that break": lambda: fh.Setup(
        lattice(),
        fh.Elastic(KERNEL, 1.0, critical_stretch=0.1),
        fh.LatticePML(nodes=12),
        {"u": [Counted(pulse), 0.0]},
        cracks=[[(100.0, 100.5), (200.0, 100.5)]],
    ),
    "a body": lambda: fh.Setup(lattice(body=hole()), fh.Wave(KERNEL), fh.Free(), {"u": Counted(pulse)}),
    "held": lambda: fh.Setup(
        lattice(), fh.Wave(KERNEL), LAYERS, constraints=[fh.Prescribed(CountedDisc(9.0, (120.0, 120.0)), "sin(t)")]
    ),
    "metal": lambda: fh.Setup(
        lattice(),
        fh.Corrosion(KERNEL, saturation=0.8),
        LAYERS,
        specimens=[fh.Specimen(CountedDisc(50.0, (120.0, 120.0)))],
    ),
    "a speed that varies": lambda: fh.Setup(lattice(), fh.Wave(KERNEL, Counted(layered)), LAYERS),
    "a density that varies": lambda: fh.Setup(
        lattice(), fh.Wave(KERNEL, 1.0, density=Counted(layered)), {"x": LAYERS, "y": fh.Periodic()}
    ),
    "states that vary in a body": lambda: fh.Setup(
        lattice(body=hole()),
        fh.Elastic(KERNEL, young=Counted(layered), poisson=0.2, material="state-based", critical_stretch=0.1),
        fh.LatticePML(nodes=12),
        dt=0.1,
    ),
    "an incident wave": lambda: fh.Setup(
        lattice(),
        fh.Wave(KERNEL),
        LAYERS,
        sources=[fh.IncidentWave((1.0, 0.0), "sin(0.2*t)*sin(pi*t/60)**2", 60.0, within=BOX)],
    ),
    "conditions": lambda: fh.Setup(
        lattice(),
        fh.Heat(KERNEL, 1.0, 1.0, 1.0),
        {"x": fh.Free(), "y": fh.Free()},
        constraints=[
            fh.Temperature("y-", Counted(lambda x, y, t: 0 * x + 1), within=CountedDisc(1e6, (0.0, 0.0))),
            fh.Flux("y+", 1.0, "layer"),
            fh.Convection("x-", 1.0),
            fh.Temperature(CountedDisc(9.0, (120.0, 120.0)), 2.0),
        ],
    ),
}
OBSERVED = {
    "receivers": lambda: fh.Receivers([(50.2, 60.1)]),
    "spectra": lambda: fh.Spectra([(50.2, 60.1)], [0.01, 0.02]),
    "a far field": lambda: fh.FarField(BOX, [0.01]),
    "the shell of a box": lambda: fh.ShellRecorder(fh.Box((200.0, 200.0), (220.0, 220.0))),
}


def main():
    shared, held = assembly.shared, 0

    def watched(*given):
        nonlocal held
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        found = shared(*given)
        held = tracemalloc.get_traced_memory()[1] - before
        return found

    assembly.shared = watched
    fh.Simulation.of(CASES["initial data"](), communicator=WORLD)  # loads modules, which are not to be counted
    for name in [*CASES, *OBSERVED]:
        Counted.points = 0
        tracemalloc.start()
        observe = [OBSERVED[name]()] if name in OBSERVED else []
        setup = CASES["initial data" if observe else name]()
        run = fh.Simulation.of(setup, observe=observe, communicator=WORLD, topology=[WORLD.size, 1])
        nodes, points, most = NODES**2, Counted.points, tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        every = WORLD.gather((points / nodes, held / nodes, most / nodes))
        if WORLD.rank == 0:
            print(json.dumps({"case": name, **dict(zip(("points", "shared", "held"), np.max(every, 0), strict=True))}))
        del run


if __name__ == "__main__":
    main()
