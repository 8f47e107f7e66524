"""Flips bits in every kind of file that the program reads again: damage is reported, or has no effect.

python tests/robustness/damage.py --flips 1000 --seed 7
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import shutil
import sys
import tempfile
import warnings
from pathlib import Path

import machinery

BAD = ("other", "traceback", "crash", "hang")
LIMIT = 300.0
CASE = """lattice = { spacing = 0.25, lower = [-3.0], upper = [3.0] }
model = { type = "wave", kernel = { horizon = 0.75 } }
initial = { u = "max(0, 1-4*x**2)**2" }
boundary = { all = { type = "exact" } }
run = { until = 3.0 }
output = { every = 0.5, probes = [[1.0]] }
receivers = [{ points = [[0.5]] }]
spectra = [{ points = [[0.5]], frequencies = [0.1] }]
"""


def told(path):
    """Return everything that a results file contains."""
    from farhorizon.files.results import open_results

    found = open_results(path, verify=False)
    columns = [
        found.times,
        found.steps,
        found.history_times,
        found.energy,
        found.probe_times,
        found.probe_values,
        found.probes,
        *found.balance.values(),
    ]
    columns += [found.field(name, k) for name in found.field_names for k in range(len(found.times))]
    for one in found.recorded.values():
        columns += [one.points, one.times, *one.data.values(), one.frequencies, *one.spectra.values()]
    return (
        [a.tobytes() for a in columns],
        found.cautions,
        found.units,
        list(found.recorded),
        found.case,
        found.program,
        found.shape,
        found.spacing,
        found.lower,
        found.finished,
    )


def opened_silently(path):
    """Return whether a results file is opened without a word."""
    from farhorizon.errors import InputError, ValidityWarning
    from farhorizon.files.results import open_results

    with warnings.catch_warnings():
        warnings.simplefilter("error", ValidityWarning)
        try:
            open_results(path)
        except (InputError, ValidityWarning):
            return False
    return True


class Damager:
    """A finished run, and one that was interrupted half-way."""

    def __init__(self):
        self.folder = Path(tempfile.mkdtemp(prefix="farhorizon-damage-"))
        self.case = self.folder / "case.toml"
        self.case.write_text(CASE)
        self.ready = False

    def command(self, *arguments):
        from farhorizon.cli import main

        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            return main([arguments[0], str(arguments[1]), *map(str, arguments[2:])]), said.getvalue()

    def prepare(self):
        for name, until in (("whole", "3"), ("half", "1.5")):
            ended = "--until", until, "--keep-checkpoint"
            assert self.command("run", self.case, "--out", self.folder / name, *ended)[0] == 0
        self.expected, self.ready = told(self.folder / "whole" / "case.h5"), True

    def answer(self, job):
        """Damage one file in one place, and use it."""
        if not self.ready:
            self.prepare()
        rng = machinery.random_of(job["seed"], job["number"])
        kind = str(rng.choice(["results", "checkpoint", "resumed results"]))
        out = self.folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(self.folder / ("whole" if kind == "results" else "half"), out)
        file = out / ("case.ckpt" if kind == "checkpoint" else "case.h5")
        data = bytearray(file.read_bytes())
        place = int(rng.integers(min(len(data), 12_000) if rng.random() < 0.4 else len(data)))
        what = str(rng.choice(["bit", "smear", "cut"], p=[0.7, 0.2, 0.1]))
        if what == "bit":
            data[place] ^= 1 << int(rng.integers(8))
        elif what == "smear":
            data[place : place + 64] = rng.bytes(len(data[place : place + 64]))
        else:
            del data[place:]
        file.write_bytes(data)
        found = {"file": kind, "what": what, "place": place}
        try:
            if kind == "results":
                same = told(file) == self.expected
            else:
                code, said = self.command("run", self.case, "--out", out, "--resume")
                if code == 2:
                    return found | {"class": "told"}
                assert code == 0, f"exit code {code}: {said[-200:]}"
                same = told(file.with_suffix(".h5")) == self.expected
        except Exception as error:
            from farhorizon.errors import InputError

            # what reading refuses was told when the file was opened
            bad = not isinstance(error, InputError) or (kind == "results" and opened_silently(file))
            return found | {
                "class": "traceback" if bad else "told",
                "where": f"{kind}, {what} at {place}: {type(error).__name__}: {str(error)[:150]}",
            }
        return found | ({"class": "harmless"} if same else {"class": "other", "where": f"{kind}, {what} at {place}"})


def campaign(flips, seed, processes, folder, report=print):
    """Return the number of damaged files by class."""
    jobs = ({"seed": seed, "number": number} for number in range(flips))
    return machinery.table(machinery.answers(Path(__file__), jobs, processes, LIMIT, folder), BAD, folder, report)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--flips", type=int, default=100)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    os.environ.setdefault("MPLBACKEND", "Agg")
    if options.worker:
        machinery.serve(Damager().answer)
    else:
        folder = Path(tempfile.mkdtemp(prefix="farhorizon-damages-"))
        counts = campaign(options.flips, machinery.seed_of(options.seed), options.processes, folder)
        print(folder)
        sys.exit(1 if set(BAD) & set(counts) else 0)
