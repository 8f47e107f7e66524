"""Pictures of a run: snapshots and films."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.pictures.fields import field_panels, magnitude
from farhorizon.pictures.movie import Film, film_format, made_film
from farhorizon.pictures.style import DAMAGE, FORMATS
from farhorizon.pictures.words import in_words


def scalars(fields: Mapping[str, np.ndarray], dim: int) -> dict[str, tuple[str, np.ndarray]]:
    """Label and values of each scalar that can be drawn from fields: for vectors, their length and each component."""
    found = {}
    for name, values in fields.items():
        if values.ndim == dim:
            found[name] = (name, values)
        else:
            found[name] = (f"|{name}|", magnitude(values))
            found |= {f"{name}_{axis}": (f"{name}_{axis}", part) for axis, part in zip("xyz", values, strict=False)}
    return found


def chosen(fields: Mapping[str, np.ndarray], name: str, dim: int) -> tuple[str, np.ndarray]:
    """Label and values of one of several fields; InputError for an unknown name."""
    known = scalars(fields, dim)
    if kinds.text(name, "name") not in known:
        raise InputError("there is no such field", value=name, limit=", ".join(known), key="name")
    return known[name]


def scale_limits(limits: tuple[float, float] | None) -> tuple[float, float] | None:
    """Check the limits of a scale."""
    if limits is None:
        return None
    low, high = kinds.array(limits, "limits", shape=(2,)).tolist()
    if not low < high:
        raise InputError("a range goes from a number to a larger one", value=limits, key="limits")
    return low, high


def snapshot(
    fields: Mapping[str, np.ndarray],
    name: str,
    axes: Sequence[np.ndarray],
    title: str,
    path: str | Path | None = None,
    limits: tuple[float, float] | None = None,
    cracks: Sequence[np.ndarray] = (),
) -> Any:
    """Draw one of several fields; see `Run.plot`."""
    if path is not None:
        path = kinds.path(path, "path")
        if path.suffix.lower().lstrip(".") not in FORMATS:
            raise InputError("unknown format", value=path.name, limit=", ".join(FORMATS), key="path")
    limits = scale_limits(limits)
    label, values = chosen(fields, name, len(axes))
    label = in_words(label)
    colors = DAMAGE if name == "damage" else None
    return field_panels([(title, values)], axes, path, label=label, colors=colors, limits=limits, cracks=cracks)


class Frames:
    """Frames of a film: one field at several times; in 3D, its slice in the middle of z.

    Parameters
    ----------
    name : str
        As in `snapshot`.
    axes : sequence of ndarray
        Coordinates of the nodes along each axis.
    path : str or Path, optional
        File name of the film, whose ending determines the format.
    limits : (float, float), optional
    cracks : sequence of ndarray, each of shape (n, dim)
        Polylines, drawn over the field.

    Raises
    ------
    InputError
        The format is unknown, the directory does not exist, or the range is empty.
    """

    def __init__(
        self,
        name: str,
        axes: Sequence[np.ndarray],
        path: str | Path | None = None,
        limits: tuple[float, float] | None = None,
        cracks: Sequence[np.ndarray] = (),
    ) -> None:
        self._name, self._axes, self._limits, self._cracks = name, axes, scale_limits(limits), cracks
        self._path = None if path is None else kinds.path(path, "path")
        self._kind = "gif" if self._path is None else film_format(self._path, "path")
        self._label, self._frames = "", []  # type: str, list[tuple[str, np.ndarray]]

    def add(self, fields: Mapping[str, np.ndarray], title: str) -> None:
        """Add the current field as a frame; InputError for an unknown name."""
        label, values = chosen(fields, self._name, len(self._axes))
        self._label = in_words(label)
        self._frames.append((title, values if values.ndim < 3 else values[..., values.shape[2] // 2, None].copy()))

    def film(self) -> Film:
        """Make the film, and write it if there is a path."""
        axes = [axis if number < 2 else axis[[axis.size // 2]] for number, axis in enumerate(self._axes)]
        colors = DAMAGE if self._name == "damage" else None
        look: dict[str, Any] = {"label": self._label, "limits": self._limits, "colors": colors, "cracks": self._cracks}
        made = made_film(self._frames, axes, self._kind, **look)
        if self._path is not None:
            made.save(self._path)
        return made
