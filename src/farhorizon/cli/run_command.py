"""`farhorizon run`: checks before the run, and reports after it."""

from __future__ import annotations

import argparse
import math
import time
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from farhorizon.cli.common import GOOD, case_of, check_folder, made_folder, write_json
from farhorizon.cli.processes import all_processes
from farhorizon.cli.run_loop import RunFiles, advance_run, again

if TYPE_CHECKING:
    from farhorizon.cli.outputs import RunFacts


#: Options that must be the same on all processes; the others concern the first one alone, or its machine.
_ALIKE = "until", "out", "resume", "force", "allow_unstable", "keep_checkpoint", "no_report"
_DRAWN = 64  # bytes per node that drawing may take, for results of several processes: eight arrays


def run_command(options: argparse.Namespace) -> int:
    """Run a case, on all processes that were started together; only the first one prints, draws and checks existing
    files.
    """
    from farhorizon.errors import InputError
    from farhorizon.simulation.time.checkpoint_files import remove_checkpoint

    options.team = team = all_processes()
    with team.agreed():
        case = case_of(options, parallel=True)
        given = {f"--{name.replace('_', '-')}": getattr(options, name) for name in _ALIKE}
        team.alike({"case": tomllib.loads(case.text), **given})
        until = case.end if options.until is None else options.until  # for a run to its static state, the latest end
        if not (math.isfinite(until) and until > 0):
            raise InputError("the end of the run must be positive", value=until, limit="> 0", key="--until")
        files = RunFiles(Path(options.out), case.name)
    team.by_first(lambda: _check_files(options, files))
    with team.agreed():
        sim = case.run(communicator=team)
    with team.agreed(), case.naming():
        last = sim.prepare(until)
        sim.record(case.parts.output.probes, case.parts.output.probe_every)
    certificate = sim.examine(until, options.allow_unstable)
    with ExitStack() as held:
        team.by_first(lambda: held.enter_context(_lock(options, files)))
        began = time.perf_counter()
        output, steps, code = advance_run(options, case, sim, files, until, last)
        if code == GOOD:
            taken, energy = time.perf_counter() - began, sim.energy()
            broken = f"; {sim.broken_bonds} bonds have broken" if "damage" in sim.fields else ""
            output.conclude()
            done = _Finished(case, sim, certificate, until, options.keep_checkpoint or until < case.end, taken, energy)

            def report() -> None:
                reached = f"{case.name}: t = {sim.time:g} reached, {steps} steps and their files in {taken:.3g} s"
                print(reached + broken)
                _report(options, files, done)

            team.by_first(report)
            output.finish()
            if not done.kept:
                team.by_first(lambda: remove_checkpoint(files.checkpoint))
    return code


class _Finished(NamedTuple):
    """A run at its end."""

    case: Any
    sim: Any
    certificate: Any  # made before the run
    until: float
    kept: bool  # whether its checkpoint stays
    taken: float  # seconds for steps and files
    energy: float


def _check_files(options: argparse.Namespace, files: RunFiles) -> None:
    """Refuse a missing checkpoint, results that would be lost, and a folder that cannot be created."""
    from farhorizon.errors import InputError

    if options.resume and not files.checkpoint.exists():
        remedy = (
            "run without --resume, or give the --out of the run; a run that has reached the end of its case keeps one "
            "only with --keep-checkpoint"
        )
        raise InputError(f"no checkpoint {files.checkpoint}", key="--resume", remedy=remedy)
    _refuse_finished(files.result, options)
    check_folder(str(files.pictures))


@contextmanager
def _lock(options: argparse.Namespace, files: RunFiles) -> Iterator[None]:
    """Context in which the run has exclusive use of its files."""
    from farhorizon.files.storage import locked, remove_leftovers

    made_folder(options.out)
    with locked(files.lock):
        _refuse_finished(files.result, options)
        for path in (files.result, files.checkpoint):
            remove_leftovers(path)
        yield


def _refuse_finished(result: Path, options: argparse.Namespace) -> None:
    """Refuse to overwrite the results of a finished run."""
    from farhorizon.errors import FileFormatError, InputError
    from farhorizon.files.results import open_results

    if options.force or options.resume or not result.is_file():
        return
    try:
        finished = open_results(result, verify=False).finished
    except FileFormatError:
        return  # not a results file of ours: `ResultsWriter.create` refuses it
    if finished:
        onward = ", --resume --until T continues from them" * result.with_suffix(".ckpt").exists()
        remedy = f"--force overwrites them{onward}, --out DIR puts the new ones elsewhere"
        raise InputError(f"{result} holds the results of a finished run", remedy=remedy)


def _report(options: argparse.Namespace, files: RunFiles, done: _Finished) -> None:
    """Draw the results, write the page about them and the output of --json, and print their paths."""
    from farhorizon.case.run_page import RunPage
    from farhorizon.files.results import open_results
    from farhorizon.machine import available_memory
    from farhorizon.pictures.result_pictures import plot_results
    from farhorizon.pictures.views import View
    from farhorizon.simulation.setup.setup import wanted_threads

    case, sim, results = done.case, done.sim, open_results(files.result, verify=False)
    for caution in results.cautions:
        print(f"warning: not valid from t = {caution.time:.6g} on: {caution.brief}", file=options.errors)
    times = [time for time in case.parts.output.pictures or () if time <= done.until]
    view = View(times=times or None, cracks=results.outlines.get("cracks", ()), quantities=case.quantities)
    fits = not sim.team or _DRAWN * math.prod(case.lattice.shape) < available_memory()
    pictures = plot_results(results, files.pictures, view, print) if fits else []
    made_folder(str(files.pictures))
    results.write_outlines(files.pictures / "outlines.vtp")
    shown = ", ".join(map(str, pictures)) if fits else "none, one process cannot hold the fields"
    paths = f"results: {files.result} ({len(results.times)} outputs); pictures: {shown}"
    if fits and not options.no_report:
        page = RunPage(
            case,
            sim,
            done.certificate,
            results,
            pictures,
            threads=wanted_threads(case.parts.run.threads),
            again=f"{again(options, until=False)} --until T" if done.kept else "",
            seconds=done.taken,
        )
        paths += f"; report: {page.write(files.pictures / 'report.html')}"
    print(paths, file=options.output)
    facts: RunFacts = {
        "name": case.name,
        "steps": sim.step_count,
        "time": sim.time,
        "dt": sim.dt,
        "energy": done.energy,
        "results": str(files.result),
        "pictures": [str(p) for p in pictures],
        "certificate": done.certificate.as_json(),
    }
    write_json(options.json, facts)
