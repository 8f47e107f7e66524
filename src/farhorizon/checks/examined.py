"""What the checks need of a set-up: protocols that `Simulation` fulfils, so that no check depends on how it runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from farhorizon.analysis.extent import Extent
from farhorizon.analysis.layers.thickness import Thickness
from farhorizon.boundaries import ExactEnds, OutlineCondition, Side
from farhorizon.engine.engine import Engine
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.conditions import Conditions
from farhorizon.inputs.incidence import Incidence
from farhorizon.inputs.prescribed import PrescribedNodes
from farhorizon.inputs.signals import Signal
from farhorizon.medium.stencil import Stencil
from farhorizon.models import LatticeModel


class Timed(Protocol):
    """A run whose steps can be timed.

    Attributes
    ----------
    dt : float
    """

    dt: float

    def seconds_per_step(self) -> float:
        """Time of a step on this machine now; the state is left unchanged."""


class Examined(Timed, Protocol):
    """A set-up before its run.

    Attributes
    ----------
    given : dict of str to object
        What it was made of except the initial data, by the names of the arguments of `Simulation`.
    lattice : Lattice
        The near field.
    model : LatticeModel
    stencil : Stencil
    engine : Engine
    sides : dict of (axis, side) to Side
    background : float
    step_limit, rate_limit, fastest_rate : float
        Largest stable time step; largest rate of the operator, and largest factor on the stencil (1/time, or 1/time^2
        of waves).
    strongest, weakest : float
        Largest squared speed relative to that of the model, and the smallest one that is not zero.
    growth : float
        Rate (1/time) at which the medium itself lets a uniform field grow, by a negative reaction.
    of_field : bool
        Whether a source or a constant of the model depends on the field.
    varied : bool
        Whether the medium varies from node to node.
    field_shape : tuple of int
        Shape of the lattice, preceded by the number of components for vectors.
    start_u, start_v : ndarray
        Initial data of that shape.
    sources : list
        (space, time) of each source, as given by `farhorizon.inputs.sources.split`.
    signals : list of (str, Signal)
        Name and signal of everything that drives the set-up, as far as the spectra are known.
    incident : list of Incidence
    conditions : Conditions
    prescribed : PrescribedNodes
    leak : ndarray
        Rate at which each node loses its value to the surroundings of the body; shape of the lattice, or empty if there
        is no loss.
    closure : OutlineCondition or None
        Condition along the outline of the near field.
    coefficients : dict of (axis, side) to float
        Squared speed or diffusivity of the medium at each side.
    extents : dict of (axis, side) to Extent
        How far the medium is computed beyond sides that extend it.
    recorders : list of farhorizon.simulation.recorders.recorder.Recorder
    """

    given: dict[str, Any]
    lattice: Lattice
    model: LatticeModel
    stencil: Stencil
    engine: Engine
    sides: dict[tuple[int, int], Side]
    background: float
    step_limit: float
    rate_limit: float
    fastest_rate: float
    strongest: float
    weakest: float
    growth: float
    of_field: bool
    varied: bool
    field_shape: tuple[int, ...]
    start_u: np.ndarray
    start_v: np.ndarray
    sources: list[tuple[np.ndarray | None, Callable[..., Any]]]
    signals: list[tuple[str, Signal]]
    incident: list[Incidence]
    conditions: Conditions
    prescribed: PrescribedNodes
    leak: np.ndarray
    closure: OutlineCondition | None
    coefficients: dict[tuple[int, int], float]
    extents: dict[tuple[int, int], Extent]
    recorders: list[Any]

    @property
    def thickness(self) -> dict[str, Thickness]:
        """Layers that were chosen, with their errors, by name of the side."""

    @property
    def doubts(self) -> list[str]:
        """Warnings about layers and extended domains that may miss their targets; `notes` contains the first ones."""

    @property
    def crossing(self) -> float:
        """The set-up's own unit of time: the fastest wave crosses the near field in it, or diffusion empties the near
        field.
        """

    @property
    def targets(self) -> dict[tuple[int, int], float]:
        """Fraction of the largest value that may be neglected beyond each absorbing side."""

    @property
    def exact_ends(self) -> ExactEnds | None:
        """The exact ends; None if there are none."""

    @property
    def ends(self) -> dict[str, str]:
        """Representation of each exact end."""

    @property
    def fields(self) -> dict[str, np.ndarray]:
        """Copies of the fields on the near field, by name."""

    @property
    def notes(self) -> list[str]:
        """What is allowed, but worth knowing."""

    def extents_for(self, wanted: Mapping[tuple[int, int], float], until: float) -> dict[tuple[int, int], Extent]:
        """How far the medium must be computed beyond the given sides so that nothing returns during a run."""

    def shortened(self) -> Examined | None:
        """The same set-up with shorter stretches of equal planes; None if that is not much smaller."""

    def remade(self, **changes: Any) -> Examined:
        """The same set-up at its start, with some arguments of `Simulation` changed."""
