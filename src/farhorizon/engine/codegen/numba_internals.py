"""Everything that the package takes from Numba beyond its documented interface: other modules import it from here.

These parts may change with any release of Numba. A version that lacks one of them is refused when the first simulation
is set up, by its number, instead of failing somewhere in a compilation.
"""

from __future__ import annotations

from typing import Any

import numba

#: The versions that `pyproject.toml` admits: the first, and the one that has not been tried.
FIRST, UNTRIED = "0.60", "0.69"


def refusal(missing: object) -> ImportError:
    """What is raised if the installed version of Numba lacks something."""
    return ImportError(
        f"Numba {numba.__version__} does not have what farhorizon uses of it ({missing}); "
        f"python -m pip install 'numba>={FIRST},<{UNTRIED}'"
    )


try:
    from numba.core import cgutils, event, sigutils
    from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, _CacheLocator
    from numba.core.ccallback import CFunc
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import Compiler, Flags
    from numba.core.imputils import lower_getattr_generic
    from numba.core.registry import CPUDispatcher
    from numba.core.typing.templates import AttributeTemplate, infer_getattr
    from numba.np import arrayobj
except ImportError as error:
    raise refusal(error) from error

CacheLocator = _CacheLocator

#: What is used of them, or overridden in them; what instances alone have is beyond this check.
USED: dict[Any, tuple[str, ...]] = {
    cgutils: (
        "alloca_once",
        "alloca_once_value",
        "for_range",
        "for_range_slice",
        "get_or_insert_function",
        "raw_memcpy",
        "raw_memmove",
        "unpack_tuple",
    ),
    event: ("Listener", "register"),
    sigutils: ("normalize_signature",),
    arrayobj: ("make_array", "populate_array"),
    CacheLocator: ("ensure_cache_path", "from_function", "get_cache_path", "get_disambiguator", "get_source_stamp"),
    CompileResultCacheImpl: ("_locator_classes", "filename_base", "locator"),
    FunctionCache: ("_impl_class", "_index_key"),
    IndexDataCacheFile: ("_data_path", "_dump", "_load_data", "_load_index"),
    CFunc: ("_targetdescr", "compile"),
    Flags: ("error_model",),
    JITCodeLibrary: (
        "_finalize_dynamic_globals",
        "_finalize_final_module",
        "_optimize_final_module",
        "codegen",
        "get_pointer_to_function",
    ),
}


def check() -> None:
    """Raise an `ImportError` with Numba's version unless all parts in `USED` exist."""
    for owner, names in USED.items():
        for name in names:
            if not hasattr(owner, name):
                raise refusal(f"{owner.__name__}.{name}")


check()

__all__ = [
    "AttributeTemplate",
    "CFunc",
    "CPUDispatcher",
    "CacheLocator",
    "CompileResultCacheImpl",
    "Compiler",
    "Flags",
    "FunctionCache",
    "IndexDataCacheFile",
    "JITCodeLibrary",
    "arrayobj",
    "cgutils",
    "event",
    "infer_getattr",
    "lower_getattr_generic",
    "sigutils",
]
