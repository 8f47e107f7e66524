"""Dense algebra side by side, on the threads that the time loop has later."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from farhorizon.engine.engine import available_threads

_Part = TypeVar("_Part")
_Result = TypeVar("_Result")


def in_parallel(function: Callable[[_Part], _Result], parts: Sequence[_Part]) -> list[_Result]:
    """Results of a function for each of several parts, on all threads that the process may have: NumPy leaves the
    interpreter to others while it computes. Parts of a size that does not depend on threads have results that do not.
    """
    threads = min(available_threads(), len(parts))
    if threads <= 1:
        return [function(part) for part in parts]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, parts))
