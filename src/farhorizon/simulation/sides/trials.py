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

from farhorizon.analysis.layers.families import Family, diffusive, families, long_run_profile
from farhorizon.analysis.layers.profiles import weak
from farhorizon.analysis.layers.short_waves import high_pass
from farhorizon.analysis.layers.thickness import AIM, APART, APART_SLOW, MOST, Candidate, of_nodes, thicker, thinnest
from farhorizon.analysis.stability import step_seconds
from farhorizon.boundaries import LatticePML, Side
from farhorizon.engine.engine import Layer
from farhorizon.errors import InputError, UnstableError, ValidityWarning
from farhorizon.medium.integrators import Verlet
from farhorizon.rounding import MARGIN, TINY
from farhorizon.simulation.setup.near_field import NearField
from farhorizon.simulation.setup.setup import Key, side_name
from farhorizon.simulation.sides.layered_sides import spreads
from farhorizon.simulation.time.steps import last_step

#: Crossings of the near field for which layers for waves are chosen where the length of the run is not known, and
#: beyond which waves that return late count.
CROSSINGS = 20
#: Trials take as long as `_RUNS` runs, but `SECONDS` if that is more and `_MOST_SECONDS` if that is less. Seconds are
#: counted operations of a typical core. Nine runs are three references, each with candidates of two families: with half
#: as many, trials of some runs end early, and one choice in twenty missed its target.
SECONDS = 2.0
_RUNS, _MOST_SECONDS = 9, 60.0
_TRIALS = 3  # runs that a choice takes, as counted: a reference, a candidate, and parts of others
# seconds that a step takes to call a function of the user's, and for each node at which it is evaluated: what numpy
# needs for an exponential
_CALL, _VALUE = 1e-4, 5e-8
#: Crossings of the near field below which a trial shows too little.
SHORTEST = 1.5
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


class _Record(NamedTuple):
    """Fields (times, values) of a run at the times of comparison, and the sizes (times,) to which errors relate."""

    fields: np.ndarray
    sizes: np.ndarray


def _allowed(seconds: float) -> float:
    """Seconds that the trials of a run may take which takes some seconds itself."""
    return float(np.clip(_RUNS * seconds, SECONDS, _MOST_SECONDS))


@dataclass
class TrialRuns:
    """Runs of one set-up, from its start, with candidate layers on the sides `keys` and a target error; `budget` is in
    seconds of a typical core, and by `longest` all that a smaller near field shows has happened.
    """

    run: Any
    keys: list[Key]
    wanted: float
    until: float
    budget: float | None = None
    longest: float = np.inf
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
            families = {family.name: family for family in self._of_side[key]}
            self._layers[known] = families[name].layer(nodes) if name in families else None
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
        slowest = pace * float(np.sqrt(near.weakest / max(near.strongest, TINY)))
        uniform = near.squared_speed is None and spreads(self.run.sides, key[0])
        late = None
        if self.until > CROSSINGS * near.crossing:
            distance = self._distance(key)

            def late(nodes: int) -> Layer:
                return long_run_profile(nodes, pace, self.until, distance, self.wanted)

        def steep(nodes: int) -> Layer:
            return LatticePML(nodes=nodes).make_layer(2, stencil, coefficient, spacing, 0.0)

        dampers = uniform and isinstance(near.model.integrator, Verlet)
        return families(stencil, pace, slowest, late, dt if dampers else None, steep)

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
        sides: dict[Key, Side] = {}
        for key in self.keys:
            layer = self.layer_of(key, name, nodes)
            if layer is None:  # another family, with as many nodes
                layer = next(
                    one for other in self._of_side[key] if (one := self.layer_of(key, other.name, nodes)) is not None
                )
            if self._short:
                layer = replace(layer, short=True)
            sides[key] = replace(self._layered(key), nodes=layer.columns, profile=layer)
        return sides

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
        return self.wanted >= _SHORT * self.until / self.near.crossing * (1 - MARGIN)  # also where both are equal

    def near_layer(self, key: Key) -> Layer:
        """Return the layer that a side has now."""
        return self.run.parts.layered.layers[key]

    # --- the runs ----------------------------------------------------------------------------------------------

    @cached_property
    def steps(self) -> np.ndarray:
        """Numbers of the steps after which fields are compared. Diffusion slows down as it spreads."""
        last, near = max(1, last_step(self.tried, self.near.dt)), self.near
        if near.model.order == 1:
            # from a time in which the field spreads a 55th as far, sqrt(1 / 3000), as by the end
            places = np.geomspace(max(1.0, last / 3000), last, _FEWEST_LOOKS * 2)
        else:
            looks = np.clip(_LOOKS * self.tried / near.crossing, _FEWEST_LOOKS, _MOST_LOOKS)
            places = np.linspace(last / int(looks), last, int(looks))
        return np.unique(np.ceil(places).astype(int))

    @cached_property
    def tried(self) -> float:
        """Length of the trials: that of the run, or shorter where the run takes long."""
        return min(self.longest, self.until * min(1.0, self.allowed / (_TRIALS * self.expected_seconds)))

    @property
    def allowed(self) -> float:
        """Seconds of a typical core that all trials may take."""
        return _allowed(self.expected_seconds) if self.budget is None else self.budget

    @property
    def brief(self) -> bool:
        """Whether trials take no more time than any may."""
        return _TRIALS * self.expected_seconds <= SECONDS

    @cached_property
    def expected_seconds(self) -> float:
        """Seconds that the run takes with the layers of the first reference."""
        family = of_nodes(self.families, self.start)
        layer = family.layer(self.start)
        return self._seconds(dict.fromkeys(self.keys, layer), self.until) if layer else np.inf

    def _seconds(self, layers: Mapping[Key, Layer], until: float) -> float:
        """Seconds that a run with some layers takes on a typical core: sums over the bonds of all nodes, and in layers
        over the continued field and the neighbours in the filter.
        """
        near, dim = self.near, self.near.lattice.dim
        every = {key: self.near_layer(key) for key, side in self.run.sides.items() if side.stretched} | dict(layers)
        width = np.array(near.lattice.shape) + 2 * np.array(near.stencil.reach)
        for (axis, _), layer in every.items():
            width[axis] += layer.columns
        nodes = float(np.prod(width))
        products = nodes * near.stencil.weights.size
        for (axis, _), layer in every.items():
            each = 4 * near.stencil.reach[axis] + 2 * dim * len(layer.taps) * layer.filtered
            products += nodes / width[axis] * layer.columns * near.stencil.components * each
        stages = len(near.model.integrator.stages(near.dt).numbers)
        called = self._functions * (_CALL + _VALUE * near.lattice.nodes)
        return until / near.dt * (step_seconds(products * stages) + called)

    @cached_property
    def _functions(self) -> int:
        """Number of functions that each step evaluates in Python."""
        parts = self.run.parts
        return len(parts.source_terms.unsplit) + len(parts.of_field) + len(parts.incident)

    @staticmethod
    def _layers_of(sides: Mapping[Key, Side]) -> dict[Key, Layer]:
        return {key: side.profile for key, side in sides.items()}

    def reference(self, family: Family, nodes: int) -> bool:
        """Run with layers of a family, with which later candidates are compared; return whether that tells anything:
        whether there was time, something moved, and the run did not grow beyond all bounds.
        """
        sides = self.sides(family.name, nodes)
        if self._reference is not None and not self._affords(sides, self.tried):
            return False
        sim, self._reference = self._made(sides), None
        _, record = (np.inf, None) if sim is None else self._followed(sim, sides, np.inf)
        if record is None or not record.fields.any():
            return False
        self._reference = record
        return True

    def error(self, family: Family, nodes: int, enough: float) -> float:
        """Return the largest difference of a run with layers of a family from the reference; above `enough`, a lower
        bound of it. Infinite if there was no time for it.
        """
        return self._error(self.sides(family.name, nodes), enough)

    def _error(self, sides: Mapping[Key, Side], enough: float) -> float:
        sim = self._made(sides) if self._affords(sides, 0.0) else None
        return np.inf if sim is None else self._followed(sim, sides, enough)[0]

    def _affords(self, sides: Mapping[Key, Side], trial: float) -> bool:
        """Whether there is time for a trial of some length, where that of a candidate, which is as long as the run,
        does not count. Where the layers turn out so thick that the run takes longer, so may the trials.
        """
        layers = self._layers_of(sides)
        longer = _allowed(self._seconds(layers, self.until))
        return self.spent + self._seconds(layers, trial) <= max(self.allowed, longer)

    def _made(self, sides: Mapping[Key, Side]) -> Any:
        """Return the set-up at its start with other sides; None if that cannot be made."""
        others = self.run.parts.layered.as_given()
        try:
            return self.run.remade(boundary=others | {side_name(*key): side for key, side in sides.items()})
        except InputError:
            return None

    def _followed(self, sim: Any, sides: Mapping[Key, Side], enough: float) -> tuple[float, _Record | None]:
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
        self.spent += self._seconds(self._layers_of(sides), sim.time)
        if reference is not None:
            return (worst if np.isfinite(worst) else 1 / AIM), None
        record = np.array(fields)
        sizes = np.abs(record).max(1, initial=0.0)
        if self.near.model.order == 2:
            sizes[:] = max(sizes.max(), float(np.abs(self.run.start_u).max()))
        return worst, _Record(record, np.maximum(sizes, TINY))

    def _sampled(self, sim: Any) -> np.ndarray:
        """Return the field without its background; of a large field every few nodes along each axis."""
        u = sim.fields["u"] - self.near.background
        stride = int(np.ceil((u.size / _MOST_VALUES) ** (1 / self.near.lattice.dim)))
        part = u[(..., *[slice(None, None, stride)] * self.near.lattice.dim)]
        return np.nan_to_num(part.ravel(), posinf=np.inf, neginf=-np.inf)

    # --- the result --------------------------------------------------------------------------------------------

    def chosen(self) -> Candidate:
        """Return the thinnest candidate that keeps the target as far as trials can tell, with more nodes where they are
        shorter than the run.
        """
        if self.tried < min(self.until, SHORTEST * self.near.crossing):
            candidate = Candidate(of_nodes(self.families, self.start), self.start, np.nan, False)
        else:
            candidate = thinnest(self.families, self, AIM * self.wanted, self.start, self.apart)
        if self.tried >= self.until:
            return candidate
        nodes = min(MOST, candidate.nodes + self._more)
        same = candidate.family.layer(nodes) is not None
        return replace(candidate, family=candidate.family if same else of_nodes(self.families, nodes), nodes=nodes)

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
        as_given, smallest = self.run.parts.layered.as_given(), np.nan
        for _ in range(2):
            nodes = min(thicker(nodes, self.apart), 2 * MOST)
            before = self._reference
            if not self.reference(of_nodes(self.families, nodes), nodes):
                self._reference = before
                return smallest
            difference = self._error({key: as_given[side_name(*key)] for key in self.keys}, np.inf)
            smallest = float(np.fmin(smallest, difference)) if np.isfinite(difference) else smallest
            if smallest <= self.wanted:
                break
        return smallest
