"""The tables of an inversion file: what `fh.invert` takes, and the shots."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Literal

from pydantic import Field, create_model

from farhorizon import public as fh
from farhorizon.case.schema import FilePath, Part, tables

#: Misfits of data by the name that a file gives them.
MISFITS: dict[str, Any] = {"least-squares": fh.LeastSquares, "envelope": fh.Envelope, "travel-time": fh.TravelTime}


class ShotPart(Part):
    """A run of the medium from which the inversion starts, and what was recorded of it."""

    case: FilePath
    """A case file: the medium at the start, what drives it, and the receivers; its end is that of the inversion."""
    data: FilePath
    """What was recorded: a .npy file with one row for each record of the run, of shape (rows, receivers) or (rows,
    receivers, dim); or a results file of `farhorizon run` that has receivers of the same name."""
    receivers: str | None = None
    """Name of the receivers, where the case has several."""
    misfit: Literal["least-squares", "envelope", "travel-time"] = "least-squares"
    """How records are compared with the data: by their differences, by envelopes, or by the delays of arrivals."""
    set: dict[str, Any] = Field({}, examples=[{"source.at": [1.0, 2.0]}])
    """Other values at dotted keys of the case, in quotes, as --set gives them: one case serves many shots."""


class InversionFilePart(Part):
    """A complete inversion file; `inversion_part` states the table of the inversion."""

    inversion: Any
    """What is unknown, within which bounds, and how it is sought."""
    shot: list[ShotPart]
    """The runs and their data."""


def inversion_part() -> type[InversionFilePart]:
    """The table of a complete inversion file."""
    return _part(tables().of(fh.invert))


@lru_cache(maxsize=4)
def _part(table: type[Part]) -> type[InversionFilePart]:
    words = InversionFilePart.model_fields["inversion"].description
    settings = {"use_attribute_docstrings": False}
    keys: dict[str, Any] = {"inversion": (table, Field(description=words))}
    return create_model("InversionFilePart", __base__=InversionFilePart, __cls_kwargs__=settings, **keys)
