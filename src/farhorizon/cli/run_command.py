"""`farhorizon run`: what is asked before, and told after."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farhorizon.cli.common import GOOD, case_of, check_folder, made_folder, write_json
from farhorizon.cli.marching import RunFiles, again, march

if TYPE_CHECKING:
    from farhorizon.cli.outputs import RunFacts


def run_command(options: argparse.Namespace) -> int:
    """Run a case to its end, or until a signal comes, then draw and tell."""
    import numpy as np

    from farhorizon.errors import InputError
    from farhorizon.files.storage import locked, remove_leftovers

    case = case_of(options)
    until = case.end if options.until is None else options.until  # of a run to its static state the latest
    if not (np.isfinite(until) and until > 0):
        raise InputError("the end of the run must be positive", value=until, key="--until")
    files = RunFiles(Path(options.out), case.name)
    if options.resume and not files.checkpoint.exists():
        remedy = (
            "run without --resume, or give the --out of the run; a run that has come to the end of its case keeps one "
            "with --keep-checkpoint alone"
        )
        raise InputError(f"no checkpoint {files.checkpoint}", key="--resume", remedy=remedy)
    _refuse_finished(files.result, options)
    check_folder(str(files.pictures))
    sim = case.run()
    with case.naming():
        last = sim.prepare(until)
        sim.record(case.parts.output.probes, case.parts.output.probe_every)
    certificate = sim.examine(until, options.allow_unstable)
    made_folder(options.out)
    with locked(files.lock):
        _refuse_finished(files.result, options)
        for path in (files.result, files.checkpoint):
            remove_leftovers(path)
        began, before = time.perf_counter(), sim.step_count
        output, code = march(options, case, sim, files, until, last)
        if code == GOOD:
            taken = time.perf_counter() - began
            _sum_up(case, sim, sim.step_count - before, taken)
            output.conclude()
            kept = options.keep_checkpoint or until < case.end
            _tell(options, case, sim, certificate, until, files, kept, taken)
            output.finish()
            if not kept:
                files.checkpoint.unlink()
    return code


def _refuse_finished(result: Path, options: argparse.Namespace) -> None:
    """Refuse to overwrite the results of a run that came to its end."""
    from farhorizon.errors import FileFormatError, InputError
    from farhorizon.files.results import open_results

    if options.force or options.resume or not result.is_file():
        return
    try:
        finished = open_results(result).finished
    except FileFormatError:
        return  # no results of ours: `ResultsWriter.create` refuses it
    if finished:
        onward = ", --resume --until T goes on from them" * result.with_suffix(".ckpt").exists()
        remedy = f"--force overwrites them{onward}, --out DIR puts the new ones elsewhere"
        raise InputError(f"{result} holds the results of a finished run", remedy=remedy)


def _sum_up(case: Any, sim: Any, steps: int, seconds: float) -> None:
    """Say what was done: how far, how fast, what broke."""
    said = f"{case.name}: t = {sim.time:g} reached, {steps} steps and their files in {seconds:.3g} s"
    if "damage" in sim.fields:
        said += f"; {sim.broken_bonds} bonds have broken"
    print(said)


def _tell(
    options: argparse.Namespace,
    case: Any,
    sim: Any,
    certificate: Any,
    until: float,
    files: RunFiles,
    kept: bool,
    taken: float,
) -> None:
    """Draw the results, write the page about them and the figures, and say where they are."""
    from farhorizon.case.run_page import write_report
    from farhorizon.files.results import open_results
    from farhorizon.pictures.result_pictures import View, plot_results
    from farhorizon.simulation.run import wanted_threads

    results = open_results(files.result)
    for caution in results.cautions:
        print(f"warning: not valid from t = {caution.time:.6g} on: {caution.brief}", file=options.errors)
    moments = [time for time in case.parts.output.pictures or () if time <= until]
    view = View(times=moments or None, cracks=results.outlines.get("cracks", ()), quantities=case.quantities)
    pictures = plot_results(results, files.pictures, view, print)
    made_folder(str(files.pictures))
    results.write_outlines(files.pictures / "outlines.vtp")
    said = f"results: {files.result} ({len(results.times)} outputs); pictures: {', '.join(map(str, pictures))}"
    if not options.no_report:
        threads = wanted_threads(case.parts.run.threads)
        page = files.pictures / "report.html"
        onward = f"{again(options, until=False)} --until T" if kept else ""
        write_report(page, case, sim, certificate, results, pictures, threads=threads, again=onward, seconds=taken)
        said += f"; report: {page}"
    print(said, file=options.output)
    figures: RunFacts = {
        "name": case.name,
        "steps": sim.step_count,
        "time": sim.time,
        "dt": sim.dt,
        "energy": sim.energy(),
        "results": str(files.result),
        "pictures": [str(p) for p in pictures],
        "certificate": certificate.as_json(),
    }
    write_json(options.json, figures)
