"""Pickling and copying of runs by their arguments and state, because compiled loops hold addresses."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from farhorizon.errors import InputError


def check_picklable(given: Mapping[str, Any]) -> None:
    """Raise InputError for an argument that contains a function which another process could not find by its name."""
    for name, value in given.items():
        try:
            pickle.dumps(value)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise InputError(
                "what is made in place, as a lambda, cannot be pickled",
                value=str(error),
                limit="functions of a module, by their names",
                key=name,
                remedy="an expression as a text, or a function of a module",
            ) from None


def packed(run: Any) -> tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]:
    """Return what pickle stores of a run: its class, its arguments, its checkpoint with the data of recorders, and its
    observers and probes.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder, "state")
        run.save(path)
        state = path.read_bytes()
    kept = {"observers": run.observers, "probes": run.probes}
    given = {**run.given, "observe": run.recorders}
    return _unpacked, (type(run), given, state, None if run.probes is None else run.probes.nodes), kept


def _unpacked(run_type: Any, given: dict[str, Any], state: bytes, watched: Any) -> Any:
    with TemporaryDirectory() as folder:
        path = Path(folder, "state")
        path.write_bytes(state)
        run = run_type.restore(path, **given)
    if watched is not None:
        run._set_probes(watched)
    return run
