"""Which states of a run to keep, so that its pieces can be made again, the last one first, with the least work.

Griewank and Walther (2000), ACM Transactions on Mathematical Software 26(1), 19-45: with s states that are kept and
pieces that are each made at most r times from the state before, ``(s + r)! / (s! r!)`` pieces can be served.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from math import comb


def states_ahead(count: int, room: int) -> list[int]:
    """Numbers of the pieces at whose beginnings the first run through all pieces keeps a state, in order."""
    return _split(0, count, room)


def pieces_backward(count: int, room: int) -> Iterator[tuple[int, int, list[int]]]:
    """Yield the numbers of `count` pieces from the last one to the first, with the piece at whose beginning the state
    lies from which it is made, and those at whose beginnings states are to be kept, up to `room` at a time.
    """
    kept = states_ahead(count, room)
    for piece in reversed(range(count)):
        while kept[-1] > piece:
            kept.pop()
        start, keep = kept[-1], []
        if start < piece and len(kept) < room:
            keep = _split(start, piece + 1, room - len(kept) + 1)[1:]
            kept += keep
        yield piece, start, keep


def _split(first: int, end: int, room: int) -> list[int]:
    """Where states are kept in a run through the pieces from `first` to `end`, which begins with one of them."""
    starts = [first]
    while room > 1 and end - first > 1:
        first += _ahead(end - first, room)
        room -= 1
        starts.append(first)
    return starts


@cache
def _ahead(count: int, room: int) -> int:
    """Number of pieces after which the next state is kept, of those that lead to the least work."""
    again = 0
    while comb(room + again, again) < count:
        again += 1
    # as many pieces behind the next state as can be made with one state less and as often, the others with once less
    return max(1, min(count - 1, comb(room + again - 1, again - 1) if again else 1))


def repeats(count: int, room: int) -> int:
    """Number of steps between pieces that are made again in all, for a number of pieces, in units of a piece."""
    made = 0
    for piece, start, _ in pieces_backward(count, room):
        made += piece - start + 1
    return made
