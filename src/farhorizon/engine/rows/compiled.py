"""Numba's decorators with a cache that knows its damaged files: Numba itself keeps machine code without a check sum,
and runs whatever it finds.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numba
from numba.core import sigutils
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.ccallback import CFunc
from numba.core.registry import CPUDispatcher

from farhorizon.files.cache import sealed, unsealed
from farhorizon.files.storage import awaited
from farhorizon.machine import without_collection


class _SealedFiles(IndexDataCacheFile):
    """Index and machine code of one function; what is damaged, or of types that are no more, is not there, and so is
    compiled again.
    """

    def _dump(self, obj: Any) -> bytes:
        return sealed(super()._dump(obj))  # pickle looks at nothing behind its end

    def _load_index(self) -> Any:
        if not _whole(self._index_path, pickle.dumps(self._version, protocol=-1)):
            return {}
        try:
            return super()._load_index()
        except (ImportError, AttributeError):
            return {}

    def _load_data(self, name: str) -> Any:
        return super()._load_data(name) if _whole(self._data_path(name)) else None


def _whole(path: str, head: bytes = b"") -> bool:
    """Whether a file has this beginning, and behind it data with their check sum."""
    try:
        data = Path(path).read_bytes()
    except OSError:
        return False
    return data.startswith(head) and unsealed(data[len(head) :]) is not None


class _SealedCache(FunctionCache):
    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _SealedFiles(
            self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp()
        )

    def has(self, made: Any) -> bool:
        """Whether machine code of a function is there for its signature."""
        codegen = made._targetdescr.target_context.codegen()
        return self._index_key(made._sig, codegen) in self._cache_file._load_index()

    @property
    def lock(self) -> Path:
        """A file that is locked while the function is compiled."""
        return Path(f"{self._cache_file._index_path}.lock")


def njit(
    *, cache: bool = False, counted: bool = True, entry: bool | None = None, **options: Any
) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit`, with sealed files where it keeps what it compiles.

    Without `counted` Numba does not count the references to arrays, which in short loops takes longer than the work.
    Such a function makes no arrays; those it is given outlive it, as their owner waits for it.

    Python calls an `entry` alone, by default what is counted. A way in takes apart all arrays of its arguments; to
    compile it takes a quarter of the time of the whole.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        called = counted if entry is None else entry
        made = numba.njit(**options | {"_nrt": counted, "no_cpython_wrapper": not called, "no_cfunc_wrapper": True})(
            function
        )
        if not called:
            made.__class__ = _Inner
        if cache:
            made._cache = _SealedCache(function)
        return made

    return decorate


class _Inner(CPUDispatcher):
    """A function without a way in from Python, which would run into nothing."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        raise TypeError(f"{self.py_func.__name__} is called by compiled functions alone")


def cfunc(signature: Any, *, counted: bool = True) -> Callable[[Callable[..., Any]], Any]:
    """`numba.cfunc` for a signature, with sealed files for what it compiles; see `njit`."""

    def decorate(function: Callable[..., Any]) -> Any:
        options = {"error_model": "numpy", "_nrt": counted}
        made: Any = CFunc(function, sigutils.normalize_signature(signature), locals={}, options=options)
        made._cache = _SealedCache(function)
        # of processes that were started together one compiles it, the others find it then
        with without_collection(), nullcontext() if made._cache.has(made) else awaited(made._cache.lock):
            made.compile()
        return made

    return decorate
