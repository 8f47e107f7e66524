"""Choice of the layers whose thickness is not given, from the data, the shape and the length of a run."""

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

# length of a run if it is not known: in crossings of the near field for waves, in R^2/diffusivity for diffusion
CROSSINGS, LASTING = 20, 10
MOST_CROSSINGS = 1000  # longest run for which layers are designed, as far as measurements go
# numbers of nodes of layers until whose return slow waves of solids are followed: one after the other, until the layer
# that is found is no thicker
_THICK = 16, 32, MOST
# Predicted over actual reflection where a free side meets a layer: predictions treat the free side as a mirror, but
# bonds are absent there, and surface waves travel along it.
_BESIDE_FREE = 0.4
_LEFT_OUT = 1.1  # margin on the smallest target that is kept, because fewer waves are followed for a larger target


def spreads(sides: Mapping[tuple[int, int], Side], axis: int) -> bool:
    """Whether the medium continues beyond at least one side along every axis other than this one.

    Between two walls, and along a periodic axis, waves near their cut-off hardly move towards a side and return again
    and again, and some waves of plates run backward even at low frequencies: in thin layers they grow by 0.01
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
        The layers with a given number of nodes, by name.
    beside : callable
        The additional reflection of a layer beside walls, times the share.
    share : float
        Predicted over actual reflection, by which a wanted error is multiplied.
    """

    members: Callable[[int], Mapping[str, Layer]]
    beside: Callable[[Layer], float]
    share: float


@dataclass(frozen=True)
class ReturnedWaves:
    """Choice of the layers of a wave field by their predicted reflection.

    Attributes
    ----------
    waves : WaveField
    soon : float
        Length of run beyond which the formula decides, where it applies.
    foreseen : float
        Time up to which errors are predicted.
    """

    waves: WaveField
    soon: float = np.inf
    foreseen: float = np.inf
    # for each group of equivalent sides: its layer, or the smallest target that a layer keeps if none keeps the wanted
    # one
    _known: dict[tuple[object, ...], Thickness] = field(default_factory=dict)
    _least: dict[tuple[object, ...], float] = field(default_factory=dict)

    @one_blas_thread()
    def layer(self, axis: int, side: int, boundary: LatticePML, wanted: float, until: float) -> Thickness | None:
        """Return the thinnest layer of one side that is predicted to keep an error up to the end of a run.

        A side without a target of its own gets the layer of a formula, which takes no time, or None if the formula does
        not apply; so does a side with a target in a long run, if the formula keeps it. The formula includes no
        reaction, with which waves may be arbitrarily slow. The result states the length of run for which it holds. None
        is also returned if another side keeps only a larger target and this side keeps that one: such a run is refused.

        Raises
        ------
        NotKept
            No layer keeps the error.
        """
        waves, medium = self.waves, self.waves.media(axis, side)[0]
        data = [datum.values for datum in waves.turned(axis, side, medium)]
        if not medium.stencil.strongest_reaction and (boundary.target is None or until > self.soon):
            found = by_formula(medium.stencil, medium.speed / waves.spacing, until, data, wanted)
            if found is None and boundary.target is None:
                return None
            if found is not None and (boundary.target is None or found.predicted <= wanted):
                # the error it is designed for, because the bound is too pessimistic for waves of a few nodes
                return replace(found, predicted=wanted)
        until = min(until, self.foreseen)
        alike = boundary, *waves.alike(axis, side, until, wanted)
        if alike in self._known:
            return self._known[alike]
        candidates = self._candidates(axis, side, boundary, wanted, until, distance_to_side(data))
        refused = max(self._least.values(), default=0.0)
        if refused > wanted:  # the run is refused; the message has to name the side that keeps the least
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
        """Return the layers among which that of a side is chosen, for data at a distance from it in nodes."""
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
            return share * self._beside_walls(axis, side, until, layer)  # its trials include free sides

        return _Candidates(members, beside, share)

    def _thinnest(self, axis: int, side: int, wanted: float, until: float, candidates: _Candidates) -> Thickness:
        """Return the thinnest candidate that keeps an error, starting from the thickness found for another side.

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
            start, too_few = found.nodes, found.nodes - 1  # following more waves never makes the layer thinner
        assert found is not None
        return replace(found, predicted=found.predicted / share)

    def _least_kept(self, axis: int, side: int, until: float, candidates: _Candidates, about: float) -> float:
        """Return the smallest target that some layer keeps, or the estimate `about` of it if that is kept."""
        members, beside, share = candidates
        sent, size = self.waves.arriving(axis, side, until, about, MOST)
        if about in self._least.values() and keeps(members, sent, share * about, size, beside):
            return about
        return _LEFT_OUT * least(members, sent, size, beside) / share

    @one_blas_thread()
    def returned(self, axis: int, side: int, layer: Layer, wanted: float, until: float) -> float:
        """Return the predicted error of a given layer of one side up to a time; waves that matter only for errors well
        below the wanted one are left out.
        """
        sent, size = self.waves.arriving(axis, side, until, wanted, layer.columns)
        return predicted_error(layer, sent, size) / self._share(axis) + self._beside_walls(axis, side, until, layer)

    def _share(self, axis: int) -> float:
        """Predicted over actual reflection along an axis."""
        return _BESIDE_FREE if any(side.image > 0 for side in self.waves.beside(axis)) else 1.0

    def _beside_walls(self, axis: int, side: int, until: float, layer: Layer) -> float:
        """Error that a layer with a filter makes beside walls, as fitted to trials: predictions do not include it."""
        waves = self.waves
        damped, walls = high_pass(waves.stencil), any(side.image for side in waves.beside(axis))
        if not walls or not layer.filtered or damped is None or damped.weak:
            return 0.0
        per_time = waves.media(axis, side)[0].speed / waves.spacing
        kept = max(waves.recursion.keep, 0.0) ** (0.5 / (per_time * waves.dt))
        turned = waves.turned_by_walls(axis)
        return lacking_beside_walls(layer, damped, waves.stencil, per_time * until, turned, kept)
