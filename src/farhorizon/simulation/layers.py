"""Choice of the layers of a set-up for its data and the length of its run, and assessment of those that are given."""

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

# message on layers whose number of nodes is given
_SENT_BACK = "layers of {{}} nodes ({{}}) are predicted to reflect {:.1g} of {}, more than the target {{:g}}"
_PATIENCE = 30.0  # seconds after which an unfinished choice or prediction is reported
_CHOSEN = "choosing or assessing these layers takes a minute or more; nodes without a target need no such time"
_PREDICTED = "predicting what these layers reflect in the continued run takes a minute or more"
_LITTLE = 0.3  # largest damping in two steps for which the filter is applied only in every second step
_TURN = 0.2  # and largest fraction of a period by which the fastest wave may advance in a step
# smallest target per crossing of the near field for which the layers' memory needs only six digits: under a persistent
# force the rounding adds up to 4e-6 per crossing, for pulses to a tenth of that
_SHORT = 1.5e-5
# rounding error in single precision relative to the largest value at the same time: of diffusion, which decays, and of
# waves
_ROUNDED = 1e-4, 2e-6
_LIGHT = 1e-5  # smallest target for light dampers, which reflect at most 2e-6 of a resolved pulse
_ALIVE = 0.75  # factor per step above which waves have not decayed when they reach a side


@contextmanager
def _told_if_it_takes_long(what: str) -> Iterator[None]:
    """Report on stderr what is being done if it takes long: following waves one by one would seem to hang."""
    timer = threading.Timer(_PATIENCE, print, [f"farhorizon: {what}"], {"file": sys.stderr, "flush": True})
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def looks_at_data(side: Side) -> bool:
    """Whether the layer of a side is chosen for the data, or assessed against a target; a `Layer` that is given whole,
    such as one chosen before, is used as it is.
    """
    return side.stretched and not side.whole and (side.open_ended or side.target is not None)


def choose_layers(setup: Setup, near: NearField, around: Surroundings, sources: Sequence[Any]) -> Surroundings:
    """Choose the thinnest layer that keeps the target for each side that leaves the choice, and assess given layers
    that have a target.

    Parameters
    ----------
    setup : Setup
    near : NearField
    around : Surroundings
        With the layers that are given or follow from their targets alone.
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


def undesigned(near: NearField, sides: Sides) -> str:
    """Return why layers for scalar waves without a target may reflect more than the model's default target; empty if
    they are made for it.

    The default layers are made for kernels that are symmetric about their axes and whose waves run forward. Backward
    waves are damped, so that nothing grows, but what is damped is also reflected.
    """
    asked = [side_name(*key) for key, b in sides.items() if b.stretched and b.target is None and not b.whole]
    if not asked or near.model.order == 1 or near.stencil.components > 1:
        return ""
    if not all(near.stencil.even_along(axis) for axis in range(near.lattice.dim)):
        why = "the kernel is not symmetric about its axes"
    elif not weak(high_pass(near.continued)):
        why = "short waves of this kernel run backward, and the layers damp them"
    else:
        return ""
    return (
        f"the layers ({', '.join(asked)}) have no target, and are not made for {near.model.target:g} of the largest "
        f"value: {why}; give a target, or measure with 'farhorizon compare'"
    )


def with_light_dampers(near: NearField, around: Surroundings) -> Surroundings:
    """Return the surroundings with light dampers in place of filters in layers for scalar waves that are given by their
    number of nodes and have a target of `_LIGHT` or more, if they reflect no more then, where the medium is uniform
    and continues beyond at least one side along every other axis. Layers that are chosen may have light dampers anyway.

    Each of several processes comes to the same result on its own.
    """
    if near.model.order == 1 or near.weakest != near.strongest:
        return around
    found = dict(around.layers)
    known: dict[tuple[Side, Stencil, float], Layer] = {}  # equivalent sides have the same layer
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
    """Whether a layer has a filter, is given by its number of nodes, and has a target of `_LIGHT` or more."""
    by_nodes = boundary.profile is None and not boundary.open_ended
    return layer.filtered and by_nodes and (boundary.target or 0.0) >= _LIGHT


def _light_if_quiet(layer: Layer, stencil: Stencil, squared: float, near: NearField) -> Layer:
    """Return the layer with light dampers, or the layer itself if it cannot have them or would reflect more."""
    light = lightly_tuned(layer, stencil, float(np.sqrt(squared)) / near.lattice.spacing, near.dt)
    if light is None:
        return layer
    # without the damping of the model, which affects both alike
    recursion = Recursion.of(near.model.integrator, near.dt)
    medium = LatticeMedium(stencil, squared, near.lattice.spacing, recursion, near.dt)
    return light if as_quiet(light, layer, medium) else layer


def _may_be_short(near: NearField, sides: Sides) -> bool:
    """Whether six digits are enough for the memory of the layers: in 3D, where reading it limits the speed, if every
    absorbing side has a target of at least `_SHORT` per crossing.

    Rounding acts as random pushes on the medium beside a layer. A push leaves a velocity behind, so the error grows
    with the length of the run.
    """
    absorbing = [b for b in sides.values() if b.stretched or b.derivatives]
    asked = [b for b in absorbing if b.target is not None or b.open_ended]
    if near.lattice.dim < 3 or not asked or len(asked) < len(absorbing):
        return False
    crossings = ((b.until or CROSSINGS * near.crossing) / near.crossing for b in asked)
    return all(b.wanted(near.model.target) >= _SHORT * n for b, n in zip(asked, crossings, strict=True))


def with_one_filter(layers: Mapping[Key, Layer], rate: float, dt: float, dim: int) -> dict[Key, Layer]:
    """Return the layers of a run with the longest of their filters in common, and with how often it is applied.

    If the damping of short waves is weak, the filter is applied in every second step only, provided that no wave
    advances by a quarter of a period in a step: at a quarter, a standing wave might have no velocity whenever the
    filter is applied, and beyond it the filter would alias waves of different frequencies. In 1D it is applied in every
    step, as the analysis of a line assumes.

    Parameters
    ----------
    layers : mapping of (axis, side) to Layer
        If some already state how often, as on a process that received them, that is kept.
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
    """Diffusion towards a side.

    Attributes
    ----------
    spacing : float
    spread : float
        Diffusivity times the length of the run.
    planes : list of Planes
    wall : Wall or None
        At the opposite side.
    alternate : callable
        Error that a layer makes of waves that alternate from step to step.
    """

    spacing: float
    spread: float
    planes: list[Planes]
    wall: Wall | None
    alternate: Callable[[Layer], float]

    def returned(self, layer: Layer) -> tuple[float, float]:
        """Return the predicted errors of a layer: for diffusion, and for waves that alternate from step to step."""
        error = predicted_for_diffusion(layer, self.spacing, self.spread, self.planes, self.wall)
        return error, self.alternate(layer)

    def thinnest(self, wanted: float) -> Thickness:
        """Return the thinnest layer that keeps an error; if none does, the best one."""
        return thinnest_for_diffusion(self.spacing, self.spread, self.planes, wanted, self.wall, self.alternate)


@dataclass(frozen=True)
class _Choice:
    """A choice of layers in progress.

    Attributes
    ----------
    found : dict of (axis, side) to Thickness
    missed : dict
        Names of the sides whose layers may miss their targets, by message, number of nodes and target.
    followed : set of (axis, side)
        Sides to which backward waves are followed.
    """

    driven: Driven
    near: NearField
    around: Surroundings
    found: dict[Key, Thickness]
    missed: dict[tuple[str, int, float], list[str]]
    followed: set[Key]

    def for_waves(self, layers: Sides) -> None:
        """Choose and assess layers for waves, by their predicted reflection of the data up to the end of the run or by
        a formula.
        """
        near, around, model = self.near, self.around, self.near.model
        crossing = near.crossing
        lengths = {key: min(b.until or CROSSINGS * crossing, MOST_CROSSINGS * crossing) for key, b in layers.items()}
        # the formula needs no time dependence of sources, but does not include a reaction
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
        if refused:  # the largest, because the run needs a target that all sides keep
            raise max(refused, key=lambda one: one.least)

    def _returned_waves(self, watched: float, layers: Sides) -> ReturnedWaves:
        """Return the choice by returned waves, with the time dependence of sources up to a time."""
        near, model, driven = self.near, self.near.model, self.driven
        sent = driven.data(driven.times(watched))
        data = [datum for datum in sent if datum.kind != "source" or datum.time.any()]
        least = min(b.wanted(model.target) for b in layers.values())
        waves = WaveField(
            near.lattice.shape,
            near.continued,
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
        """Return the predicted errors of the layers of some sides up to a time, at most `foreseeable`."""
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
        """Return notes on short waves in the data that predictions leave out: backward waves where they are not
        followed, and waves that a step of diffusion near its limit hardly damps.

        Raises
        ------
        InputError
            Scalar data hold more of them than the target of a layer that is chosen.
        """
        near, model = self.near, self.near.model
        if model.order == 1:
            first = self._kept_alive()
            say = "which a step so close to its limit hardly damps, and which layers for diffusion do not absorb"
            remedy = f"dt <= {0.6 * near.step_limit:.3g} or smoother data"
        else:
            damped = high_pass(near.continued)
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
        """Smallest wavenumber times spacing above that of the strongest damping which a step of diffusion hardly
        damps; None if there is none. With forward Euler, waves that are followed do not count.
        """
        radius, growth = growth_of_waves(self.near)
        alive = np.abs(growth) > (FOLLOWED if self.near.model.integrator.alternates else _ALIVE)
        alive &= radius > radius.ravel()[np.abs(growth).argmin()]
        return float(radius[alive].min()) if alive.any() else None

    def for_diffusion(self, layers: Sides) -> None:
        """Choose and assess layers for diffusion, by the distances from data, metal and conditions to the sides."""
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
        if refused:  # as for waves
            raise max(refused, key=lambda one: one.least)

    def _diffusing(self, longest: float) -> Callable[[Key, float, float], _AtSide]:
        """Return a function of side, length of the run and wanted error, for the diffusion to that side in runs no
        longer than `longest`.
        """
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
        """Report that a layer reflects too much of the waves that alternate from step to step.

        Raises
        ------
        InputError
            The layer was chosen for a target of its own.
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
        """Keep the layer found for a side, and report if it may miss its target."""
        self.found[key] = found
        if found.predicted > wanted:
            words = "the run is long: layers of {} nodes ({}) may miss the target {:g}"
            self._miss(key, words, found.layer.columns, wanted)

    def _miss(self, key: Key, words: str, columns: int, wanted: float) -> None:
        self.missed.setdefault((words, columns, wanted), []).append(side_name(*key))
