"""Numba's decorators with a cache that detects damaged files: Numba itself keeps machine code without a checksum, and
runs whatever it finds.
"""

from __future__ import annotations

import inspect
import pickle
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from functools import cached_property
from pathlib import Path
from typing import Any

import numba
from numba import types

from farhorizon.engine.codegen.code_digest import digest
from farhorizon.engine.codegen.numba_internals import (
    CacheLocator,
    CFunc,
    Compiler,
    CompileResultCacheImpl,
    CPUDispatcher,
    FunctionCache,
    IndexDataCacheFile,
    JITCodeLibrary,
    sigutils,
)
from farhorizon.files.cache import cache_folder, sealed, unsealed
from farhorizon.files.storage import awaited
from farhorizon.machine import without_collection


class _SealedFiles(IndexDataCacheFile):
    """Index and machine code of one function. What is damaged, or of types or modules that no longer exist, counts as
    absent and is compiled again.
    """

    def _dump(self, obj: Any) -> bytes:
        return sealed(super()._dump(obj))  # pickle ignores what follows its end

    def _load_index(self) -> Any:
        if not _undamaged(self._index_path, pickle.dumps(self._version, protocol=-1)):
            return {}
        try:
            return super()._load_index()
        except (ImportError, AttributeError):
            return {}

    def _load_data(self, name: str) -> Any:
        try:
            return super()._load_data(name) if _undamaged(self._data_path(name)) else None
        except (ImportError, AttributeError):
            return None


def _undamaged(path: str, head: bytes = b"") -> bool:
    """Whether a file begins with `head`, followed by data with their checksum."""
    try:
        data = Path(path).read_bytes()
    except OSError:
        return False
    return data.startswith(head) and unsealed(data[len(head) :]) is not None


class _CacheFolder(CacheLocator):
    """The place of all machine code: the cache folder, and never that of the source, which may be read by many users
    and written by none.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._line = function.__code__.co_firstlineno

    def get_cache_path(self) -> str:
        folder = cache_folder() / "__pycache__"
        folder.mkdir(exist_ok=True)
        return str(folder)

    def get_source_stamp(self) -> str:
        return ""  # `_SealedCache` has its own

    def get_disambiguator(self) -> str:
        return str(self._line)

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> _CacheFolder:
        return cls(function)


class _InCacheFolder(CompileResultCacheImpl):
    """Numba's way to keep machine code, in the cache folder."""

    _locator_classes: Any = (_CacheFolder,)


class _SealedCache(FunctionCache):
    """Sealed files of one function, named after all code that it depends on; versions of it lie side by side."""

    _impl_class = _InCacheFolder

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        del self._cache_file  # it is made, and the sources are read, for those functions alone that are called

    @cached_property
    def _cache_file(self) -> _SealedFiles:
        function = self._py_func
        stamp = digest(Path(inspect.getfile(function)), function.__qualname__.partition(".")[0])
        start, _, end = self._impl.filename_base.rpartition(f"-{function.__code__.co_firstlineno}.")
        return _SealedFiles(self._impl.locator.get_cache_path(), f"{start}-{stamp[:20]}.{end}", stamp)

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        """Numba's key, and the order of the fields in named tuples among the arguments: their types do not tell it."""
        fields = [_fields(kind) for kind in getattr(sig, "args", sig)]
        return (*super()._index_key(sig, codegen), repr(fields))

    def has(self, made: Any) -> bool:
        """Whether there is machine code of a function for its signature."""
        codegen = made._targetdescr.target_context.codegen()
        return self._index_key(made._sig, codegen) in self._cache_file._load_index()

    @property
    def lock(self) -> Path:
        """File that is locked while the function is compiled."""
        return Path(f"{self._cache_file._index_path}.lock")


def _fields(kind: Any) -> tuple[Any, ...]:
    """Names of the fields of a named tuple, and those of the named tuples in a tuple; nothing for other types."""
    if not isinstance(kind, types.BaseTuple):
        return ()
    of_parts: Iterable[Any] = kind  # type: ignore[assignment]  # all its subclasses can be iterated over
    return getattr(kind, "fields", ()), tuple(map(_fields, of_parts))


class _Inlined(JITCodeLibrary):
    """Code of a function that compiled functions alone call. It becomes a part of theirs, and is optimised as a whole
    and turned into machine code there, not by itself as well: that would take a fifth of the time of all compiling.
    """

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0  # as for what a library does not define

    @property
    def codegen(self) -> _Inlined:
        return self  # Numba asks it for nothing else than this:

    def set_env(self, name: str, env: Any) -> None:
        """Ignore the objects that machine code could refer to."""


class _InnerCompiler(Compiler):
    """Numba's compiler, for such code."""

    def __init__(self, typingctx: Any, targetctx: Any, library: None, *rest: Any) -> None:
        super().__init__(typingctx, targetctx, _Inlined(targetctx.codegen(), "inlined"), *rest)


def njit(
    *, cache: bool = False, counted: bool = True, entry: bool | None = None, **options: Any
) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit`, with sealed files where what it compiles is cached.

    Without `counted` Numba does not count the references to arrays, which in short loops takes longer than the work.
    Such a function must create no arrays; those passed to it outlive the call, as their owner waits for it.

    Python can call only an `entry`, by default those functions that are counted. The wrapper for calls from Python
    unpacks all arrays among the arguments, and compiling it takes a quarter of the total time. Other functions are kept
    as parts of those that call them.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        called = counted if entry is None else entry
        options_of_numba = options | {"_nrt": counted, "no_cpython_wrapper": not called, "no_cfunc_wrapper": True}
        made: Any
        if called:
            made = numba.njit(**options_of_numba)(function)
            if cache:
                made._cache = _SealedCache(function)
        else:
            made = numba.njit(pipeline_class=_InnerCompiler, **options_of_numba)(function)
            made.__class__ = _Inner
        return made

    return decorate


class _Inner(CPUDispatcher):
    """A function without a wrapper for calls from Python, which would otherwise crash."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        raise TypeError(f"{self.py_func.__name__} is called by compiled functions alone")


def cfunc(signature: Any, *, counted: bool = True) -> Callable[[Callable[..., Any]], Any]:
    """`numba.cfunc` for a signature, with sealed files for what it compiles; see `njit`."""

    def decorate(function: Callable[..., Any]) -> Any:
        options = {"error_model": "numpy", "_nrt": counted}
        made: Any = CFunc(function, sigutils.normalize_signature(signature), locals={}, options=options)
        made._cache = _SealedCache(function)
        # of several processes that start together one compiles it, and the others find the result
        with without_collection(), nullcontext() if made._cache.has(made) else awaited(made._cache.lock):
            made.compile()
        return made

    return decorate
