"""The waves that data send to a side, as they arrive there; see `farhorizon.analysis.layers.returned`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from scipy import fft, special

from farhorizon.analysis.layers.chain_modes import (
    alike_along,
    all_modes,
    parts_in_cache,
    sent_in_mode,
    slowest_modes,
    vectors_arrived,
)
from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.returned import Arrivals, loudest
from farhorizon.analysis.layers.samples import Sample
from farhorizon.analysis.layers.side_data import Datum, frequency_of_slow_waves, reach_the_end
from farhorizon.engine.parallel import in_parallel

# on the line Re s = _DECAY/T what happens after 2 T folds back into the run, exp(-2 _DECAY) times as large; where waves
# are followed each by itself, what is left out of them grows as exp(_DECAY)
_DECAY, _DECAY_EACH = 6.0, 5.0
_FELT = 0.02  # share of the wanted error that waves which are left out may make together
_FINER = 2  # moments and places at which the largest value is looked for, over the fewest that hold the waves
# on a line, where waves are few, less by as much as layers amplify some that fall within a node or two
_AMPLIFIED = 1e-6
_UNHEARD = 0.05  # and of what comes back of those that are followed each by itself
_COHERENT = 0.05  # the largest value over the sum of all amplitudes, at least
_SPARSE = 8  # every so many tangential modes tell which frequencies are felt
_PASSED = 2.0  # of a wave's displacement, the most that an interface lets through into a faster medium
_HELD = 7.0  # widths of a Gaussian in the transform of smoothed data: exp(-24) remains
# over the length of the run: the band of frequencies in which waves fade out; and what of a wave is nothing
_FADES, _FADED = 10.0, 1e-6
_BETWEEN = np.pi / 8  # of the directions of a square lattice


def arrivals(
    medium: LatticeMedium,
    steps: int,
    data: Sequence[Datum],
    lengths: Sequence[int],
    near: Sequence[range],
    wanted: float,
    size: float = 0.0,
    sample: Sample | None = None,
    smooth: float = 0.0,
    radial: np.ndarray | None = None,
    every: bool = False,
    limit: float = np.inf,
) -> Arrivals:
    """The waves that data send to a side.

    Parameters
    ----------
    medium : LatticeMedium
        Of second order in time; its first axis is the normal of the side.
    steps : int
        Of the run.
    data : sequence of Datum
    lengths : sequence of int
        Nodes after which the near field repeats itself, one for each tangential axis: so many that nothing comes round
        within the run, or the period of a waveguide.
    near : sequence of range
        Of the data's nodes along each tangential axis, those of the near field; the others are images.
    wanted : float
        The error that is to be told from none, relative to the largest value.
    size : float
        The largest value, as far as it is known: that of the initial displacements.
    sample : Sample, optional
        Of the type of waves that all data are taken to travel as.
    smooth : float, optional
        Width in nodes of a Gaussian by which the data are smoothed along the side, and in time by as long as the
        fastest waves take for it: of the long waves alone there is little to look at, however long the run.
    radial : ndarray, optional
        Tangential wavenumbers times spacing, shape (dim - 1, modes), of waves that are round about a point of the side;
        then values of the data are amplitudes at that point, arrays (rows, modes), see `round_a_point`.
    every : bool
        Whether all modes of the chain are followed, as `hold_backward_waves` tells; of vectors then those of all
        components of the data together, of which 0 is along the normal.
    limit : float, optional
        Speed along the side that waves do not exceed where all modes are followed; faster ones are left out, of
        scalars all whose frequencies have such.
    """
    sample = sample or Sample(medium)
    every = every and all(datum.behind is None for datum in data)
    along, rows = _modes_along(data, lengths, wanted, smooth, radial)
    if radial is not None:
        lengths, near = [], []
    carrier = medium if every and medium.stencil.components > 1 else medium.carrier(sample.kind)
    folded = _DECAY_EACH if every or not len(along) else _DECAY
    lowest = frequency_of_slow_waves(medium, limit) if limit < np.inf and medium.stencil.components == 1 else 0.0
    line = _Line(steps, medium.dt, folded, smooth * medium.spacing / medium.speed, lowest)
    sent = _Sending(carrier, line, along, data, rows, every, limit)
    told = wanted * (_AMPLIFIED if every and reach_the_end(medium, data, wanted) else 1.0)
    heard, left_out = sent.heard(size, told)
    waves = sent.arrived(heard, slice(None))
    felt = loudest(np.abs(waves.amplitude).ravel(), left_out)
    amplitude, root, slowness = (part.ravel()[felt] for part in (waves.amplitude, waves.root, waves.slowness))
    factor = np.broadcast_to(line.z[heard][:, None], waves.root.shape).ravel()[felt]
    shape = None if waves.shape is None else waves.shape.reshape(len(waves.shape), -1)[:, felt]
    side = _coarse_side(along, lengths, near)
    place = side.places(heard, waves.root.shape[1]).ravel()[felt]
    along = _of_each(along, waves.root.shape)[:, felt]
    times = _FINER * (int(heard[-1]) + 1)  # a coarser sampling of time and place than the run's holds all that is heard
    return Arrivals(
        medium,
        amplitude,
        root,
        factor,
        along,
        place,
        (times + 1, *side.counts),
        line.growth(times) * (times / steps) * np.prod(side.counts),
        side.seen,
        sample,
        sample.add(amplitude, root, factor, along, slowness, shape),
        _UNHEARD * told * 2 * steps * np.exp(-folded),
        size,
        every,
        shapes=np.ones((1, 1)) if shape is None else shape,
    )


def _modes_along(
    data: Sequence[Datum], lengths: Sequence[int], wanted: float, smooth: float, radial: np.ndarray | None
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Tangential wavenumbers of the modes along the side that are felt, shape (dim - 1, m), and what each datum has of
    them on its rows.
    """
    if radial is None:
        every = [2 * np.pi * np.fft.fftfreq(length) for length in lengths]
        numbers = [line[np.abs(line) * smooth <= _HELD] for line in every]
        spectra = [_along_side(datum.values, numbers, lengths, smooth) for datum in data]
        modes = _felt_modes(spectra, wanted)
        grid = np.meshgrid(*numbers, indexing="ij")
        along = np.array([k.ravel()[modes] for k in grid]) if numbers else np.zeros((0, 1))
    else:
        spectra = [datum.values * np.exp(-0.5 * smooth**2 * (radial**2).sum(0)) for datum in data]
        modes = _felt_modes(spectra, wanted)
        along = radial[:, modes]
    return along, [spectrum[:, modes] for spectrum in spectra]


def _felt_modes(spectra: Sequence[np.ndarray], wanted: float) -> np.ndarray:
    """Numbers of the modes along the side in which some datum has more than nothing."""
    sizes = [np.abs(spectrum).sum(0) for spectrum in spectra]
    # about the point that faces them data that are odd there are nothing
    content = np.max([size / max(float(size.sum()), 1e-300) for size in sizes], axis=0)
    return loudest(content, 0.1 * _FELT * wanted)


@dataclass(frozen=True, eq=False)
class _Line:
    """The line of the Laplace integral that a run is.

    Attributes
    ----------
    steps : int
    dt : float
    folded : float
        How far off the axis it lies, over the inverse of the length of the run.
    lasting : float
        Width in time of the Gaussian that smoothes the data.
    lowest : float
        Frequency below which waves fade out, 0 if none do.
    """

    steps: int
    dt: float
    folded: float
    lasting: float
    lowest: float

    @property
    def decay(self) -> float:
        """Its distance from the axis."""
        return self.folded / (self.steps * self.dt)

    @cached_property
    def z(self) -> np.ndarray:
        """Factors over a step at so many of its points as the run has steps."""
        return np.exp(self.decay * self.dt + 1j * np.pi * np.arange(self.steps + 1) / self.steps)

    @cached_property
    def taken(self) -> np.ndarray:
        """What remains of the waves of each point: it is analytic, so that nothing rings which the Laplace integral
        would let grow.
        """
        if not self.lowest:
            return np.ones(1)
        return special.erfc((self.lowest + 1j * self._complete) * (self.steps * self.dt / _FADES)) / 2

    @property
    def smoothing(self) -> np.ndarray:
        """What remains of them where data are smoothed in time."""
        return np.exp(0.5 * (self.lasting * self._complete) ** 2)

    @property
    def _complete(self) -> np.ndarray:
        return np.log(self.z) / self.dt

    def growth(self, times: int) -> np.ndarray:
        """How much larger than in the integral all is at so many moments of the run."""
        return np.exp(self.decay * self.dt * self.steps / times * np.arange(times))


class _Waves(NamedTuple):
    """Waves by frequency and mode.

    Attributes
    ----------
    root, amplitude, slowness : ndarray of complex, shape (frequencies, modes)
        Factors over a node, amplitudes, and steps that they take over a node.
    shape : ndarray of complex, shape (d, frequencies, modes), or None
        Polarisations where they are of several types.
    """

    root: np.ndarray
    amplitude: np.ndarray
    slowness: np.ndarray
    shape: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class _Sending:
    """What data send to a side.

    Attributes
    ----------
    medium : LatticeMedium
        In front of the side; of vectors where all modes of theirs are followed, else of one type of waves.
    line : _Line
    along : ndarray, shape (dim - 1, m)
        Tangential wavenumbers times spacing.
    data : sequence of Datum
    rows : list of ndarray, shape (rows, m)
        What each has of the modes along the side.
    every : bool
        Whether all modes of the chain are followed.
    limit : float
        Speed along the side that waves of vectors do not exceed.
    """

    medium: LatticeMedium
    line: _Line
    along: np.ndarray
    data: Sequence[Datum]
    rows: list[np.ndarray]
    every: bool
    limit: float

    @cached_property
    def starts(self) -> list[np.ndarray]:
        """What the scheme makes of each datum."""
        line = self.line
        return [line.taken * _start(datum, line.z, self.medium, line.decay) * line.smoothing for datum in self.data]

    @cached_property
    def _alike(self) -> tuple[np.ndarray, np.ndarray]:
        return alike_along(self.medium.stencil, self.along)

    def heard(self, size: float, told: float) -> tuple[np.ndarray, float]:
        """Numbers of the frequencies at which something is felt, and what may be left out of the sum of amplitudes at
        these, where the largest value is at least `size` and a part of `told` of it is to be told from none.
        """
        possible, steps = self._travelling(), self.line.steps
        sparse = np.abs(self.arrived(possible, slice(None, None, _SPARSE)).amplitude)
        loudness = sparse.max(1) * self.along.shape[1]
        largest = max(size * 2 * steps * np.exp(-self.line.folded), _COHERENT * _SPARSE * float(sparse.sum()))
        threshold = _FELT * told * largest  # of the sum of all amplitudes that are left out, half of it by frequencies
        return possible[loudest(loudness, 0.5 * threshold)], 0.5 * threshold

    def _travelling(self) -> np.ndarray:
        """Numbers of the frequencies at which waves may be felt.

        Nothing travels beyond, where only the shortest pulses have anything; one at least, of runs of a few short
        steps.
        """
        medium, line = self.medium, self.line
        pitch = np.abs(medium.recursion.eigenvalue(line.z))
        highest = np.inf if self.every else 1.2 * medium.rate * medium.stencil.symbol_maximum
        highest = min(highest, (_HELD / line.lasting) ** 2 if line.lasting else np.inf)
        return np.flatnonzero((pitch <= max(highest, pitch.min())) & (np.abs(line.taken) > _FADED))

    def arrived(self, which: np.ndarray, some: slice) -> _Waves:
        """The waves of some frequencies and of some modes along the side."""
        if self.medium.stencil.components > 1:
            held = [
                (datum.component, rows[:, some], start[which])
                for datum, rows, start in zip(self.data, self.rows, self.starts, strict=True)
            ]
            return _Waves(*vectors_arrived(self.medium, self.line.z[which], self.along[:, some], held, self.limit))
        parts = parts_in_cache(len(which), self.along[..., some].shape[1])
        found = in_parallel(lambda part: self._scalar(which[part], some), parts)
        return _Waves(*(np.concatenate(part, axis=-2) for part in zip(*found, strict=True)))

    def _scalar(self, which: np.ndarray, some: slice) -> tuple[np.ndarray, ...]:
        """Factors, amplitudes and slownesses of waves of one component or type."""
        z, recursion = self.line.z[which], self.medium.recursion
        modes_of = cache(lambda ratio: self._modes(ratio, z, some))
        root, slope = modes_of(1.0)
        total = np.zeros(root.shape, complex)
        for datum, rows, start in zip(self.data, self.rows, self.starts, strict=True):
            total += _through(datum, rows[:, some], modes_of) * start[which][:, None]
        rise = recursion.scale * np.where(slope == 0, 1, slope)
        slowness = (recursion.keep / z - z)[:, None] / rise
        found = root, np.where(slope == 0, 0, total), np.where(slope == 0, 0, slowness)
        return tuple(np.concatenate(part, axis=1) if part.ndim > 2 else part for part in found)

    def _modes(self, ratio: float, z: np.ndarray, some: slice) -> tuple[np.ndarray, np.ndarray]:
        """Factors over a node and slopes of the modes in a medium of a squared speed over that at the side."""
        alike, number = self._alike
        used, again = np.unique(number[some], return_inverse=True)
        slower = self.medium.slower(ratio)
        solve = all_modes if self.every else slowest_modes
        root, slope = solve(slower, slower.recursion.eigenvalue(z), alike[:, used])
        return root[..., again], slope[..., again]


def _through(datum: Datum, rows: np.ndarray, modes_of: Callable[[float], tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """What a datum sends in the modes of the medium at the side, through a slower one where it lies behind that."""
    root, slope = modes_of(1.0)
    nodes, ratio = datum.behind or (len(rows), 1.0)
    sent = sent_in_mode(rows[len(rows) - nodes :], root, slope)
    if datum.behind is None:
        return sent
    return np.asarray(sent + _PASSED * root**nodes * sent_in_mode(rows[: len(rows) - nodes], *modes_of(ratio)))


class _CoarseSide(NamedTuple):
    """Places along a side, so few that they just hold some modes.

    Attributes
    ----------
    counts : list of int
        Along each tangential axis.
    grid : ndarray of int, shape (m,)
        Where each mode stands among the wavenumbers of so many places.
    seen : list of ndarray of int
        The places along each axis that are beside the near field.
    """

    counts: list[int]
    grid: np.ndarray
    seen: list[np.ndarray]

    def places(self, frequencies: np.ndarray, modes: int) -> np.ndarray:
        """Places of waves in the array of all frequencies and wavenumbers, shape (frequencies, modes)."""
        every = np.tile(self.grid, modes // len(self.grid))
        return np.asarray(frequencies[:, None] * int(np.prod(self.counts)) + every)


def _coarse_side(along: np.ndarray, lengths: Sequence[int], near: Sequence[range]) -> _CoarseSide:
    """The places for modes of tangential wavenumbers along a near field."""
    signed = [np.round(line / (2 * np.pi) * length).astype(int) for line, length in zip(along, lengths, strict=False)]
    counts = [fft.next_fast_len(_FINER * (2 * int(np.abs(line).max()) + 1)) for line in signed]
    seen = [
        np.unique(np.round(np.linspace(nodes[0], nodes[-1], count) / length * count).astype(int) % count)
        for nodes, length, count in zip(near, lengths, counts, strict=True)
    ]
    if not counts:
        return _CoarseSide(counts, np.zeros(along.shape[1], int), seen)
    grid = np.ravel_multi_index([line % count for line, count in zip(signed, counts, strict=True)], counts)
    return _CoarseSide(counts, grid, seen)


def _of_each(along: np.ndarray, waves: tuple[int, ...]) -> np.ndarray:
    """Tangential wavenumbers of all waves, whose modes are several of each wavenumber."""
    every = np.tile(along, waves[1] // along.shape[1])[:, None, :]
    return np.broadcast_to(every, (len(along), *waves)).reshape(len(along), int(np.prod(waves)))


def round_a_point(values: np.ndarray, place: Sequence[int] | np.ndarray, room: float) -> tuple[np.ndarray, np.ndarray]:
    """Data in space as a sum of waves that are round about a line along the normal, which is all that a point of that
    line sees of them where the medium is alike in all directions along the side.

    Parameters
    ----------
    values : ndarray, shape (rows, nodes, nodes)
    place : sequence of int
        Node of the line.
    room : float
        Nodes beyond the farthest of the data after which the waves end, at nodes of Bessel functions.

    Returns
    -------
    ndarray, shape (2, modes)
        Tangential wavenumbers times spacing, in a direction midway between those in which a lattice differs most.
    ndarray, shape (rows, modes)
        Amplitude of each wave on the line.
    """
    squared = sum(
        offset**2 for offset in np.ix_(*[np.arange(n) - at for n, at in zip(values.shape[1:], place, strict=True)])
    )
    distances, ring = np.unique(np.asarray(squared), return_inverse=True)
    rings = np.zeros((len(values), len(distances)))
    np.add.at(rings.T, ring.ravel(), values.reshape(len(values), -1).T)
    radius = float(np.sqrt(distances[-1])) + room
    count = int(radius / np.cos(_BETWEEN))
    zeros = special.jn_zeros(0, max(count, 1))
    weights = 1 / (np.pi * (radius * special.j1(zeros)) ** 2)
    numbers = zeros / radius
    amplitudes = rings @ special.j0(np.sqrt(distances)[:, None] * numbers) * weights
    return np.outer([np.cos(_BETWEEN), np.sin(_BETWEEN)], numbers), amplitudes


def _along_side(values: np.ndarray, numbers: Sequence[np.ndarray], lengths: Sequence[int], smooth: float) -> np.ndarray:
    """Fourier coefficients along the side of values on rows, shape (rows, modes), of data that repeat themselves after
    some lengths and are smoothed by a Gaussian.
    """
    if not smooth:
        axes = tuple(range(1, values.ndim))
        found = fft.fftn(values, s=lengths, axes=axes) / np.prod(lengths) if axes else values
    else:  # few modes of a long side
        found = values
        for line, length in zip(numbers, lengths, strict=True):
            waves = np.exp(-1j * np.outer(np.arange(found.shape[1]), line) - 0.5 * (smooth * line) ** 2) / length
            found = np.tensordot(found, waves, (1, 0))  # which comes last, so that the next axis is the first again
    return np.asarray(found).reshape(len(values), -1)


def _start(datum: Datum, z: np.ndarray, medium: LatticeMedium, decay: float) -> np.ndarray:
    """What the scheme makes of a unit datum, in the transform ``sum_n u_n z^-n``, over its factor `scale`."""
    recursion, dt = medium.recursion, medium.dt
    if datum.kind == "u":
        return (z - recursion.keep + (recursion.first - 1) * (z - 1) * (1 - recursion.keep / z)) / recursion.scale
    if datum.kind == "v":
        return np.full(z.shape, 2 * recursion.keep * recursion.first * dt / recursion.scale, complex)
    steps = len(z) - 1
    samples = datum.time * np.exp(-decay * dt * np.arange(len(datum.time)))
    samples[0] *= recursion.first
    return fft.rfft(samples, 2 * steps)
