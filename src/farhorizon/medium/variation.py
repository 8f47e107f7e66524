"""Media that vary from node to node, beside the uniform one that a model stands for."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from farhorizon.engine.bonds import combined

_ROUNDING = 1e-14


@dataclass(frozen=True, eq=False)
class Variation:
    """How a medium varies; all of the lattice's shape, and None where it does not.

    Attributes
    ----------
    stiffness : ndarray or None
        Of the waves that the model's coefficient tells: factor on bonds.
    density : ndarray or None
        Mass of a node over that of a node of the model.
    moduli : ndarray, shape (3, ...), or None
        Those of `ForceStates`, where forces follow from states of the nodes.
    springs : ndarray or None
        Factor on the bonds beside these states.
    lame : ndarray, shape (2, ...), or None
        Lame's constants of such a medium.
    strength : ndarray or None
        Critical stretch, or fracture energy, over that of the model.
    toughness : ndarray or None
        Fracture energy over that of the model where bonds have a critical stretch, too, at which they begin to soften.
    """

    stiffness: np.ndarray | None = None
    density: np.ndarray | None = None
    moduli: np.ndarray | None = None
    springs: np.ndarray | None = None
    lame: np.ndarray | None = None
    strength: np.ndarray | None = None
    toughness: np.ndarray | None = None

    @property
    def of_bonds(self) -> np.ndarray | None:
        """Factor on bonds."""
        return self.stiffness if self.moduli is None else self.springs

    def times(self, factor: np.ndarray | None) -> Variation:
        """The same with another factor on bonds."""
        if factor is None:
            return self
        return replace(self, stiffness=factor if self.stiffness is None else factor * self.stiffness)

    def part(self, within: tuple[slice, ...]) -> Variation:
        """That of a box of the lattice."""
        place: tuple[Any, ...] = (..., *within)
        return Variation(**{name: value if value is None else value[place] for name, value in vars(self).items()})

    @property
    def squared_speed(self) -> np.ndarray | None:
        """Of the waves at each node over that of the model."""
        if self.density is None:
            return self.stiffness
        return (1.0 if self.stiffness is None else self.stiffness) / self.density


def middle_node(values: np.ndarray) -> int:
    """Number of a node whose value is in the middle of all: of the host medium, where that fills most of a lattice."""
    return int(np.argsort(values, axis=None, kind="stable")[values.size // 2])


def varying(values: np.ndarray) -> np.ndarray | None:
    """Values over nodes; None where all are 1 to rounding."""
    return None if np.abs(values - 1).max() < _ROUNDING else values


def lightest_bond(
    factor: np.ndarray | None, density: np.ndarray, offsets: np.ndarray, rule: str, periodic: Collection[int] = ()
) -> float:
    """The largest factor of a bond over the smaller mass of its ends; those of bonds across an edge are alike.

    The squared frequencies of the medium are at most so many times those of the uniform one if no weight is negative:
    the bonds between nodes heavier than any m, which have a mass of at least m, oscillate no faster than all bonds do.

    Parameters
    ----------
    factor : ndarray or None
        Of the stiffness of bonds, at the nodes.
    density : ndarray
        Masses of the nodes.
    offsets : ndarray of int, shape (K, dim)
    rule : {"both", "arithmetic", "harmonic"}
        How the factors of a bond's ends combine.
    periodic : collection of int
        Axes along which the medium repeats itself.
    """
    reach = np.abs(offsets).max(0)
    stiff, heavy = (
        grown_over(np.ones(density.shape) if one is None else one, reach, periodic) for one in (factor, density)
    )
    largest = 0.0
    here = tuple(slice(m, m + n) for m, n in zip(reach, density.shape, strict=True))
    for offset in offsets:
        there = tuple(slice(m + o, m + o + n) for m, o, n in zip(reach, offset, density.shape, strict=True))
        bond = combined(rule, stiff[here], stiff[there])
        largest = max(largest, float((bond / np.minimum(heavy[here], heavy[there])).max()))
    return largest


def grown_over(values: np.ndarray, reach: Sequence[int], periodic: Collection[int]) -> np.ndarray:
    """Values with so many more beyond each edge: as at the edge, or as across a periodic axis."""
    for axis, more in enumerate(reach):
        widths = [(int(more), int(more)) if a == axis else (0, 0) for a in range(values.ndim)]
        values = np.pad(values, widths, mode="wrap" if axis in periodic else "edge")
    return values
