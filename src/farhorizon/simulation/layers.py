"""The layers of a set-up that choose themselves, for its data and the length of its run, and what those given by hand
keep.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.layers.choice import weak
from farhorizon.analysis.layers.diffusing import Planes, Wall, predicted_for_diffusion, thinnest_for_diffusion
from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.short_waves import high_pass, short_share
from farhorizon.analysis.layers.thickness import NotKept, Thickness
from farhorizon.analysis.layers.tuned_layers import as_quiet, lightly_tuned
from farhorizon.boundaries import LatticePML, Side
from farhorizon.engine.engine import Layer
from farhorizon.errors import InputError
from farhorizon.medium.stencil import Stencil
from farhorizon.simulation.alternating_waves import FOLLOWED, AlternatingWaves, growth_of_waves
from farhorizon.simulation.layer_data import Driven
from farhorizon.simulation.near_field import NearField
from farhorizon.simulation.returned_waves import CROSSINGS, LASTING, MOST_CROSSINGS, ReturnedWaves, spreads
from farhorizon.simulation.setup import Key, Setup, Sides, side_name
from farhorizon.simulation.surroundings import Surroundings
from farhorizon.simulation.wave_data import FORESEEN, foreseen_time, stand_ins
from farhorizon.simulation.wave_field import WaveField

# of layers that are given by hand
_SENT_BACK = "layers of {{}} nodes ({{}}) are predicted to reflect {:.1g} of {}, more than the target {{:g}}"
_PATIENCE = 30.0  # seconds after which a choice or a prediction that still goes on says so
_CHOSEN = "choosing or assessing these layers takes a minute or more; nodes without a target need no such time"
_PREDICTED = "predicting what these layers reflect in the continued run takes a minute or more"
_LITTLE = 0.3  # damping in two steps that may wait for the second
_TURN = 0.2  # of a period, in a step of the fastest wave, where it may
# target for each crossing of the near field down to which six digits are enough for what layers remember: under a force
# that stays they add up to 4e-6 a crossing, of pulses a tenth of it
_SHORT = 1.5e-5
# what rounding adds in single precision of the largest value at the same time, of diffusion which falls, and of waves
_ROUNDED = 1e-4, 2e-6
_LIGHT = 1e-5  # and for light dampers: they send 2e-6 of a resolved pulse back at most
_ALIVE = 0.75  # factor of a step from which on waves are still there when they reach a side


@contextmanager
def _told_if_it_takes_long(what: str) -> Iterator[None]:
    """Without a word a choice in which waves are followed one by one seems to hang."""
    timer = threading.Timer(_PATIENCE, print, [f"farhorizon: {what}"], {"file": sys.stderr, "flush": True})
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def looks_at_data(side: Side) -> bool:
    """Whether a side has a layer that chooses itself for the data, or is to say what it keeps of a target; whole
    `Layer`s, as those that were chosen are handed on, are taken as they are.
    """
    return side.stretched and not side.whole and (side.open_ended or side.target is not None)


def choose_layers(setup: Setup, near: NearField, around: Surroundings, sources: Sequence[Any]) -> Surroundings:
    """Give each side whose layer chooses for itself the thinnest that keeps its target, and see what one given by hand
    keeps of its own.

    Parameters
    ----------
    setup : Setup
    near : NearField
    around : Surroundings
        With layers that follow from their targets alone or are given.
    sources : sequence
        Sources, incident waves and loads.

    Raises
    ------
    InputError
        No layer keeps a target.
    """
    layers = {key: b for key, b in around.sides.items() if looks_at_data(b)}
    choice = _Choice(Driven(setup, near, sources), near, around, {}, {}, set())
    if layers and near.model.order == 1:
        choice.for_diffusion(layers)
    elif layers:
        with _told_if_it_takes_long(_CHOSEN):
            choice.for_waves(layers)
    thickness = {side_name(*key): found for key, found in choice.found.items()}
    doubts = [words.format(nodes, ", ".join(named), aim) for (words, nodes, aim), named in choice.missed.items()]
    wanted = min((b.wanted(near.model.target) for b in layers.values()), default=1.0)
    if setup.dtype == "float32" and wanted < _ROUNDED[near.model.order - 1]:
        doubts.append(f"in single precision, rounding exceeds the target {wanted:g}: use float64 or a larger target")
    chosen = {key: one.layer for key, one in choice.found.items()}
    chosen = with_one_filter(around.layers | chosen, near.rate_limit, near.dt, near.lattice.dim)
    if _may_be_short(near, around.sides):
        chosen = {key: replace(layer, short=True) for key, layer in chosen.items()}
    notes = choice.unforeseen(layers)
    found = replace(around, layers=chosen, thickness=thickness, doubts=doubts, notes=notes)
    if not thickness:
        return found
    of_chosen = {key: layers[key] for key in choice.found}
    returned = partial(replace(choice, around=found).returned, of_chosen)
    return replace(found, returned=returned, foreseeable=choice.foreseeable)


def with_light_dampers(near: NearField, around: Surroundings) -> Surroundings:
    """The sides with light dampers in place of the filters of layers of scalars that are given by their nodes, with a
    target down to `_LIGHT`, if no more comes back then: in a medium that does not vary, and goes on to one side at
    least along each other axis. Layers that choose themselves choose this, too.

    It follows from what each of several processes knows.
    """
    if near.model.order == 1 or near.weakest != near.strongest:
        return around
    found = dict(around.layers)
    known: dict[tuple[Side, Stencil, float], Layer] = {}  # sides that are alike have the same layer
    for key, boundary in around.sides.items():
        layer = found.get(key)
        if layer is None or not _may_be_light(boundary, layer) or not spreads(around.sides, key[0]):
            continue
        squared, first = around.coefficients[key], 0 if near.stencil.same_along(0, key[0]) else key[0]
        stencil = near.stencil.along(first).beside(squared / near.model.coefficient)
        alike = boundary, stencil, squared
        if alike not in known:
            known[alike] = _light_if_quiet(layer, stencil, squared, near)
        found[key] = known[alike]
    return replace(around, layers=found)


def _may_be_light(boundary: Side, layer: Layer) -> bool:
    """Whether a side has a filter, by its nodes, and enough is known of what is asked to do without it."""
    by_nodes = boundary.profile is None and not boundary.open_ended
    return layer.filtered and by_nodes and (boundary.target or 0.0) >= _LIGHT


def _light_if_quiet(layer: Layer, stencil: Stencil, squared: float, near: NearField) -> Layer:
    """The layer with light dampers, or itself where it has none, or more would come back."""
    light = lightly_tuned(layer, stencil, float(np.sqrt(squared)) / near.lattice.spacing, near.dt)
    if light is None:
        return layer
    # without the damping of the model, which takes of both alike
    recursion = Recursion.of(near.model.integrator, near.dt)
    medium = LatticeMedium(stencil, squared, near.lattice.spacing, recursion, near.dt)
    return light if as_quiet(light, layer, medium) else layer


def _may_be_short(near: NearField, sides: Sides) -> bool:
    """Whether six digits are enough for what layers remember: in space, where steps wait for it, if no side is asked
    for less than `_SHORT` a crossing.

    What is dropped pushes the medium beside a layer, now one way and now the other, and a push remains as a velocity:
    what it adds grows with the length of the run.
    """
    absorbing = [b for b in sides.values() if b.stretched or b.derivatives]
    asked = [b for b in absorbing if b.target is not None or b.open_ended]
    if near.lattice.dim < 3 or not asked or len(asked) < len(absorbing):
        return False
    crossings = ((b.until or CROSSINGS * near.crossing) / near.crossing for b in asked)
    return all(b.wanted(near.model.target) >= _SHORT * n for b, n in zip(asked, crossings, strict=True))


def with_one_filter(layers: Mapping[Key, Layer], rate: float, dt: float, dim: int) -> dict[Key, Layer]:
    """The layers of a run, which share the longest of their filters, and how often it is applied.

    A weak damping of short waves is made up for in every second step, if no wave turns by a quarter of a period in a
    step: at a quarter a standing wave might be without velocity whenever it is looked at, and beyond it the frequencies
    of the filter and of waves would differ by those of other waves. More than one axis is needed, for the analysis of a
    line takes a step as it is.

    Parameters
    ----------
    layers : mapping of (axis, side) to Layer
        Those that know already how often, as on a process which has some of them, go on with that.
    rate : float
        Largest squared frequency.
    dt : float
    dim : int
    """
    damped = [layer for layer in layers.values() if layer.filtered]
    if not damped:
        return dict(layers)
    whole, taps = any(layer.whole for layer in damped), max((layer.taps for layer in damped), key=len)
    most = 2 * dim * dt * max(float(layer.damping.max()) for layer in damped)
    turn = float(np.arcsin(min(1.0, dt * np.sqrt(rate) / 2)) / np.pi)
    seldom = dim > 1 and not whole and most <= _LITTLE and turn <= _TURN
    every = max(layer.every for layer in damped) or 1 + seldom
    return {
        key: replace(layer, taps=taps, whole=whole, every=every) if layer.filtered else layer
        for key, layer in layers.items()
    }


class _AtSide(NamedTuple):
    """What diffuses to a side.

    Attributes
    ----------
    spacing : float
    spread : float
        Diffusivity times the length of the run.
    planes : list of Planes
    wall : Wall or None
        At the other end.
    alternate : callable
        What a layer sends back of waves that alternate from step to step.
    """

    spacing: float
    spread: float
    planes: list[Planes]
    wall: Wall | None
    alternate: Callable[[Layer], float]

    def returned(self, layer: Layer) -> tuple[float, float]:
        """Errors that a layer is predicted to make: of what diffuses, and of what alternates."""
        error = predicted_for_diffusion(layer, self.spacing, self.spread, self.planes, self.wall)
        return error, self.alternate(layer)

    def thinnest(self, wanted: float) -> Thickness:
        """The thinnest layer that keeps an error, as far as one does."""
        return thinnest_for_diffusion(self.spacing, self.spread, self.planes, wanted, self.wall, self.alternate)


@dataclass(frozen=True)
class _Choice:
    """A choice that goes on.

    Attributes
    ----------
    found : dict of (axis, side) to Thickness
    missed : dict
        Names of the sides whose layers may miss their targets, by what is said of them, nodes and target.
    followed : set of (axis, side)
        Sides to which waves that run backward are followed.
    """

    driven: Driven
    near: NearField
    around: Surroundings
    found: dict[Key, Thickness]
    missed: dict[tuple[str, int, float], list[str]]
    followed: set[Key]

    def for_waves(self, layers: Sides) -> None:
        """By what the layers send back of the data until the end of the run, or by a formula."""
        near, around, model = self.near, self.around, self.near.model
        crossing = near.crossing
        lengths = {key: min(b.until or CROSSINGS * crossing, MOST_CROSSINGS * crossing) for key, b in layers.items()}
        # a formula looks at no course in time, and knows no reaction
        slow = bool(near.stencil.strongest_reaction)
        watched = max((lengths[key] for key, b in layers.items() if b.target is not None or slow), default=0.0)
        far = self._returned_waves(watched, layers)
        refused: list[NotKept] = []
        for key, boundary in layers.items():
            wanted, until = boundary.wanted(model.target), lengths[key]
            if far.waves.follows_backward_waves:
                self.followed.add(key)
            if boundary.open_ended:
                try:
                    found = far.layer(*key, boundary, wanted, until)
                except NotKept as refusal:
                    refused.append(refusal)
                    continue
                if found is not None:
                    self._take(key, found, wanted)
            else:
                layer = around.layers[key]
                error = far.returned(*key, layer, wanted, min(until, far.foreseen))
                if error > wanted:
                    self._miss(key, _SENT_BACK.format(error, "the largest value"), layer.columns, wanted)
        if refused:  # what one side keeps another one may not
            raise max(refused, key=lambda one: one.least)

    def _returned_waves(self, watched: float, layers: Sides) -> ReturnedWaves:
        """What layers send back of the data, with the course of sources up to a time."""
        near, model, driven = self.near, self.near.model, self.driven
        sent = driven.data(driven.times(watched))
        data = [datum for datum in sent if datum.kind != "source" or datum.time.any()]
        least = min(b.wanted(model.target) for b in layers.values())
        waves = WaveField(
            near.lattice.shape,
            near.stencil,
            model.coefficient,
            self.around.coefficients,
            near.lattice.spacing,
            Recursion.of(model.integrator, near.dt, model.damping),
            near.dt,
            self.around.sides,
            data or stand_ins(*driven.like_near_field, driven.courses(watched, least)),
            driven.scatterers(),
            near.squared_speed,
            known=bool(data),
        )
        return ReturnedWaves(waves, FORESEEN * near.crossing, self.foreseeable)

    def returned(self, layers: Sides, until: float) -> dict[Key, float]:
        """Errors that the layers of some sides are predicted to make up to a time that can be foreseen."""
        target, given = self.near.model.target, self.around.layers
        if self.near.model.order == 1:
            at_side = self._diffusing(until)
            return {key: max(at_side(key, until, b.wanted(target)).returned(given[key])) for key, b in layers.items()}
        far = self._returned_waves(until, layers)
        with _told_if_it_takes_long(_PREDICTED):
            return {key: far.returned(*key, given[key], b.wanted(target), until) for key, b in layers.items()}

    @property
    def foreseeable(self) -> float:
        """Time up to which errors are predicted."""
        near = self.near
        most = MOST_CROSSINGS * near.crossing
        if near.model.order == 1:
            return most
        return min(most, foreseen_time(near.crossing, near.dt, near.stencil, near.lattice.shape))

    def unforeseen(self, layers: Sides) -> list[str]:
        """What is to be said of short waves in the data that predictions leave out: those that run backward, of vectors
        and in a medium that varies, and those that a step of diffusion near its limit hardly damps.

        Raises
        ------
        InputError
            Scalar data have more of them than the target of a layer that chooses for itself.
        """
        near, model = self.near, self.near.model
        if model.order == 1:
            first = self._kept_alive()
            say = "which a step so close to its limit hardly damps, and which layers for diffusion do not absorb"
            remedy = f"dt <= {0.6 * near.step_limit:.3g} or smoother data"
        else:
            damped = high_pass(near.stencil)
            first = None if damped is None or weak(damped) else damped.first
            say = "some of which run backward in this medium, which predictions do not include"
            remedy = "smoother data, another influence or Extended"
            layers = {
                key: b for key, b in layers.items() if key not in self.followed or not (key in self.found or b.target)
            }
        if first is None or not layers:
            return []
        share = max((short_share(datum.values, first) for datum in self.driven.initial()), default=0.0)
        say = f"{share:.2g} of the data are waves of less than {2 * np.pi / first:.2g} nodes, {say}"
        asked = [b.target for b in layers.values() if b.target is not None and b.open_ended]
        if near.stencil.components == 1 and share > min(asked, default=np.inf):
            raise InputError(
                say,
                value=min(asked),
                limit=f">= {share:.1g}",
                key="boundary.target",
                remedy=f"{remedy}; nodes instead of the target, and 'farhorizon compare' for the error",
            )
        wanted = min(b.wanted(model.target) for b in layers.values())
        words = f"{say}: layers may reflect more than the target {wanted:g}; {remedy} would meet it"
        return [f"{words}, 'farhorizon compare' measures the error"] if share > wanted else []

    def _kept_alive(self) -> float | None:
        """The least wavenumber times spacing that a step of diffusion hardly damps, although it damps longer waves
        more; of forward Euler those that were followed are not meant.
        """
        radius, growth = growth_of_waves(self.near)
        alive = np.abs(growth) > (FOLLOWED if self.near.model.integrator.alternates else _ALIVE)
        alive &= radius > radius.ravel()[np.abs(growth).argmin()]
        return float(radius[alive].min()) if alive.any() else None

    def for_diffusion(self, layers: Sides) -> None:
        """What counts is the way from the data, the metal or a condition to the side."""
        near, model = self.near, self.near.model
        lengths = {
            key: min(b.until or LASTING * near.crossing, MOST_CROSSINGS * near.crossing) for key, b in layers.items()
        }
        diffusing = self._diffusing(max(lengths.values(), default=0.0))
        refused: list[NotKept] = []
        for key, boundary in layers.items():
            wanted = boundary.wanted(model.target)
            at_side = diffusing(key, lengths[key], wanted)
            if not boundary.open_ended:
                given = self.around.layers[key]
                error, back = at_side.returned(given)
                if back > wanted:
                    self._miss_alternating(key, boundary, back, given, wanted)
                if error > wanted:
                    self._miss(key, _SENT_BACK.format(error, "the largest value at that time"), given.columns, wanted)
                continue
            found = at_side.thinnest(wanted)
            if found.predicted > wanted and boundary.target is not None:
                refused.append(NotKept.of(wanted, found.predicted))
                continue
            if (back := at_side.alternate(found.layer)) > wanted:
                self._miss_alternating(key, boundary, back, found.layer, wanted)
            self._take(key, replace(found, until=lengths[key]), wanted)
        if refused:  # as of waves
            raise max(refused, key=lambda one: one.least)

    def _diffusing(self, longest: float) -> Callable[[Key, float, float], _AtSide]:
        """What diffuses to a side up to a time, of which an error is wanted, in runs no longer than one."""
        near, spacing, sides = self.near, self.near.lattice.spacing, self.around.sides
        causes = list(self.driven.causes(longest, sides))
        at_once = [cause.datum for cause in causes if cause.whole or cause.lasting]
        alternating = AlternatingWaves.of(near, sides, at_once)

        def at_side(key: Key, until: float, wanted: float) -> _AtSide:
            image, across = sides[key[0], -key[1]].image, near.lattice.shape[key[0]]
            return _AtSide(
                spacing,
                near.model.coefficient * near.strongest * until,
                [part for cause in causes for part in cause.planes(*key, spacing)],
                Wall(image, spacing * across) if image else None,
                partial(alternating.returned, *key, wanted=wanted, until=until),
            )

        return at_side

    def _miss_alternating(self, key: Key, boundary: LatticePML, back: float, layer: Layer, wanted: float) -> None:
        """Say that a layer sends back more of waves that alternate than it may.

        Raises
        ------
        InputError
            It chose itself for a target.
        """
        say = "waves alternate from step to step, which a step so close to its limit hardly damps"
        remedy = f"dt <= {0.6 * self.near.step_limit:.3g} or smoother data"
        if boundary.open_ended and boundary.target is not None:
            raise InputError(
                f"no layer meets the target: {say}",
                value=wanted,
                limit=f">= {back:.1g}",
                key="boundary.target",
                remedy=f"{remedy}; nodes instead of the target, and 'farhorizon compare' for the error",
            )
        words = f"layers of {{}} nodes ({{}}) reflect {back:.1g} of the largest value, more than the target {{:g}}"
        self._miss(key, f"{words}: {say}; {remedy}", layer.columns, wanted)

    def _take(self, key: Key, found: Thickness, wanted: float) -> None:
        """Give a side the layer that was found for it."""
        self.found[key] = found
        if found.predicted > wanted:
            words = "the run is long: layers of {} nodes ({}) may miss the target {:g}"
            self._miss(key, words, found.layer.columns, wanted)

    def _miss(self, key: Key, words: str, columns: int, wanted: float) -> None:
        self.missed.setdefault((words, columns, wanted), []).append(side_name(*key))
