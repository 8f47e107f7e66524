"""Incident plane waves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.references.pulse import PlanePulse, sampled
from farhorizon.analysis.surface_pulses import reflected_pulse
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Box
from farhorizon.inputs.incidence import End, Passage, Region
from farhorizon.inputs.travelling_waves import SurfacePassage, TravellingWave, lost_notes

_POLARISATIONS = ("P", "S")
_TOWARDS = 1e-9  # component of a unit vector along a normal above which a wave comes to the side


@dataclass(frozen=True)
class IncidentWave(TravellingWave):
    r"""A plane wave that is incident on whatever is inside a box, exact on the lattice.

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
        everything that scatters, at least two reaches inside its faces.

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
        met = [(axis, side) for axis, side in free if side * self.along[axis] > _TOWARDS]
        return met[0] if len(met) == 1 else None

    def passage(self, region: Region) -> Passage:
        """The wave in the open medium, or including its reflection from the free side of the box."""
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
        if 1e-6 < abs(vector @ along) < 1 - 1e-6:
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
