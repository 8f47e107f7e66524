"""The command line: new, keys, run, check, compare, plot, reproduce, demo, info."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import signal
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any, NoReturn

GOOD, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
_CHECKPOINT_SECONDS = 30.0


def process() -> NoReturn:
    """The `farhorizon` command as a process: Ctrl-C ends it at once and in one line, and a run between two steps.

    Python loses a KeyboardInterrupt that is raised in callbacks (of the compiler, of destructors, at its own exit).
    Leaving is safe at any time, since files are complete or have a journal whenever a process dies.
    """
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as for jobs in the background of a script
        signal.signal(signal.SIGINT, _leave)
    sys.exit(main())


def _leave(number: int, frame: Any) -> None:
    with suppress(Exception):  # it may come while something is printed
        sys.stdout.flush()
    os.write(2, b"farhorizon: interrupted\n")
    os._exit(INTERRUPTED)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line, by default that of the process; returns the exit code."""
    try:
        options = _parser().parse_args(arguments)
        options.output, options.errors = sys.stdout, sys.stderr
        import farhorizon.case.case  # noqa: F401

        _check_json(getattr(options, "json", None))
        with _silence() if getattr(options, "quiet", False) else nullcontext():
            code = int(options.command(options) or GOOD)
        sys.stdout.flush()  # here a full disk can still be told
        return code
    except KeyboardInterrupt:  # first: it comes while the names of other errors are imported, too
        print("farhorizon: interrupted", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        return _tell(error)


@contextmanager
def _silence() -> Iterator[None]:
    """Within it nobody hears what is printed, but for what goes to `options.output` and `options.errors`: the result
    and errors.
    """
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        yield


def _tell(error: Exception) -> int:
    """Explain in one line an error that is no fault of the program, and return the exit code; raises others again."""
    from farhorizon.errors import FarhorizonError, InputError

    code = (
        BAD_INPUT
        if isinstance(error, InputError | PermissionError | FileExistsError | FileNotFoundError | NotADirectoryError)
        else FAILED
    )
    if isinstance(error, OSError):
        _let_go_of_stdout()
        if isinstance(error, BrokenPipeError):  # the reader of our output, such as head, has gone
            return FAILED
        print(
            f"farhorizon: {error.strerror or error}" + (f": {error.filename}" if error.filename else ""),
            file=sys.stderr,
        )
    elif isinstance(error, MemoryError):
        print(
            f"farhorizon: not enough memory ({error or 'no more to be had'}); remedy: a coarser or smaller lattice",
            file=sys.stderr,
        )
    elif isinstance(error, FarhorizonError):
        print(f"farhorizon: {error}", file=sys.stderr)
    else:
        raise error
    return code


def _let_go_of_stdout() -> None:
    """If nobody takes what is printed, throw it away, so that nothing is written at the exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _Version(argparse.Action):
    """Prints the version; it is looked up only then."""

    def __call__(self, parser: argparse.ArgumentParser, *given: Any) -> NoReturn:
        import farhorizon

        print(f"farhorizon {farhorizon.__version__}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="farhorizon",
        description="Waves, diffusion, heat and corrosion in an unbounded peridynamic or classical medium, computed "
        "on a small grid.",
        epilog="Start with 'farhorizon demo'; then 'farhorizon new wave -o my.toml' and 'farhorizon run my.toml'. Exit "
        "code: 0 good, 1 run failed, 2 bad input, 130 interrupted (Ctrl-C), 143 terminated.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    def add(name: str, function: Any, text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        sub.set_defaults(command=function)
        return sub

    new = add("new", _new, "write a commented case to start from; without a kind, list them")
    new.add_argument("kind", nargs="?", metavar="KIND", help="what it is about, such as wave")
    new.add_argument("-o", "--out", metavar="FILE", help="the file (default: print it)")
    new.add_argument("--force", action="store_true", help="overwrite the file")
    keys = add("keys", _keys, "explain the keys of a case file, such as model.kernel; without one, list the tables")
    keys.add_argument("prefix", nargs="?", default="", metavar="KEY", help="a key with dots, or the first part of one")
    run = add("run", _run, "run a case: writes NAME.h5 (opens in ParaView) and pictures in NAME/")
    run.add_argument("case", help="case file (TOML)")
    run.add_argument("--out", metavar="DIR", default=".", help="folder of the results (default: here)")
    run.add_argument("--resume", action="store_true", help="go on from the checkpoint NAME.ckpt of an interrupted run")
    run.add_argument("--until", type=float, metavar="T", help="end time instead of the case's")
    run.add_argument("--force", action="store_true", help="overwrite the results of a finished run")
    run.add_argument("--no-report", action="store_true", help="write no page about the run (NAME/report.html)")
    run.add_argument("--allow-unstable", action="store_true", help="run although a mode grows")
    check = add(
        "check", _check, "check a case without running it: step limit, stability, reflection, layer, memory, time"
    )
    check.add_argument("case", help="case file (TOML)")
    check.add_argument(
        "--out", metavar="DIR", help="draw reflection and a growing mode into this folder (default: no pictures)"
    )
    check.add_argument(
        "--tune",
        action="store_true",
        help="search the settings of a PlaneWave or Higdon for the best that are certified",
    )
    check.add_argument(
        "--budget",
        type=float,
        metavar="SECONDS",
        help="time for the stability certificate (default: that of the run, 2 to 30 s)",
    )
    compare = add("compare", _compare, "compare a case with the infinite medium, beside a fixed and a free edge")
    compare.add_argument("case", help="case file (TOML)")
    compare.add_argument("--out", metavar="DIR", default=".", help="folder of the pictures (default: here)")
    compare.add_argument("--times", type=float, nargs="+", metavar="T", help="when to compare (default: 40 even times)")
    plot = add("plot", _plot, "draw pictures of a results file")
    plot.add_argument("result", help="results file (NAME.h5)")
    plot.add_argument(
        "--out", metavar="DIR", help="folder of the pictures (default: beside the file, its name without .h5)"
    )
    plot.add_argument(
        "--time", "--times", dest="times", type=float, nargs="+", metavar="T", help="times (default: four even ones)"
    )
    plot.add_argument("--field", nargs="+", metavar="NAME", help="fields or components, such as u u_x (default: all)")
    plot.add_argument("--slice", metavar="z=0.5", help="in space the plane to draw (default: the middle of z)")
    plot.add_argument("--range", type=float, nargs=2, metavar=("LOW", "HIGH"), help="of the colours")
    plot.add_argument("--db", action="store_true", help="magnitudes in decibels below the largest")
    plot.add_argument(
        "--deformed",
        type=float,
        nargs="?",
        const=0.0,
        metavar="FACTOR",
        help="of elastic runs in 2D the deformed shape, displacements times a factor (default: a round one)",
    )
    plot.add_argument("--movie", action="store_true", help="a film of a field: GIF, and MP4 with imageio-ffmpeg")
    plot.add_argument("--format", default="png", metavar="png|pdf|svg", help="of pictures (default: png)")
    reproduce = add(
        "reproduce",
        _reproduce,
        "compute a published table or figure anew, ours beside theirs; without a name, list them",
    )
    reproduce.add_argument("name", nargs="?", help="name of the table or figure")
    reproduce.add_argument("--out", metavar="DIR", default=".", help="folder of the pictures (default: here)")
    reproduce.add_argument(
        "--full", action="store_true", help="the published size, where the default is a smaller one; takes minutes"
    )
    demo = add("demo", _demo, "two notches in an infinite membrane: run, compare and draw, in under a minute")
    demo.add_argument(
        "--out", metavar="DIR", default="farhorizon-demo", help="folder of the picture (default: farhorizon-demo)"
    )
    add("schema", _schema, "the JSON Schema of case files, with which editors complete and check them")
    add("info", _info, "versions, threads, caches")
    for sub in (run, check, compare):
        sub.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="KEY=VALUE",
            help="another value of a key of the case, such as model.speed=2.0; may be repeated",
        )
    for sub in (run, check, compare, reproduce, demo):
        sub.add_argument("--json", metavar="FILE", help="write the figures as JSON too")
        sub.add_argument("--threads", type=int, metavar="N", help="threads of the time loop (default: all there are)")
        sub.add_argument("--quiet", action="store_true", help="print errors and the result only")
    _offer_completion(parser)
    return parser


def _offer_completion(parser: argparse.ArgumentParser) -> None:
    """Answer the shell that asks what a command line may go on with, where argcomplete is installed."""
    if "_ARGCOMPLETE" in os.environ:
        with suppress(ImportError):
            import argcomplete

            argcomplete.autocomplete(parser)


def _write_json(path: str | None, content: dict[str, Any]) -> None:
    if path:
        Path(path).write_text(json.dumps(content, indent=1) + "\n")


def _check_json(name: str | None) -> None:
    """Refuse a JSON file that cannot be written, before any work."""
    from farhorizon.errors import InputError

    if name and (Path(name).is_dir() or not os.access(Path(name).parent, os.W_OK)):
        raise InputError(
            "cannot write this file",
            value=name,
            key="--json",
            remedy="a file in a folder that exists and may be written",
        )


def _check_folder(name: str) -> None:
    """Refuse a folder that cannot be made, without making it."""
    from farhorizon.errors import InputError

    there = next(p for p in (Path(name).resolve(), *Path(name).resolve().parents) if p.exists())
    if not (there.is_dir() and os.access(there, os.W_OK)):
        raise InputError(
            "cannot make the folder",
            value=name,
            key="--out",
            remedy=f"{there} is no folder that may be written: choose another",
        )


def _folder(name: str) -> Path:
    from farhorizon.errors import InputError

    folder = Path(name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror}", key="--out") from None
    return folder


def _again(options: argparse.Namespace, until: bool = True) -> str:
    """The command that goes on with a run, with every option that it was given, or all but its end."""
    words = ["farhorizon", "run", options.case, "--resume"]
    for name, value, default in (
        ("--out", options.out, "."),
        ("--until", options.until if until else None, None),
        ("--json", options.json, None),
        ("--threads", options.threads, None),
        *(("--set", change, None) for change in options.set),
    ):
        words += [name, str(value)] if value != default else []
    return shlex.join(
        words
        + ["--allow-unstable"] * options.allow_unstable
        + ["--no-report"] * options.no_report
        + ["--quiet"] * options.quiet
    )


def _case(options: argparse.Namespace) -> Any:
    """The case file with the changes of the command line."""
    from farhorizon.case.case import Case
    from farhorizon.case.changes import parsed

    return Case.read(options.case, dict(map(parsed, options.set)) | _thread_change(options))


def _thread_change(options: argparse.Namespace) -> dict[str, Any]:
    return {} if options.threads is None else {"run.threads": options.threads}


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
        remedy = "--force overwrites them, --resume --until T goes on from them, --out DIR puts the new ones elsewhere"
        raise InputError(f"{result} holds the results of a finished run", remedy=remedy)


@contextmanager
def _stopping(sim: Any) -> Iterator[list[int]]:
    """Let Ctrl-C and SIGTERM, which batch systems send, end a run between two steps; yields the signals that came. A
    second one acts at once.
    """
    came: list[int] = []

    def interrupt(number: int, frame: Any) -> None:
        came.append(number)
        if len(came) > 1:
            raise KeyboardInterrupt
        sim.stop_requested = True

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _files(options: argparse.Namespace, case: Any) -> tuple[Path, Path]:
    """Results and checkpoint of a case."""
    return Path(options.out) / f"{case.name}.h5", Path(options.out) / f"{case.name}.ckpt"


def _run(options: argparse.Namespace) -> int:
    import numpy as np

    from farhorizon.case.report import write_report
    from farhorizon.errors import InputError
    from farhorizon.files.results import open_results
    from farhorizon.files.storage import locked, remove_leftovers
    from farhorizon.pictures.results import View, plot_results
    from farhorizon.simulation.run import wanted_threads

    case = _case(options)
    until = case.parts.run.until if options.until is None else options.until
    if not (np.isfinite(until) and until > 0):
        raise InputError("the end of the run must be positive", value=until, key="--until")
    folder = Path(options.out)
    result, checkpoint = _files(options, case)
    if options.resume and not checkpoint.exists():
        raise InputError(
            f"no checkpoint {checkpoint}", key="--resume", remedy="run without --resume, or give the --out of the run"
        )
    _refuse_finished(result, options)
    _check_folder(str(folder / case.name))
    sim = case.run()
    with case.naming():
        last = sim.prepare(until)
        sim.record(case.parts.output.probes, case.parts.output.probe_every)
    certificate = sim.examine(until, options.allow_unstable)
    _folder(options.out)
    with locked(folder / f".{case.name}.lock"):
        _refuse_finished(result, options)
        for path in (result, checkpoint):
            remove_leftovers(path)
        with _stopping(sim) as came:
            writer, code = _compute(options, case, sim, until, last, came)
        if code != GOOD:
            return code
        results = open_results(result)
        for caution in results.cautions:
            print(f"warning: not valid from t = {caution.time:.6g} on: {caution.brief}", file=options.errors)
        moments = [time for time in case.parts.output.pictures or () if time <= until]
        view = View(times=moments or None, cracks=case.polylines, quantities=case.quantities)
        pictures = plot_results(results, folder / case.name, view, print)
        said = f"results: {result} ({len(results.times)} outputs); pictures: {', '.join(map(str, pictures))}"
        if not options.no_report:
            threads = wanted_threads(case.parts.run.threads)
            page = folder / case.name / "report.html"
            write_report(
                page, case, sim, certificate, results, pictures, threads=threads, again=_again(options, until=False)
            )
            said += f"; report: {page}"
        print(said, file=options.output)
        _write_json(
            options.json,
            {
                "name": case.name,
                "steps": sim.step_count,
                "time": sim.time,
                "dt": sim.dt,
                "energy": sim.energy(),
                "results": str(result),
                "pictures": [str(p) for p in pictures],
                "certificate": certificate.as_json(),
            },
        )
        writer.finish()
    return GOOD


def _compute(
    options: argparse.Namespace, case: Any, sim: Any, until: float, last: int, came: list[int]
) -> tuple[Any, int]:
    """Begin or take up the files of a run and advance it to its end, or until a signal came; returns the writer of the
    results and the exit code.
    """
    import farhorizon as fh
    from farhorizon.errors import FarhorizonError
    from farhorizon.files.results import ResultsWriter, check_replaceable
    from farhorizon.simulation.run import Run

    result, checkpoint = _files(options, case)
    probes = sim.probes
    if options.resume:
        kept = sim.load(checkpoint)
        writer = ResultsWriter.resume(result, int(kept["outputs"]), int(kept["rows"]), int(kept["records"]))
        probes.take()  # the start, which the file has
    else:
        check_replaceable(result)
        checkpoint.unlink(missing_ok=True)  # it belongs to the results that go
        writer = ResultsWriter.create(
            result,
            dim=case.lattice.dim,
            shape=case.lattice.shape,
            spacing=case.lattice.spacing,
            lower=case.lattice.lower,
            fields=case.fields,
            dtype=sim.fields["u"].dtype,
            probes=probes.places,
            accounts=list(sim.balance()) if case.parts.output.balance else [],
            case=case.text,
            program=f"farhorizon {fh.__version__}",
            components={name: len(field) if field.ndim > case.lattice.dim else 1 for name, field in sim.fields.items()},
        )
    for note in (*sim.notes, *probes.notes):
        print(f"note: {note}", file=sys.stderr)
    print(
        f"{case.name}: {case.lattice.nodes} nodes, dt = {sim.dt:.6g}, {last} steps to t = {last * sim.dt:g}; outputs "
        f"{case.schedule(sim.dt)}"
    )
    if options.resume:
        print(f"resumed at step {sim.step_count}, t = {sim.time:g}")
    saved = [time.monotonic()]

    def record(sim: Run) -> None:
        fields = sim.fields
        keep_probes()
        writer.append(
            sim.step_count,
            sim.time,
            {k: fields[k] for k in case.fields},
            energy=sim.energy(),
            balance=sim.balance() if writer.accounts else None,
            cautions=sim.cautions,
        )

    def keep_probes() -> None:
        if len(probes.nodes):
            writer.append_probes(*probes.take())

    def keep(sim: Run) -> None:
        keep_probes()
        sim.save(checkpoint, outputs=writer.outputs, rows=writer.rows, records=writer.records)
        saved[0] = time.monotonic()

    def observe(sim: Run) -> None:
        record(sim)
        if time.monotonic() - saved[0] > _CHECKPOINT_SECONDS:
            keep(sim)

    if not options.resume:
        record(sim)
        keep(sim)
    sim.observers.append(observe)

    try:
        with _said_plainly():
            sim.run(until, case.every(sim.dt), allow_unstable=options.allow_unstable)
    except KeyboardInterrupt:
        if len(came) == 1:  # it ended between two steps
            keep(sim)
        print(f"\ninterrupted at t = {sim.time:g}; go on with: {_again(options)}", file=options.errors)
        return writer, 128 + came[0] if came else INTERRUPTED
    except FarhorizonError:
        print(f"the last good checkpoint is {checkpoint}", file=options.errors)
        raise
    except OSError:
        print(
            f"the last good checkpoint is {checkpoint}; when files can be written again go on with: {_again(options)}",
            file=options.errors,
        )
        raise
    keep(sim)
    return writer, GOOD


@contextmanager
def _said_plainly() -> Iterator[None]:
    """Within it doubts about the validity of a run are lines on stderr."""
    from farhorizon.errors import ValidityWarning

    usual = warnings.showwarning

    def show(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, ValidityWarning):
            print(f"warning: {message}", file=sys.stderr)
        else:
            usual(message, category, *where, **more)

    with warnings.catch_warnings():
        warnings.simplefilter("always", ValidityWarning)
        warnings.showwarning = show
        yield


def _check(options: argparse.Namespace) -> int:
    from farhorizon.simulation.probes import Probes

    if options.out:
        _check_folder(options.out)
    case = _case(options)
    sim = case.run()
    with case.naming():
        sim.prepare(case.parts.run.until)
    report = sim.check(case.parts.run.until, options.budget)
    report.rows.append(("outputs", case.schedule(sim.dt)))
    report.notes = [*report.notes, *Probes(case.lattice, case.parts.output.probes).notes]
    print(report)
    if options.out:
        for picture in report.draw(_folder(options.out), case.name, case.lattice.spacing):
            print(f"picture: {picture}")
    facts = report.as_json()
    if options.tune:
        from farhorizon.studies.tuning import BUDGET, tuned

        with case.naming():
            found = tuned(case.simulation(), budget=options.budget or BUDGET)
        print(f"tuned: {found}\nin the case file: all = {found.toml}")
        facts["tuned"] = {
            "boundary": found.toml,
            "amplitude": found.amplitude,
            "angle": found.angle,
            **found.certificate.as_json(),
        }
    _write_json(options.json, facts)
    if report.refused:
        print("farhorizon: run refuses this case: it is not stable", file=options.errors)
        return BAD_INPUT
    if options.quiet:
        print(f"{case.name}: {report.headline}", file=options.output)
    return GOOD


def _compare_case(
    options: argparse.Namespace, case: Any, folder: Path, times: Sequence[float] | None, moment: float | None
) -> None:
    from farhorizon.pictures.curves import error_history
    from farhorizon.pictures.fields import field_panels, magnitude
    from farhorizon.studies.compare import compare

    with case.naming(), _said_plainly():
        result = compare(case.setup, case.parts.run.until, times, moment, kind=case.kind)
    print(result.table())
    shown = {
        name: value if value.ndim == case.lattice.dim else magnitude(value)
        for name, value in result.fields.items()
        if name != "free edge"
    }
    fields = [(f"{name}, t = {result.shown_time:.3g}", value) for name, value in shown.items()]
    folder.mkdir(parents=True, exist_ok=True)
    picture, history = folder / "compare.png", folder / "error.png"
    label = "|u|" if any(value.ndim > case.lattice.dim for value in result.fields.values()) else "u"
    field_panels(fields, case.lattice.axes, picture, cracks=case.polylines, label=label)
    curves = {name: (c["times"], c["error_rel_initial"]) for name, c in result.curves.items()}
    error_history(curves, history, f"max error / {result.scale}", "Error against the infinite medium")
    print(f"pictures: {picture}, {history}")
    if options.quiet:
        print(f"{case.name}: {result.headline}", file=options.output)
    curves_and_growth = {
        n: {**c, "growth_rate": result.growth[n]} if n in result.growth else c for n, c in result.curves.items()
    }
    _write_json(options.json, curves_and_growth)


def _compare(options: argparse.Namespace) -> int:
    _check_folder(options.out)
    case = _case(options)
    _compare_case(options, case, Path(options.out) / case.name, options.times, None)
    return GOOD


def _plot(options: argparse.Namespace) -> int:
    from farhorizon.case.case import Case
    from farhorizon.errors import InputError
    from farhorizon.files.results import open_results
    from farhorizon.pictures.results import View, plot_results

    path = Path(options.result)
    folder = Path(options.out) if options.out else path.with_suffix("")
    results = open_results(path)
    try:
        case: Case | None = Case(results.case, path)
    except InputError:  # written from Python, or by a program with other keys: a picture without cracks
        case = None
    view = View(
        times=options.times,
        fields=options.field,
        plane=None if options.slice is None else _plane(options.slice),
        limits=None if options.range is None else tuple(options.range),
        decibels=options.db,
        deformed=options.deformed,
        movie=options.movie,
        format=options.format,
        cracks=case.polylines if case else (),
        quantities=case.quantities if case else {},
    )
    for picture in plot_results(results, folder, view, print):
        print(picture)
    return GOOD


def _plane(text: str) -> tuple[str, float]:
    """Axis and place of a slice such as z=0.5."""
    import math

    from farhorizon.errors import InputError

    axis, _, place = text.partition("=")
    with suppress(ValueError):
        if axis.strip() in ("x", "y", "z") and math.isfinite(float(place)):
            return axis.strip(), float(place)
    raise InputError("a slice is an axis and a number", value=text, key="--slice", remedy="--slice z=0.5")


def _reproduce(options: argparse.Namespace) -> int:
    from farhorizon.engine.engine import at_most
    from farhorizon.papers.registry import find, reproductions, table

    if options.name is None:
        known = reproductions()
        width, longest = max(map(len, known)), max(len(entry.duration) for entry in known.values())
        for name, entry in known.items():
            print(f"{name:{width}}  {entry.duration:{longest}}  {entry.title}", file=options.output)
        _write_json(
            options.json,
            {
                name: {"paper": entry.paper, "title": entry.title, "takes": entry.takes, "full": entry.full}
                for name, entry in known.items()
            },
        )
        return GOOD
    entry = find(options.name)
    print(f"{entry.paper}\n{entry.name}: {entry.title}")
    with at_most(options.threads):
        outcome = entry.run(_folder(options.out), options.full)
    print(table(outcome), file=options.output)
    if outcome.pictures:
        print(f"pictures: {', '.join(str(p) for p in outcome.pictures)}")
    _write_json(options.json, entry.as_json(outcome))
    return GOOD


def _demo(options: argparse.Namespace) -> int:
    _check_folder(options.out)
    from importlib.resources import files

    from farhorizon.case.case import Case

    text = files("farhorizon.case").joinpath("demo.toml").read_text(encoding="utf-8")
    case = Case(text, "two_notches.toml", _thread_change(options))
    print("An infinite membrane with two notches, seen through a disc of radius 26 (example 3 of Hermann et al. 2023).")
    print(
        "Running it with the lattice PML, with a fixed and a free edge, and on a domain from which nothing returns ..."
    )
    _compare_case(options, case, Path(options.out), None, 30.0)
    return GOOD


def _new(options: argparse.Namespace) -> int:
    from farhorizon.case.problems import nearest
    from farhorizon.case.templates import KINDS, brief, template
    from farhorizon.errors import InputError

    if options.kind is None:
        print("\n".join(f"{kind:12}{brief(kind)}" for kind in KINDS))
        return GOOD
    if options.kind not in KINDS:
        raise InputError("no such kind of case", value=options.kind, key="new", remedy=nearest(options.kind, KINDS))
    if options.out is None:
        print(template(options.kind), end="")
        return GOOD
    path = Path(options.out)
    try:
        with path.open("w" if options.force else "x", encoding="utf-8") as file:
            file.write(template(options.kind))
    except FileExistsError:
        raise InputError(f"{path} exists", key="--out", remedy="--force overwrites it") from None
    print(f"{path}: farhorizon check {path} tells what is to be expected, farhorizon run {path} computes it")
    return GOOD


def _keys(options: argparse.Namespace) -> int:
    from shutil import get_terminal_size

    from farhorizon.case.keys import explain_keys

    print(explain_keys(options.prefix, min(get_terminal_size().columns, 120)))
    return GOOD


def _schema(options: argparse.Namespace) -> int:
    from farhorizon.case.schema import schema

    print(json.dumps(schema(), indent=1))
    return GOOD


def _info(options: argparse.Namespace) -> int:
    from farhorizon.case.report import versions
    from farhorizon.engine.engine import available_threads
    from farhorizon.files.cache import cache_folder

    for name, value in (*versions(), ("threads", available_threads()), ("compiled programs", cache_folder())):
        print(f"{name:<18}{value}")
    return GOOD
