"""Media that vary: the uniform host medium relative to which they do, and quantities that depend on the whole medium.

In a run on several processes, each evaluates a box of the lattice, and they exchange their results.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
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
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.setup.setup import Setup, within_part

_EVEN = ("stiffness", "density")  # parts of a variation that may turn out to be 1 everywhere


@dataclass(frozen=True, eq=False)
class ReferenceMedium:
    """The uniform medium relative to which a medium varies.

    Attributes
    ----------
    model : LatticeModel
    outside : dict of str to float
        Constants outside a body, where none are given.
    even : tuple of str
        Names of those parts of `Variation` that do not vary after all.
    """

    model: LatticeModel
    outside: Mapping[str, float]
    even: tuple[str, ...]

    def uniform(self, setup: Setup) -> Setup:
        """Return a set-up with this medium everywhere."""
        return replace(setup, model=self.model, rule=setup.bond_rule) if setup.model.varying else setup

    def variation_of(self, setup: Setup) -> Variation:
        """Return the variation of the medium of a set-up, or of a part of it, relative to this one; raises InputError
        as `reference_and_variation` does.
        """
        return self.varying(_filled(constants_of(setup), setup.lattice, self.outside))

    def varying(self, values: Mapping[str, np.ndarray]) -> Variation:
        """Return the variation from constants at all nodes, including those outside a body."""
        return self.model.beside(values).without(self.even) if values else Variation()


class Contrast(NamedTuple):
    """Squared speeds and frequencies of a varying medium over those of the uniform host medium.

    Attributes
    ----------
    strongest, weakest : float
        Largest squared speed of waves, and the smallest one where there are bonds; if no density varies, factors on
        bonds.
    fastest : float
        Upper bound of the factor on squared frequencies.
    sides : dict of (axis, side) to float
        Largest squared speed within one reach of each side: a layer is made for the fastest waves that it meets.
    closing : float
        Largest contribution of closing bonds to the largest value of the symbol, for materials with states.
    lame : float or None
        Largest ratio of Lame's constant to the P modulus at the sides with layers; None where it does not vary.
    """

    strongest: float
    weakest: float
    fastest: float
    sides: dict[Key, float]
    closing: float
    lame: float | None = None


def varied(setup: Setup) -> tuple[Setup, Variation]:
    """Return a set-up with a uniform model, and the variation relative to it; raises InputError as
    `reference_and_variation` does.
    """
    reference_medium, variation = reference_and_variation(setup, ALONE)
    return reference_medium.uniform(setup), variation


def reference_and_variation(setup: Setup, team: ProcessGroup) -> tuple[ReferenceMedium, Variation]:
    """Return the host medium of a set-up, and the variation relative to it in the box of the lattice that this process
    evaluates.

    Raises
    ------
    InputError
        Constants that are not positive, or of the wrong shape; a reaction without a definite strength.
    """
    boxes = decompose(setup.lattice.shape, team.size, (1,) * setup.lattice.dim, {}, frozenset())
    part = replace(setup, lattice=setup.lattice.part(boxes.ranges(team.number))) if team else setup
    lattice, outside, constants = part.lattice, dict[str, float](), dict[str, float]()
    values = constants_of(part)
    if lattice.existing is not None:
        there = np.flatnonzero(lattice.existing)
        check_any(team.any(bool(there.size)))
        for name, value in values.items():
            outside |= _middle(value.ravel()[there], {name: value.ravel()[there]}, there, lattice, team)
        values = _filled(values, lattice, outside)
    for order, of_nodes in setup.model.ordered(values):
        constants |= _middle(order.ravel(), of_nodes, np.arange(order.size), lattice, team)
    reference_medium = ReferenceMedium(setup.model.with_constants(constants) if values else setup.model, outside, ())
    varies = {name for every in team.gather(_unlike_one(reference_medium.varying(values))) for name in every}
    reference_medium = replace(reference_medium, even=tuple(name for name in _EVEN if name not in varies))
    _check_reaction(reference_medium.model, lattice, varies)
    return reference_medium, reference_medium.varying(values)


def _check_reaction(model: LatticeModel, lattice: Lattice, varies: Collection[str]) -> None:
    """Refuse a reaction where its strength at a node would depend on which medium is in the middle of all: that of a
    stencil, in units of its bonds, where they vary; any, per mass, where the density does.
    """
    if not varies:
        return
    of_bonds = bool(np.any(model.stencil(lattice.spacing, lattice.dim).reaction))
    if of_bonds or ("density" in varies and model.medium(lattice.spacing, lattice.dim).strongest_reaction):
        raise InputError(
            "a reaction has no definite strength in a medium that varies",
            value="varying " + " and ".join(sorted(varies)),
            limit="one density, and for the reaction of a stencil one stiffness",
            key="model",
            remedy="bonds of unequal strength by a `coefficient`, which does not apply to the reaction",
        )


def constants_of(setup: Setup) -> dict[str, np.ndarray]:
    """Return those of the model's constants that vary, at the nodes of a lattice or of a part of it.

    Raises
    ------
    InputError
        As in `reference_and_variation`.
    """
    lattice, values = setup.lattice, {}
    for name, value in setup.model.varying.items():
        key = f"model.{name}"
        values[name] = _on_part(as_given(value, lattice.dim, key, time=False), lattice, key)
        setup.model.check_constant(name, values[name] if lattice.mask is None else values[name][lattice.mask], key)
    return values


def node_factor(setup: Setup) -> np.ndarray | None:
    """Return the given factor on bonds at each node; None if none is given. Raises InputError if it is negative.

    Beyond a fixed rim it is that of the nearest node of the body, because bonds lead there.
    """
    if setup.coefficient is None:
        return None
    lattice, own = setup.lattice, (slice(None),) * setup.lattice.dim
    held = setup.rim == "fixed" and lattice.body is not None
    if held:  # the nearest node may belong to another part
        stencil = setup.model.medium(lattice.spacing, lattice.dim)
        lattice, own = lattice.around([_to_nearest(m, lattice.dim) for m in stencil.reach])
    factor = _on_part(setup.coefficient, lattice, "coefficient")
    if (factor < 0).any():
        raise InputError(
            "a coefficient must not be negative", value=float(factor.min()), limit=">= 0", key="coefficient"
        )
    return _to_rim(factor, lattice)[own] if held else factor


def contrast_in(
    setup: Setup, boxes: Decomposition, stencil: Stencil, variation: Variation, team: ProcessGroup = ALONE
) -> Contrast:
    """Return the pace of a medium that varies in boxes of a lattice, of which each process has its own.

    Parameters
    ----------
    setup : Setup
        Set-up of the box of this process, with a uniform model.
    boxes : Decomposition
    stencil : Stencil
    variation : Variation
        Variation in this box.
    team : ProcessGroup
    """
    speeds, lattice, strongest = variation.squared_speed, setup.lattice, setup.model.strongest
    keys = [(axis, side) for axis in range(lattice.dim) for side in (-1, 1)]
    states = None if setup.model.bond_law is None else setup.model.force_states(lattice.spacing, lattice.dim)
    closing = 0.0 if states is None else closing_rate(states, _softest(variation, team))
    if speeds is None:
        return Contrast(strongest, 1.0, strongest, dict.fromkeys(keys, 1.0), strongest * closing)
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
        if closing:  # the two ends may differ in their P-wave moduli
            closing *= team.largest(lightest_bond(stiff, heavy, stencil.offsets, "arithmetic"))
    else:
        closing *= strongest
    beside = {key: team.largest(_largest_at(speeds, lattice, stencil.reach, *key)) for key in keys}
    sides = {key: found or strongest or 1.0 for key, found in beside.items()}
    fastest *= setup.model.strongest
    return Contrast(
        strongest, weakest, fastest, sides, closing, _lame_beside_layers(setup, variation, stencil.reach, team)
    )


def _lame_beside_layers(setup: Setup, variation: Variation, reach: Sequence[int], team: ProcessGroup) -> float | None:
    """Return the largest ratio of Lame's constant to the P modulus within one reach of the sides with layers: the
    nearer a solid is to a fluid, the longer and stronger are its backward waves, which its layers must damp.
    """
    if variation.lame is None:
        return None
    ratio = variation.lame[0] / (variation.lame[0] + 2 * variation.lame[1])
    layered = [key for key, side in setup.sides.items() if side.stretched or side.undecided]
    beside = [team.largest(_largest_at(ratio, setup.lattice, reach, *key, initial=-1.0)) for key in layered]
    return max(beside, default=None)


def _softest(variation: Variation, team: ProcessGroup) -> float:
    """Return the smallest ratio of the springs beside the states to the P-wave modulus, over that of the model."""
    if variation.springs is None or variation.stiffness is None:
        return 1.0
    return -team.largest(-float((variation.springs / variation.stiffness).min()))


def _largest_at(
    values: np.ndarray, part: Lattice, reach: Sequence[int], axis: int, side: int, initial: float = 0.0
) -> float:
    """Return the largest value within one reach of a side of the whole lattice, but at least `initial`."""
    first, last = part.first[axis], part.first[axis] + part.shape[axis]
    low, high = (0, reach[axis] + 1) if side < 0 else (part.whole.shape[axis] - reach[axis] - 1, last)
    there = slice(max(low - first, 0), max(min(high, last) - first, 0))
    return float(np.moveaxis(values, axis, 0)[there].max(initial=initial))


def _grown(values: np.ndarray, boxes: Decomposition, reach: Sequence[int], team: ProcessGroup) -> np.ndarray:
    """Extend values by one reach beyond each edge of a box: by those of other processes; beyond the edges of the
    lattice by the values there, or periodically.
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
        above, below = team.send_receive(lowest, to, of), team.send_receive(highest, of, to)
        edges = (np.take(values, [end] * m, axis) for end in (0, -1))
        ends = (edge if halo is None else halo for edge, halo in zip(edges, (below, above), strict=True))
        values = np.concatenate([next(ends), values, next(ends)], axis)
    return values


def _on_part(value: Any, lattice: Lattice, key: str) -> np.ndarray:
    """Return the values at the nodes of a part of a lattice; an array holds those of the whole lattice."""
    if isinstance(value, np.ndarray) and value.ndim:
        value = within_part(checked_shape(value, lattice.whole, key), lattice.whole, lattice.within)
    return field(value, lattice, 1, key)


def _unlike_one(variation: Variation) -> list[str]:
    """Return the names of those parts of a variation that are not 1 everywhere."""
    values = {name: getattr(variation, name) for name in _EVEN}
    return [name for name, value in values.items() if value is not None and not is_one(value)]


def _filled(values: dict[str, np.ndarray], lattice: Lattice, outside: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Return constants with those outside a body filled in."""
    if not outside or lattice.existing is None:
        return values
    return {name: np.where(lattice.existing, value, outside[name]) for name, value in values.items()}


def _middle(
    order: np.ndarray, values: Mapping[str, np.ndarray], nodes: np.ndarray, lattice: Lattice, team: ProcessGroup
) -> dict[str, float]:
    """Return the values of the median node of all processes; of several with the same key, of the one whose index in
    the whole lattice is in the middle of theirs.

    Parameters
    ----------
    order : ndarray, shape (n,)
        Keys by which nodes are ordered.
    values : mapping of str to ndarray
    nodes : ndarray of int, shape (n,)
        Flat indices of the nodes in this part of the lattice, in order.
    lattice : Lattice
    team : ProcessGroup
    """
    bits = (order + 0.0).view(np.int64)  # adding zero turns -0.0 into 0.0
    keys = np.where(bits < 0, ~bits.view(np.uint64), bits.view(np.uint64) | np.uint64(1 << 63))  # in the same order
    place = np.argsort(keys, kind="stable")
    rank = int(team.total({"nodes": len(order)})["nodes"]) // 2
    first, last, rank = _ranked(keys[place], rank, team)
    alike = place[first:last]
    at = np.unravel_index(nodes[alike], lattice.shape)
    of_whole = [one + first for one, first in zip(at, lattice.first, strict=True)]
    first, last, _ = _ranked(np.ravel_multi_index(of_whole, lattice.whole.shape).astype(np.uint64), rank, team)
    mine = {name: float(value.ravel()[alike[first]]) for name, value in values.items()} if last > first else None
    return next(found for found in team.gather(mine) if found is not None)


def _ranked(keys: np.ndarray, rank: int, team: ProcessGroup) -> tuple[int, int, int]:
    """Find the key of a given rank among the keys of all processes; `keys` (uint64, in order) are those of this one.
    Returns the first and end index of the keys here that equal it, and its rank among all equal ones.

    Radix selection, eight bits at a time: the processes exchange how many keys begin with each of 256 values.
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
    """Return the number of nodes along an axis within which the nearest node of a body lies, for nodes that its bonds
    reach.
    """
    return int(np.ceil(reach * np.sqrt(dim)))


def _to_rim(factor: np.ndarray, lattice: Lattice) -> np.ndarray:
    """Return a factor that, outside a body, is that of its nearest node."""
    if lattice.existing is None or not lattice.existing.any():
        return factor
    nearest = distance_transform_edt(~lattice.existing, return_distances=False, return_indices=True)
    return np.asarray(factor[tuple(nearest)])
