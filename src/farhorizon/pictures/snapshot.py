"""A picture of a run at one moment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.pictures.fields import field_panels, magnitude
from farhorizon.pictures.style import DAMAGE


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
    known = scalars(fields, len(axes))
    if name not in known:
        raise InputError("there is no such field", value=name, limit=", ".join(known), key="plot")
    label, values = known[name]
    colors = DAMAGE if name == "damage" else None
    return field_panels([(title, values)], axes, path, label=label, colors=colors, limits=limits)
