"""External forces on a body: per volume, and per area on its free sides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Function, OfTime, Registered, Toml, Unit
from farhorizon.errors import InputError
from farhorizon.files.storable import Storable
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.inputs.expressions import as_signal
from farhorizon.rounding import MARGIN

_VALUE = "Force per volume, one component per axis, each a function of the coordinates and t."


class Load(Registered, Storable):
    """A force on an elastic medium, or a strain of it.

    A user-defined load is a frozen dataclass that derives from this class and states by `resolved` which of the loads
    that exist already it is. Its fields are the keys of its table in case files.

    Attributes
    ----------
    tag : str
        Its `type` in a case file: ``BodyForce`` is "body-force".
    known : dict of str to type
        All loads by name, including user-defined ones.

    Examples
    --------
    >>> import farhorizon as fh
    >>> isinstance(fh.BodyForce([0.0, -1.0]), fh.Load), fh.BodyForce.tag
    (True, 'body-force')
    """

    known: ClassVar[dict[str, type[Load]]] = {}

    def resolved(self, lattice: Lattice) -> Load:
        """The load as one of those that exist already, for the nodes of a lattice."""
        return self


@dataclass(frozen=True)
class BodyForce(Load):
    """A force per volume in the near field.

    Parameters
    ----------
    value : sequence of (ndarray, callable, str, Expression or float)
        One component per axis: an array of the lattice's shape, a function or an expression of the coordinates, or a
        number.
    time : callable, str, Expression or float, optional
        Factor of t; 1 unless given.

    Raises
    ------
    InputError
        A value that is not a list of components, a factor that is not a function of t.

    Examples
    --------
    >>> import farhorizon as fh
    >>> weight = fh.BodyForce(["0", "-exp(-x**2 - y**2)"], time=lambda t: min(t, 1.0))
    >>> model = fh.Elastic(fh.Kernel(2.0), young=1.0)
    >>> sim = fh.Simulation(fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0)), model, loads=[weight])
    >>> sim.step(5)
    >>> bool(sim.fields["u"][1].min() < 0)
    True
    """

    value: Annotated[Sequence[Any], Toml(list[str | float]), Function(components=True), Unit("N/m^3"), _VALUE]
    time: OfTime = None

    def __post_init__(self) -> None:
        if not isinstance(self.value, np.ndarray):
            kinds.sequence(self.value, "load.value", "one component an axis")
        kinds.set_fields(self, time=None if self.time is None else as_signal(self.time, "load.time"))


@dataclass(frozen=True)
class Traction(Load):
    """A force per area on a free side, applied to its outermost nodes as a force per volume, value / spacing.

    Parameters
    ----------
    side : str
        Free side on which it acts, such as "x-" or "y+".
    value : sequence of float
        Force per area, one component per axis.
    between : sequence of (float, float), optional
        Range in which it acts, along each of the other axes in their order; the whole side unless given. Nodes at
        either end are included.
    time : callable, str, Expression or float, optional
        Factor of t; 1 unless given.

    Raises
    ------
    InputError
        An unknown side, components or ends that are not finite numbers, ends in the wrong order, a factor that is not a
        function of t.

    Examples
    --------
    >>> import farhorizon as fh
    >>> jack = fh.Traction("y+", (0.0, -1.0), between=[(-2.0, 2.0)], time="1 - exp(-t)")
    >>> plate = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 0.0))
    >>> sides = {"all": fh.LatticePML(), "y+": fh.Free()}
    >>> sim = fh.Simulation(plate, fh.Elastic(fh.Kernel(2.0), young=1.0), sides, loads=[jack])
    >>> _ = sim.run(until=5.0)
    >>> bool(sim.fields["u"][1][9, -1] < 0)
    True
    """

    side: str
    value: Annotated[Sequence[float], Unit("Pa")]
    between: Annotated[Sequence[tuple[float, float]] | None, Unit("m")] = None
    time: OfTime = None

    def __post_init__(self) -> None:
        kinds.one_of(self.side, "load.side", [axis + sign for axis in AXES for sign in "-+"], "unknown side")
        kinds.array(self.value, "load.value", shape=(None,))
        if self.between is not None:
            for low, high in kinds.array(self.between, "load.between", shape=(None, 2)):
                if low > high:
                    raise InputError(
                        "the ends are in the wrong order",
                        value=(low, high),
                        limit="the lower one first",
                        key="load.between",
                        remedy=f"({high:g}, {low:g})",
                    )
        kinds.set_fields(self, time=None if self.time is None else as_signal(self.time, "load.time"))

    def bounded(self, lattice: Lattice) -> Traction:
        """The same traction with explicit ends if it acts on the whole side, so that it keeps its position on a larger
        lattice.
        """
        ends = [
            (float(a), float(b))
            for name, a, b in zip(AXES, lattice.lower, lattice.upper, strict=False)
            if name != self.side[:1]
        ]
        return self if self.between is not None else replace(self, between=ends)


def force_density(
    load: Traction, lattice: Lattice, sides: Mapping[tuple[int, int], Any], key: str = "load"
) -> np.ndarray:
    """Return the force per volume of a traction on the nodes of a lattice, without its factor of time, shape (dim,
    *lattice.shape); raises InputError for an unknown side or one that is not free, components that are missing or not
    finite, a range beyond the near field, or one without nodes.
    """
    names = {AXES[a] + sign: (a, s) for a in range(lattice.dim) for sign, s in (("-", -1), ("+", 1))}
    if load.side not in names:
        raise InputError("unknown side", value=load.side, limit=", ".join(names), key=f"{key}.side")
    axis, side = names[load.side]
    if sides[axis, side].shared:  # the side belongs to other processes
        return np.zeros((lattice.dim, *lattice.shape))
    if sides[axis, side].bonded:
        raise InputError(
            "a traction acts on a free side",
            value=type(sides[axis, side]).__name__,
            key=f"{key}.side {load.side}",
            remedy="Free()",
        )
    if len(load.value) != lattice.dim:
        raise InputError(
            "a traction needs one component per axis",
            value=list(load.value),
            limit=f"a list of {lattice.dim}",
            key=f"{key}.value",
        )
    at = lattice.coordinates()
    place = lattice.lower[axis] if side < 0 else lattice.upper[axis]
    loaded = np.abs(at[axis] - place) < 0.5 * lattice.spacing
    across = [a for a in range(lattice.dim) if a != axis]
    slack = MARGIN * lattice.spacing  # rounding of coordinates
    if load.between is not None and np.shape(load.between) != (len(across), 2):
        raise InputError(
            "a part of a side is given by two ends along each other axis",
            value=load.between,
            limit=f"{len(across)} pairs",
            key=f"{key}.between",
        )
    for a, (low, high) in zip(across, load.between or (), strict=load.between is not None):
        first, last = lattice.whole.lower[a], lattice.whole.upper[a]
        if not first - slack <= low <= high <= last + slack:
            raise InputError(
                "the traction reaches beyond the near field",
                value=(low, high),
                limit=(float(first), float(last)),
                key=f"{key}.between ({AXES[a]})",
                remedy="a wider lattice or a narrower load",
            )
        loaded &= (at[a] >= low - slack) & (at[a] <= high + slack)
    if lattice.mask is not None:
        loaded &= lattice.mask
    if lattice.whole is lattice and not loaded.any():
        raise InputError("the traction meets no node", value=load.between, key=f"{key}.between", remedy="a wider load")
    return np.multiply.outer(np.asarray(load.value, float) / lattice.spacing, loaded)
