"""A wave field with open sides: the waves that its data send to each of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import fft
from scipy.ndimage import affine_transform

from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.arrivals import arrivals, round_a_point
from farhorizon.analysis.layers.beside_walls import Turned, turned_by_wall
from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.returned import Arrivals
from farhorizon.analysis.layers.samples import Sample
from farhorizon.analysis.layers.short_waves import high_pass
from farhorizon.analysis.layers.side_data import Datum, hold_backward_waves, reach_the_end
from farhorizon.analysis.layers.thickness import distance_to_side
from farhorizon.boundaries import Side
from farhorizon.medium.stencil import Stencil
from farhorizon.simulation.wave_data import depth_of, followed_parts, is_long, key_of, largest_along

# The period of the data along an open side exceeds the near field by at most so many nodes, or so many lengths of the
# near field if that is more: by the time images arrive, only the longest waves and those that hardly move remain.
_ROOM, _LEFT = 512, 3
_HERE = 0.01  # fraction of its largest value above which a datum is taken to occupy a node


def _beyond(side: Side) -> tuple[float, bool, bool]:
    """Return all that predictions use of a side, as a key: sides that hold arrays have no hash."""
    return side.image, side.periodic, side.stretched


def _size(datum: Datum) -> float:
    return float(np.abs(datum.values).max())


@dataclass(frozen=True)
class WaveField:
    """Scalar or vector wave field with open sides.

    A vector field travels as P and S waves, whose shares are not known from the data. So each component is taken to
    travel once as P and once as S waves, and the larger error counts. Where backward waves are followed, all modes of
    all components are followed together.

    Attributes
    ----------
    shape : tuple of int
        Nodes of the near field.
    stencil : Stencil
    coefficient : float
        Squared speed of the medium to which the stencil belongs.
    coefficients : mapping of (axis, side) to float
        Squared speed of the medium at each side; the whole medium is taken to have it when waves to this side are
        predicted.
    spacing : float
    recursion : Recursion
    dt : float
    sides : mapping of (axis, side) to Side
    data : sequence of Datum
        Fields on the near field.
    scatterers : ndarray of bool, or None
        Nodes where waves are scattered: the data are taken to start from those nearest to a side as well.
    squared_speed : ndarray, or None
        Squared speed at each node over that of the model: waves become shorter in a slower medium, longer in a faster
        one.
    known : bool
        Whether the data are those of the run. If not, they are short pulses, which may hold more short waves.
    """

    shape: tuple[int, ...]
    stencil: Stencil
    coefficient: float
    coefficients: Mapping[tuple[int, int], float]
    spacing: float
    recursion: Recursion
    dt: float
    sides: Mapping[tuple[int, int], Side]
    data: Sequence[Datum]
    scatterers: np.ndarray | None = None
    squared_speed: np.ndarray | None = None
    known: bool = True
    # by the key of equivalent sides
    _sent: dict[tuple[object, ...], tuple[list[Arrivals], float]] = field(default_factory=dict)
    _samples: dict[tuple[Stencil, float, int, int], Sample] = field(default_factory=dict)
    _turned: dict[int, Turned] = field(default_factory=dict)  # by axis

    def alike(self, axis: int, side: int, until: float, wanted: float) -> tuple[object, ...]:
        """Return a key that is the same for equivalent sides."""
        return self._alike(axis, side, until, wanted, self._seen(axis, side, wanted))

    def arriving(self, axis: int, side: int, until: float, wanted: float, nodes: int) -> tuple[list[Arrivals], float]:
        """Return the waves that arrive at a side, followed until slow ones are back from a layer of `nodes` nodes, and
        the largest value of the data.
        """
        seen = self._seen(axis, side, wanted)
        slow = any(every and is_long(medium, until, self._room) for medium, _, every in seen)
        key = self._alike(axis, side, until, wanted, seen), nodes if slow else 0
        if key not in self._sent:
            size = max((_size(datum) for datum in self.data if datum.kind == "u"), default=0.0)
            arrived = [
                one
                for medium, data, _ in seen
                for one in self._arrivals(medium, axis, side, data, until, wanted, size, nodes)
            ]
            self._sent[key] = arrived, max([size, *(one.largest for one in arrived)])
        return self._sent[key]

    def _seen(self, axis: int, side: int, wanted: float) -> list[tuple[LatticeMedium, list[Datum], bool]]:
        """Return the media at a side, each with the data seen from there and whether they are followed as vectors."""
        found = []
        for medium in self.media(axis, side):
            data = self.turned(axis, side, medium)
            vectors = self.stencil.components > 1 and self._every(medium, data, wanted)
            whole = self._as_vectors(data, axis, side) if vectors else data
            found += [(medium, one, vectors) for one in (whole, *self._sent_back(whole))]
        return found

    def _sent_back(self, data: Sequence[Datum]) -> list[list[Datum]]:
        """Return the data with reversed velocities, if they have initial values as well and there are scatterers: waves
        that run away from a side, of which the data may contain nothing else, are scattered back to it.
        """
        scattered = self.scatterers is not None and self.scatterers.any()
        if not scattered or not {"u", "v"} <= {datum.kind for datum in data}:
            return []
        return [[replace(datum, values=-datum.values) if datum.kind == "v" else datum for datum in data]]

    def _alike(
        self, axis: int, side: int, until: float, wanted: float, seen: Sequence[tuple[LatticeMedium, list[Datum], bool]]
    ) -> tuple[object, ...]:
        return (
            until,
            wanted,
            *map(_beyond, (self.sides[axis, -side], *self.beside(axis))),
            *(part for medium, _, _ in seen for part in (medium.stencil, medium.coefficient)),
            *(key_of(data, every, self._mirrors(axis, medium)) for medium, data, every in seen),
        )

    def media(self, axis: int, side: int) -> list[LatticeMedium]:
        """Return the fastest medium at a side, for which its layer is made, and the slowest one along the side if it is
        different: the layer attenuates its waves more strongly.

        In their stencils the normal axis comes first; if all axes are equivalent, axis 0 stands for each of them.
        """
        alike = all(self.stencil.same_along(0, other) for other in range(1, self.stencil.dim))
        stencil, found = self.stencil.along(0 if alike else axis), [self.coefficients[axis, side]]
        if self.squared_speed is not None:
            along = self.squared_speed.take(min(side, 0), axis)
            found.append(self.coefficient * float(along.min(where=along > 0, initial=found[0] / self.coefficient)))
        return [
            LatticeMedium(stencil.beside(squared / self.coefficient), squared, self.spacing, self.recursion, self.dt)
            for squared in sorted(set(found), reverse=True)
        ]

    def turned(self, axis: int, side: int, medium: LatticeMedium) -> list[Datum]:
        """Return the data as seen from a side at which the medium is the given one."""
        at_side = medium.coefficient / self.coefficient
        return [
            self._from_scatterers(self._shortened(datum, axis, side).turned(axis, side), axis, side).with_entrance()
            for datum in (self._behind(datum, axis, side, at_side) for datum in self.data)
        ]

    def _every(self, medium: LatticeMedium, data: Sequence[Datum], wanted: float) -> bool:
        """Whether all modes of the medium in front of a side are followed."""
        if not self.follows_backward_waves:
            return False
        return hold_backward_waves(medium, data, wanted) or reach_the_end(medium, data, wanted)

    @property
    def follows_backward_waves(self) -> bool:
        """Whether backward waves in the data are followed: in uniform media, for scalars, and for vectors in 2D if the
        data are those of the run and no wall converts P and S waves into each other.
        """
        if self.squared_speed is not None or self.stencil.components == 1:
            return self.squared_speed is None
        walls = any(b.image for b in self.sides.values())
        return self.stencil.components == self.stencil.dim == 2 and self.known and not walls

    @property
    def _room(self) -> int:
        """Largest number of nodes by which the period along an open side exceeds the near field."""
        return max(_ROOM, _LEFT * max(self.shape))

    def _as_vectors(self, data: Sequence[Datum], axis: int, side: int) -> list[Datum]:
        """Return the data of a side in 2D with the components seen from there: 0 towards the side, 1 along it."""
        towards = [replace(d, values=side * d.values, component=0) for d in data if d.component == axis]
        return towards + [replace(d, component=1) for d in data if d.component != axis]

    def _behind(self, datum: Datum, axis: int, side: int, at_side: float) -> Datum:
        """Return the datum; if the medium is slower where it lies than at the side, with the place of the interface."""
        if self.squared_speed is None:
            return datum
        here = np.abs(datum.values) > _HERE * np.abs(datum.values).max()
        # no wave starts where bonds have no stiffness
        slowest = float(self.squared_speed.min(where=here & (self.squared_speed > 0), initial=at_side))
        if slowest >= at_side:
            return datum
        rows = Datum(self.squared_speed, datum.kind).turned(axis, side).values.reshape(len(datum.values), -1)
        nodes = len(rows) - 1 - int(np.flatnonzero(rows.min(1) ** 2 < slowest * at_side)[-1])
        return replace(datum, behind=(nodes, slowest / at_side)) if nodes else datum

    def _shortened(self, datum: Datum, axis: int, side: int) -> Datum:
        """Return the datum; if the medium at the side is slower than anywhere the datum lies, a copy compressed along
        the normal is added, because waves keep their frequency at an interface.
        """
        if self.squared_speed is None:
            return datum
        here = np.abs(datum.values) > _HERE * np.abs(datum.values).max()
        fastest = self.coefficient * float(self.squared_speed[here].max())
        ratio = float(np.sqrt(self.coefficients[axis, side] / fastest)) if fastest > 0 else 1.0
        if ratio >= 1:
            return datum
        size = np.abs(datum.values).sum(axis=tuple(a for a in range(datum.values.ndim) if a != axis))
        centre = float(np.average(np.arange(len(size)), weights=size))
        scale, offset = np.ones(datum.values.ndim), np.zeros(datum.values.ndim)
        scale[axis], offset[axis] = 1 / ratio, centre - centre / ratio
        return replace(datum, values=datum.values + affine_transform(datum.values, scale, offset, order=1))

    def beside(self, axis: int) -> list[Side]:
        """Return the sides of the other axes."""
        return [self.sides[other, side] for other in range(len(self.shape)) if other != axis for side in (-1, 1)]

    def _mirrors(self, axis: int, medium: LatticeMedium) -> list[int]:
        """Return the axes of the turned data under whose reflection the medium and the sides are unchanged."""
        beside = self.beside(axis)
        pairs = enumerate(zip(beside[::2], beside[1::2], strict=True), 1)
        return [
            place
            for place, (lower, upper) in pairs
            if _beyond(lower) == _beyond(upper) and medium.stencil.even_along(place)
        ]

    def _from_scatterers(self, datum: Datum, axis: int, side: int) -> Datum:
        """Return the datum; if there are scatterers nearer to the side, the larger of it and a copy that is moved to
        the last of them, but at most half the distance.
        """
        if self.scatterers is None or not self.scatterers.any():
            return datum
        nodes = Datum(self.scatterers, datum.kind).turned(axis, side).values.reshape(len(datum.values), -1)
        nearer = int(distance_to_side([datum.values])) - (len(nodes) - 1 - int(np.flatnonzero(nodes.any(1))[-1]))
        nearer = min(nearer, int(distance_to_side([datum.values])) // 2)
        if nearer <= 0:
            return datum
        moved = np.zeros_like(datum.values)
        moved[nearer:] = datum.values[:-nearer]
        return replace(datum, values=np.where(np.abs(moved) > np.abs(datum.values), moved, datum.values))

    def _arrivals(
        self,
        medium: LatticeMedium,
        axis: int,
        side: int,
        data: Sequence[Datum],
        until: float,
        wanted: float,
        size: float,
        nodes: int,
    ) -> list[Arrivals]:
        """Return the waves that arrive at a side, with those of the images of the data behind walls."""
        others = [b for b in range(len(self.shape)) if b != axis]
        image = self.sides[axis, -side].image
        echoing = len({other for (other, _), b in self.sides.items() if b.stretched})
        found = []
        apart = [[datum for datum in data if datum.component == one] for one in sorted({d.component for d in data})]
        several = self.stencil.components > 1
        groups = [(own, not several and self._every(medium, own, wanted)) for own in apart]
        if several and self._every(medium, data, wanted):
            groups.append((list(data), True))  # in addition: the separate components resolve slow waves better
        for own, every in groups:
            together = several and every
            if len(others) == 2 and not any(self.sides[other, s].periodic for other in others for s in (-1, 1)):
                round_waves = self._round(medium, axis, own, image, until, wanted, size, nodes, echoing, every)
                if round_waves:
                    found += round_waves
                    continue
            for kept in range(max(1, len(others))):
                flat = [
                    largest_along(datum.values, [place for place in range(1, len(self.shape)) if place != kept + 1])
                    for datum in own
                ]
                if image:
                    flat = [np.concatenate([image * values[::-1], values]) for values in flat]
                lengths, near, length = [1] * len(others), [range(1)] * len(others), 0
                if others:
                    flat, near[kept], length = self._unfold(flat, kept + 1, others[kept])
                sent = [replace(datum, values=values) for datum, values in zip(own, flat, strict=True)]
                depths = self.shape[axis] // 2, *depth_of(own)[: int(every)]
                endless = bool(others) and not length
                for part in followed_parts(
                    medium, sent, until, wanted, self._room if endless else np.inf, every, nodes
                ):
                    if others:
                        lengths[kept] = length or fft.next_fast_len(flat[0].shape[kept + 1] + part.room)
                    steps = max(2, int(np.ceil(part.time / self.dt)))
                    for kind in range(1 if together else min(self.stencil.components, 2)):
                        key = medium.stencil, medium.coefficient, -1 if together else kind, steps
                        sample = self._samples.setdefault(key, Sample(medium, kind))
                        coming = arrivals(
                            medium,
                            steps,
                            part.data,
                            lengths,
                            near,
                            wanted,
                            size,
                            sample,
                            smooth=part.smooth,
                            every=every,
                            limit=part.limit,
                        )
                        found.append(replace(coming, depths=depths, axes=echoing, later=part.later))
        return found

    def _round(
        self,
        medium: LatticeMedium,
        axis: int,
        data: Sequence[Datum],
        image: int,
        until: float,
        wanted: float,
        size: float,
        nodes: int,
        echoing: int,
        every: bool,
    ) -> list[Arrivals]:
        """Return the waves that arrive at a side in 3D, at the point that faces the data, at the corner farthest from
        it, and midway between them; empty unless the medium continues along both tangential axes.
        """
        others, fields, near = [b for b in range(3) if b != axis], [datum.values for datum in data], []
        for place, other in enumerate(others, 1):
            fields, beside, length = self._unfold(fields, place, other)
            near.append(beside)
            if length:
                return []
        if image:
            fields = [np.concatenate([image * values[::-1], values]) for values in fields]
        weight = np.max([(np.abs(values) / max(np.abs(values).max(), 1e-300)).max(0) for values in fields], axis=0)
        inside = weight[np.ix_(*near)]
        facing = np.array([round(float(np.average(grid, weights=inside))) for grid in np.indices(inside.shape)])
        corner = np.where(facing > (np.array(inside.shape) - 1) / 2, 0, np.array(inside.shape) - 1)
        first = np.array([nodes[0] for nodes in near])
        found = []
        depths = self.shape[axis] // 2, *depth_of(data)[: int(every)]
        flat = [replace(datum, values=values) for datum, values in zip(data, fields, strict=True)]
        for part in followed_parts(medium, flat, until, wanted, self._room, every, nodes):
            steps = max(2, int(np.ceil(part.time / self.dt)))
            for point in (facing, (facing + corner) // 2, corner):
                turned = [round_a_point(datum.values, first + point, part.room / 2) for datum in part.data]
                sent = [replace(datum, values=values) for datum, (_, values) in zip(part.data, turned, strict=True)]
                for kind in range(min(self.stencil.components, 2)):
                    key = medium.stencil, medium.coefficient, kind, steps
                    sample = self._samples.setdefault(key, Sample(medium, kind))
                    coming = arrivals(
                        medium,
                        steps,
                        sent,
                        [],
                        [],
                        wanted,
                        size,
                        sample,
                        smooth=part.smooth,
                        radial=turned[0][0],
                        every=every,
                        limit=part.limit,
                    )
                    found.append(replace(coming, depths=depths, axes=echoing, later=part.later))
        return found

    def _unfold(self, fields: list[np.ndarray], place: int, axis: int) -> tuple[list[np.ndarray], range, int]:
        """Return the fields with their images along an axis, the range of nodes that belong to the near field, and the
        period; 0 if the axis is open.
        """
        lower, upper = self.sides[axis, -1], self.sides[axis, 1]
        below, above, nodes = lower.image, upper.image, fields[0].shape[place]
        near = range(nodes)
        if lower.periodic:
            return fields, near, nodes
        if above:
            fields = [np.concatenate([field, above * np.flip(field, place)], place) for field in fields]
        elif below:
            fields = [np.concatenate([below * np.flip(field, place), field], place) for field in fields]
            near = range(nodes, 2 * nodes)
        if above and below and above != below:
            fields = [np.concatenate([field, -field], place) for field in fields]
        return fields, near, fields[0].shape[place] if above and below else 0

    def turned_by_walls(self, axis: int) -> Turned:
        """Return the backward waves that the walls beside the layers of an axis make of the data."""
        if axis not in self._turned:
            walls = {a: [s for s in (-1, 1) if self.sides[a, s].image] for a in range(len(self.shape)) if a != axis}
            found = [self._turned_by(wall, axis) for wall, ends in walls.items() for _ in ends]
            between = [self.shape[wall] for wall, ends in walls.items() if len(ends) == 2]
            amplitudes, roots = (sum(getattr(one, name) for one in found) for name in ("amplitude", "root"))
            self._turned[axis] = Turned(amplitudes, roots, min(between, default=0))
        return self._turned[axis]

    def _turned_by(self, wall: int, axis: int) -> Turned:
        """Return the waves that a wall across an axis makes of the data."""
        order = [wall, axis, *(other for other in range(len(self.shape)) if other not in (wall, axis))]
        damped, stencil = high_pass(self.stencil), self.stencil.along(axis).along(1 + wall - (wall > axis))
        assert damped is not None
        medium, found = LatticeMedium(stencil, self.coefficient, self.spacing, self.recursion, self.dt), np.zeros(2)
        largest = {one.kind: max(_size(other) for other in self.data if other.kind == one.kind) for one in self.data}
        for datum in self.data:
            fields = [datum.values]
            for along in order:
                fields = self._unfold(fields, along, along)[0]
            component = order.index(datum.component) if self.stencil.components > 1 else 0
            turned = replace(datum, values=fields[0].transpose(order), component=component)
            found += np.array(turned_by_wall(medium, damped, turned)[:2]) * _size(datum) / (largest[datum.kind] or 1.0)
        return Turned(*found)
