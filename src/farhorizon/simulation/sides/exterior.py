"""Checks of what lies beyond the absorbing sides: data, sources and cracks there belong to the medium, but a truncated
run misses them.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from farhorizon.boundaries import Side
from farhorizon.errors import InputError, shown
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.geometry.shapes import Cut
from farhorizon.rounding import TINY

_FAR_NODES = 1_000_000  # most nodes at which data that vanish in the near field are sought farther out
_REACHES = 4  # depth in front of a side to which a material is examined
_FLAT = 1e-4  # relative change there that needs no note
# multiples of the extent of the near field, within which the largest value of data outside is sought
_FARTHER = (2, 4, 8, 16, 32)
_ROUNDING = float(np.finfo(float).eps)  # values below this part of the largest count as zero

Function = Callable[..., Any]
_Part = tuple[str, float, list[np.ndarray], np.ndarray]  # name, target, coordinates and existing nodes


class Exterior:
    """The medium beyond the absorbing sides. Fixed, free and periodic sides end it: nothing is missed there.

    Beyond sides that do not specify it, the fraction `wanted` of the largest value may be missed. `depth` is the number
    of nodes examined beyond each absorbing side. What lies around the nodes `near` of a window whose outline is closed
    by a condition is missed, too. `largest` returns the largest value of all processes that compute the run.
    """

    def __init__(
        self,
        lattice: Lattice,
        sides: dict[tuple[int, int], Side],
        target: float,
        depth: dict[tuple[int, int], int],
        near: np.ndarray | None = None,
        largest: Callable[[float], float] = float,
    ) -> None:
        self.lattice, self.depth, self.near, self._largest_of_all = lattice, depth, near, largest
        absorbing = {key: b for key, b in sides.items() if b.endless}
        self.targets = {key: b.wanted(target) for key, b in absorbing.items()}
        self.examines = bool(self.targets) or near is not None or largest is not float  # also with other processes
        self.notes: list[str] = []

    def but_for(self, sides: Iterable[tuple[int, int]]) -> Exterior:
        """Return a copy that does not check some of the sides; it adds its notes to the same list."""
        checks, left_out = copy.copy(self), set(sides)
        checks.targets = {key: target for key, target in self.targets.items() if key not in left_out}
        return checks

    def check_values(self, values: np.ndarray, key: str) -> None:
        """Note nonzero values at an absorbing edge, since what an array would be beyond it is unknown; refuse values
        around a closed window.
        """
        peak = float(np.abs(values).max(initial=0))
        at_edges = {}
        if self.near is not None:
            missed = float(np.abs(np.where(self.near, 0.0, values)).max(initial=0))
            if missed > max(self.targets.values()) * peak:
                raise InputError(
                    "not zero beyond the outline of the window, where the run would miss it",
                    value=f"{missed:.3g}",
                    limit=f"{max(self.targets.values()) * peak:.3g}",
                    key=key,
                    remedy="a larger window, or zeros there",
                )
            return
        for (axis, side), target in self.targets.items():
            edge = float(np.abs(np.take(values, 0 if side < 0 else -1, axis)).max(initial=0))
            if edge > target * peak:
                at_edges[_name(axis, side)] = edge / peak
        if at_edges:
            self.notes.append(
                f"{key} is an array with {max(at_edges.values()):.2g} of its largest value at an absorbing edge "
                f"({', '.join(at_edges)}): it is taken to be "
                "zero beyond, which cannot be checked"
            )

    def check_function(
        self, function: Function, peak: float, key: str, level: float = 0.0, missed: str = "value"
    ) -> None:
        """Check a function of the coordinates just beyond the absorbing sides, where it should be `level`.

        `peak` is its largest difference from that in the near field, and `missed` says in messages what it is the
        largest of. Raises InputError if more than a side's target of the largest value lies beyond it, or all of it
        does.
        """
        shares, peak = {}, self._largest_of_all(peak)
        for (name, target, coordinates, exists), values in self._evaluated(function):
            with np.errstate(all="ignore"):
                beyond = np.abs(np.where(exists, values - level, 0.0))
            worst = float(beyond.max(initial=0))
            share = worst / max(peak, worst, TINY) if np.isfinite(worst) else np.inf
            if not share <= target:
                if worst > peak and missed != "value":
                    self._refuse_outside(function, key, level, missed)
                where = shown([float(c[np.unravel_index(int(np.argmax(beyond)), beyond.shape)]) for c in coordinates])
                edge = "outline" if name == "outline" else f"side {name}"
                if not np.isfinite(worst):
                    raise InputError(
                        f"not finite beyond the absorbing {edge}, where the medium continues",
                        value=f"{worst:.3g} at {where}",
                        limit="no nan, no inf",
                        key=key,
                        remedy="where(condition, a, b) in an expression restricts it to where it is defined",
                    )
                raise InputError(
                    f"not {_named(level)} beyond the absorbing {edge}; the run would miss it: an error of about "
                    f"{share:.2g} of the largest {missed}",
                    value=f"{worst:.3g}{' off' * bool(level)} at {where}",
                    limit=f"{target * max(peak, worst):.3g} ({target:g} of the largest)",
                    key=key,
                    remedy="enlarge the near field, narrow or move what is given"
                    + (", set background to its value far away" if missed == "initial value" else ""),
                )
            if share > _ROUNDING:
                shares[name] = share
        if shares:
            self.notes.append(
                f"{key}: {max(shares.values()):.2g} of the largest {missed} lies beyond {', '.join(shares)} and is "
                "missed; below the target"
            )
        if peak == 0 and self.targets:
            self._seek(function, key, level)

    def _seek(self, function: Function, key: str, level: float) -> None:
        """Refuse a function that vanishes on every node of the near field, but not farther out."""
        most, where = self._largest(function, level)
        if most > 0:
            raise InputError(
                f"{_named(level)} on every node of the near field, and not beyond",
                value=f"{most:.3g}{' off' * bool(level)} near {where}",
                limit=_extent(self.lattice),
                key=key,
                remedy="move it inside or enlarge the near field",
            )
        self.notes.append(f"{key} is {_named(level)} on every node of the near field")

    def _refuse_outside(self, function: Function, key: str, level: float, missed: str) -> None:
        """Raise an InputError for a function that is larger beyond a side than anywhere in the near field."""
        most, where = self._largest(function, level)
        for times in _FARTHER:
            farther, place = self._largest(function, level, times)
            if not farther > most:
                break
            most, where = farther, place
        raise InputError(
            f"lies outside the near field: the largest {missed} is found beyond the absorbing sides",
            value=f"{most:.3g} near {where}",
            limit=_extent(self.lattice),
            key=key,
            remedy="move it inside or enlarge the near field",
        )

    def _largest(self, function: Function, level: float, times: int = 1) -> tuple[float, str]:
        """Return the largest magnitude of the function less the level, and its place, on a sample of the near field and
        of `times` its extent beyond each absorbing side.
        """
        lattice = self.lattice
        more = {key: times * lattice.shape[key[0]] for key in self.targets}
        lower, count = lattice.lower.copy(), np.array(lattice.shape)
        for (axis, side), nodes in more.items():
            lower[axis] -= lattice.spacing * nodes * (side < 0)
            count[axis] += nodes
        stride = max(1, int(np.ceil((np.prod(count.astype(float)) / _FAR_NODES) ** (1 / lattice.dim))))
        axes = [first + lattice.spacing * np.arange(0, n, stride) for first, n in zip(lower, count, strict=True)]
        coordinates = np.meshgrid(*axes, indexing="ij")
        with np.errstate(all="ignore"):
            sizes = np.nan_to_num(
                np.abs(np.asarray(function(*coordinates), float) - level) + np.zeros(coordinates[0].shape), nan=0.0
            )
        top = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
        return float(sizes[top]), shown([float(c[top]) for c in coordinates])

    def check_moving(self, source: Function, times: np.ndarray, peak: float, key: str = "source") -> float:
        """Check a source s(x, ..., t) at some times as `check_function` does; returns its largest magnitude in the near
        field at these times, and at earlier ones, at which it was `peak`.
        """

        def largest(*coordinates: np.ndarray) -> np.ndarray:
            zero = np.zeros(coordinates[0].shape)
            with np.errstate(all="ignore"):
                return np.max([np.abs(np.asarray(source(*coordinates, t), float)) + zero for t in times], axis=0)

        peak = max(peak, float(np.nanmax(largest(*self.lattice.coordinates()), initial=0)))
        self.check_function(largest, peak, key, missed="source value")
        return peak

    def check_cracks(self, cuts: Iterable[Cut], reach: Sequence[int]) -> None:
        """Refuse cracks that lie so far beyond the near field that they cut no bond of its nodes; raises InputError."""
        whole_lattice, slack = self.lattice.whole, self.lattice.spacing * np.array(reach)
        for cut in cuts:
            low, high = cut.bounds()
            if np.any(low > whole_lattice.upper + slack) or np.any(high < whole_lattice.lower - slack):
                raise InputError(
                    "the crack lies beyond the near field and cuts none of its bonds",
                    value=[b.tolist() for b in (low, high)],
                    limit=_extent(whole_lattice),
                    key="crack",
                    remedy="move it inside or enlarge the near field",
                )

    def _evaluated(self, function: Function) -> list[tuple[_Part, np.ndarray]]:
        """Return each part of the medium that is examined, and the values of a function there, which is called once."""
        parts = list(self._around())
        if not parts:
            return []
        shapes = [coordinates[0].shape for _, _, coordinates, _ in parts]
        along = zip(*(coordinates for _, _, coordinates, _ in parts), strict=True)
        places = [np.concatenate([values.ravel() for values in axis]) for axis in along]
        with np.errstate(all="ignore"):
            values = np.broadcast_to(np.asarray(function(*places), float), places[0].shape)
        pieces = np.split(values, np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1])
        return [(part, piece.reshape(shape)) for part, piece, shape in zip(parts, pieces, shapes, strict=True)]

    def _around(self) -> Iterator[_Part]:
        """Yield each part of the medium that is examined."""
        for (axis, side), target in self.targets.items():
            yield _name(axis, side), target, *self.strip(axis, side)
        if self.near is not None:
            yield "outline", max(self.targets.values()), self.lattice.coordinates(), ~self.near

    def strip(self, axis: int, side: int) -> tuple[list[np.ndarray], np.ndarray]:
        """Return the coordinates of the nodes beyond a side, corners included, and which of them exist (a body
        continues along the normal).
        """
        lattice, dx = self.lattice, self.lattice.spacing
        pads = [(self.depth.get((a, -1), 0), self.depth.get((a, 1), 0)) for a in range(lattice.dim)]
        axes = [
            lattice.lower[a] + dx * np.arange(-low, n + high)
            for a, (n, (low, high)) in enumerate(zip(lattice.shape, pads, strict=True))
        ]
        steps = dx * np.arange(1, self.depth[axis, side] + 1)
        axes[axis] = lattice.upper[axis] + steps if side > 0 else lattice.lower[axis] - steps
        coordinates = list(np.meshgrid(*axes, indexing="ij"))
        if lattice.existing is None:
            return coordinates, np.ones(coordinates[0].shape, bool)
        pads[axis] = (0, 0)
        edge = np.pad(np.take(lattice.existing, [0 if side < 0 else -1], axis), pads, mode="edge")
        return coordinates, np.broadcast_to(edge, coordinates[0].shape)


def changes(values: np.ndarray, what: str, sides: Iterable[tuple[int, int]], reach: Sequence[int]) -> list[str]:
    """Return notes on a medium that changes in front of absorbing sides, beyond which it continues along the normal as
    at the edge: gradually along the normal, or at an interface that runs into the side at an angle to the normal.

    A change is gradual if, within the last `_REACHES` reaches, values differ between more pairs of neighbours than one
    reach holds. An interface that does not run into the side is neither. `what` names the values in notes.
    """
    notes = []
    for axis, side in sides:
        lines = np.moveaxis(values, axis, 0)[::-side][: _REACHES * reach[axis] + 1]
        gradual = (np.diff(lines, axis=0) != 0).sum(0) > reach[axis]
        size = np.abs(lines).max(0)
        change = np.divide(np.ptp(lines, axis=0), size, out=np.zeros(size.shape), where=gradual & (size > 0)).max()
        name, where = _name(axis, side), f"over the last {len(lines) - 1} nodes in front of"
        missed = "would reflect is missed; a wider near field misses less"
        if change > _FLAT:
            notes.append(
                f"{what} changes by {100 * change:.2g} % along the normal {where} {name}, and is assumed to stay "
                f"beyond as it is at the edge: what a medium that keeps changing {missed}"
            )
        elif _oblique(lines):
            notes.append(
                f"{what}: an interface meets {name} at an angle, or bends {where} it, and is assumed to continue "
                f"straight along the normal: what one that continues otherwise {missed}"
            )
    return notes


def _oblique(lines: np.ndarray) -> bool:
    """Whether an interface runs into the edge, the first of the lines, at an angle: a line begins on one side of it and
    soon reaches the other, where its neighbour begins.
    """
    edge = lines[0]
    first = (np.abs(lines - edge) > _FLAT * np.abs(lines).max()).argmax(0)
    behind = np.take_along_axis(lines, first[None], 0)[0]
    step = np.abs(behind - edge)
    for axis in range(edge.ndim):
        pads = [(1, 1) if a == axis else (0, 0) for a in range(edge.ndim)]
        padded = np.pad(edge, pads, mode="edge")
        for shift in (0, 2):
            beside = np.take(padded, np.arange(shift, shift + edge.shape[axis]), axis)
            if (4 * np.abs(behind - beside) < step).any():
                return True
    return False


def _name(axis: int, side: int) -> str:
    return AXES[axis] + "-+"[side > 0]


def _named(level: float) -> str:
    """Value of the medium far away, in words."""
    return f"{level:.6g}, the background," if level else "zero"


def _extent(lattice: Lattice) -> str:
    return f"{shown(lattice.lower)} to {shown(lattice.upper)}"
