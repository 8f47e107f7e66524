"""Incident waves given as functions of space and time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Box
from farhorizon.inputs.expressions import Expression, as_given
from farhorizon.inputs.incidence import Incident, Passage, Region, check_within
from farhorizon.inputs.sources import as_source

_TIMES, _NODES = 17, 500  # at which the equation of the lattice is checked
_MUCH = 0.05  # largest tolerated residual: that of a continuum wave of eight nodes
_EXACT = 1e-9  # of the acceleration: a function with a smaller residual counts as a wave of the lattice


@dataclass(frozen=True)
class IncidentField(Incident):
    r"""A wave that is incident on whatever is inside a box, given as a function of space and time.

    The run begins with the wave in its box, and joins total and scattered field on the faces as `IncidentWave` does. A
    wave that satisfies the equation of the lattice leaves nothing outside except rounding errors. To the extent that
    the function does not satisfy it, the difference is radiated by the whole box: inside it, the field is the
    continuation, on the lattice, of what enters through the faces.

    Parameters
    ----------
    field : callable, str or Expression, or a list of one per component
        A function of the coordinates and t, which is also evaluated one step before the start. For vectors, the return
        value of a callable has the components first.
    within : Box, optional
        The near field minus two reaches of the stencil unless given. If the box stands on a free side, the function is
        taken to be a wave of the half-space.

    Raises
    ------
    InputError
        When the simulation is created: a text that is not an expression, values that are not finite.

    Examples
    --------
    >>> import farhorizon as fh
    >>> ring = fh.IncidentField("cos(0.3*x)*cos(0.3*t)", fh.Box((-4.0, -4.0), (4.0, 4.0)))
    >>> lattice = fh.Lattice(0.5, (-6.0, -6.0), (6.0, 6.0))
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), sources=[ring])
    >>> any("equation of the lattice" in note for note in sim.check(until=10.0).notes)
    True
    """

    field: str | float | Sequence[Any] | Callable[..., Any]
    within: Box | None = None

    undamped: ClassVar[bool] = False

    def __post_init__(self) -> None:
        as_given(self.field, 3, "incident.field")
        check_within(self.within)

    def on(self, dim: int) -> Self:
        return replace(self, field=as_source(self.field, dim, "incident.field"))

    def passage(self, region: Region) -> Passage:
        """The function on the nodes."""
        return _GivenPassage(self.field, region)


class _GivenPassage(Passage):
    """An incident wave given as a function of space and time."""

    def __init__(self, field: Any, region: Region) -> None:
        self._field, self._region = field, region

    @property
    def midway(self) -> float:
        region = self._region
        return float(np.linalg.norm(region.last - region.first) / np.sqrt(region.scheme.rate) / 2)

    def at(self, nodes: np.ndarray) -> Callable[[float], np.ndarray]:
        places = self._region.places(nodes).T
        return lambda t: _values(self._field, places, t, self._region.scheme.stencil.components)

    def foresee(self, until: float) -> list[str]:
        """Check the residual of the equation of the lattice at some nodes of the box and some times of a run."""
        lacks = self._residual(until)
        text = (
            f"an incident field solves the equation of the lattice but for {lacks:.2g} of its acceleration: what it "
            "lacks of a wave of the lattice is radiated, too"
        )
        self.doubts = [text] if lacks > _MUCH else []
        return [text] if _EXACT < lacks <= _MUCH else []

    def _residual(self, until: float) -> float:
        region, scheme = self._region, self._region.scheme
        stencil, dt, components = scheme.stencil, scheme.dt, scheme.stencil.components
        nodes = region.nodes(_NODES)
        offsets, weights = stencil.offsets, stencil.weights.reshape(1, -1, components, components)
        if region.end is not None:
            offsets, weights = region.end.offsets, region.end.weights_at(nodes)
        around = nodes[:, None] + offsets
        near, far = self.at(nodes), self.at(around.reshape(-1, around.shape[-1]))
        keep = scheme.recursion.keep
        worst = largest = 0.0
        for t in np.linspace(0, until, _TIMES):
            now = near(t)
            stretch = far(t).reshape(components, *around.shape[:-1]) - now[:, :, None]
            force = scheme.rate * np.einsum("nkab,bnk->an", weights, stretch)
            change = (near(t + dt) - now - keep * (now - near(t - dt))) / scheme.recursion.scale
            worst = max(worst, float(np.abs(change - force).max()))
            largest = max(largest, float(np.abs(change).max()), float(np.abs(force).max()))
        return worst / largest if largest else 0.0


def _values(field: Any, places: np.ndarray, t: float, components: int) -> np.ndarray:
    """Values of a function of the coordinates and t at places (dim, n), shape (components, n)."""
    given = _value(field, places, t)
    several = isinstance(given, list | tuple) or (components > 1 and np.size(given) != 1)
    entries = list(given) if several else [given]
    if len(entries) != components:
        raise InputError(
            "an incident field needs one entry per component",
            value=f"{len(entries)} entries",
            limit=components,
            key="incident.field",
            remedy="one entry per axis for an elastic medium, a single one for a scalar field",
        )
    values = np.empty((components, places.shape[1]))
    for number, entry in enumerate(entries):
        part = kinds.array(_value(entry, places, t), "incident.field", finite=False)
        if part.shape not in ((), values.shape[1:]):
            raise InputError(
                "an incident field has one value a place",
                value=part.shape,
                limit=values.shape[1:],
                key="incident.field",
                remedy="a function of arrays that returns an array of their shape, or a number",
            )
        values[number] = part
    if not np.isfinite(values).all():
        raise InputError(
            "an incident field must be finite",
            value=f"not so at t = {t:g}",
            limit="no nan, no inf",
            key="incident.field",
            remedy="where(condition, a, b) in an expression restricts it to where it is defined",
        )
    return values


def _value(part: Any, places: np.ndarray, t: float) -> Any:
    """Value of a function at some places; anything else is returned as it is."""
    if isinstance(part, Expression):
        return part(*places, t=t)
    return part(*places, t) if callable(part) else part
