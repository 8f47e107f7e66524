"""The thinnest lattice PML that keeps a target error for the waves of a run, by the error that
`farhorizon.analysis.layers.returned` predicts for each candidate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from farhorizon.analysis.layers.choice import crowded
from farhorizon.analysis.layers.returned import Arrivals
from farhorizon.engine.engine import Layer
from farhorizon.errors import InputError

# part of the target error: at edges the reflections from two sides add up, and the prediction covers one reflection
_AIM = 0.4
_AIM_CROWDED = 0.2  # part of that where waves that hardly move crowd
MOST = 60  # largest number of nodes of a layer
_NOT_WORTH = 16  # the search ends where fewer nodes would save at most a sixteenth of them
_CHECKED = 3  # quarters of the nodes that are tried in any case: an error need not fall regularly
_SINGLY = 6  # number of nodes up to which every number is tried


@dataclass(frozen=True, repr=False)
class Thickness:
    """A layer and the error that is predicted for it, or for which it is designed.

    Attributes
    ----------
    name : str
        Name of its profile.
    layer : Layer
    predicted : float
        Largest error at the side, relative to the largest of the data.
    until : float
        Length of the run for which it is predicted.
    designed : bool
        Whether a formula gave the layer for that error, without a prediction for these data.
    set_by : str
        Description of the waves that are reflected most and therefore determine the thickness. Empty where a formula
        treats all waves alike.
    """

    name: str
    layer: Layer
    predicted: float
    until: float = np.inf
    designed: bool = False
    set_by: str = ""

    @property
    def nodes(self) -> int:
        """Thickness of the layer in nodes."""
        return self.layer.columns

    def __repr__(self) -> str:
        return f"Thickness({self.nodes} nodes, {self})"

    def __str__(self) -> str:
        known = "designed for an error of" if self.designed else "predicted error"
        most = f", set by {self.set_by}" if self.set_by else ""
        return (
            f"{self.name} profile, {known} {self.predicted:.1g} of the largest value up to t = {self.until:.6g}{most}"
        )


def predicted_error(
    layer: Layer, waves: Sequence[Arrivals], size: float, enough: float = np.inf, closely: bool = False
) -> float:
    """Error of a layer for the waves that arrive, relative to the largest of the data: the largest over the sets of
    waves, each with all types that are reflected. Above `enough` the value is rough, but also above it, unless
    `closely`.
    """
    found = []
    for side in waves:
        found.append(float(side.returned(layer, enough * size, closely) / size))
        if not found[-1] <= enough:
            break
    return float(np.max(found))


def thinnest(
    members: Callable[[int], Mapping[str, Layer]],
    waves: Sequence[Arrivals],
    wanted: float,
    size: float,
    beside: Callable[[Layer], float] = lambda layer: 0.0,
    too_few: int = 0,
    start: int = 0,
) -> Thickness:
    """The layer with the fewest nodes with which some member of a family keeps an error at a side; thick layers may
    have about a sixteenth more.

    Parameters
    ----------
    members : callable
        Layers with a given number of nodes, by name.
    waves : sequence of Arrivals
        What arrives at the side, each treated separately.
    wanted : float
        Target error, relative to `size`.
    size : float
        The largest of the data.
    beside : callable, optional
        Upper estimate of what a layer reflects in addition, which the waves of the medium do not show.
    too_few : int, optional
        A number of nodes known to be insufficient.
    start : int, optional
        Number of nodes to try first, such as that of another side; ignored if it is small, where every number is tried.

    Raises
    ------
    NotKept
        No layer of up to 60 nodes keeps it; the smallest target that it names is a rough one.
    """
    aim = _aim(waves) * wanted
    scalar = waves[0].medium.stencil.components == 1
    low, high, found = too_few, MOST + 1, None
    error, reached = 1.0, 0.0  # errors at `low` and `high` nodes, the former a rough one
    nodes = max(2, too_few + 1, start if start >= _SINGLY else 0)
    while found is None or (high - low > 1 and high - nodes > high // _NOT_WORTH):
        every = members(nodes)
        # for scalars dampers come first, as they need no box of all nodes; filters where dampers do not keep the error
        light = {name: one for name, one in every.items() if one.tuned.size} if scalar else {}
        for some in filter(None, (light, {name: one for name, one in every.items() if name not in light})):
            name, layer = _quietest(some, waves)
            predicted, more = predicted_error(layer, waves, size, aim, closely=nodes == MOST), beside(layer)
            if predicted <= aim and predicted + more <= wanted:
                high, found, reached = nodes, Thickness(name, layer, predicted + more), predicted
                break
        if high > nodes:
            if nodes == MOST:
                raise NotKept.of(wanted, max(predicted / _aim(waves), predicted + more))
            low, error = nodes, predicted
        nodes = _next(low, error, high, reached, aim)
    return replace(found, set_by=max(side.strongest(found.layer) for side in waves)[1])


def _next(low: int, error: float, high: int, reached: float, aim: float) -> int:
    """The next number of nodes to try, between `low`, with which the error is above the aim, and `high`, with which it
    is below it if any such number is known. Interpolated linearly in the logarithm of the error, but at most three
    quarters of `high` as long as these have not been tried.
    """
    if high > MOST:  # one by one where each node counts, then by half as many again
        return min(MOST, low + (1 if low < _SINGLY else low // 2))
    error, reached = max(error if np.isfinite(error) else np.inf, 1.1 * aim), max(reached, 1e-300)
    nodes = high - int((high - low) * np.log(aim / reached) / np.log(error / reached))
    checked = _CHECKED * high // 4
    return int(np.clip(min(nodes, checked) if low < checked else nodes, low + 1, max(low + 1, high - 1)))


def _quietest(members: Mapping[str, Layer], waves: Sequence[Arrivals]) -> tuple[str, Layer]:
    """The layer that reflects the smallest share of the waves, with its name."""
    if len(members) == 1:
        return next(iter(members.items()))
    return min(members.items(), key=lambda member: max(side.largest * side.share(member[1]) for side in waves))


def _aim(waves: Sequence[Arrivals]) -> float:
    """Part of a target error that the prediction for the waves may reach."""
    return _AIM * (_AIM_CROWDED if crowded(waves[0].medium.stencil) else 1.0)


def keeps(
    members: Callable[[int], Mapping[str, Layer]],
    waves: Sequence[Arrivals],
    wanted: float,
    size: float,
    beside: Callable[[Layer], float] = lambda layer: 0.0,
) -> bool:
    """Whether a layer of 60 nodes keeps an error; parameters as for `thinnest`."""
    _, layer = _quietest(members(MOST), waves)
    aim = _aim(waves) * wanted
    predicted = predicted_error(layer, waves, size, aim, closely=True)
    return bool(predicted <= aim and predicted + beside(layer) <= wanted)


def least(
    members: Callable[[int], Mapping[str, Layer]],
    waves: Sequence[Arrivals],
    size: float,
    beside: Callable[[Layer], float] = lambda layer: 0.0,
) -> float:
    """The smallest target that a layer of 60 nodes keeps; parameters as for `thinnest`."""
    _, layer = _quietest(members(MOST), waves)
    predicted = predicted_error(layer, waves, size)
    return max(predicted / _aim(waves), predicted + beside(layer))


def _one_digit(value: float) -> float:
    """The value, rounded up to one digit."""
    digit = 10.0 ** np.floor(np.log10(max(value, 1e-300)))
    return float(np.ceil(value / digit - 1e-9) * digit)


class NotKept(InputError):
    """No layer of a side keeps a target.

    Attributes
    ----------
    least : float
        The smallest target that a layer keeps.
    """

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
            remedy="a larger target, smoother data, data farther from the side, another influence, or Extended, "
            "Exact or a Sponge",
        )
        refusal.least = least
        return refusal


def distance_to_side(values: Iterable[np.ndarray]) -> float:
    """Nodes between the side and all but a thousandth of the data; arrays with the normal first, towards the side."""
    held = [np.cumsum(amount) / amount.sum() for amount in along_normal(values)]
    return float(min((len(share) - 1 - int(np.searchsorted(share, 0.999)) for share in held), default=0))


def along_normal(values: Iterable[np.ndarray]) -> list[np.ndarray]:
    """Sums of absolute values along the first axis of fields, for those that are not zero."""
    amounts = [np.abs(field).reshape(len(field), -1).sum(1) for field in values]
    return [amount for amount in amounts if amount.any()]
