"""What a results file has over time: probes, receivers, spectra, the energy and the balance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from farhorizon.pictures.curves import lines
from farhorizon.pictures.polar import polar_picture
from farhorizon.pictures.style import number_text, with_unit
from farhorizon.pictures.traces import spectrum_picture, trace_picture

if TYPE_CHECKING:
    from farhorizon.files.records import Recorded
    from farhorizon.files.results import Results

_LEVELS = {"intensity": "energy per frequency and angle", "cross_section": "scattering cross section per angle"}


def history_pictures(results: Results, directory: Path, ending: str) -> list[Path]:
    """Draw what was recorded over time: probes, energy, balance."""
    written = []
    moments, values = results.probe_times, results.probe_values
    if moments.size:
        names = [
            ", ".join(f"{axis} = {number_text(x, results.spacing)}" for axis, x in zip("xyz", place, strict=False))
            for place in results.probes
        ]
        if values.ndim > 2:
            names = [f"u_{axis} at {name}" for name in names for axis in "xyz"[: values.shape[2]]]
            values = values.reshape(len(values), -1)
        written.append(directory / f"probes.{ending}")
        title = f"probe at {names[0]}" if len(names) == 1 else ""
        curves = [(name, *_recorded(moments, column)) for name, column in zip(names, values.T, strict=True)]
        ylabel = with_unit("probe value", "u")
        lines(curves, written[-1], xlabel=with_unit("t", "time"), ylabel=ylabel, title=title)
    for name, one in results.recorded.items():
        for quantity in one.data if len(one.times) > 1 and not one.medium else ():
            for column, traces in _distinct(one.columns(quantity)).items():
                written.append(directory / f"{name}_{column}.{ending}")
                trace_picture(one.points, one.times, traces, written[-1], label=with_unit(column, quantity))
        if one.directions:
            written += _pattern(one, directory / f"{name}.{ending}")
            continue
        for quantity in one.spectra:
            for column, sums in _distinct(one.columns(quantity)).items():
                written.append(directory / f"{name}_{column}.{ending}")
                spectrum_picture(one.points, one.frequencies, sums, written[-1], label=column)
    history, energy = results.history_times, results.energy
    if np.isfinite(energy).any():
        moments, energies = _recorded(history, energy)
        log = bool((energies > 0).all() and energies.max() > 100 * energies.min())
        written.append(directory / f"energy.{ending}")
        lines([("energy", moments, energies)], written[-1], xlabel=with_unit("t", "time"), ylabel="energy", log=log)
    if results.balance:
        written.append(directory / f"balance.{ending}")
        curves = [(name, *_recorded(history, values)) for name, values in results.balance.items()]
        ylabel = "energy" if "kinetic" in results.balance else "gain since the start, and inflow"
        lines(curves, written[-1], xlabel=with_unit("t", "time"), ylabel=ylabel)
    return written


def _distinct(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The components of a quantity without those below the diagonal of a tensor that is symmetric: "stress_yx"."""
    found: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        quantity, _, letters = name.rpartition("_")
        above = found.get(f"{quantity}_{letters[::-1]}") if len(letters) == 2 else None
        if above is None or not np.array_equal(above, values):
            found[name] = values
    return found


def _pattern(records: Recorded, path: Path) -> list[Path]:
    """Draw the levels of a pattern over its directions; on a line there are but two."""
    if records.dim == 1:
        return []
    levels = {name: values for name, values in records.spectra.items() if name.startswith(tuple(_LEVELS))}
    what = next(what for what in _LEVELS if next(iter(levels)).startswith(what))
    waves = {name.removeprefix(f"{what}_"): values for name, values in levels.items()}
    polar_picture(records.points, records.frequencies, waves, path, _LEVELS[what])
    return [path]


def _recorded(times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of a history in which a value was recorded."""
    kept = np.isfinite(values)
    return times[kept], values[kept]
