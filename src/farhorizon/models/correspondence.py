"""Correspondence elasticity with features of published programs: drag, and bonds that break by their stretch, with
shape tensors that are recomputed or kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from farhorizon import kinds
from farhorizon.arguments import Frequency
from farhorizon.errors import InputError
from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.kernel import Kernel
from farhorizon.models.elastic import Elastic
from farhorizon.models.model import Constant, Density, Modulus

SHAPE_TENSORS = ("recomputed", "published", "kept")


class Correspondence(Elastic):
    r"""A correspondence solid with damage: an `Elastic` model with ``material="correspondence"`` and drag.

    The deformation gradient and the force density of a node (Silling et al. 2007; Wildman and Gazonas 2012, eqs 2-6 to
    2-14) are

    .. math::

        e_i = \left(\sum_j w\,(u_j - u_i)\,\xi\right) K_i^{-1}, \quad K_i = \sum_j w\,\xi\,\xi, \quad
        \rho\,\ddot u_i = \sum_j w\,(\sigma_i K_i^{-1} + \sigma_j K_j^{-1})\,\xi + b_i, \quad \sigma = C : e.

    Parameters
    ----------
    kernel : Kernel
        Influence function times volume; its scale is irrelevant.
    young : float, str, ndarray or callable
        Young's modulus; where the material varies, an expression or a function of the coordinates, or the values at the
        nodes.
    poisson : float, str, ndarray or callable
        Poisson's ratio; given like `young`.
    density : float, str, ndarray or callable
        Mass per volume; given like `young`.
    plane : {"strain", "stress"}, optional
        Plane strain or plane stress in two dimensions; "strain" unless given.
    critical_stretch : float, str, ndarray or callable, optional
        Bonds whose relative elongation exceeds this value break permanently; unless given, none break. May vary like
        `young`: a bond breaks when its weaker end would.
    shape_tensor : {"recomputed", "published", "kept"}
        How K is determined at a node that loses bonds. "recomputed": from the remaining bonds (0 where its determinant
        is below a thousandth of that of an intact node), where nodes with fewer bonds than on a flat face bear less of
        their stress; "published": likewise, but all of their stress is borne, as published; "kept": K of the body
        without cracks, which softens gradually.
    drag : float
        Rate D/dt (1/time) at which a velocity relaxes towards the mean of its neighbours (Wildman and Gazonas 2012, eq.
        3-4). The rate, not D, is a property of the body: D itself is proportional to the time step.
    stabilisation : float
        0 to 1: fraction that is restored of the energy of displacements that do not contribute to the gradient (Silling
        2017); with 1, longitudinal waves are those of the bond-based operator of the same influence function. It
        increases the resistance to fracture: calibrate it together with the critical stretch.
    contact : bool
        Whether bonds that are cut or broken transmit compression, as in `Elastic`.
    friction : float
        As in `Elastic`.

    Raises
    ------
    InputError
        As in `Elastic`; a negative drag, an unknown shape tensor.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(1.0, (-8.0, -10.0), (8.0, 0.0))
    >>> glass = fh.Correspondence(fh.Kernel(2.0, 0, "gaussian", 1.0), young=1.0, poisson=0.25, drag=0.5)
    >>> sides = {"all": fh.NonlocalPML(10, cross=0.1), "y+": fh.Free()}
    >>> push = fh.Traction("y+", (0.0, -1e-3), between=[(-2.0, 2.0)])
    >>> sim = fh.Simulation(lattice, glass, sides, loads=[push])
    >>> sim.step(20)
    >>> bool(sim.fields["u"][1][8, -1] < 0)  # what is pushed gives way
    True
    """

    others: ClassVar[Mapping[str, str]] = {
        **Elastic.others,
        "fracture_energy": "critical_stretch: bonds break by their stretch here, and what a crack spends goes by the "
        'shape tensor and the drag as well; Elastic(material="correspondence"), whose bonds break by their energy, '
        "takes a fracture_energy",
    }

    def __init__(
        self,
        kernel: Kernel,
        young: Modulus,
        poisson: Constant,
        *,
        density: Density = 1.0,
        plane: str | None = None,
        critical_stretch: Constant | None = None,
        shape_tensor: str = "recomputed",
        drag: Frequency = 0.0,
        stabilisation: float = 0.0,
        contact: bool = False,
        friction: float = 0.0,
    ) -> None:
        super().__init__(
            kernel,
            young,
            poisson,
            density=density,
            material="correspondence",
            plane=plane,
            critical_stretch=critical_stretch,
            stabilisation=stabilisation,
            contact=contact,
            friction=friction,
        )
        if not isinstance(kernel, Kernel):
            raise InputError(
                "a correspondence solid is made of its kernel",
                value=kinds.said(kernel),
                key="model.kernel",
                remedy="Kernel(horizon=3*spacing)",
            )
        self.drag = kinds.number(drag, "model.drag", least=0)
        self.shape_tensor = kinds.one_of(shape_tensor, "model.shape_tensor", SHAPE_TENSORS, "unknown shape tensor")

    @property
    def title(self) -> str:
        """Name of the model in messages."""
        return "Correspondence"

    def force_states(self, spacing: float, dim: int) -> ForceStates | None:
        """Return gradients and stresses, computed with the chosen shape tensors; bonds break at their critical
        stretch.
        """
        states = super().force_states(spacing, dim)
        kept, unweakened = (self.shape_tensor == name for name in ("kept", "published"))
        return None if states is None else replace(states, kept=kept, unweakened=unweakened, released=None)
