"""Pictures of the histories in a results file: probes, receivers, spectra, energy and balance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farhorizon.pictures.curves import Curve, Frame, lines
from farhorizon.pictures.style import number_text, with_unit
from farhorizon.pictures.traces import polar_picture, spectrum_picture, trace_picture
from farhorizon.pictures.words import axis_label, in_words

if TYPE_CHECKING:
    from farhorizon.files.records import Recorded
    from farhorizon.files.results import Results

_MOMENT = 0.05  # of the duration of a record: what was seen for no longer is not drawn
_FALL = 100.0  # fall of an energy from which on its axis is logarithmic
_DECADES = 6  # of that axis: less than a millionth of the largest energy is irrelevant
_MEASURED = {"position": "length", "advance": "length", "displacement": "u"}  # quantities with the unit of another one
_ACCOUNTS = {side: f"through {side}".replace("-", "\N{MINUS SIGN}") for side in ("x-", "x+", "y-", "y+", "z-", "z+")}
_LEVELS = {"intensity": "energy per frequency and angle", "cross_section": "scattering cross section per angle"}


def history_pictures(results: Results, directory: Path, ending: str, words: Mapping[str, str]) -> list[Path]:
    """Draw everything that was recorded over time into files with an ending; `words` are names of quantities in the
    case.
    """
    histories = _Histories(results, directory, ending, words)
    written = histories.probes()
    for record in results.recorded.values():
        written += histories.records(record)
    return [*written, *histories.energies()]


@dataclass(frozen=True)
class _Histories:
    """What the pictures of the histories of a results file have in common."""

    results: Results
    directory: Path
    ending: str
    words: Mapping[str, str]

    def path(self, name: str) -> Path:
        return self.directory / f"{name}.{self.ending}"

    def over_time(self, name: str, curves: list[Curve], ylabel: str, title: str = "") -> Path:
        """Draw curves over time."""
        lines(curves, self.path(name), Frame(with_unit("t", "time"), ylabel, title))
        return self.path(name)

    def probes(self) -> list[Path]:
        """Draw the field at the probes."""
        times, values = self.results.probe_times, self.results.probe_values
        if not times.size:
            return []
        names = [
            ", ".join(f"{axis} = {number_text(x, self.results.spacing)}" for axis, x in zip("xyz", point, strict=False))
            for point in self.results.probes
        ]
        if values.ndim > 2:
            names = [f"{in_words(f'u_{axis}')} at {name}" for name in names for axis in "xyz"[: values.shape[2]]]
            values = values.reshape(len(values), -1)
        title = f"probe at {names[0]}" if len(names) == 1 else ""
        curves = [(name, *_recorded(times, column)) for name, column in zip(names, values.T, strict=True)]
        return [self.over_time("probes", curves, axis_label("u", "u", self.words), title)]

    def records(self, record: Recorded) -> list[Path]:
        """Draw the records of one recorder, with a picture for each component of each quantity."""
        written = []
        for quantity in record.data if len(record.times) > 1 and not record.medium else ():
            measured = _MEASURED.get(quantity, quantity)
            for column, values in _distinct(record.columns(quantity)).items():
                name, label = f"{record.name}_{column}", axis_label(column, measured, self.words)
                curves, title = _long_enough(record, values)
                if not record.labels:
                    path = self.path(name)
                    trace_picture(record.points, record.times, values, path, label=label, measured=measured)
                    written.append(path)
                elif curves:
                    written.append(self.over_time(name, curves, label, title))
        if len(record.times) > 1 and {"force", "displacement"} <= record.data.keys():
            written += self._forces(record)
        if record.directions:
            return [*written, *self._pattern(record)]
        for quantity in record.spectra:
            for column, sums in _distinct(record.columns(quantity)).items():
                named: dict[str, Any] = {"label": in_words(column, self.words), "measured": quantity}
                written.append(self.path(f"{record.name}_{column}"))
                spectrum_picture(record.points, record.frequencies, sums, written[-1], **named, labels=record.labels)
        return written

    def _forces(self, record: Recorded) -> list[Path]:
        """Draw forces over displacements, with a picture for each component in which something moves."""
        written = []
        pairs = zip(record.columns("force").items(), record.columns("displacement").items(), strict=True)
        for (force, forces), (displacement, displacements) in pairs:
            columns = zip(record.labels, displacements.T, forces.T, strict=True)
            curves = [(label, x, y) for label, x, y in columns if np.ptp(x) and np.any(y)]
            if curves:
                xlabel, ylabel = axis_label(displacement, "u", self.words), axis_label(force, "force", self.words)
                written.append(self.path(f"{record.name}_{force}_{displacement}"))
                lines(curves, written[-1], Frame(xlabel, ylabel, curves[0][0] if len(curves) == 1 else ""))
        return written

    def _pattern(self, record: Recorded) -> list[Path]:
        """Draw the levels of a pattern over its directions; nothing in 1D, where there are only two."""
        if record.dim == 1:
            return []
        levels = {name: values for name, values in record.spectra.items() if name.startswith(tuple(_LEVELS))}
        kind = next(kind for kind in _LEVELS if next(iter(levels)).startswith(kind))
        waves = {name.removeprefix(f"{kind}_"): values for name, values in levels.items()}
        measured = ("energy", "time") if kind == "intensity" else ("length",) * (record.dim - 1)
        path, label = self.path(record.name), with_unit(_LEVELS[kind], *measured)
        polar_picture(record.points, record.frequencies, waves, path, label)
        return [path]

    def energies(self) -> list[Path]:
        """Draw the energy and the balance over time."""
        written = []
        times, energy = self.results.history_times, self.results.energy
        if np.isfinite(energy).any():
            moments, energies = _recorded(times, energy)
            log, top = _falls_far(energies), 1.05 * float(energies.max())
            limits = (0.0, top) if not log and energies.min() >= 0 < top else None  # so that small changes look small
            written.append(self.path("energy"))
            label = axis_label("energy", "energy", self.words)
            frame = Frame(with_unit("t", "time"), label, log=log, limits=limits, decades=_DECADES)
            lines([("energy", moments, energies)], written[-1], frame)
        if balance := self.results.balance:
            curves = [(_ACCOUNTS.get(name, name), *_recorded(times, account)) for name, account in balance.items()]
            waves = "kinetic" in balance
            label = with_unit("energy", "energy") if waves else "gain since the start, and inflow"
            written.append(self.over_time("balance", curves, label))
        return written


def _long_enough(record: Recorded, values: np.ndarray) -> tuple[list[Curve], str]:
    """Curves of what was seen for more than a moment, such as crack tips, and a title: the name of a single curve, and
    the number of those left out.
    """
    first = next(iter(record.data.values())).reshape(len(record.times), len(record.points), -1)
    seen = np.isfinite(first).all(2).mean(0)  # fraction of the time
    curves = [
        (label, record.times, column)
        for label, column, fraction in zip(record.labels, values.T, seen, strict=False)
        if fraction > _MOMENT and np.isfinite(column).any()
    ]
    brief = int(((seen > 0) & (seen <= _MOMENT)).sum())
    alone = curves[0][0] if len(curves) == 1 else ""  # a single curve has no legend
    return curves, ", ".join(filter(None, (alone, f"without {brief} seen for a moment" if brief else "")))


def _falls_far(energies: np.ndarray) -> bool:
    """Whether energies require a logarithmic axis: only those after the largest one count, since before it they may
    rise from zero.
    """
    after = energies[int(energies.argmax()) :]
    return bool(after.min() > 0 and after[0] > _FALL * after.min())


def _distinct(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The components of a quantity without those below the diagonal of a symmetric tensor, such as "stress_yx"."""
    distinct: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        quantity, _, letters = name.rpartition("_")
        above = distinct.get(f"{quantity}_{letters[::-1]}") if len(letters) == 2 else None
        if above is None or not np.array_equal(above, values):
            distinct[name] = values
    return distinct


def _recorded(times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of a history at which a value was recorded."""
    recorded = np.isfinite(values)
    return times[recorded], values[recorded]
