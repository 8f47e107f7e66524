"""Plane waves that come from far away."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.references.pulse import PlanePulse
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.geometry.shapes import Box
from farhorizon.inputs.expressions import as_signal
from farhorizon.inputs.incidence import End, Incident, Passage, Region, check_within

_POLARISATIONS = ("P", "S")
_SAID = 1e-9  # part of a signal that a note is worth


@dataclass(frozen=True)
class IncidentWave(Incident):
    r"""A plane wave that falls on whatever is inside a box, exact on the lattice.

    Inside the box `within` the field is the total one, outside it only what is scattered, which the absorbing sides
    take. On the box's faces the two are joined by the sources :math:`\chi L u_i - L (\chi u_i)` with the incident wave
    :math:`u_i`, a sum of the lattice's own plane waves, and
    :math:`\chi` 1 inside and 0 outside: without a scatterer nothing leaves the box but rounding.

    Parameters
    ----------
    direction : sequence of float
        Along which it travels; its length does not matter.
    signal : callable, str or Expression
        Displacement as a function of t, where the wave meets the box first.
    duration : float
        The signal is zero before 0 and after it.
    polarisation : "P", "S" or sequence of float
        Of elastic waves. In three dimensions an S wave needs its displacement's direction, at right angles to
        `direction`.
    within : Box, optional
        The near field less two reaches of the stencil unless given. It contains all that scatters, two reaches inside
        its faces.

    Raises
    ------
    InputError
        A direction without length, a duration that is not positive, a signal that is no function of t, an unknown
        polarisation.

    Examples
    --------
    >>> import farhorizon as fh
    >>> plane = fh.IncidentWave((1.0, 0.0), "exp(-(t - 6)**2/2)", duration=12.0)
    >>> lattice = fh.Lattice(0.5, (-6.0, -6.0), (6.0, 6.0))
    >>> notch = [[(0.25, -1.0), (0.25, 1.0)]]
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), sources=[plane], cracks=notch)
    >>> len(sim.incident)
    1
    """

    direction: Sequence[float]
    signal: Any
    duration: float
    polarisation: str | Sequence[float] = "P"
    within: Box | None = None

    plane: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not kinds.array(self.direction, "incident.direction", shape=(None,)).any():
            raise InputError(
                "an incident wave needs a direction",
                value=self.direction,
                limit="one component an axis, not all zero",
                key="incident.direction",
            )
        kinds.settle(
            self,
            duration=kinds.number(self.duration, "incident.duration", above=0),
            signal=as_signal(self.signal, "incident.signal"),
        )
        if isinstance(self.polarisation, str):
            kinds.one_of(self.polarisation, "incident.polarisation", _POLARISATIONS, "unknown polarisation")
        else:
            kinds.array(self.polarisation, "incident.polarisation", shape=(None,))
        check_within(self.within)

    def at(self, t: float) -> float:
        """The signal at a time."""
        return signal_at(self.signal, self.duration, t)

    @property
    def along(self) -> np.ndarray:
        """The direction as a unit vector."""
        direction = np.asarray(self.direction, float)
        return direction / np.linalg.norm(direction)

    def resolved(self, lattice: Lattice, reach: Sequence[int], ends: Mapping[End, bool] | None = None) -> Self:
        """The same wave with its box; see `Incident.resolved`."""
        check_direction(self.direction, lattice.dim)
        return super().resolved(lattice, reach, ends)

    def start(self, region: Region) -> float:
        """Where, along its direction from the origin, the wave meets the box first and has its signal."""
        return float(sum(min(n * a, n * b) for n, a, b in zip(self.along, *_corners(region), strict=True)))

    def passage(self, region: Region) -> Passage:
        """The wave in the open medium."""
        if region.surface is not None:
            axis, side = region.surface
            raise InputError(
                "an incident wave does not know the surface that it would fall on",
                value=AXES[axis] + "-+"[side > 0],
                key="incident.within",
                limit="one reach away from sides at which the medium ends",
                remedy="a source below the surface, or initial data in the form of the wave",
            )
        return _PlanePassage(self, region)

    def vector(self, components: int) -> np.ndarray | None:
        """Unit vector of the displacement; None for scalar fields.

        Raises
        ------
        InputError
            A displacement neither along the direction nor at right angles to it; "S" in three dimensions.
        """
        if components == 1:
            return None
        along = self.along
        if self.polarisation == "P":
            return along
        if self.polarisation == "S":
            if components == 3:
                raise InputError(
                    "an S wave in three dimensions needs the direction of its displacement",
                    value="S",
                    key="incident.polarisation",
                    limit="a vector at right angles to the direction",
                )
            return np.array([-along[1], along[0]])
        vector = np.asarray(self.polarisation, float)
        length = float(np.linalg.norm(vector))
        if vector.shape != along.shape or not length > 0:
            raise InputError(
                "a polarisation has one component an axis, not all zero",
                value=self.polarisation,
                key="incident.polarisation",
            )
        vector = vector / length
        if 1e-6 < abs(vector @ along) < 1 - 1e-6:
            raise InputError(
                "a wave's displacement is along its direction (P) or at right angles to it (S)",
                value=self.polarisation,
                limit=f"direction {along.tolist()}",
                key="incident.polarisation",
            )
        return vector


def signal_at(signal: Callable[[float], Any], duration: float, t: float) -> float:
    """A signal that is zero before 0 and after its duration, at a time."""
    return float(kinds.array(signal(t), "incident.signal", shape=())) if 0 <= t <= duration else 0.0


def check_direction(direction: Sequence[float], dim: int) -> None:
    """InputError unless it has one component an axis."""
    if np.size(direction) != dim:
        raise InputError(
            "an incident wave and the lattice differ in dimension", value=np.size(direction), limit=dim, key="incident"
        )


def _corners(region: Region) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the first and the last node of a box."""
    low, high = region.places(np.stack([region.first, region.last]))
    return low, high


class _PlanePassage(Passage):
    """A plane wave in the open medium."""

    rests = True

    def __init__(self, wave: IncidentWave, region: Region) -> None:
        self._region, self._start, self._along = region, wave.start(region), wave.along
        scheme, spacing = region.scheme, region.lattice.spacing
        far = sum(max(n * a, n * b) for n, a, b in zip(wave.along, *_corners(region), strict=True))
        self.pulse = PlanePulse(
            scheme.stencil,
            scheme.rate * spacing**2,
            spacing,
            scheme.dt,
            wave.along,
            wave.vector(scheme.stencil.components),
            wave.at,
            wave.duration,
            float(far) - self._start,
        )
        self.period = self.pulse.period
        self.midway = (wave.duration + self.pulse.distance / self.pulse.speed) / 2
        self.notes = lost_notes(self.pulse)

    def at(self, nodes: np.ndarray) -> Callable[[float], np.ndarray]:
        return self.pulse.at(self._region.places(nodes) @ self._along - self._start)


def lost_notes(pulse: PlanePulse) -> list[str]:
    """What of the signal the lattice does not carry, where it is worth a note."""
    if pulse.lost <= _SAID:
        return []
    return [
        f"a part of {pulse.lost:.1g} of an incident wave's signal is shorter than the lattice carries: "
        "so much leaks from its box"
    ]
