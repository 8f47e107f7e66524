"""Rayleigh waves, which run along a free surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from farhorizon.analysis.references.pulse import sampled
from farhorizon.analysis.surface_pulses import rayleigh_pulse
from farhorizon.errors import InputError
from farhorizon.geometry.shapes import Box
from farhorizon.inputs.incidence import End, Passage, Region
from farhorizon.inputs.travelling_waves import SurfacePassage, TravellingWave

_ALONG = 1e-9  # component of a unit vector along a normal below which a wave runs along the side


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
