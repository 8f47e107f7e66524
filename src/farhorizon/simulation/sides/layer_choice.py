"""The choice of layers for a run: of their family and their number of nodes, by trial runs of the set-up, of a smaller
copy where it is large, or of what reflects alike; and the assessment of layers that are given.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from farhorizon.analysis.layers import families, short_waves, thickness
from farhorizon.analysis.layers.thickness import Candidate, NotKept, Thickness
from farhorizon.boundaries import Side
from farhorizon.errors import InputError
from farhorizon.files.cache import cache_folder, keep, kept
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.conditions import Temperature
from farhorizon.models import Diffusion
from farhorizon.rounding import TINY
from farhorizon.simulation.setup.digests import digest_of
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, side_name
from farhorizon.simulation.sides import trials as trial_runs
from farhorizon.simulation.sides.trials import CROSSINGS, SECONDS, SHORTEST, TrialRuns

LASTING = 10  # length of a run of diffusion if it is not known, in R^2/diffusivity
# rounding error in single precision relative to the largest value at the same time: of diffusion, which decays, and of
# waves
_ROUNDED = 1e-4, 2e-6
_BESIDE = 0.03  # part of the target that data may have at the sides of a smaller copy
_ALONG = 0.25  # cosine of the angle to the normal of a side, below which waves run almost along it
_ENOUGH = 8  # trials for which a smaller copy leaves time: three references, and candidates
_MEASURE = "'farhorizon compare' measures it"

_PROGRAM = (
    b"".join(Path(str(module.__file__)).read_bytes() for module in (thickness, families, short_waves, trial_runs))
    + Path(__file__).read_bytes()
)


class Chosen(NamedTuple):
    """Layers by side that were chosen or assessed, with their errors, warnings of missed targets, and notes."""

    sides: dict[Key, Side]
    thickness: dict[str, Thickness]
    doubts: list[str]
    notes: list[str]


def default_length(near: NearField) -> float:
    """Return the length of run for which layers are chosen if it is not known."""
    return (CROSSINGS if near.model.order == 2 else LASTING) * near.crossing


def _in_place_of(run: Any) -> tuple[list[Any], str]:
    """Return the runs that are tried in place of a run, and what to say of them.

    Fronts of a corrosion, which move from node to node, would hide the differences between layers: the metal is held at
    one concentration, as long as it lasts, and is initial data, when it is dissolved. Where bonds break, small
    differences grow, which no layer causes: the linear medium is tried. Other runs are tried as they are.
    """
    model, same = run.model, {"boundary": run.parts.layered.as_given(), "dt": run.dt}
    with suppress(InputError):
        if run.parts.phases is not None:
            solid = run.fields["solid"] > 0
            held = (*run.setup.constraints, Temperature(solid, run.background + 1.0))
            same |= {
                "model": Diffusion(model.operator, model.diffusivity, integrator=model.integrator),
                "specimens": (),
            }
            dissolved = run.remade(initial={"u": run.background + solid}, **same)
            return [run.remade(constraints=held, **same), dissolved], ""
        if run.parts.breaking is not None and not model.warm:
            return [run.remade(model=model.linearised, **same)], "trial runs of the layers are those of linear bonds"
    return [run], ""


def _smaller(trials: TrialRuns) -> TrialRuns | None:
    """Return trials on a smaller copy of the near field. None where anything but initial data in a uniform medium
    drives the run, or where nothing is gained.

    Data in the middle reach the sides of a copy, which are nearer to them in proportion, under the same angles, so that
    it serves for as many crossings. Beside a long side near to the data waves run almost along it, and how much of them
    a layer reflects depends on the distance itself and on the length of the side: the copy is a strip along it.
    """
    run, near = trials.run, trials.near
    given = run.setup
    other = (given.sources, given.loads, given.cracks, given.constraints, given.specimens)
    if any(other) or near.varies or near.lattice.mask is not None or run.team or run.of_field:
        return None
    shape, busy = np.array(near.lattice.shape), np.zeros(near.lattice.shape, bool)
    for values in (run.start_u, run.start_v):
        size = near.size(np.abs(values))
        busy |= size > _BESIDE * trials.wanted * max(float(size.max()), TINY)
    if not busy.any():
        return None
    held = [np.flatnonzero(np.moveaxis(busy, a, 0).reshape(n, -1).any(1)) for a, n in enumerate(shape)]
    room = np.array([(places[0], n - 1 - places[-1]) for places, n in zip(held, shape, strict=True)])
    open_axes = [a for a in range(len(shape)) if {(a, -1), (a, 1)} <= set(trials.keys)]
    if not open_axes:
        return None
    axis = min(open_axes, key=lambda a: room[a].min())
    along = max((int(room[a].max()) for a in range(len(shape)) if a != axis), default=0)
    if near.model.order == 2 and room[axis].min() < _ALONG * along:
        strip = _strip(trials, held, room, axis)
        if strip is not None:
            return strip
    return _in_proportion(trials, held, room, open_axes)


def _least_room(near: NearField) -> np.ndarray:
    """Return the least number of nodes between data and a side, by axis: the reach, and some nodes of the medium."""
    return np.array(near.stencil.reach) + 2


def _strip(trials: TrialRuns, held: list[np.ndarray], room: np.ndarray, axis: int) -> TrialRuns | None:
    """Return trials on a strip along the nearest side, which lies across an axis, until all waves have passed it once,
    along the diagonal; None where they take too long.
    """
    near, beside = trials.near, room.copy()
    beside[axis] = np.minimum(room[axis], max(2 * room[axis].min(), _least_room(near)[axis]))
    passing = max(SHORTEST, float(np.sqrt(near.lattice.dim))) * near.slow_crossing
    strip = _cropped(trials, held, beside, trials.until, passing)
    return strip if strip is not None and strip.tried == min(strip.longest, strip.until) else None


def _in_proportion(
    trials: TrialRuns, held: list[np.ndarray], room: np.ndarray, open_axes: list[int]
) -> TrialRuns | None:
    """Return trials on the largest near field, with sides nearer to the data in proportion, that leaves time for a
    choice, or else the smallest one.
    """
    near, small = trials.near, None
    shape, least = np.array(near.lattice.shape), _least_room(near)
    for part in 0.7 ** np.arange(1, 15):  # halves the number of nodes, in the plane
        nearer = room.copy()
        for a in open_axes:
            nearer[a] = np.minimum(room[a], np.maximum(least[a], np.ceil(part * room[a])).astype(int))
        sizes = np.array([places[-1] - places[0] + 1 for places in held]) + nearer.sum(1)
        if not sizes.prod() < 0.7 * shape.prod():  # what is saved would not pay for the run that is lost
            return small
        until = trials.until * (sizes.max() / shape.max()) ** (3 - near.model.order)
        small = _cropped(trials, held, nearer, until)
        if small is None or _ENOUGH * small.expected_seconds <= trials.allowed:
            return small
    return small


def _cropped(
    trials: TrialRuns, held: list[np.ndarray], room: np.ndarray, until: float, longest: float = np.inf
) -> TrialRuns | None:
    """Return trials on a part of the near field, given by the places of the data and the nodes beside them."""
    run, near = trials.run, trials.near
    low = np.array([places[0] for places in held]) - room[:, 0]
    high = np.array([places[-1] for places in held]) + room[:, 1]
    part = tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))
    lower = near.lattice.lower + near.lattice.spacing * low
    lattice = Lattice(near.lattice.spacing, lower, lower + near.lattice.spacing * (high - low))
    initial = {"u": run.start_u[(..., *part)] + near.background}
    initial |= {"v": run.start_v[(..., *part)]} if near.model.order == 2 else {}
    try:
        small = run.remade(lattice=lattice, initial=initial, boundary=run.parts.layered.as_given())
        return TrialRuns(small, trials.keys, trials.wanted, until, trials.allowed, longest)
    except InputError:
        return None


def choose_layers(run: Any, keys: list[Key], until: float) -> Chosen:
    """Choose the layers of some sides for a run of a given length, and for a usual one if that is longer and trials of
    it take no more than two seconds: runs are often continued. All sides have the same number of nodes, and the
    smallest target of them counts; NotKept if no layer of up to 60 nodes keeps a target that is given.
    """
    runs, remark = _in_place_of(run)
    every = [_chosen(run, tried, keys, until) for tried in runs]
    most = max(every, key=lambda one: max(found.nodes for found in one.thickness.values()))
    return most._replace(notes=[*most.notes, remark] if remark else most.notes)


def _chosen(run: Any, tried: Any, keys: list[Key], until: float) -> Chosen:
    """Return the layers that trials of a set-up, that of the run or one in its place, choose."""
    asked = min(run.sides[key].wanted(run.model.target) for key in keys)
    rounded = _ROUNDED[run.model.order - 1] if run.setup.dtype == "float32" else 0.0
    target = max(asked, rounded)  # of what rounding exceeds, trials show nothing
    trials = TrialRuns(tried, keys, target, until)
    usual = TrialRuns(tried, keys, target, max(until, default_length(run.parts.near)))
    if not any(run.sides[key].until for key in keys) and usual.brief:
        trials, until = usual, usual.until
    small = None if trials.tried == until else _smaller(trials)
    used = trials if small is None else small
    best, cost = _recalled(used), 0.0
    if best is None:
        best, cost = used.chosen(), used.spent / trials.expected_seconds
        _remember(used, best)
    if best.error > target and any(run.sides[key].target is not None for key in keys):
        raise NotKept.of(target, best.error)
    sides = trials.sides(best.family.name, best.nodes)
    tried = until * used.tried / used.until  # a smaller near field sees as many crossings in less time
    thickness = {
        side_name(*key): Thickness(best.family.name, side.profile, float(best.error), until, tried, cost)
        for key, side in sides.items()
    }
    names = ", ".join(thickness)
    doubts, notes = [], []
    if best.error > target:
        doubts.append(_missed(best.nodes, names, best.error, target, run.model.order))
    if np.isnan(best.error):
        notes.append(f"trial runs that show the error of the layers ({names}) take too long; {_MEASURE}")
    elif small is not None:
        shape = " x ".join(map(str, small.run.lattice.shape))
        notes.append(
            f"trial runs of the layers ({names}) are those of a smaller near field of {shape} nodes; {_MEASURE}"
        )
    elif tried < until:
        notes.append(f"trial runs of the layers ({names}) end at t = {tried:.4g}; {_MEASURE}")
    if asked < rounded:
        doubts.append(f"in single precision, rounding exceeds the target {asked:g}: use float64 or a larger target")
    return Chosen(sides, thickness, doubts, notes)


def _recalled(trials: TrialRuns) -> Candidate | None:
    """Return what trials of the same set-up chose before."""
    known = kept(_cache_file(trials))
    if known is None:
        return None
    family = next(candidate for candidate in trials.families if candidate.name == str(known["family"]))
    return Candidate(family, int(known["nodes"]), float(known["error"]), bool(known["kept"]))


def _remember(trials: TrialRuns, best: Candidate) -> None:
    """Keep what trials chose, if they took a while."""
    if trials.spent > 0.1 * SECONDS:  # less is not noticed
        keep(_cache_file(trials), family=best.family.name, nodes=best.nodes, error=best.error, kept=best.kept)


def _cache_file(trials: TrialRuns) -> Path:
    """Return the file of a choice as made by this version of the program. Initial data count by their values, which a
    function need not return twice.
    """
    run = trials.run
    others = {key: side for key, side in run.sides.items() if key not in trials.keys}
    given = replace(run.setup, initial={}, boundary=None), others, run.start_u, run.start_v, run.dt
    asked = trials.keys, trials.wanted, trials.until, trials.allowed, trials.longest
    mark = hashlib.sha256(digest_of((given, asked)) + _PROGRAM)
    return cache_folder() / f"layers_{mark.hexdigest()[:24]}.npz"


def assess_layers(run: Any, keys: list[Key], until: float) -> tuple[float, list[str]]:
    """Return the error of layers as they are in a run of a given length, nan if a trial takes too long, and a warning
    if it is above the targets.
    """
    target = max(run.sides[key].wanted(run.model.target) for key in keys)
    trials = TrialRuns(_in_place_of(run)[0][-1], keys, target, until)
    error = trials.assessed()
    names = ", ".join(side_name(*key) for key in keys)
    nodes = max(trials.near_layer(key).columns for key in keys)
    return error, [_missed(nodes, names, error, target, run.model.order)] if error > target else []


def _missed(nodes: int, names: str, error: float, wanted: float, order: int) -> str:
    at = "the largest value" if order == 2 else "the largest value at that time"
    return (
        f"layers of {nodes} nodes ({names}) reflect {error:.1g} of {at} in trial runs, more than the target {wanted:g}"
    )
