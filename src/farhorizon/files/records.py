"""Data that recorders have recorded, independent of the run: as arrays, as tables, and in other programs' formats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.files.hdf5 import directory_of

if TYPE_CHECKING:
    import obspy

_AXES = "xyz"
_UNEVEN = 1e-6  # largest deviation of equidistant times relative to a step; rounding of late times is less


@dataclass(frozen=True, eq=False)
class Recorded:
    """The records of one recorder of a run.

    Attributes
    ----------
    name : str
    points : ndarray, shape (n, dim)
        Positions at which data were recorded.
    times : ndarray, shape (rows,)
    data : dict of str to ndarray
        Values over time by quantity, of shape (rows, n, ...).
    frequencies : ndarray, shape (F,)
        Frequencies of the spectra, in cycles per unit of time.
    spectra : dict of str to ndarray
        Spectra by quantity, of shape (F, n, ...): complex sums, or energies, intensities and cross sections, which are
        real.
    directions : bool
        Whether the points are unit vectors, the directions of a pattern.
    medium : float
        For the shell of a box, recorded for another run: coefficient divided by squared spacing there; otherwise 0.
    labels : tuple of str
        What the points represent if they are not positions at which values are read: "tip 1", "plane x = 2.5".

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> line = fh.Receivers([-2.0, 2.0])
    >>> lattice = fh.Lattice(1.0, -9, 9)
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), initial={"u": "exp(-x**2)"}, observe=[line])
    >>> sim.step(4)
    >>> line.recorded.to_csv("line.csv")
    >>> np.loadtxt("line.csv", delimiter=",", skiprows=3).shape  # times, and two receivers
    (5, 3)
    """

    name: str
    points: np.ndarray
    times: np.ndarray
    data: dict[str, np.ndarray]
    frequencies: np.ndarray = field(default_factory=lambda: np.zeros(0))
    spectra: dict[str, np.ndarray] = field(default_factory=dict)
    directions: bool = False
    medium: float = 0.0
    labels: tuple[str, ...] = ()

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return int(self.points.shape[1])

    def columns(self, quantity: str) -> dict[str, np.ndarray]:
        """The components of a quantity by name ("u_x", "stress_xy"), each of shape (rows, n), or (F, n) for spectra.

        Raises
        ------
        InputError
            It was not recorded.
        """
        known = {**self.data, **self.spectra}
        values = known[kinds.one_of(quantity, "quantity", known, f"{self.name} have no such quantity")]
        return {
            "_".join([quantity, *["".join(_AXES[i] for i in place)][: len(place)]]): values[:, :, *place]
            for place in np.ndindex(values.shape[2:])
        }

    def to_npz(self, path: str | Path) -> None:
        """Write all arrays to one NPZ file: points, times, each quantity; for spectra also the frequencies."""
        arrays: dict[str, Any] = {"points": self.points, "times": self.times, **self.data}
        if self.spectra:
            arrays |= {"frequencies": self.frequencies, **self.spectra}
        with _writable(path).open("wb") as file:
            np.savez(file, **arrays)

    def to_csv(self, path: str | Path, quantity: str | Sequence[str] | None = None) -> None:
        """Write quantities as a table: two header lines with their names, a line of column titles with the positions of
        the receivers, then one row per time, which starts with the time.

        Parameters
        ----------
        path : str or Path
        quantity : str or sequence of str, optional
            The first one if not given.

        Raises
        ------
        InputError
            The quantity was not recorded, or there is no such folder.
        """
        chosen = [quantity] if quantity is None or isinstance(quantity, str) else list(quantity)
        columns = {name: rows for given in chosen for name, rows in self.columns(self._chosen(given)).items()}
        places = [" ".join(f"{x:.10g}" for x in point) for point in self.points]
        titles = ["t", *(f"{name} at {place}" for name in columns for place in places)]
        table = np.column_stack([self.times, *columns.values()])
        head = f"# {self.name}: {', '.join(columns)}\n# one column a receiver, at {' '.join(_AXES[: self.dim])}\n"
        with _writable(path).open("w", encoding="utf-8") as file:
            file.write(head + ",".join(titles) + "\n")
            np.savetxt(file, table, delimiter=",", fmt="%.17g")

    def to_obspy(self, quantity: str | None = None, start: Any = 0.0) -> obspy.Stream:
        """A quantity as traces of ObsPy, which writes SAC, miniSEED, SEG-Y and more.

        Parameters
        ----------
        quantity : str, optional
            The first one if not given.
        start : UTCDateTime or float
            The date of time 0, in any form that `obspy.UTCDateTime` accepts.

        Returns
        -------
        obspy.Stream
            One trace per receiver and component. Stations are R00000, R00001, ...; channels are the last letters of the
            components in capitals, or Z for a scalar. ``trace.stats.coordinates`` has the position.

        Raises
        ------
        InputError
            ObsPy is not installed; the quantity was not recorded; there are fewer than two rows, or the times are not
            equidistant.

        Notes
        -----
        The formats have limits of their own: times are in seconds, and SEG-Y counts them in whole microseconds and
        stores single precision (``trace.data = trace.data.astype("float32")``). If the run has another unit of time,
        scale ``trace.stats.delta``.
        """
        try:
            import obspy
        except ImportError as error:
            raise InputError(
                "ObsPy is not installed",
                value="no obspy",
                limit="obspy",
                key="to_obspy",
                remedy="pip install 'farhorizon[obspy]'",
            ) from error
        chosen, delta, traces = self._chosen(quantity), self._interval(), []
        for name, values in self.columns(chosen).items():
            letters = name.removeprefix(chosen).lstrip("_").upper() or "Z"
            for number, column in enumerate(values.T):
                stats = {
                    "delta": delta,
                    "starttime": obspy.UTCDateTime(start) + float(self.times[0]),
                    "station": f"R{number:05d}",
                    "channel": letters,
                    "coordinates": dict(zip(_AXES, self.points[number].tolist(), strict=False)),
                }
                traces.append(obspy.Trace(np.ascontiguousarray(column), stats))
        return obspy.Stream(traces)

    def _chosen(self, quantity: str | None) -> str:
        if not self.data:
            raise InputError(
                "nothing was recorded in time",
                value=self.name,
                limit="a record with times",
                key="quantity",
                remedy="Receivers record in time",
            )
        return (
            next(iter(self.data))
            if quantity is None
            else kinds.one_of(quantity, "quantity", self.data, f"{self.name} have no such quantity")
        )

    def _interval(self) -> float:
        """Time between two rows."""
        if len(self.times) < 2:
            raise InputError(
                "a trace has two rows or more",
                value=len(self.times),
                limit="at least 2",
                key=self.name,
                remedy="a longer run",
            )
        apart = np.diff(self.times)
        if np.ptp(apart) > _UNEVEN * apart.mean():
            raise InputError(
                "the times are not even",
                value=apart.min(),
                limit=apart.max(),
                key=self.name,
                remedy="CSV and NumPy keep times as they are",
            )
        return float(apart.mean())


def _writable(path: str | Path) -> Path:
    path = kinds.path(path, "path")
    directory_of(path)
    return path


def variables_of(records: Mapping[str, Recorded]) -> tuple[dict[str, Any], dict[str, Any], dict[str, tuple[str, ...]]]:
    """Variables and coordinates of an xarray Dataset, where the names of those of recorder NAME begin with NAME, and of
    each the quantities whose units multiply to its unit: spectra at points are integrals over time.
    """
    data: dict[str, Any] = {}
    coords: dict[str, Any] = {}
    quantities: dict[str, tuple[str, ...]] = {}
    for name, record in records.items():
        letters, point = list(_AXES[: record.dim]), f"{name}_point"
        quantities |= {f"{name}_time": ("time",), f"{name}_frequency": ("frequency",)}
        if record.data:
            coords[f"{name}_time"] = record.times
        if record.spectra:
            coords[f"{name}_frequency"] = record.frequencies
        for axis, letter in enumerate(letters):
            coords[f"{name}_{letter}"] = (point, record.points[:, axis])
            if not record.directions:
                quantities[f"{name}_{letter}"] = ("length",)
        for along, ending, tables in (("time", "", record.data), ("frequency", "_spectrum", record.spectra)):
            for quantity, values in tables.items():
                inner = ("component", "along")[: values.ndim - 2]
                data[f"{name}_{quantity}{ending}"] = ((f"{name}_{along}", point, *inner), values)
                coords |= dict.fromkeys(inner, letters)
                if not ending:
                    quantities[f"{name}_{quantity}"] = (quantity,)
                elif not record.directions:
                    quantities[f"{name}_{quantity}{ending}"] = (quantity, "time")
    return data, coords, quantities
