"""Dense linear algebra in parallel, on the threads that the time loop uses later."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from farhorizon.engine.engine import available_threads

_Part = TypeVar("_Part")
_Result = TypeVar("_Result")


def in_parallel(function: Callable[[_Part], _Result], parts: Sequence[_Part]) -> list[_Result]:
    """Apply a function to each of several parts on all threads that the process may use, and return the results: NumPy
    releases the interpreter lock while it computes. If the size of the parts does not depend on the number of threads,
    neither do the results.
    """
    threads = min(available_threads(), len(parts))
    if threads <= 1:
        return [function(part) for part in parts]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, parts))
