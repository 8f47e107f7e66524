"""What a run writes into a results file: its fields now and then, its history, what recorders and probes have.

Several processes write a file in parts, each its own; the first one writes the file of the whole.
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
from farhorizon.errors import InputError
from farhorizon.files.parts import folder_of, part_path
from farhorizon.files.provenance import computed_with
from farhorizon.files.region_numbers import Regions
from farhorizon.files.results import open_results
from farhorizon.files.results_writer import ResultsWriter
from farhorizon.simulation.nodal_stress import fields_of
from farhorizon.simulation.outlines import outlines_of
from farhorizon.simulation.recorder import Recorder
from farhorizon.simulation.regions import regions_of
from farhorizon.simulation.team import Team

_FOLLOWS = ("v", "solid")  # from the others, and as large


class RunResults:
    """A run and the results file that it fills.

    Parameters
    ----------
    run : Run
    path : Path
    writer : ResultsWriter or None
        That of the file; of several processes the first one has it.
    part : ResultsWriter or None
        That of the part of one of several processes.

    Attributes
    ----------
    path, writer
        As given.
    own : ResultsWriter
        That of the fields of this process.
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
        """An empty file, in place of results that were there.

        Parameters
        ----------
        run : Run
        path : str or Path
        fields : sequence of str, optional
            All but velocities, and the metal that the times of dissolution tell, unless given; "stress" of elastic
            media stands for its components and von Mises' stress.
        dtype : {"float32", "float64"}, optional
            That of the run unless given.
        case, units, compress
            As of `ResultsWriter.create`.
        command : mapping of str to str, optional
            What is known of where the run comes from, beside versions and machine.
        materials : Regions, optional
            What materials are called.

        Raises
        ------
        InputError
            A field that there is not; another file is there, or no such folder.
        """
        team, lattice, path = run.team, run.lattice, kinds.path(path, "path")
        if fields is None:
            held = {name: values for name, values in run.fields.items() if name not in _FOLLOWS}
        else:
            wanted = kinds.sequence(fields, "fields", "names of fields")
            held = fields_of(run, [kinds.text(name, "fields") for name in wanted])
        shown = {"u": run.fields["u"], **held}  # probes show u, written or not
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
                provenance={**(command or {}), **dict(computed_with())},
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
        """A file that goes on after so many outputs; one whose parts are of other boxes is cut anew.

        Parameters
        ----------
        run : Run
        path : Path
        outputs : int
        *kept
            What else is kept, as of `ResultsWriter.resume`.
        """
        team, part = run.team, None
        _cut_anew(run, path, outputs)
        writer = team.by_first(lambda: ResultsWriter.resume(path, outputs, *kept))
        with team.agreed():
            if team:
                part = ResultsWriter.resume(part_path(path, team.number), outputs)
        return cls(run, path, writer, part)

    def _write(self, change: Callable[..., None], *given: Any) -> None:
        """Change the file of the whole, which one process does; what it fails with all fail with."""
        with self._run.team.agreed():
            if self.writer is not None:
                change(self.writer, *given)

    @property
    def growing(self) -> list[Recorder]:
        """Recorders that have something before the run has come to its end."""
        return [one for one in self._run.recorders if one.recorded.data or one.recorded.spectra]

    def append(self) -> None:
        """Append the fields as they are now; not twice the same step."""
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
        """Append what recorders and probes have recorded; they forget it."""
        for recorder in self.growing:
            self._write(ResultsWriter.append_recorded, recorder.recorded)
            recorder.forget()
        probes = self._run.probes
        if probes is not None and len(probes.nodes):
            self._write(ResultsWriter.append_probes, *probes.take())

    def copy_records(self) -> None:
        """Put what recorders and probes have, which keep it, in place of what the file has of them."""
        for recorder in self.growing:
            self._write(ResultsWriter.conclude, recorder.recorded)
        probes = self._run.probes
        if probes is not None and len(probes.nodes):
            held = 0 if self.writer is None else self.writer.records
            self._write(ResultsWriter.append_probes, probes.times[held:], probes.values[held:])

    def conclude(self) -> None:
        """Append what follows from all that was recorded, once the run has come to its end."""
        for recorder in self._run.recorders:
            for records in recorder.concluded():
                self._write(ResultsWriter.conclude, records)

    def finish(self) -> None:
        """Note that the run has come to its end."""
        self._write(ResultsWriter.finish)


@contextmanager
def written(run: Any, output: Any) -> Iterator[RunResults | None]:
    """Within it a run writes an output whenever it calls its observers, and one at the start; at the end, also where
    that is not a good one, what was recorded. A file that the run has begun itself goes on.

    Parameters
    ----------
    run : Run
    output : str or Path, or None
        The file; without one nothing is written.
    """
    if output is None:
        yield None
        return
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
        if run.team.knows(error):  # else the others do something else
            made.copy_records()
        raise
    finally:
        run.observers = observers
    made.copy_records()
    made.conclude()
    made.finish()


def _box_of(run: Any) -> list[tuple[int, int]]:
    """The nodes of this process along each axis: the first one and the last + 1."""
    return [(first, first + n) for first, n in zip(run.lattice.first, run.lattice.shape, strict=True)]


def _cut_anew(run: Any, path: Path, outputs: int) -> None:
    """Let the parts of a results file be those of the processes that go on with it."""
    team, own = run.team, _box_of(run)
    with team.agreed():
        held = open_results(path)
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


def _check_seen(team: Team, path: Path) -> None:
    """Refuse a folder that not all processes see: what the first one puts there no other folder of the name has."""
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
