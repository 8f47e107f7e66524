"""The recorded waves of another run, as a wave incident on the box in whose shell they were recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError, shown
from farhorizon.files.records import Recorded
from farhorizon.files.results import open_results
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Box
from farhorizon.inputs.incidence import End, Incident, Passage, Region, check_within

_ALIKE = 1e-9  # of a step or a rate: smaller differences are ignored
_CLOSE = 1e-6  # of a spacing: places closer to each other than this coincide
_FADED = 1e-9  # of the largest value: a record that ends below this has come to rest
_PARTS = ("points", "times", "u", "medium")


@dataclass(frozen=True, eq=False)
class IncidentRecord(Incident):
    """The waves of another run that pass through a box, as the wave incident on scatterers in it: near field to near
    field, exact on the lattice.

    They are recorded by a `ShellRecorder` in the other run. The contents of the box there (nothing, or scatterers) may
    be changed in this run; outside the box the field is what the change scatters. Time steps, nodes, and the medium at
    the faces of the box must be the same in both runs.

    Parameters
    ----------
    record : str, Path, ShellRecorder, Recorded, or mapping
        Results file, recorder, or the contents of one of them: "points", "times", "u", and for the medium at the faces
        "medium", the coefficient divided by the squared spacing.
    name : str
        Name of the recorder in a results file.
    within : Box, optional
        The box of the record; no other is possible.

    Raises
    ------
    InputError
        A file without such a record. When the simulation is created: another step, other nodes, another medium; when it
        is run: a record that ends too early.

    Examples
    --------
    >>> import farhorizon as fh
    >>> shell = fh.ShellRecorder(fh.Box((-4.0, -4.0), (4.0, 4.0)))
    >>> model, absorb = fh.Wave(fh.Kernel(1.0)), fh.LatticePML(nodes=12)
    >>> blow = "exp(-(x + 10)**2 - y**2)*exp(-(t - 3)**2)"
    >>> far = fh.Lattice(0.5, (-16.0, -10.0), (8.0, 10.0))
    >>> first = fh.Simulation(far, model, absorb, sources=[blow], observe=[shell])
    >>> _ = first.run(16.0)
    >>> near, crack = fh.Lattice(0.5, (-7.0, -7.0), (7.0, 7.0)), [[(0.25, -1.0), (0.25, 1.0)]]
    >>> again = fh.Simulation(near, model, absorb, sources=[fh.IncidentRecord(shell)], cracks=crack, dt=first.dt)
    >>> bool(abs(again.run(16.0).fields["u"]).max() > 0.01)
    True
    """

    record: Path | Any
    name: str = "shell"
    within: Box | None = None

    undamped: ClassVar[bool] = False

    def __post_init__(self) -> None:
        kinds.text(self.name, "incident.name")
        check_within(self.within)
        kinds.set_fields(self, record=_checked_record(self.record, self.name))

    def resolved(self, lattice: Lattice, reach: Sequence[int], ends: Mapping[End, bool] | None = None) -> Self:
        """The same wave with its box, which lies one reach inside the outermost nodes of the record; see
        `Incident.resolved`.
        """
        record: Any = self.record
        points = record["points"]
        if points.shape[1] != lattice.dim:
            raise InputError(
                "an incident wave and the lattice differ in dimension",
                value=points.shape[1],
                limit=lattice.dim,
                key="incident",
                remedy="the record of a run on a lattice of as many dimensions",
            )
        more, close = lattice.spacing * np.array(reach), _CLOSE * lattice.spacing
        low, high = points.min(0) + more, points.max(0) - more
        for (axis, side), free in (ends or {}).items():
            edge = (lattice.lower if side < 0 else lattice.upper)[axis]
            bound, far = (low, points.min(0)) if side < 0 else (high, points.max(0))
            if free and abs(far[axis] - edge) < close:
                bound[axis] = edge
        box = Box(tuple(low.tolist()), tuple(high.tolist()))
        return super(IncidentRecord, replace(self, within=box)).resolved(lattice, reach, ends)

    def passage(self, region: Region) -> Passage:
        """The record on the nodes of the shell."""
        record: Any = self.record
        return _RecordedPassage(record, region)


def _checked_record(record: Any, name: str) -> dict[str, Any]:
    """Return the checked record of a file, a recorder or a mapping."""
    if isinstance(record, str | Path):
        known = open_results(record, verify=False).recorded
        record = known[kinds.one_of(name, "incident.name", known, f"{record} has no such record")]
    record = getattr(record, "recorded", record)
    if isinstance(record, Recorded):
        record = {"points": record.points, "times": record.times, "medium": record.medium, **record.data}
    if not isinstance(record, Mapping) or not set(_PARTS) <= set(record):
        raise InputError(
            "not the record of a shell",
            value=f"{', '.join(map(str, record))} alone" if isinstance(record, Mapping) else kinds.said(record),
            limit="a results file, a ShellRecorder that has run, or its points, times, u and medium",
            key="incident.record",
            remedy="observe=[ShellRecorder(box)] in the first run",
        )
    points = kinds.array(record["points"], "incident.record", shape=(None, None))
    times, u = (kinds.array(record[part], "incident.record") for part in ("times", "u"))
    if times.ndim != 1 or times.size < 2 or u.shape[:2] != (times.size, len(points)) or u.ndim > 3:
        raise InputError(
            "the record of a shell has two rows or more, one value a node in each",
            value=f"{shown(u.shape)} values for {shown(times.shape)} times and {shown(points.shape)} points",
            limit="as many rows as times, as many columns as points",
            key="incident.record",
            remedy="run the first run to its end",
        )
    medium = kinds.number(record["medium"], "incident.record", least=0)
    if not medium:
        raise InputError(
            "not the record of a shell",
            value=name,
            limit="a record with a medium",
            key="incident.name",
            remedy="a ShellRecorder's name",
        )
    return {"points": points, "times": times, "u": u, "medium": medium}


class _RecordedPassage(Passage):
    """A record on the nodes of the shell, which begins at rest."""

    rests, everywhere = True, False

    def __init__(self, record: Mapping[str, Any], region: Region) -> None:
        scheme, spacing, times = region.scheme, region.lattice.spacing, record["times"]
        self._last, self._dt = len(times) - 1, scheme.dt
        step = float(times[-1] - times[0]) / self._last
        if abs(times[0]) > _ALIKE * step or abs(step - scheme.dt) > _ALIKE * scheme.dt:
            raise InputError(
                "the record is of another time step",
                value=f"{step:.10g} from t = {times[0]:g} on",
                limit=f"{scheme.dt:.10g} from t = 0 on",
                key="incident.record",
                remedy=f"dt = {step!r}",
            )
        if abs(record["medium"] - scheme.rate) > _ALIKE * scheme.rate:
            raise InputError(
                "the record is of another medium",
                value=f"{record['medium']:.10g} (coefficient over squared spacing)",
                limit=f"{scheme.rate:.10g}",
                key="incident.record",
                remedy="the same model and spacing in both runs",
            )
        nodes, components = region.shell.nodes, scheme.stencil.components
        places = region.places(nodes)
        self._values = record["u"].reshape(len(times), len(record["points"]), -1)
        alike = places.shape == record["points"].shape and self._values.shape[2] == components
        if not alike or np.abs(places - record["points"]).max() > _CLOSE * spacing:
            raise InputError(
                "the record is of other nodes than the shell of the box has",
                value=f"{len(record['points'])} nodes, {self._values.shape[2]} components",
                limit=f"{len(nodes)} nodes, {components} components",
                key="incident.record",
                remedy="the same kernel, and lattices whose nodes coincide",
            )
        self._number = np.full(region.lattice.shape, -1)
        self._number[tuple(nodes.T)] = np.arange(len(nodes))
        largest = float(np.abs(self._values).max())
        self._faded = bool(np.abs(self._values[-1]).max() <= _FADED * largest)
        self.period = scheme.dt * (self._last + 0.5) if self._faded else np.inf

    def at(self, nodes: np.ndarray) -> Callable[[float], np.ndarray]:
        number = self._number[tuple(nodes.T)]

        def values(t: float) -> np.ndarray:
            step = round(t / self._dt)
            if step > self._last:
                self._refuse(t)
            return np.asarray(np.where(number < 0, np.nan, self._values[step][number].T))

        return values

    def foresee(self, until: float) -> list[str]:
        # the last step reads the wave one step before it
        if until > self._dt * (self._last + 1 + 1e-6) and not self._faded:
            self._refuse(until)
        return []

    def _refuse(self, t: float) -> None:
        raise InputError(
            "the recorded waves end before the run, and have not come to rest",
            value=f"t = {t:g}",
            limit=f"{self._dt * self._last:g}",
            key="incident.record",
            remedy="a longer first run, or a shorter one now",
        )
