"""Kills runs at single calls of the file system, and checks that they can be continued with the same results.

    python tests/robustness/kill.py --kills 500 --seed 7 --processes 2

A preloaded library counts the calls that change files below the folder of the results (writes, renames,
truncations, removals, ...) and ends the process at one of them, within it if it is a write. Then the run is
resumed, or restarted if there is no checkpoint, up to three times killed again, and its results must be bitwise those
of an undisturbed run. Half of the runs are those below, the others random ones of all features.
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

import cases
import fuzz
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
    "static": """lattice = { spacing = 0.5, lower = [-3.0, -3.0], upper = [3.0, 3.0] }
model = { type = "wave", kernel = { horizon = 1.0 } }
source = [{ value = "exp(-x**2 - y**2)", time = { type = "ricker", frequency = 0.3 } }]
boundary = { all = { type = "lattice-pml", nodes = 6 } }
run = { until = "static", limit = 60.0, tolerance = 0.02 }
output = { every = 2.0, probes = [[1.5, 0.0]] }
""",
    "static heat": """lattice = { spacing = 1.0, lower = [0.0], upper = [12.0] }
model = { type = "diffusion", stencil = "finite-difference" }
initial = { u = "exp(-(x - 6)**2)" }
boundary = { all = { type = "fixed" } }
run = { until = "static", limit = 400.0, tolerance = 0.01 }
output = { every = 10.0, balance = true }
""",
    "not static": """lattice = { spacing = 1.0, lower = [0.0], upper = [12.0] }
model = { type = "diffusion", stencil = "finite-difference" }
initial = { u = "exp(-(x - 6)**2)" }
boundary = { all = { type = "fixed" } }
run = { until = "static", limit = 20.0, tolerance = 1e-6 }
output = { every = 1.0 }
""",
    "recorders": """lattice = { spacing = 0.5, lower = [-5.0, -5.0], upper = [5.0, 5.0] }
model = { type = "wave", kernel = { horizon = 1.0 } }
initial = { u = "exp(-2*(x**2 + y**2))" }
boundary = { all = { type = "lattice-pml", nodes = 6 } }
receivers = [{ points = [[2.2, 0.3]], record = ["u", "v"], every = 2, interpolation = "linear" }]
spectra = [{ points = [[2.0, 1.0]], frequencies = [0.1, 0.2], interpolation = "linear" }]
power = [{ axis = "x", position = 2.0, frequencies = [0.1] }]
far_field = { points = [[30.0, 10.0]], frequencies = [0.1] }
run = { until = 6.0 }
output = { every = 1.0, probes = [[1.0, 0.0]], probe_every = 0.25 }
""",
}
PICTURED = "exact"  # the only case that draws pictures
MOST_STEPS = 60  # of a random run to a time
MOST_KILLS = 3  # of one run


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
            from farhorizon.cli import main, run_loop
            from farhorizon.pictures import result_pictures

            run_loop.CHECKPOINT_SECONDS = period
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


def random_text(rng):
    """Return a random case of a short run to a time or to its static state; None if it cannot be run."""
    import farhorizon as fh
    from farhorizon.case.case import Case

    case = cases.Draw(rng).case()
    try:
        sim = Case(cases.text_of(case)).run()
    except fh.InputError:
        return None
    if fuzz.large(sim):
        return None
    steps, run = int(rng.integers(20, MOST_STEPS + 1)), case["run"] | {"dt": sim.dt}
    run |= {"until": steps * sim.dt}
    if rng.random() < 0.3:
        window = int(sim.resting.slow_crossing / sim.dt)
        steps = min(int(rng.uniform(0.5, 4) * window) + 1, 10 * MOST_STEPS)
        run |= {"until": "static", "limit": steps * sim.dt, "tolerance": float(rng.choice([0.5, 0.1]))}
    every = int(rng.integers(1, max(2, steps // 4)))
    return cases.text_of(case | {"run": run, "output": case.get("output", {}) | {"every": every * sim.dt}})


class Killer:
    """Undisturbed runs of each case, and their numbers of calls."""

    def __init__(self):
        import farhorizon.case.case  # noqa: F401 (once, for all forks)

        self.folder = Path(tempfile.mkdtemp(prefix="farhorizon-kill-"))
        self.calls = {}

    def whole(self, name, text, period):
        """Return the folder of the undisturbed run; None if it is refused or becomes unstable."""
        folder = self.folder / f"whole-{name}-{period:g}"
        if folder not in self.calls:
            (self.folder / f"{name}.toml").write_text(text)
            arguments = ["run", str(self.folder / f"{name}.toml"), "--out", str(folder)]
            code = run(arguments, period, name == PICTURED, self.folder / "calls", FARHORIZON_UNDER=str(folder))
            if code and name not in CASES:
                return None
            assert code == 0, f"exit code {code} of {name}"
            self.calls[folder] = int((self.folder / "calls").read_text())
        return folder

    def drawn(self, rng, number, period):
        """Return the name and the undisturbed run of one of the cases, or of a random one."""
        if rng.random() < 0.5:
            name = str(rng.choice(list(CASES)))
            return name, self.whole(name, CASES[name], period)
        while True:
            text, name = random_text(rng), f"random{number}"
            if text is not None and (whole := self.whole(name, text, period)) is not None:
                return name, whole

    def answer(self, job):
        """Kill one run, perhaps several times, and examine whether it can be continued."""
        rng = machinery.random_of(job["seed"], job["number"])
        period = float(rng.choice([0.0, 30.0]))
        name, whole = self.drawn(rng, job["number"], period)
        out, calls = self.folder / "out", self.calls[whole]
        shutil.rmtree(out, ignore_errors=True)
        arguments = ["run", str(self.folder / f"{name}.toml"), "--out", str(out)]
        told = {"case": name, "of": calls, "period": period, "killed": [], "class": "not killed"}
        code, again = 137, []
        for _ in range(int(rng.integers(1, MOST_KILLS + 1))):
            at, half = int(rng.integers(1, calls + 1)), bool(rng.integers(2))
            dying = {"FARHORIZON_UNDER": str(out), "FARHORIZON_DIE": str(at)} | (
                {"FARHORIZON_HALF": "1"} if half else {}
            )
            code = run([*arguments, *again], period, name == PICTURED, **dying)
            if code != 137:  # what was left of the run makes fewer calls
                break
            told["killed"].append(f"{at}{' half' * half}")
            resumed = (out / f"{name}.ckpt").exists()
            again = ["--resume" if resumed else "--force"]  # the latter is needed if it died after its end
            told["class"] = "resumed" if resumed else "begun anew"
        if not told["killed"]:
            return told
        try:
            if code == 137:
                code = run([*arguments, *again], period, name == PICTURED)
            assert code == 0, f"exit code {code}"
            machinery.same_results(out / f"{name}.h5", whole / f"{name}.h5")
            left = [p.name for p in out.iterdir() if p.name.startswith(".")]
            assert not left, f"left behind: {left}"
        except Exception as error:
            where = f"{name}, calls {', '.join(told['killed'])} of {calls}, period {period:g}: {error}"
            return told | {"class": "lost", "where": where, "text": (self.folder / f"{name}.toml").read_text()}
        finally:
            if name not in CASES:
                shutil.rmtree(whole)
        return told


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
