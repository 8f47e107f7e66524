"""Pictures of a run: snapshots and films."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.pictures.fields import field_panels
from farhorizon.pictures.movie import Film, film_format, made_film
from farhorizon.pictures.panels import Axes, File, Look, Panel
from farhorizon.pictures.scalars import Scalar, parts_of
from farhorizon.pictures.style import DAMAGE, FORMATS
from farhorizon.pictures.words import in_words


def scalars(fields: Mapping[str, np.ndarray], dim: int) -> dict[str, Scalar]:
    """The scalars that can be drawn from fields, by name: for vectors, their length and each component."""
    components = {name: 1 if values.ndim == dim else len(values) for name, values in fields.items()}
    return {scalar.name: scalar for scalar in parts_of(components)}


def chosen(fields: Mapping[str, np.ndarray], name: str, dim: int) -> tuple[str, np.ndarray]:
    """Label and values of one of several fields; InputError for an unknown name."""
    known = scalars(fields, dim)
    if kinds.text(name, "name") not in known:
        raise InputError("there is no such field", value=name, limit=", ".join(known), key="name")
    return in_words(known[name].label), known[name].of(fields[known[name].field])


def _look(name: str, limits: tuple[float, float] | None, cracks: Sequence[np.ndarray]) -> Look:
    """The look of a field, with checked limits of its scale."""
    if limits is not None:
        low, high = kinds.array(limits, "limits", shape=(2,)).tolist()
        if not low < high:
            raise InputError("a range goes from a number to a larger one", value=limits, key="limits")
        limits = low, high
    return Look(colors=DAMAGE if name == "damage" else None, limits=limits, cracks=cracks)


def snapshot(
    fields: Mapping[str, np.ndarray],
    name: str,
    axes: Axes,
    title: str,
    path: File = None,
    limits: tuple[float, float] | None = None,
    cracks: Sequence[np.ndarray] = (),
) -> Any:
    """Draw one of several fields; see `Run.plot`."""
    if path is not None:
        path = kinds.path(path, "path")
        if path.suffix.lower().lstrip(".") not in FORMATS:
            raise InputError("unknown format", value=path.name, limit=", ".join(FORMATS), key="path")
    look = _look(name, limits, cracks)
    label, values = chosen(fields, name, len(axes))
    return field_panels([Panel(title, values)], axes, path, look._replace(label=label))


class Frames:
    """Frames of a film: one field at several times; in 3D, its slice in the middle of z; see `Run.animate`."""

    def __init__(
        self,
        name: str,
        axes: Axes,
        path: File = None,
        limits: tuple[float, float] | None = None,
        cracks: Sequence[np.ndarray] = (),
    ) -> None:
        self._name, self._axes, self._look = name, axes, _look(name, limits, cracks)
        self._path = None if path is None else kinds.path(path, "path")
        self._format = "gif" if self._path is None else film_format(self._path, "path")
        self._frames: list[Panel] = []

    def add(self, fields: Mapping[str, np.ndarray], title: str) -> None:
        """Add the current field as a frame; InputError for an unknown name."""
        label, values = chosen(fields, self._name, len(self._axes))
        self._look = self._look._replace(label=label)
        values = values if values.ndim < 3 else values[..., values.shape[2] // 2, None].copy()
        self._frames.append(Panel(title, values))

    def film(self) -> Film:
        """Make the film, and write it if there is a path."""
        axes = [axis if number < 2 else axis[[axis.size // 2]] for number, axis in enumerate(self._axes)]
        film = made_film(self._frames, axes, self._format, self._look)
        if self._path is not None:
            film.save(self._path)
        return film
