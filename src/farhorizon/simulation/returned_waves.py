"""The layers of a set-up whose thickness nobody gave: chosen for its data, its shape and the length of its run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from farhorizon.analysis.layers.beside_walls import lacking_beside_walls
from farhorizon.analysis.layers.families import by_formula, family
from farhorizon.analysis.layers.short_waves import high_pass
from farhorizon.analysis.layers.thickness import (
    MOST,
    NotKept,
    Thickness,
    distance_to_side,
    keeps,
    least,
    predicted_error,
    thinnest,
)
from farhorizon.boundaries import LatticePML, Side
from farhorizon.engine.engine import Layer
from farhorizon.machine import one_blas_thread
from farhorizon.simulation.wave_field import WaveField

# length of a run unless it is known: of waves in crossings of the near field, of diffusion in R^2/diffusivity
CROSSINGS, LASTING = 20, 10
MOST_CROSSINGS = 1000  # for which layers are made: what was measured
# nodes of layers from which slow waves of solids are followed until they are back, as far as it takes thicker ones
_THICK = 16, 32, MOST
# What is predicted over what comes back, where a free side runs into a layer: predictions take it for a mirror, but it
# lacks bonds, and waves run along it that are bound to it.
_BESIDE_FREE = 0.4
_LEFT_OUT = 1.1  # of the least target that is kept: for a larger one fewer waves are followed


def spreads(sides: Mapping[tuple[int, int], Side], axis: int) -> bool:
    """Whether a medium goes on to one side at least along each axis but this one.

    Between two walls, and where it repeats itself, waves near their cut-off hardly move towards a side and come back
    again and again, and those of plates run backward at low frequencies, too: in thin layers they grow by 0.01
    c/spacing.
    """
    others = {other for other, _ in sides} - {axis}
    open_to = {other for (other, _), b in sides.items() if not b.periodic and not b.image}
    return bool(others) and others <= open_to


class _Candidates(NamedTuple):
    """Layers among which that of a side is chosen.

    Attributes
    ----------
    members : callable
        Those of so many nodes, by name.
    beside : callable
        What one sends back beside walls, over the share.
    share : float
        Of a wanted error that counts here.
    """

    members: Callable[[int], Mapping[str, Layer]]
    beside: Callable[[Layer], float]
    share: float


@dataclass(frozen=True)
class ReturnedWaves:
    """The choice of the layers of a wave field by what they send back.

    Attributes
    ----------
    waves : WaveField
    soon, foreseen : float
        Times up to which errors are predicted: in runs longer than the first the formula decides where it serves.
    """

    waves: WaveField
    soon: float = np.inf
    foreseen: float = np.inf
    # of sides that are alike: their layers, and the least targets that layers keep of those that keep too little
    _known: dict[tuple[object, ...], Thickness] = field(default_factory=dict)
    _least: dict[tuple[object, ...], float] = field(default_factory=dict)

    @one_blas_thread()
    def layer(self, axis: int, side: int, boundary: LatticePML, wanted: float, until: float) -> Thickness | None:
        """The thinnest layer of one side that is predicted to keep an error to the end of a run.

        Where the side does not ask for one, that which a formula finds in no time, or None; the formula knows no
        reaction, with which waves may be as slow as they like. The layer says for how long a run it is. None, too,
        where another side keeps less and this one keeps what that does: such a run is refused.

        Raises
        ------
        NotKept
            No layer keeps it.
        """
        waves, medium = self.waves, self.waves.media(axis, side)[0]
        data = [datum.values for datum in waves.turned(axis, side, medium)]
        if not medium.stencil.strongest_reaction and (boundary.target is None or until > self.soon):
            found = by_formula(medium.stencil, medium.speed / waves.spacing, until, data, wanted)
            if found is None and boundary.target is None:
                return None
            if found is not None and (boundary.target is None or found.predicted <= wanted):
                # what it is designed for: of waves of a few nodes the bound tells too much
                return replace(found, predicted=wanted)
        until = min(until, self.foreseen)
        alike = boundary, *waves.alike(axis, side, until, wanted)
        if alike in self._known:
            return self._known[alike]
        candidates = self._candidates(axis, side, boundary, wanted, until, distance_to_side(data))
        refused = max(self._least.values(), default=0.0)
        if refused > wanted:  # of the run; a side that keeps less than others is the one to be named
            if boundary.target is not None and alike not in self._least:
                self._least[alike] = self._least_kept(axis, side, until, candidates, refused)
                if self._least[alike] > refused:
                    raise NotKept.of(wanted, self._least[alike])
            return None
        try:
            found = replace(self._thinnest(axis, side, wanted, until, candidates), until=until)
        except NotKept as refusal:
            if boundary.target is None:
                return None
            kept = self._least_kept(axis, side, until, candidates, refusal.least)
            self._least[alike] = max(_LEFT_OUT * wanted, kept)
            raise NotKept.of(wanted, self._least[alike]) from None
        self._known[alike] = found
        return found

    def _candidates(
        self, axis: int, side: int, boundary: LatticePML, wanted: float, until: float, distance: float
    ) -> _Candidates:
        """The layers of a side that may keep an error of data at a distance."""
        waves, media = self.waves, self.waves.media(axis, side)

        def steep(nodes: int) -> Layer:
            return replace(boundary, nodes=nodes).make_layer(
                2, media[0].stencil, media[0].coefficient, waves.spacing, 0.0
            )

        share = self._share(axis)
        dt = waves.dt if waves.squared_speed is None and spreads(waves.sides, axis) else None
        fastest, slowest = (medium.speed / waves.spacing for medium in (media[0], media[-1]))
        members = family(media[0].stencil, fastest, slowest, until, distance, share * wanted, dt, steep)

        def beside(layer: Layer) -> float:
            return share * self._beside_walls(axis, side, until, layer)  # known of free sides, too

        return _Candidates(members, beside, share)

    def _thinnest(self, axis: int, side: int, wanted: float, until: float, candidates: _Candidates) -> Thickness:
        """The thinnest of them that keeps an error; that of another side is tried first.

        Raises
        ------
        NotKept
            None does.
        """
        members, beside, share = candidates
        same = (found.nodes for (b, end, aim, *_), found in self._known.items() if (end, aim) == (until, wanted))
        start = max(same, default=0)
        before, found, too_few = None, None, 0
        for nodes in _THICK:
            if nodes < max(start, too_few + 1):
                continue
            sent, size = self.waves.arriving(axis, side, until, wanted, nodes)
            if sent is before:
                break
            before, found = sent, thinnest(members, sent, share * wanted, size, beside, too_few, start)
            if found.nodes <= nodes:
                break
            start, too_few = found.nodes, found.nodes - 1  # with more of the waves it takes no fewer
        assert found is not None
        return replace(found, predicted=found.predicted / share)

    def _least_kept(self, axis: int, side: int, until: float, candidates: _Candidates, about: float) -> float:
        """The smallest target that a layer keeps, which is about known, or that one if it is kept."""
        members, beside, share = candidates
        sent, size = self.waves.arriving(axis, side, until, about, MOST)
        if about in self._least.values() and keeps(members, sent, share * about, size, beside):
            return about
        return _LEFT_OUT * least(members, sent, size, beside) / share

    @one_blas_thread()
    def returned(self, axis: int, side: int, layer: Layer, wanted: float, until: float) -> float:
        """Error that a given layer of one side is predicted to make up to a time, told from none where it is near the
        wanted one or larger.
        """
        sent, size = self.waves.arriving(axis, side, until, wanted, layer.columns)
        return predicted_error(layer, sent, size) / self._share(axis) + self._beside_walls(axis, side, until, layer)

    def _share(self, axis: int) -> float:
        """What is predicted to come back along an axis, over what does."""
        return _BESIDE_FREE if any(side.image > 0 for side in self.waves.beside(axis)) else 1.0

    def _beside_walls(self, axis: int, side: int, until: float, layer: Layer) -> float:
        """What a layer that damps short waves lacks beside walls, from trials: predictions do not know of it."""
        waves = self.waves
        damped, walls = high_pass(waves.stencil), any(side.image for side in waves.beside(axis))
        if not walls or not layer.filtered or damped is None or damped.weak:
            return 0.0
        way = waves.media(axis, side)[0].speed / waves.spacing * until
        return lacking_beside_walls(layer, damped, waves.stencil, way, waves.as_fast_as_backward)
