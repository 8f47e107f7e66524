"""Kills runs at single calls of the file system, and checks that they can be continued with the same results.

    python tests/robustness/kill.py --kills 500 --seed 7 --processes 2

A preloaded library counts the calls that change files below the folder of the results (writes, renames,
truncations, removals, ...) and ends the process at one of them, within it if it is a write. Then the run is
resumed, or restarted if there is no checkpoint, and its results must be bitwise those of an undisturbed run.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import machinery

CASES = {
    "wave": """lattice = { spacing = 0.25, lower = [-3.0, -2.0], upper = [3.0, 2.0] }
model = { type = "wave", kernel = { horizon = 0.5 } }
initial = { u = "max(0, 1-2*(x**2+y**2))**2" }
crack = [{ points = [[1.05, -1.0], [1.05, 1.0]] }]
boundary = { all = { type = "lattice-pml", nodes = 8 } }
run = { until = 3.0 }
output = { every = 0.5, probes = [[1.5, 0.0]], balance = false }
""",
    "exact": """lattice = { spacing = 0.25, lower = [-3.0], upper = [3.0] }
model = { type = "wave", kernel = { horizon = 0.75 } }
initial = { u = "max(0, 1-4*x**2)**2" }
boundary = { all = { type = "exact" } }
run = { until = 6.0 }
output = { every = 1.0 }
""",
    "breaking": """lattice = { spacing = 0.25, lower = [-2.0, -1.0], upper = [2.0, 1.0] }
model.type = "elastic"
model.young = 1.0
model.nonlinear = true
model.critical_stretch = 0.1
model.kernel = { horizon = 0.5, exponent = 1 }
initial = { v = ["0.4*x", "0"] }
boundary = { x = { type = "free" }, y = { type = "fixed" } }
run = { until = 1.0 }
output = { every = 0.2, balance = true }
""",
    "corrosion": """lattice = { spacing = 0.25, lower = [-2.0, -2.0], upper = [2.0, 2.0] }
model = { type = "corrosion", saturation = 0.9, interface = 0.5, kernel = { horizon = 0.5 } }
specimen = [{ region = { disc = { radius = 0.9 } } }]
run = { until = 0.4 }
output = { every = 0.1, balance = true }
""",
}
PICTURED = "exact"  # the only case that draws pictures


def compiled_shim(folder: Path):
    """Return the preloaded library, or None if it cannot be compiled."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or not sys.platform.startswith("linux"):
        return None
    library = folder / "shim.so"
    made = subprocess.run(
        [compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(machinery.HERE / "shim.c"), "-ldl"],
        capture_output=True,
    )
    return library if made.returncode == 0 else None


def run(arguments, period, pictures, calls=None, **environment):
    """Return the exit code of the command line in a fork of this process, in which everything is loaded; the number
    of its calls that change files is written to `calls`.
    """
    child = os.fork()
    if child == 0:
        code = 99
        try:
            from farhorizon.cli import main, marching
            from farhorizon.pictures import result_pictures

            marching.CHECKPOINT_SECONDS = period
            if not pictures:  # pictures take most of the time
                result_pictures.plot_results = lambda *_: []
            os.environ.update(environment)
            code = main(arguments)
            sys.stdout.flush()
            if calls is not None:
                calls.write_text(str(ctypes.c_long.in_dll(ctypes.CDLL(None), "farhorizon_calls").value))
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


class Killer:
    """Undisturbed runs of each case, and their numbers of calls."""

    def __init__(self):
        import farhorizon.case.case  # noqa: F401 (once, for all forks)

        self.folder = Path(tempfile.mkdtemp(prefix="farhorizon-kill-"))
        self.calls = {}

    def whole(self, name, period):
        """Return the folder of the undisturbed run."""
        folder = self.folder / f"whole-{name}-{period:g}"
        if folder not in self.calls:
            (self.folder / f"{name}.toml").write_text(CASES[name])
            arguments = ["run", str(self.folder / f"{name}.toml"), "--out", str(folder)]
            assert run(arguments, period, name == PICTURED, self.folder / "calls", FARHORIZON_UNDER=str(folder)) == 0
            self.calls[folder] = int((self.folder / "calls").read_text())
        return folder

    def answer(self, job):
        """Kill one run and examine whether it can be continued."""
        rng = machinery.random_of(job["seed"], job["number"])
        name, period = str(rng.choice(list(CASES))), float(rng.choice([0.0, 30.0]))
        whole = self.whole(name, period)
        at, half = int(rng.integers(1, self.calls[whole] + 1)), bool(rng.integers(2))
        out = self.folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        arguments = ["run", str(self.folder / f"{name}.toml"), "--out", str(out)]
        told = {"case": name, "call": at, "of": self.calls[whole], "half": half, "period": period}
        dying = {"FARHORIZON_UNDER": str(out), "FARHORIZON_DIE": str(at), **({"FARHORIZON_HALF": "1"} if half else {})}
        if run(arguments, period, name == PICTURED, **dying) != 137:
            return told | {"class": "not killed"}
        resumed = (out / f"{name}.ckpt").exists()
        again = "--resume" if resumed else "--force"  # needed if it died after its end
        code = run([*arguments, again], period, name == PICTURED)
        found = told | {"class": "resumed" if resumed else "begun anew"}
        try:
            assert code == 0, f"exit code {code}"
            machinery.same_results(out / f"{name}.h5", whole / f"{name}.h5")
            left = [p.name for p in out.iterdir() if p.name.startswith(".")]
            assert not left, f"left behind: {left}"
        except Exception as error:
            return found | {"class": "lost", "where": f"{name}, call {at}{' half' * half}, period {period:g}: {error}"}
        return found


def campaign(kills, seed, processes, folder, report=print):
    """Return the number of kills by class, and report lost runs; None if no library can be preloaded."""
    library = compiled_shim(folder)
    if library is None:
        return None
    before = os.environ.get("LD_PRELOAD")
    os.environ["LD_PRELOAD"] = str(library)
    try:
        jobs = ({"seed": seed, "number": number} for number in range(kills))
        return machinery.table(
            machinery.answers(Path(__file__), jobs, processes, 600.0, folder), ("lost", "crash", "hang"), folder, report
        )
    finally:
        if before is None:
            del os.environ["LD_PRELOAD"]
        else:
            os.environ["LD_PRELOAD"] = before


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        machinery.serve(Killer().answer)
    else:
        folder = Path(tempfile.mkdtemp(prefix="farhorizon-kills-"))
        counts = campaign(options.kills, machinery.seed_of(options.seed), options.processes, folder)
        print("no C compiler for the library" if counts is None else f"{folder}: {options.kills} kills")
        sys.exit(0 if counts is not None and not {"lost", "crash", "hang"} & set(counts) else 1)
