"""Waves radiated by data towards a side, as they arrive there; see `farhorizon.analysis.layers.returned`."""

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

# on the line Re s = _DECAY/T whatever happens after 2 T folds back into the run, reduced by exp(-2 _DECAY); where waves
# are followed individually, the error of leaving some out grows as exp(_DECAY)
_DECAY, _DECAY_EACH = 6.0, 5.0
_FELT = 0.02  # share of the target error that the waves left out may cause together
_FINER = 2  # times and places at which the largest value is sampled, over the fewest that represent the waves
# this share is smaller on a line, where there are few waves, since layers amplify some that decay within a node or two
_AMPLIFIED = 1e-6
_UNHEARD = 0.05  # the same share for the reflections of waves that are followed individually
_COHERENT = 0.05  # lower bound of the largest value over the sum of all amplitudes
_SPARSE = 8  # every eighth tangential mode is used to find the frequencies that matter
_PASSED = 2.0  # largest transmission coefficient, in displacement, of an interface to a faster medium
_HELD = 7.0  # widths of a Gaussian in the transform of smoothed data: exp(-24) remains
# width of the band of frequencies in which waves fade out, over the inverse of the length of the run; negligible part
# of a wave
_FADES, _FADED = 10.0, 1e-6
_BETWEEN = np.pi / 8  # midway between an axis and a diagonal of a square lattice


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
    """Compute the waves that data send to a side.

    Parameters
    ----------
    medium : LatticeMedium
        Of second order in time; its first axis is the normal of the side.
    steps : int
        Number of time steps of the run.
    data : sequence of Datum
    lengths : sequence of int
        Period of the near field along each tangential axis, in nodes: so long that no periodic image arrives within the
        run, or the period of a waveguide.
    near : sequence of range
        Nodes along each tangential axis that belong to the near field; the others are images.
    wanted : float
        Target error relative to the largest value, from which the accuracy follows.
    size : float
        The largest value, as far as it is known: that of the initial displacements.
    sample : Sample, optional
        Sample for the type of waves as which all data are assumed to travel.
    smooth : float, optional
        Width in nodes of a Gaussian by which the data are smoothed along the side, and in time over the time in which
        the fastest waves travel this width. For long waves alone the computation is short, however long the run.
    radial : ndarray, optional
        Tangential wavenumbers times spacing, shape (dim - 1, modes), of waves that are axially symmetric about a point
        of the side; the values of the data are then amplitudes at that point, arrays (rows, modes), see
        `round_a_point`.
    every : bool
        Whether all modes of the chain are followed, as `hold_backward_waves` decides; for vectors these are the modes
        of all components of the data together, of which component 0 is along the normal.
    limit : float, optional
        Speed along the side that waves do not exceed where all modes are followed. Faster waves are left out; for
        scalars, all waves at frequencies that have faster ones.
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
    times = _FINER * (int(heard[-1]) + 1)  # a coarser sampling in time than the run's resolves these frequencies
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
    """Tangential wavenumbers of the modes along the side that matter, shape (dim - 1, m), and the amplitudes of each
    datum in these modes on its rows.
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
    """Indices of the modes along the side in which the amplitude of some datum is not negligible."""
    sizes = [np.abs(spectrum).sum(0) for spectrum in spectra]
    # data that are odd about the point that faces them have zero amplitude there
    content = np.max([size / max(float(size.sum()), 1e-300) for size in sizes], axis=0)
    return loudest(content, 0.1 * _FELT * wanted)


@dataclass(frozen=True, eq=False)
class _Line:
    """The line of the Laplace integral for a run.

    Attributes
    ----------
    steps : int
    dt : float
    folded : float
        Its distance from the imaginary axis, times the length of the run.
    lasting : float
        Width in time of the Gaussian that smooths the data.
    lowest : float
        Frequency below which waves are faded out, 0 if none are.
    """

    steps: int
    dt: float
    folded: float
    lasting: float
    lowest: float

    @property
    def decay(self) -> float:
        """Its distance from the imaginary axis."""
        return self.folded / (self.steps * self.dt)

    @cached_property
    def z(self) -> np.ndarray:
        """Factors per step at the points of the line, steps + 1 in number."""
        return np.exp(self.decay * self.dt + 1j * np.pi * np.arange(self.steps + 1) / self.steps)

    @cached_property
    def taken(self) -> np.ndarray:
        """Factor by which the waves of each point are faded out. It is analytic, so that there is no ringing, which the
        Laplace integral would amplify.
        """
        if not self.lowest:
            return np.ones(1)
        return special.erfc((self.lowest + 1j * self._complete) * (self.steps * self.dt / _FADES)) / 2

    @property
    def smoothing(self) -> np.ndarray:
        """Factor on the waves of each point where data are smoothed in time."""
        return np.exp(0.5 * (self.lasting * self._complete) ** 2)

    @property
    def _complete(self) -> np.ndarray:
        return np.log(self.z) / self.dt

    def growth(self, times: int) -> np.ndarray:
        """Factor by which values exceed those in the integral, at a number of times of the run."""
        return np.exp(self.decay * self.dt * self.steps / times * np.arange(times))


class _Waves(NamedTuple):
    """Waves by frequency and mode.

    Attributes
    ----------
    root, amplitude, slowness : ndarray of complex, shape (frequencies, modes)
        Factors per node, amplitudes, and steps that the waves take per node.
    shape : ndarray of complex, shape (d, frequencies, modes), or None
        Polarisations where there are several types of waves.
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
        The medium in front of the side: of vectors where all their modes are followed, else a scalar one for one type
        of waves.
    line : _Line
    along : ndarray, shape (dim - 1, m)
        Tangential wavenumbers times spacing.
    data : sequence of Datum
    rows : list of ndarray, shape (rows, m)
        Amplitudes of each datum in the modes along the side.
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
        """Transform of the scheme for each datum, at each frequency."""
        line = self.line
        return [line.taken * _start(datum, line.z, self.medium, line.decay) * line.smoothing for datum in self.data]

    @cached_property
    def _alike(self) -> tuple[np.ndarray, np.ndarray]:
        return alike_along(self.medium.stencil, self.along)

    def heard(self, size: float, told: float) -> tuple[np.ndarray, float]:
        """Numbers of the frequencies that matter, and the sum of amplitudes that may be left out at these, where the
        largest value is at least `size` and the part `told` of it has to be resolved.
        """
        possible, steps = self._travelling(), self.line.steps
        sparse = np.abs(self.arrived(possible, slice(None, None, _SPARSE)).amplitude)
        loudness = sparse.max(1) * self.along.shape[1]
        largest = max(size * 2 * steps * np.exp(-self.line.folded), _COHERENT * _SPARSE * float(sparse.sum()))
        threshold = _FELT * told * largest  # for the sum of all amplitudes left out, half of it by frequencies
        return possible[loudest(loudness, 0.5 * threshold)], 0.5 * threshold

    def _travelling(self) -> np.ndarray:
        """Numbers of the frequencies at which there may be significant waves.

        Nothing travels above the highest frequency of the medium, where only the shortest pulses have any content. At
        least one, for runs of a few short steps.
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
        """Factors per node, amplitudes and slownesses of waves of one component or type."""
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
        """Factors per node and slopes of modes in a medium whose squared speed, over that at the side, is `ratio`."""
        alike, number = self._alike
        used, again = np.unique(number[some], return_inverse=True)
        slower = self.medium.slower(ratio)
        solve = all_modes if self.every else slowest_modes
        root, slope = solve(slower, slower.recursion.eigenvalue(z), alike[:, used])
        return root[..., again], slope[..., again]


def _through(datum: Datum, rows: np.ndarray, modes_of: Callable[[float], tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Amplitudes of a datum in the modes of the medium at the side, transmitted from a slower one where part of it lies
    there.
    """
    root, slope = modes_of(1.0)
    nodes, ratio = datum.behind or (len(rows), 1.0)
    sent = sent_in_mode(rows[len(rows) - nodes :], root, slope)
    if datum.behind is None:
        return sent
    return np.asarray(sent + _PASSED * root**nodes * sent_in_mode(rows[: len(rows) - nodes], *modes_of(ratio)))


class _CoarseSide(NamedTuple):
    """Sampling points along a side, just enough to represent some modes.

    Attributes
    ----------
    counts : list of int
        Number of points along each tangential axis.
    grid : ndarray of int, shape (m,)
        Place of each mode in the array of wavenumbers of that many points.
    seen : list of ndarray of int
        Points along each axis that are beside the near field.
    """

    counts: list[int]
    grid: np.ndarray
    seen: list[np.ndarray]

    def places(self, frequencies: np.ndarray, modes: int) -> np.ndarray:
        """Places of waves in the array of all frequencies and wavenumbers, shape (frequencies, modes)."""
        every = np.tile(self.grid, modes // len(self.grid))
        return np.asarray(frequencies[:, None] * int(np.prod(self.counts)) + every)


def _coarse_side(along: np.ndarray, lengths: Sequence[int], near: Sequence[range]) -> _CoarseSide:
    """The sampling points for modes of given tangential wavenumbers along a near field."""
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
    """Tangential wavenumbers of all waves, where each wavenumber has several modes."""
    every = np.tile(along, waves[1] // along.shape[1])[:, None, :]
    return np.broadcast_to(every, (len(along), *waves)).reshape(len(along), int(np.prod(waves)))


def round_a_point(values: np.ndarray, place: Sequence[int] | np.ndarray, room: float) -> tuple[np.ndarray, np.ndarray]:
    """Represent data in space by waves that are axially symmetric about a line along the normal. These determine the
    field on that line completely where the medium is uniform in all directions along the side.

    Parameters
    ----------
    values : ndarray, shape (rows, nodes, nodes)
    place : sequence of int
        Node through which the line runs.
    room : float
        Nodes beyond the farthest of the data at which the waves end, at zeros of Bessel functions.

    Returns
    -------
    ndarray, shape (2, modes)
        Tangential wavenumbers times spacing, in the direction midway between those in which a lattice differs most.
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
    """Fourier coefficients along the side of values on rows, shape (rows, modes), for data that are periodic with some
    lengths and are smoothed by a Gaussian.
    """
    if not smooth:
        axes = tuple(range(1, values.ndim))
        found = fft.fftn(values, s=lengths, axes=axes) / np.prod(lengths) if axes else values
    else:  # few modes of a long side
        found = values
        for line, length in zip(numbers, lengths, strict=True):
            waves = np.exp(-1j * np.outer(np.arange(found.shape[1]), line) - 0.5 * (smooth * line) ** 2) / length
            found = np.tensordot(found, waves, (1, 0))  # the new axis comes last, so that the next axis is second again
    return np.asarray(found).reshape(len(values), -1)


def _start(datum: Datum, z: np.ndarray, medium: LatticeMedium, decay: float) -> np.ndarray:
    """Transform ``sum_n u_n z^-n`` of the right-hand side that the scheme makes of a unit datum, over its factor
    `scale`.
    """
    recursion, dt = medium.recursion, medium.dt
    if datum.kind == "u":
        return (z - recursion.keep + (recursion.first - 1) * (z - 1) * (1 - recursion.keep / z)) / recursion.scale
    if datum.kind == "v":
        return np.full(z.shape, 2 * recursion.keep * recursion.first * dt / recursion.scale, complex)
    steps = len(z) - 1
    samples = datum.time * np.exp(-decay * dt * np.arange(len(datum.time)))
    samples[0] *= recursion.first
    return fft.rfft(samples, 2 * steps)
