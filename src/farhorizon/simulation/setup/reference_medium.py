"""Media that vary: the uniform reference medium, that of the node whose speed is the median, their contrast to it, and
what else depends on the whole medium; several processes evaluate a box of the lattice each.

Where most nodes belong to one medium, it is the reference, whatever is stiffer or softer: incident waves, shells and
far fields live in it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.geometry.decomposition import Decomposition, Key, decompose
from farhorizon.geometry.lattice import Lattice, check_any
from farhorizon.inputs.expressions import as_given
from farhorizon.inputs.sources import checked_shape, field
from farhorizon.machine import check_fits
from farhorizon.medium.force_states import closing_rate
from farhorizon.medium.stencil import Stencil
from farhorizon.medium.variation import Variation, is_one, lightest_bond
from farhorizon.models import LatticeModel
from farhorizon.simulation.processes.process_group import ALONE, ProcessGroup
from farhorizon.simulation.setup.setup import Setup, within_part

_EVEN = ("stiffness", "density")  # parts of a variation that may turn out to be 1 everywhere
# values per node that evaluating constants takes at its peak, as `tracemalloc` counts: where forces are those of bonds,
# and with the moduli of force states
_VALUES_OF_BONDS, _VALUES = 11, 22


@dataclass(frozen=True, eq=False)
class ReferenceMedium:
    """The uniform medium relative to which a medium varies."""

    model: LatticeModel
    outside: Mapping[str, float]  # constants outside a body, where none are given
    even: tuple[str, ...]  # names of those parts of `Variation` that do not vary after all

    def uniform(self, setup: Setup) -> Setup:
        """Return a set-up with this medium everywhere."""
        return replace(setup, model=self.model, rule=setup.bond_rule) if setup.model.varying else setup

    def variation_of(self, setup: Setup) -> Variation:
        """Return the variation of the medium of a set-up, or of a part of it, relative to this one."""
        return self.varying(_filled(constants_of(setup), setup.lattice, self.outside))

    def varying(self, values: Mapping[str, np.ndarray]) -> Variation:
        """Return the variation from constants at all nodes, including those outside a body."""
        return self.model.beside(values).without(self.even) if values else Variation()


class Contrast(NamedTuple):
    """Squared speeds and frequencies of a varying medium over those of the reference medium."""

    strongest: float  # largest squared speed of waves; if no density varies, largest factor on bonds
    weakest: float  # the smallest one where there are bonds
    fastest: float  # upper bound of the factor on squared frequencies
    sides: dict[Key, float]  # largest squared speed within one reach of each side: a layer is made for it
    closing: float  # largest contribution of closing bonds to the largest value of the symbol, with force states
    lame: float | None = None  # largest Lame's constant / P modulus at sides with layers; None if it does not vary


def varied(setup: Setup) -> tuple[Setup, Variation]:
    """Return a set-up with a uniform model, and the variation relative to it."""
    reference_medium, variation = reference_and_variation(setup, ALONE)
    return reference_medium.uniform(setup), variation


def reference_and_variation(setup: Setup, group: ProcessGroup) -> tuple[ReferenceMedium, Variation]:
    """Return the reference medium of a set-up, and the variation relative to it in the box of the lattice that this
    process evaluates.
    """
    boxes = decompose(setup.lattice.shape, group.size, (1,) * setup.lattice.dim, {}, frozenset())
    subdomain = replace(setup, lattice=setup.lattice.part(boxes.ranges(group.number))) if group else setup
    lattice, outside, constants = subdomain.lattice, dict[str, float](), dict[str, float]()
    if setup.model.varying:
        need = 8.0 * lattice.nodes * (_VALUES_OF_BONDS if setup.model.bonds else _VALUES)
        check_fits(need, f"constants at {lattice.nodes} nodes do", "lattice", "a coarser or smaller lattice")
    values = constants_of(subdomain)
    if lattice.existing is not None:
        nodes = np.flatnonzero(lattice.existing)
        check_any(group.any(bool(nodes.size)))
        for name, value in values.items():
            outside |= _median(value.ravel()[nodes], {name: value.ravel()[nodes]}, nodes, lattice, group)
        values = _filled(values, lattice, outside)
    for order, of_nodes in setup.model.ordered(values):
        constants |= _median(order.ravel(), of_nodes, np.arange(order.size), lattice, group)
    reference_medium = ReferenceMedium(setup.model.with_constants(constants) if values else setup.model, outside, ())
    varies = {name for names in group.gather(_unlike_one(reference_medium.varying(values))) for name in names}
    reference_medium = replace(reference_medium, even=tuple(name for name in _EVEN if name not in varies))
    _check_reaction(reference_medium.model, lattice, varies)
    return reference_medium, reference_medium.varying(values)


def _check_reaction(model: LatticeModel, lattice: Lattice, varies: Collection[str]) -> None:
    """Refuse a reaction where its strength at a node would depend on which medium is the reference: that of a stencil,
    in units of its bonds, where they vary; any, per mass, where the density does.
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
    """Return those of the model's constants that vary, at the nodes of a lattice or of a part of it; raises InputError
    if they are not positive, or of the wrong shape.
    """
    lattice, values = setup.lattice, {}
    for name, value in setup.model.varying.items():
        key = f"model.{name}"
        values[name] = _on_part(as_given(value, lattice.dim, key, time=False), lattice, key)
        setup.model.check_constant(name, values[name] if lattice.mask is None else values[name][lattice.mask], key)
    return values


def node_factor(setup: Setup) -> np.ndarray | None:
    """Return the given factor on bonds at each node, beyond a fixed rim that of the nearest node of the body; None if
    none is given. Raises InputError if it is negative.
    """
    if setup.coefficient is None:
        return None
    lattice, inside = setup.lattice, (slice(None),) * setup.lattice.dim
    held = setup.rim == "fixed" and lattice.body is not None
    if held:  # the nearest node may belong to another part
        stencil = setup.model.medium(lattice.spacing, lattice.dim)
        lattice, inside = lattice.around([_to_nearest(m, lattice.dim) for m in stencil.reach])
    factor = _on_part(setup.coefficient, lattice, "coefficient")
    if (factor < 0).any():
        raise InputError(
            "a coefficient must not be negative", value=float(factor.min()), limit=">= 0", key="coefficient"
        )
    return _to_rim(factor, lattice)[inside] if held else factor


def contrast_in(
    setup: Setup, boxes: Decomposition, stencil: Stencil, variation: Variation, group: ProcessGroup = ALONE
) -> Contrast:
    """Return the contrast of a medium that varies, of which each process has a box: its set-up, with a uniform model,
    and the variation there.
    """
    speeds, lattice, strongest = variation.squared_speed, setup.lattice, setup.model.strongest
    keys = [(axis, side) for axis in range(lattice.dim) for side in (-1, 1)]
    states = None if setup.model.bond_law is None else setup.model.force_states(lattice.spacing, lattice.dim)
    closing = 0.0 if states is None else closing_rate(states, _softest(variation, group))
    if speeds is None:
        return Contrast(strongest, 1.0, strongest, dict.fromkeys(keys, 1.0), strongest * closing)
    strongest = group.largest(float(speeds.max()))
    if strongest == 0:
        raise InputError(
            "the coefficient is zero everywhere: there is no medium",
            value=0.0,
            limit="> 0 somewhere",
            key="coefficient",
            remedy="leave it out, or a factor that is zero in a part of the medium alone",
        )
    if setup.coefficient is not None:
        kinds.check_magnitude(strongest, "coefficient")
    weakest = min(group.gather(float(speeds.min(where=speeds > 0, initial=strongest))))
    fastest = strongest
    if variation.density is not None:
        stiff = np.ones(lattice.shape) if variation.stiffness is None else variation.stiffness
        stiff, heavy = (_widened(values, boxes, stencil.reach, group) for values in (stiff, variation.density))
        fastest = group.largest(lightest_bond(stiff, heavy, stencil.offsets, setup.bond_rule))
        if closing:  # the two ends may differ in their P-wave moduli
            closing *= group.largest(lightest_bond(stiff, heavy, stencil.offsets, "arithmetic"))
    else:
        closing *= strongest
    at_sides = {key: group.largest(_largest_at(speeds, lattice, stencil.reach, *key)) for key in keys}
    sides = {key: speed or strongest or 1.0 for key, speed in at_sides.items()}
    fastest *= setup.model.strongest
    return Contrast(
        strongest, weakest, fastest, sides, closing, _lame_beside_layers(setup, variation, stencil.reach, group)
    )


def _lame_beside_layers(setup: Setup, variation: Variation, reach: Sequence[int], group: ProcessGroup) -> float | None:
    """Return the largest ratio of Lame's constant to the P modulus within one reach of the sides with layers: the
    nearer a solid is to a fluid, the longer and stronger are its backward waves, which its layers must damp.
    """
    if variation.lame is None:
        return None
    ratio = variation.lame[0] / (variation.lame[0] + 2 * variation.lame[1])
    layered = [key for key, side in setup.sides.items() if side.as_layer(None, setup.model.target).stretched]
    ratios = [group.largest(_largest_at(ratio, setup.lattice, reach, *key, initial=-1.0)) for key in layered]
    return max(ratios, default=None)


def _softest(variation: Variation, group: ProcessGroup) -> float:
    """Return the smallest ratio of the springs beside the states to the P-wave modulus, over that of the model."""
    if variation.springs is None or variation.stiffness is None:
        return 1.0
    return min(group.gather(float((variation.springs / variation.stiffness).min())))


def _largest_at(
    values: np.ndarray, subdomain: Lattice, reach: Sequence[int], axis: int, side: int, initial: float = 0.0
) -> float:
    """Return the largest value within one reach of a side of the whole lattice, but at least `initial`."""
    first, last = subdomain.first[axis], subdomain.first[axis] + subdomain.shape[axis]
    low, high = (0, reach[axis] + 1) if side < 0 else (subdomain.whole.shape[axis] - reach[axis] - 1, last)
    strip = slice(max(low - first, 0), max(min(high, last) - first, 0))
    return float(np.moveaxis(values, axis, 0)[strip].max(initial=initial))


def _widened(values: np.ndarray, boxes: Decomposition, reach: Sequence[int], group: ProcessGroup) -> np.ndarray:
    """Extend values by one reach beyond each edge of a box: by those of other processes; beyond the edges of the
    lattice by the values there, or periodically.
    """
    neighbours = boxes.neighbours(group.number)
    for axis, m in enumerate(reach):
        halos = group.halos(values, axis, m, *(neighbours.get((axis, side), -1) for side in (-1, 1)))
        low, high = (
            np.take(values, [end] * m, axis) if halo is None else halo for end, halo in zip((0, -1), halos, strict=True)
        )
        values = np.concatenate([low, values, high], axis)
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


def _median(
    order: np.ndarray, values: Mapping[str, np.ndarray], nodes: np.ndarray, lattice: Lattice, group: ProcessGroup
) -> dict[str, float]:
    """Return the values of the median node of all processes by `order`; of several with the same key, of the one whose
    index in the whole lattice is in the middle of theirs. `nodes` are the flat indices of the nodes in this part of the
    lattice, in order; all arrays have shape (n,).
    """
    bits = (order + 0.0).view(np.int64)  # adding zero turns -0.0 into 0.0
    keys = np.where(bits < 0, ~bits.view(np.uint64), bits.view(np.uint64) | np.uint64(1 << 63))  # in the same order
    place = np.argsort(keys, kind="stable")
    rank = sum(group.gather(len(order))) // 2
    first, last, rank = _ranked(keys[place], rank, group)
    alike = place[first:last]
    at = np.unravel_index(nodes[alike], lattice.shape)
    of_whole = [index + start for index, start in zip(at, lattice.first, strict=True)]
    first, last, _ = _ranked(np.ravel_multi_index(of_whole, lattice.whole.shape).astype(np.uint64), rank, group)
    own = {name: float(value.ravel()[alike[first]]) for name, value in values.items()} if last > first else None
    return next(median for median in group.gather(own) if median is not None)


def _ranked(keys: np.ndarray, rank: int, group: ProcessGroup) -> tuple[int, int, int]:
    """Find the key of a given rank among the keys of all processes; `keys` (uint64, in order) are those of this one.
    Returns the first and end index of the keys here that equal it, and its rank among all equal ones.

    Radix selection, eight bits at a time: the processes exchange how many keys begin with each of 256 values.
    """
    first, last, start = 0, len(keys), 0
    for shift in range(56, -1, -8):
        starts = np.uint64(start) + (np.arange(256, dtype=np.uint64) << np.uint64(shift))
        ends = np.append(first + np.searchsorted(keys[first:last], starts), last)
        counts = group.summed(np.diff(ends))
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
