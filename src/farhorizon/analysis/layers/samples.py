"""Waves that stand for others, with the exact reflections that are known of them, and the closed form beside these."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from farhorizon.analysis.layers.layer import ArrivingWave, LatticeMedium, WavesAtFrequency, amplitudes_of
from farhorizon.analysis.layers.reflection import polarisations
from farhorizon.engine.engine import Layer
from farhorizon.engine.parallel import in_parallel
from farhorizon.errors import InputError

# parts of a factor e of frequency, of decay or wavenumber over a node, and of slowness: waves of one such cell return
# alike. Where forward waves meet backward ones, what comes back changes by a hundred within a third of the wavenumber;
# of vectors, whose samples tell too much as they are, layers for 1e-4 had twice the nodes with as fine cells
_CELLS, _CELLS_OF_VECTORS = (2.5, 10.0, 2.5), (2.5, 2.5, 2.5)
_BLOCK = 4096  # waves that `reflected` takes at a time


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

    def passed(part: slice) -> np.ndarray:
        cosine, sine, there = 1 + root[part], 1 - root[part], np.ones_like(root[part])
        for edge, (kappa, sigma, alpha) in enumerate(zip(layer.kappa, layer.sigma, layer.alpha, strict=True)):
            shifted = frequency[part] + alpha
            stretched, plain = (kappa * shifted + sigma) * sine, shifted * cosine
            if edge == layer.columns:
                there *= there  # and back; the last edge is the end, which is passed once
            there *= (plain - stretched) / (plain + stretched)
        return there

    # what an edge takes stays in the cache for the next
    parts = [slice(first, first + _BLOCK) for first in range(0, max(1, len(root)), _BLOCK)]
    return np.concatenate(in_parallel(passed, parts))
