"""The layers of a set-up whose thickness nobody gave: chosen for its data, its shape and the length of its run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import fft

from farhorizon.analysis.chain import Recursion
from farhorizon.analysis.layer import Medium
from farhorizon.analysis.returned import Arrivals, Datum, Sample, arrivals
from farhorizon.analysis.thickness import Thickness, distance_to_side, family, least, thinnest
from farhorizon.boundaries import Fixed, Free, LatticePML, Periodic
from farhorizon.engine import Layer
from farhorizon.errors import InputError
from farhorizon.machine import one_blas_thread
from farhorizon.stencil import Stencil

CROSSINGS, LASTING = 20, 10  # length of a run unless it is known: of waves in crossings of the near field, of diffusion in R^2/diffusivity
_ROOM = 512  # nodes beside the near field, at most, before the data repeat themselves along the side
_ROUND = 2  # lengths of the run before images come round, if there is room: what comes later folds back into it, much fainter
_STAND_IN = 2.0  # width, in nodes, of the pulses that stand for data which are not known


@dataclass(frozen=True)
class FarField:
    """A wave field with open sides, of a scalar or of vectors.

    Vectors travel as P and as S waves, of which neither the data nor a side tells how much there is of each. So each
    component is taken to travel once as the one and once as the other, and the larger error counts.

    Attributes
    ----------
    shape : tuple of int
        Nodes of the near field.
    stencil : Stencil
    coefficient : float
        Squared speed.
    spacing : float
    recursion : Recursion
    dt : float
    sides : mapping of (axis, side) to Boundary
    data : sequence of Datum
        On the near field.
    scatterers : ndarray of bool, or None
        Nodes where waves are scattered: the data are taken to come from the nearest of them, too.
    """

    shape: tuple[int, ...]
    stencil: Stencil
    coefficient: float
    spacing: float
    recursion: Recursion
    dt: float
    sides: Mapping[tuple[int, int], object]
    data: Sequence[Datum]
    scatterers: np.ndarray | None = None
    _known: dict[tuple[object, ...], Thickness] = field(default_factory=dict)  # of sides that are alike
    _samples: dict[tuple[Stencil, int], Sample] = field(default_factory=dict)

    @one_blas_thread()
    def layer(self, axis: int, side: int, boundary: LatticePML, until: float) -> Thickness:
        """The thinnest layer of one side that keeps the target to the end of a run.

        Raises
        ------
        InputError
            No layer keeps it.
        """
        stencil, wanted = self._facing(axis), boundary.wanted(2)
        size = max((float(np.abs(datum.values).max()) for datum in self.data if datum.kind == "u"), default=0.0)
        medium = Medium(stencil, self.coefficient, self.spacing, self.recursion, self.dt)
        turned = [self._from_scatterers(datum.turned(axis, side), axis, side) for datum in self.data]
        alike = (boundary, until, stencil, self.sides[axis, -side], *self._beside(axis), *(datum.values.tobytes() for datum in turned))
        if alike in self._known:
            return self._known[alike]
        distance = distance_to_side([datum.values for datum in turned])
        arrived = self._arrivals(medium, axis, side, turned, until, wanted, size)
        size = max([size, *(one.largest for one in arrived)])

        def steep(nodes: int) -> Layer:
            return replace(boundary, nodes=nodes).layer(2, stencil, self.coefficient, self.spacing, 0.0)

        members = family(stencil, medium.speed / self.spacing, until, distance, wanted, steep)
        found = thinnest(members, arrived, wanted, size)
        if found is None:
            raise InputError(
                "no layer keeps the target for these data", value=wanted, limit=f">= {least(members, arrived, size):.1g}", key="boundary.target",
                remedy="a larger target, smoother data, data farther from the side, another influence, or Extended, Exact or a Sponge",
            )  # fmt: skip
        self._known[alike] = replace(found, until=until)
        return self._known[alike]

    def _facing(self, axis: int) -> Stencil:
        """The stencil with an axis first; the same one for all axes where these may be exchanged."""
        alike = all(self.stencil.same_along(0, other) for other in range(1, self.stencil.dim))
        return self.stencil.along(0 if alike else axis)

    def _beside(self, axis: int) -> list[object]:
        """The sides along the other axes."""
        return [self.sides[other, side] for other in range(len(self.shape)) if other != axis for side in (-1, 1)]

    def _from_scatterers(self, datum: Datum, axis: int, side: int) -> Datum:
        """The datum, moved along the normal to where waves are scattered last before the side, if that is nearer to it."""
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
        self, medium: Medium, axis: int, side: int, data: Sequence[Datum], until: float, wanted: float, size: float
    ) -> list[Arrivals]:  # fmt: skip
        """What arrives at a side, with the images of the data behind the walls of the near field."""
        room, steps = int(np.ceil(_ROUND * medium.speed * until / self.spacing)), max(2, int(np.ceil(until / self.dt)))
        others = [b for b in range(len(self.shape)) if b != axis]
        image = _image(self.sides[axis, -side])
        found = []
        for component in sorted({datum.component for datum in data}):
            own = [datum for datum in data if datum.component == component]
            for kept in range(max(1, len(others))):
                flat = [_flattened(datum.values, [place for place in range(1, len(self.shape)) if place != kept + 1]) for datum in own]
                if image:
                    flat = [np.concatenate([image * values[::-1], values]) for values in flat]
                lengths, near = [1] * len(others), [range(1)] * len(others)
                if others:
                    flat, near[kept], lengths[kept] = self._unfold(flat, kept + 1, others[kept], room)
                sent = [replace(datum, values=values) for datum, values in zip(own, flat, strict=True)]
                for kind in range(min(self.stencil.components, 2)):
                    sample = self._samples.setdefault((medium.stencil, kind), Sample(medium, kind))
                    found.append(arrivals(medium, steps, sent, lengths, near, wanted, size, sample))
        return found

    def _unfold(self, fields: list[np.ndarray], place: int, axis: int, room: int) -> tuple[list[np.ndarray], range, int]:
        """Fields with their images along a tangential axis, which nodes are the near field's, and the length after which all is repeated."""
        lower, upper = self.sides[axis, -1], self.sides[axis, 1]
        below, above, nodes = _image(lower), _image(upper), fields[0].shape[place]
        near = range(nodes)
        if isinstance(lower, Periodic):
            return fields, near, nodes
        if above:
            fields = [np.concatenate([field, above * np.flip(field, place)], place) for field in fields]
        elif below:
            fields = [np.concatenate([below * np.flip(field, place), field], place) for field in fields]
            near = range(nodes, 2 * nodes)
        if above and below and above != below:
            fields = [np.concatenate([field, -field], place) for field in fields]
        count = fields[0].shape[place]
        if above and below:
            return fields, near, count
        return fields, near, fft.next_fast_len(count + min(room, max(_ROOM, nodes)))


def stand_ins(shape: tuple[int, ...], reach: int, components: int = 1) -> list[Datum]:
    """Data in place of such that are not known: short pulses in the middle and one reach and a few nodes from both ends of each axis."""
    places = [np.array(shape) / 2]
    for axis, nodes in enumerate(shape):
        near = min(reach + 4 * _STAND_IN, nodes / 2)
        places += [np.where(np.arange(len(shape)) == axis, end, places[0]) for end in (near, nodes - 1 - near)]
    grid = np.ix_(*[np.arange(n) for n in shape])
    pulses = [np.exp(-sum((x - a) ** 2 for x, a in zip(grid, place, strict=True)) / _STAND_IN**2) for place in places]
    return [Datum(np.max(pulses, axis=0), "u", component=component) for component in range(components)]


def _flattened(values: np.ndarray, axes: Sequence[int]) -> np.ndarray:
    """Values without their course along some axes, where the largest remains: in space waves along one tangential axis at a time stand for all.

    A cylindrical wave falls off more slowly than a spherical one, so this is careful, and far less work.
    """
    for axis in axes:
        values = np.take_along_axis(values, np.abs(values).argmax(axis, keepdims=True), axis)
    return values


def _image(boundary: object) -> int:
    """Sign of the image that stands for a wall; 0 where the medium goes on."""
    return 1 if isinstance(boundary, Free) else -1 if isinstance(boundary, Fixed) else 0
