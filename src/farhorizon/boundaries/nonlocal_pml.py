"""Published perfectly matched layer for state-based peridynamics (Wildman and Gazonas 2012).

In the layer a derivative along its normal is divided by the stretch ``1 + phi/s`` (eq. 2-22), where phi grows outwards.
The derivatives are those of correspondence elasticity: the deformation gradient and the divergence of the stress (eqs
2-24 and 2-26). A factor on a whole derivative is exact for a uniform phi, but neighbours with a different phi reflect:
the reflection decreases with the smoothness of the ramp, not with the thickness alone. Each stretched derivative has
one memory variable; the split fields and two-level update of eqs 2-30 and 2-31, which is forward Euler, are in
`farhorizon.papers.wildman2012`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Frequency
from farhorizon.boundaries.side import Side

RAMPS = {"quadratic": 2, "cubic": 3}
_FOOT = 1e-6  # foot of the Gaussian ramp relative to its maximum: "the minimum value in the Gaussian region is 10^-6"


@dataclass(frozen=True)
class NonlocalPML(Side):
    """Absorbing layer on the derivatives of correspondence elasticity, for comparison and for reproducing the paper.

    Parameters
    ----------
    nodes : int
        Thickness. Waves require a ramp of several horizons: 20 nodes or more with a Gaussian influence function about
        as wide as a spacing.
    ramp : {"cubic", "quadratic", "gaussian"}
        phi as a function of the depth d: ``(d/thickness)^3``, ``(d/thickness)^2``, or that of the paper, which rises
        like the flank of a Gaussian bell from a millionth at the entrance and stays at its maximum over the outermost
        `plateau` of the layer (section 2B).
    strength : float, optional
        Largest phi (1/time). Once the layer absorbs enough, larger values are worse.
    reflection : float
        If no strength is given: the fraction of its amplitude that a longitudinal wave at normal incidence retains on
        the way to the outer end and back.
    plateau : float
        Fraction of the layer in which the Gaussian ramp is at its maximum.
    cross : float
        Fraction of phi that also acts on the derivatives along the side (a multiaxial PML): stable where the plain PML
        is not, but less accurate.
    shift : float
        alpha (1/time) in ``1 + phi/(s + alpha)``.

    Raises
    ------
    InputError
        An unknown ramp, a number out of range.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> layer = fh.NonlocalPML(nodes=20, cross=0.1)
    >>> layer.shape(np.array([0.0, 0.5, 1.0]))  # a cubic ramp
    array([0.   , 0.125, 1.   ])
    """

    label: ClassVar[str] = "nonlocal PML"
    assumes = frozenset({"no drift", "no losses"})
    alone = "stretched derivatives are remembered on all nodes beyond them, cut across, too"
    cracks: ClassVar[Literal["end", "continue", "refuse"]] = "end"
    nodes: int = 30
    ramp: str = "cubic"
    strength: Frequency | None = None
    reflection: float = 1e-3
    plateau: float = 1 / 3
    cross: float = 0.0
    shift: Frequency = 0.0

    def __post_init__(self) -> None:
        kinds.set_fields(
            self,
            nodes=kinds.integer(self.nodes, "boundary.nodes", least=1),
            ramp=kinds.one_of(self.ramp, "boundary.ramp", (*RAMPS, "gaussian"), "unknown ramp"),
            strength=None if self.strength is None else kinds.number(self.strength, "boundary.strength", least=0),
            reflection=kinds.number(self.reflection, "boundary.reflection", above=0, below=1),
            plateau=kinds.number(self.plateau, "boundary.plateau", least=0, most=0.95),
            cross=kinds.number(self.cross, "boundary.cross", least=0, most=1),
            shift=kinds.number(self.shift, "boundary.shift", least=0),
        )

    def wanted(self, default: float) -> float:
        """Return the fraction of the largest value that may be neglected beyond the layer."""
        return default

    def width(self, reach: int, spacing: float) -> int:
        """Return the number of nodes of the layer."""
        return self.nodes

    def shape(self, depth: np.ndarray) -> np.ndarray:
        """Return phi relative to its largest value at depths from 0 (entrance) to 1 (outer end)."""
        depth = np.asarray(depth, float)
        if self.ramp in RAMPS:
            return depth ** RAMPS[self.ramp]
        rise = 1 - self.plateau
        return np.exp(np.log(_FOOT) * np.maximum(0.0, 1 - depth / rise) ** 2)

    def stretches(self, spacing: float, speed: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Return phi along the normal and along the side at the nodes of the layer, and alpha."""
        phi = self.stretch(spacing, speed)
        return phi, self.cross * phi, self.shift

    def stretch(self, spacing: float, speed: float) -> np.ndarray:
        """Return phi (1/time) at the layer's nodes from the near field outwards, shape (nodes,).

        Parameters
        ----------
        spacing : float
        speed : float
            Longitudinal wave speed.
        """
        depth = (np.arange(self.nodes) + 1) / self.nodes
        strength = self.strength
        if strength is None:  # exp(-2/speed * integral of phi) = reflection
            fine = self.shape((np.arange(1000) + 0.5) / 1000).mean() * self.nodes * spacing
            strength = -np.log(self.reflection) * speed / (2 * fine)
        return strength * self.shape(depth)
