"""Layers chosen by running: a set-up is run with candidates, and the error of each is its difference from a better one.

The run itself contains what a prediction would have to know: corners, walls, free sides, cracks, strata, sources,
waves of all kinds and every integrator.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from farhorizon.analysis.layers.choice import weak
from farhorizon.analysis.layers.families import Family, diffusive, families, long_run_profile
from farhorizon.analysis.layers.short_waves import high_pass
from farhorizon.analysis.layers.thickness import (
    AIM,
    APART,
    APART_SLOW,
    MOST,
    Found,
    NotKept,
    Thickness,
    of_nodes,
    thicker,
    thinnest,
)
from farhorizon.analysis.stability import step_seconds
from farhorizon.boundaries import LatticePML, Side
from farhorizon.engine.engine import Layer
from farhorizon.errors import InputError, UnstableError, ValidityWarning
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.conditions import Temperature
from farhorizon.medium.integrators import RungeKuttaChebyshev
from farhorizon.models import Diffusion
from farhorizon.simulation.layers import spreads
from farhorizon.simulation.near_field import NearField
from farhorizon.simulation.setup import Key, side_name
from farhorizon.simulation.steps import last_step

#: Length of a run if it is not known: in crossings of the near field for waves, in R^2/diffusivity for diffusion.
CROSSINGS, LASTING = 20, 10
# trials take as long as so many runs, or as many seconds if that is more; where a run takes long, a part of its time,
# and twenty seconds at most. Seconds are counted operations of a typical core
_RUNS, _SECONDS, _LONG, _PART, _MOST_SECONDS = 1.5, 2.0, 10.0, 0.25, 20.0
_TRIALS = 3  # runs that a choice takes, as counted: a reference, a candidate, and parts of others
# seconds that a step takes to call a function of the user's, and for each node at which it is evaluated: what numpy
# needs for an exponential
_CALL, _VALUE = 1e-4, 5e-8
# the same where usual layers turn out too thin: three references, each with candidates of up to three families, which
# have three quarters of its nodes and cost less than that
_THICKER = 9
_SHORTEST = 1.5  # crossings of the near field below which a trial shows too little
# comparisons per crossing of the near field, within which a reflected wave travels on, and their least and largest
# number
_LOOKS, _FEWEST_LOOKS, _MOST_LOOKS = 4, 24, 120
_MOST_VALUES = 2**18  # values of a field that are compared at a time
# nodes of the first reference: at the beginning and for each decade of the target, for waves whose layers are thin, and
# for strong backward waves; in space thick layers take too much time to begin with them
_START, _START_STRONG = (2.0, 1.5), (8.0, 4.0)
_FAINT = 1e-3  # part of the largest value below which data do not count for their distance to a side
# smallest target per crossing of the near field for which the layers' memory needs only six digits: under a persistent
# force the rounding adds up to 4e-6 per crossing, for pulses to a tenth of that
_SHORT = 1.5e-5
# rounding error in single precision relative to the largest value at the same time: of diffusion, which decays, and of
# waves
_ROUNDED = 1e-4, 2e-6
_BESIDE = 0.03  # part of the target that data may have at the sides of a smaller copy
_MEASURE = "'farhorizon compare' measures it"


class Chosen(NamedTuple):
    """Layers that were chosen or assessed.

    Attributes
    ----------
    sides : dict of (axis, side) to Side
    thickness : dict of str to Thickness
        By name of the side.
    doubts : list of str
        Warnings about layers that miss their targets.
    notes : list of str
    """

    sides: dict[Key, Side]
    thickness: dict[str, Thickness]
    doubts: list[str]
    notes: list[str]


class _Record(NamedTuple):
    """Fields of a run at the times of comparison.

    Attributes
    ----------
    fields : ndarray, shape (times, values)
    sizes : ndarray, shape (times,)
        What an error at each time is relative to.
    """

    fields: np.ndarray
    sizes: np.ndarray


@dataclass
class TrialRuns:
    """Runs of one set-up with candidate layers on some of its sides.

    Attributes
    ----------
    run : Simulation
        At its start, or later: trials begin at its start.
    keys : list of (axis, side)
        Sides of the candidates.
    wanted : float
        Target error.
    until : float
        Length of the run.
    budget : float, optional
        Seconds of a typical core that all trials may take, where it does not follow from this run.
    """

    run: Any
    keys: list[Key]
    wanted: float
    until: float
    budget: float | None = None
    spent: float = 0.0
    _reference: _Record | None = None
    _layers: dict[tuple[Key, str, int], Layer | None] = field(default_factory=dict)

    @property
    def near(self) -> NearField:
        """The near field."""
        return self.run.parts.near

    # --- the candidates ----------------------------------------------------------------------------------------

    @cached_property
    def families(self) -> list[Family]:
        """Families of layers for all sides together. Where one side has no layer of a family, such as one beside walls,
        it has the thickest of its next family.
        """
        names = list(dict.fromkeys(family.name for every in self._of_side.values() for family in every))

        def of(name: str) -> Family:
            def layer(nodes: int) -> Layer | None:
                own = [self.layer_of(key, name, nodes) for key in self.keys]
                return max((one for one in own if one is not None), key=lambda one: one.columns, default=None)

            return Family(name, layer)

        return [of(name) for name in names]

    def layer_of(self, key: Key, name: str, nodes: int) -> Layer | None:
        """Return the layer of a side for a family and a number of nodes; None if no side has one."""
        known = (key, name, nodes)
        if known not in self._layers:
            own = {family.name: family for family in self._of_side[key]}
            self._layers[known] = own[name].layer(nodes) if name in own else None
        return self._layers[known]

    @cached_property
    def _of_side(self) -> dict[Key, list[Family]]:
        return {key: self._families(key) for key in self.keys}

    def _families(self, key: Key) -> list[Family]:
        near, spacing, dt = self.near, self.near.lattice.spacing, self.near.dt
        if near.model.order == 1:
            spread = near.model.coefficient * near.strongest * self.until
            distance = spacing * max(1.0, self._distance(key))
            return [Family("diffusive", lambda nodes: diffusive(nodes, spacing, spread, distance))]
        coefficient = self.run.coefficients[key]
        first = 0 if near.continued.same_along(0, key[0]) else key[0]
        stencil = near.continued.along(first).beside(coefficient / near.model.coefficient)
        pace = float(np.sqrt(coefficient)) / spacing
        slowest = pace * float(np.sqrt(near.weakest / max(near.strongest, 1e-300)))
        uniform = near.squared_speed is None and spreads(self.run.sides, key[0])
        late = None
        if self.until > CROSSINGS * near.crossing:
            distance = self._distance(key)

            def late(nodes: int) -> Layer:
                return long_run_profile(nodes, pace, self.until, distance, self.wanted)

        def steep(nodes: int) -> Layer:
            return LatticePML(nodes=nodes).make_layer(2, stencil, coefficient, spacing, 0.0)

        return families(stencil, pace, slowest, late, dt if uniform else None, steep)

    def _distance(self, key: Key) -> float:
        """Return the nodes between a side and the data, sources and conditions."""
        axis, side = key
        near = self.near
        busy = near.busy.copy()
        for values in (self.run.start_u, self.run.start_v, *(space for space, _ in self.run.sources)):
            if values is not None and np.any(values):
                size = near.size(np.abs(np.reshape(values, near.field_shape)))
                busy |= size > _FAINT * size.max()
        planes = np.flatnonzero(np.moveaxis(busy, axis, 0).reshape(near.lattice.shape[axis], -1).any(1))
        if not planes.size:
            return 1.0
        return float(planes[0] if side < 0 else near.lattice.shape[axis] - 1 - planes[-1])

    def sides(self, name: str, nodes: int) -> dict[Key, Side]:
        """Return the sides with the layers of a candidate, given the name of its family."""
        found: dict[Key, Side] = {}
        for key in self.keys:
            layer = self.layer_of(key, name, nodes)
            if layer is None:  # another family, with as many nodes
                layer = next(
                    one for other in self._of_side[key] if (one := self.layer_of(key, other.name, nodes)) is not None
                )
            if self._short:
                layer = replace(layer, short=True)
            found[key] = replace(self._layered(key), nodes=layer.columns, profile=layer)
        return found

    def _layered(self, key: Key) -> LatticePML:
        side = self.run.sides[key]
        return LatticePML(target=side.wanted(self.near.model.target), until=self.until)

    @cached_property
    def _short(self) -> bool:
        """Whether six digits are enough for the memory of the layers: in 3D, where reading it limits the speed, if the
        target is at least `_SHORT` per crossing, on all absorbing sides.

        Rounding acts as random pushes on the medium beside a layer. A push leaves a velocity behind, so the error grows
        with the length of the run.
        """
        absorbing = [key for key, b in self.run.sides.items() if b.stretched or b.derivatives]
        if self.near.lattice.dim < 3 or set(absorbing) != set(self.keys):
            return False
        return self.wanted >= _SHORT * self.until / self.near.crossing

    def as_it_is(self, key: Key) -> Side:
        """Return a side of the run; if it has a layer, with this layer, so that nothing is chosen or assessed."""
        side = self.run.sides[key]
        if not side.stretched:
            return side
        layer = self.near_layer(key)
        return replace(side, nodes=layer.columns, profile=layer)

    def near_layer(self, key: Key) -> Layer:
        """Return the layer that a side has now."""
        return self.run.parts.around.layers[key]

    # --- the runs ----------------------------------------------------------------------------------------------

    @cached_property
    def steps(self) -> np.ndarray:
        """Numbers of the steps after which fields are compared. Diffusion slows down as it spreads."""
        last, near = max(1, last_step(self.tried, self.near.dt)), self.near
        if near.model.order == 1:
            found = np.geomspace(max(1.0, last / 3000), last, _FEWEST_LOOKS * 2)
        else:
            looks = np.clip(_LOOKS * self.tried / near.crossing, _FEWEST_LOOKS, _MOST_LOOKS)
            found = np.linspace(last / int(looks), last, int(looks))
        return np.unique(np.ceil(found).astype(int))

    @cached_property
    def tried(self) -> float:
        """Length of the trials: that of the run, or shorter where the run takes long."""
        return self.until * min(1.0, self.allowed / (_TRIALS * self._usual))

    @cached_property
    def allowed(self) -> float:
        """Seconds of a typical core that all trials may take."""
        if self.budget is not None:
            return self.budget
        return float(np.clip((_RUNS if self._usual < _LONG else _PART) * self._usual, _SECONDS, _MOST_SECONDS))

    @cached_property
    def _usual(self) -> float:
        """Seconds that the run takes with the layers of the first reference."""
        lattice = self.near.lattice
        more = [
            2 * reach + self.start * sum(key[0] == axis for key in self.keys)
            for axis, reach in enumerate(self.near.stencil.reach)
        ]
        return self._seconds(float(np.prod(np.array(lattice.shape) + more)), self.until)

    def _seconds(self, nodes: float, until: float) -> float:
        """Seconds that a run takes on a typical core."""
        scheme = self.near.model.integrator
        stages = scheme.chebyshev if isinstance(scheme, RungeKuttaChebyshev) else 1
        each = step_seconds(nodes * self.near.stencil.weights.size * stages)
        return until / self.near.dt * (each + self._functions * (_CALL + _VALUE * self.near.lattice.nodes))

    @cached_property
    def _functions(self) -> int:
        """Number of functions that each step evaluates in Python."""
        parts = self.run.parts
        return len(parts.drives.unsplit) + len(parts.of_field) + len(parts.incident)

    def _takes(self, sim: Any, until: float) -> float:
        return self._seconds(float(np.prod(sim.engine.layout.box.nodes)), until)

    def reference(self, family: Family, nodes: int) -> bool:
        """Run with layers of a family, with which later candidates are compared; return whether that tells anything:
        whether there was time, something moved, and the run did not grow beyond all bounds.
        """
        sim = self._made(self.sides(family.name, nodes))
        if sim is None or (self._reference is not None and not self._affords(sim, False)):
            return False
        self._reference = None
        _, found = self._followed(sim, np.inf)
        if found is None or not found.fields.any():
            return False
        self._reference = found
        return True

    def error(self, family: Family, nodes: int, enough: float) -> float:
        """Return the largest difference of a run with layers of a family from the reference; above `enough`, a lower
        bound of it. Infinite if there was no time for it.
        """
        sim = self._made(self.sides(family.name, nodes))
        return np.inf if sim is None or not self._affords(sim, True) else self._followed(sim, enough)[0]

    def _affords(self, sim: Any, candidate: bool) -> bool:
        """Whether there is time for a trial, without that of a candidate itself, which is as long as the run. Where the
        layers turn out so thick that the run takes longer than was expected, so may the trials.
        """
        trial, whole = self._takes(sim, self.tried), self._takes(sim, self.until)
        before = self.spent + (0.0 if candidate else trial)
        return before <= self.allowed or (whole < _LONG and before <= _THICKER * whole)

    def _made(self, sides: Mapping[Key, Side]) -> Any:
        """Return the set-up at its start with other sides; None if that cannot be made."""
        every = {key: self.as_it_is(key) for key in self.run.sides} | dict(sides)
        try:
            return self.run.remade(boundary={side_name(*key): side for key, side in every.items()})
        except InputError:
            return None

    def _followed(self, sim: Any, enough: float) -> tuple[float, _Record | None]:
        """Run a candidate, and return its largest difference from the reference, if there is one, and its record. It
        ends where the difference is above `enough`.
        """
        worst, fields, reference = 0.0, [], self._reference
        for number, step in enumerate(self.steps):
            try:
                with np.errstate(all="ignore"), warnings.catch_warnings():
                    warnings.simplefilter("ignore", ValidityWarning)  # the run itself will warn
                    sim.step(int(step) - sim.step_count)
            except (UnstableError, InputError):  # the run itself will tell
                return 1 / AIM, None
            fields.append(self._sampled(sim))
            if reference is None:
                continue
            off = float(np.abs(fields[-1] - reference.fields[number]).max(initial=0.0))
            worst = max(worst, off / reference.sizes[number])
            if not worst <= enough:
                break
        self.spent += self._takes(sim, sim.time)
        if reference is not None:
            return (worst if np.isfinite(worst) else 1 / AIM), None
        record = np.array(fields)
        sizes = np.abs(record).max(1, initial=0.0)
        if self.near.model.order == 2:
            sizes[:] = max(sizes.max(), float(np.abs(self.run.start_u).max()))
        return worst, _Record(record, np.maximum(sizes, 1e-300))

    def _sampled(self, sim: Any) -> np.ndarray:
        """Return the field without its background; of a large field every few nodes along each axis."""
        u = sim.fields["u"] - self.near.background
        stride = int(np.ceil((u.size / _MOST_VALUES) ** (1 / self.near.lattice.dim)))
        part = u[(..., *[slice(None, None, stride)] * self.near.lattice.dim)]
        return np.nan_to_num(part.ravel(), posinf=np.inf, neginf=-np.inf)

    # --- the result --------------------------------------------------------------------------------------------

    def chosen(self) -> Found:
        """Return the thinnest candidate that keeps the target as far as trials can tell, with more nodes where they are
        shorter than the run.
        """
        if self.tried < min(self.until, _SHORTEST * self.near.crossing):
            found = Found(of_nodes(self.families, self.start), self.start, np.nan, False)
        else:
            found = thinnest(self.families, self, AIM * self.wanted, self.start, self.apart)
        if self.tried >= self.until:
            return found
        nodes = min(MOST, found.nodes + self._more)
        same = found.family.layer(nodes) is not None
        return replace(found, family=found.family if same else of_nodes(self.families, nodes), nodes=nodes)

    @property
    def _strong(self) -> bool:
        """Whether the layers must damp strong backward waves."""
        return self.near.model.order == 2 and not weak(high_pass(self.near.continued))

    @property
    def apart(self) -> float:
        """Nodes of a reference over those of a candidate."""
        walls = any(b.image for b in self.run.sides.values())
        return APART_SLOW if walls and self._strong and self.near.lattice.dim > 1 else APART

    @property
    def start(self) -> int:
        """Nodes of the first reference."""
        first, each = _START_STRONG if self._strong and self.near.lattice.dim < 3 else _START
        return int(np.ceil(first - each * np.log10(self.wanted)))

    @property
    def _more(self) -> int:
        """Nodes that a run needs beyond those of its trials, by the bound of Zolotarev's problem: the error falls as
        ``exp(-pi^2 n/ln(4 T))`` for a length of the run T.
        """
        longer = np.log(self.until / self.tried) * (1.0 if self.near.model.order == 2 else 0.5)
        return int(np.ceil(longer * np.log(4 / (AIM * self.wanted)) / np.pi**2))

    def assessed(self) -> float:
        """Return the error of the layers as they are: their difference from thicker ones, the smaller of two; nan if
        there is no time for it.
        """
        nodes = max(self.near_layer(key).columns for key in self.keys)
        found = np.nan
        for _ in range(2):
            nodes = min(thicker(nodes, self.apart), 2 * MOST)
            before = self._reference
            if not self.reference(of_nodes(self.families, nodes), nodes):
                self._reference = before
                return found
            sim = self._made({})
            if sim is None or not self._affords(sim, True):
                return found
            found = float(np.fmin(found, self._followed(sim, np.inf)[0]))
            if found <= self.wanted:
                break
        return found


def default_length(near: NearField) -> float:
    """Return the length of run for which layers are chosen if it is not known."""
    return (CROSSINGS if near.model.order == 2 else LASTING) * near.crossing


def _without_fronts(run: Any) -> list[Any]:
    """Return, for a corrosion, runs in which no front moves from node to node, since its steps would hide the
    differences between layers: with the metal held at one concentration, as long as it lasts, and with the metal as
    initial data, when it is dissolved. Other runs are returned as they are.
    """
    if run.parts.phases is None:
        return [run]
    model, sides = run.model, {}
    for key, side in run.sides.items():
        layer = run.parts.around.layers.get(key)
        sides[side_name(*key)] = side if layer is None else replace(side, nodes=layer.columns, profile=layer)
    solid = run.fields["solid"] > 0
    held = (*run.setup.constraints, Temperature(solid, run.background + 1.0))
    liquid = Diffusion(model.operator, model.diffusivity, integrator=model.integrator)
    changes = {"model": liquid, "specimens": (), "boundary": sides, "dt": run.dt}
    try:
        dissolved = run.remade(initial={"u": run.background + solid}, **changes)
        return [run.remade(constraints=held, **changes), dissolved]
    except InputError:
        return [run]


def _smaller(trials: TrialRuns) -> TrialRuns | None:
    """Return trials on a copy whose sides are nearer to the data, in proportion, with as many crossings of the near
    field; the largest copy whose trials take no more time than those of the run may. None where anything but initial
    data in a uniform medium drives the run, or where nothing is gained.

    A wave arrives at the nearer sides under the same angles and larger, so that its errors are larger, too.
    """
    run, near = trials.run, trials.near
    given = run.setup
    other = (given.sources, given.loads, given.cracks, given.constraints, given.specimens)
    if any(other) or near.varies or near.lattice.mask is not None or run.team or run.of_field:
        return None
    shape, busy = np.array(near.lattice.shape), np.zeros(near.lattice.shape, bool)
    for values in (run.start_u, run.start_v):
        size = near.size(np.abs(values))
        busy |= size > _BESIDE * trials.wanted * max(float(size.max()), 1e-300)
    small = None
    held = [np.flatnonzero(np.moveaxis(busy, a, 0).reshape(n, -1).any(1)) for a, n in enumerate(shape)]
    if not busy.any():
        return None
    first, last = (np.array([h[end] for h in held]) for end in (0, -1))
    least = np.array(near.stencil.reach) + 2
    for part in 0.5 ** np.arange(1, 8):
        low = np.maximum(0, first - np.maximum(least, np.ceil(part * first)).astype(int))
        high = np.minimum(shape - 1, last + np.maximum(least, np.ceil(part * (shape - 1 - last))).astype(int))
        if not (high - low + 1).prod() < 0.7 * shape.prod():
            return small
        until = trials.until * ((high - low + 1).max() / shape.max()) ** (3 - near.model.order)
        small = _cropped(trials, low, high, until)
        if small is None or small.tried == until:
            return small
    return small


def _cropped(trials: TrialRuns, low: np.ndarray, high: np.ndarray, until: float) -> TrialRuns | None:
    """Return trials on a part of the near field, given by its first and last nodes."""
    run, near = trials.run, trials.near
    part = tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))
    lower = near.lattice.lower + near.lattice.spacing * low
    lattice = Lattice(near.lattice.spacing, lower, lower + near.lattice.spacing * (high - low))
    initial = {"u": run.start_u[(..., *part)] + near.background}
    initial |= {"v": run.start_v[(..., *part)]} if near.model.order == 2 else {}
    sides = {side_name(*key): trials.as_it_is(key) for key in run.sides}
    try:
        small = run.remade(lattice=lattice, initial=initial, boundary=sides)
        return TrialRuns(small, trials.keys, trials.wanted, until, trials.allowed)
    except InputError:
        return None


def choose_layers(run: Any, keys: list[Key], until: float) -> Chosen:
    """Choose the layers of some sides for a run of a given length, and for a usual one if that is longer and trials of
    it take no more than two seconds: runs are often continued. All sides have the same number of nodes, and the
    smallest target of them counts.

    Parameters
    ----------
    run : Simulation
    keys : list of (axis, side)
    until : float

    Raises
    ------
    NotKept
        No layer of up to 60 nodes keeps a target that is given.
    """
    every = [_chosen(run, tried, keys, until) for tried in _without_fronts(run)]
    return max(every, key=lambda one: max(found.nodes for found in one.thickness.values()))


def _chosen(run: Any, tried: Any, keys: list[Key], until: float) -> Chosen:
    """Return the layers that trials of a set-up, that of the run or one in its place, choose."""
    asked = min(run.sides[key].wanted(run.model.target) for key in keys)
    rounded = _ROUNDED[run.model.order - 1] if run.setup.dtype == "float32" else 0.0
    wanted = max(asked, rounded)  # of what rounding exceeds, trials show nothing
    trials = TrialRuns(tried, keys, wanted, until)
    usual = TrialRuns(tried, keys, wanted, max(until, default_length(run.parts.near)))
    if not any(run.sides[key].until for key in keys) and usual.tried == usual.until and usual.allowed == _SECONDS:
        trials, until = usual, usual.until
    small = None if trials.tried == until else _smaller(trials)
    found = trials.chosen() if small is None else small.chosen()
    if found.error > wanted and any(run.sides[key].target is not None for key in keys):
        raise NotKept.of(wanted, found.error)
    sides = trials.sides(found.family.name, found.nodes)
    thickness = {
        side_name(*key): Thickness(found.family.name, side.profile, float(found.error), until, trials.tried)
        for key, side in sides.items()
    }
    names = ", ".join(thickness)
    doubts, notes = [], []
    if found.error > wanted:
        doubts.append(_missed(found.nodes, names, found.error, wanted, run.model.order))
    if np.isnan(found.error):
        notes.append(f"trial runs that show the error of the layers ({names}) take too long; {_MEASURE}")
    elif small is not None:
        shape = " x ".join(map(str, small.run.lattice.shape))
        notes.append(
            f"trial runs of the layers ({names}) are those of a smaller near field of {shape} nodes; {_MEASURE}"
        )
    elif trials.tried < until:
        notes.append(f"trial runs of the layers ({names}) end at t = {trials.tried:.4g}; {_MEASURE}")
    if asked < rounded:
        doubts.append(f"in single precision, rounding exceeds the target {asked:g}: use float64 or a larger target")
    return Chosen(sides, thickness, doubts, notes)


def assess_layers(run: Any, keys: list[Key], until: float) -> tuple[float, list[str]]:
    """Return the error of layers as they are in a run of a given length, nan if a trial takes too long, and a warning
    if it is above the targets.
    """
    wanted = max(run.sides[key].wanted(run.model.target) for key in keys)
    trials = TrialRuns(_without_fronts(run)[-1], keys, wanted, until)
    error = trials.assessed()
    names = ", ".join(side_name(*key) for key in keys)
    nodes = max(trials.near_layer(key).columns for key in keys)
    return error, [_missed(nodes, names, error, wanted, run.model.order)] if error > wanted else []


def _missed(nodes: int, names: str, error: float, wanted: float, order: int) -> str:
    at = "the largest value" if order == 2 else "the largest value at that time"
    return (
        f"layers of {nodes} nodes ({names}) reflect {error:.1g} of {at} in trial runs, more than the target {wanted:g}"
    )
