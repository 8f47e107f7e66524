"""What processes do that are not given the same, or of which one fails: `mpiexec -n 2 python on_unlike_processes.py
FOLDER [CASE]`.

Without a case, each is tried in turn, and the first process prints a line of JSON with the errors of all. The error of
a case that is given is handled by nobody.
"""

import json
import sys
import warnings
from pathlib import Path

import numpy as np
from mpi4py import MPI

import farhorizon as fh

WORLD, FOLDER = MPI.COMM_WORLD, Path(sys.argv[1])
RANK, LAST = WORLD.rank, WORLD.rank == WORLD.size - 1
PULSE = {"u": "exp(-2*(x**2 + y**2))"}
FACTOR = 1.0 + LAST


def here(usual, other):
    """Return a value that is another one on the last process."""
    return other if LAST else usual


def lattice(upper=6.0):
    return fh.Lattice(0.5, (-6.0, -6.0), (upper, 6.0))


def made(grid=None, model=None, boundary=None, initial=PULSE, **given):
    model = model or fh.Wave(fh.Kernel(1.0))
    boundary = boundary or fh.Fixed()
    return fh.Simulation(grid or lattice(), model, boundary, initial, communicator=WORLD, **given)


def fails(*_):
    if WORLD.rank == WORLD.size - 1:  # unlike values that differ, the rank is not part of what a function computes with
        raise ZeroDivisionError("nothing to divide by")
    return 0.0


def blows_up(x, y, t):
    return x * (np.nan if WORLD.rank and t > 0.5 else 0.0)


def leaves(run):
    if LAST:
        sys.exit(3)


def scaled(x, y):
    return FACTOR * np.exp(-(x**2) - y**2)


class Scaled:
    """A function that is an object."""

    def __init__(self, factor):
        self.factor = factor

    def __call__(self, x, y):
        return self.factor * np.exp(-(x**2) - y**2)


def closed(factor):
    return lambda x, y: factor * np.exp(-(x**2) - y**2)


def array(changed=False):
    found = np.random.default_rng(7).standard_normal(lattice().shape)
    found[3, 4] += changed
    return found


def file_of(name, usual, other):
    """Write a file for each process, and return its path."""
    folder = FOLDER / str(RANK)
    folder.mkdir(exist_ok=True)
    path = folder / name
    np.save(path, here(usual, other))
    return path


def stepped(run, counts):
    for count in counts:
        run.step(count)


def kept(steps, size=1):
    """Write a checkpoint on each process alone, and return its path."""
    run = fh.Simulation(lattice(), fh.Wave(fh.Kernel(1.0)), fh.Fixed(), {"u": f"{size}*exp(-(x**2) - y**2)"})
    run.step(steps)
    run.save(FOLDER / f"{RANK}.ckpt")
    return FOLDER / f"{RANK}.ckpt"


def driven(source):
    return made(sources=[source]).run(1.0)


BEATS = np.array([0.0, 0.0, 1.0, 0.5, -1.0, 0.0, 0.0])
ELASTIC = fh.Elastic(fh.Kernel(1.0, 1), 1.0)
#: What is given differently, and a word of the message.
CASES = {
    "lattice": (lambda: made(lattice(here(6.0, 7.0))), "lattice"),
    "no lattice": (lambda: made(grid=here(None, "nothing")), "a Lattice"),
    "model": (lambda: made(model=fh.Wave(fh.Kernel(here(1.0, 1.5)))), "model"),
    "speed": (lambda: made(model=fh.Wave(fh.Kernel(1.0), speed=here(1.0, 1.0 + 2**-52))), "model"),
    "kind of model": (lambda: made(model=here(fh.Wave, fh.Diffusion)(fh.Kernel(1.0))), "model"),
    "boundary": (lambda: made(boundary=fh.LatticePML(nodes=here(4, 5))), "boundary.x-"),
    "one side": (lambda: made(boundary={"x-": here(fh.Free(), fh.Fixed()), "all": fh.Fixed()}), "boundary.x-"),
    "expression": (lambda: made(initial={"u": here("exp(-x**2)", "exp(-y**2)")}), "initial.u"),
    "another field": (lambda: made(initial={here("u", "v"): "exp(-x**2)"}), "initial"),
    "array": (lambda: made(initial={"u": array(LAST)}), "initial.u"),
    "samples of a file": (lambda: made(initial={"u": np.load(file_of("u.npy", array(), array(True)))}), "initial.u"),
    "function that reads a global value": (lambda: made(initial={"u": scaled}), "initial.u"),
    "function that encloses a value": (lambda: made(initial={"u": closed(FACTOR)}), "initial.u"),
    "object that is called": (lambda: made(initial={"u": Scaled(FACTOR)}), "initial.u"),
    "coefficient": (lambda: made(coefficient=np.exp(0.01 * array(LAST))), "coefficient"),
    "dt": (lambda: made(dt=here(0.1, 0.09)), "dt"),
    "rule of dt": (lambda: made(dt=fh.WholeSteps(every=here(0.5, 0.7))), "dt"),
    "dtype": (lambda: made(dtype=here("float64", "float32")), "dtype"),
    "balance": (lambda: made(balance=LAST), "balance"),
    "topology": (lambda: made(topology=here([WORLD.size, 1], [1, WORLD.size])), "topology"),
    "crack": (lambda: made(cracks=[[(-2.0, 0.1), (here(2.0, 1.0), 0.1)]]), "cracks"),
    "one crack more": (lambda: made(cracks=[[(-2.0, 0.1), (2.0, 0.1)]] * here(1, 2)), "cracks"),
    "source": (lambda: driven(fh.PointSource((0.1, 0.2), time=fh.Ricker(here(0.3, 0.4)))), "sources"),
    "samples of a signal": (
        lambda: driven(fh.PointSource((0.1, 0.2), time=fh.Samples(here(BEATS, 2 * BEATS), 0.1))),
        "sources",
    ),
    "load": (lambda: made(model=ELASTIC, initial={}, loads=[fh.BodyForce((here(1.0, 2.0), 0.0))]), "loads"),
    "condition": (lambda: made(constraints=[fh.Prescribed([(0.0, 0.0)], here("0", "t"))]), "constraints"),
    "receivers": (lambda: made(observe=[fh.Receivers([(0.1, here(0.1, 0.2))])]), "observe"),
    "number of receivers": (lambda: made(observe=[fh.Receivers([(0.1, 0.1)] * here(1, 2))]), "observe"),
    "receivers on one": (lambda: made(observe=here([], [fh.Receivers([(0.1, 0.1)])])), "observe"),
    "until": (lambda: made().run(here(1.0, 3.0)), "run.until"),
    "kind of end": (lambda: made().run(here(1.0, "static")), "run.until"),
    "every": (lambda: made(dt=0.1).run(1.0, every=here(0.1, 0.2)), "run.every"),
    "tolerance": (lambda: made().run("static", tolerance=here(0.1, 0.2)), "run.tolerance"),
    "output": (lambda: made().run(1.0, output=here(None, FOLDER / "one.h5")), "run.output"),
    "prepare": (lambda: made().prepare(here(1.0, 3.0)), "run.until"),
    "steps": (lambda: made().step(here(5, 6)), "the same"),
    "steps before": (lambda: stepped(made(), here([5, 5], [5, 6])), "the same"),
    "source that fails": (lambda: driven(fh.Source("exp(-x**2)", fails)), "nothing to divide by"),
    "source anywhere that fails": (
        lambda: driven(lambda x, y, t: x * 0 + (t > 0.5 and fails())),
        "nothing to divide by",
    ),
    "source that is not finite on one": (lambda: driven(blows_up), "finite"),
    "prescribed value that fails": (
        lambda: made(constraints=[fh.Prescribed([(0.0, 0.0)], lambda t: t > 0.5 and fails())]).run(1.0),
        "nothing to divide by",
    ),
    "checkpoint": (lambda: made().load(kept(here(3, 4))), "path"),
    "content of a checkpoint": (lambda: made().load(kept(3, here(1, 2))), "path"),
    "no checkpoint on one": (lambda: made().load(here(kept(3), FOLDER / "nowhere")), "nowhere"),
    "folder of a checkpoint": (lambda: made().save(FOLDER / here("a", "b") / "c"), "path"),
    "probes": (lambda: made().record([(0.0, here(0.0, 1.0))]), "points"),
    "fields of a file": (lambda: made().write(FOLDER / "w.h5", here(["u"], ["u", "v"])), "fields"),
    "one goes on": (lambda: here(lambda run: run.energy(), lambda run: run.step(3))(made()), "the same"),
    "observer that steps on one": (
        lambda: made(observe=[lambda run: run.energy() if LAST else 0]).run(1.0),
        "the same",
    ),
    "observer on one": (lambda: made(observe=here([], [lambda run: run.energy()])).run(1.0), "the same"),
    "observer that fails": (lambda: made(observe=[fails]).run(1.0), "nothing to divide by"),
    "observer that exits": (lambda: made(observe=[leaves]).run(1.0), "3"),
    "initial data that fail": (lambda: made(initial={"u": lambda x, y: x * 0 + fails()}), "nothing to divide by"),
    "step that fails": (lambda: made(dt=lambda most: most + fails()), "nothing to divide by"),
}
#: Cases that end the program of one process.
ALONE = {
    "script that fails": (lambda: (made(), fails(), made()),),
    "script that is refused": (lambda: (made(), LAST and fh.Lattice(-1.0, 0.0, 1.0), made()),),
    "script that ends": (lambda: (made(), LAST and sys.exit(0), made()),),
}


def told(case):
    """Return the error of a case on each process: its class, its message, and whether this process tells of it."""
    try:
        CASES[case][0]()
        mine = ["nothing", "", True]
    except (Exception, SystemExit) as error:
        mine = [type(error).__name__, str(error), not getattr(error, "told", False)]
    return WORLD.gather(mine)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    for case in CASES if len(sys.argv) < 3 else ():
        errors = told(case)
        if RANK == 0:
            print(json.dumps({"case": case, "word": CASES[case][1], "errors": errors}), flush=True)
    if len(sys.argv) > 2:
        {**CASES, **ALONE}[sys.argv[2]][0]()
