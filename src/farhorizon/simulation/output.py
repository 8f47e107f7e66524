"""What a run writes into a results file: its fields now and then, its history, what recorders and probes have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from farhorizon import __version__, kinds
from farhorizon.files.provenance import computed_with
from farhorizon.files.results import ResultsWriter
from farhorizon.simulation.outlines import outlines_of
from farhorizon.simulation.recorder import Recorder

_FOLLOWS = ("v", "solid")  # from the others, and as large


class RunResults:
    """A run and the results file that it fills.

    Parameters
    ----------
    run : Run
    writer : ResultsWriter

    Attributes
    ----------
    writer : ResultsWriter
    """

    def __init__(self, run: Any, writer: ResultsWriter) -> None:
        self._run, self.writer = run, writer

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
    ) -> RunResults:
        """An empty file, in place of results that were there.

        Parameters
        ----------
        run : Run
        path : str or Path
        fields : sequence of str, optional
            All but velocities, and the metal that the times of dissolution tell, unless given.
        dtype : {"float32", "float64"}, optional
            That of the run unless given.
        case, units, compress
            As of `ResultsWriter.create`.
        command : mapping of str to str, optional
            What is known of where the run comes from, beside versions and machine.

        Raises
        ------
        InputError
            A field that there is not; another file is there, or no such folder.
        """
        run.team.alone("results files")
        held, lattice = run.fields, run.lattice
        if fields is None:
            names = tuple(name for name in held if name not in _FOLLOWS)
        else:
            given = kinds.sequence(fields, "fields", "names of fields")
            names = tuple(kinds.one_of(name, "fields", held, "the run has no such field") for name in given)
        writer = ResultsWriter.create(
            kinds.path(path, "path"),
            shape=lattice.shape,
            spacing=lattice.spacing,
            lower=lattice.lower,
            fields=names,
            dtype=dtype or held["u"].dtype,
            probes=None if run.probes is None else run.probes.places,
            accounts=list(run.balance()) if run.given.get("balance") else [],
            case=case,
            units=units,
            provenance={**(command or {}), **dict(computed_with())},
            compress=compress,
            program=f"farhorizon {__version__}",
            outlines=outlines_of(run),
            components={name: len(values) if values.ndim > lattice.dim else 1 for name, values in held.items()},
        )
        made = cls(run, writer)
        for recorder in made.growing:
            writer.hold(recorder.recorded)
        return made

    @property
    def growing(self) -> list[Recorder]:
        """Recorders that have something before the run has come to its end."""
        return [one for one in self._run.recorders if one.recorded.data or one.recorded.spectra]

    def append(self) -> None:
        """Append the fields as they are now; not twice the same step."""
        run, writer = self._run, self.writer
        if writer.last_step == run.step_count:
            return
        fields = run.fields
        writer.append(
            run.step_count,
            run.time,
            {name: fields[name] for name in writer.fields},
            energy=run.energy(),
            balance=run.balance() if writer.accounts else None,
            cautions=run.cautions,
        )

    def move_records(self) -> None:
        """Append what recorders and probes have recorded; they forget it."""
        for recorder in self.growing:
            self.writer.append_recorded(recorder.recorded)
            recorder.forget()
        probes = self._run.probes
        if probes is not None and len(probes.nodes):
            self.writer.append_probes(*probes.take())

    def copy_records(self) -> None:
        """Put what recorders and probes have, which keep it, in place of what the file has of them."""
        for recorder in self.growing:
            self.writer.conclude(recorder.recorded)
        probes = self._run.probes
        if probes is not None and len(probes.nodes):
            self.writer.append_probes(probes.times[self.writer.records :], probes.values[self.writer.records :])

    def conclude(self) -> None:
        """Append what follows from all that was recorded, once the run has come to its end."""
        for recorder in self._run.recorders:
            for records in recorder.concluded():
                self.writer.conclude(records)

    def finish(self) -> None:
        """Note that the run has come to its end."""
        self.writer.finish()


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
    if made is not None and made.writer.path == path:
        made = RunResults(run, ResultsWriter.resume(path, made.writer.outputs))
    else:
        made = RunResults.begin(run, path)
    run.output = made
    made.append()
    observers = run.observers
    run.observers = [*observers, lambda _: made.append()]
    try:
        yield made
    finally:
        run.observers = observers
        made.copy_records()
    made.conclude()
    made.finish()
