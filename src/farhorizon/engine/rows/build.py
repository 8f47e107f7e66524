"""Writes compiled programs (the time loop, and the rows of each stencil) to disk and imports them, so that Numba's
cache finds them again.
"""

from __future__ import annotations

import hashlib
import importlib.util
import platform
import re
import sys
import threading
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from farhorizon.engine.rows.notice import importing
from farhorizon.files.cache import cache_folder, write
from farhorizon.machine import without_collection

_ENGINE = Path(__file__).parents[1]
#: Modules that the templates import.
_COMPILED_IN = (
    "bonds",
    "damage",
    "dampers",
    "release",
    "drag",
    "ends",
    "exchange",
    "filter",
    "outline_stencil",
    "thermal_strain",
    "layout",
    "nested",
    "operations",
    "point_law",
    "phases",
    "shape_tensors",
    "stretches",
    "tables",
    "threads",
    "rows/calls",
    "rows/compiled",
    "rows/vectors",
    "rows/shifts",
    "rows/bond_sweeps",
    "rows/exchanges",
    "rows/linear_maps",
    "rows/structs",
    "rows/layer_sums",
    "rows/matrices",
)
_LOADING = threading.RLock()  # simulations may be set up in parallel


def load_program() -> ModuleType:
    """Module with the operations of the time loop."""
    return _load("program")


def load_layer_program() -> ModuleType:
    """Module with its operations on layers."""
    return _load("layer_program")


def load_rows(
    shape: tuple[tuple[int, int, int], ...],
    classes: tuple[int, ...],
    real: str,
    increments: bool,
    pattern: tuple[tuple[bool, ...], ...] = (),
    inside: tuple[tuple[int, int, int], ...] = (),
    outside: tuple[tuple[int, int, int], ...] = (),
    form: str = "step",
) -> int:
    """Address of the compiled rows of a stencil shape (see `vectors.line_sweep`, and `matrices.matrix_line_sweep` for a
    pattern).
    """
    lines = not increments and max(i for _, _, i in shape) <= (8 if real == "float64" else 16)
    return int(
        _load(
            "rows/stencil_rows",
            SHAPE=shape,
            CLASSES=classes,
            REAL=real,
            INCREMENTS=increments,
            LINES=lines,
            PATTERN=pattern,
            INSIDE=inside,
            OUTSIDE=outside,
            FORM=form,
        ).rows.address
    )


def load_shifts(reach: int, nested: bool, varied: bool, real: str, kept: str) -> tuple[int, int, int]:
    """Addresses of stretched shifts outwards and inwards, and of the sums that they take (see `shifts.stretched_shifts`
    and `vectors.weighted_parts`).
    """
    made = _load("rows/shift_rows", REACH=reach, NESTED=nested, VARIED=varied, REAL=real, KEPT=kept)
    return int(made.outwards.address), int(made.inwards.address), int(made.parts.address)


def load_parts(
    shape: tuple[tuple[int, int, int], ...],
    pattern: tuple[tuple[bool, ...], ...],
    inside: tuple[tuple[int, int, int], ...],
    outside: tuple[tuple[int, int, int], ...],
    axis: int,
    both: bool,
    apart: bool,
    differ: bool,
    real: str,
) -> int:
    """Address of the sums across lines of a mirror-symmetric stencil (see `layer_sums.mirrored_parts`)."""
    made = _load(
        "rows/part_rows",
        SHAPE=shape,
        PATTERN=pattern,
        INSIDE=inside,
        OUTSIDE=outside,
        AXIS=axis,
        BOTH=both,
        APART=apart,
        DIFFER=differ,
        REAL=real,
    )
    return int(made.tile_parts.address)


def load_crossing(
    shape: tuple[tuple[int, int, int], ...],
    pattern: tuple[tuple[bool, ...], ...],
    inside: tuple[tuple[int, int, int], ...],
    outside: tuple[tuple[int, int, int], ...],
    both: tuple[bool, bool],
    reach: int,
    apart: bool,
    differ: bool,
    real: str,
) -> int:
    """Address of the sums where faces meet (see `layer_sums.crossing_parts`)."""
    made = _load(
        "rows/crossing_rows",
        SHAPE=shape,
        PATTERN=pattern,
        INSIDE=inside,
        OUTSIDE=outside,
        BOTH=both,
        REACH=reach,
        APART=apart,
        DIFFER=differ,
        REAL=real,
    )
    return int(made.crossings.address)


def load_bands(
    shape: tuple[tuple[int, int, int], ...],
    pattern: tuple[tuple[bool, ...], ...],
    inside: tuple[tuple[int, int, int], ...],
    outside: tuple[tuple[int, int, int], ...],
    differ: bool,
    real: str,
) -> int:
    """Address of the sums over slots in bands (see `layer_sums.band_sums`)."""
    stencil = {"SHAPE": shape, "PATTERN": pattern, "INSIDE": inside, "OUTSIDE": outside}
    return int(_load("rows/band_rows", **stencil, DIFFER=differ, REAL=real).bands.address)


def load_exchange() -> tuple[int, int, int]:
    """Addresses of the functions that begin messages with other processes, end them, and let them progress (see
    `exchanges.send_values`, `receive_values` and `move_messages`).
    """
    made = _load("rows/exchange_rows")
    return int(made.send.address), int(made.receive.address), int(made.move.address)


def load_map(entries: tuple[tuple[int, ...], ...], columns: int, each: bool, added: bool, real: str) -> int:
    """Address of the product of the values of nodes with a matrix (see `linear_maps.linear_map`)."""
    made = _load("rows/map_rows", ENTRIES=entries, COLUMNS=columns, EACH=each, ADDED=added, REAL=real)
    return int(made.product.address)


def load_bonds(
    components: int,
    nonlinear: bool,
    real: str,
    rule: str | None,
    strong: bool = False,
    contact: bool = False,
    warm: bool = False,
    softening: str | None = None,
) -> tuple[int, int, int]:
    """Addresses of the sweeps of an intact and of a damaged tile for a law of bonds, and of the bound of their stretch
    (see `bond_sweeps`).
    """
    law = {"COMPONENTS": components, "NONLINEAR": nonlinear, "REAL": real, "RULE": rule}
    made = _load("rows/bond_rows", **law, STRONG=strong, CONTACT=contact, WARM=warm, SOFTENING=softening)
    return int(made.intact.address), int(made.damaged.address), int(made.steep.address)


def _load(place: str, **settings: Any) -> ModuleType:
    """Module of compiled functions: a template in the engine's folder with its upper-case names set to `settings`."""
    name, text = _written_out(place, **settings)
    with _LOADING:
        return sys.modules[name] if name in sys.modules else _load_file(name, text)


@cache
def _written_out(place: str, **settings: Any) -> tuple[str, str]:
    """Name and text of a module.

    The name holds a hash of the templates, the generator and the settings, because Numba's own cache does not notice a
    change of the generator.
    """
    template = (_ENGINE / f"{place}.py").read_text()
    for key, value in settings.items():
        template, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value!r}", template)
        assert count == 1, f"the template has no setting {key}"
    import numba

    parts = [(_ENGINE / f"{part}.py").read_text() for part in _COMPILED_IN]
    mark = "\n".join([template, *parts, numba.__version__, platform.machine()])
    return f"{place.rpartition('/')[2]}_" + hashlib.sha256(mark.encode()).hexdigest()[:20], template


def _load_file(name: str, template: str) -> ModuleType:
    path = cache_folder() / f"{name}.py"
    if not path.is_file() or path.read_bytes() != template.encode():  # missing or damaged
        write(path, template.encode())
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
