"""What a layer sends back of the waves that a run really has: its error, predicted before the run.

A layer sees the near field's data as they arrive at its side. Along the side they are a sum of Fourier modes, in time a
Laplace integral on the line Re s = a, a few times the inverse of the length of the run: there travelling, grazing,
evanescent and static waves are alike, and none needs a rule of its own. For each s and tangential wavenumber the medium
in front of the side is a chain. Of its modes the slowest, of factor zeta over a node, carries the data u0 to the side,

    U = N(z) sum_x u0(x) zeta^(distance of x) / (zeta dA/dzeta),    A(zeta) = (z - 1)(1 - keep/z)/scale,    z = exp(s
    dt),

where N(z) is what the start of the scheme makes of displacements, of velocities or of a source in time. What comes back
is U times the layer's reflection R(s, zeta), which is known in closed form, and fast Fourier transforms lead back to
the error at the last node before the layer, at all times; and, times its mode's factor for each node of the way, in the
middle of the near field, where the echoes of all sides meet. This is exact for one flat side and one mode. Wide
stencils have more modes, so the prediction is good to a small factor: enough to choose a thickness by, since the error
falls by a factor of three to ten with each node. Where the data hold waves that run backward all modes are followed, of
vectors in the plane P and S waves of both components together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np
from scipy import fft, special

from farhorizon.analysis.layers.choice import weak
from farhorizon.analysis.layers.layer import ArrivingWave, LatticeMedium, WavesAtFrequency, amplitudes_of
from farhorizon.analysis.layers.reflection import factor_of_wave, polarisations
from farhorizon.analysis.layers.short_waves import high_pass, short_share
from farhorizon.engine.engine import Layer
from farhorizon.errors import InputError
from farhorizon.medium.stencil import Stencil

# on the line Re s = _DECAY/T what happens after 2 T folds back into the run, exp(-2 _DECAY) times as large; where waves
# are followed each by itself, what is left out of them grows as exp(_DECAY)
_DECAY, _DECAY_EACH = 6.0, 4.0
_NEWTON, _LONGEST = 12, 0.3  # iterations from the root of long waves, and the largest change of log zeta in one of them
_SETTLED = 1e-8  # relative residual of a root
_FELT = 0.02  # share of the wanted error that waves which are left out may make together
_FINER = 2  # moments and places at which the largest value is looked for, over the fewest that hold the waves
# on a line, where waves are few, less by as much as layers amplify some that fall within a node or two
_AMPLIFIED = 1e-6
_UNHEARD = 0.05  # and of what comes back of those that are followed each by itself
_FELT_BACKWARD = 0.3  # share of the wanted error that backward waves in the data are looked for from
# of the first backward wavenumber, from which on forward waves have its frequency nearly, and leave as backward ones;
# of scalars: what is known of vectors that way is too large for a few such waves
_TURNING = 0.8
_COMPARED = 2000  # waves by which layers are compared
_EACH = 1500  # waves of a line that are followed each by itself although none is a backward one, at most: a second
# such waves where backward ones are among them: those that show what a layer is not enough for, and all, at most
_FIRST, _MOST_EACH = 300, 4000
_TOO_MUCH = 5.0  # what the first of them must make over what is enough: without the others they ring
_COHERENT = 0.05  # the largest value over the sum of all amplitudes, at least
_SPARSE = 8  # every so many tangential modes tell which frequencies are felt
_PASSED = 2.0  # of a wave's displacement, the most that an interface lets through into a faster medium
_HELD = 7.0  # widths of a Gaussian in the transform of smoothed data: exp(-24) remains
# over the length of the run: the band of frequencies in which waves fade out; and what of a wave is nothing
_FADES, _FADED = 10.0, 1e-6
_BETWEEN = np.pi / 8  # of the directions of a square lattice
_STATIC = 1e-9  # eigenvalue over the rate at which modes that do not travel are told from the longest waves
# of the modes of a chain: relative residual, where two nearly coincide, and the least factor over a node
_ROUGH, _GONE = 1e-6, 1e-6
_NEARLY = 0.01  # and the largest change of log zeta in an iteration from such a root
_FLAT = 1e-14  # of a polynomial's largest coefficient, the least of the first one: what dies out at once
# parts of a factor e of frequency, of decay or wavenumber over a node, and of slowness: waves of one such cell return
# alike. Where forward waves meet backward ones, what comes back changes by a hundred within a third of the wavenumber;
# of vectors, whose samples tell too much as they are, layers for 1e-4 had twice the nodes with as fine cells
_CELLS, _CELLS_OF_VECTORS = (2.5, 10.0, 2.5), (2.5, 2.5, 2.5)


@dataclass(frozen=True)
class Datum:
    """A field of the data at one side.

    Attributes
    ----------
    values : ndarray
        On the near field, the first axis along the normal and towards the side.
    kind : {"u", "v", "source"}
        Values or velocities at the start, or a source, ``u_tt = .. + values time``.
    time : ndarray, shape (steps,)
        Of a source, its factor at each step; empty otherwise.
    component : int
        Of a field of vectors, the one whose values these are.
    behind : tuple of (int, float), or None
        Number of nodes next to the side beyond which the medium is slower, and its squared speed over that at the side.
        Waves keep their frequency at such an interface, so that they arrive longer than they set out.
    """

    values: np.ndarray
    kind: str
    time: np.ndarray = field(default_factory=lambda: np.zeros(0))
    component: int = 0
    behind: tuple[int, float] | None = None

    def turned(self, axis: int, side: int) -> Datum:
        """The same with an axis first, and towards its lower (-1) or upper (1) end."""
        values = np.moveaxis(self.values, axis, 0)
        return replace(self, values=values if side > 0 else values[::-1])

    def with_entrance(self) -> Datum:
        """The same with the node between the side that it is turned to and the layer, which holds nothing."""
        values = np.pad(self.values, [(0, 1), *[(0, 0)] * (self.values.ndim - 1)])
        behind = self.behind and (self.behind[0] + 1, self.behind[1])
        return replace(self, values=values, behind=behind)


class Sample:
    """Waves of one type that stand for all that are like them in frequency, and in how and how fast they go on along
    the normal, on one line of the Laplace integral: nearer to the axis, in longer runs, some come back much stronger.

    Parameters
    ----------
    medium : LatticeMedium
    kind : int
        Number of the type among `farhorizon.analysis.layers.reflection.types_of`.
    """

    def __init__(self, medium: LatticeMedium, kind: int = 0) -> None:
        self.medium, self.kind = medium, kind
        self._waves: list[ArrivingWave | None] = []
        self._cells: dict[tuple[int, ...], int] = {}
        self._known: dict[bytes, np.ndarray] = {}
        self._followed: dict[tuple[complex, ...], ArrivingWave | None] = {}
        self._every: dict[tuple[complex, ...], WavesAtFrequency] = {}
        self._came_back: dict[bytes, dict[tuple[complex, ...], tuple[np.ndarray, np.ndarray]]] = {}

    def needed(self, layer: Layer) -> bool:
        """Whether a layer sends back more than the wave that comes, whose reflection has a closed form: other types,
        and what of a wide stencil dies out over some nodes.
        """
        stencil = self.medium.stencil
        return bool(layer.damping.size) or stencil.components > 1 or stencil.reach[0] > 1

    def add(
        self,
        amplitude: np.ndarray,
        root: np.ndarray,
        factor: np.ndarray,
        along: np.ndarray,
        slowness: np.ndarray,
        shape: np.ndarray | None = None,
    ) -> np.ndarray:
        """Take in waves, arrays as of `Arrivals` and the steps that each takes over a node; returns the number of the
        wave that each is like, the loudest that came first. Without shapes all are of the sample's type.

        Waves that hardly move come back as they come, while others of nearly their frequency are absorbed.
        """
        finite, medium = np.where(amplitude == 0, 0.5, root), self.medium
        slow = np.maximum(1.0, np.abs(slowness) * medium.speed * medium.dt / medium.spacing)
        sizes = np.abs(np.log(factor)), np.abs(np.log(finite)), slow
        logs = np.log(np.maximum(sizes, 1e-12))
        parts = _CELLS if medium.stencil.components == 1 else _CELLS_OF_VECTORS
        cells = np.floor(np.array(parts)[:, None] * logs).astype(int).T
        if shape is not None:  # along the normal or across it
            cells = np.append(cells, np.abs(shape[:1].T) ** 2 > 0.5, axis=1)
        found, number = np.unique(cells, axis=0, return_inverse=True)
        number = number.ravel()
        order = np.lexsort((-np.abs(amplitude), number))
        first = order[np.searchsorted(number[order], np.arange(len(found)))]
        places = np.zeros(len(found), int)
        for i, cell in enumerate(map(tuple, found.tolist())):
            if cell not in self._cells:
                self._cells[cell] = len(self._waves)
                one = first[i]
                of = None if shape is None else shape[:, one]
                self._waves.append(self.wave(complex(root[one]), complex(factor[one]), along[:, one], of))
            places[i] = self._cells[cell]
        return places[number]

    def wave(
        self, root: complex, factor: complex, along: np.ndarray, shape: np.ndarray | None = None
    ) -> ArrivingWave | None:
        """A wave with all modes of the medium; None where none comes to the side. Its shape is that of the sample's
        type unless given. Several modes of one frequency and wavenumber may come, of different types.
        """
        stencil, azimuth = self.medium.stencil, float(np.arctan2(along[-1], along[0])) if len(along) > 1 else 0.0
        angle = float(np.arctan2(np.linalg.norm(along), np.abs(np.log(root))))
        if shape is None:
            shape = polarisations(stencil.components, stencil.dim, angle, azimuth)[self.kind]
        key = factor, *along.tolist()
        if key not in self._every:
            self._every[key] = self.medium.waves(along, factor)
        try:
            return self._every[key].coming(root, shape)
        except InputError:
            return None

    def judged(self, layer: Layer) -> np.ndarray:
        """Of each wave of the sample the reflected amplitude, of all types together, and by how much it is above the
        closed form; shape (2, waves).
        """
        key = _key(layer)
        known = self._known.get(key, np.zeros((2, 0)))
        new = self._waves[known.shape[1] :]
        more, waves = np.zeros((2, len(new))), [wave for wave in new if wave is not None]
        if waves:
            more[:, [wave is not None for wave in new]] = _judged(waves, layer)
        self._known[key] = np.append(known, more, axis=1)
        return self._known[key]

    def followed(
        self, layer: Layer, waves: Sequence[tuple[complex, complex]], along: np.ndarray, shape: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of waves, each by itself, the amplitudes of all modes that leave the layer, arrays (modes, d), and their
        factors over a node; no modes where none comes to the side.

        Other sides, and the mirror images of waves along the side, ask for the same ones.

        Parameters
        ----------
        layer : Layer
        waves : sequence of (complex, complex)
            Factors over a node and over a step.
        along : ndarray, shape (waves, dim - 1)
            Tangential wavenumbers.
        shape : ndarray, shape (waves, d)
            Polarisations, of length 1.
        """
        known = self._came_back.setdefault(_key(layer), {})
        sign = np.ones(shape.shape)
        if shape.shape[1] > 1:  # in the mirror image the component along the side has another sign
            sign[along[:, 0] < 0, 1] = -1
            along, shape = np.abs(along), shape * sign
        names = [
            (*map(_rounded, wave), *(map(_rounded, one.tolist()) if len(one) > 1 else ()))
            for wave, one in zip(waves, shape, strict=True)
        ]
        asked = {name: i for i, name in enumerate(names)}
        for key, i in asked.items():
            if key not in self._followed:
                self._followed[key] = self.wave(*waves[i], along[i], shape[i])
        there = [(key, wave) for key in asked if key not in known and (wave := self._followed[key]) is not None]
        amplitudes = amplitudes_of([wave for _, wave in there], layer) if there else []
        for (key, wave), one in zip(there, amplitudes, strict=True):
            known[key] = one[:, None] * wave.modes.vectors, wave.modes.leaving
        nothing = np.zeros((0, shape.shape[1])), np.ones(0)
        found = [known.get(name, nothing) for name in names]
        return [(came * one, leaving) for (came, leaving), one in zip(found, sign, strict=True)]


def _key(layer: Layer) -> bytes:
    arrays = layer.kappa, layer.sigma, layer.alpha, layer.damping, layer.tuned
    return b"".join(array.tobytes() for array in arrays)


def _rounded(number: complex) -> complex:
    """By which waves that are the same are known."""
    return complex(round(number.real, 9), round(number.imag, 9))


def _judged(waves: Sequence[ArrivingWave], layer: Layer) -> np.ndarray:
    """Of waves the exact reflection, never more than all, and by how much it is above the closed form: of what travels,
    or of all that is at the last node of the near field, one from the layer, where wide stencils leave what dies out;
    shape (2, waves).
    """
    closed = np.abs(reflected(np.array([w.modes.incoming for w in waves]), np.array([w.s for w in waves]), layer))
    exact = np.zeros(len(waves))
    for i, (wave, amplitudes) in enumerate(zip(waves, amplitudes_of(waves, layer), strict=True)):
        beside = float(np.linalg.norm((amplitudes / wave.modes.leaving) @ wave.modes.vectors))
        exact[i] = min(1.0, max(float(np.linalg.norm(amplitudes[wave.modes.travels])), beside))
    return np.stack([exact, np.maximum(0.0, exact - closed)])


@dataclass(frozen=True)
class Arrivals:
    """Waves as they arrive at the last node before a layer; n of them, by frequency and tangential wavenumber.

    Attributes
    ----------
    medium : LatticeMedium
    amplitude : ndarray of complex, shape (n,)
    root : ndarray of complex, shape (n,)
        Factor of each over one node towards the side.
    factor : ndarray of complex, shape (n,)
        Factor of each over one step.
    along : ndarray, shape (dim - 1, n)
        Tangential wavenumbers of each, times spacing.
    place : ndarray of int, shape (n,)
        Of each in the array of all frequencies and tangential wavenumbers.
    shape : tuple of int
        Of that array, frequencies first: no more than the waves need.
    growth : ndarray, shape (times,)
        exp(a t) at so many moments of the run, times what the transforms divide by.
    seen : list of ndarray of int
        Of the places along each tangential axis, those beside the near field.
    sample : Sample
        Waves whose exact reflections are known, and
    number : ndarray of int, shape (n,)
        which of them each wave is like.
    silent : float
        Sum of amplitudes that nobody hears, for data of which the largest is 1.
    size : float
        The largest of the data, as far as it is known.
    every : bool
        Whether all modes of the medium in front are among the waves, as backward waves ask for.
    depths : tuple of int
        Nodes from the side to where echoes of all sides meet: to the middle of the near field; and to the middle of the
        data, where waves that hardly move come together again, for those that arrive a little below the largest
        frequency as forward waves leave as backward ones, in the direction that they came from.
    axes : int
        Along so many there are layers.
    shapes : ndarray of complex, shape (d, n)
        Polarisations of all modes of a medium of vectors, of length 1; 1 of waves that are of one type.
    """

    medium: LatticeMedium
    amplitude: np.ndarray
    root: np.ndarray
    factor: np.ndarray
    along: np.ndarray
    place: np.ndarray
    shape: tuple[int, ...]
    growth: np.ndarray
    seen: list[np.ndarray]
    sample: Sample
    number: np.ndarray
    silent: float = 0.0
    size: float = 0.0
    every: bool = False
    depths: tuple[int, ...] = ()
    axes: int = 1
    shapes: np.ndarray = field(default_factory=lambda: np.ones((1, 1)))

    @cached_property
    def frequency(self) -> np.ndarray:
        """The discrete s of each, ``2/dt (z - 1)/(z + 1)``."""
        return 2 / self.medium.dt * (self.factor - 1) / (self.factor + 1)

    def returned(self, layer: Layer, enough: float = np.inf) -> float:
        """Largest value, over the run and along the side, of what a layer sends back.

        Inside the near field it meets as much from each of the other sides, while what an aim leaves is for the two
        sides of one axis.
        What the closed form does not know, such as the damping of short waves, is known of a sample: it counts by its
        share of the waves' energy. As a sum of waves each step from one sample to the next would be noise, which the
        Laplace integral lets grow. On a line, which has so few waves that there is time for each, and where backward
        waves are among them, they are followed each by itself.

        Parameters
        ----------
        layer : Layer
        enough : float, optional
            Where the loudest waves alone make five times that, no others are followed.
        """
        if not self.sample.needed(layer):
            return self._over_the_field(self.amplitude * self._closed(layer, slice(None)))
        few = len(self.along) == 0 and len(self.amplitude) <= _EACH
        if self.every or (self.medium.stencil.components == 1 and few):
            return self._each(layer, enough)
        closed = self._over_the_field(self.amplitude * self._closed(layer, slice(None)))
        return closed + self._by_energy(np.abs(self.amplitude) * self._excess(layer, slice(None)))

    def _over_the_field(self, back: np.ndarray, inside: Sequence[np.ndarray] | None = None) -> float:
        """Largest value beside the layer and inside the near field of what comes back of each wave."""
        found = self._largest(back)
        if self.axes > 1:
            inside = [back * self.root**depth for depth in self.depths] if inside is None else inside
            found = max([found, *(self.axes * self._largest(one) for one in inside)])
        return found

    def _by_energy(self, back: np.ndarray) -> float:
        """The largest of all waves by the share of their energy that is in some amplitudes."""
        return float(self.largest * np.linalg.norm(back) / max(float(np.linalg.norm(self.amplitude)), 1e-300))

    def _each(self, layer: Layer, enough: float) -> float:
        """Largest value of what comes back of waves, of which the loudest are followed each by itself."""
        loud = np.abs(self.amplitude) * self.sample.judged(layer)[0, self.number]
        heard = _largest(loud, self.silent * max(self.size, self.largest))
        heard = heard[_loudest_first(loud[heard], _MOST_EACH)]
        for most in (_FIRST, _MOST_EACH):
            back = self.amplitude * self._exact(layer, heard[:most])
            rest = np.zeros_like(loud)
            rest[heard[most:]] = loud[heard[most:]]
            found = max(self._over_the_field(one[0], one[1:]) for one in back)
            if found > _TOO_MUCH * enough or len(heard) <= most:
                break
        return found + self._by_energy(rest)

    def _exact(self, layer: Layer, some: np.ndarray) -> np.ndarray:
        """What comes back of some waves of amplitude 1, by component, one node from the layer and inside the near
        field; 0 of the others.
        """
        shapes = np.broadcast_to(self.shapes, (len(self.shapes), len(self.amplitude)))
        found = np.zeros((len(shapes), 1 + len(self.depths), len(self.amplitude)), complex)
        nodes = -np.array([1.0, *self.depths])[:, None]
        keys = [(complex(self.root[one]), complex(self.factor[one])) for one in some.tolist()]
        for one, (amplitude, leaving) in zip(
            some.tolist(), self.sample.followed(layer, keys, self.along[:, some].T, shapes[:, some].T), strict=True
        ):
            found[:, :, one] = amplitude.T @ (leaving**nodes).T
        return found

    def share(self, layer: Layer) -> float:
        """Root of the share of the waves' energy that comes back, from a part of them: quick, to compare layers by."""
        some = slice(None, None, 1 + len(self.amplitude) // _COMPARED)
        back = self.amplitude[some] * (np.abs(self._closed(layer, some)) + self._excess(layer, some))
        return float(np.linalg.norm(back) / max(float(np.linalg.norm(self.amplitude[some])), 1e-300))

    def _closed(self, layer: Layer, some: slice) -> np.ndarray:
        """Reflection of some waves by the closed form.

        It lets backward waves grow, which the layer's damping takes: of them as much comes back as of those that stand
        for them, or all.
        """
        found = reflected(self.root[some], self.frequency[some], layer)
        sizes = np.abs(found)
        grown = sizes > 1
        if grown.any():
            exact = self.sample.judged(layer)[0, self.number[some][grown]] if self.sample.needed(layer) else 1.0
            found[grown] *= exact / sizes[grown]
        return found

    def _excess(self, layer: Layer, some: slice) -> np.ndarray:
        """By how much the reflected amplitudes of some waves are above the closed form, by the waves that stand for
        them."""
        alike = self.number[some]
        return self.sample.judged(layer)[1, alike] if self.sample.needed(layer) else np.zeros(len(alike))

    @cached_property
    def largest(self) -> float:
        """Largest value, over the run and along the side, of the waves themselves."""
        return max(self._largest(self.amplitude * component) for component in self.shapes)

    @cached_property
    def _rows(self) -> np.ndarray:
        """Frequencies at which there are waves."""
        return np.unique(self.place // int(np.prod(self.shape[1:])))

    def _largest(self, amplitude: np.ndarray) -> float:
        """Largest value of a sum of waves, by inverse transforms in time and along the side."""
        spectrum = np.zeros(int(np.prod(self.shape)), complex)
        np.add.at(spectrum, self.place, amplitude)
        along = tuple(range(1, len(self.shape)))
        if along:
            spectrum = spectrum.reshape(self.shape)
            spectrum[self._rows] = fft.ifftn(spectrum[self._rows], axes=along)
        times = len(self.growth)
        history = fft.irfft(spectrum[np.ix_(np.arange(self.shape[0]), *self.seen)], 2 * times, axis=0)[:times]
        return float((np.abs(history).max(along) * self.growth).max())


_BLOCK = 4096  # waves that `reflected` takes at a time


def reflected(root: np.ndarray, frequency: np.ndarray, layer: Layer) -> np.ndarray:
    """Reflection of a layer for modes of given factors over a node: the way to its outer end and back.

    Parameters
    ----------
    root, frequency : ndarray of complex, shape (n,)
        As in `Arrivals`.
    layer : Layer
        Its damping of short waves is not looked at.

    Returns
    -------
    ndarray of complex, shape (n,)
    """
    found = np.empty_like(root)
    for first in range(0, len(root), _BLOCK):  # what an edge takes stays in the cache for the next
        part = slice(first, first + _BLOCK)
        cosine, sine, passed = 1 + root[part], 1 - root[part], np.ones_like(root[part])
        for edge, (kappa, sigma, alpha) in enumerate(zip(layer.kappa, layer.sigma, layer.alpha, strict=True)):
            shifted = frequency[part] + alpha
            stretched, plain = (kappa * shifted + sigma) * sine, shifted * cosine
            if edge == layer.columns:
                passed *= passed  # there and back; the last edge is the end, which is passed once
            passed *= (plain - stretched) / (plain + stretched)
        found[part] = passed
    return found


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
    lowest: float = 0.0,
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
    lowest : float, optional
        Frequency from which on waves are followed, see `frequency_of_slow_waves`; the others fade out below it.
    """
    front, sample = medium, sample or Sample(medium)
    every = every and all(datum.behind is None for datum in data)
    vectors = every and front.stencil.components > 1
    medium = front if vectors else medium.carrier(sample.kind)
    folded = _DECAY_EACH if every or not (lengths or radial is not None) else _DECAY
    decay = folded / (steps * medium.dt)
    z = np.exp(decay * medium.dt + 1j * np.pi * np.arange(steps + 1) / steps)
    numbers = [2 * np.pi * np.fft.fftfreq(length) for length in lengths]
    numbers = [line[np.abs(line) * smooth <= _HELD] for line in numbers]
    if radial is None:
        spectra = [_along_side(datum.values, numbers, lengths, smooth) for datum in data]
    else:
        numbers, lengths, near = [], [], []
        spectra = [datum.values * np.exp(-0.5 * smooth**2 * (radial**2).sum(0)) for datum in data]
    sizes = [np.abs(spectrum).sum(0) for spectrum in spectra]
    # about the point that faces them data that are odd there are nothing
    content = np.max([size / max(float(size.sum()), 1e-300) for size in sizes], axis=0)
    modes = _largest(content, 0.1 * _FELT * wanted)
    if radial is not None:
        along = radial[:, modes]
    else:
        every_number = np.meshgrid(*numbers, indexing="ij")
        along = np.array([k.ravel()[modes] for k in every_number]) if numbers else np.zeros((0, 1))
    lasting = smooth * medium.spacing / front.speed
    complete = np.log(z) / medium.dt
    # analytic, so that nothing rings which the Laplace integral would let grow
    taken = special.erfc((lowest + 1j * complete) * (steps * medium.dt / _FADES)) / 2 if lowest else np.ones(1)
    starts = [taken * _start(datum, z, medium, decay) * np.exp(0.5 * (lasting * complete) ** 2) for datum in data]

    alike, number = _alike(medium.stencil, along)

    def arrived(which: np.ndarray, some: slice) -> tuple[np.ndarray, ...]:
        parts = [spectrum[:, modes][:, some] for spectrum in spectra]
        if vectors:
            held = [
                (datum.component, rows, start[which]) for datum, rows, start in zip(data, parts, starts, strict=True)
            ]
            return _vectors_arrived(medium, z[which], along[:, some], held)
        used, again = np.unique(number[some], return_inverse=True)

        @cache
        def modes_of(ratio: float) -> tuple[np.ndarray, np.ndarray]:
            slower = medium.slower(ratio)
            solve = _all_modes if every else _slowest
            root, slope = solve(slower, slower.recursion.eigenvalue(z[which]), alike[:, used])
            return root[..., again], slope[..., again]

        root, slope = modes_of(1.0)
        total = np.zeros(root.shape, complex)
        for datum, rows, start in zip(data, parts, starts, strict=True):
            nodes, ratio = datum.behind or (len(rows), 1.0)
            sent = _sent(rows[len(rows) - nodes :], root, slope)
            if datum.behind is not None:
                sent = sent + _PASSED * root**nodes * _sent(rows[: len(rows) - nodes], *modes_of(ratio))
            total += sent * start[which][:, None]
        rise = medium.recursion.scale * np.where(slope == 0, 1, slope)
        slowness = (medium.recursion.keep / z - z)[which][:, None] / rise
        found = root, np.where(slope == 0, 0, total), np.where(slope == 0, 0, slowness)
        return tuple(np.concatenate(part, axis=1) if part.ndim > 2 else part for part in found)

    few = slice(None, None, _SPARSE)
    pitch = np.abs(medium.recursion.eigenvalue(z))
    # nothing travels beyond, where only the shortest pulses have anything; one at least, of runs of a few short steps
    highest = np.inf if every else 1.2 * medium.rate * medium.stencil.symbol_maximum
    highest = min(highest, (_HELD / lasting) ** 2 if smooth else np.inf)
    heard = np.flatnonzero((pitch <= max(highest, pitch.min())) & (np.abs(taken) > _FADED))
    sparse = np.abs(arrived(heard, few)[1])
    loudness = sparse.max(1) * len(modes)
    largest = max(size * 2 * steps * np.exp(-folded), _COHERENT * _SPARSE * float(sparse.sum()))
    told = wanted * (_AMPLIFIED if every and reach_the_end(front, data, wanted) else 1.0)
    threshold = _FELT * told * largest  # of the sum of all amplitudes that are left out
    heard = heard[_largest(loudness, 0.5 * threshold)]
    root, amplitude, slowness, *shapes = arrived(heard, slice(None))
    kinds = root.shape[1] // along.shape[1]  # modes of each tangential wavenumber
    felt = _largest(np.abs(amplitude).ravel(), 0.5 * threshold)
    times = _FINER * (int(heard[-1]) + 1)  # a coarser sampling of time and place than the run's holds all that is heard
    signed = [np.round(line / (2 * np.pi) * length).astype(int) for line, length in zip(along, lengths, strict=False)]
    counts = [fft.next_fast_len(_FINER * (2 * int(np.abs(line).max()) + 1)) for line in signed]
    seen = [
        np.unique(np.round(np.linspace(nodes[0], nodes[-1], count) / length * count).astype(int) % count)
        for nodes, length, count in zip(near, lengths, counts, strict=True)
    ]
    grid = (
        np.ravel_multi_index([line % count for line, count in zip(signed, counts, strict=True)], counts)
        if counts
        else np.zeros(along.shape[1], int)
    )
    place = (heard[:, None] * int(np.prod(counts)) + np.tile(grid, kinds)).ravel()[felt]
    factor = np.broadcast_to(z[heard][:, None], root.shape).ravel()[felt]
    along = np.tile(along, kinds)[:, None, :]
    along = np.broadcast_to(along, (len(along), *root.shape)).reshape(len(along), root.size)[:, felt]
    growth = np.exp(decay * medium.dt * steps / times * np.arange(times)) * (times / steps) * np.prod(counts)
    amplitude, root, slowness = amplitude.ravel()[felt], root.ravel()[felt], slowness.ravel()[felt]
    shape = shapes[0].reshape(len(shapes[0]), -1)[:, felt] if shapes else None
    number = sample.add(amplitude, root, factor, along, slowness, shape)
    silent = _UNHEARD * told * 2 * steps * np.exp(-folded)
    found = Arrivals(
        front,
        amplitude,
        root,
        factor,
        along,
        place,
        (times + 1, *counts),
        growth,
        seen,
        sample,
        number,
        silent,
        size,
        every,
    )
    return found if shape is None else replace(found, shapes=shape)


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


def _slowest(medium: LatticeMedium, eigenvalue: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factor over a node and ``zeta dA/dzeta`` of the mode that reaches farthest; shape (frequencies, tangential
    modes).

    The slope is zero where the lattice carries no such wave.
    """
    stencil, rate = medium.stencil, medium.rate
    lines = _lines(stencil, along)
    target = eigenvalue[:, None] / rate
    squared = (4 * np.sin(along / 2) ** 2).sum(0) + stencil.reaction
    exponent = -np.sqrt(target + squared)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for _ in range(_NEWTON):
            value, slope = _chain(lines, np.exp(exponent))
            change = (value - target) / slope
            length = np.abs(change)
            exponent = exponent - change * np.minimum(1, _LONGEST / np.maximum(length, 1e-300))
            if not (length > 1e-10).any():
                break
        root = np.exp(exponent)
        value, slope = _chain(lines, root)
        carried = (np.abs(value - target) < _SETTLED * np.abs(target)) & (np.abs(root) < 1)
    return np.where(carried, root, 0.5), np.where(carried, rate * slope, 0.0)


def hold_backward_waves(medium: LatticeMedium, data: Sequence[Datum], wanted: float) -> bool:
    """Whether data hold waves of which some run backward and are felt, so that all modes of the chain in front of a
    side are to be followed; in a medium that varies they are not, nor are vectors but in the plane.
    """
    stencil = medium.stencil
    plane = stencil.components == stencil.dim == 2 and all(stencil.even_along(axis) for axis in range(2))
    damped = high_pass(stencil) if stencil.components == 1 or plane else None
    if damped is None or weak(damped):
        return False
    first = damped.first * (_TURNING if stencil.components == 1 else 1.0)
    return any(
        short_share(datum.values, first) * _briskness(medium, first, datum.time) > _FELT_BACKWARD * wanted
        for datum in data
        if datum.values.any()
    )


def reach_the_end(medium: LatticeMedium, data: Sequence[Datum], wanted: float) -> bool:
    """Whether data at the end of a line are felt in front of the layer by waves, too, that do not travel: some of these
    a layer amplifies, and all modes are to be followed. Along a side long waves that graze it set more than they do.
    """
    if medium.stencil.dim > 1 or medium.stencil.reach[0] == 1:
        return False
    roots = _all_modes(medium, np.array([_STATIC * medium.rate + 0j]), np.zeros((0, 1)))[0]
    fall = np.sort(np.abs(roots.ravel()))[-2]
    sizes = [np.abs(datum.values) for datum in data if datum.values.any()]
    return any(size[::-1] @ fall ** np.arange(len(size)) > _FELT_BACKWARD * wanted * size.max() for size in sizes)


def frequency_of_slow_waves(medium: LatticeMedium, speed: float) -> float:
    """The frequency from which on no wave is faster than a speed; all of them, if there are none so slow.

    Those of the largest frequency stand still, and others about them go slowly, forward and backward.
    """
    _, values, slopes = medium.stencil.zone_branches
    turn = np.minimum(medium.dt * np.sqrt(np.maximum(medium.rate * values, 0.0)) / 2, 1.0)
    # of the steps: d(omega)/dk with sin(omega dt / 2) = turn
    rise = medium.spacing * medium.rate * np.sqrt(sum(slope**2 for slope in slopes)) * medium.dt
    fast = rise > speed * 4 * turn * np.sqrt(1 - turn**2)
    return float(2 * np.arcsin(turn[fast].max(initial=0.0)) / medium.dt)


def _briskness(medium: LatticeMedium, first: float, course: np.ndarray) -> float:
    """What a source that follows a course in time sends of waves from a wavenumber times spacing on, over what it sends
    of them if it is switched on at once; 1 for what is there at the start.

    A field that follows its source slowly is none of waves: these are as large as the source changes at their
    frequency.
    """
    if not course.any():
        return 1.0
    line = np.linspace(first, np.pi, 9)
    symbol = medium.stencil.symbol(line, *[np.zeros_like(line)] * (medium.stencil.dim - 1))
    values = symbol if medium.stencil.components == 1 else np.linalg.eigvalsh(symbol).ravel()
    turns = np.angle([factor_of_wave(-medium.rate * float(one), medium.recursion) for one in values])
    changes = np.diff(course, prepend=0.0)
    heard = np.abs(np.exp(-1j * np.outer(turns, np.arange(len(course)))) @ changes).max()
    return min(1.0, float(heard / np.abs(course).max()))


def _all_modes(medium: LatticeMedium, eigenvalue: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of all modes that come from a distance, as `_slowest`; shape (modes, frequencies, tangential modes).

    The eigenvalue is a polynomial of ``(zeta + 1/zeta)/2``, whose roots are eigenvalues of a matrix for its Chebyshev
    series.
    """
    lines = _lines(medium.stencil, along)
    series = np.stack(
        [np.broadcast_to((2 if d else 1) * line, eigenvalue.shape + line.shape) for d, line in enumerate(lines)], -1
    )
    series = series.astype(complex)
    target = (eigenvalue / medium.rate)[:, None]
    series[..., 0] -= target
    root, gone = _factors(series)
    value, slope = _chain(lines, root)
    carried = ~gone & (np.abs(value - target) < _ROUGH * np.abs(series).max())
    return np.where(carried, root, 0.5), np.where(carried, medium.rate * slope, 0.0)


def _factors(series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors over a node, below 1, at which Chebyshev series in ``(zeta + 1/zeta)/2`` are zero, and which of them die
    out at once; shape (degree, ...) for series (..., degree + 1).
    """
    degree = series.shape[-1] - 1
    floor = _FLAT * np.abs(series).max(-1, keepdims=True)
    last = np.where(np.abs(series[..., -1:]) < floor, floor, series[..., -1:])
    matrix = np.zeros((*series.shape[:-1], degree, degree), complex)
    row = np.arange(degree - 1)
    matrix[..., row, row + 1] = 0.5
    matrix[..., row + 1, row] = 0.5
    matrix[..., 0, 1:2] = 1.0
    matrix[..., -1, :] -= series[..., :-1] / (last if degree == 1 else 2 * last)
    half = np.moveaxis(np.linalg.eigvals(matrix), -1, 0)
    grown = half + np.sqrt(half - 1) * np.sqrt(half + 1)  # the other way, by 1 at least
    gone = ~(np.abs(grown) < 1 / _GONE)
    return 1 / np.where(gone, 2.0, grown), gone


@dataclass(frozen=True)
class _PlaneChain:
    """The symmetric matrix of 2 x 2 that a stencil of vectors in the plane is for modes of given tangential
    wavenumbers: along the normal, across, and between both, which changes its sign with the direction.

    Attributes
    ----------
    normal, across, between : ndarray, shape (K + 1, m)
        Weights by distance along the normal.
    """

    normal: np.ndarray
    across: np.ndarray
    between: np.ndarray

    @classmethod
    def of(cls, stencil: Stencil, along: np.ndarray) -> _PlaneChain:
        """For tangential wavenumbers times spacing, shape (1, m)."""
        found = np.zeros((3, stencil.reach[0] + 1, along.shape[1]), complex)
        entries = stencil.weights[:, [0, 1, 0], [0, 1, 1]]
        for offset, entry in zip(stencil.offsets, entries, strict=True):
            if offset[0] >= 0:
                found[:, offset[0]] += np.outer(entry, np.exp(1j * offset[1:] @ along))
        own = stencil.weights.sum(0) + stencil.own
        found[:, 0] -= np.array([own[0, 0], own[1, 1], own[0, 1]])[:, None]
        return cls(*found)

    def at(self, root: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The three entries less an eigenvalue, and their derivatives by the factor's logarithm; shape (3, ...)."""
        parts = [_chain(self.normal, root), _chain(self.across, root), _chain(self.between, root, -1)]
        value, slope = (np.stack(part) for part in zip(*parts, strict=True))
        value[:2] -= target
        return value, slope

    def series(self, target: np.ndarray) -> np.ndarray:
        """The determinant as a Chebyshev series, shape (frequencies, m, degree + 1); eigenvalues (frequencies, 1)."""
        degree = 2 * (len(self.normal) - 1)
        angles = np.exp(2j * np.pi * np.arange(2 * degree + 1) / (2 * degree + 1))[:, None]
        normal, across, between = self.at(np.broadcast_to(angles, (len(angles), self.normal.shape[1])), np.zeros(()))[0]
        sampled = normal * across - between**2, normal + across
        found, trace = (np.fft.fft(part, axis=0)[: degree + 1].T / len(angles) for part in sampled)
        series = found - target[..., None] * trace
        series[..., 0] += target**2
        series[..., 1:] *= 2
        # bonds along the normal alone have no stiffness across it
        held = np.flatnonzero(np.abs(series).max((0, 1)) > _FLAT * np.abs(series).max())
        return np.asarray(series[..., : max(int(held[-1]), 1) + 1])


def _vectors_arrived(
    medium: LatticeMedium, z: np.ndarray, along: np.ndarray, sent: Sequence[tuple[int, np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, ...]:
    """All modes of vectors in the plane that come to a side, by what data send in them: the residues of the inverse of
    their matrix, which are those of its adjugate over the derivative of its determinant.

    Parameters
    ----------
    medium : LatticeMedium
    z : ndarray of complex, shape (frequencies,)
        Factors over a step.
    along : ndarray, shape (1, m)
        Tangential wavenumbers times spacing.
    sent : sequence of (int, ndarray, ndarray)
        Component, rows (rows, m) towards the side, and what the scheme makes of them at each frequency.

    Returns
    -------
    tuple of ndarray
        Factors over a node, amplitudes and steps over a node, shape (frequencies, modes m), and polarisations, shape
        (2, frequencies, modes m); amplitudes are zero where the lattice carries no such wave.
    """
    alike, number = _alike(medium.stencil, along)
    target = (medium.recursion.eigenvalue(z) / medium.rate)[:, None]
    series = _PlaneChain.of(medium.stencil, alike).series(target)
    root, gone = (part[..., number] for part in _factors(series))
    chain = _PlaneChain.of(medium.stencil, along)
    for polish in (True, True, False):
        value, slope = chain.at(root, target)
        determinant = value[0] * value[1] - value[2] ** 2
        rise = slope[0] * value[1] + value[0] * slope[1] - 2 * value[2] * slope[2]
        rise = np.where(rise == 0, 1e-300, rise)
        if polish:
            change = determinant / rise
            root = root * np.exp(-change * np.minimum(1.0, _NEARLY / np.maximum(np.abs(change), 1e-300)))
    carried = ~gone & (np.abs(root) < 1) & (np.abs(determinant) < _ROUGH * np.abs(series).max())
    # columns of the adjugate, of which the longer one tells the polarisation
    columns = np.stack([np.stack([value[1], -value[2]]), np.stack([-value[2], value[0]])])
    lengths = np.linalg.norm(columns, axis=1)
    shape = np.where(lengths[0] > lengths[1], columns[0], columns[1]) / np.maximum(lengths.max(0), 1e-300)
    total = np.zeros(root.shape, complex)
    for component, rows, start in sent:
        total += (shape.conj() * columns[component]).sum(0) * _carried(rows, root) * start[:, None]
    total = np.where(carried, total / (medium.rate * rise), 0)
    # of the eigenvalue by the factor's logarithm
    rise = medium.recursion.scale * medium.rate * rise / np.where(carried, value[0] + value[1], 1)
    slowness = np.where(carried, (medium.recursion.keep / z - z)[:, None] / rise, 0)
    root = np.where(carried, root, 0.5)
    found = [np.concatenate(part, axis=1) for part in (root, total, slowness)]
    return *found, np.concatenate(np.moveaxis(shape, 1, 0), axis=2)


def _lines(stencil: Stencil, along: np.ndarray) -> np.ndarray:
    """Weights of the chain that the stencil is for tangential wavenumbers, by distance along the normal."""
    lines = np.zeros((stencil.reach[0] + 1, along.shape[1]))
    for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
        if offset[0] >= 0:
            lines[offset[0]] += weight * np.cos(offset[1:] @ along)
    lines[0] -= stencil.weights.sum() + stencil.reaction
    return lines


def _alike(stencil: Stencil, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tangential wavenumbers whose modes differ, and for each given one the number of the one it is like."""
    tangential = range(1, stencil.dim)
    if not len(along) or not all(stencil.even_along(axis) for axis in tangential):
        return along, np.arange(along.shape[1])
    folded = np.abs(along)
    if stencil.dim == 3 and stencil.same_along(1, 2):
        folded = np.sort(folded, axis=0)
    found, number = np.unique(np.round(folded, 12), axis=1, return_inverse=True)
    return found, number.ravel()


def _sent(rows: np.ndarray, root: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """What data on rows send to the last of them in a mode, nothing where the lattice carries none."""
    return np.where(slope == 0, 0, _carried(rows, root) / np.where(slope == 0, 1, slope))


def _carried(rows: np.ndarray, root: np.ndarray) -> np.ndarray:
    """``sum_x rows[x] root^(last - x)``, by Horner's rule over the rows that hold something."""
    held = np.flatnonzero(np.abs(rows).max(1))
    found = np.zeros(root.shape, complex)
    if held.size:
        for row in rows[held[0] : held[-1] + 1]:
            found = found * root + row
        found = found * root ** (len(rows) - 1 - held[-1])
    return found


def _chain(lines: np.ndarray, root: np.ndarray, back: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalue of the chain for modes of a factor over a node, and its derivative by the factor's logarithm; the
    weights the other way times `back`, 1 or -1.
    """
    value, slope, power = lines[0] + 0j * root, np.zeros_like(root), np.ones_like(root)
    for distance, line in enumerate(lines[1:], 1):
        power = power * root
        value = value + line * (power + back / power)
        slope = slope + line * distance * (power - back / power)
    return value, slope


def _loudest_first(sizes: np.ndarray, most: int) -> np.ndarray:
    """Indices of the largest values, from the largest on, and then of all others: there may be millions of them."""
    if len(sizes) <= most:
        return np.argsort(-sizes)
    order = np.argpartition(-sizes, most)
    return np.append(order[:most][np.argsort(-sizes[order[:most]])], order[most:])


def _largest(sizes: np.ndarray, rest: float) -> np.ndarray:
    """Indices, ascending, of the values that remain when the smallest ones are left out while their sum is below
    `rest`; one at least.
    """
    order = np.argsort(sizes)
    return np.sort(order[min(int(np.searchsorted(np.cumsum(sizes[order]), rest)), len(order) - 1) :])
