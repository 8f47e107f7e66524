"""Base of the waves that travel in a direction with a signal: plane waves and waves along a surface."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.surface_pulses import SurfacePulse
from farhorizon.arguments import Duration, OfTime
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.expressions import as_signal
from farhorizon.inputs.incidence import End, Incident, Passage, Region, check_within
from farhorizon.medium.free_side import FreeSide

_SAID = 1e-9  # part of a signal above which there is a note
_MOMENTS = 257  # times at which the middle of a box is sampled


@dataclass(frozen=True)
class TravellingWave(Incident):
    """A wave in a given direction, with a given signal where it first meets its box.

    Parameters
    ----------
    direction : sequence of float
        Direction of propagation; its length is irrelevant.
    signal : callable, str or Expression
        Displacement as a function of t at the point where the wave first meets the box.
    duration : float
        Duration of the signal, which is zero before 0 and after this time.

    Raises
    ------
    InputError
        A direction of zero length, a duration that is not positive, a signal that is not a function of t.
    """

    direction: Sequence[float]
    signal: OfTime
    duration: Duration

    def __post_init__(self) -> None:
        kinds.set_fields(
            self,
            direction=_as_direction(self.direction),
            duration=kinds.number(self.duration, "incident.duration", above=0),
            signal=as_signal(self.signal, "incident.signal"),
        )
        check_within(self.within)

    def at(self, t: float) -> float:
        """The signal at a time: zero before 0 and after its duration."""
        return float(kinds.array(self.signal(t), "incident.signal", shape=())) if 0 <= t <= self.duration else 0.0

    def velocities(self, times: np.ndarray) -> np.ndarray | None:
        """Rates of change of the signal at equidistant times, up to a factor."""
        return np.gradient([self.at(t) for t in times.tolist()]) if len(times) > 1 else None

    @property
    def along(self) -> np.ndarray:
        """The direction as a unit vector."""
        direction = np.asarray(self.direction, float)
        return direction / np.linalg.norm(direction)

    def resolved(self, lattice: Lattice, reach: Sequence[int], ends: Mapping[End, bool] | None = None) -> Self:
        """The same wave with its box; see `Incident.resolved`."""
        if np.size(self.direction) != lattice.dim:
            raise InputError(
                "an incident wave and the lattice differ in dimension",
                value=np.size(self.direction),
                limit=lattice.dim,
                key="incident",
                remedy="a direction with one component an axis of the lattice",
            )
        return super().resolved(lattice, reach, ends)

    def way(self, region: Region) -> tuple[float, float]:
        """Range of the coordinate along the direction, from the origin, in which the wave is inside the box."""
        ends = region.places(np.stack([region.first, region.last]))
        begin, end = np.sort(self.along * ends, axis=0).sum(1).tolist()
        return begin, end


class SurfacePassage(Passage):
    """A pulse in a half-space."""

    def __init__(self, pulse: SurfacePulse, region: Region, end: FreeSide) -> None:
        self._pulse, self._region, self._end = pulse, region, end
        self.period, self.tail = pulse.period, pulse.tail
        self.notes = lost_notes(pulse.lost)
        if pulse.tail > _SAID:
            self.notes.append(
                f"an incident wave at a free surface has a tail before and after it, of {pulse.tail:.1g} of its "
                f"signal: the run begins with it, and at t = {pulse.period:.4g} what is left of it is radiated"
            )

    @cached_property
    def midway(self) -> float:
        """Time at which the wave is strongest in the middle of the box: its tails may be far longer."""
        value = self.at((self._region.first + self._region.last)[None] // 2)
        return max(np.linspace(0, self.period, _MOMENTS).tolist(), key=lambda t: float(np.abs(value(t)).max()))

    def at(self, nodes: np.ndarray) -> Callable[[float], np.ndarray]:
        return self._pulse.waves.at(self._region.places(nodes) @ self._pulse.direction, self._end.row(nodes))


def lost_notes(lost: float) -> list[str]:
    """Notes on the part of a signal that the lattice does not carry, if it is large enough."""
    if lost <= _SAID:
        return []
    return [
        f"a part of {lost:.1g} of an incident wave's signal is shorter than the lattice carries: "
        "this part leaks from its box"
    ]


def _as_direction(direction: Any) -> Any:
    given = kinds.array(direction, "incident.direction", shape=(None,))
    kinds.check_magnitude(given, "incident.direction")
    if not given.any():
        raise InputError(
            "an incident wave needs a direction",
            value=direction,
            limit="one component an axis, not all zero",
            key="incident.direction",
            remedy="(1, 0) in two dimensions for a wave along x",
        )
    return direction
