"""Plane waves that come from far away: the field inside a box is the total one, outside it the scattered one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.references.pulse import PlanePulse
from farhorizon.errors import InputError, shown
from farhorizon.files.storable import Storable
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.geometry.shapes import Box, Cut
from farhorizon.inputs.expressions import as_signal
from farhorizon.medium.stencil import Stencil

_POLARISATIONS = ("P", "S")


@dataclass(frozen=True)
class IncidentWave(Storable):
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
        if self.within is not None:
            kinds.instance(self.within, "incident.within", Box, "a Box")

    def at(self, t: float) -> float:
        """The signal at a time."""
        return float(kinds.array(self.signal(t), "incident.signal", shape=())) if 0 <= t <= self.duration else 0.0

    def resolved(self, lattice: Lattice, reach: Sequence[int], walls: Sequence[tuple[int, int]] = ()) -> IncidentWave:
        """The same wave with its box.

        Parameters
        ----------
        lattice : Lattice
        reach : sequence of int
        walls : sequence of (axis, side)
            Sides at which the medium ends.

        Raises
        ------
        InputError
            A box that is not inside the near field by one reach, or reaches a side at which the medium ends, or is so
            small that its faces' neighbourhoods meet.
        """
        more = lattice.spacing * np.array(reach)
        box = self.within or Box(tuple(lattice.lower + 2 * more), tuple(lattice.upper - 2 * more))
        lower, upper = (np.asarray(b, float) for b in box.bounds())
        if lower.size != lattice.dim or np.size(self.direction) != lattice.dim:
            raise InputError(
                "an incident wave and the lattice differ in dimension",
                value=np.size(self.direction),
                limit=lattice.dim,
                key="incident",
            )
        close = 1e-6 * lattice.spacing
        outside = (lower - more < lattice.lower - close) | (upper + more > lattice.upper + close)
        past = {-1: lower - more < lattice.lower - close, 1: upper + more > lattice.upper + close}
        beyond = [(axis, side) for axis, side in walls if past[side][axis]]
        if beyond:
            names = ", ".join(AXES[axis] + "-+"[side > 0] for axis, side in beyond)
            raise InputError(
                "an incident wave is the wave of the open medium, which does not know the surface that it would fall "
                "on",
                value=names,
                key="incident.within",
                limit="one reach away from sides at which the medium ends",
                remedy="a source below the surface, or initial data in the form of the wave",
            )
        if outside.any():
            axis = int(np.argmax(outside))
            limits = shown((lattice.lower + more)[axis]), shown((lattice.upper - more)[axis])
            raise InputError(
                f"the box of an incident wave reaches too far along {AXES[axis]}: one reach of the near field must be "
                "left around it",
                value=f"{shown(lower[axis])} to {shown(upper[axis])}",
                key="incident.within",
                limit=f"within {limits[0]} to {limits[1]}",
                remedy="a smaller box, or a larger near field",
            )
        if (upper - lower < 4 * more - close).any():
            raise InputError(
                "the box of an incident wave is too small",
                value=(upper - lower).tolist(),
                limit=f"sides of {(4 * more).tolist()}",
                key="incident.within",
                remedy="enlarge the near field",
            )
        return IncidentWave(
            self.direction,
            self.signal,
            self.duration,
            self.polarisation,
            Box(tuple(lower.tolist()), tuple(upper.tolist())),
        )

    def vector(self, components: int) -> np.ndarray | None:
        """Unit vector of the displacement; None for scalar fields.

        Raises
        ------
        InputError
            A displacement neither along the direction nor at right angles to it; "S" in three dimensions.
        """
        if components == 1:
            return None
        along = np.asarray(self.direction, float) / np.linalg.norm(self.direction)
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


class Incidence:
    """An incident wave on a lattice: what joins total and scattered field.

    Parameters
    ----------
    wave : IncidentWave
        With its box.
    lattice : Lattice
    stencil : Stencil
    coefficient : float
        Of the medium outside the box, for which the wave is made.
    dt : float
    operator : callable
        L of a field of the lattice's shape (with components first), zero beyond it.

    Attributes
    ----------
    pulse : PlanePulse
    start : float
        Where, along its direction from the origin, the wave meets the box first and has its signal.

    Raises
    ------
    InputError
        As `PlanePulse`.
    """

    def __init__(
        self,
        wave: IncidentWave,
        lattice: Lattice,
        stencil: Stencil,
        coefficient: float,
        dt: float,
        operator: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        self.wave, self._operator = wave, operator
        direction = np.asarray(wave.direction, float) / np.linalg.norm(wave.direction)
        along = sum(n * x for n, x in zip(direction, np.ix_(*lattice.axes), strict=True))
        self._shape = (stencil.components, *lattice.shape)
        box = self._slices(lattice, 0)
        self.start = float(along[box].min())
        self._along = along - self.start
        self.pulse = PlanePulse(
            stencil,
            coefficient,
            lattice.spacing,
            dt,
            direction,
            wave.vector(stencil.components),
            wave.at,
            wave.duration,
            float(self._along[box].max()),
        )
        reach = np.array(stencil.reach)
        self._inside = self._mask(lattice, box, self._slices(lattice, -2 * reach))
        self._outside_in = self._mask(lattice, self._slices(lattice, reach), self._slices(lattice, -reach))
        self._values = self.pulse.at(self._along[self._inside])

    def _slices(self, lattice: Lattice, more: np.ndarray | int) -> tuple[slice, ...]:
        """Nodes of the box grown by some nodes an axis."""
        assert self.wave.within is not None
        lower, upper = (np.asarray(b, float) for b in self.wave.within.bounds())
        first = np.ceil((lower - lattice.lower) / lattice.spacing - 1e-6).astype(int) - more
        last = np.floor((upper - lattice.lower) / lattice.spacing + 1e-6).astype(int) + more
        return tuple(slice(int(a), int(b) + 1) for a, b in zip(first, last, strict=True))

    @staticmethod
    def _mask(lattice: Lattice, outer: tuple[slice, ...], inner: tuple[slice, ...]) -> np.ndarray:
        """Nodes of one box without those of a smaller one."""
        mask = np.zeros(lattice.shape, bool)
        mask[outer] = True
        mask[inner] = False
        return mask

    def source(self, t: float) -> np.ndarray:
        """``chi a - L (chi u)`` on the lattice, of displacement u and acceleration a of the wave; zero once it has
        passed.
        """
        force = np.zeros(self._shape)
        if t < self.pulse.period:
            displacement = np.zeros(self._shape)
            displacement[:, self._inside], force[:, self._inside] = self._values(t)
            force -= self._operator(displacement.reshape(self._field_shape)).reshape(self._shape)
            force[:, ~self._outside_in] = 0
        return force.reshape(self._field_shape)

    def field(self, t: float) -> np.ndarray:
        """The incident wave everywhere on the lattice, of the field's shape."""
        if t >= self.pulse.period:
            return np.zeros(self._field_shape)
        return self.pulse.at(self._along.ravel())(t)[0].reshape(self._field_shape)

    @property
    def midway(self) -> float:
        """A time at which the pulse is on its way through the box."""
        return (self.wave.duration + self.pulse.distance / self.pulse.speed) / 2

    @property
    def _field_shape(self) -> tuple[int, ...]:
        return self._shape if self._shape[0] > 1 else self._shape[1:]


def check_scatterers(
    wave: IncidentWave, lattice: Lattice, reach: Sequence[int], cuts: Sequence[Cut], material: np.ndarray
) -> None:
    """Cracks, holes and other materials must be inside the box, two reaches from its faces.

    Parameters
    ----------
    wave : IncidentWave
        With its box.
    lattice : Lattice
    reach : sequence of int
    cuts : sequence of Cut
    material : ndarray
        Of the lattice's shape: what the bonds are multiplied with, nan where there are no nodes.

    Raises
    ------
    InputError
    """
    assert wave.within is not None
    lower, upper = (np.asarray(b, float) for b in wave.within.bounds())
    more = 2 * lattice.spacing * np.array(reach)
    lower, upper = lower + more, upper - more
    limit = f"{lower.tolist()} to {upper.tolist()}"
    for cut in cuts:
        low, high = (np.asarray(b, float) for b in cut.bounds())
        if (low < lower - 1e-9).any() or (high > upper + 1e-9).any():
            raise InputError(
                "a crack reaches to the faces of an incident wave's box",
                value=[low.tolist(), high.tolist()],
                limit=limit,
                key="crack",
                remedy="shorten it, or enlarge the near field",
            )
    inner = np.ones(lattice.shape, bool)
    for axis, places in enumerate(lattice.axes):
        within = (places >= lower[axis] - 1e-9) & (places <= upper[axis] + 1e-9)
        inner &= within.reshape([-1 if a == axis else 1 for a in range(lattice.dim)])
    outside: Any = material[~inner]
    if outside.size and not np.ptp(outside) == 0:
        raise InputError(
            "the medium is not uniform near the faces of an incident wave's box, or beyond",
            limit=limit,
            key="incident.within",
            remedy="enlarge the near field",
        )
