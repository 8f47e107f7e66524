"""Checks of the box of a far field: what must lie inside it and what must not touch it; the medium around it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.references.infinite_lattice import Scheme
from farhorizon.errors import InputError, shown
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Box
from farhorizon.inputs.cracks import cut_ends
from farhorizon.inputs.incidence import Incident
from farhorizon.medium.shell import Shell
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.recorders.recorder import size_of_record
from farhorizon.simulation.setup.compatibility import check_lossless
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Setup, side_name
from farhorizon.simulation.time.source_terms import scheme_of

_TIMES = 33  # times at which sources that do not split into space and time are sampled
_LARGE = 2**28  # size of a history in bytes above which there is a note
LEFT = 1e-3  # share of the largest field on the shell that remains at the end above which there is a note
_FAST = 1e-6  # error by aliasing, over the largest sum, above which there is a note if it exceeds what remains
_OFF_NODE = 1e-6  # spacings: coordinates that users write with seven digits are meant to be those of nodes
_TINY = float(np.finfo(float).tiny)
_ROUNDING = float(np.finfo(float).eps)


def medium_outside(parts: RunParts) -> Scheme:
    """Return the uniform medium around a run, and its time integration; raises InputError if the medium ends at some
    side or is not linear, or the field is neither a scalar nor a vector.
    """
    near = parts.whole.near
    ends = [side_name(*key) for key, side in parts.whole.sides.items() if not side.endless]
    if ends:
        raise InputError(
            "the far field is that of a medium without end: echoes of walls, free and periodic sides are not included",
            value=", ".join(ends),
            limit="sides beyond which the medium continues",
            key="far_field",
            remedy="LatticePML there; or, where the medium does end, Receivers in a larger near field",
        )
    if near.stencil.components not in (1, near.lattice.dim):
        raise InputError(
            "the far field is that of scalars and of vectors",
            value=f"{near.stencil.components} components",
            limit=f"1 or {near.lattice.dim}",
            key="far_field",
            remedy="Receivers in a larger near field",
        )
    check_lossless(near.model, "far_field", "Receivers in a larger near field")
    law = near.model.bond_law
    if law is not None and law.nonlinear:
        raise InputError(
            "the far field is that of a linear medium",
            value="nonlinear = true",
            limit="nonlinear = false",
            key="far_field",
            remedy="linear bonds, which may break inside the box",
        )
    factor = parts.near.factor
    return scheme_of(near, 1.0 if factor is None else float(parts.at(factor, np.zeros(1, int))[0]))


def corner_nodes(lattice: Lattice, box: Box | None, reach: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and last indices of the nodes in a box, by default the widest possible one; raises InputError
    for another dimension, a side nearer than one reach, or a box without nodes one reach inside its faces.
    """
    margin, spacing = np.array(reach), lattice.spacing
    first, last = margin, np.array(lattice.shape) - 1 - margin
    limits = f"{shown(lattice.lower + spacing * first)} to {shown(lattice.lower + spacing * last)}"
    if box is not None:
        if box.dim != lattice.dim:
            raise InputError(
                "the box of a far field and the lattice differ in dimension",
                value=box.dim,
                limit=lattice.dim,
                key="far_field.box",
                remedy="a box with one entry per axis of the lattice in each corner",
            )
        lower, upper = ((bound - lattice.lower) / spacing for bound in box.bounds())
        if (lower < first - _OFF_NODE).any() or (upper > last + _OFF_NODE).any():
            raise InputError(
                "the box of a far field must leave one reach of the near field on each side",
                value=f"{shown(box.lower)} to {shown(box.upper)}",
                limit=limits,
                key="far_field.box",
                remedy="a smaller box, or a larger near field",
            )
        first, last = np.ceil(lower - _OFF_NODE).astype(int), np.floor(upper + _OFF_NODE).astype(int)
    if (last - first < 2 * margin).any():
        raise InputError(
            "the box of a far field is so small that nothing lies one reach inside its faces",
            value=f"sides of {shown(spacing * np.maximum(last - first, 0))}",
            limit=f"at least {shown(2 * spacing * margin)}",
            key="far_field.box",
            remedy="a larger box in a larger near field",
        )
    return first, last


def check_window(parts: RunParts, nodes: np.ndarray, box: Box) -> None:
    """Raise InputError if nodes (flat indices) of the shell of a box have no values, as outside a window."""
    if parts.hides(nodes).any():
        raise InputError(
            "the box of a far field reaches to the edge of the window",
            value=f"{shown(box.lower)} to {shown(box.upper)}",
            limit="inside the window by one reach",
            key="far_field.box",
            remedy="a smaller box, or a larger window",
        )


def steps_between_samples(near: NearField, frequencies: np.ndarray) -> int:
    """Return the number of steps from one sample of a spectrum to the next: the largest for which no frequency that the
    lattice carries, up to that of Verlet's method for the largest rate, is an alias of those of the spectrum.
    """
    if not frequencies.size:
        return 1
    highest = np.arcsin(min(1.0, near.dt * float(np.sqrt(near.rate_limit)) / 2)) / (np.pi * near.dt)
    return max(1, int(np.ceil(1 / (near.dt * (highest + float(frequencies.max()))))) - 1)


def check_outside(setup: Setup, parts: RunParts, box: Box, reach: np.ndarray) -> list[str]:
    """Refuse what must not lie outside a box whose corners are nodes, or too near to its faces: cracks, holes, other
    materials, conditions, metal, initial data, sources; return notes on values there that are smaller than the sides'
    targets. `reach` is that of a step along each axis.
    """
    _check_medium(setup, parts, box, reach)
    for incident in parts.incident:
        _check_incident(incident.wave, box, reach)
    values = [("initial.u", parts.start.u), ("initial.v", parts.start.v)]
    values += [("source", space) for space, _ in parts.source_terms.sources if space is not None]
    outside = ~_core(parts, box, reach)
    return [note for key, data in values for note in _missed(parts, np.abs(data), outside, key)]


def receiver_nodes(points: Any, lattice: Lattice, shell: Shell, box: Box) -> tuple[np.ndarray, list[str]]:
    """Return the indices of the nodes nearest to points, also beyond the lattice, and notes on points that are not
    nodes. Raises InputError for points in the box, or so far away that their nodes cannot be counted.
    """
    given = kinds.array(points, "far_field.points")
    if given.ndim < 2 and lattice.dim == 1:
        given = given.reshape(-1, 1)
    given = kinds.array(np.atleast_2d(given), "far_field.points", shape=(None, lattice.dim))
    place = (given - lattice.lower) / lattice.spacing
    if not len(given) or np.abs(place).max() > kinds.MOST_WHOLE:
        raise InputError(
            "receivers are one or more points at distances that can be computed",
            value=given,
            limit=f"{kinds.MOST_WHOLE} nodes away",
            key="far_field.points",
            remedy="the pattern, for what is so far away",
        )
    nodes = np.round(place).astype(int)
    inside = shell.contains(nodes)
    if inside.any():
        raise InputError(
            "a receiver of the far field lies inside the box",
            value=given[int(np.argmax(inside))],
            limit=f"outside {shown(box.lower)} to {shown(box.upper)}",
            key="far_field.points",
            remedy="Receivers there, or a smaller box",
        )
    apart = np.abs(place - nodes).max(1) > _OFF_NODE
    places = lattice.lower + lattice.spacing * nodes
    return nodes, [
        f"the far field at {shown(point)} is that of the nearest node, {shown(node)}"
        for point, node in zip(given[apart].tolist(), places[apart].round(12).tolist(), strict=True)
    ]


def check_moving(parts: RunParts, box: Box, reach: np.ndarray, until: float) -> list[str]:
    """Check sources that do not split into space and time as `check_outside` does, at equidistant times of a run."""
    outside, notes = ~_core(parts, box, reach), []
    for space, source in parts.source_terms.sources:
        if space is None:
            values = [np.broadcast_to(np.abs(source(t)), parts.near.field_shape) for t in np.linspace(0, until, _TIMES)]
            notes += _missed(parts, np.max(values, axis=0), outside, "source")
    return notes


def check_kept(history: bool, remedy: str) -> None:
    """Raise InputError unless the history of the shell is kept."""
    if not history:
        raise InputError(
            "receivers of the far field need the values on the shell at all steps",
            value="history = false",
            limit="history = true",
            key="far_field.history",
            remedy=remedy,
        )


def check_history(need: int, nodes: int, steps: int) -> list[str]:
    """Return notes on a history of `need` bytes; raises InputError if it does not fit into memory."""
    remedy = "a smaller box, a shorter run, or history = false with frequencies"
    size = size_of_record(need, nodes, steps, "far_field.history", remedy)
    return [f"the far field keeps the history of its shell: {size}"] if need > _LARGE else []


def spectral_notes(last: float, largest: float, missed: float) -> list[str]:
    """Return why the spectra of a far field may be doubtful: the field that remains on the shell at the end, or the
    aliasing error of the samples.
    """
    if last > LEFT * largest:
        return [
            "spectra of the far field leave out what has not left the box by the end of the run: on its shell "
            f"{last / largest:.2g} of the largest value remains"
        ]
    if missed > max(_FAST, last / max(largest, _TINY)):
        return [
            "spectra of the far field mistake something on the box that is faster than all waves of the lattice for "
            f"something slower, some {missed:.2g} of the largest: sources that are smooth in time, or farther from "
            "the faces of the box, emit less of it"
        ]
    return []


def is_around(box: Box, wave: Incident) -> bool:
    """Whether a box lies around that of an incident wave, and not inside it."""
    assert wave.within is not None
    return bool((box.lower <= wave.within.lower).all())


def _inner(lattice: Lattice, box: Box, margin: np.ndarray) -> np.ndarray:
    """Return the nodes of the lattice inside a box that is shrunk by some lengths on each side, as a mask."""
    inside = np.ones(lattice.shape, bool)
    for inside_along in np.meshgrid(*_between(lattice, box, margin), indexing="ij", sparse=True):
        inside = inside & inside_along
    return inside


def _between(lattice: Lattice, box: Box, margin: np.ndarray) -> list[np.ndarray]:
    """Return the nodes along each axis that lie inside the box shrunk likewise, as masks."""
    slack = _OFF_NODE * lattice.spacing
    bounds = zip(lattice.axes, box.lower + margin - slack, box.upper - margin + slack, strict=True)
    return [(axis > low) & (axis < high) for axis, low, high in bounds]


def _less(parts: RunParts, reach: np.ndarray) -> np.ndarray:
    """Return the distance between the box and its core: by how much a step of several stages reaches farther than the
    stencil.
    """
    return np.asarray(reach - parts.near.lattice.spacing * np.array(parts.near.stencil.reach))


def _core(parts: RunParts, box: Box, reach: np.ndarray) -> np.ndarray:
    """Return the nodes of the core of the box in this part of the lattice, as a mask."""
    return _inner(parts.near.lattice, box, _less(parts, reach))


def _check_medium(setup: Setup, parts: RunParts, box: Box, reach: np.ndarray) -> None:
    """Refuse cracks, holes, other materials, conditions and metal that affect bonds through a face or outside."""
    near, lattice, whole_lattice = parts.near, parts.near.lattice, parts.whole.near.lattice
    limit = f"{shown(box.lower + reach)} to {shown(box.upper - reach)}"
    core, well_inside = _core(parts, box, reach), _inner(lattice, box, reach)
    inside_along = _between(whole_lattice, box, _less(parts, reach))
    for crack in setup.cracks:
        end_nodes = cut_ends(crack.cut, whole_lattice, near.stencil.offsets)
        in_lattice = ((end_nodes >= 0) & (end_nodes < whole_lattice.shape)).all(1)
        if not (
            in_lattice.all()
            and all(inside[index].all() for inside, index in zip(inside_along, end_nodes.T, strict=True))
        ):
            raise InputError(
                "the box of a far field cuts a crack, or lies within one reach of it",
                value=[np.asarray(bound).tolist() for bound in crack.cut.bounds()],
                limit=limit,
                key="far_field.box",
                remedy="a larger box, or a shorter crack",
            )
    material = near.material
    corner = parts.whole.team.first(material.flat[0])
    for mask, message in (
        (~well_inside & ~(material == corner), "cuts a hole, the rim of a body or another material"),
        (~core & near.conditioned, "leaves out nodes that a condition holds"),
        (~well_inside & parts.start.solid, "cuts metal"),
    ):
        if mask.any():
            raise InputError(
                f"the box of a far field {message}",
                value=f"at {shown(_place(lattice, mask))}",
                limit=limit,
                key="far_field.box",
                remedy="a larger box, or a larger near field",
            )


def _place(lattice: Lattice, where: np.ndarray) -> np.ndarray:
    """Return the coordinates of the first node of a mask."""
    return np.asarray(lattice.lower + lattice.spacing * np.argwhere(where)[0])


def _missed(parts: RunParts, sizes: np.ndarray, outside: np.ndarray, key: str) -> list[str]:
    """Raise InputError if values outside the box exceed the sides' target; return a note on smaller ones."""
    beyond = sizes.reshape(-1, *outside.shape).max(0)
    own_missed, team, model = float(beyond[outside].max(initial=0)), parts.whole.team, parts.near.model
    peak, missed = team.largest(float(beyond.max(initial=0))), team.largest(own_missed)
    target = min(side.wanted(model.target) for side in parts.whole.sides.values())
    if own_missed > target * peak:
        raise InputError(
            "not zero outside the box of a far field, which would miss it",
            value=f"{own_missed:.3g} at {shown(_place(parts.near.lattice, outside & (beyond == own_missed)))}",
            limit=f"{target * peak:.3g} ({target:g} of the largest)",
            key=key,
            remedy="a larger box, or narrower data",
        )
    faint = missed <= _ROUNDING * peak
    return [] if faint else [f"{key}: {missed / peak:.2g} of the largest value lies outside the box of the far field"]


def _check_incident(wave: Incident, box: Box, reach: np.ndarray) -> None:
    """Refuse a box that holds some, but not all, of the nodes at which an incident wave joins the scattered field."""
    assert wave.within is not None
    slack, low, high = _OFF_NODE * reach, wave.within.lower, wave.within.upper
    is_around_wave = (box.lower <= low - reach + slack) & (box.upper >= high + reach - slack)
    is_inside_wave = (box.lower >= low + 2 * reach - slack) & (box.upper <= high - 2 * reach + slack)
    if not (is_around_wave.all() or is_inside_wave.all()):
        raise InputError(
            "the box of a far field meets the box of an incident wave",
            value=f"{shown(box.lower)} to {shown(box.upper)}",
            limit=f"around {shown(low - reach)} to {shown(high + reach)}, or inside {shown(low + 2 * reach)} to "
            f"{shown(high - 2 * reach)}",
            key="far_field.box",
            remedy="leave it out: the widest box serves",
        )
