"""A run as a value: pickled and copied by what was given and its state, since compiled loops hold addresses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any


def packed(run: Any) -> tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]:
    """What pickle keeps of a run: its class, what was given, its checkpoint, which has the records of recorders;
    observers and probes.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder, "state")
        run.save(path)
        state = path.read_bytes()
    kept = {"observers": run.observers, "probes": run.probes}
    given = {**run.given, "observe": run.recorders}
    return _unpacked, (type(run), given, state, None if run.probes is None else run.probes.nodes), kept


def _unpacked(kind: Any, given: dict[str, Any], state: bytes, watched: Any) -> Any:
    with TemporaryDirectory() as folder:
        path = Path(folder, "state")
        path.write_bytes(state)
        run = kind.restore(path, **given)
    if watched is not None:
        run._watch(watched)
    return run
