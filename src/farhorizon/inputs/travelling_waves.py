"""Waves that travel in a direction with a signal: plane waves, and Rayleigh waves along a free surface."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from farhorizon import kinds
from farhorizon.analysis.references.pulse import PlanePulse, sampled
from farhorizon.analysis.surface_pulses import SurfacePulse, rayleigh_pulse, reflected_pulse
from farhorizon.arguments import Duration, OfTime
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Box
from farhorizon.inputs.expressions import as_signal
from farhorizon.inputs.incidence import End, Incident, Passage, Region, check_within
from farhorizon.inputs.sources import at_times
from farhorizon.medium.stratified_medium import StratifiedMedium

_POLARISATIONS = ("P", "S")
_ALONG = 1e-9  # component of a unit vector along a normal up to which a wave runs along the side
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

    def at(self, times: ArrayLike) -> np.ndarray:
        """The signal at times of any shape: zero before 0 and after its duration."""
        times = np.asarray(times, float)
        during = (times >= 0) & (times <= self.duration)
        values = np.zeros(times.shape)
        values[during] = at_times(self.signal, times[during], "incident.signal")
        return values

    def velocities(self, times: np.ndarray) -> np.ndarray | None:
        """Rates of change of the signal at equidistant times, up to a factor."""
        return np.gradient(self.at(times)) if len(times) > 1 else None

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

    def heads(self, axis: int) -> int:
        """Direction along an axis in which the wave travels."""
        return -1 if self.along[axis] < 0 else 1

    def way(self, region: Region) -> tuple[float, float]:
        """Range of the coordinate along the direction, from the origin, in which the wave is inside the box."""
        ends = region.places(np.stack([region.first, region.last]))
        begin, end = np.sort(self.along * ends, axis=0).sum(1).tolist()
        return begin, end


class SurfacePassage(Passage):
    """A pulse at a free surface, or in strata."""

    def __init__(self, pulse: SurfacePulse, region: Region, end: StratifiedMedium) -> None:
        self._pulse, self._region, self._end = pulse, region, end
        self.period, self.tail = pulse.period, pulse.tail
        self.notes = lost_notes(pulse.lost)
        if pulse.tail > _SAID:
            self.notes.append(
                f"an incident wave at a surface or in strata has a tail before and after it, of {pulse.tail:.1g} of "
                f"its signal: the run begins with it, and at t = {pulse.period:.4g} what is left of it is radiated"
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


@dataclass(frozen=True)
class IncidentWave(TravellingWave):
    r"""A plane wave that is incident on whatever is inside a box, exact on the lattice, also where it comes to strata.

    Inside the box `within` the field is the total field, outside it only the scattered field, which the absorbing sides
    absorb. On the faces of the box the two are joined by the sources :math:`\chi L u_i - L (\chi u_i)`, where the
    incident wave :math:`u_i` is a sum of the lattice's own plane waves and :math:`\chi` is 1 inside and 0 outside:
    without a scatterer nothing leaves the box except rounding errors.

    Parameters
    ----------
    direction : sequence of float
        Direction of propagation; its length is irrelevant.
    signal : callable, str or Expression
        Displacement as a function of t at the point where the wave first meets the box.
    duration : float
        Duration of the signal, which is zero before 0 and after this time.
    polarisation : "P", "S" or sequence of float
        For elastic waves. In three dimensions an S wave requires the direction of its displacement, perpendicular to
        `direction`.
    within : Box, optional
        Unless given, the near field minus two reaches of the stencil; if the wave travels towards a free side, the box
        extends to that side, and the incident wave includes everything that the surface reflects. The box must contain
        everything that scatters, at least two reaches inside its faces. Strata parallel to that side, or to any side if
        the box stands on none, are not scatterers if they continue through the faces of the box: the wave comes from
        the medium that lies before them on its way, and includes what they reflect and transmit.

    Raises
    ------
    InputError
        A direction of zero length, a duration that is not positive, a signal that is not a function of t, an unknown
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

    polarisation: str | Sequence[float] = "P"
    within: Box | None = None

    plane: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.polarisation, str):
            kinds.one_of(self.polarisation, "incident.polarisation", _POLARISATIONS, "unknown polarisation")
        else:
            kinds.array(self.polarisation, "incident.polarisation", shape=(None,))

    def start(self, region: Region) -> float:
        """Coordinate along its direction at which the wave first meets the box and has the given signal."""
        return self.way(region)[0]

    def surface_met(self, free: Sequence[End]) -> End | None:
        """The free side towards which the wave travels, if there is exactly one."""
        met = [(axis, side) for axis, side in free if side * self.along[axis] > _ALONG]
        return met[0] if len(met) == 1 else None

    def passage(self, region: Region) -> Passage:
        """The wave in the open medium, or including what it becomes at the free side of the box and in strata."""
        if region.end is None:
            return _PlanePassage(self, region)
        pulse = reflected_pulse(
            region.under(region.end),
            lambda period: self.pulse(region, period),
            self.along,
            self.way(region),
            sampled(self.at, self.duration, region.scheme.dt),
        )
        return SurfacePassage(pulse, region, region.end)

    def pulse(self, region: Region, period: float | None = None) -> PlanePulse:
        """The wave in the open medium, repeated with a period; by default, it is repeated once it has passed."""
        scheme, spacing = region.scheme, region.lattice.spacing
        begin, end = self.way(region)
        return PlanePulse(
            scheme.stencil,
            scheme.rate * spacing**2,
            spacing,
            scheme.dt,
            self.along,
            self.vector(scheme.stencil.components),
            self.at,
            self.duration,
            end - begin,
            period,
        )

    def vector(self, components: int) -> np.ndarray | None:
        """Unit vector of the displacement; None for scalar fields.

        Raises
        ------
        InputError
            A displacement that is neither parallel nor perpendicular to the direction; "S" in three dimensions.
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
                    remedy="polarisation = [...]",
                )
            return np.array([-along[1], along[0]])
        vector = np.asarray(self.polarisation, float)
        length = float(np.linalg.norm(vector))
        if vector.shape != along.shape or not length > 0:
            raise InputError(
                "a polarisation has one component an axis, not all zero",
                value=self.polarisation,
                limit=f"{along.size} components",
                key="incident.polarisation",
                remedy='"P", "S" or the direction of the displacement',
            )
        vector = vector / length
        if 1e-6 < abs(vector @ along) < 1 - 1e-6:  # six digits are typed
            raise InputError(
                "a wave's displacement is along its direction (P) or at right angles to it (S)",
                value=self.polarisation,
                limit=f"direction {along.tolist()}",
                key="incident.polarisation",
                remedy="a wave for each part of it",
            )
        return vector


class _PlanePassage(Passage):
    """A plane wave in the open medium."""

    rests = True

    def __init__(self, wave: IncidentWave, region: Region) -> None:
        self._region, self._start, self._along = region, wave.start(region), wave.along
        self.pulse = wave.pulse(region)
        self.period = self.pulse.period
        self._duration = wave.duration
        self.notes = lost_notes(self.pulse.lost)

    @property
    def midway(self) -> float:
        return (self._duration + self.pulse.distance / self.pulse.speed) / 2

    def at(self, nodes: np.ndarray) -> Callable[[float], np.ndarray]:
        return self.pulse.at(self._region.places(nodes) @ self._along - self._start)


@dataclass(frozen=True)
class RayleighWave(TravellingWave):
    """A surface wave incident along a free surface of an elastic medium, exact on the lattice: at each frequency, the
    mode of the half-infinite lattice that decays downwards.

    Parameters
    ----------
    direction : sequence of float
        Direction of propagation along the surface; its length is irrelevant.
    signal : callable, str or Expression
        Displacement of the surface along its outward normal as a function of t, at the point where the wave first meets
        the box.
    duration : float
        Duration of the signal, which is zero before 0 and after this time.
    within : Box, optional
        Box that stands on the free side, otherwise as in `IncidentWave`. Unless given, it stands on the only free side
        parallel to the direction.

    Raises
    ------
    InputError
        A direction of zero length, a duration that is not positive, a signal that is not a function of t. When the
        simulation is created: a box that does not stand on a free side parallel to the direction, a scalar field,
        frequencies at which no such wave exists.

    Notes
    -----
    The displacement along the surface is a Hilbert transform of the signal, which has a tail before and after it. Over
    a depth of one horizon the surface of a lattice is softer than that of the continuum, so that short waves are slower
    (Lord Rayleigh, Proc. Lond. Math. Soc. 17 (1885) 4, gives the speed of long ones).

    Examples
    --------
    >>> import farhorizon as fh
    >>> along = fh.RayleighWave((1.0, 0.0), "sin(t/3)*exp(-((t - 40)/8)**2)", duration=80.0)
    >>> ground = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 0.0))
    >>> half_space = {"all": fh.LatticePML(), "y+": fh.Free()}
    >>> sim = fh.Simulation(ground, fh.Elastic(fh.Kernel(2.0), young=1.0), half_space, sources=[along])
    >>> len(sim.incident)
    1
    """

    within: Box | None = None

    def surface_met(self, free: Sequence[End]) -> End | None:
        """The free side along which the wave travels, if there is exactly one."""
        met = [(axis, side) for axis, side in free if abs(self.along[axis]) < _ALONG]
        return met[0] if len(met) == 1 else None

    def passage(self, region: Region) -> Passage:
        """The wave below the free side on which its box stands."""
        end = region.end
        if end is None or abs(self.along[end.axis]) > _ALONG:
            raise InputError(
                "a Rayleigh wave runs along a free side, on which its box stands",
                value=self.along.tolist(),
                limit="along a Free side that the box reaches",
                key="incident.direction",
                remedy="a Free side, a direction along it, and a box that reaches it",
            )
        if end.strata is not None:
            raise InputError(
                "a Rayleigh wave is one of a uniform half-space",
                value="strata at the faces of its box",
                limit="one medium outside the box",
                key="incident",
                remedy="an IncidentWave from below, or a record of a larger run",
            )
        if region.scheme.stencil.components == 1:
            raise InputError(
                "a scalar field has no Rayleigh waves",
                value="1 component",
                limit="Elastic",
                key="incident",
                remedy="an Elastic medium",
            )
        samples = sampled(self.at, self.duration, region.scheme.dt)
        pulse = rayleigh_pulse(region.under(end), self.along, self.way(region), samples)
        return SurfacePassage(pulse, region, end)
