"""What a resumed run takes from a checkpoint."""

from __future__ import annotations

import json
from collections.abc import Container, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.errors import FileFormatError
from farhorizon.files.checkpoint_format import read_checkpoint
from farhorizon.simulation.setup.serialization import rebuild


def stored(path: str | Path, kind: str, left_out: Container[str]) -> dict[str, Any]:
    """Return the arguments of the run that wrote a checkpoint, without those in `left_out`; the initial data are arrays
    of its state.

    Parameters
    ----------
    path : str or Path
    kind : str
        Name of the class of the run.
    left_out : container of str
        Names of arguments to omit.

    Raises
    ------
    InputError
        An argument is a Python function, which a file cannot hold.
    FileFormatError
        The file is damaged or foreign, holds another kind of run, or was written by several processes.
    """
    arrays, meta = read_checkpoint(path)
    if len(meta.get("boxes", ())) > 1:
        raise FileFormatError(
            "a checkpoint of several processes does not hold what was given for the run",
            value=str(path),
            remedy=f"make the same {kind} and load(path)",
        )
    if "setup" not in meta or meta.get("fingerprint", {}).get("run", "Simulation") != kind:
        raise FileFormatError(
            f"the file holds no {kind}", value=str(path), remedy=f"a checkpoint written by {kind}.save"
        )
    given = {name: value for name, value in meta["setup"]["dict"].items() if name not in left_out}
    found = {name: rebuild(value, arrays, name) for name, value in given.items()}
    if "start_u" in arrays:
        found["initial"] = {"u": arrays["start_u"] + rebuild(meta["setup"]["dict"]["background"], arrays)}
        found["initial"] |= {"v": arrays["start_v"]} if np.any(arrays["start_v"]) else {}
    return found


def check_alike(
    path: str | Path, meta: Mapping[str, Any], fingerprint: dict[str, Any], left_out: Container[str] = ()
) -> None:
    """Refuse a checkpoint whose fingerprint, in `meta`, differs from that of a set-up; entries in `left_out` are not
    compared.

    Raises
    ------
    FileFormatError
    """
    mine, theirs = json.loads(json.dumps(fingerprint)), meta.get("fingerprint", {})
    different = sorted(k for k in {*mine, *theirs} if k not in left_out and mine.get(k) != theirs.get(k))
    if different:
        raise FileFormatError(
            "the checkpoint belongs to another set-up",
            value=str(path),
            limit=f"same {', '.join(different)}",
            remedy="resume with the case that wrote it",
        )
