"""The thinnest layer that keeps a target, found with few trials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from farhorizon.analysis.layers.families import Family
from farhorizon.engine.engine import Layer
from farhorizon.errors import InputError
from farhorizon.rounding import MARGIN, TINY

MOST = 60  # largest number of nodes of a layer
# part of the target that the difference of two candidates may reach: it was 0.5 to 1.5 times the error of the thinner
# one in 200 comparisons with the infinite lattice
AIM = 0.5
#: Nodes of a reference over those of a candidate: with less, both may fail alike, so that their difference is less than
#: the error of either. Beside walls, what damped layers lack is in inverse proportion to their nodes: the difference
#: from twice as many is half of it.
APART, APART_SLOW = 4 / 3, 2.0
_FEWER = 8  # the search ends where fewer nodes would save at most an eighth of them
_HOPELESS = 1000  # a candidate is given up at so many times the aim: how much worse it is matters little
_MOST_AHEAD = 4  # largest factor on the nodes from one candidate to the next, since the error need not fall regularly


@dataclass(frozen=True, repr=False)
class Thickness:
    """A layer with the error that trial runs showed (nan without a trial), the lengths of the run and of the trials,
    and the cost of these over that of the run (nan if they were not made now).
    """

    name: str
    layer: Layer
    predicted: float
    until: float = np.inf
    tried: float = np.inf
    cost: float = np.nan

    @property
    def nodes(self) -> int:
        """Thickness of the layer in nodes."""
        return self.layer.columns

    def __repr__(self) -> str:
        return f"Thickness({self.nodes} nodes, {self})"

    def __str__(self) -> str:
        if np.isnan(self.predicted):
            return f"{self.name} profile, without a trial run"
        end = min(self.until, self.tried)
        return f"{self.name} profile, error in trial runs {self.predicted:.1g} of the largest value up to t = {end:.6g}"


def largest_error(thickness: Mapping[str, Thickness]) -> dict[str, str]:
    """What to say of the errors of layers, by side, under one heading; empty if nothing is known."""
    known = [side for side in thickness.values() if not np.isnan(side.predicted)]
    if not known:
        return {}
    worst = max(known, key=lambda side: side.predicted)
    end = min(worst.until, worst.tried)
    return {"error of the layers": f"{worst.predicted:.1g} of the largest value, in trial runs up to t = {end:.6g}"}


class Trials(Protocol):
    """Runs of a set-up with candidate layers."""

    def reference(self, family: Family, nodes: int) -> bool:
        """Run with layers of a family, and compare later candidates with it; False if that takes too long."""

    def error(self, family: Family, nodes: int, enough: float) -> float:
        """Largest difference of a run with layers of a family from the reference; above `enough`, a lower bound of it.
        Infinite if that takes too long.
        """


@dataclass(frozen=True)
class Candidate:
    """A candidate, its error (nan if unknown), and whether that is below the target."""

    family: Family
    nodes: int
    error: float
    kept: bool


def thinner(nodes: int, apart: float = APART) -> int:
    """The largest number of nodes that is compared with that of a reference."""
    return int(max(1, min(nodes - 1, nodes / apart)))


def thicker(nodes: int, apart: float = APART) -> int:
    """The smallest number of nodes of a reference for some nodes."""
    return next(n for n in range(nodes + 1, 3 * nodes + 3) if thinner(n, apart) >= nodes)


def thinnest(families: list[Family], trials: Trials, aim: float, start: int, apart: float = APART) -> Candidate:
    """The layer with the fewest nodes whose error is at most `aim`, to an eighth of the nodes, or the best one of up to
    60; a node more than the errors so far suggest if the time is up. The first reference has `start` nodes, others
    `apart` times those of a candidate.

    A candidate is judged by its difference from a reference, a thicker layer. If both are good, the difference is the
    error of the thinner one; if one of them is not, the difference is large.
    """
    most, thick, errors = thicker(MOST, apart), start, [(0, 1.0)]
    best = of_nodes(families, min(start, most))
    while True:
        thick = min(thick, most)
        reference = best if best.layer(thick) is not None else of_nodes(families, thick)
        likely = min(thinner(thick, apart) + 1, MOST)
        unknown = Candidate(of_nodes(families, likely), likely, np.nan, False)
        if not trials.reference(reference, thick):
            return unknown
        # of the thickest layers the error is told, however large it is
        enough = np.inf if thick == most else _HOPELESS * aim
        candidate = _first_below(families, trials, aim, thinner(thick, apart), enough)
        if candidate is None:
            return unknown
        if candidate.kept:
            return _refined(families, trials, aim, candidate)
        if thick == most:
            return candidate
        # from the thickest candidate: where all differ alike from the reference, the error is that of the reference
        errors.append((thinner(thick, apart), max(candidate.error, aim)))
        thick = int(np.clip(thicker(_likely(errors, aim, most), apart), thick + 1, _MOST_AHEAD * thick))
        best = candidate.family  # a reference of the worse family would hide how good the better one is


def _likely(errors: list[tuple[int, float]], aim: float, most: int) -> int:
    """The nodes with which the error falls to half of the aim, if it goes on to fall as in the last two rounds."""
    (before, larger), (nodes, error) = errors[-2:]
    fall = np.log(larger / error) / (nodes - before)
    missing = np.log(error / (aim / 2)) / fall if fall > 0 else most
    return nodes + int(np.ceil(min(missing, most)))


def of_nodes(families: list[Family], nodes: int) -> Family:
    """The first family with a layer of a number of nodes."""
    return next(family for family in families if family.layer(nodes) is not None)


def _first_below(families: list[Family], trials: Trials, aim: float, nodes: int, enough: float) -> Candidate | None:
    """The first candidate with at most some nodes whose error is below the aim, or else that with the smallest error,
    which need not be known above `enough`; None if there was no time for any.
    """
    best: Candidate | None = None
    for family in families:
        layer = family.thickest(nodes)
        if layer is None:
            continue
        error = trials.error(family, layer.columns, enough)
        if np.isinf(error):
            continue
        candidate = Candidate(family, layer.columns, error, error <= aim)
        if candidate.kept:
            return candidate
        if best is None or error < best.error:
            best = candidate
    return best


def _refined(families: list[Family], trials: Trials, aim: float, good: Candidate) -> Candidate:
    """The thinnest candidate that is below the aim, where one with more nodes is."""
    low, error = 1, 1.0
    families = families[families.index(good.family) :]  # those before it failed with more nodes
    while good.nodes - low > max(1, good.nodes // _FEWER):
        ahead = np.log(error / (aim / 2)) / np.log(max(error, 2 * aim) / max(min(good.error, aim / 2), TINY))
        # rather too thin, since trials of layers that miss end early
        nodes = int(np.clip(low + np.ceil((good.nodes - low) * min(ahead, 0.5)), low + 1, good.nodes - 1))
        candidate = _first_below(families, trials, aim, nodes, aim)
        if candidate is None:
            return good
        if candidate.kept:
            good = candidate
        else:
            low, error = nodes, candidate.error
    return good


class NotKept(InputError):
    """No layer keeps a target; `least` is the smallest one that a layer keeps."""

    least = np.inf

    @classmethod
    def of(cls, wanted: float, least: float) -> NotKept:
        """The refusal of a target, which names the smallest target that is kept."""
        least = _one_digit(least)
        refusal = cls(
            "no layer meets the target for these data",
            value=wanted,
            limit=f">= {least:.1g}",
            key="boundary.target",
            remedy="a larger target, smoother data, data farther from the side, another influence, or Auto or Extended",
        )
        refusal.least = least
        return refusal


def _one_digit(value: float) -> float:
    """The value, rounded up to one digit."""
    digit = 10.0 ** np.floor(np.log10(max(value, TINY)))
    return float(np.ceil(value / digit - MARGIN) * digit)
