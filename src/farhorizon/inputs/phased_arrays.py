"""Phased arrays: elements driven one after the other, so that their waves meet in a focus or leave at an angle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import ANY, Length, OfTime, Speed, Unit
from farhorizon.errors import InputError
from farhorizon.geometry.interpolation import as_points
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Cut
from farhorizon.inputs.local_sources import LocalSource, amount_of, directed, patch, place_of, set_source_fields, spread
from farhorizon.inputs.signals import SMALL, Delayed, Signal
from farhorizon.inputs.sources import Source, steady
from farhorizon.machine import check_fits
from farhorizon.rounding import MARGIN


@dataclass(frozen=True)
class PhasedArray(LocalSource):
    r"""A row of equal elements driven by one signal with delays.

    Each element is a line, or with `across` a parallelogram, over which a source or a force is spread uniformly: on a
    free side, a traction. The delays are those of rays: for a focus, ``(max_j d_j - d_i) / c`` with its distances d
    from the centres of the elements; for an angle to the normal of the row, ``s_i sin(angle) / c`` with the positions s
    of the elements along the row.

    Parameters
    ----------
    first, last : sequence of float
        Centres of the first and the last element.
    elements : int
        Number of elements, at least 2.
    strength : float or sequence of float
        Strength per length, or with `across` per area; in an elastic medium a force, one component per axis.
    time : callable, str, Expression or Signal
        Signal of each element, zero before t = 0.
    speed : float, optional
        Speed c of the waves that are to be focused or steered; required for delays.
    focus : sequence of float, optional
        Point at which they meet.
    angle : float, optional
        Angle between their direction and the normal of the row, in degrees, towards the last element.
    width : float, optional
        Width of an element along the row; unless given, the distance between two elements.
    across : sequence of float, optional
        Other edge of the elements, a vector.
    interpolation : {"sinc", "linear"}
        As in `PointSource`.

    Raises
    ------
    InputError
        As in `PointSource`; both a focus and an angle, either of them without a speed, elements that overlap; with
        delays, a signal that does not begin at rest.

    Examples
    --------
    >>> import farhorizon as fh
    >>> probe = fh.PhasedArray((-4.0, 0.0), (4.0, 0.0), 9, (0.0, -1.0), fh.ToneBurst(0.1, 3), speed=2.0, angle=30.0)
    >>> probe.delays.round(12).tolist()
    [0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0]
    """

    first: Annotated[Sequence[float], Unit("m")]
    last: Annotated[Sequence[float], Unit("m")]
    elements: int
    strength: Annotated[float | Sequence[float], Unit(ANY)]
    time: OfTime
    speed: Speed | None = None
    focus: Annotated[Sequence[float] | None, Unit("m")] = None
    angle: float | None = None
    width: Length | None = None
    across: Annotated[Sequence[float] | None, Unit("m")] = None
    interpolation: str = "sinc"

    def __post_init__(self) -> None:
        kinds.integer(self.elements, "source.elements", least=2)
        points = {name: getattr(self, name) for name in ("first", "last", "focus", "across")}
        points = {
            name: place_of(at, f"source.{name}")
            for name, at in points.items()
            if at is not None or name in ("first", "last")
        }
        if len({len(at) for at in points.values()}) > 1 or points["first"] == points["last"]:
            raise InputError(
                "the first and the last element differ, and every point has one coordinate per axis",
                value=[self.first, self.last],
                limit="two different points of as many coordinates as the others",
                key="source.first",
                remedy="the centres of the outer elements",
            )
        set_source_fields(self, strength=amount_of(self.strength, "source.strength"), **points)
        pitch = self._length / (self.elements - 1)
        limits = {"speed": {"above": 0}, "angle": {"least": -90, "most": 90}, "width": {"above": 0}}
        for name, range_ in limits.items():
            if (value := getattr(self, name)) is not None:
                kinds.set_fields(self, **{name: kinds.number(value, f"source.{name}", **range_)})  # type: ignore[arg-type]
        if self.width is not None and self.width > pitch * (1 + MARGIN):
            raise InputError(
                "the elements overlap",
                value=self.width,
                limit=f"{pitch:.6g}",
                key="source.width",
                remedy="at most the distance of two elements",
            )
        begins = 0.0 if self.time is None else abs(float(kinds.array(self.time(0.0), "source.time", shape=())))
        if self.speed is not None and begins > SMALL:
            raise InputError(
                "the signal of an array's elements does not begin at rest: each would begin with a jump",
                value=f"{begins:.3g} at t = 0",
                limit=f"{SMALL:g}",
                key="source.time",
                remedy="a ToneBurst or another signal, or an expression that is 0 at t = 0",
            )
        if self.focus is not None and self.angle is not None:
            raise InputError(
                "either a focus or an angle", value="both", limit="one", key="source.angle", remedy="leave one out"
            )
        if (self.focus is not None or self.angle is not None) and self.speed is None:
            raise InputError(
                "delays follow from the speed of the waves",
                value="no speed",
                limit="> 0",
                key="source.speed",
                remedy="speed = that of the waves in the medium",
            )

    @property
    def _length(self) -> float:
        return float(np.linalg.norm(np.subtract(self.last, self.first)))

    @property
    def centres(self) -> np.ndarray:
        """Centres of the elements, shape (elements, dim)."""
        return np.linspace(self.first, self.last, self.elements)

    @property
    def delays(self) -> np.ndarray:
        """Delays of the elements, shape (elements,); the smallest is zero."""
        if self.speed is None:
            return np.zeros(self.elements)
        if self.focus is not None:
            lead = -np.linalg.norm(self.centres - np.asarray(self.focus), axis=1)
        else:
            lead = np.linspace(0.0, self._length, self.elements) * np.sin(np.radians(self.angle or 0.0))
        return np.asarray((lead - lead.min()) / self.speed)

    def placed(self, lattice: Lattice, components: int, key: str, cuts: Sequence[Cut] = ()) -> list[Source]:
        """The source as arrays on the nodes."""
        need = 8.0 * components * float(np.prod(lattice.shape)) * self.elements
        check_fits(need, f"{self.elements} elements, each on all nodes, do", "source.elements", "fewer elements")
        row = np.subtract(self.last, self.first) / self._length
        width = self._length / (self.elements - 1) if self.width is None else self.width
        edges = [width * row, *([] if self.across is None else [np.asarray(self.across)])]
        sources = []
        for centre, delay in zip(as_points(self.centres, lattice.dim, f"{key}.first"), self.delays, strict=True):
            points, amounts = patch(centre - sum(edges) / 2, edges, lattice, f"{key}.first")
            density = spread(lattice, points, amounts, self.interpolation, f"{key}.first", cuts=cuts)
            values = directed(density, self.strength, components, f"{key}.strength")  # type: ignore[arg-type]
            sources.append(Source(values, _later(self.time or steady, float(delay))))
        return sources


def _later(time: Callable[[float], Any], delay: float) -> Callable[[float], Any]:
    """A factor of time with a delay, zero before it."""
    if isinstance(time, Signal):
        return Delayed(time, delay)
    return lambda t: time(t - delay) if t >= delay else 0.0
