"""Errors that name the value, the limit and a remedy."""

from __future__ import annotations

from typing import Any


class FarhorizonError(Exception):
    """Base of every error that farhorizon raises on purpose."""


class InputError(FarhorizonError, ValueError):
    """Input that cannot be computed, refused before any work.

    Parameters
    ----------
    message : str
        What is wrong, in one sentence.
    value, limit : object, optional
        The offending value and the limit it breaks.
    remedy : str, optional
        What to do instead.
    key : str, optional
        Where the value stands, e.g. ``"model.kernel.horizon"``.
    """

    def __init__(self, message: str, *, value: Any = None, limit: Any = None, remedy: str = "", key: str = "") -> None:
        self.message, self.value, self.limit, self.remedy, self.key = message, value, limit, remedy, key
        parts = [f"{key}: {message}" if key else message]
        if value is not None:
            parts.append(f"value: {value}")
        if limit is not None:
            parts.append(f"limit: {limit}")
        if remedy:
            parts.append(f"remedy: {remedy}")
        super().__init__("; ".join(parts))


class FileFormatError(InputError):
    """A results file, checkpoint or case file that is truncated, foreign or damaged."""


class UnstableError(FarhorizonError, RuntimeError):
    """The run produced a non-finite or exploding value; the message says step, place and likely cause."""


class ValidityWarning(UserWarning):
    """From some time of a run on its result is doubtful; see `Run.cautions`."""
