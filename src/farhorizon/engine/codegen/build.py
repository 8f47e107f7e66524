"""Modules of compiled functions for one row or tile of nodes, for each choice of their settings, written to disk and
imported from there, so that Numba's cache finds them again.
"""

from __future__ import annotations

import importlib.util
import sys
import threading
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

from farhorizon.engine.codegen.code_digest import hash_of
from farhorizon.engine.codegen.compile_notice import importing
from farhorizon.files.cache import cache_folder, write
from farhorizon.machine import without_collection

_LOADING = threading.RLock()  # simulations may be set up in parallel


class Row(NamedTuple):
    """A function for one row or tile of nodes: its name and arguments, its signature, and what makes the intrinsic that
    it calls; the latter two are expressions with the settings of `load_rows`, in modules of this folder.
    """

    head: str
    signature: str
    intrinsic: str


#: The functions of each kind of row.
ROWS = {
    "stencil_rows": [
        Row(
            "rows(levels, weights, a, b, extent, strides, apart, shifts)",
            "stencil_sweeps.sweep_signature(real)",
            "stencil_sweeps.stencil_sweep(shape, classes, real, increments)",
        )
    ],
    "matrix_rows": [
        Row(
            "rows(levels, weights, a, b, extent, strides, apart, shifts)",
            "stencil_sweeps.sweep_signature(real)",
            "matrices.matrix_sweep(stencil, real, form, lines)",
        )
    ],
    # of bonds, each by what its code depends on: most laws share the first and the last
    "intact_rows": [
        Row(
            "intact(at, shape, a, b, limit)",
            "bond_sweeps.bond_signature(law.real)",
            "bond_sweeps.bond_sweep(law, damaged=False)",
        )
    ],
    "damaged_rows": [
        Row(
            "damaged(at, shape, a, b, limit)",
            "bond_sweeps.bond_signature(law.real)",
            "bond_sweeps.bond_sweep(law, damaged=True)",
        )
    ],
    "steep_rows": [
        Row(
            "steep(src, planes, rows, n, step0, step1, apart)",
            "bond_sweeps.STEEPNESS_SIGNATURE",
            "bond_sweeps.steepness(components, real)",
        )
    ],
    "shift_rows": [
        Row(
            "outwards(parts, results, memory, edges, columns, vectors)",
            "shifts.SHIFTS_SIGNATURE",
            "shifts.stretched_shifts(reach, nested, True, real, kept)",
        ),
        Row(
            "inwards(parts, results, memory, edges, columns, vectors)",
            "shifts.SHIFTS_SIGNATURE",
            "shifts.stretched_shifts(reach, nested, False, real, kept)",
        ),
        Row(
            "parts(to, source, tables, vectors, least, more)",
            "shifts.PARTS_SIGNATURE",
            "shifts.weighted_parts(reach if nested else 1, varied, real)",
        ),
    ],
    "part_rows": [
        Row(
            "parts(to, source, strides, weights, vectors)",
            "layer_sums.MIRRORED_SIGNATURE",
            "layer_sums.mirrored_parts(stencil, axis, both, apart, differ, real)",
        )
    ],
    "crossing_rows": [
        Row(
            "parts(to, source, strides, weights, vectors)",
            "layer_sums.CROSSING_SIGNATURE",
            "layer_sums.crossing_parts(stencil, both, reach, apart, differ, real)",
        )
    ],
    "band_rows": [
        Row(
            "bands(to, source, strides, weights, extent)",
            "layer_sums.BAND_SIGNATURE",
            "layer_sums.band_sums(stencil, differ, real)",
        )
    ],
    "map_rows": [
        Row(
            "product(src, read, out, written, matrix, step, nodes, factor)",
            "matrices.MAP_SIGNATURE",
            "matrices.linear_map(entries, columns, each, added, real)",
        )
    ],
    "exchange_rows": [
        Row("send(table, array, components, apart)", "exchanges.EXCHANGE_SIGNATURE", "exchanges.send_values"),
        Row("receive(table, array, components, apart)", "exchanges.EXCHANGE_SIGNATURE", "exchanges.receive_values"),
        Row("move(table, array, components, apart)", "exchanges.EXCHANGE_SIGNATURE", "exchanges.move_messages"),
    ],
}

_FUNCTION = """
_{name} = {intrinsic}


@cfunc({signature})
def {head}:
    return _{head}
"""


def load_rows(kind: str, **settings: Any) -> tuple[int, ...]:
    """Addresses of the functions of one kind of row, in the order of `ROWS`, compiled for some settings."""
    module = _load(kind, _written_out(kind, **settings))
    return tuple(int(getattr(module, _name(row)).address) for row in ROWS[kind])


def _name(row: Row) -> str:
    return row.head.partition("(")[0]


@cache
def _written_out(kind: str, **settings: Any) -> str:
    """Text of a module with the functions of one kind of row."""
    modules = sorted({text.partition(".")[0] for row in ROWS[kind] for text in (row.signature, row.intrinsic)})
    types = {type(value) for value in settings.values() if hasattr(value, "_fields")}
    lines = [
        "from farhorizon.engine.codegen.compiled import cfunc",
        *(f"from farhorizon.engine.codegen import {module}" for module in modules),
        *(f"from {of.__module__} import {of.__name__}" for of in types),
        *(f"{name} = {value!r}" for name, value in settings.items()),
        *(_FUNCTION.format(name=_name(row), **row._asdict()) for row in ROWS[kind]),
    ]
    return "\n".join(lines)


@cache
def _module_name(kind: str, text: str) -> str:
    """Name of a module, which differs if its code does; what it imports decides about the files with machine code."""
    return f"{kind}_{hash_of(text)[:20]}"


def _load(kind: str, text: str) -> ModuleType:
    name = _module_name(kind, text)
    with _LOADING:
        return sys.modules[name] if name in sys.modules else _load_file(name, text)


def _load_file(name: str, text: str) -> ModuleType:
    path = cache_folder() / f"{name}.py"
    if not path.is_file() or path.read_bytes() != text.encode():  # missing or damaged
        write(path, text.encode())
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        with importing(name), without_collection():
            spec.loader.exec_module(module)
    except BaseException:  # an interrupt, too: no half-loaded module may remain
        del sys.modules[name]
        raise
    return module
