"""Output of a run to a results file: its fields at chosen times, its history, and the data of recorders and probes.

Several processes write a file in parts, each its own; the first one writes the file that joins them.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from farhorizon import __version__, kinds
from farhorizon.analysis.layers.thickness import largest_error
from farhorizon.errors import InputError
from farhorizon.files.parts import folder_of, part_path
from farhorizon.files.provenance import computed_with
from farhorizon.files.region_numbers import Regions
from farhorizon.files.results import open_results
from farhorizon.files.results_writer import ResultsWriter
from farhorizon.simulation.processes.process_group import ProcessGroup
from farhorizon.simulation.recorders.quantities import fields_of
from farhorizon.simulation.recorders.recorder import Recorder
from farhorizon.simulation.setup.regions import regions_of
from farhorizon.simulation.time.outlines import outlines_of

_FOLLOWS = ("v", "solid")  # follow from other fields, and are as large


class RunResults:
    """A run and the results file that it writes.

    Parameters
    ----------
    run : Run
    path : Path
    writer : ResultsWriter or None
        Writer of the file; on several processes only the first one has it.
    part : ResultsWriter or None
        Writer of the part of this process, if there are several.

    Attributes
    ----------
    path, writer
        As given.
    own : ResultsWriter
        Writer of the fields of this process.
    """

    def __init__(self, run: Any, path: Path, writer: ResultsWriter | None, part: ResultsWriter | None = None) -> None:
        own = writer if part is None else part
        assert own is not None
        self._run, self.path, self.writer, self.own = run, path, writer, own

    @classmethod
    def begin(
        cls,
        run: Any,
        path: str | Path,
        fields: Sequence[str] | None = None,
        *,
        dtype: str | None = None,
        case: str = "",
        units: Mapping[str, str] | None = None,
        command: Mapping[str, str] | None = None,
        compress: bool = False,
        materials: Regions | None = None,
    ) -> RunResults:
        """Create an empty file, replacing earlier results.

        Parameters
        ----------
        run : Run
        path : str or Path
        fields : sequence of str, optional
            Names of fields; unless given, all but velocities and the metal, which follow from the other fields.
            "stress" in elastic media stands for its components and the von Mises stress.
        dtype : {"float32", "float64"}, optional
            That of the run, unless given.
        case, units, compress
            As for `ResultsWriter.create`.
        command : mapping of str to str, optional
            Provenance of the run, in addition to versions and machine.
        materials : Regions, optional
            Names of the materials.

        Raises
        ------
        InputError
            There is no such field or folder, or another file is in the way.
        """
        team, lattice, path = run.team, run.lattice, kinds.path(path, "path")
        team.alike({"path": path, "fields": fields})
        if fields is None:
            held = {name: values for name, values in run.fields.items() if name not in _FOLLOWS}
        else:
            wanted = kinds.sequence(fields, "fields", "names of fields")
            held = fields_of(run, [kinds.text(name, "fields") for name in wanted])
        shown = {"u": run.fields["u"], **held}  # probes record u, whether it is written or not
        alike: dict[str, Any] = {
            "spacing": lattice.spacing,
            "fields": tuple(held),
            "dtype": dtype or shown["u"].dtype,
            "compress": compress,
            "program": f"farhorizon {__version__}",
            "components": {name: len(values) if values.ndim > lattice.dim else 1 for name, values in shown.items()},
        }
        accounts = list(run.balance()) if run.given.get("balance") else []
        boxes, regions = team.gather(_box_of(run)), regions_of(run, materials)
        writer = team.by_first(
            lambda: ResultsWriter.create(
                path,
                shape=lattice.whole.shape,
                lower=lattice.whole.lower,
                probes=None if run.probes is None else run.probes.places,
                accounts=accounts,
                case=case,
                units=units,
                provenance={**(command or {}), **dict(computed_with()), **largest_error(run.thickness)},
                outlines=outlines_of(run),
                regions=regions,
                boxes=boxes if team else (),
                **alike,
            )
        )
        part = None
        if team:
            _check_seen(team, path)
        with team.agreed():
            if team:
                part = ResultsWriter.create(
                    part_path(path, team.number), shape=lattice.shape, lower=lattice.lower, **alike
                )
        made = cls(run, path, writer, part)
        for recorder in made.growing:
            made._write(ResultsWriter.hold, recorder.recorded)
        return made

    @classmethod
    def resume(cls, run: Any, path: Path, outputs: int, *kept: Any) -> RunResults:
        """Continue a file after its first `outputs` outputs; if its parts belong to other boxes, it is divided again.

        Parameters
        ----------
        run : Run
        path : Path
        outputs : int
        *kept
            What else to keep, as for `ResultsWriter.resume`.
        """
        team, part = run.team, None
        _cut_anew(run, path, outputs)
        writer = team.by_first(lambda: ResultsWriter.resume(path, outputs, *kept))
        with team.agreed():
            if team:
                part = ResultsWriter.resume(part_path(path, team.number), outputs)
        return cls(run, path, writer, part)

    def _write(self, change: Callable[..., None], *given: Any) -> None:
        """Change the file of the whole run, on the first process; all processes fail if it does."""
        with self._run.team.agreed():
            if self.writer is not None:
                change(self.writer, *given)

    @property
    def growing(self) -> list[Recorder]:
        """Recorders that have data before the run has ended."""
        return [one for one in self._run.recorders if one.recorded.data or one.recorded.spectra]

    def append(self) -> None:
        """Append the present fields, unless this step has already been written."""
        run, own = self._run, self.own
        if own.last_step == run.step_count:
            return
        held, energy = fields_of(run, own.fields), run.energy()
        if run.team:
            with run.team.agreed():
                own.append(run.step_count, run.time, held)
            held = {}
        balance = run.balance() if run.given.get("balance") else None
        self._write(ResultsWriter.append, run.step_count, run.time, held, energy, balance, run.cautions)

    def move_records(self) -> None:
        """Append what recorders and probes have recorded, and discard it there."""
        for recorder in self.growing:
            self._write(ResultsWriter.append_recorded, recorder.recorded)
            recorder.forget()
        probes = self._run.probes
        if probes is not None and len(probes.nodes):
            self._write(ResultsWriter.append_probes, *probes.take())

    def copy_records(self) -> None:
        """Write what recorders and probes have recorded, replacing what the file has of it, and keep it there."""
        for recorder in self.growing:
            self._write(ResultsWriter.conclude, recorder.recorded)
        probes = self._run.probes
        if probes is not None and len(probes.nodes):
            held = 0 if self.writer is None else self.writer.records
            self._write(ResultsWriter.append_probes, probes.times[held:], probes.values[held:])

    def conclude(self) -> None:
        """Append what follows from all recorded data, once the run has ended."""
        for recorder in self._run.recorders:
            for records in recorder.concluded():
                self._write(ResultsWriter.conclude, records)

    def finish(self) -> None:
        """Mark the run as finished."""
        self._write(ResultsWriter.finish)


@contextmanager
def written(run: Any, output: str | Path) -> Iterator[RunResults]:
    """Write outputs to a file within the context: at the start, whenever the run calls its observers, and at the end,
    even after an error, what was recorded. A file that this run itself has begun is continued.
    """
    path = kinds.path(output, "run.output")
    made = run.output
    if made is not None and made.path == path:
        made = RunResults.resume(run, path, made.own.outputs)
    else:
        made = RunResults.begin(run, path)
    run.output = made
    made.append()
    observers = run.observers
    run.observers = [*observers, lambda _: made.append()]
    try:
        yield made
    except BaseException as error:
        if run.team.knows(error):  # otherwise the processes would no longer act together
            made.copy_records()
        raise
    finally:
        run.observers = observers
    made.copy_records()
    made.conclude()
    made.finish()


def _box_of(run: Any) -> list[tuple[int, int]]:
    """Return the nodes of this process along each axis: the first one and the last + 1."""
    return [(first, first + n) for first, n in zip(run.lattice.first, run.lattice.shape, strict=True)]


def _cut_anew(run: Any, path: Path, outputs: int) -> None:
    """Divide the parts of a results file anew for the processes that continue it."""
    team, own = run.team, _box_of(run)
    with team.agreed():
        held = open_results(path, verify=False)
    boxes = team.gather(own) if team else []
    if held.boxes == boxes:
        return
    if not team:
        os.replace(held.merge(path.with_name(f".{path.name}.cut")), path)
        shutil.rmtree(folder_of(path))
        return
    folder = path.with_name(f".{path.name}.cut")
    team.by_first(lambda: folder.mkdir(exist_ok=True))
    with team.agreed():
        held.cut(folder / part_path(path, team.number).name, own, outputs)
    team.by_first(lambda: held.take_parts(boxes, folder))


def _check_seen(team: ProcessGroup, path: Path) -> None:
    """Refuse a folder that not all processes see: the first one creates a file there whose name no other folder has."""
    mark = folder_of(path) / team.first(f".{secrets.token_hex(8)}.seen")
    team.by_first(mark.touch)
    try:
        with team.agreed():
            if not mark.exists():
                raise InputError(
                    "the folder of the results is not the same on all processes",
                    value=path,
                    key="run.output",
                    remedy="a folder of a file system that all machines share",
                )
    finally:
        if team.number == 0:
            mark.unlink()
