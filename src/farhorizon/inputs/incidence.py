"""Incident waves: inside a box the field is the total field, outside it the scattered field."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.references.infinite_lattice import Scheme
from farhorizon.analysis.surface_pulses import FreeSurface
from farhorizon.arguments import Registered
from farhorizon.errors import InputError, shown
from farhorizon.files.storable import Storable
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.geometry.shapes import Box, Cut
from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.shell import Shell
from farhorizon.medium.stratified_medium import StratifiedMedium

End = tuple[int, int]  # axis and side, -1 or +1
_CLOSE = 1e-6  # of a spacing: places closer to each other than this coincide
_ACROSS_LAYERS = (
    "no size of the near field helps where another medium leaves through a side, unless it is a layer parallel to the "
    "free side on which the box stands, or, if it stands on none, to any side, and lies so at all faces"
)


@dataclass(frozen=True, eq=False)
class Region:
    """The box of an incident wave on a lattice, and the medium there."""

    lattice: Lattice
    scheme: Scheme  # scheme of the medium at the faces of the box and outside; with strata, of that below them
    first: np.ndarray  # of int, shape (dim,); smallest and largest index of the box along each axis
    last: np.ndarray
    #: The medium with the free side on which the box stands, or with strata; None if it is the same everywhere.
    end: StratifiedMedium | None = None

    def along(self, axis: int, part: Lattice) -> tuple[int, int]:
        """First node along an axis and the one after the last, as counted in a part of the lattice."""
        return int(self.first[axis]) - part.first[axis], int(self.last[axis]) + 1 - part.first[axis]

    def nodes(self, most: int) -> np.ndarray:
        """Indices of nodes of the box, sampled evenly such that there are at most `most`; shape (n, dim)."""
        counts = self.last - self.first + 1
        numbers = np.arange(0, int(np.prod(counts)), -(-int(np.prod(counts)) // most))
        return np.stack(np.unravel_index(numbers, counts), axis=-1) + self.first

    @property
    def shell(self) -> Shell:
        """Shell of the box, the nodes with a bond through a face; there is no face where the medium ends."""
        first, last, end = self.first.copy(), self.last.copy(), self.end
        if end is not None and not end.open:
            (first if end.side < 0 else last)[end.axis] += end.side * self.scheme.stencil.reach[end.axis]
        return Shell(self.scheme.stencil, first, last, self.end)

    def under(self, end: StratifiedMedium) -> FreeSurface:
        """The first row of the medium, with the rows below it."""
        axis, side = end.axis, end.side
        beyond = -end.edge if side < 0 else end.edge + 1 - self.lattice.shape[axis]  # rows before those of the lattice
        level = (self.lattice.lower if side < 0 else self.lattice.upper)[axis] + side * beyond * self.lattice.spacing
        rows, depth = self.lattice.shape[axis] + beyond, int(self.last[axis] - self.first[axis]) + 1
        return FreeSurface(self.scheme, end, self.lattice.spacing, float(level), rows, depth)

    def places(self, nodes: np.ndarray) -> np.ndarray:
        """Coordinates of nodes (n, dim)."""
        return np.asarray(self.lattice.lower + self.lattice.spacing * nodes)


class Passage(ABC):
    """An incident wave on the nodes of a lattice.

    Attributes
    ----------
    period : float
        Time from which on the wave is zero.
    rests : bool
        Whether the wave has not yet reached the box at the start.
    everywhere : bool
        Whether the wave is known on all nodes; otherwise only on those with a bond through a face, and nan on others.
    notes : list of str
        Notes for the user.
    doubts : list of str
        Reasons why results computed with the wave may be wrong.
    """

    period: float = np.inf
    rests: bool = False
    everywhere: bool = True
    notes: Sequence[str] = ()
    doubts: Sequence[str] = ()

    @abstractmethod
    def at(self, nodes: np.ndarray) -> Callable[[float], np.ndarray]:
        """The displacement of nodes (n, dim) as a function of t, of shape (components, n)."""

    @property
    def midway(self) -> float:
        """A time at which the wave is on its way through the box."""
        return 0.0

    def foresee(self, until: float) -> list[str]:
        """Return notes on a run up to a time.

        Raises
        ------
        InputError
            A wave that is not known up to then.
        """
        return []


class Incident(Registered, Storable, ABC):
    """A wave that is incident on whatever is inside a box.

    Attributes
    ----------
    within : Box, optional
        Box that contains everything that scatters, at least two reaches of the stencil inside its faces.
    plane : bool
        Whether it is a single plane wave in an open medium, for which cross sections are defined.
    undamped : bool
        Whether it is a wave of an undamped medium.
    tag : str
        Its `type` in a case file: ``IncidentField`` is "incident-field".
    known : dict of str to type
        All such waves by name, including user-defined ones.
    """

    within: Box | None
    plane: ClassVar[bool] = False
    undamped: ClassVar[bool] = True
    tag: ClassVar[str]
    known: ClassVar[dict[str, type[Incident]]] = {}

    @abstractmethod
    def passage(self, region: Region) -> Passage:
        """The wave in a medium.

        Raises
        ------
        InputError
            A wave that this medium does not support.
        """

    def on(self, dim: int) -> Self:
        """The wave for the given number of dimensions, with every text in it as an expression of their coordinates."""
        return self

    def velocities(self, times: np.ndarray) -> np.ndarray | None:
        """Rates of change of its signal at some equidistant times, up to a factor; None if it has no signal."""
        return None

    def heads(self, axis: int) -> int:
        """Direction along an axis, -1 or +1, in which the wave travels through strata; +1 if it matters not."""
        return 1

    def surface_met(self, free: Sequence[End]) -> End | None:
        """The free side on which the box stands if no box is given; None for most waves."""
        return None

    def resolved(self, lattice: Lattice, reach: Sequence[int], ends: Mapping[End, bool] | None = None) -> Self:
        """The same wave with its box.

        Parameters
        ----------
        lattice : Lattice
        reach : sequence of int
        ends : mapping of (axis, side) to bool, optional
            Sides at which the medium ends, and whether they are free.

        Raises
        ------
        InputError
            As in `resolved_box`.
        """
        ends = ends or {}
        met = self.surface_met([end for end, free in ends.items() if free])
        box = resolved_box(self.within, lattice, reach, ends, "incident.within", met)
        return replace(self, within=box)  # type: ignore[type-var]


def resolved_box(
    within: Box | None,
    lattice: Lattice,
    reach: Sequence[int],
    ends: Mapping[End, bool],
    key: str,
    met: End | None = None,
) -> Box:
    """Return the box of an incident wave: by default the near field less two reaches, up to the free side `met`, if
    any; where it stands on a side, it ends at the nodes of that side.

    `ends` are the sides at which the medium ends, and whether they are free. Raises InputError for a box that is not
    inside the near field by one reach, except at one free side on which it may stand, or one so small that the
    neighbourhoods of its faces meet.
    """
    more, close = lattice.spacing * np.array(reach), _CLOSE * lattice.spacing
    if within is None:
        low, high = lattice.lower + 2 * more, lattice.upper - 2 * more
        if met is not None:
            (low if met[1] < 0 else high)[met[0]] = (lattice.lower if met[1] < 0 else lattice.upper)[met[0]]
    else:
        low, high = (np.array(bound, float) for bound in within.bounds())
    if low.size != lattice.dim:
        raise InputError(
            "the box of a wave and the lattice differ in dimension",
            value=low.size,
            limit=lattice.dim,
            key=key,
            remedy="a box with one entry per axis of the lattice in each corner",
        )
    stands = {-1: low < lattice.lower + close, 1: high > lattice.upper - close}
    surfaces = [end for end, free in ends.items() if free and stands[end[1]][end[0]]]
    for axis, side in surfaces:
        (low if side < 0 else high)[axis] = (lattice.lower if side < 0 else lattice.upper)[axis]
    near = {-1: low - more < lattice.lower - close, 1: high + more > lattice.upper + close}
    beyond = [(axis, side) for axis, side in ends if near[side][axis] and (axis, side) not in surfaces]
    if beyond or len(surfaces) > 1:
        raise InputError(
            "an incident wave does not account for the surface that it would hit"
            if beyond
            else "an incident wave accounts for only one free surface",
            value=_names(beyond or surfaces),
            key=key,
            limit="one reach away from sides at which the medium ends, or standing on one that is free",
            remedy="a source below the surface, or initial data in the form of the wave",
        )
    least = 4 * more  # two for each face
    for axis, side in surfaces:
        near[side][axis], least[axis] = False, 2 * more[axis]
    outside = near[-1] | near[1]
    if outside.any():
        axis = int(np.argmax(outside))
        limits = shown((lattice.lower + more)[axis]), shown((lattice.upper - more)[axis])
        raise InputError(
            f"the box of an incident wave reaches too far along {AXES[axis]}: one reach of the near field must be "
            "left around it",
            value=f"{shown(low[axis])} to {shown(high[axis])}",
            key=key,
            limit=f"within {limits[0]} to {limits[1]}",
            remedy="a smaller box, or a larger near field",
        )
    if (high - low < least - close).any():
        raise InputError(
            "the box of an incident wave is too small",
            value=(high - low).tolist(),
            limit=f"sides of {least.tolist()}",
            key=key,
            remedy="enlarge the near field",
        )
    return Box(tuple(low.tolist()), tuple(high.tolist()))


def _names(ends: Sequence[End]) -> str:
    return ", ".join(AXES[axis] + "-+"[side > 0] for axis, side in ends)


def standing_on(box: Box, lattice: Lattice, free: Sequence[End]) -> list[End]:
    """The free sides on which a box stands."""
    low, high = (np.asarray(bound, float) for bound in box.bounds())
    close = _CLOSE * lattice.spacing
    stands = {-1: low < lattice.lower + close, 1: high > lattice.upper - close}
    return [(axis, side) for axis, side in free if stands[side][axis]]


def region_of(
    box: Box,
    lattice: Lattice,
    scheme: Scheme,
    free: Sequence[End] = (),
    states: ForceStates | None = None,
    strata: StratifiedMedium | None = None,
) -> Region:
    """Region of a box, which may stand on one of the free sides, in the uniform medium of a scheme, or in strata."""
    low, high = (np.asarray(bound, float) for bound in box.bounds())
    first = np.ceil((low - lattice.lower) / lattice.spacing - _CLOSE).astype(int)
    last = np.floor((high - lattice.lower) / lattice.spacing + _CLOSE).astype(int)
    surfaces = standing_on(box, lattice, free)
    if strata is None and surfaces:
        axis, side = surfaces[0]
        edge = 0 if side < 0 else lattice.shape[axis] - 1
        return Region(lattice, scheme, first, last, StratifiedMedium(scheme.stencil, axis, side, edge, states))
    if strata is not None:
        scheme = replace(scheme, stencil=strata.inside)
    return Region(lattice, scheme, first, last, strata)


class Incidence:
    r"""An incident wave on a lattice: the sources that join total and scattered field.

    The sources :math:`\chi L u_i - L (\chi u_i)` of the incident wave :math:`u_i`, where :math:`\chi` is 1 inside the
    box and 0 outside, require the wave only on the nodes with a bond through a face (`farhorizon.medium.shell.Shell`).
    The scheme and the states, or the strata, are those of the medium outside the box, which the wave satisfies.
    """

    def __init__(
        self,
        wave: Incident,
        lattice: Lattice,
        scheme: Scheme,
        free: Sequence[End] = (),
        states: ForceStates | None = None,
        strata: StratifiedMedium | None = None,
    ) -> None:
        assert wave.within is not None
        self.wave, self._lattice, self._dt = wave, lattice, scheme.dt
        self.region = region_of(wave.within, lattice.whole, scheme, free, states, strata)
        self.passage = wave.passage(self.region)
        shell, self._components = self.region.shell, scheme.stencil.components
        mine, self._nodes = self._own(shell.nodes)
        joins = (-scheme.rate * shell.commutator).tocsr()[np.tile(mine, self._components)]
        if strata is not None and strata.strata is not None:  # from accelerations to the forces on the nodes
            masses = strata.strata.density_at(strata.row(shell.nodes[mine]))
            joins = (joins.T * np.tile(masses, self._components)).T.tocsr()
        # forces on nodes of another part are left to that part
        acting = np.zeros(joins.shape[1], bool)
        acting[joins.indices] = True
        needed = np.flatnonzero(acting.reshape(self._components, -1).any(0))
        self._values = self.passage.at(shell.nodes[needed])
        self._joins = joins[:, (needed + len(shell.nodes) * np.arange(self._components)[:, None]).ravel()]

    def _own(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which nodes (n, dim) of the whole lattice belong to this part of it, and their flat indices there."""
        return self._lattice.own(np.ravel_multi_index(tuple(nodes.T), self._lattice.whole.shape))

    def source(self, t: float) -> np.ndarray:
        """``chi L u - L (chi u)`` of the wave on the lattice; zero once it has passed."""
        force = np.zeros((self._components, int(np.prod(self._lattice.shape))))
        if t < self.passage.period:
            force[:, self._nodes] = (self._joins @ self._values(t).ravel()).reshape(self._components, -1)
        return self._shaped(force)

    def initial(self) -> tuple[np.ndarray, np.ndarray]:
        """The wave inside its box at the start, and its velocity there as the scheme defines it,
        ``(u(dt) - u(-dt)) / (2 dt)``.
        """
        axes = [np.arange(first, first + n) for first, n in zip(self._lattice.first, self._lattice.shape, strict=True)]
        ends = zip(axes, self.region.first, self.region.last, strict=True)
        box = [axis[(axis >= first) & (axis <= last)] for axis, first, last in ends]  # as far as it is in this part
        nodes = np.stack(np.meshgrid(*box, indexing="ij"), axis=-1).reshape(-1, len(box))
        where, wave = self._own(nodes)[1], self.passage.at(nodes)
        data = np.zeros((2, self._components, int(np.prod(self._lattice.shape))))
        data[0][:, where] = wave(0.0)
        data[1][:, where] = (wave(self._dt) - wave(-self._dt)) / (2 * self._dt)
        return self._shaped(data[0]), self._shaped(data[1])

    def field(self, t: float) -> np.ndarray:
        """The incident wave on the whole lattice, of the field's shape; nan where it is not known."""
        if t >= self.passage.period:
            return self._shaped(np.zeros((self._components, int(np.prod(self._lattice.shape)))))
        nodes = np.indices(self._lattice.shape).reshape(self._lattice.dim, -1).T + np.array(self._lattice.first)
        return self._shaped(self.passage.at(nodes)(t))

    def _shaped(self, values: np.ndarray) -> np.ndarray:
        shape = self._lattice.shape
        return values.reshape((self._components, *shape) if self._components > 1 else shape)


def medium_outside(
    wave: Incident,
    lattice: Lattice,
    reach: Sequence[int],
    cuts: Sequence[Cut],
    material: np.ndarray,
    constants: np.ndarray,
    free: Sequence[End],
    gather: Callable[[Any], list[Any]],
) -> float | tuple[int, np.ndarray]:
    """Return the factor on the bonds outside the box, or, if there are strata, their normal and the constants of each
    row along it, (rows, P), after a check that cracks, holes and whatever else scatters are inside it, at least two
    reaches from its faces.

    `material` is the factor on the bonds in this part of the lattice, nan where there are no nodes, and `constants` (P,
    ..) is all that may differ between strata, nan where there are no nodes. The box may stand on one of the free sides:
    it has no face there. `gather` returns the values of all processes, given that of this one.
    """
    assert wave.within is not None
    whole_lattice, close = lattice.whole, _CLOSE * lattice.spacing
    lower, upper = (np.array(b, float) for b in wave.within.bounds())
    more = 2 * lattice.spacing * np.array(reach)
    open_sides = standing_on(wave.within, whole_lattice, free)
    lower, upper = lower + more, upper - more
    for axis, side in open_sides:
        (lower if side < 0 else upper)[axis] = side * np.inf
    limit = f"{shown(np.maximum(lower, whole_lattice.lower))} to {shown(np.minimum(upper, whole_lattice.upper))}"
    lower, upper = lower - close, upper + close
    for cut in cuts:
        low, high = (np.asarray(b, float) for b in cut.bounds())
        if (low < lower).any() or (high > upper).any():
            raise InputError(
                "a crack reaches to the faces of an incident wave's box",
                value=[low.tolist(), high.tolist()],
                limit=limit,
                key="crack",
                remedy="shorten it, or enlarge the near field",
            )
    inner = np.ones(lattice.shape, bool)
    for axis, places in enumerate(lattice.axes):
        within = (places >= lower[axis]) & (places <= upper[axis])
        inner &= within.reshape([-1 if a == axis else 1 for a in range(lattice.dim)])
    first = next(value for values in gather(material[~inner][:1].tolist()) for value in values)
    unlike = lattice.lower + lattice.spacing * np.argwhere(~inner & ~(material == first))
    leaving = ((unlike < whole_lattice.lower + close) | (unlike > whole_lattice.upper - close)).any(1)
    mine = [(bool(leaving[at]), unlike[at].tolist()) for at in ([int(leaving.argmax())] if len(unlike) else [])]
    unlike_of_all = [entry for entries in gather(mine) for entry in entries]
    if not unlike_of_all:
        return float(first)
    for axis in [axis for axis, _ in open_sides] or range(lattice.dim):
        rows = _constants_by_row(constants, ~inner, axis, lattice, gather)
        if rows is not None:
            return axis, rows
    leaves, place = max(unlike_of_all, key=lambda entry: entry[0])
    raise InputError(
        "the medium is not uniform near the faces of an incident wave's box, or beyond",
        value=f"another one at {shown(place)}",
        limit=limit,
        key="incident.within",
        remedy=_ACROSS_LAYERS if leaves else "enlarge the near field, or the box if it is given",
    )


def _constants_by_row(
    constants: np.ndarray, outside: np.ndarray, axis: int, lattice: Lattice, gather: Callable[[Any], list[Any]]
) -> np.ndarray | None:
    """Constants (P, ..) of each row along an axis, (rows, P), if they are the same at all nodes of the row outside a
    box; None if they are not. Rows without nodes outside it have those of any node.
    """
    counts = lattice.whole.shape[axis]
    across = np.moveaxis(constants, 1 + axis, 1).reshape(len(constants), lattice.shape[axis], -1)
    beyond = np.moveaxis(outside, axis, 0).reshape(lattice.shape[axis], -1)
    chosen = np.take_along_axis(across, beyond.argmax(1)[None, :, None], 2)[..., 0].T
    numbers = lattice.first[axis] + np.arange(lattice.shape[axis])
    rows = np.full((counts, len(constants)), np.nan)
    for has_outside in (False, True):  # the latter overwrites
        for of_part, values, there in gather((numbers, chosen, beyond.any(1))):
            rows[of_part[there == has_outside]] = values[there == has_outside]
    alike = (across == rows[numbers].T[:, :, None]) | ~beyond
    return rows if all(gather(bool(alike.all()))) and np.isfinite(rows).all() else None


def check_within(within: Any) -> None:
    """Raise an InputError unless `within` is a Box or None."""
    if within is not None:
        kinds.instance(within, "incident.within", Box, "a Box")
