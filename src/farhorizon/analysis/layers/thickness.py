"""The thinnest lattice PML that keeps a wanted error, for the waves that a run has: by the error that
`farhorizon.analysis.layers.returned` predicts of each that is tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from farhorizon.analysis.layers.choice import crowded
from farhorizon.analysis.layers.returned import Arrivals
from farhorizon.engine.engine import Layer
from farhorizon.errors import InputError

# of the wanted error: at edges what two sides send back adds up, and the prediction knows one reflection
_AIM = 0.4
_AIM_CROWDED = 0.2  # of that, where waves that hardly move crowd
MOST = 60  # nodes of a layer
_NOT_WORTH = 16  # part of a layer that is not looked for any more
_CHECKED = 3  # quarters of a layer that are tried in any case: an error need not fall as it should
_SINGLY = 6  # nodes up to which all numbers are tried


@dataclass(frozen=True, repr=False)
class Thickness:
    """A layer and the error that it is predicted to make, or designed for.

    Attributes
    ----------
    name : str
        Of its profile.
    layer : Layer
    predicted : float
        Largest error at the side, relative to the largest of the data.
    until : float
        Length of the run that it is predicted for.
    designed : bool
        Whether a formula made the layer for that error, and nothing was predicted of these data.
    set_by : str
        In words, of what most comes back: it sets the thickness. Empty where a formula counts all waves alike.
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
    """Error that a layer makes of what arrives, relative to the largest of the data: of all types that a wave is turned
    into together. Where it is more than `enough`, something that is, too; by a rough look unless `closely`.
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
    """The fewest nodes with which some member of a family keeps an error at a side; of thick layers about a
    sixteenth more may be taken.

    Parameters
    ----------
    members : callable
        Layers of so many nodes, by name.
    waves : sequence of Arrivals
        What arrives there, each by itself.
    wanted : float
        Relative to `size`.
    size : float
        The largest of the data.
    beside : callable, optional
        What a layer sends back besides, at most, which no waves of the medium show.
    too_few : int, optional
        Nodes that are known to be.
    start : int, optional
        Nodes that are tried first where not each node counts, such as those of another side.

    Raises
    ------
    NotKept
        No layer of up to 60 nodes keeps it; the least that it names is a rough one.
    """
    aim = _aim(waves) * wanted
    scalar = waves[0].medium.stencil.components == 1
    low, high, found = too_few, MOST + 1, None
    error, reached = 1.0, 0.0  # of layers of so many nodes, the former roughly
    nodes = max(2, too_few + 1, start if start >= _SINGLY else 0)
    while found is None or (high - low > 1 and high - nodes > high // _NOT_WORTH):
        every = members(nodes)
        # of scalars: dampers take no box of all nodes, so that filters are for what these do not keep
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
    """Nodes to be tried between such as make an error above an aim and such as reach one below it, if some do: where a
    straight line in the logarithm says that the aim is just reached, but no more than three quarters of those that do
    as long as it is not known of so many.
    """
    if high > MOST:  # one by one where each node counts, and where fewer may do what some more do not
        return min(MOST, low + (1 if low < _SINGLY else low // 2))
    error, reached = max(error if np.isfinite(error) else np.inf, 1.1 * aim), max(reached, 1e-300)
    nodes = high - int((high - low) * np.log(aim / reached) / np.log(error / reached))
    checked = _CHECKED * high // 4
    return int(np.clip(min(nodes, checked) if low < checked else nodes, low + 1, max(low + 1, high - 1)))


def _quietest(members: Mapping[str, Layer], waves: Sequence[Arrivals]) -> tuple[str, Layer]:
    """The layer, with its name, that returns the least share of the waves."""
    if len(members) == 1:
        return next(iter(members.items()))
    return min(members.items(), key=lambda member: max(side.largest * side.share(member[1]) for side in waves))


def _aim(waves: Sequence[Arrivals]) -> float:
    """What waves may leave of a wanted error."""
    return _AIM * (_AIM_CROWDED if crowded(waves[0].medium.stencil) else 1.0)


def keeps(
    members: Callable[[int], Mapping[str, Layer]],
    waves: Sequence[Arrivals],
    wanted: float,
    size: float,
    beside: Callable[[Layer], float] = lambda layer: 0.0,
) -> bool:
    """Whether a layer of 60 nodes keeps an error; parameters as of `thinnest`."""
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
    """The smallest target that a layer of 60 nodes keeps; parameters as of `thinnest`."""
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
        The smallest target that one keeps.
    """

    least = np.inf

    @classmethod
    def of(cls, wanted: float, least: float) -> NotKept:
        """The refusal of a target, which names the smallest one that is kept."""
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
    """Size of fields along their first axis; of those that are anything."""
    amounts = [np.abs(field).reshape(len(field), -1).sum(1) for field in values]
    return [amount for amount in amounts if amount.any()]
