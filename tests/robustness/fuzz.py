"""Random case files: each runs, or is refused in one line.

None ends in a traceback, a crash, a hang or values that are not finite.

    python tests/robustness/fuzz.py --cases 10000 --seed 7 --processes 16
    python tests/robustness/fuzz.py --show 123 --seed 7
    python tests/robustness/fuzz.py --cases 100000 --odd 0.95    # most are refused, and take no time

Most cases are run from Python: half of the run, a checkpoint, the rest, and the rest again from the checkpoint,
which must be bitwise the same. Some go through the command line (run and check). Cases that were spoilt on purpose
may be refused; the tests require that more than 0.4 of all are accepted.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
import tempfile
import warnings
from pathlib import Path

import cases
import foreign
import machinery
import numpy as np

BAD = ("traceback", "crash", "hang", "not finite", "other resume", "wrong exit")
MOST_STEPS = 60
LIMIT = 180.0  # seconds of processor time per case
LARGEST = 2**28  # bytes of the largest set-up that is run: `check` reports the memory of larger ones
SLOWEST = 10.0  # seconds that `MOST_STEPS` steps may take, by their products
CHOICE = 5.0  # seconds that choosing layers may take, by the same count; users wait for up to a minute


def large(sim):
    """Return whether a run is too large to be computed."""
    import farhorizon as fh
    from farhorizon.analysis.stability import step_seconds

    if not isinstance(sim, fh.Simulation):
        return False
    products = float(np.prod(sim.engine.core.nodes)) * sim.stencil.weights.size
    return sim.engine.nbytes > LARGEST or MOST_STEPS * step_seconds(products) > SLOWEST


def library(text, folder):
    """Run a case from Python, and its second half again from its checkpoint."""
    import farhorizon as fh
    from farhorizon.case.case import Case

    try:
        case = Case(text, folder / "case.toml")
        sim = case.run()
        if large(sim):
            return {"class": "too large"}
        until = min(case.end, MOST_STEPS * sim.dt)
        if not until > 0:
            return {"class": "refused"}
        sim.prepare(until)
        sim.run(until / 2)
        sim.save(folder / "half.ckpt")
        sim.run(until)
        other = case.run()
        other.load(folder / "half.ckpt")
        other.run(until)
    except fh.InputError as error:
        return {"class": "refused", "where": str(error)[:300]}
    except fh.UnstableError as error:
        return {"class": "unstable", "where": str(error)[:300]}
    hidden = np.zeros(case.lattice.shape, bool) if case.lattice.mask is None else ~case.lattice.mask
    conditioned = bool(case.parts.constraint)
    for name, values in sim.fields.items():
        if name != "dissolved" and not conditioned and not np.isfinite(values[..., ~hidden]).all():
            return {"class": "not finite", "where": name}
        if values.tobytes() != other.fields[name].tobytes():
            return {"class": "other resume", "where": f"{name} of {case.parts.model.type}"}
    if not np.isfinite(sim.energy()):
        return {"class": "not finite", "where": "energy"}
    if isinstance(sim, fh.Simulation) and any(isinstance(one, fh.ShellRecorder) for one in sim.recorders):
        return recorded(text, folder, sim.dt, until)
    return {"class": "accepted"}


def recorded(text, folder, dt, until):
    """Run a case with a shell on the command line, then one with the recorded wave from its results file."""
    from farhorizon.cli import main

    path, said = folder / "first.toml", io.StringIO()
    path.write_text(text)
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = main(["run", str(path), "--out", str(folder / "first"), "--until", repr(until), "--no-report"])
    if code:
        return {"class": "wrong exit", "where": f"{code}: {said.getvalue()[-300:]}"}
    return library(cases.with_record(text, str(folder / "first" / "first.h5"), dt), folder)


def command(text, folder, arguments):
    """Run a command on a case that does not take long."""
    from farhorizon.case.case import Case
    from farhorizon.cli import main
    from farhorizon.errors import InputError

    with contextlib.suppress(InputError):
        case = Case(text, folder / "case.toml")
        sim = case.run()
        if case.end > 1e4 * sim.dt:
            return {"class": "too long"}
        if large(sim):
            return {"class": "too large"}
    path = folder / "case.toml"
    path.write_text(text)
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = main([arguments[0], str(path), *arguments[1:]])
    if code not in (0, 1, 2):
        return {"class": "wrong exit", "where": str(code)}
    return {"class": {0: "accepted", 1: "unstable", 2: "refused"}[code], "where": said.getvalue()[-300:]}


def answer(job):
    """Return the class of one case, and where it went wrong."""
    from farhorizon.simulation.sides import trials

    trials._MOST_SECONDS = CHOICE
    rng = machinery.random_of(job["seed"], job["number"])
    text, odd = cases.random_case(rng, job.get("share", cases.ODD_SHARE))
    mode = rng.random()
    [files] = rng.spawn(1)
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(name)
        for file, (write, _) in foreign.FILES.items():
            if f'"{file}"' in text:
                write(folder / file, files)
                if files.random() < 0.3:
                    (folder / file).write_bytes(foreign.damaged((folder / file).read_bytes(), files))
        try:
            if mode < 0.9:
                found = library(text, folder)
            elif mode < 0.96:
                found = command(text, folder, ["run", "--out", str(folder / "out")])
            else:
                found = command(text, folder, ["check", "--budget", "0.5"])
        except Exception as error:
            found = {"class": "traceback", "where": machinery.place(error)}
    return {"odd": odd, "mode": round(mode, 2), "text": text, **found}


def campaign(count, seed, processes, folder, report=print, first=0, odd=cases.ODD_SHARE):
    """Return the number of cases by class, without assertions."""
    shares = {"sound": [0, 0]}

    def watched(found):
        for one in found:
            if not one.get("odd", True):
                shares["sound"][0] += one["class"] == "accepted"
                shares["sound"][1] += 1
                if one["class"] == "refused":
                    (folder / "refused.txt").open("a").write(f"{one['number']}: {one['where']}\n")
            yield one

    jobs = ({"seed": seed, "number": number, "share": odd} for number in range(first, first + count))
    counts = machinery.table(
        watched(machinery.answers(Path(__file__), jobs, processes, LIMIT, folder)), BAD, folder, report
    )
    accepted, sound = shares["sound"]
    report(f"of {sound} sound cases {accepted} accepted; of all {counts['accepted']} of {count}")
    return counts


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--odd", type=float, default=cases.ODD_SHARE, help="part of the cases that are spoilt")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--show", type=int, metavar="NUMBER", help="run this case here and print it")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        machinery.serve(answer)
    elif options.show is not None:
        job = {"seed": machinery.seed_of(options.seed), "number": options.show, "share": options.odd}
        found = answer(job)
        print(found.pop("text"), *(f"{name}: {value}" for name, value in found.items()), sep="\n")
    else:
        folder = Path(tempfile.mkdtemp(prefix="farhorizon-fuzz-"))
        seed = machinery.seed_of(options.seed)
        counts = campaign(options.cases, seed, options.processes, folder, first=options.first, odd=options.odd)
        print(f"{folder}: {options.cases} cases")
        sys.exit(1 if set(BAD) & set(counts) else 0)
