"""Waves that represent others, with their exact reflections, and the closed form for all others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from farhorizon.analysis.layers.layer import ArrivingWave, LatticeMedium, WavesAtFrequency, amplitudes_of
from farhorizon.analysis.layers.reflection import polarisations
from farhorizon.engine.engine import Layer
from farhorizon.engine.parallel import in_parallel
from farhorizon.errors import InputError

# cells per factor e of frequency, of decay or wavenumber per node, and of slowness: the waves of one cell are reflected
# alike. Where forward waves meet backward ones, the reflection changes by a factor of a hundred within a third of the
# wavenumber. The samples of vectors overestimate the reflection as they are: with cells as fine, layers for 1e-4 had
# twice the nodes
_CELLS, _CELLS_OF_VECTORS = (2.5, 10.0, 2.5), (2.5, 2.5, 2.5)
_BLOCK = 4096  # waves that `reflected` processes at a time


class Sample:
    """Waves of one type, on one line of the Laplace integral, each of which represents all waves similar to it in
    frequency, in decay or wavenumber along the normal, and in slowness. Lines nearer to the axis, for longer runs, have
    samples of their own, because some waves are reflected much more strongly there.

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
        """Whether the reflection of a layer is more than the closed form for the incoming wave: because of damping, of
        other types of waves, or of evanescent modes of a wide stencil that decay over several nodes.
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
        """Add waves, given by arrays as in `Arrivals` and by the steps that each takes per node, and return for each
        wave the number of its representative: the loudest wave of its cell in the first call that had any. Without
        shapes all are of the sample's type.

        Slowness counts because waves that hardly move are reflected entirely, while others of nearly the same frequency
        are absorbed.
        """
        finite, medium = np.where(amplitude == 0, 0.5, root), self.medium
        slow = np.maximum(1.0, np.abs(slowness) * medium.speed * medium.dt / medium.spacing)
        sizes = np.abs(np.log(factor)), np.abs(np.log(finite)), slow
        logs = np.log(np.maximum(sizes, 1e-12))
        parts = _CELLS if medium.stencil.components == 1 else _CELLS_OF_VECTORS
        cells = np.floor(np.array(parts)[:, None] * logs).astype(int).T
        if shape is not None:  # whether polarised along the normal or across it
            cells = np.append(cells, np.abs(shape[:1].T) ** 2 > 0.5, axis=1)
        keys = np.ravel_multi_index(tuple((cells - cells.min(0)).T), tuple(np.ptp(cells, 0) + 1))
        order = np.lexsort((-np.abs(amplitude), keys))
        changes = np.diff(keys[order], prepend=-1) > 0
        number, first = np.zeros(len(keys), int), order[changes]
        number[order] = np.cumsum(changes) - 1
        places = np.zeros(len(first), int)
        for i, (one, cell) in enumerate(zip(first, map(tuple, cells[first].tolist()), strict=True)):
            if cell not in self._cells:
                self._cells[cell] = len(self._waves)
                of = None if shape is None else shape[:, one]
                self._waves.append(self.wave(complex(root[one]), complex(factor[one]), along[:, one], of))
            places[i] = self._cells[cell]
        return places[number]

    def wave(
        self, root: complex, factor: complex, along: np.ndarray, shape: np.ndarray | None = None
    ) -> ArrivingWave | None:
        """The wave with all modes of the medium, or None if no such wave comes to the side. Its polarisation is that of
        the sample's type unless given. Several modes of one frequency and wavenumber, of different types, may come to
        the side.
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
        """For each wave of the sample, the reflected amplitude, all types together, and its excess over the closed
        form; shape (2, waves).
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
        """For each of several waves, the amplitudes of all modes that leave the layer, arrays (modes, d), and their
        factors per node; no modes where no such wave comes to the side.

        Results are kept, since other sides, and the mirror images of waves along the side, ask for the same waves.

        Parameters
        ----------
        layer : Layer
        waves : sequence of (complex, complex)
            Factors per node and per step.
        along : ndarray, shape (waves, dim - 1)
            Tangential wavenumbers.
        shape : ndarray, shape (waves, d)
            Polarisations, of length 1.
        """
        known = self._came_back.setdefault(_key(layer), {})
        sign = np.ones(shape.shape)
        if shape.shape[1] > 1:  # in the mirror image the component along the side has the opposite sign
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
    """The number, rounded so that it identifies equal waves."""
    return complex(round(number.real, 9), round(number.imag, 9))


def _judged(waves: Sequence[ArrivingWave], layer: Layer) -> np.ndarray:
    """Exact reflections of waves, at most 1, and their excess over the closed form; shape (2, waves). The reflection is
    the amplitude of the travelling modes, or, if larger, that of all modes at the last node of the near field, one node
    from the layer, where evanescent modes of wide stencils are still present.
    """
    closed = np.abs(reflected(np.array([w.modes.incoming for w in waves]), np.array([w.s for w in waves]), layer))
    exact = np.zeros(len(waves))
    for i, (wave, amplitudes) in enumerate(zip(waves, amplitudes_of(waves, layer), strict=True)):
        beside = float(np.linalg.norm((amplitudes / wave.modes.leaving) @ wave.modes.vectors))
        exact[i] = min(1.0, max(float(np.linalg.norm(amplitudes[wave.modes.travels])), beside))
    return np.stack([exact, np.maximum(0.0, exact - closed)])


def reflected(root: np.ndarray, frequency: np.ndarray, layer: Layer) -> np.ndarray:
    """Reflection of a layer for modes of given factors per node, from the closed form: the way to its outer end and
    back.

    Parameters
    ----------
    root, frequency : ndarray of complex, shape (n,)
        As in `Arrivals`.
    layer : Layer
        Its damping of short waves is ignored.

    Returns
    -------
    ndarray of complex, shape (n,)
    """

    def passed(part: slice) -> np.ndarray:
        cosine, sine, there = 1 + root[part], 1 - root[part], np.ones_like(root[part])
        for edge, (kappa, sigma, alpha) in enumerate(zip(layer.kappa, layer.sigma, layer.alpha, strict=True)):
            shifted = frequency[part] + alpha
            stretched, plain = (kappa * shifted + sigma) * sine, shifted * cosine
            if edge == layer.columns:
                there *= there  # and back; the last edge is the outer end, which is passed once
            there *= (plain - stretched) / (plain + stretched)
        return there

    # in blocks, so that the arrays stay in the cache from one edge to the next
    parts = [slice(first, first + _BLOCK) for first in range(0, max(1, len(root)), _BLOCK)]
    return np.concatenate(in_parallel(passed, parts))
