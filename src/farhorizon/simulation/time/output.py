"""Output of a run to a results file: its fields at chosen times, its history, and the data of recorders and probes.

Several processes write a file in parts, each its own; the first one writes the file that joins them.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon import __version__, kinds
from farhorizon.analysis.layers.thickness import largest_error
from farhorizon.errors import InputError
from farhorizon.files.parts import folder_of, part_path
from farhorizon.files.provenance import computed_with
from farhorizon.files.results import open_results
from farhorizon.files.results_layout import Regions
from farhorizon.files.results_writer import ResultsWriter
from farhorizon.inputs.cracks import as_crack
from farhorizon.simulation.processes.process_group import ProcessGroup
from farhorizon.simulation.recorders.quantities import fields_of
from farhorizon.simulation.recorders.recorder import Recorder
from farhorizon.simulation.setup.regions import regions_of

_FOLLOWS = ("v", "solid")  # follow from other fields, and are as large


class RunResults:
    """A run and the results file that it writes, of which each process has a part (`own`) and the first one the whole
    (`writer`).
    """

    def __init__(self, run: Any, path: Path, writer: ResultsWriter | None, part: ResultsWriter | None = None) -> None:
        fields = writer if part is None else part
        assert fields is not None
        self._run, self.path, self.writer, self.own = run, path, writer, fields

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

        Its fields are, unless named, all but velocities and the metal, which follow from the others; "stress" in
        elastic media stands for its components and the von Mises stress. The type is that of the run unless given;
        `command` is provenance in addition to versions and machine, the rest as for `ResultsWriter.create`.
        """
        team, lattice, path = run.team, run.lattice, kinds.path(path, "path")
        team.alike({"path": path, "fields": fields})
        if fields is None:
            held = {name: values for name, values in run.fields.items() if name not in _FOLLOWS}
        else:
            names = kinds.sequence(fields, "fields", "names of fields")
            held = fields_of(run, [kinds.text(name, "fields") for name in names])
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
        """Continue a file after its first outputs, keeping what else `ResultsWriter.resume` is told; if its parts
        belong to other boxes, it is divided again.
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
        return [recorder for recorder in self._run.recorders if recorder.recorded.data or recorder.recorded.spectra]

    def append(self) -> None:
        """Append the present fields, unless this step has already been written."""
        run, writer = self._run, self.own
        if writer.last_step == run.step_count:
            return
        held, energy = fields_of(run, writer.fields), run.energy()
        if run.team:
            with run.team.agreed():
                writer.append(run.step_count, run.time, held)
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
    """Nodes of this process along each axis: the first one and the last + 1."""
    return [(first, first + n) for first, n in zip(run.lattice.first, run.lattice.shape, strict=True)]


def _cut_anew(run: Any, path: Path, outputs: int) -> None:
    """Divide the parts of a results file anew for the processes that continue it."""
    team, box = run.team, _box_of(run)
    with team.agreed():
        held = open_results(path, verify=False)
    boxes = team.gather(box) if team else []
    if held.boxes == boxes:
        return
    if not team:
        os.replace(held.merge(path.with_name(f".{path.name}.cut")), path)
        shutil.rmtree(folder_of(path))
        return
    folder = path.with_name(f".{path.name}.cut")
    team.by_first(lambda: folder.mkdir(exist_ok=True))
    with team.agreed():
        held.cut(folder / part_path(path, team.number).name, box, outputs)
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


def outlines_of(run: Any) -> dict[str, list[np.ndarray]]:
    """Polylines of a run by name, each of shape (n, dim), on several processes of the whole lattice: "cracks" as given
    (in space their rims, on a line points), the edges of the "near field", and those of everything that is computed,
    "layers", if that extends beyond it.
    """
    lattice = run.lattice.whole
    lower, upper = np.array(lattice.lower), np.array(lattice.upper)
    cuts = [as_crack(crack, lattice.dim).cut for crack in run.given["cracks"]]
    outlines = {"cracks": [line for cut in cuts if len(line := cut.outline())], "near field": edges(lower, upper)}
    if any(run.beyond.values()):
        ends = (lower.copy(), upper.copy())
        for (axis, side), nodes in run.beyond.items():
            ends[side > 0][axis] += side * nodes * lattice.spacing
        outlines["layers"] = edges(*ends)
    return {name: lines for name, lines in outlines.items() if lines}


def edges(lower: np.ndarray, upper: np.ndarray) -> list[np.ndarray]:
    """Edges of a box: its two ends on a line, a closed polyline in the plane, twelve edges in space."""
    dim = len(lower)
    if dim == 1:
        return [lower[None], upper[None]]
    if dim == 2:
        (x, y), (right, top) = lower, upper
        return [np.array([(x, y), (right, y), (right, top), (x, top), (x, y)])]
    lines = []
    for axis, corner in product(range(dim), product((0, 1), repeat=dim - 1)):
        start = np.where(np.insert(np.array(corner), axis, 0), upper, lower)
        lines.append(np.array([start, np.where(np.arange(dim) == axis, upper, start)]))
    return lines
