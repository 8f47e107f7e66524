"""What the layers sum: the terms of a stencil in groups, of values in a level and of values in the slots of bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from farhorizon.engine.layout import Layout
from farhorizon.engine.nested import COLUMNS, LINES, STEP, WIDTH


@dataclass(frozen=True)
class Slots:
    """Where the slots of bands lie: for each component and each distance along the last axis one line beside every line
    of nodes, those of the halo included.

    Attributes
    ----------
    layout : Layout
    sets : int
        1 if the values for neighbours ahead and behind are added up, 2 if both have slots.
    bands : ndarray of int, shape (2, n)
        See `nested.Layers`.
    """

    layout: Layout
    sets: int
    bands: np.ndarray

    @property
    def grid(self) -> tuple[int, int]:
        """Distances in lines between neighbours along the first two axes."""
        return self.layout.box.nodes[1] + 2 * self.layout.reach[1], 1

    @property
    def first(self) -> int:
        """Number of the line of the first node."""
        return self.layout.reach[0] * self.grid[0] + self.layout.reach[1]

    @property
    def lines(self) -> int:
        """Number of lines for one component and distance."""
        return (self.layout.box.nodes[0] + 2 * self.layout.reach[0]) * self.grid[0]

    def place(self, number: int, component: int, offset: Sequence[int]) -> int | None:
        """Place of the slots of a band that serve an offset, counted from the line of a node; None if none do.

        Those of mirror images are added up and appear once.
        """
        ahead, reach = int(offset[2]), self.layout.reach[2]
        if not self.bands[number, COLUMNS] or ahead == 0 or (self.sets == 1 and ahead < 0):
            return None
        inwards = self.sets == 2 and ahead * int(self.bands[number, STEP]) < 0
        distance = (component * self.sets + inwards) * reach + abs(ahead) - 1
        line = distance * self.lines + offset[0] * self.grid[0] + offset[1] * self.grid[1]
        return int(line * self.bands[number, WIDTH])


@dataclass(frozen=True)
class Terms:
    """Sums over the terms of a stencil, one after the other.

    Attributes
    ----------
    layout : Layout
    offsets, weights : ndarray, shapes (K, 3) and (K, rows, columns)
        The stencil.
    itemsize : int
        Bytes of a number of the field.
    slots : Slots
    ends, places, factors, values : list
        Rows of the tables `ends`, `places`, `factors` and `weights` of `nested.Layers`.
    neighbours : dict
        For the axes along which sums run, the distances to neighbours along them and the numbers of these.
    """

    layout: Layout
    offsets: np.ndarray
    weights: np.ndarray
    itemsize: int
    slots: Slots
    ends: list[list[int]] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    factors: list[int] = field(default_factory=list)
    values: list[np.ndarray] = field(default_factory=list)
    neighbours: dict[tuple[int, ...], dict[int, int]] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of sums so far."""
        return len(self.ends) // 3

    def add(self, row: int, fixed: Sequence[Mapping[int, int]], across: Sequence[int]) -> None:
        """Add sums for one component of the result, each with given offsets along some axes, over terms at all offsets
        along the axes `across`.

        Without given offsets, only those over the slots of bands.
        """
        stride, numbers = self.layout.box.stride, self.neighbours.setdefault(tuple(across), {})
        for band in (None, 0, 1):
            terms: dict[tuple[int, int], np.ndarray] = {}
            for k, given in enumerate(fixed):
                at = np.ones(len(self.offsets), bool)
                for axis, value in given.items():
                    at &= self.offsets[:, axis] == value
                for o, w in zip(self.offsets[at].tolist(), self.weights[at], strict=True):
                    material = sum(o[a] * stride[a] for a in across)
                    line = [o[a] if a in across or a == 2 else 0 for a in range(3)]
                    for column in np.flatnonzero(w[row]).tolist() if band is not None or given else ():
                        place = (
                            material + column * self.layout.size
                            if band is None
                            else self.slots.place(band, column, line)
                        )
                        if place is not None:
                            row_of = terms.setdefault((place, material), np.zeros(max(self.layout.reach)))
                            row_of[k] += w[row, column]
            self._append(terms, len(fixed), numbers)

    def _append(self, terms: dict[tuple[int, int], np.ndarray], sums: int, numbers: dict[int, int]) -> None:
        """Append terms in groups: those that the last sum has, then those that the last but one has, and so on."""
        first = len(self.places)
        used = {key: int(np.flatnonzero(w)[-1]) + 1 for key, w in terms.items()}
        for key in sorted(terms, key=lambda key: (-used[key], key)):
            self.places.append(key[0] * self.itemsize)
            self.factors.append(numbers.setdefault(key[1], len(numbers)) * LINES * self.itemsize)
            self.values.append(terms[key])
        last = [first + sum(n >= k for n in used.values()) for k in range(sums, 0, -1)]
        self.ends.append([first, *last, *[0] * (max(self.layout.reach) - sums)])
