"""The published perfectly matched layer for state-based peridynamics (Wildman and Gazonas 2012).

In the layer a derivative along its normal is divided by the stretch ``1 + phi/s`` (eq. 2-22), phi growing outwards. The
derivatives are those of correspondence elasticity: the deformation gradient and the divergence of the stress (eqs 2-24
and 2-26). A factor on a whole derivative is exact for one phi, but neighbours with another phi reflect: what comes back
falls with the smoothness of the ramp, not with the thickness alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from farhorizon import kinds
from farhorizon.boundaries.side import Side
from farhorizon.errors import InputError

RAMPS = {"quadratic": 2, "cubic": 3}
FORMS = ("displacement", "split")
_FOOT = 1e-6  # of the Gaussian ramp, relative to its top: "the minimum value in the Gaussian region is 10^-6"


@dataclass(frozen=True)
class NonlocalPML(Side):
    """Absorbing layer on the derivatives of correspondence elasticity; a point of comparison, and what reproduces the
    paper.

    Parameters
    ----------
    nodes : int
        Thickness. A wave needs a ramp of several horizons, 20 nodes or more with a gaussian influence function about as
        wide as a spacing.
    ramp : {"cubic", "quadratic", "gaussian"}
        phi over the depth d: ``(d/thickness)^3``, ``(d/thickness)^2``, or the paper's, which rises like the flank of a
        Gaussian bell from a millionth at the entrance and stays at its top over the outermost `plateau` of the layer
        (section 2B).
    strength : float, optional
        Largest phi (1/time). More is worse once the layer absorbs enough.
    reflection : float
        Without a strength: what a longitudinal wave at normal incidence keeps of its amplitude on the way to the outer
        end and back.
    plateau : float
        Part of the layer in which the Gaussian ramp is at its top.
    form : {"displacement", "split"}
        "displacement": velocity Verlet on displacements, one memory a stretched derivative, for damage and statics too.
        "split": forward Euler on split fields, which is eqs 2-30 and 2-31; it grows everywhere by half of frequency^2
        dt, and has no damage.
    cross : float
        Part of phi that acts on the derivatives along the side as well (a multiaxial PML): stable where the plain one
        is not, less accurate.
    shift : float
        alpha (1/time) in ``1 + phi/(s + alpha)``, displacement form only.

    Raises
    ------
    InputError
        An unknown ramp or form, a number out of range, a shift in the split form.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> layer = fh.NonlocalPML(nodes=20, cross=0.1)
    >>> layer.shape(np.array([0.0, 0.5, 1.0]))  # a cubic ramp
    array([0.   , 0.125, 1.   ])
    """

    label: ClassVar[str] = "nonlocal PML"
    endless: ClassVar[bool] = True
    split: ClassVar[bool] = True
    nodes: int = 30
    ramp: str = "cubic"
    strength: float | None = None
    reflection: float = 1e-3
    plateau: float = 1 / 3
    form: str = "displacement"
    cross: float = 0.0
    shift: float = 0.0

    def __post_init__(self) -> None:
        kinds.settle(
            self,
            nodes=kinds.integer(self.nodes, "boundary.nodes", least=1),
            ramp=kinds.one_of(self.ramp, "boundary.ramp", (*RAMPS, "gaussian"), "unknown ramp"),
            strength=None if self.strength is None else kinds.number(self.strength, "boundary.strength", least=0),
            reflection=kinds.number(self.reflection, "boundary.reflection", above=0, below=1),
            plateau=kinds.number(self.plateau, "boundary.plateau", least=0, most=0.95),
            form=kinds.one_of(self.form, "boundary.form", FORMS, "unknown form"),
            cross=kinds.number(self.cross, "boundary.cross", least=0, most=1),
            shift=kinds.number(self.shift, "boundary.shift", least=0),
        )
        if self.shift and self.form == "split":
            raise InputError(
                "split fields take no shift", value=self.shift, key="boundary.shift", remedy='form = "displacement"'
            )

    def wanted(self, default: float) -> float:
        """What may be missed beyond the layer, as a part of the largest value."""
        return default

    def shape(self, depth: np.ndarray) -> np.ndarray:
        """phi over its largest value at depths 0 (entrance) to 1 (outer end)."""
        depth = np.asarray(depth, float)
        if self.ramp in RAMPS:
            return depth ** RAMPS[self.ramp]
        rise = 1 - self.plateau
        return np.exp(np.log(_FOOT) * np.maximum(0.0, 1 - depth / rise) ** 2)

    def stretch(self, spacing: float, speed: float) -> np.ndarray:
        """phi (1/time) on the layer's nodes from the near field outwards, shape (nodes,).

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
