"""A run and its files: results that grow, checkpoints from which it resumes, signals that end it."""

from __future__ import annotations

import argparse
import shlex
import signal
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from farhorizon.cli.common import GOOD, INTERRUPTED

if TYPE_CHECKING:
    from farhorizon.simulation.time.output import RunResults

CHECKPOINT_SECONDS = 30.0  # what a kill costs at most; writing the largest states takes a few of them
_FREE = {"run", "output"}  # tables of a case that may change in an interrupted run
_WRITTEN: dict[str, Any] = {"probes": [], "fields": None, "dtype": None}  # keys of the output that may not: defaults


class RunFiles(NamedTuple):
    """Paths of the files of a run."""

    folder: Path
    name: str

    @property
    def result(self) -> Path:
        return self.folder / f"{self.name}.h5"

    @property
    def checkpoint(self) -> Path:
        return self.folder / f"{self.name}.ckpt"

    @property
    def lock(self) -> Path:
        return self.folder / f".{self.name}.lock"

    @property
    def pictures(self) -> Path:
        """Folder of the pictures."""
        return self.folder / self.name


def advance_run(
    options: argparse.Namespace, case: Any, sim: Any, files: RunFiles, until: float, last: int
) -> tuple[RunResults, int, int]:
    """Begin or resume the files of a run and advance it to its last step, or until a signal arrives; returns its
    results, the number of steps taken and the exit code.
    """
    with _stopping(sim) as signals:
        output = _resumed(case, sim, files) if options.resume else _begun(options, case, sim, files)
        for note in (*sim.notes, *sim.probes.notes):
            print(f"note: {note}", file=sys.stderr)
        nodes = round(sim.team.total({"nodes": sim.lattice.nodes})["nodes"])
        boxes = "" if sim.subdomain is None else f" on {sim.team.size} processes in {sim.subdomain.words} boxes"
        print(
            f"{case.name}: {nodes} nodes{boxes}, dt = {sim.dt:.6g}, {'at most ' * _to_static(options, case)}"
            f"{last} steps to t = {last * sim.dt:g}; "
            f"outputs {case.schedule(sim.dt)}"
        )
        record = _Record(output, sim, files.checkpoint)
        if options.resume:
            print(f"resumed at step {sim.step_count}, t = {sim.time:g}")
        else:
            record.append()
            record.keep()
        sim.observers.append(record.observe)
        before = sim.step_count
        code = _advance(options, case, sim, until, record, signals)
        return output, sim.step_count - before, code


def _advance(
    options: argparse.Namespace, case: Any, sim: Any, until: float, record: _Record, signals: list[int]
) -> int:
    """Run to the end and keep the state reached then, or when a signal arrived; returns the exit code."""
    from farhorizon.errors import FarhorizonError

    end, limits = (case.parts.run.until, case.to_rest) if _to_static(options, case) else (until, {})
    try:
        sim.run(end, case.every(sim.dt), allow_unstable=options.allow_unstable, **limits)
    except KeyboardInterrupt as stopped:
        if not sim.team.knows(stopped):
            raise
        if len(signals) == 1 or sim.team:  # ended between two steps
            record.keep()
        print(f"\ninterrupted at t = {sim.time:g}; continue with: {again(options)}", file=options.errors)
        return int(sim.team.largest(128 + signals[0] if signals else INTERRUPTED))
    except FarhorizonError:
        print(f"the last good checkpoint is {record.checkpoint}", file=options.errors)
        raise
    except OSError:
        onward = f"when files can be written again, continue with: {again(options)}"
        print(f"the last good checkpoint is {record.checkpoint}; {onward}", file=options.errors)
        raise
    record.keep()
    if _to_static(options, case):
        print(f"{case.name}: ended at t = {sim.time:g}")
    return GOOD


def _to_static(options: argparse.Namespace, case: Any) -> bool:
    """Whether the run ends at a static state rather than at a given time."""
    return options.until is None and isinstance(case.parts.run.until, str)


def _resumed(case: Any, sim: Any, files: RunFiles) -> RunResults:
    """The results of an interrupted run as they were at its checkpoint; the simulation is set to the checkpoint."""
    from farhorizon.simulation.time.output import RunResults

    with sim.team.agreed():
        _check_unchanged(case, files.result)
    counts = sim.load(files.checkpoint)
    sim.probes.take()  # drop the record of the start, which is in the file
    outputs, rows, records = (int(counts[name]) for name in ("outputs", "rows", "records"))
    return RunResults.resume(sim, files.result, outputs, rows, records, counts.get("recorded"))


def _check_unchanged(case: Any, path: Path) -> None:
    """Refuse to resume with a case that differs from the one in the results; the run's length and its output may
    change.
    """
    from farhorizon.errors import FileFormatError
    from farhorizon.files.results import open_results

    before, now = (tomllib.loads(text) for text in (open_results(path, verify=False).case, case.text))
    for case_data in (before, now):
        output = case_data.get("output", {})
        case_data |= {f"output.{name}": output.get(name, usual) for name, usual in _WRITTEN.items()}
    changed = sorted(name for name in {*before, *now} - _FREE if before.get(name) != now.get(name))
    if changed:
        raise FileFormatError(
            "the case has changed since this run began",
            value=str(path),
            limit=f"same {', '.join(changed)}",
            remedy="resume with the case that wrote it, or run the new one by itself: --out another name",
        )


def _begun(options: argparse.Namespace, case: Any, sim: Any, files: RunFiles) -> RunResults:
    """Empty results, replacing existing ones."""
    from farhorizon.files.results_writer import check_replaceable
    from farhorizon.simulation.time.checkpoint_files import remove_checkpoint
    from farhorizon.simulation.time.output import RunResults

    def make_room() -> None:
        check_replaceable(files.result)
        remove_checkpoint(files.checkpoint)  # it belongs to the results that are replaced

    sim.team.by_first(make_room)
    return RunResults.begin(
        sim,
        files.result,
        case.fields,
        dtype=case.parts.output.dtype,
        case=case.text,
        units=case.unit_names,
        command={"command": shlex.join(["farhorizon", *options.given])},
        compress=case.parts.output.compress,
        materials=case.materials,
    )


class _Record:
    """What a run writes on its way: outputs, and checkpoints at intervals."""

    def __init__(self, output: RunResults, sim: Any, checkpoint: Path) -> None:
        self._output, self._sim, self.checkpoint = output, sim, checkpoint
        self._kept = time.monotonic()

    def observe(self, _: Any) -> None:
        """Called after each output step."""
        self.append()
        if self._sim.team.first(time.monotonic() - self._kept > CHECKPOINT_SECONDS):
            self.keep()

    def append(self) -> None:
        """Append recorded values and the present fields."""
        self._output.move_records()
        self._output.append()

    def keep(self) -> None:
        """Write a checkpoint from which the run can be resumed."""
        self._output.move_records()
        writer = self._output.writer  # on several processes, only the first has one; it writes what is the same for all
        names = () if writer is None else ("outputs", "rows", "records", "recorded")
        counts = {name: getattr(writer, name) for name in names}
        self._sim.save(self.checkpoint, **counts)
        self._kept = time.monotonic()


@contextmanager
def _stopping(sim: Any) -> Iterator[list[int]]:
    """Let Ctrl-C and SIGTERM, which batch systems send, end a run between two steps; yields the signals received. A
    second one acts at once.
    """
    signals: list[int] = []

    def interrupt(number: int, frame: Any) -> None:
        signals.append(number)
        if len(signals) > 1:
            raise KeyboardInterrupt
        sim.stop_requested = True

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield signals
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def again(options: argparse.Namespace, until: bool = True) -> str:
    """The command that continues a run, with all options that it was given, except its end if not `until`."""
    launcher = ["mpiexec", "-n", str(options.team.size)] if options.team else []
    words = [*launcher, "farhorizon", "run", options.case, "--resume"]
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
        + ["--keep-checkpoint"] * options.keep_checkpoint
        + ["--no-report"] * options.no_report
        + ["--quiet"] * options.quiet
    )
