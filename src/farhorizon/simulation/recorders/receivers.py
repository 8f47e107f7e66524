"""The field, and what follows from it, at points: step by step, or at chosen frequencies."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Annotated, Any, Self

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Frequencies, Makes, OneOf, Points
from farhorizon.errors import InputError, shown
from farhorizon.files.records import Recorded
from farhorizon.geometry.interpolation import (
    INTERPOLATIONS,
    Blocks,
    another_point,
    as_points,
    interpolation_blocks,
    points_on_grid,
    points_on_line,
)
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.geometry.shapes import Shape
from farhorizon.machine import check_fits
from farhorizon.rounding import MARGIN
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.recorders.fourier_sums import FourierSums
from farhorizon.simulation.recorders.quantities import QUANTITIES, LocalModuli, Reading
from farhorizon.simulation.recorders.recorder import (
    Arrays,
    LinearRecorder,
    Plane,
    RecordRequest,
    RowRecorder,
    StepValues,
    Window,
    check_begun,
)
from farhorizon.simulation.setup.compatibility import check_lossless
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Setup

_LINEAR = [name for name, quantity in QUANTITIES.items() if not quantity.moving]
#: Keys of a case file that give points.
POINT_KEYS = {
    "points": Annotated[Points, "Points, on nodes or between them."],
    "line": Annotated[Any, Makes(points_on_line), "Points along a line."],
    "grid": Annotated[Any, Makes(points_on_grid), "Points on a grid."],
}


class _AtPoints(LinearRecorder, offered=False):
    """A recorder of the field at points, between nodes too, or of quantities that follow from it and its gradient."""

    points: np.ndarray
    record: tuple[str, ...]
    interpolation: str

    def _examine(self, parts: RunParts, names: Iterable[str], key: str) -> None:
        """Determine what the quantities need; raises InputError for those not among the named ones of the model."""
        near = parts.whole.near
        known = [name for name in names if QUANTITIES[name].has(near.model)]
        for name in self.record:
            kinds.one_of(name, key, known, f"{near.model.title} has no such quantity")
        self._derived = any(QUANTITIES[name].derived for name in self.record)
        stressed = any(QUANTITIES[name].stressed for name in self.record)
        if stressed:
            check_lossless(near.model, key, "the displacements, velocities or strains")
        self._strained = near.model.warm and stressed
        self._medium = _moduli_at(parts, self.points)

    def _interpolations(self, setup: Setup, parts: RunParts, key: str) -> tuple[Blocks, ...]:
        """Return the sums that interpolate the field at the points, followed by its derivatives along the axes if a
        quantity needs them.
        """
        lattice, sums = parts.whole.near.lattice, []
        for axis in [None, *range(lattice.dim)] if self._derived else [None]:
            cuts = [crack.cut for crack in setup.cracks]
            sums.append(interpolation_blocks(lattice, self.points, self.interpolation, axis, key, cuts=cuts))
            self._check(parts, sums[-1], another_point(self.interpolation, axis is not None), key)
        return tuple(sums)

    def _check(self, parts: RunParts, blocks: Blocks, remedy: str, key: str) -> None:
        """Raise InputError if an interpolation uses nodes beyond a wall, which are images of those inside."""
        nodes, weights = blocks.entries()
        hidden = ((weights != 0) & parts.hides(nodes)).any(axis=1)
        if hidden.any():
            raise InputError(
                "the point needs nodes beyond a wall, which are images of those inside",
                value=self.points[hidden][0],
                limit=f"interpolation = {self.interpolation!r}",
                key=key,
                remedy=remedy,
            )

    def functional(self, step_values: StepValues) -> np.ndarray:
        """Return the field, its derivatives and the thermal strain, laid out as in `Reading`."""
        if len(step_values.blocks) > 1:
            return np.stack(step_values.blocks, axis=-1)
        # no copy: every quantity computes a new array
        return (step_values.blocks[0] if step_values.blocks else step_values.nodes)[..., None]


class Receivers(_AtPoints, RowRecorder):
    """Points at which a run is recorded in every step of the compiled loop, or every few steps.

    They are passed to a run in ``observe=[...]``.

    Parameters
    ----------
    points : array_like, shape (n, dim), or (n,) in 1D
        Anywhere in the near field; `line` and `grid` create regular arrangements.
    record : str or sequence of str
        What is recorded: "u", the field; for waves "v", the velocity; "gradient", the derivatives along the axes; for
        elastic media "strain", "stress", "pressure" (minus the mean of the normal stresses, in two dimensions of those
        in the plane), "divergence", "curl" and "rotation" (half the curl); for waves "energy_flux", the Poynting vector
        ``- stress . v``, for scalar waves ``- c^2 v grad u``.
    every : int
        Steps from one record to the next.
    interpolation : {"sinc", "linear"}
        Interpolation between nodes: by a windowed sinc that uses eight nodes to either side, accurate to some 1e-5 for
        waves of four nodes per wavelength and more; or linear, with an error of second order, which also works within
        eight nodes of an edge, a hole or a crack. A point that coincides with a node takes its value. Derivatives are
        those of the sinc, or central differences.
    name : str
        Name that distinguishes several of them in one run, in files and pictures.

    Attributes
    ----------
    points : ndarray, shape (n, dim)
    times : ndarray, shape (rows,)
        Time at which each row was recorded. "v" and "energy_flux" refer to half a step earlier, as in the energies.
    data : dict of str to ndarray
        Recorded values, each of shape (rows, n), for vectors (rows, n, dim), for tensors (rows, n, dim, dim); gradients
        of displacements have the component first.
    doubts : list of str
        Which waves are aliased if not every step is recorded; a `ValidityWarning` when the simulation is created.
    shared : bool
        They can also record runs on several processes, with the same result on each: sums over nodes of several boxes
        agree to rounding error.

    Raises
    ------
    InputError
        No points, an unknown quantity. When the simulation is created: points outside the near field, in a hole, or too
        close to an edge, a hole or a crack for the interpolation; quantities that the model does not have.

    Notes
    -----
    The interpolation is that of Hicks (2002), see `farhorizon.geometry.interpolation`. Where a material changes, the
    sinc shows ringing, as Fourier sums do; stress and energy flux use the moduli at the nearest node.

    Examples
    --------
    >>> import farhorizon as fh
    >>> line = fh.Receivers.line((1.3, 0.2), (6.3, 0.2), 6, record=["u", "v"])
    >>> lattice = fh.Lattice(0.5, (-12.0, -6.0), (12.0, 6.0))
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), initial={"u": "exp(-x**2 - y**2)"}, observe=[line])
    >>> _ = sim.run(until=4.0)
    >>> line.data["u"].shape == (sim.step_count + 1, 6)
    True
    """

    shared = True
    before = 1
    _last_key = "before"

    def __init__(
        self,
        points: Annotated[Any, OneOf(**POINT_KEYS)],
        record: str | Sequence[str] = ("u",),
        every: int = 1,
        interpolation: str = "sinc",
        name: str = "receivers",
    ) -> None:
        super().__init__(name)
        self.points = kinds.array(points, "receivers.points")
        self.record = _quantities_asked(record, "receivers.record", QUANTITIES, "unknown quantity")
        self.every = kinds.integer(every, "receivers.every", least=1)
        self.interpolation = kinds.one_of(
            interpolation, "receivers.interpolation", INTERPOLATIONS, "unknown interpolation"
        )

    @classmethod
    def line(cls, start: Any, end: Any, count: int, **options: Any) -> Self:
        """Create receivers at equal distances along a line, including both ends.

        Parameters
        ----------
        start, end : array_like, shape (dim,)
        count : int
        **options
            Options of the constructor.
        """
        return cls(points_on_line(start, end, count), **options)

    @classmethod
    def grid(cls, lower: Any, upper: Any, counts: Any, **options: Any) -> Self:
        """Create receivers on a grid, including both corners; the last axis varies fastest.

        Parameters
        ----------
        lower, upper : array_like, shape (dim,)
        counts : sequence of int
            Number of receivers along each axis.
        **options
            Options of the constructor.
        """
        return cls(points_on_grid(lower, upper, counts), **options)

    def __repr__(self) -> str:
        return f"Receivers({len(self.points)} points, record={list(self.record)}, every={self.every})"

    # --- in a run ----------------------------------------------------------------------------------------------

    def begin(self, setup: Setup, parts: RunParts) -> RecordRequest:
        near = parts.whole.near
        self.points = as_points(self.points, near.lattice.dim, "receivers.points")
        self._examine(parts, QUANTITIES, "receivers.record")
        blocks = self._interpolations(setup, parts, "receivers.points")
        self._background, self.dt = near.background, near.dt
        self.doubts = self._aliased(near)
        moving = any(QUANTITIES[name].moving for name in self.record)  # these need every step
        return RecordRequest(np.zeros(0, np.int64), blocks, 1 if moving else self.every, heat=self._strained)

    def rows(self, window: Window) -> Arrays:
        before, now = window.values
        return Reading(now, before, self.dt, self._background, self._medium, self._strained).of(self.record)

    def _aliased(self, near: NearField) -> list[str]:
        """Return warnings about waves whose frequencies are aliased because not every step is recorded."""
        most = _largest_stride(near)
        if near.model.order == 1 or self.every <= most:
            return []
        limit = 0.5 / (self.every * near.dt)
        return [
            f"{self.name} are recorded every {self.every} steps: frequencies above {limit:.4g} "
            f"are aliased to lower ones, and the lattice carries waves up to {near.highest_frequency:.4g}; "
            f"every = {most} or less records all of them correctly"
        ]


class Spectra(_AtPoints):
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
    sums: FourierSums
    _sums_key = ""

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
        super().__init__(name)
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
        self.record = _quantities_asked(record, "spectra.record", _LINEAR, "no quantity that is linear in the field")
        self.every = kinds.integer(every, "spectra.every", least=1)
        self.interpolation = kinds.one_of(
            interpolation, "spectra.interpolation", INTERPOLATIONS, "unknown interpolation"
        )
        self.points = np.zeros((0, 1))

    def __repr__(self) -> str:
        return f"Spectra({len(self.frequencies)} frequencies, record={list(self.record)})"

    @property
    def data(self) -> dict[str, np.ndarray]:
        """The sums so far, by quantity."""
        check_begun(self.points.size > 0, "spectra", "spectra")
        sums = self.sums.values.reshape(-1, *self._shape)
        return Reading(sums, np.zeros(0), self.sums.dt, 0.0, self._medium, self._strained).of(self.record)

    @property
    def recorded(self) -> Recorded:
        """The sums so far, independent of the run."""
        return Recorded(self.name, self.points, np.zeros(0), {}, self.frequencies, self.data)

    @property
    def asked(self) -> Arrays:
        """The points and the frequencies."""
        return {"points": self.points, "frequencies": self.frequencies}

    # --- in a run ----------------------------------------------------------------------------------------------

    def begin(self, setup: Setup, parts: RunParts) -> RecordRequest:
        near = parts.whole.near
        lattice, nodes = near.lattice, None
        if self._plane or isinstance(self.where, Shape):
            nodes = _nodes(self.where, self._plane, parts)
            self.points = lattice.lower + lattice.spacing * np.stack(np.unravel_index(nodes, lattice.shape), -1)
        else:
            self.points = as_points(self.where, lattice.dim, "spectra.where")
        self._examine(parts, _LINEAR, "spectra.record")
        check_frequencies(self.frequencies, near)
        self._check_stride(near)
        self._shape = len(self.points), near.stencil.components, 1 + lattice.dim * self._derived + self._strained
        self._check_size()
        self.sums = FourierSums(self.frequencies, near.dt, int(np.prod(self._shape)), self.every)
        if nodes is not None and not self._derived:
            return RecordRequest(nodes, (), self.every)
        blocks = self._interpolations(setup, parts, "spectra.where")
        return RecordRequest(np.zeros(0, np.int64), blocks, self.every, heat=self._strained)

    def _check_stride(self, near: NearField) -> None:
        """Raise InputError if terms are so far apart that some wave on the lattice would be aliased."""
        most = _largest_stride(near)
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
        check_fits(need, "the sums do", "spectra.frequencies", "fewer frequencies or points")


def _quantities_asked(record: str | Sequence[str], key: str, known: Collection[str], what: str) -> tuple[str, ...]:
    """Return the names of quantities, each once; raises InputError for none, or for one that is not known."""
    names = [record] if isinstance(record, str) else kinds.sequence(record, key, "quantities")
    if not names:
        raise InputError(
            "nothing is to be recorded",
            value=names,
            limit=", ".join(known),
            key=key,
            remedy="one of these, or leave the recorder out",
        )
    for name in names:
        kinds.one_of(name, key, known, what)
    return tuple(dict.fromkeys(names))


def _largest_stride(near: NearField) -> int:
    """Return the largest number of steps between two samples for which no wave on the lattice is aliased; 1 for
    diffusion, which has no highest frequency.
    """
    if near.model.order == 1:
        return 1
    return max(1, int(0.5 / (near.highest_frequency * near.dt) * (1 + MARGIN)))


def _moduli_at(parts: RunParts, points: np.ndarray) -> LocalModuli:
    """Return the constants of the medium at points: those of the nearest nodes."""
    lattice = parts.near.lattice.whole
    last = np.array(lattice.shape) - 1  # points outside are refused elsewhere
    nearest = np.clip(np.round((points - lattice.lower) / lattice.spacing), 0, last).astype(int)
    return LocalModuli(*parts.at(parts.near.lame, np.ravel_multi_index(tuple(nearest.T), lattice.shape)))


def as_frequencies(given: Any, key: str) -> np.ndarray:
    """Return frequencies as an array of shape (F,); raises InputError for anything else."""
    frequencies = np.atleast_1d(kinds.array(given, key))
    if frequencies.ndim != 1 or frequencies.min(initial=0.0) < 0:
        raise InputError(
            "frequencies are a list of numbers from 0 on",
            value=kinds.said(frequencies),
            limit=">= 0",
            key=key,
            remedy="cycles per unit of time; what they have below 0 is the complex conjugate",
        )
    return frequencies


def check_frequencies(frequencies: np.ndarray, near: NearField, key: str = "spectra.frequencies") -> None:
    """Raise InputError for frequencies that steps of this length cannot resolve, or that no wave on the lattice has."""
    highest, nyquist = float(frequencies.max(initial=0.0)), 0.5 / near.dt
    if highest > nyquist * (1 + MARGIN):
        raise InputError(
            "the frequency is above Nyquist's: steps of this length cannot distinguish it from a lower one",
            value=highest,
            limit=nyquist,
            key=key,
            remedy="cycles, not radians, per unit of time; or a smaller dt",
        )
    if near.model.order == 2 and highest > near.highest_frequency * (1 + MARGIN):
        raise InputError(
            "no wave on the lattice has so high a frequency",
            value=highest,
            limit=near.highest_frequency,
            key=key,
            remedy="cycles, not radians, per unit of time; or a smaller spacing",
        )


def _on_plane(plane: tuple[str, float], lattice: Lattice) -> np.ndarray:
    """Return which nodes belong to the layer of nodes nearest to a plane, as a mask of the lattice's shape."""
    axis, position = plane
    number = AXES.index(kinds.one_of(axis, "spectra.where", AXES[: lattice.dim], "the lattice has no such axis"))
    place = (kinds.number(position, "spectra.where") - lattice.whole.lower[number]) / lattice.spacing
    return np.asarray(np.indices(lattice.shape)[number] + lattice.first[number] == np.round(place))


def _nodes(where: Any, is_plane: bool, parts: RunParts) -> np.ndarray:
    """Return the flat indices of the nodes of the near field in a region or on a plane; raises InputError for none."""
    subdomain, lattice = parts.near.lattice, parts.whole.near.lattice
    if is_plane:
        inside = _on_plane(where, subdomain)
    else:
        inside = np.asarray(where.contains(np.stack(subdomain.coordinates(), axis=-1)))
    if subdomain.mask is not None:
        inside = inside & subdomain.mask
    nodes = parts.whole.numbers(inside, subdomain)
    if not nodes.size:
        raise InputError(
            "no node of the near field lies in the region, or on the plane",
            value=repr(where),
            limit=f"{shown(lattice.lower)} to {shown(lattice.upper)}",
            key="spectra.where",
            remedy="move it inside or enlarge the lattice",
        )
    return nodes
