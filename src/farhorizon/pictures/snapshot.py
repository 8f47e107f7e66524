"""A picture of a run at one moment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.pictures.fields import field_panels, magnitude
from farhorizon.pictures.style import DAMAGE, FORMATS


def scalars(fields: Mapping[str, np.ndarray], dim: int) -> dict[str, tuple[str, np.ndarray]]:
    """Label and values of what can be drawn of fields: of vectors their length and each component."""
    found = {}
    for name, values in fields.items():
        if values.ndim == dim:
            found[name] = (name, values)
        else:
            found[name] = (f"|{name}|", magnitude(values))
            found |= {f"{name}_{axis}": (f"{name}_{axis}", part) for axis, part in zip("xyz", values, strict=False)}
    return found


def snapshot(
    fields: Mapping[str, np.ndarray],
    name: str,
    axes: Sequence[np.ndarray],
    title: str,
    path: str | Path | None = None,
    limits: tuple[float, float] | None = None,
) -> Any:
    """Draw one of several fields; see `Run.plot`."""
    name = kinds.text(name, "name")
    if path is not None:
        path = kinds.path(path, "path")
        if path.suffix.lower().lstrip(".") not in FORMATS:
            raise InputError("unknown format", value=path.name, limit=", ".join(FORMATS), key="path")
    if limits is not None:
        low, high = kinds.array(limits, "limits", shape=(2,)).tolist()
        if not low < high:
            raise InputError("a range goes from a number to a larger one", value=limits, key="limits")
        limits = low, high
    known = scalars(fields, len(axes))
    if name not in known:
        raise InputError("there is no such field", value=name, limit=", ".join(known), key="name")
    label, values = known[name]
    colors = DAMAGE if name == "damage" else None
    return field_panels([(title, values)], axes, path, label=label, colors=colors, limits=limits)
