"""Sponge: more of the same medium with damping that grows outwards, and a fixed end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Frequency
from farhorizon.boundaries.side import Side


@dataclass(frozen=True)
class Sponge(Side):
    """Absorbing zone of real nodes beyond the side, damped by ``strength * (depth / thickness)^2``.

    It never causes growth (its damping is non-negative), but it must be several wavelengths thick, rather than several
    nodes: intended for comparison.

    Parameters
    ----------
    nodes : int
        Thickness.
    strength : float, optional
        Damping d at the outer end in ``2 d u_t`` (waves) or loss rate in ``u_t = ... - d u`` (diffusion);
        ``6 speed / thickness`` or ``10 diffusivity / thickness^2`` unless given.

    Examples
    --------
    >>> import farhorizon as fh
    >>> fh.Sponge(nodes=4, strength=1.0).damping(order=2, coefficient=1.0, spacing=1.0)
    array([0.0625, 0.25  , 0.5625, 1.    ])
    """

    passive: ClassVar[bool] = True
    nodes: int = 40
    strength: Frequency | None = None

    def __post_init__(self) -> None:
        kinds.set_fields(
            self,
            nodes=kinds.integer(self.nodes, "boundary.nodes", least=1),
            strength=None if self.strength is None else kinds.number(self.strength, "boundary.strength", least=0),
        )

    def wanted(self, default: float) -> float:
        """Return the fraction of the largest value that may be neglected beyond the side."""
        return default

    def width(self, reach: int, spacing: float) -> int:
        """Return the number of nodes of the sponge."""
        return self.nodes

    def damping(self, order: int, coefficient: float, spacing: float) -> np.ndarray:
        """Return the damping at the sponge's nodes from the near field outwards, shape (nodes,)."""
        width = self.nodes * spacing
        default = 6 * np.sqrt(coefficient) / width if order == 2 else 10 * coefficient / width**2
        strength = default if self.strength is None else self.strength
        return strength * ((np.arange(self.nodes) + 1) / self.nodes) ** 2
