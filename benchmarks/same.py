"""Do two checkouts compute the same, bit for bit? Every example, and some set-ups that none of them contains.

    python benchmarks/same.py ../other --steps 60

Each case is advanced by some steps in both, and the fields and the contents of a checkpoint are compared.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

EXAMPLES = Path(__file__).parents[1] / "examples"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, nargs="?", help="the other checkout; without it, the sums are printed")
    parser.add_argument("--steps", type=int, default=60, help="of each case (default 60)")
    given = parser.parse_args()
    if given.other is None:
        for name, mark in _marks(given.steps):
            print(f"{mark} {name}", flush=True)
        return
    if not (given.other / "src" / "farhorizon").is_dir():
        parser.error(f"no checkout: {given.other}")
    here, there = (_marks_of(folder, given.steps) for folder in (EXAMPLES.parent, given.other.resolve()))
    changed = sorted(name for name in {*here, *there} if here.get(name) != there.get(name))
    print(f"{len(here) - len(changed)} of {len(here)} cases are equal bit for bit after {given.steps} steps")
    for name in changed:
        print(f"differs: {name}")
    sys.exit(1 if changed else 0)


def _marks_of(checkout: Path, steps: int) -> dict[str, str]:
    """Hashes of all cases, computed with the sources of a checkout."""
    env = os.environ | {"PYTHONPATH": str(checkout / "src"), "NUMBA_NUM_THREADS": "2"}
    command = [sys.executable, __file__, "--steps", str(steps)]
    lines = subprocess.run(command, env=env, check=True, stdout=subprocess.PIPE, text=True).stdout.splitlines()
    return {name: mark for mark, _, name in (line.partition(" ") for line in lines)}


def _marks(steps: int) -> Iterator[tuple[str, str]]:
    from farhorizon.case.case import Case

    for path in sorted(EXAMPLES.glob("*.toml")):
        yield path.stem, _mark(lambda path=path: Case.read(path).run(), steps)
    for name, make in _more().items():
        yield name, _mark(make, steps)


def _mark(make: Callable[[], Any], steps: int) -> str:
    """Hash of the fields and of the contents of a checkpoint after some steps."""
    from farhorizon.files.checkpoint_format import read_checkpoint

    run, mark = make(), hashlib.sha256()
    run.step(steps)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "checkpoint.h5"
        run.save(path)
        arrays = dict(run.fields) | {f"checkpoint {name}": a for name, a in read_checkpoint(path)[0].items()}
    for name in sorted(arrays):
        mark.update(name.encode() + np.ascontiguousarray(arrays[name]).tobytes())
    return mark.hexdigest()[:16]


def _more() -> dict[str, Callable[[], Any]]:
    """Set-ups that no example contains: other precisions, integrators, sides and combinations."""
    import farhorizon as fh

    def lattice(*shape: int, **more: Any) -> Any:
        return fh.Lattice(spacing=1.0, lower=[0.0] * len(shape), upper=[n - 1.0 for n in shape], **more)

    blob = {dim: {"u": "exp(-(" + "+".join(f"({x}-9)**2" for x in "xyz"[:dim]) + ")/2)"} for dim in (1, 2, 3)}
    wave, source = fh.Wave(fh.Kernel(3.0)), [fh.Source("exp(-(x-9)**2-(y-9)**2)", "sin(t)")]
    slow = fh.LatticePML(nodes=6)
    ball, half = fh.Disc(12.0, (14.0, 14.0)), "1+(x>12)"
    elastic = fh.Elastic(fh.Kernel(2.0), young=1.0)
    state_based = fh.Elastic(fh.Kernel(2.0), young=1.0, poisson=0.2, material="state-based")
    push = {"u": ["exp(-((x-9)**2+(y-9)**2)/9)/100", "0"]}

    def sim(*args: Any, **more: Any) -> Callable[[], Any]:
        return lambda: fh.Simulation(*args, **more)

    return {
        "wave, 1D": sim(lattice(40), wave, slow, blob[1]),
        "wave, 2D, two threads": sim(lattice(210, 200), wave, slow, blob[2], threads=2),
        "wave, 2D, single precision": sim(lattice(30, 31), wave, slow, blob[2], dtype="float32"),
        "wave, 2D, source, periodic": sim(lattice(30, 31), wave, {"x": fh.Periodic(), "y": slow}, blob[2], source),
        "wave, 2D, sponge and free": sim(lattice(30, 31), wave, {"x": fh.Sponge(8), "y": fh.Free()}, blob[2], source),
        "wave, 2D, coefficient": sim(lattice(30, 31), wave, slow, blob[2], coefficient=half, rule="harmonic"),
        "wave, 2D, body": sim(lattice(30, 31, body=ball), wave, fh.Free(), blob[2]),
        "wave, 2D, crack": sim(lattice(30, 31), wave, slow, blob[2], cracks=[[(5.2, 9.3), (20.1, 16.7)]]),
        "wave, 2D, prescribed": sim(
            lattice(30, 31), wave, slow, constraints=[fh.Prescribed([(9.0, 9.0), (12.0, 12.0)], "sin(t)", until=9.0)]
        ),
        "wave, 2D, window": sim(fh.Lattice(1.0, window=fh.Disc(15.0, (9.0, 9.0))), wave, fh.Higdon(), blob[2]),
        "wave, 3D": sim(lattice(20, 19, 21), wave, slow, blob[3]),
        "wave, 3D, two threads": sim(lattice(40, 38, 41), wave, slow, blob[3], threads=2),
        "exact ends": sim(lattice(60), wave, fh.Exact(), blob[1]),
        "exact ends, source": sim(lattice(60), wave, fh.Exact(), sources=[fh.Source("exp(-(x-9)**2)", "sin(t)")]),
        "diffusion, Chebyshev": sim(
            lattice(30, 31), fh.Diffusion(fh.Kernel(3.0), integrator=fh.RungeKuttaChebyshev(5)), slow, blob[2]
        ),
        "diffusion, balance": sim(lattice(30, 31), fh.Diffusion(fh.Kernel(3.0)), slow, blob[2], balance=True),
        "heat, conditions": sim(
            lattice(30, 31),
            fh.Heat(fh.Kernel(3.0), conductivity=1.0),
            {"x-": fh.Free(), "x+": fh.Free(), "y": fh.Periodic()},
            constraints=[fh.Temperature("x-", 1.0), fh.Convection("x+", 0.4, 0.0)],
        ),
        "elastic, 2D": sim(lattice(30, 31), elastic, slow, push),
        "elastic, 2D, state-based": sim(lattice(30, 31), state_based, slow, push),
        "elastic, breaking": sim(
            lattice(30, 31),
            fh.Elastic(fh.Kernel(2.0), young=1.0, critical_stretch=4e-3),
            {"x": slow, "y": fh.Free()},
            push,
            balance=True,
        ),
    }


if __name__ == "__main__":
    main()
