"""Media that vary from node to node, relative to the uniform medium of a model."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from farhorizon.engine.bonds import combined

_ROUNDING = 1e-14  # of values computed by a few operations


@dataclass(frozen=True, eq=False)
class Variation:
    """Variation of a medium: arrays of the lattice's shape, None where it does not vary."""

    #: Modulus of the waves described by the model's coefficient, over that of the model; without `moduli` it is the
    #: factor on bonds.
    stiffness: np.ndarray | None = None
    #: Mass of a node over that of a node of the model.
    density: np.ndarray | None = None
    #: Moduli of `ForceStates`, where forces follow from states of the nodes, (3, ...).
    moduli: np.ndarray | None = None
    #: Factor on the bonds beside these states.
    springs: np.ndarray | None = None
    #: Lame's constants of such a medium, (2, ...).
    lame: np.ndarray | None = None
    #: Critical stretch, or fracture energy, over that of the model.
    strength: np.ndarray | None = None
    #: Fracture energy over that of the model where bonds also have a critical stretch, at which they begin to soften.
    toughness: np.ndarray | None = None

    @property
    def of_bonds(self) -> np.ndarray | None:
        """Factor on bonds."""
        return self.stiffness if self.moduli is None else self.springs

    @property
    def of_waves(self) -> list[np.ndarray]:
        """All properties that affect waves, each of the lattice's shape."""
        given = self.stiffness, self.density, self.springs, *(() if self.moduli is None else self.moduli)
        return [values for values in given if values is not None]

    def times(self, factor: np.ndarray | None) -> Variation:
        """The same variation with a further factor on bonds."""
        if factor is None:
            return self
        return replace(self, stiffness=factor if self.stiffness is None else factor * self.stiffness)

    def without(self, names: Collection[str]) -> Variation:
        """The same variation with the named properties uniform."""
        return replace(self, **dict.fromkeys(names))

    @property
    def squared_speed(self) -> np.ndarray | None:
        """Squared wave speed at each node over that of the model; None if it is uniform."""
        if self.density is None:
            return self.stiffness
        return (1.0 if self.stiffness is None else self.stiffness) / self.density


def is_one(values: np.ndarray) -> bool:
    """Whether all values are 1 to rounding."""
    return bool(np.abs(values - 1).max(initial=0) < _ROUNDING)


def lightest_bond(factors: np.ndarray, masses: np.ndarray, offsets: np.ndarray, rule: str) -> float:
    """Largest ratio of the factor of a bond to the smaller mass of its ends; factor on the bonds and mass of each node
    have a margin beyond each edge as wide as bonds reach, and `rule` combines the factors of the ends of a bond.

    If no weight is negative, the squared frequencies of the medium are at most this ratio times those of the uniform
    one: the bonds between nodes heavier than any m, which have a mass of at least m, oscillate no faster than all bonds
    do.
    """
    reach = np.abs(offsets).max(0)
    largest, shape = 0.0, np.array(masses.shape) - 2 * reach
    ends = tuple(slice(m, m + n) for m, n in zip(reach, shape, strict=True))
    for offset in offsets:
        other_ends = tuple(slice(m + o, m + o + n) for m, o, n in zip(reach, offset, shape, strict=True))
        bond = combined(rule, factors[ends], factors[other_ends])
        largest = max(largest, float((bond / np.minimum(masses[ends], masses[other_ends])).max()))
    return largest
