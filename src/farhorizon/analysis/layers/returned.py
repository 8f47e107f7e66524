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
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import fft

from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.samples import Sample, reflected
from farhorizon.engine.engine import Layer

_COMPARED = 2000  # waves by which layers are compared
_EACH = 1500  # waves of a line that are followed each by itself although none is a backward one, at most: a second
# of such waves, where backward ones are among them, how many are followed at first, the loudest, which may show that
# too much comes back; how many show that it is not, for others that come together make more than their energy tells;
# and how many at most. What the others may make of these where no limit decides
_FIRST_EACH, _SURE_EACH, _MOST_EACH, _LITTLE = 1000, 8000, 64000, 0.1
_PEAK = 5.0  # of a sum of waves of any phases, at all places and times, over its root mean square
# what the closed form must make over what is enough, before nothing else is asked: of short waves it knows no damping
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
    later : float
        Length of the run over the time for which these waves are followed. What comes later counts as so many times
        what comes back in the second half of that time: waves that hardly move come back ever later, and ever fainter
        as they spread; of long ones along the side what comes back may grow, in proportion to time.
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
    later: float = 1.0
    shapes: np.ndarray = field(default_factory=lambda: np.ones((1, 1)))

    @cached_property
    def frequency(self) -> np.ndarray:
        """The discrete s of each, ``2/dt (z - 1)/(z + 1)``."""
        return 2 / self.medium.dt * (self.factor - 1) / (self.factor + 1)

    def returned(self, layer: Layer, enough: float = np.inf, closely: bool = False) -> float:
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
            Above it the value is told roughly: where the closed form makes twenty times as much no wave is followed,
            else as many as tell whether it is enough. Unless it is given, so many that the others make a tenth of them.
        closely : bool, optional
            Whether they are followed whatever the closed form makes, which may be far above what comes back.
        """
        closed = self._over_the_field(self.amplitude * self._closed(layer, slice(None)))
        if not self.sample.needed(layer):
            return closed
        few = len(self.along) == 0 and len(self.amplitude) <= _EACH
        if (closely or closed <= _TOO_MUCH * enough) and (self.every or (self.medium.stencil.components == 1 and few)):
            return self._each(layer, enough)
        return closed + self._by_energy(np.abs(self.amplitude) * self._excess(layer, slice(None)))

    def _over_the_field(self, back: np.ndarray, inside: Sequence[np.ndarray] | None = None) -> float:
        """Largest value beside the layer and inside the near field of what comes back of each wave."""
        found = self._largest(back, self._told)
        if self.axes > 1:
            inside = [back * self.root**depth for depth in self.depths] if inside is None else inside
            found = max([found, *(self.axes * self._largest(one, self._told) for one in inside)])
        return found

    @cached_property
    def _told(self) -> np.ndarray:
        """`growth`, more in the second half, from which is told what comes later."""
        half = np.arange(len(self.growth)) >= len(self.growth) // 2
        return self.growth * np.where(half, max(self.later, 1.0), 1.0)

    def _by_energy(self, back: np.ndarray) -> float:
        """The largest of all waves by the share of their energy that is in some amplitudes."""
        return float(self.largest * np.linalg.norm(back) / max(float(np.linalg.norm(self.amplitude)), 1e-300))

    def _each(self, layer: Layer, enough: float) -> float:
        """Largest value of what comes back of waves, each followed by itself, the loudest first: of all, or of so many
        that the others, by their energy, do not change whether it is enough.

        They are told by the closed form of each and not by the waves that stand for them alone: of long waves a little
        more or less slow a layer sends back ten times as much, and the sum of the others rang.
        """
        loud = self._sizes(layer, slice(None))
        heard = loudest(loud, self.silent * max(self.size, self.largest) / max(self.later, 1.0))
        heard = heard[np.argsort(-loud[heard])]
        back, first, last = np.zeros((), complex), 0, _FIRST_EACH
        while True:
            back = back + self.amplitude * self._exact(layer, heard[first:last])
            followed = max(self._over_the_field(one[0], one[1:]) for one in back)
            rest = np.zeros_like(loud)
            rest[heard[last:]] = loud[heard[last:]]
            others = self._by_energy(rest)
            little = others <= _LITTLE * followed if enough == np.inf else followed + others <= enough
            decided = (little and last >= _SURE_EACH) or followed > enough + self._noise(rest)
            if decided or last >= min(len(heard), _MOST_EACH):
                return followed + others
            first, last = last, max(2 * last, _SURE_EACH)

    def _noise(self, amplitude: np.ndarray) -> float:
        """What a sum of waves of any phases is at most where it has grown most."""
        places = 2 * len(self.growth) * np.prod(self.shape[1:])
        mean = np.sqrt(2) * np.linalg.norm(amplitude) / places * self._told.max()
        return float(_PEAK * max(1, self.axes) * mean)

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

    def strongest(self, layer: Layer) -> tuple[float, str]:
        """What comes back of the waves by their energy, and in words the one of which most does."""
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
        """Root of the share of the waves' energy that comes back, from a part of them: quick, to compare layers by."""
        some = slice(None, None, 1 + len(self.amplitude) // _COMPARED)
        whole = max(float(np.linalg.norm(self.amplitude[some])), 1e-300)
        return float(np.linalg.norm(self._sizes(layer, some)) / whole)

    def _sizes(self, layer: Layer, some: slice) -> np.ndarray:
        """How much comes back of some waves, about."""
        return np.asarray(
            np.abs(self.amplitude[some]) * (np.abs(self._closed(layer, some)) + self._excess(layer, some))
        )

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
        return max(self._largest(self.amplitude * component, self.growth) for component in self.shapes)

    @cached_property
    def _rows(self) -> np.ndarray:
        """Frequencies at which there are waves."""
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
    """Indices, ascending, of the values that remain when the smallest ones are left out while their sum is below
    `rest`; one at least.
    """
    order = np.argsort(sizes)
    return np.sort(order[min(int(np.searchsorted(np.cumsum(sizes[order]), rest)), len(order) - 1) :])
