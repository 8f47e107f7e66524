"""Conditions on nodes of a body: prescribed temperature, prescribed flux, convection, insulation.

A condition on a side ("x-", "y+", ..) applies to the outermost nodes of the body along that axis. It is imposed in one
of these ways:

- on one layer of nodes, or on as many as the stencil reaches (a volume layer): they take the value;
- by a layer of nodes *beyond the wall*, which belong to the lattice but not to the body proper: as many nodes as the
  stencil reaches take values that follow from those inside (mirror images, or eq. 22 of Bobaru and Duangpanya 2010);
  the wall lies half a spacing inside the last of them;
- as a source in the outermost cells, which needs no nodes of its own.

A flux and convection may also act on the surface of a region: of a hole, a baffle or a body of any form. Each bond k
that leads through it to a place without a node bears ``w |k . n|`` of the area of a face, with its weight w, of which
half the second moment is 1, and the normal n of the region. Since ``|k . n|`` such bonds pass through the area of a
face, these add up to the area of the surface; heat that flows evenly through a plane leaves a linear temperature. The
flux of convection is that for such a temperature between the node and the surface.

Which nodes follow from which is stated by tables (`Conditions`), which the engine applies after every stage of a step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import ANY, PYTHON_ONLY, REQUIRED, Function, InFile, OneOf, Unit
from farhorizon.errors import InputError
from farhorizon.files.storable import Storable
from farhorizon.geometry.lattice import AXES, Lattice, nodes_in
from farhorizon.geometry.shapes import Shape
from farhorizon.inputs.expressions import as_given
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.inputs.sources import Source, as_source, check_size, space_and_time, steady
from farhorizon.medium.stencil import Stencil

Where = str | Shape | np.ndarray
_Side = Annotated[str, 'Side on which it is imposed, such as "x-".']
_Surface = Annotated[Shape, "Region of a hole, a baffle or a body, on whose surface it acts."]
_Ambient = Annotated[Any, Function(), Unit(ANY), "Temperature of the fluid; may depend on the coordinates and t."]


@dataclass(frozen=True)
class Temperature(Storable):
    """Prescribed temperature (or value of any other field).

    Parameters
    ----------
    where : str, Shape or ndarray of bool
        A side ("x-", ..); or a shape or a mask, all of whose nodes take the value.
    value : float, ndarray, callable, Expression or Source
        As for a source: a number, an array (of the lattice's shape or, for a side, of that of its face), a callable of
        the coordinates and t, an expression, or a `Source` with a function of space and one of time. For a side, the
        coordinate along the normal is that of the wall.
    kind : {"node", "volume", "mirror"}
        For a side: the outermost layer of nodes takes the value (Bobaru and Duangpanya 2010, section 3.1; this has no
        limit as the number of nodes in the horizon increases: a point has no capacity); or as many layers as the
        stencil reaches take it; or those layers are mirror images ``2 value - T`` of the nodes inside, which is
        second-order accurate. The wall is the middle of the outermost cells, the inner edge of the volume layer, and
        likewise that of the mirror layer.
    within : Shape, optional
        Restricts the condition to nodes in this shape.

    Examples
    --------
    >>> import farhorizon as fh
    >>> end = fh.Temperature("x-", 100.0)
    >>> model = fh.Heat(fh.Kernel(0.2), density=1.0, specific_heat=1.0, conductivity=1.0)
    >>> rod = {"x-": fh.Free(), "x+": fh.LatticePML()}
    >>> sim = fh.Simulation(fh.Lattice(0.1, 0, 2), model, rod, {"u": 0.0}, constraints=[end])
    >>> _ = sim.run(until=0.1)
    >>> bool(sim.fields["u"][1] > 50)
    True
    """

    where: Annotated[Where, OneOf(side=_Side, region=Annotated[Shape, "Region whose nodes take the value."])]
    value: Annotated[Any, Function(), Unit(ANY)]
    kind: str = "volume"
    within: Shape | None = None

    def __post_init__(self) -> None:
        kind = kinds.one_of(self.kind, "constraint.kind", ("node", "volume", "mirror"), "unknown kind of condition")
        _check_place(self.where, self.within, anywhere=kind != "mirror")
        _check_value(self.value, "constraint.value")


@dataclass(frozen=True)
class Flux(Storable):
    """Prescribed heat flux through a side or the surface of a hole or a body, positive when heat enters.

    Parameters
    ----------
    where : str or Shape
        A side, or a region as below.
    value : float, ndarray, callable, Expression or Source
        Power per area; as in `Temperature`.
    kind : {"source", "layer", "mirror"}
        A source in the outermost cells; or as many layers of nodes beyond the wall as the stencil reaches, with
        ``T_j = T + value * distance / conductivity``, where T is that of the outermost node of the body and the
        distance is measured from it (eq. 22); or ``T_j = T_mirror + value * distance / conductivity`` with the mirror
        image, which is second-order accurate. On the surface of a region it is a source.
    within : Shape, optional
        Restricts the condition to nodes in this shape.
    region : Shape, optional
        In place of `where`: the shape of a hole, a baffle or a body, on whose surface heat enters what is there of the
        lattice's `body`. Second-order accurate on faces along the axes midway between nodes; on curved surfaces
        first-order: the error is at most 0.45 spacings over the radius of the largest change of a disc. At corners of a
        body, fewer bonds lead out: it takes the heat of up to 0.45 spacings less at each, with 3 nodes in the horizon.

    Raises
    ------
    InputError
        Neither a side nor a region or both, a region whose surface is not one of the body.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> heater = fh.Flux("x-", 3.0)
    >>> model = fh.Heat(fh.Kernel(0.3), density=1.0, specific_heat=1.0, conductivity=1.0)
    >>> rod = {"x-": fh.Free(), "x+": fh.Free()}
    >>> sim = fh.Simulation(fh.Lattice(0.1, 0, 2), model, rod, {"u": 0.0}, constraints=[heater])
    >>> _ = sim.run(until=0.5)
    >>> round(float(0.1 * sim.fields["u"].sum() / sim.time), 6)
    3.0
    >>> pipe = fh.Disc(2.0)
    >>> ground = fh.Lattice(0.5, (-6.0, -6.0), (6.0, 6.0), body=fh.Box((-6.0, -6.0), (6.0, 6.0)) - pipe)
    >>> sim = fh.Simulation(ground, fh.Heat(fh.Kernel(1.0)), fh.Free(), constraints=[fh.Flux(region=pipe, value=3.0)])
    >>> _ = sim.run(until=0.5)
    >>> bool(abs(0.25 * np.nansum(sim.fields["u"]) / (sim.time * 3.0 * 4 * np.pi) - 1) < 0.05)
    True
    """

    where: Annotated[str | Shape | None, OneOf(side=_Side, region=_Surface), InFile(REQUIRED)] = None
    value: Annotated[Any, Function(), Unit(ANY), InFile(REQUIRED)] = None
    kind: str = "source"
    within: Shape | None = None
    region: Annotated[Shape | None, PYTHON_ONLY] = None

    def __post_init__(self) -> None:
        _set_surface(self, "value")
        kinds.one_of(self.kind, "constraint.kind", ("source", "layer", "mirror"), "unknown kind of condition")
        if not isinstance(self.where, str) and self.kind != "source":
            raise InputError(
                "layers of nodes beyond the wall exist at sides only",
                value=self.kind,
                limit="source",
                key="constraint.kind",
                remedy="leave it out on the surface of a region",
            )
        _check_value(self.value, "constraint.value")


@dataclass(frozen=True)
class Insulated(Storable):
    """No flux through a side: `Flux` with value 0. The surface of a body and a `Free` side are insulated in any case.

    Parameters
    ----------
    where : str
        A side.
    kind : {"mirror", "layer"}
        As in `Flux`.
    within : Shape, optional
        Restricts the condition to nodes in this shape.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> end = fh.Insulated("x-")
    >>> model = fh.Diffusion(fh.Kernel(0.2))
    >>> rod = {"x-": fh.Free(), "x+": fh.LatticePML()}
    >>> sim = fh.Simulation(fh.Lattice(0.1, 0, 3), model, rod, {"u": "exp(-(x - 1)**2/0.04)"}, constraints=[end])
    >>> sim.step(10)
    >>> bool(np.nanmax(sim.fields["u"]) < 1)
    True
    """

    where: Annotated[str, OneOf(side=_Side)]
    kind: str = "mirror"
    within: Shape | None = None

    def __post_init__(self) -> None:
        _check_place(self.where, self.within)
        kinds.one_of(self.kind, "constraint.kind", ("mirror", "layer"), "unknown kind of condition")


@dataclass(frozen=True)
class Convection(Storable):
    """Heat transfer to a fluid, flux ``transfer (ambient - T)`` into the outermost cells of a side, or of those at the
    surface of a hole or a body.

    Parameters
    ----------
    where : str or Shape
    transfer : float
        Heat transfer coefficient, power per area and temperature.
    ambient : float, ndarray, callable, Expression or Source
        Temperature of the fluid; as in `Temperature`.
    within : Shape, optional
        Restricts the condition to nodes in this shape.
    region : Shape, optional
        In place of `where`; as in `Flux`.

    Examples
    --------
    >>> import farhorizon as fh
    >>> surface = fh.Convection("x-", transfer=5.0, ambient=20.0)
    >>> model = fh.Heat(fh.Kernel(0.3), density=1.0, specific_heat=1.0, conductivity=1.0)
    >>> wall = {"x-": fh.Free(), "x+": fh.LatticePML()}
    >>> sim = fh.Simulation(fh.Lattice(0.1, 0, 3), model, wall, {"u": 20.0}, background=20.0, constraints=[surface])
    >>> sim.step(10)
    >>> float(abs(sim.fields["u"] - 20.0).max())  # nothing flows between equals
    0.0
    """

    where: Annotated[str | Shape | None, OneOf(side=_Side, region=_Surface), InFile(REQUIRED)] = None
    transfer: Annotated[float | None, Unit("W/(m^2*K)"), InFile(REQUIRED)] = None
    ambient: Annotated[Any, OneOf(value=_Ambient), InFile(REQUIRED)] = 0.0
    within: Shape | None = None
    region: Annotated[Shape | None, PYTHON_ONLY] = None

    def __post_init__(self) -> None:
        _set_surface(self, "transfer")
        kinds.set_fields(self, transfer=kinds.number(self.transfer, "constraint.transfer", least=0))
        _check_value(self.ambient, "constraint.ambient")


Constraint = Temperature | Flux | Insulated | Convection
#: Returns the values of all processes, in their order, given that of this process.
Gather = Callable[[Any], list[Any]]
#: A value that may vary in time: (values at some nodes, factor of t), or (None, function of t that gives such values).
SourceTerm = tuple[np.ndarray | None, Callable[..., Any]]


def alone(value: Any) -> list[Any]:
    """The values of all processes if there is only one."""
    return [value]


def _driven(source_terms: Sequence[SourceTerm], shape: tuple[int, ...]) -> np.ndarray:
    """Where the source terms that vary in time, or the sum of those that do not, are not zero."""
    constant, active = np.zeros(shape), np.zeros(shape, bool)
    for space, time in source_terms:
        if space is None:
            active[...] = True
        elif time is steady:
            constant += space
        else:
            active |= space != 0
    return active | (constant != 0)


def _set_surface(condition: Flux | Convection, needed: str) -> None:
    """Check where a flux or convection acts, and take the region as the place."""
    if (condition.where is None) == (condition.region is None):
        raise InputError(
            "give either a side or a region with a surface",
            value=kinds.said(condition.where),
            key="constraint.where",
            remedy='"x-", or region=Disc(...) of a hole or a body',
        )
    if getattr(condition, needed) is None:
        raise InputError(f"the {needed} is missing", value="none", key=f"constraint.{needed}", limit="a number")
    if condition.region is not None:
        kinds.set_fields(
            condition, where=kinds.instance(condition.region, "constraint.region", Shape, "a shape"), region=None
        )
    assert condition.where is not None
    if isinstance(condition.where, Shape):
        _check_place(condition.where, condition.within, anywhere=True)
    else:
        _check_place(condition.where, condition.within)


def _check_place(where: Where, within: Any, anywhere: bool = False) -> None:
    """Check that the place is a side or, if the condition may be `anywhere`, also a shape or a mask."""
    if within is not None:
        kinds.instance(within, "constraint.within", Shape, "a shape")
    if isinstance(where, str):
        kinds.one_of(
            where,
            "constraint.where",
            [axis + sign for axis in AXES for sign in "-+"],
            "a condition is on a side, a shape or a mask",
        )
    elif not anywhere:
        raise InputError(
            "this condition needs a side",
            value=where,
            limit="x-, x+, y-, y+, z-, z+",
            key="constraint.where",
            remedy="a side, a Temperature, or a Source in the shape",
        )
    elif not isinstance(where, Shape):
        kinds.mask(where, "constraint.where", "a condition is on a side, a shape or a mask")


def _check_value(value: Any, key: str) -> None:
    """Parse a text at once; its number of coordinates, and all other values, are checked with the lattice."""
    text = value.value if isinstance(value, Source) else value
    if isinstance(text, str):
        as_given(text, len(AXES), key)


@dataclass
class Conditions:
    """Tables of all conditions of a body, or of those on the nodes of a part of it."""

    # of int, shape (H,); flat indices (of the lattice, or of its part) of the prescribed nodes, in the order in which
    # they are set
    nodes: np.ndarray = field(default_factory=partial(np.zeros, 0, int))
    # of int, shape (H,); number of the condition of each prescribed node
    owner: np.ndarray = field(default_factory=partial(np.zeros, 0, int))
    starts: np.ndarray = field(default_factory=partial(np.zeros, 1, int))  # of int, shape (H + 1,)
    # of int, shape (R,); node i follows from the nodes references[starts[i]:starts[i + 1]]
    references: np.ndarray = field(default_factory=partial(np.zeros, 0, int))
    weights: np.ndarray = field(default_factory=partial(np.zeros, 0))  # shape (R,)
    # values added to the prescribed nodes, each over all H
    source_terms: list[SourceTerm] = field(default_factory=list)
    # number of a condition and its power per volume, of the lattice's shape
    sources: list[tuple[int, SourceTerm]] = field(default_factory=list)
    # number of a condition and the power lost per volume and temperature, of the lattice's shape
    leaks: list[tuple[int, np.ndarray]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # notes on conditions that are allowed but may be unintended

    @property
    def resting(self) -> np.ndarray:
        """Which prescribed nodes hold the background value at all times."""
        return (np.diff(self.starts) == 0) & ~_driven(self.source_terms, self.nodes.shape)

    @property
    def constant(self) -> bool:
        """Whether all values that drive the prescribed nodes are constant in time."""
        return all(space is not None and time is steady for space, time in self.source_terms)

    def heated(self, shape: tuple[int, ...]) -> np.ndarray:
        """Mask, of the lattice's shape, of the nodes that receive heat at some time."""
        return _driven([source_term for _, source_term in self.sources], shape)

    @property
    def images(self) -> np.ndarray:
        """Flat indices of the nodes that follow from others: they lie beyond the wall, and their values are not
        temperatures of the body.
        """
        return self.nodes[np.diff(self.starts) > 0]


def resolve(
    constraints: Sequence[Constraint | Prescribed],
    lattice: Lattice,
    reach: Sequence[int],
    conductivity: np.ndarray | float = 1.0,
    background: float = 0.0,
    gather: Gather = alone,
    stencil: Stencil | None = None,
) -> Conditions:
    """Return the tables of all conditions on the lattice, or on the part of it that belongs to this process, counted
    from a `background`; `gather` returns the values of all processes. The bonds of `stencil`, those to the nearest
    nodes unless given, bear what passes through the surface of a region. Raises InputError for what is no condition,
    has another dimension or shape, no node, or not finite values; for contradictions on a node; for bodies too thin;
    and for nodes in another part than those from which they follow.
    """
    held: list[_Held] = []
    face: _Face | _RegionSurface
    heated: list[tuple[int, _Face | _RegionSurface]] = []  # sides and surfaces that take heat as a source
    out = Conditions()
    for number, constraint in enumerate(constraints):
        if isinstance(constraint, Prescribed):
            continue  # handled by farhorizon.inputs.prescribed
        if not isinstance(constraint, Constraint):
            names = "Temperature, Flux, Insulated, Convection, Prescribed"
            raise InputError("not a constraint", value=kinds.said(constraint), limit=names, key="constraints")
        key = f"constraint[{number}]"
        given = "ambient" if isinstance(constraint, Convection) else "value"
        if hasattr(constraint, given):
            constraint = replace(
                constraint, **{given: as_source(getattr(constraint, given), lattice.dim, f"{key}.value")}
            )
        if isinstance(constraint, Convection) or (isinstance(constraint, Flux) and constraint.kind == "source"):
            face = _surface_of(constraint, lattice, key, gather, stencil)
            _add_source(out, number, constraint, face, conductivity, background)
            heated.append((number, face))
        elif isinstance(constraint.where, str):
            side = _Face(constraint.where, lattice, constraint.within, key, gather)
            held.append(_on_face(number, constraint, side, lattice, reach, conductivity, background, key))
        else:
            held.append(_in_region(number, constraint, lattice, background, key, gather))
    _join(out, held, lattice)
    _refuse_heated(out, held, heated, lattice)
    for number, face in heated:
        condition = constraints[number]
        if isinstance(condition, Convection) and condition.within is not None:
            on_face = (
                face_there.own(0)
                for _, face_there in heated
                if (face_there.axis, face_there.side) == (face.axis, face.side)
            )
            nodes_of_side = _surface_of(
                replace(condition, within=None), lattice, f"constraint[{number}]", gather, stencil
            ).own(0)
            rest = sum(gather(int((~np.isin(nodes_of_side, np.concatenate([out.nodes, *on_face]))).sum())))
            if rest:
                out.notes.append(
                    f"constraint[{number}]: outside `within` {rest} of the {sum(gather(len(nodes_of_side)))} nodes of "
                    f"{face.name} are insulated: no heat passes there"
                )
    return out


def losses(
    constraints: Sequence[Constraint | Prescribed],
    lattice: Lattice,
    gather: Gather = alone,
    stencil: Stencil | None = None,
    conductivity: np.ndarray | float = 1.0,
) -> list[tuple[int, np.ndarray]]:
    """Return the number of each convection and the power that it takes per volume and temperature, of the shape of the
    lattice or of this part of it; see `resolve`.
    """
    lost = []
    for number, condition in enumerate(constraints):
        if isinstance(condition, Convection):
            face = _surface_of(condition, lattice, f"constraint[{number}]", gather, stencil)
            lost.append((number, _loss(condition, face, conductivity)))
    return lost


def _loss(convection: Convection, face: _Face | _RegionSurface, conductivity: np.ndarray | float) -> np.ndarray:
    assert convection.transfer is not None
    return face.spread(face.transfer(convection.transfer, conductivity))


def _surface_of(
    condition: Flux | Convection, lattice: Lattice, key: str, gather: Gather, stencil: Stencil | None
) -> _Face | _RegionSurface:
    if isinstance(condition.where, str):
        return _Face(condition.where, lattice, condition.within, key, gather)
    assert isinstance(condition.where, Shape)
    stencil = Stencil.finite_difference(lattice.dim) if stencil is None else stencil
    return _RegionSurface(condition.where, lattice, condition.within, key, gather, stencil)


@dataclass
class _Held:
    """Prescribed nodes of one condition: each takes weight * its reference (weight 0: none) + source terms."""

    number: int
    nodes: np.ndarray
    references: np.ndarray
    weight: float
    source_terms: list[SourceTerm]
    plain: Any  # the number that all nodes take, or None
    axis: int | None = None  # normal of the side


class _Face:
    """The outermost nodes of a body on one side: for each line along the axis that meets the part of the lattice, the
    first node (a flat index in the whole lattice), the thickness of the body there, and the position of the wall.
    """

    def __init__(self, name: str, subdomain: Lattice, within: Shape | None, key: str, gather: Gather) -> None:
        self.axis, self.side = AXES.index(name[0]), 1 if name[1] == "+" else -1
        self.name, self.key = f"side {name}", key
        self.part, self.lattice = subdomain, subdomain.whole
        if self.axis >= subdomain.dim:
            raise InputError(
                "the lattice has no such side", value=name, limit=", ".join(AXES[: subdomain.dim]), key=f"{key}.where"
            )
        if within is not None and within.dim != subdomain.dim:
            raise InputError(
                "shape and lattice differ in dimension", value=within.dim, limit=subdomain.dim, key=f"{key}.within"
            )
        self.count = self.lattice.shape[self.axis]
        first, thickness = (depths.ravel() for depths in self._depths())
        self._lines = np.flatnonzero(thickness)
        self.first = first[self._lines]
        if within is not None:
            self._lines = self._lines[within.contains(self._at(self.nodes(0)))]
        self.first, self.thickness = first[self._lines], thickness[self._lines]
        if not any(gather(bool(self._lines.size))):
            raise InputError(
                "no node lies on that side within the shape", key=f"{key}.within", remedy="enlarge the shape"
            )

    @property
    def _across(self) -> list[np.ndarray]:
        """Indices of the lines along the other axes of the whole lattice."""
        across = [axis for axis in range(self.part.dim) if axis != self.axis]
        shape = [self.part.shape[axis] for axis in across]
        places = np.unravel_index(self._lines, shape) if across else ()  # a bar has one line along its axis
        return [place + self.part.first[axis] for axis, place in zip(across, places, strict=True)]

    def _depths(self) -> tuple[np.ndarray, np.ndarray]:
        """Return for each line that meets the part the depth of the first node of the body and the number of nodes from
        there on without a gap, itself included, 0 where there is none; the body is examined in pieces, each as thick as
        the part.
        """
        subdomain, axis = self.part, self.axis
        across = tuple(n for a, n in enumerate(subdomain.shape) if a != axis)
        nearest, thickness = np.zeros(across, int), np.zeros(across, int)
        if subdomain.body is None:
            return nearest, thickness + self.count
        goes_on = np.ones(across, bool)  # the end behind the first node has not been reached
        step = subdomain.shape[axis]
        for start in range(0, self.count, step):
            ends = [(first, first + n) for first, n in zip(subdomain.first, subdomain.shape, strict=True)]
            last = min(start + step, self.count)
            ends[axis] = (start, last) if self.side < 0 else (self.count - last, self.count - start)
            mask = self.lattice.part(ends).existing
            assert mask is not None
            for depth, exists in enumerate(np.moveaxis(mask, axis, 0)[:: -self.side], start):
                nearest = np.where((thickness == 0) & exists, depth, nearest)
                goes_on &= exists | (thickness == 0)
                thickness = thickness + (exists & goes_on)
        return nearest, thickness

    def nodes(self, depth: int) -> np.ndarray:
        """The nodes at `depth` from the outermost ones, one for each line."""
        along = self.first + depth
        along = along if self.side < 0 else self.count - 1 - along
        index = self._across
        index.insert(self.axis, along)
        return np.ravel_multi_index(index, self.lattice.shape)

    def own(self, depth: int) -> np.ndarray:
        """Those of these nodes that lie in the part, by their flat indices there."""
        return self.part.own(self.nodes(depth))[1]

    def need(self, least: int, what: str) -> None:
        """Raise an InputError unless the body is `least` nodes thick along all lines."""
        if self.thickness.min(initial=least) < least:
            raise InputError(
                what,
                value=f"{int(self.thickness.min())} node(s) along {AXES[self.axis]}",
                limit=f">= {least}",
                key=self.key,
                remedy="refine the lattice, enlarge the body, or restrict the condition by `within`",
            )

    def transfer(self, given: float, conductivity: np.ndarray | float) -> np.ndarray:
        """Heat transfer coefficients of the outermost nodes."""
        return np.full(len(self.first), given)

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Turn values per area on the lines into values per volume at the outermost nodes, of the shape of the part."""
        mine, nodes = self.part.own(self.nodes(0))
        field = np.zeros(self.part.shape)
        field.ravel()[nodes] = values[mine] / self.lattice.spacing
        return field

    def _at(self, nodes: np.ndarray) -> np.ndarray:
        """Coordinates of nodes, shape (n, dim)."""
        numbers = np.unravel_index(nodes, self.lattice.shape)
        return np.stack([self.lattice.lower[a] + self.lattice.spacing * i for a, i in enumerate(numbers)], axis=-1)

    def coordinates(self, depth: float) -> list[np.ndarray]:
        """Coordinates of the wall, `depth` spacings inside the outermost nodes, one array per axis."""
        at = list(self._at(self.nodes(0)).T)
        at[self.axis] = at[self.axis] - self.side * depth * self.lattice.spacing
        return at

    def values(self, value: Any, depth: float) -> SourceTerm:
        """A value as a source term over the lines, for a wall at `depth`."""
        space, time = space_and_time(value)
        at = self.coordinates(depth)
        if space is None:
            return None, lambda t: _finite(time(*at, t), len(at[0]), self.key)
        if callable(space):
            space = space(*at)
        space = kinds.array(space, self.key, finite=False)
        if space.ndim:
            face = self.lattice.shape[: self.axis] + self.lattice.shape[self.axis + 1 :]
            if space.shape == self.lattice.shape and self.lattice.dim > 1:
                space = space.ravel()[self.nodes(0)]
            elif space.shape == face:
                space = space[tuple(self._across)]
            elif space.shape != at[0].shape:
                raise InputError(
                    "an array has the shape of the side or of the lattice", value=space.shape, limit=face, key=self.key
                )
        return _finite(space, len(at[0]), self.key), time


def _finite(value: Any, count: int, key: str) -> np.ndarray:
    values = np.broadcast_to(kinds.array(value, key, finite=False), (count,))
    if not np.isfinite(values).all():
        raise InputError("values must be finite", value=f"{int((~np.isfinite(values)).sum())} nan or inf", key=key)
    check_size(values, key)
    return values


def _scaled(
    source_term: SourceTerm, factor: np.ndarray | float, put: Callable[[np.ndarray], np.ndarray] = lambda v: v
) -> SourceTerm:
    """The source term times a factor, with its values rearranged by `put`."""
    space, time = source_term
    if space is None:
        return None, lambda t: put(factor * time(t))
    return put(factor * space), time


def _add_source(
    out: Conditions,
    number: int,
    constraint: Flux | Convection,
    face: _Face | _RegionSurface,
    conductivity: np.ndarray | float,
    background: float,
) -> None:
    face.need(2, "heat through a side needs a part at least two nodes wide")
    if isinstance(constraint, Flux):
        out.sources.append((number, _scaled(face.values(constraint.value, -0.5), 1.0, face.spread)))
        return
    assert constraint.transfer is not None
    transfer = face.transfer(constraint.transfer, conductivity)
    out.leaks.append((number, face.spread(transfer)))
    out.sources.append((number, _scaled(face.values(constraint.ambient, -0.5), transfer, face.spread)))
    if background:
        out.sources.append((number, (face.spread(-transfer * background), space_and_time(0.0)[1])))


def _on_face(
    number: int,
    constraint: Temperature | Flux | Insulated,
    face: _Face,
    lattice: Lattice,
    reach: Sequence[int],
    conductivity: np.ndarray | float,
    background: float,
    key: str,
) -> _Held:
    """Layer of prescribed nodes on a side: `depth` counts from the outermost node, the wall is behind the layer."""
    kind = constraint.kind
    layers = 1 if kind == "node" else reach[face.axis]
    mirror = kind == "mirror"
    if not isinstance(constraint, Temperature):
        face.need(layers + 2, "a flux needs a part at least two nodes wide beside its layer")
    face.need(layers + (layers if mirror else 1), "the body is too thin for the layer of a condition")
    mine, nodes = lattice.own(np.concatenate([face.nodes(depth) for depth in range(layers)]))
    inner = [face.nodes(2 * layers - 1 - depth if mirror else layers) for depth in range(layers)]
    in_part, references = lattice.own(np.concatenate(inner)[mine])
    if not in_part.all():
        raise InputError(
            "a condition depends on nodes that another process has",
            value=face.name,
            key="run.topology",
            remedy=f"boxes that are not cut along {AXES[face.axis]} within {2 * layers} nodes of this side of the body",
        )

    def put(values: np.ndarray) -> np.ndarray:
        return np.tile(values, layers)[mine]

    source_terms: list[SourceTerm]
    if isinstance(constraint, Temperature):
        source_term = face.values(constraint.value, 0.0 if kind == "node" else layers - 0.5)
        weight = -1.0 if mirror else 0.0
        source_terms = [_scaled(source_term, 1.0 - weight, put)]
        if background:
            source_terms.append((np.full(len(nodes), -(1 - weight) * background), space_and_time(0.0)[1]))
        plain = constraint.value if not mirror and np.isscalar(constraint.value) else None
        return _Held(number, nodes, references, weight, source_terms, plain, face.axis)
    apart = np.array([2 * (layers - depth) - 1 if mirror else layers - depth for depth in range(layers)])
    distance = np.repeat(apart * lattice.spacing, len(face.first))[mine]
    source_terms = []  # an insulated layer depends on the inside only
    if isinstance(constraint, Flux):
        material = np.broadcast_to(conductivity, lattice.shape).ravel()[references]
        if (material <= 0).any():
            raise InputError(
                "a flux needs a conductivity above 0 on its side", value=float(material.min()), limit="> 0", key=key
            )
        source_term = face.values(constraint.value, layers - 0.5)
        source_terms = [_scaled(source_term, 1.0, lambda v: put(v) * distance / material)]
    return _Held(number, nodes, references, 1.0, source_terms, None, face.axis)


def _in_region(
    number: int, constraint: Constraint, lattice: Lattice, background: float, key: str, gather: Gather
) -> _Held:
    assert isinstance(constraint, Temperature)
    where = constraint.where
    mask = nodes_in(where, lattice, f"{key}.where") if isinstance(where, Shape) else np.asarray(where)
    size = lattice.shape if isinstance(where, Shape) else lattice.whole.shape
    if mask.shape != size or mask.dtype != bool:
        raise InputError(
            "a mask holds true or false for each node",
            value=(mask.shape, str(mask.dtype)),
            limit=size,
            key=f"{key}.where",
        )
    mask = mask if isinstance(where, Shape) else mask[lattice.within]
    if constraint.within is not None:
        mask = mask & nodes_in(constraint.within, lattice, f"{key}.where")
    if lattice.mask is not None:
        mask = mask & lattice.mask
    nodes = np.flatnonzero(mask)
    if not any(gather(bool(nodes.size))):
        raise InputError("no node lies in the shape", key=f"{key}.where", remedy="enlarge it or refine the lattice")
    source_terms = [
        _values_at(constraint.value, [g.ravel()[nodes] for g in lattice.coordinates()], nodes, lattice, key)
    ]
    if background:
        source_terms.append((np.full(len(nodes), -background), space_and_time(0.0)[1]))
    return _Held(number, nodes, nodes, 0.0, source_terms, constraint.value if np.isscalar(constraint.value) else None)


def _values_at(value: Any, at: Sequence[np.ndarray], nodes: np.ndarray, lattice: Lattice, key: str) -> SourceTerm:
    """A value as a source term over points, each of which belongs to a node of this part of the lattice."""
    space, time = space_and_time(value)
    if space is None:
        return None, lambda t: _finite(time(*at, t), len(nodes), key)
    space = kinds.array(space(*at) if callable(space) else space, key, finite=False)
    whole_shape = lattice.whole.shape
    if space.ndim and space.shape != whole_shape and space.shape != nodes.shape:
        raise InputError("an array must have the lattice's shape", value=space.shape, limit=whole_shape, key=key)
    return _finite(space[lattice.within].ravel()[nodes] if space.shape == whole_shape else space, len(nodes), key), time


class _RegionSurface:
    """Bonds of nodes of this part of a body that lead through the surface of a region to places without a node, each
    with the point where it crosses the surface.
    """

    axis, side = None, 0
    _SAMPLES, _HALVINGS = 4, 30  # points per spacing at which a crossing is looked for, and steps by which it is found
    _BALL, _POINTS = 0.25, {1: 2, 2: 32, 3: 14}  # radius around it, in spacings, and points along each axis
    _CHUNK = 1000  # bonds whose normals are found at a time

    def __init__(
        self, region: Shape, subdomain: Lattice, within: Shape | None, key: str, gather: Gather, stencil: Stencil
    ) -> None:
        for shape, name in ((region, "region"), (within, "within")):
            if shape is not None and shape.dim != subdomain.dim:
                raise InputError(
                    "shape and lattice differ in dimension", value=shape.dim, limit=subdomain.dim, key=f"{key}.{name}"
                )
        self.name, self.key, self.part, self._region = "the surface of the region", key, subdomain, region
        self._nodes, self._at, self.first, self._depth = self._bonds(stencil)
        if within is not None:
            kept = within.contains(np.stack([g.ravel()[self._nodes] for g in subdomain.coordinates()], axis=-1))
            self._nodes, self._at, self.first, self._depth = (
                values[kept] for values in (self._nodes, self._at, self.first, self._depth)
            )
        if not any(gather(bool(self._nodes.size))):
            raise InputError(
                "the region has no surface of the body: nodes on one side of its edge, and none on the other",
                value=type(region).__name__,
                limit="the shape of a hole or of the body",
                key=f"{key}.region",
                remedy="a lattice with body=Box(...) - Disc(...), and the Disc as region",
            )

    def _bonds(self, stencil: Stencil) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Nodes, crossings, areas in those of a face of a cell, and distances from the surface, of all bonds."""
        subdomain, reach = self.part, stencil.reach
        wide, part_in_wide = subdomain.around(reach)
        exists = np.ones(wide.shape, bool) if wide.mask is None else wide.mask
        beyond = [
            (m - ends.start, ends.stop + m - n) for m, ends, n in zip(reach, part_in_wide, wide.shape, strict=True)
        ]
        missing = np.pad(~exists, beyond)  # the sides of the lattice are no surface
        middle = tuple(slice(m, m + n) for m, n in zip(reach, subdomain.shape, strict=True))
        moment = 0.5 * (stencil.weights[:, None] * stencil.offsets**2).sum(0).mean()
        near = np.zeros(subdomain.shape, bool)
        for offset in stencil.offsets:
            near |= missing[tuple(slice(ends.start + k, ends.stop + k) for ends, k in zip(middle, offset, strict=True))]
        nodes = np.flatnonzero(near & ~missing[middle])
        at = np.stack([g.ravel()[nodes] for g in subdomain.coordinates()], axis=-1)
        places = np.stack(np.unravel_index(nodes, subdomain.shape), axis=-1) + np.array(reach)
        here, crossing = self._region.contains(at)[:, None], []
        for offset, weight in zip(stencil.offsets, stencil.weights, strict=True):
            count = self._SAMPLES * int(np.abs(offset).max())
            steps = np.arange(1, count + 1)[:, None] * offset / count
            across = self._region.contains(at[:, None] + subdomain.spacing * steps) != here
            bare = missing[tuple(np.moveaxis(places[:, None] + np.rint(steps).astype(int), -1, 0))]
            which = np.flatnonzero((across & bare).any(1))
            high = (across[which].argmax(1) + 1.0) / count
            low = high - 1 / count
            for _ in range(self._HALVINGS):
                half = (low + high) / 2
                before_surface = (
                    self._region.contains(at[which] + subdomain.spacing * half[:, None] * offset) == here[which, 0]
                )
                low, high = np.where(before_surface, half, low), np.where(before_surface, high, half)
            points = at[which] + subdomain.spacing * high[:, None] * offset
            along = np.abs(self._normals(points) @ offset)
            crossing.append((nodes[which], points, weight / moment * along, subdomain.spacing * high * along))
        return tuple(np.concatenate(values) for values in zip(*crossing, strict=True))  # type: ignore[return-value]

    def _normals(self, at: np.ndarray) -> np.ndarray:
        """Normals of the region at points of its surface, from where it lies around them."""
        dim, count = self.part.dim, self._POINTS[self.part.dim]
        along = (2 * np.arange(count) + 1 - count) / count
        ball = np.stack(np.meshgrid(*[along] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
        ball = ball[(ball**2).sum(1) <= 1]
        normals = np.zeros_like(at)
        for first in range(0, len(at), self._CHUNK):
            points = at[first : first + self._CHUNK, None] + self._BALL * self.part.spacing * ball
            normal = self._region.contains(points) @ ball
            length = np.linalg.norm(normal, axis=1, keepdims=True)
            normals[first : first + self._CHUNK] = normal / np.where(length > 0, length, 1.0)
        return normals

    def transfer(self, given: float, conductivity: np.ndarray | float) -> np.ndarray:
        """Heat transfer coefficients between a fluid and the nodes: that of the surface, and the way to the node."""
        material = np.broadcast_to(conductivity, self.part.shape).ravel()[self._nodes]
        slow = np.divide(given * self._depth, material, out=np.zeros_like(self._depth), where=material > 0)
        return given / (1 + slow)

    def need(self, least: int, what: str) -> None:
        """A surface may have nodes of any depth behind it."""

    def own(self, depth: int) -> np.ndarray:
        """Nodes at the surface, by their flat indices in the part."""
        return np.unique(self._nodes)

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Turn values per area on the bonds into values per volume at their nodes, of the shape of the part."""
        field = np.zeros(self.part.shape)
        np.add.at(field.reshape(-1), self._nodes, values * self.first / self.part.spacing)
        return field

    def values(self, value: Any, depth: float) -> SourceTerm:
        """A value as a source term over the bonds."""
        return _values_at(value, list(self._at.T), self._nodes, self.part, self.key)


def _contradiction(first: int, second: int, node: int, lattice: Lattice) -> InputError:
    at = np.array(np.unravel_index(node, lattice.shape))
    return InputError(
        "two conditions on one node contradict each other",
        value=f"constraint[{min(first, second)}] and constraint[{max(first, second)}] near "
        f"{(lattice.lower + at * lattice.spacing).tolist()}",
        key="constraints",
        remedy="restrict one of them by `within`",
    )


def _refuse_heated(
    out: Conditions, held_nodes: Sequence[_Held], heated: Sequence[tuple[int, _Face | _RegionSurface]], lattice: Lattice
) -> None:
    """Refuse heat into nodes whose value is prescribed, where it would be lost; where two sides of the body meet, it
    goes into the wall.
    """
    axes = {held.number: held.axis for held in held_nodes}
    for number, face in heated:
        alike = np.isin(out.owner, [n for n, axis in axes.items() if axis in (None, face.axis)])
        lost = np.flatnonzero(alike & np.isin(out.nodes, face.own(0)))
        if lost.size:
            raise _contradiction(number, int(out.owner[lost[0]]), int(out.nodes[lost[0]]), lattice)


def _join(out: Conditions, held_nodes: Sequence[_Held], lattice: Lattice) -> None:
    """Join all conditions into one table: plain values first, then nodes that follow from others, axis by axis. A node
    with two conditions must get the same number from both, except where layers of different axes meet: a plain value
    counts, otherwise the layer of the later axis, which reads that of the earlier one.
    """
    if not held_nodes:
        return
    shape = lattice.shape
    owner = np.full(int(np.prod(shape)), -1)
    by_number = {h.number: h for h in held_nodes}
    order = sorted(held_nodes, key=lambda h: (h.weight != 0, -1 if h.axis is None else h.axis))
    for held in order:
        taken = owner[held.nodes]
        for owner_there in np.unique(taken[taken >= 0]):
            rival = by_number[int(owner_there)]
            corner = None not in (held.axis, rival.axis) and held.axis != rival.axis and bool(held.weight)
            if not corner and (held.plain is None or held.plain != rival.plain):
                raise _contradiction(held.number, int(owner_there), int(held.nodes[taken == owner_there][0]), lattice)
            if corner and rival.weight:
                owner[held.nodes[taken == owner_there]] = held.number
        owner[held.nodes[taken < 0]] = held.number
    kept = [(held, owner[held.nodes] == held.number) for held in order]
    place = np.full(owner.shape, -1)  # position of each node in the order of setting
    start = 0
    for held, keep in kept:
        place[held.nodes[keep]] = start + np.arange(keep.sum())
        start += int(keep.sum())
        if held.weight and (place[held.references[keep]] < 0).any():
            loose = held.references[keep][place[held.references[keep]] < 0]
            if (owner[loose] >= 0).any():
                raise InputError(
                    "a condition depends on nodes that a later one prescribes",
                    value=f"constraint[{held.number}]",
                    key="constraints",
                    remedy="restrict one of them by `within`",
                )
    sizes = [int(keep.sum()) for _, keep in kept]
    total, start = sum(sizes), 0
    out.nodes = np.concatenate([h.nodes[k] for h, k in kept])
    out.owner = np.repeat([h.number for h, _ in kept], sizes)
    follows = np.repeat([h.weight != 0 for h, _ in kept], sizes)
    out.starts = np.concatenate([[0], np.cumsum(follows)])
    out.references = np.concatenate([h.references[k] for h, k in kept])[follows]
    out.weights = np.repeat([h.weight for h, _ in kept], sizes)[follows]
    for (held, keep), size in zip(kept, sizes, strict=True):

        def put(values: np.ndarray, keep: np.ndarray = keep, first: int = start, size: int = size) -> np.ndarray:
            field = np.zeros(total)
            field[first : first + size] = values[keep]
            return field

        out.source_terms += [_scaled(source_term, 1.0, put) for source_term in held.source_terms]
        start += size
