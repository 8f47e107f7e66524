"""Spectra accumulated during a run: Fourier sums of the field at chosen frequencies, in regions and at points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Frequencies, OneOf
from farhorizon.errors import InputError, shown
from farhorizon.files.records import Recorded
from farhorizon.geometry.interpolation import INTERPOLATIONS, as_points, interpolation_blocks
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.geometry.shapes import Shape
from farhorizon.machine import available_memory
from farhorizon.simulation.assembly import Parts
from farhorizon.simulation.recorders.fourier_sums import FourierSums
from farhorizon.simulation.recorders.quantities import QUANTITIES, Reading
from farhorizon.simulation.recorders.receivers import POINT_KEYS, check_blocks, moduli_at
from farhorizon.simulation.recorders.recorder import (
    Arrays,
    Plane,
    Recorder,
    RecordRequest,
    StepValues,
    check_begun,
    recorder_name,
)
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Setup

_LINEAR = [name for name, quantity in QUANTITIES.items() if not quantity.moving]


class Spectra(Recorder):
    """Spectrum of the field at some frequencies, accumulated in every step: memory by frequency, not by time.

    It is passed to a run in ``observe=[...]``. The sums are ``sum dt u(n dt) exp(-2 pi i f n dt)`` over all steps from
    the first on, with the convention of `numpy.fft`: once the field has come to rest, they are its Fourier transform.

    Parameters
    ----------
    where : Shape, (str, float), or array_like, shape (n, dim), or (n,) in 1D
        A region, for all nodes of the near field in it; a plane, ``("z", 2.5)``, for all nodes of the layer of nodes
        nearest to it; or points as in `Receivers`.
    frequencies : array_like, shape (F,)
        In cycles per unit of time.
    record : str or sequence of str
        Quantities of `Receivers` that are linear in the field: all but "v" and "energy_flux".
    every : int
        Steps from one term of the sums to the next, whose weight is larger by this factor. If this does not alias any
        waves on the lattice, the sums are the same once the field has come to rest, at a cost smaller by this factor.
        Half the stable step allows 3.
    interpolation : {"sinc", "linear"}
        For points between nodes, as in `Receivers`.
    name : str
        Name that distinguishes several of them in one run.

    Attributes
    ----------
    points : ndarray, shape (n, dim)
        The points, or the nodes of the region.
    frequencies : ndarray, shape (F,)
    data : dict of str to ndarray
        The sums so far, complex, each of shape (F, n), for vectors (F, n, dim), for tensors (F, n, dim, dim).

    Raises
    ------
    InputError
        A negative frequency, an unknown quantity. When the simulation is created: frequencies above the limit for steps
        of that length, or above those of waves on the lattice; no node in the region; points as in `Receivers`; sums
        that do not fit into memory.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> spectra = fh.Spectra([1.0, 3.5], [0.05, 0.1])
    >>> line = fh.Receivers([1.0, 3.5])
    >>> lattice = fh.Lattice(0.5, -12, 12)
    >>> start = {"v": "x*exp(-x**2)"}
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), initial=start, observe=[spectra, line])
    >>> sim.step(100)
    >>> phases = np.exp(-2j * np.pi * np.outer(spectra.frequencies, line.times))
    >>> bool(np.allclose(spectra.data["u"], sim.dt * phases @ line.data["u"]))
    True
    """

    shared = True

    def __init__(
        self,
        where: Annotated[
            Any, OneOf(**POINT_KEYS, region=Annotated[Shape, "Region all of whose nodes are recorded."], plane=Plane)
        ],
        frequencies: Frequencies,
        record: str | Sequence[str] = ("u",),
        every: int = 1,
        interpolation: str = "sinc",
        name: str = "spectra",
    ) -> None:
        self._plane = isinstance(where, list | tuple) and len(where) == 2 and isinstance(where[0], str)
        self.where: Any = where if self._plane or isinstance(where, Shape) else kinds.array(where, "spectra.where")
        self.frequencies = as_frequencies(frequencies, "spectra.frequencies")
        if not self.frequencies.size:
            raise InputError(
                "frequencies are one or more numbers from 0 on",
                value="none",
                limit="at least 1",
                key="spectra.frequencies",
                remedy="a list of cycles per time, as np.linspace gives it",
            )
        wanted = [record] if isinstance(record, str) else kinds.sequence(record, "spectra.record", "quantities")
        for one in wanted or [""]:
            kinds.one_of(one, "spectra.record", _LINEAR, "no quantity that is linear in the field")
        self.record = tuple(dict.fromkeys(wanted))
        self.every = kinds.integer(every, "spectra.every", least=1)
        self.interpolation = kinds.one_of(
            interpolation, "spectra.interpolation", INTERPOLATIONS, "unknown interpolation"
        )
        self.name = recorder_name(name)
        self.notes: list[str] = []
        self.points = np.zeros((0, 1))

    def __repr__(self) -> str:
        return f"Spectra({len(self.frequencies)} frequencies, record={list(self.record)})"

    @property
    def data(self) -> dict[str, np.ndarray]:
        """The sums so far, by quantity."""
        check_begun(self.points.size > 0, "spectra", "spectra")
        sums = self._sums.values.reshape(-1, *self._shape)
        reading = Reading(sums, np.zeros(0), self._sums.dt, 0.0, self._medium, self._warm)
        return reading.of(self.record)

    @property
    def recorded(self) -> Recorded:
        """The sums so far, independent of the run."""
        return Recorded(self.name, self.points, np.zeros(0), {}, self.frequencies, self.data)

    @property
    def asked(self) -> Arrays:
        """The points and the frequencies."""
        return {"points": self.points, "frequencies": self.frequencies}

    def forget(self) -> None:
        """Do nothing: there are no rows."""

    # --- in a run ----------------------------------------------------------------------------------------------

    def begin(self, setup: Setup, parts: Parts) -> RecordRequest:
        near = parts.whole.near
        lattice = near.lattice
        for name in self.record:
            kinds.one_of(
                name,
                "spectra.record",
                [one for one in _LINEAR if QUANTITIES[one].has(near.model)],
                f"{near.model.title} has no such quantity",
            )
        check_frequencies(self.frequencies, near)
        self._check_stride(near)
        nodes = None
        if self._plane or isinstance(self.where, Shape):
            nodes = _nodes(self.where, self._plane, parts)
        if nodes is None:
            self.points = as_points(self.where, lattice.dim, "spectra.where")
        else:
            self.points = lattice.lower + lattice.spacing * np.stack(np.unravel_index(nodes, lattice.shape), -1)
        derived = any(QUANTITIES[name].derived for name in self.record)
        self._warm = near.model.warm and any(QUANTITIES[name].stressed for name in self.record)
        self._shape = len(self.points), near.stencil.components, 1 + lattice.dim * derived + self._warm
        self._check_size()
        self._medium = moduli_at(parts, self.points)
        self._sums = FourierSums(self.frequencies, self.every * near.dt, int(np.prod(self._shape)))
        if nodes is not None and not derived:
            return RecordRequest(nodes, (), self.every)
        axes = [None, *range(lattice.dim)] if derived else [None]
        blocks = [
            interpolation_blocks(lattice, self.points, self.interpolation, axis, "spectra.where") for axis in axes
        ]
        for axis, one in zip(axes, blocks, strict=True):
            check_blocks(setup, parts, self.points, one, self.interpolation, axis is not None, "spectra.where")
        return RecordRequest(np.zeros(0, np.int64), tuple(blocks), self.every, heat=self._warm)

    def start(self, step: int, step_values: StepValues) -> None:
        self._sums = FourierSums(self.frequencies, self._sums.dt, int(np.prod(self._shape)))
        self.add(step, StepValues(step_values.nodes[1:], tuple(one[1:] for one in step_values.blocks)))

    def add(self, step: int, step_values: StepValues) -> None:
        kept = slice(-step % self.every, None, self.every)
        rows = np.stack(step_values.blocks, axis=-1)[kept] if step_values.blocks else step_values.nodes[kept]
        self._sums.add(-(-step // self.every), rows.reshape(len(rows), int(np.prod(self._shape))))

    def state(self) -> Arrays:
        return self._sums.state()

    def take(self, state: Arrays) -> None:
        self._sums.take(state)

    def _check_stride(self, near: NearField) -> None:
        """Raise InputError if terms are so far apart that some wave on the lattice would be aliased."""
        waves = near.model.order == 2  # diffusion has no highest frequency
        most = max(1, int(0.5 / (near.highest_frequency * near.dt) * (1 + 1e-9))) if waves else 1
        if self.every > most:
            raise InputError(
                "terms so far apart would alias waves on the lattice",
                value=self.every,
                limit=f"1 to {most}",
                key="spectra.every",
                remedy=f"every = {most}",
            )

    def _check_size(self) -> None:
        need = 32.0 * len(self.frequencies) * float(np.prod(self._shape))
        if need > 2.0**28 and need > available_memory():
            raise InputError(
                "the sums do not fit into memory",
                value=f"about {need / 2**30:.3g} GiB",
                limit=f"{available_memory() / 2**30:.3g} GiB available",
                key="spectra.frequencies",
                remedy="fewer frequencies or points",
            )


def as_frequencies(given: Any, key: str) -> np.ndarray:
    """Return frequencies as an array of shape (F,); raises InputError for anything else."""
    found = np.atleast_1d(kinds.array(given, key))
    if found.ndim != 1 or found.min(initial=0.0) < 0:
        raise InputError(
            "frequencies are a list of numbers from 0 on",
            value=kinds.said(found),
            limit=">= 0",
            key=key,
            remedy="cycles per unit of time; what they have below 0 is the complex conjugate",
        )
    return found


def check_frequencies(frequencies: np.ndarray, near: NearField, key: str = "spectra.frequencies") -> None:
    """Refuse frequencies that steps of this length cannot resolve, or that no wave on the lattice has.

    Raises
    ------
    InputError
        A frequency above the Nyquist frequency, or above the highest of waves on the lattice.
    """
    highest, nyquist = float(frequencies.max(initial=0.0)), 0.5 / near.dt
    if highest > nyquist * (1 + 1e-9):
        raise InputError(
            "the frequency is above Nyquist's: steps of this length cannot distinguish it from a lower one",
            value=highest,
            limit=nyquist,
            key=key,
            remedy="cycles, not radians, per unit of time; or a smaller dt",
        )
    if near.model.order == 2 and highest > near.highest_frequency * (1 + 1e-9):
        raise InputError(
            "no wave on the lattice has so high a frequency",
            value=highest,
            limit=near.highest_frequency,
            key=key,
            remedy="cycles, not radians, per unit of time; or a smaller spacing",
        )


def _in_region(region: Shape, lattice: Lattice) -> np.ndarray:
    """Return which nodes lie in a region, as a mask of the lattice's shape."""
    return np.asarray(region.contains(np.stack(lattice.coordinates(), axis=-1)))


def _on_plane(plane: tuple[str, float], lattice: Lattice) -> np.ndarray:
    """Return which nodes belong to the layer of nodes nearest to a plane, as a mask of the lattice's shape."""
    axis, position = plane
    number = AXES.index(kinds.one_of(axis, "spectra.where", AXES[: lattice.dim], "the lattice has no such axis"))
    place = (kinds.number(position, "spectra.where") - lattice.whole.lower[number]) / lattice.spacing
    return np.asarray(np.indices(lattice.shape)[number] + lattice.first[number] == np.round(place))


def _nodes(where: Any, is_plane: bool, parts: Parts) -> np.ndarray:
    """Return the flat indices of the nodes of the near field in a region or on a plane; raises InputError if there are
    none.
    """
    part, lattice = parts.near.lattice, parts.whole.near.lattice
    inside = _on_plane(where, part) if is_plane else _in_region(where, part)
    if part.mask is not None:
        inside = inside & part.mask
    nodes = parts.whole.numbers(inside, part)
    if not nodes.size:
        raise InputError(
            "no node of the near field lies in the region, or on the plane",
            value=repr(where),
            limit=f"{shown(lattice.lower)} to {shown(lattice.upper)}",
            key="spectra.where",
            remedy="move it inside or enlarge the lattice",
        )
    return nodes
