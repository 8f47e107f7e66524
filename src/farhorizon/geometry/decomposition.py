"""Decomposition of a lattice into a grid of boxes, one for each process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from farhorizon.errors import InputError
from farhorizon.geometry.lattice import AXES

Key = tuple[int, int]  # axis and side, -1 or +1


@dataclass(frozen=True)
class Decomposition:
    """A grid of boxes that make up a lattice."""

    #: For each axis the first node of each box, followed by the number of nodes.
    cuts: tuple[tuple[int, ...], ...]
    #: Axes along which the last box is a neighbour of the first one.
    periodic: frozenset[int]

    @property
    def topology(self) -> tuple[int, ...]:
        """Number of boxes along each axis."""
        return tuple(len(ends) - 1 for ends in self.cuts)

    def place(self, number: int) -> tuple[int, ...]:
        """Indices of the box of a process along the axes; the last axis varies fastest."""
        return tuple(int(i) for i in np.unravel_index(number, self.topology))

    def ranges(self, number: int) -> list[tuple[int, int]]:
        """First node and last node + 1 of a box along each axis."""
        return [(ends[i], ends[i + 1]) for ends, i in zip(self.cuts, self.place(number), strict=True)]

    def neighbours(self, number: int) -> dict[Key, int]:
        """Numbers of the processes with adjacent boxes, along axes that are cut or periodic; -1 where there is none."""
        place, numbers = self.place(number), {}
        for axis, count in enumerate(self.topology):
            if count == 1 and axis not in self.periodic:
                continue
            for side in (-1, 1):
                neighbour = list(place)
                neighbour[axis] += side
                exists = axis in self.periodic or 0 <= neighbour[axis] < count
                numbers[axis, side] = (
                    int(np.ravel_multi_index(tuple(neighbour), self.topology, mode="wrap")) if exists else -1
                )
        return numbers

    def size(self, number: int, more: Mapping[Key, int]) -> list[int]:
        """Nodes of a process along each axis, including those beyond the outer sides."""
        return [
            last - first + more.get((a, -1), 0) * (i == 0) + more.get((a, 1), 0) * (i == count - 1)
            for a, ((first, last), i, count) in enumerate(
                zip(self.ranges(number), self.place(number), self.topology, strict=True)
            )
        ]

    def exchanged(self, number: int, reach: Sequence[int], more: Mapping[Key, int], edges: bool = True) -> list[int]:
        """Number of nodes whose values a process sends in each exchange along each axis, of which the last is first;
        with `edges` later axes send earlier halos along. `more` are nodes beyond the outer sides.
        """
        sizes, neighbours, sent = self.size(number, more), self.neighbours(number), [0] * len(reach)
        for axis in (len(reach) - 1, *range(len(reach) - 1)):
            processes = [process for (a, _), process in neighbours.items() if a == axis]
            across = int(np.prod([size for a, size in enumerate(sizes) if a != axis]))
            sent[axis] = sum(process not in (-1, number) for process in processes) * reach[axis] * across
            sizes[axis] += 2 * reach[axis] * edges
        return sent

    def corners(self) -> Iterator[int]:
        """Processes that include the one that exchanges most: the first, middle and last ones along each axis."""
        picks = [sorted({0, count // 2, count - 1}) for count in self.topology]
        for place in np.stack(np.meshgrid(*picks, indexing="ij"), -1).reshape(-1, len(picks)):
            yield int(np.ravel_multi_index(tuple(place), self.topology))


def decompose(
    shape: Sequence[int],
    processes: int,
    reach: Sequence[int],
    more: Mapping[Key, float],
    periodic: frozenset[int],
    topology: Sequence[int] | None = None,
    least: int = 1,
    work: Sequence[np.ndarray] | None = None,
) -> Decomposition:
    """Divide a lattice into the grid of boxes (`topology`, or the best one) that exchange least, cut into equal work
    along each axis; an InputError for more processes than the lattice can be cut into, or a topology with another
    number of boxes. `more` is the work beyond each side, `work` that of the nodes along each axis, `least` the minimum
    number of nodes of a box, more than twice the reach.
    """
    fewest = [max(least, 2 * m + 1) for m in reach]
    most = [max(1, n // few) for n, few in zip(shape, fewest, strict=True)]
    if topology is not None:
        if len(topology) != len(shape) or int(np.prod(topology)) != processes:
            raise InputError(
                "the boxes along the axes do not multiply to the number of processes",
                value=list(topology),
                limit=f"{len(shape)} numbers whose product is {processes}",
                key="run.topology",
                remedy="leave it out",
            )
        choices = [tuple(int(count) for count in topology)]
    else:
        choices = list(_grids(processes, len(shape)))
    fitting = [grid for grid in choices if all(count <= top for count, top in zip(grid, most, strict=True))]
    if not fitting:
        raise InputError(
            "the lattice cannot be cut into so many boxes, each wider than the stencil and the filter of layers",
            value=f"{processes} processes",
            limit=f"at most {' x '.join(map(str, most))} boxes along {', '.join(AXES[: len(shape)])}",
            key="run.topology" if topology is not None else "processes",
            remedy="fewer processes",
        )
    summed = [np.cumsum(np.ones(n) if work is None else work[a]) for a, n in enumerate(shape)]
    candidates = [_cut(summed, grid, fewest, more, periodic) for grid in fitting]
    width = {key: int(np.ceil(nodes)) for key, nodes in more.items()}

    def cost(boxes: Decomposition) -> tuple[int, tuple[int, ...]]:
        most = max(sum(boxes.exchanged(number, reach, width, edges=False)) for number in boxes.corners())
        return most, tuple(-count for count in boxes.topology)  # of equals, the one that cuts earlier axes

    return min(candidates, key=cost)


def _grids(count: int, axes: int) -> Iterator[tuple[int, ...]]:
    """All ways to write a number as a product of as many factors as there are axes."""
    if axes == 1:
        yield (count,)
        return
    for first in range(1, count + 1):
        if count % first == 0:
            yield from ((first, *further) for further in _grids(count // first, axes - 1))


def _cut(
    summed: Sequence[np.ndarray],
    topology: Sequence[int],
    fewest: Sequence[int],
    more: Mapping[Key, float],
    periodic: frozenset[int],
) -> Decomposition:
    """Boxes of equal work, including what lies beyond the outer sides, but never thinner than allowed."""
    cuts = []
    for axis, (sums, count, least) in enumerate(zip(summed, topology, fewest, strict=True)):
        low, high, n = more.get((axis, -1), 0.0), more.get((axis, 1), 0.0), len(sums)
        targets = np.arange(count + 1) * (low + sums[-1] + high) / count - low
        ends = np.interp(targets, np.append(0.0, sums), np.arange(n + 1)).round().astype(int).tolist()
        ends[0], ends[-1] = 0, n
        for i in range(1, count):
            ends[i] = min(max(ends[i], ends[i - 1] + least), n - (count - i) * least)
        cuts.append(tuple(ends))
    return Decomposition(tuple(cuts), periodic)
