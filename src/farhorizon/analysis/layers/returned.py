"""The reflection from a layer of the waves that a run actually has: its error, predicted before the run.

A layer sees the near field's data as they arrive at its side. Along the side they are a sum of Fourier modes, in time a
Laplace integral on the line Re s = a, a few times the inverse of the length of the run: there travelling, grazing,
evanescent and static waves are treated alike, and none needs a rule of its own. For each s and tangential wavenumber
the medium in front of the side is a chain. Its slowest mode, of factor zeta per node, carries the data u0 to the side,

    U = N(z) sum_x u0(x) zeta^(distance of x) / (zeta dA/dzeta),    A(zeta) = (z - 1)(1 - keep/z)/scale,    z = exp(s
    dt),

where N(z) is the transform of the start of the scheme for displacements, for velocities or for a source in time. The
reflected wave is U times the layer's reflection R(s, zeta), which is known in closed form. Fast Fourier transforms then
give the error at the last node before the layer, at all times; and, with the mode's factor for each node on the way, in
the middle of the near field, where the echoes of all sides meet. This is exact for one flat side and one mode. Wide
stencils have more modes, so the prediction is accurate to a small factor. This is enough to choose a thickness, since
the error falls by a factor of three to ten with each node. Where the data contain backward waves, all modes are
followed, for vectors in the plane the P and S waves of both components together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import fft

from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.samples import Sample, reflected
from farhorizon.engine.engine import Layer

_COMPARED = 2000  # number of waves by which layers are compared
_EACH = 1500  # largest number of waves on a line that are followed individually without backward waves: a second
# with backward waves among them: how many waves, the loudest, are followed at first, which may show that the reflection
# is too large; how many are needed to show that it is not, because waves that interfere constructively cause more than
# their energy suggests; and how many are followed at most. Part of these that the others may add where there is no
# limit
_FIRST_EACH, _SURE_EACH, _MOST_EACH, _LITTLE = 1000, 8000, 64000, 0.1
_TRIED = 500  # of the other waves, those that are followed to see how much they reflect
_PEAK = 5.0  # largest value, over all places and times, of a sum of waves of random phases over its root mean square
# ratio of the closed form to `enough` above which nothing else is computed: it does not include the damping of short
# waves
_TOO_MUCH = 20.0


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
        Place of each in the array of all frequencies and tangential wavenumbers.
    shape : tuple of int
        Shape of that array, frequencies first: no larger than the waves need.
    growth : ndarray, shape (times,)
        exp(a t) at a number of times of the run, times the divisor of the transforms.
    seen : list of ndarray of int
        Places along each tangential axis that are beside the near field.
    sample : Sample
        Waves whose exact reflections are known.
    number : ndarray of int, shape (n,)
        Number of the wave in the sample that represents each wave.
    silent : float
        Sum of amplitudes that is negligible, for data of which the largest is 1.
    size : float
        The largest of the data, as far as it is known.
    every : bool
        Whether the waves include all modes of the medium in front of the side, as backward waves require.
    depths : tuple of int
        Nodes from the side to where the echoes of all sides meet: to the middle of the near field, and to the middle of
        the data. There waves that hardly move come together again, because those that arrive slightly below the largest
        frequency as forward waves leave as backward ones, in the direction from which they came.
    axes : int
        Number of axes with layers.
    later : float
        Length of the run over the time for which these waves are followed. To allow for later times, what comes back in
        the second half of that time is multiplied by this factor: waves that hardly move come back ever later, and ever
        weaker as they spread; the reflection of long waves along the side may grow in proportion to time.
    shapes : ndarray of complex, shape (d, n)
        Polarisations, of length 1, of all modes of a medium of vectors; 1 for waves of one type.
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
    later: float = 1.0
    shapes: np.ndarray = field(default_factory=lambda: np.ones((1, 1)))

    @cached_property
    def frequency(self) -> np.ndarray:
        """The discrete frequency s of each wave, ``2/dt (z - 1)/(z + 1)``."""
        return 2 / self.medium.dt * (self.factor - 1) / (self.factor + 1)

    def returned(self, layer: Layer, enough: float = np.inf, closely: bool = False) -> float:
        """Largest value, over the run and along the side, of what a layer reflects.

        Inside the near field the echo meets equal ones from the other sides, so that it counts once for each axis with
        layers; the margin of the design covers the two sides of one axis.
        What the closed form does not include, such as the damping of short waves, is known for a sample of the waves:
        it is taken into account by its share of the waves' energy. In a sum of waves each step from one sample to the
        next would be noise, which the Laplace integral would amplify. On a line, where there are few enough waves, and
        where backward waves are among them, the waves are followed individually.

        Parameters
        ----------
        layer : Layer
        enough : float, optional
            Above it the value is only rough: where the closed form gives more than twenty times as much, no wave is
            followed, else as many as are needed to decide whether the value exceeds it. Without it, so many that the
            others contribute at most a tenth.
        closely : bool, optional
            Whether waves are followed whatever the closed form gives, which may be far above the actual reflection.
        """
        closed = self._over_the_field(self.amplitude * self._closed(layer, slice(None)))
        if not self.sample.needed(layer):
            return closed
        few = len(self.along) == 0 and len(self.amplitude) <= _EACH
        if (closely or closed <= _TOO_MUCH * enough) and (self.every or (self.medium.stencil.components == 1 and few)):
            return self._each(layer, enough)
        return closed + self._by_energy(np.abs(self.amplitude) * self._excess(layer, slice(None)))

    def _over_the_field(self, back: np.ndarray, inside: Sequence[np.ndarray] | None = None) -> float:
        """Largest value, beside the layer and inside the near field, for given reflections of all waves."""
        found = self._largest(back, self._told)
        if self.axes > 1:
            inside = [back * self.root**depth for depth in self.depths] if inside is None else inside
            found = max([found, *(self.axes * self._largest(one, self._told) for one in inside)])
        return found

    @cached_property
    def _told(self) -> np.ndarray:
        """`growth`, increased by `later` in the second half, from which later times are extrapolated."""
        half = np.arange(len(self.growth)) >= len(self.growth) // 2
        return self.growth * np.where(half, max(self.later, 1.0), 1.0)

    def _by_energy(self, back: np.ndarray) -> float:
        """The largest value of all waves, times the root of the share of their energy in given amplitudes."""
        return float(self.largest * np.linalg.norm(back) / max(float(np.linalg.norm(self.amplitude)), 1e-300))

    def _each(self, layer: Layer, enough: float) -> float:
        """Largest value of the reflections of waves that are followed individually, the loudest first: of all, or of so
        many that the others, by their energy or as noise, do not change whether the value is at most `enough`.

        They are ranked by the closed form of each as well as by the waves of the sample that represent them. Of long
        waves that are slightly slower a layer may reflect ten times as much, and with the sample alone the sum of the
        remaining waves rang.
        """
        loud = self._sizes(layer, slice(None))
        heard = loudest(loud, self.silent * max(self.size, self.largest) / max(self.later, 1.0))
        heard = heard[np.argsort(-loud[heard])]
        back, first, last = np.zeros((), complex), 0, _FIRST_EACH
        while True:
            back = back + self.amplitude * self._exact(layer, heard[first:last])
            followed = max(self._over_the_field(one[0], one[1:]) for one in back)
            rest = np.zeros_like(loud)
            rest[heard[last:]] = loud[heard[last:]] * self._misjudged(layer, heard[last:], loud)
            # relative to the energy of all times, waves that come late have grown most
            others = max(self._by_energy(rest), self._noise(rest))
            little = others <= _LITTLE * followed if enough == np.inf else followed + others <= enough
            decided = (little and last >= _SURE_EACH) or followed > enough + self._noise(rest)
            if decided or last >= min(len(heard), _MOST_EACH):
                return followed + others
            first, last = last, max(2 * last, _SURE_EACH)

    def _misjudged(self, layer: Layer, some: np.ndarray, sizes: np.ndarray) -> float:
        """Ratio of the reflected amplitudes of some waves, of which a few are followed, to the given approximate ones;
        at least 1. A layer turns waves into others, such as P waves into backward S waves, of which the waves of the
        sample need not tell.
        """
        tried = some[:: 1 + len(some) // _TRIED]
        followed = np.abs(self._exact(layer, tried)[:, 0, tried]).max(0, initial=0.0) * np.abs(self.amplitude[tried])
        return max(1.0, float(np.linalg.norm(followed) / max(float(np.linalg.norm(sizes[tried])), 1e-300)))

    def _noise(self, amplitude: np.ndarray) -> float:
        """Largest value of a sum of waves of random phases with given amplitudes, at the time of largest growth."""
        places = 2 * len(self.growth) * np.prod(self.shape[1:])
        mean = np.sqrt(2) * np.linalg.norm(amplitude) / places * self._told.max()
        return float(_PEAK * max(1, self.axes) * mean)

    def _exact(self, layer: Layer, some: np.ndarray) -> np.ndarray:
        """Reflections of some waves, for incoming ones of amplitude 1, by component, one node from the layer and inside
        the near field; 0 for all other waves.
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

    def strongest(self, layer: Layer) -> tuple[float, str]:
        """Return the reflection of the waves by their energy, and a description of the wave that contributes most."""
        sizes = self._sizes(layer, slice(None))
        one = int(np.argmax(sizes))
        normal, fades = abs(float(np.angle(self.root[one]))), -float(np.log(np.abs(self.root[one])))
        along = float(np.linalg.norm(self.along[:, one]))
        if fades > normal:
            words = f"waves that decay by a factor of e in {1 / fades:.2g} nodes towards the side"
        else:
            angle = "" if not self.along.size else f" at {np.degrees(np.arctan2(along, normal)):.0f} degrees"
            words = f"waves of {2 * np.pi / max(np.hypot(normal, along), 1e-300):.2g} nodes{angle}"
        return self._by_energy(sizes), words

    def share(self, layer: Layer) -> float:
        """Root of the share of the waves' energy that is reflected, from a part of the waves: a quick measure by which
        to compare layers.
        """
        some = slice(None, None, 1 + len(self.amplitude) // _COMPARED)
        whole = max(float(np.linalg.norm(self.amplitude[some])), 1e-300)
        return float(np.linalg.norm(self._sizes(layer, some)) / whole)

    def _sizes(self, layer: Layer, some: slice) -> np.ndarray:
        """Approximate reflected amplitudes of some waves."""
        return np.asarray(
            np.abs(self.amplitude[some]) * (np.abs(self._closed(layer, some)) + self._excess(layer, some))
        )

    def _closed(self, layer: Layer, some: slice) -> np.ndarray:
        """Reflection of some waves by the closed form.

        In the closed form backward waves grow, whereas the layer damps them: where it exceeds 1, the reflection is that
        of the waves of the sample that represent them, or total.
        """
        found = reflected(self.root[some], self.frequency[some], layer)
        sizes = np.abs(found)
        grown = sizes > 1
        if grown.any():
            exact = self.sample.judged(layer)[0, self.number[some][grown]] if self.sample.needed(layer) else 1.0
            found[grown] *= exact / sizes[grown]
        return found

    def _excess(self, layer: Layer, some: slice) -> np.ndarray:
        """Excess of the reflected amplitudes of some waves over the closed form, from the waves that represent them."""
        alike = self.number[some]
        return self.sample.judged(layer)[1, alike] if self.sample.needed(layer) else np.zeros(len(alike))

    @cached_property
    def largest(self) -> float:
        """Largest value, over the run and along the side, of the arriving waves themselves."""
        return max(self._largest(self.amplitude * component, self.growth) for component in self.shapes)

    @cached_property
    def _rows(self) -> np.ndarray:
        """Indices of the frequencies at which there are waves."""
        return np.unique(self.place // int(np.prod(self.shape[1:])))

    def _largest(self, amplitude: np.ndarray, growth: np.ndarray) -> float:
        """Largest value of a sum of waves that grow in time, by inverse transforms in time and along the side."""
        spectrum = np.zeros(int(np.prod(self.shape)), complex)
        np.add.at(spectrum, self.place, amplitude)
        along = tuple(range(1, len(self.shape)))
        if along:
            spectrum = spectrum.reshape(self.shape)
            spectrum[self._rows] = fft.ifftn(spectrum[self._rows], axes=along)
        times = len(self.growth)
        history = fft.irfft(spectrum[np.ix_(np.arange(self.shape[0]), *self.seen)], 2 * times, axis=0)[:times]
        return float((np.abs(history).max(along) * growth).max())


def loudest(sizes: np.ndarray, rest: float) -> np.ndarray:
    """Indices, ascending, of the values that remain when the smallest ones are left out as long as their sum is below
    `rest`; at least one.
    """
    order = np.argsort(sizes)
    return np.sort(order[min(int(np.searchsorted(np.cumsum(sizes[order]), rest)), len(order) - 1) :])
