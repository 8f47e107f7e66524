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
    """A run whose steps can be timed."""

    dt: float

    def seconds_per_step(self) -> float:
        """Time of a step on this machine now; the state is left unchanged."""


class Examined(Timed, Protocol):
    """A set-up before its run; sides are (axis, -1 or 1)."""

    given: dict[str, Any]  # arguments of `Simulation`, except the initial data
    lattice: Lattice
    model: LatticeModel
    stencil: Stencil
    engine: Engine
    sides: dict[tuple[int, int], Side]
    background: float
    step_limit: float  # largest stable time step
    rate_limit: float  # largest rate of the operator: 1/time, or 1/time^2 of waves
    fastest_rate: float  # largest factor on the stencil, in the same unit
    strongest: float  # largest squared speed over that of the model
    weakest: float  # the smallest one that is not zero
    growth: float  # rate (1/time) at which a negative reaction lets a uniform field grow
    of_field: bool  # whether a source or a constant of the model depends on the field
    varied: bool  # whether the medium varies from node to node
    field_shape: tuple[int, ...]  # that of the lattice, preceded by the number of components for vectors
    start_u: np.ndarray  # initial data of that shape
    start_v: np.ndarray
    sources: list[tuple[np.ndarray | None, Callable[..., Any]]]  # as given by `farhorizon.inputs.sources.split`
    signals: list[tuple[str, Signal]]  # name and signal of each source whose spectrum is known
    incident: list[Incidence]
    conditions: Conditions
    prescribed: PrescribedNodes
    leak: np.ndarray  # rate at which each node loses its value beyond the body; empty if there is no loss
    closure: OutlineCondition | None  # condition along the outline of the near field
    coefficients: dict[tuple[int, int], float]  # squared speed or diffusivity at each side
    extents: dict[tuple[int, int], Extent]  # of the medium beyond sides that extend it
    recorders: list[Any]

    @property
    def thickness(self) -> dict[str, Thickness]:
        """Layers that were chosen, with their errors, by name of the side."""

    @property
    def doubts(self) -> list[str]:
        """Warnings about layers and extended domains that may miss their targets; `notes` begins with them."""

    @property
    def crossing(self) -> float:
        """Time in which the fastest wave crosses the near field, or in which diffusion empties it."""

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
