"""Media that vary: the uniform medium beside which one does, and what follows from all of it.

Of a run on several processes each looks at a box of the lattice, and they tell each other what they have found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt

from farhorizon.errors import InputError
from farhorizon.geometry.decomposition import Decomposition, Key, decompose
from farhorizon.geometry.lattice import Lattice, check_any
from farhorizon.inputs.expressions import as_given
from farhorizon.inputs.sources import checked_shape, field
from farhorizon.medium.force_states import closing_rate
from farhorizon.medium.stencil import Stencil
from farhorizon.medium.variation import Variation, is_one, lightest_bond
from farhorizon.models import LatticeModel
from farhorizon.simulation.setup import Setup, within_part
from farhorizon.simulation.team import ALONE, Team

_EVEN = ("stiffness", "density")  # what of a variation may turn out to be 1 everywhere


@dataclass(frozen=True, eq=False)
class Host:
    """The uniform medium beside which one varies.

    Attributes
    ----------
    model : LatticeModel
    outside : dict of str to float
        Constants where a body has no nodes, for nothing is known there.
    even : tuple of str
        What does not vary after all, by the names of `Variation`.
    """

    model: LatticeModel
    outside: Mapping[str, float]
    even: tuple[str, ...]

    def uniform(self, setup: Setup) -> Setup:
        """A set-up with this medium everywhere."""
        return replace(setup, model=self.model, rule=setup.bond_rule) if setup.model.varying else setup

    def beside(self, setup: Setup) -> Variation:
        """How the medium of a set-up, or of a part of it, varies beside this one; InputError as `looked_at`."""
        return self.varying(_filled(constants_of(setup), setup.lattice, self.outside))

    def varying(self, values: Mapping[str, np.ndarray]) -> Variation:
        """How it does by the constants at the nodes, which are known outside a body, too."""
        return self.model.beside(values).without(self.even) if values else Variation()


class Pace(NamedTuple):
    """How fast a medium that varies is, over the uniform one beside it.

    Attributes
    ----------
    strongest, weakest : float
        The largest squared speed of waves, and the smallest one where there are bonds; factors on bonds where no
        density varies.
    fastest : float
        What squared frequencies are multiplied with at most.
    sides : dict of (axis, side) to float
        The largest squared speed within one reach of each side, for a layer goes by the fastest waves that it meets.
    closing : float
        What bonds that close may add to the largest value of the symbol, of materials with states.
    """

    strongest: float
    weakest: float
    fastest: float
    sides: dict[Key, float]
    closing: float


def varied(setup: Setup) -> tuple[Setup, Variation]:
    """A set-up whose model is uniform, and how the medium varies beside it; InputError as `looked_at`."""
    host, variation = looked_at(setup, ALONE)
    return host.uniform(setup), variation


def looked_at(setup: Setup, team: Team) -> tuple[Host, Variation]:
    """The host medium of a set-up, and how the medium varies beside it in the box of the lattice that this process
    looks at.

    Raises
    ------
    InputError
        Constants that are not positive, or of the wrong shape.
    """
    boxes = decompose(setup.lattice.shape, team.size, (1,) * setup.lattice.dim, {}, frozenset())
    part = replace(setup, lattice=setup.lattice.part(boxes.ranges(team.number))) if team else setup
    lattice, outside, constants = part.lattice, dict[str, float](), dict[str, float]()
    values = constants_of(part)
    if lattice.mask is not None and lattice.body is not None:
        there = np.flatnonzero(lattice.mask)
        check_any(team.any(bool(there.size)))
        for name, value in values.items():
            outside |= _middle(value.ravel()[there], {name: value.ravel()[there]}, there, lattice, team)
        values = _filled(values, lattice, outside)
    for order, of_nodes in setup.model.ordered(values):
        constants |= _middle(order.ravel(), of_nodes, np.arange(order.size), lattice, team)
    host = Host(setup.model.with_constants(constants) if values else setup.model, outside, ())
    varies = {name for every in team.gather(_unlike_one(host.varying(values))) for name in every}
    host = replace(host, even=tuple(name for name in _EVEN if name not in varies))
    return host, host.varying(values)


def constants_of(setup: Setup) -> dict[str, np.ndarray]:
    """Those of the model's constants that vary, at the nodes of the lattice or of a part of one.

    Raises
    ------
    InputError
        As `looked_at`.
    """
    lattice, values = setup.lattice, {}
    for name, value in setup.model.varying.items():
        key = f"model.{name}"
        values[name] = _on_part(as_given(value, lattice.dim, key, time=False), lattice, key)
        setup.model.check_constant(name, values[name] if lattice.mask is None else values[name][lattice.mask], key)
    return values


def node_factor(setup: Setup) -> np.ndarray | None:
    """The factor on bonds at each node; None without. InputError where it is negative.

    Beyond a rim that is held it is that of the nearest node of the body, for bonds lead there.
    """
    if setup.coefficient is None:
        return None
    lattice, own = setup.lattice, (slice(None),) * setup.lattice.dim
    held = setup.rim == "fixed" and lattice.body is not None
    if held:  # the nearest node may be one of another part
        stencil = setup.model.medium(lattice.spacing, lattice.dim)
        lattice, own = lattice.around([_to_nearest(m, lattice.dim) for m in stencil.reach])
    factor = _on_part(setup.coefficient, lattice, "coefficient")
    if (factor < 0).any():
        raise InputError(
            "a coefficient must not be negative", value=float(factor.min()), limit=">= 0", key="coefficient"
        )
    return _to_rim(factor, lattice)[own] if held else factor


def pace_in(setup: Setup, boxes: Decomposition, stencil: Stencil, variation: Variation, team: Team = ALONE) -> Pace:
    """How fast a medium is that varies in boxes of a lattice, of which each process knows its own.

    Parameters
    ----------
    setup : Setup
        Of the box of this process, with a model that is uniform.
    boxes : Decomposition
    stencil : Stencil
    variation : Variation
        In this box.
    team : Team
    """
    speeds, lattice, strongest = variation.squared_speed, setup.lattice, setup.model.strongest
    keys = [(axis, side) for axis in range(lattice.dim) for side in (-1, 1)]
    states = None if setup.model.bond_law is None else setup.model.force_states(lattice.spacing, lattice.dim)
    closing = 0.0 if states is None else closing_rate(states, _softest(variation, team))
    if speeds is None:
        return Pace(strongest, 1.0, strongest, dict.fromkeys(keys, 1.0), strongest * closing)
    strongest = team.largest(float(speeds.max()))
    if strongest == 0:
        raise InputError(
            "the coefficient is zero everywhere: there is no medium",
            value=0.0,
            limit="> 0 somewhere",
            key="coefficient",
            remedy="leave it out, or a factor that is zero in a part of the medium alone",
        )
    weakest = -team.largest(-float(speeds.min(where=speeds > 0, initial=strongest)))
    fastest = strongest
    if variation.density is not None:
        stiff = np.ones(lattice.shape) if variation.stiffness is None else variation.stiffness
        stiff, heavy = (_grown(values, boxes, stencil.reach, team) for values in (stiff, variation.density))
        fastest = team.largest(lightest_bond(stiff, heavy, stencil.offsets, setup.bond_rule))
        if closing:  # each end has a P modulus of its own
            closing *= team.largest(lightest_bond(stiff, heavy, stencil.offsets, "arithmetic"))
    else:
        closing *= strongest
    beside = {key: team.largest(_fastest_at(speeds, lattice, stencil.reach, *key)) for key in keys}
    sides = {key: found or strongest or 1.0 for key, found in beside.items()}
    return Pace(strongest, weakest, fastest, sides, closing)


def _softest(variation: Variation, team: Team) -> float:
    """The least stiffness of the springs beside states over the modulus of P waves, over that of the model."""
    if variation.springs is None or variation.stiffness is None:
        return 1.0
    return -team.largest(-float((variation.springs / variation.stiffness).min()))


def _fastest_at(speeds: np.ndarray, part: Lattice, reach: Sequence[int], axis: int, side: int) -> float:
    """The largest of the squared speeds within one reach of a side of the whole lattice; 0 where this part has none."""
    first, last = part.first[axis], part.first[axis] + part.shape[axis]
    low, high = (0, reach[axis] + 1) if side < 0 else (part.whole.shape[axis] - reach[axis] - 1, last)
    there = slice(max(low - first, 0), max(min(high, last) - first, 0))
    return float(np.moveaxis(speeds, axis, 0)[there].max(initial=0))


def _grown(values: np.ndarray, boxes: Decomposition, reach: Sequence[int], team: Team) -> np.ndarray:
    """Values with as many more beyond each edge of a box as bonds reach: those of the processes that have them, beyond
    the edges of the lattice as at them, or as across a periodic axis.
    """
    neighbours = boxes.neighbours(team.number)
    for axis, (count, m) in enumerate(zip(boxes.topology, reach, strict=True)):
        periodic = axis in boxes.periodic
        if count == 1:
            widths = [(m, m) if a == axis else (0, 0) for a in range(values.ndim)]
            values = np.pad(values, widths, mode="wrap" if periodic else "edge")
            continue
        to, of = neighbours[axis, -1], neighbours[axis, 1]
        lowest, highest = (np.take(values, range(*ends), axis) for ends in ((0, m), (-m, 0)))
        above, below = team.passed(lowest, to, of), team.passed(highest, of, to)
        edges = (np.take(values, [end] * m, axis) for end in (0, -1))
        ends = (edge if halo is None else halo for edge, halo in zip(edges, (below, above), strict=True))
        values = np.concatenate([next(ends), values, next(ends)], axis)
    return values


def _on_part(value: Any, lattice: Lattice, key: str) -> np.ndarray:
    """Values on the nodes of a part of a lattice, of which an array has those of the whole."""
    if isinstance(value, np.ndarray) and value.ndim:
        value = within_part(checked_shape(value, lattice.whole, key), lattice.whole, lattice.within)
    return field(value, lattice, 1, key)


def _unlike_one(variation: Variation) -> list[str]:
    """What of a variation is not 1 everywhere."""
    values = {name: getattr(variation, name) for name in _EVEN}
    return [name for name, value in values.items() if value is not None and not is_one(value)]


def _filled(values: dict[str, np.ndarray], lattice: Lattice, outside: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Constants with those outside a body."""
    if not outside or lattice.mask is None:
        return values
    return {name: np.where(lattice.mask, value, outside[name]) for name, value in values.items()}


def _middle(
    order: np.ndarray, values: Mapping[str, np.ndarray], nodes: np.ndarray, lattice: Lattice, team: Team
) -> dict[str, float]:
    """Values of the node that is in the middle of those of all processes; of equal ones the one in the middle of their
    numbers in the whole lattice.

    Parameters
    ----------
    order : ndarray, shape (n,)
        What they are put in order by.
    values : mapping of str to ndarray
    nodes : ndarray of int, shape (n,)
        Their flat numbers in this part of the lattice, in order.
    lattice : Lattice
    team : Team
    """
    bits = (order + 0.0).view(np.int64)  # one zero
    keys = np.where(bits < 0, ~bits.view(np.uint64), bits.view(np.uint64) | np.uint64(1 << 63))  # ordered as they are
    place = np.argsort(keys, kind="stable")
    rank = int(team.total({"nodes": len(order)})["nodes"]) // 2
    first, last, rank = _ranked(keys[place], rank, team)
    alike = place[first:last]
    at = np.unravel_index(nodes[alike], lattice.shape)
    of_whole = [one + first for one, first in zip(at, lattice.first, strict=True)]
    first, last, _ = _ranked(np.ravel_multi_index(of_whole, lattice.whole.shape).astype(np.uint64), rank, team)
    mine = {name: float(value.ravel()[alike[first]]) for name, value in values.items()} if last > first else None
    return next(found for found in team.gather(mine) if found is not None)


def _ranked(keys: np.ndarray, rank: int, team: Team) -> tuple[int, int, int]:
    """Where, among the keys (uint64, in order) of this process, those are that equal the one of a rank among all
    processes' keys, and its rank among its equals.

    Eight bits at a time: all know how many keys begin with each of 256.
    """
    first, last, start = 0, len(keys), 0
    for shift in range(56, -1, -8):
        starts = np.uint64(start) + (np.arange(256, dtype=np.uint64) << np.uint64(shift))
        ends = np.append(first + np.searchsorted(keys[first:last], starts), last)
        counts = team.summed(np.diff(ends))
        before = np.cumsum(counts) - counts
        digit = int(np.searchsorted(before, rank, side="right")) - 1
        rank -= int(before[digit])
        first, last, start = int(ends[digit]), int(ends[digit + 1]), int(starts[digit])
    return first, last, rank


def _to_nearest(reach: int, dim: int) -> int:
    """Nodes along an axis in which the nearest one of a body is, for those that bonds of the body reach."""
    return int(np.ceil(reach * np.sqrt(dim)))


def _to_rim(factor: np.ndarray, lattice: Lattice) -> np.ndarray:
    """A factor that beyond the rim of a body is that of its nearest node."""
    if lattice.mask is None or not lattice.mask.any():
        return factor
    nearest = distance_transform_edt(~lattice.mask, return_distances=False, return_indices=True)
    return np.asarray(factor[tuple(nearest)])
