"""Pictures of the histories in a results file: probes, receivers, spectra, energy and balance."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farhorizon.pictures.curves import lines
from farhorizon.pictures.polar import polar_picture
from farhorizon.pictures.style import number_text, with_unit
from farhorizon.pictures.traces import spectrum_picture, trace_picture
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
    """Draw everything that was recorded over time: probes, receivers, energy and balance.

    Parameters
    ----------
    results : Results
    directory : Path
    ending : str
        Format, the ending of the file names.
    words : mapping of str to str
        Names of quantities in the case.

    Returns
    -------
    list of Path
    """
    written = _probes(results, directory / f"probes.{ending}", words)
    for one in results.recorded.values():
        written += _records(one, directory, ending, words)
    return [*written, *_energies(results, directory, ending, words)]


def _probes(results: Results, path: Path, words: Mapping[str, str]) -> list[Path]:
    """Draw the field at the probes over time."""
    moments, values = results.probe_times, results.probe_values
    if not moments.size:
        return []
    names = [
        ", ".join(f"{axis} = {number_text(x, results.spacing)}" for axis, x in zip("xyz", place, strict=False))
        for place in results.probes
    ]
    if values.ndim > 2:
        names = [f"{in_words(f'u_{axis}')} at {name}" for name in names for axis in "xyz"[: values.shape[2]]]
        values = values.reshape(len(values), -1)
    title = f"probe at {names[0]}" if len(names) == 1 else ""
    curves = [(name, *_recorded(moments, column)) for name, column in zip(names, values.T, strict=True)]
    lines(curves, path, xlabel=with_unit("t", "time"), ylabel=axis_label("u", "u", words), title=title)
    return [path]


def _records(one: Recorded, directory: Path, ending: str, words: Mapping[str, str]) -> list[Path]:
    """Draw the records of one recorder, with a picture for each component of each quantity."""
    written = []
    for quantity in one.data if len(one.times) > 1 and not one.medium else ():
        measured = _MEASURED.get(quantity, quantity)
        for column, values in _distinct(one.columns(quantity)).items():
            path, label = directory / f"{one.name}_{column}.{ending}", axis_label(column, measured, words)
            curves, title = _followed(one, values)
            if not one.labels:
                trace_picture(one.points, one.times, values, path, label=label, measured=measured)
            elif curves:
                lines(curves, path, xlabel=with_unit("t", "time"), ylabel=label, title=title)
            written += [path] if curves or not one.labels else []
    if len(one.times) > 1 and {"force", "displacement"} <= one.data.keys():
        written += _force_displacement(one, directory, ending, words)
    if one.directions:
        return [*written, *_pattern(one, directory / f"{one.name}.{ending}")]
    for quantity in one.spectra:
        for column, sums in _distinct(one.columns(quantity)).items():
            written.append(directory / f"{one.name}_{column}.{ending}")
            spectrum_picture(
                one.points,
                one.frequencies,
                sums,
                written[-1],
                label=in_words(column, words),
                measured=quantity,
                labels=one.labels,
            )
    return written


def _force_displacement(one: Recorded, directory: Path, ending: str, words: Mapping[str, str]) -> list[Path]:
    """Draw forces over displacements, with a picture for each component in which something moves."""
    written = []
    pairs = zip(one.columns("force").items(), one.columns("displacement").items(), strict=True)
    for (force, forces), (way, ways) in pairs:
        curves = [
            (label, x, y) for label, x, y in zip(one.labels, ways.T, forces.T, strict=True) if np.ptp(x) and np.any(y)
        ]
        if not curves:
            continue
        written.append(directory / f"{one.name}_{force}_{way}.{ending}")
        labels = axis_label(way, "u", words), axis_label(force, "force", words)
        title = curves[0][0] if len(curves) == 1 else ""
        lines(curves, written[-1], xlabel=labels[0], ylabel=labels[1], title=title)
    return written


def _followed(one: Recorded, values: np.ndarray) -> tuple[list[tuple[str, np.ndarray, np.ndarray]], str]:
    """Curves of what was seen for more than a moment, such as crack tips, and a title: the name of a single curve, and
    the number of those left out.
    """
    first = next(iter(one.data.values())).reshape(len(one.times), len(one.points), -1)
    seen = np.isfinite(first).all(2).mean(0)
    curves = [
        (label, one.times, column)
        for label, column, share in zip(one.labels, values.T, seen, strict=False)
        if share > _MOMENT and np.isfinite(column).any()
    ]
    brief = int(((seen > 0) & (seen <= _MOMENT)).sum())
    alone = curves[0][0] if len(curves) == 1 else ""  # a single curve has no legend
    return curves, ", ".join(filter(None, (alone, f"without {brief} seen for a moment" if brief else "")))


def _energies(results: Results, directory: Path, ending: str, words: Mapping[str, str]) -> list[Path]:
    """Draw the energy and the balance over time."""
    written, time = [], with_unit("t", "time")
    history, energy = results.history_times, results.energy
    if np.isfinite(energy).any():
        moments, energies = _recorded(history, energy)
        log = _falls_far(energies)
        written.append(directory / f"energy.{ending}")
        label, top = axis_label("energy", "energy", words), 1.05 * float(energies.max())
        limits = (0.0, top) if not log and energies.min() >= 0 < top else None  # so that small changes look small
        scale: dict[str, Any] = {"log": log, "limits": limits, "decades": _DECADES}
        lines([("energy", moments, energies)], written[-1], xlabel=time, ylabel=label, **scale)
    if results.balance:
        written.append(directory / f"balance.{ending}")
        curves = [(_ACCOUNTS.get(name, name), *_recorded(history, one)) for name, one in results.balance.items()]
        waves = "kinetic" in results.balance
        label = with_unit("energy", "energy") if waves else "gain since the start, and inflow"
        lines(curves, written[-1], xlabel=time, ylabel=label)
    return written


def _falls_far(energies: np.ndarray) -> bool:
    """Whether energies require a logarithmic axis: only those after the largest one count, since before it they may
    rise from zero.
    """
    after = energies[int(energies.argmax()) :]
    return bool(after.min() > 0 and after[0] > _FALL * after.min())


def _distinct(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The components of a quantity without those below the diagonal of a symmetric tensor, such as "stress_yx"."""
    found: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        quantity, _, letters = name.rpartition("_")
        above = found.get(f"{quantity}_{letters[::-1]}") if len(letters) == 2 else None
        if above is None or not np.array_equal(above, values):
            found[name] = values
    return found


def _pattern(records: Recorded, path: Path) -> list[Path]:
    """Draw the levels of a pattern over its directions; nothing in 1D, where there are only two."""
    if records.dim == 1:
        return []
    levels = {name: values for name, values in records.spectra.items() if name.startswith(tuple(_LEVELS))}
    what = next(what for what in _LEVELS if next(iter(levels)).startswith(what))
    waves = {name.removeprefix(f"{what}_"): values for name, values in levels.items()}
    measured = ("energy", "time") if what == "intensity" else ("length",) * (records.dim - 1)
    polar_picture(records.points, records.frequencies, waves, path, with_unit(_LEVELS[what], *measured))
    return [path]


def _recorded(times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of a history at which a value was recorded."""
    kept = np.isfinite(values)
    return times[kept], values[kept]
