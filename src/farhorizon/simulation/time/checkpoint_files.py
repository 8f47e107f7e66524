"""Checkpoint files.

One process writes one file. Of several processes, each writes the state of the nodes in its box to a file of its own,
whose name contains the step (``NAME.ckpt.parts/120-0000.ckpt``); then the first one writes ``NAME.ckpt``, which says
where the boxes lie and holds what is common to all, and removes the parts of earlier checkpoints. A complete checkpoint
thus exists whenever they are stopped. A run resumes from either kind on any number of processes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from farhorizon.engine.state import Box, common
from farhorizon.errors import FileFormatError
from farhorizon.files.checkpoint_format import read_checkpoint, write_checkpoint
from farhorizon.files.parts import folder_of
from farhorizon.simulation.setup.serialization import describe
from farhorizon.simulation.time.checkpoint import OF_A_BOX, Arrays, check_alike, fingerprint
from farhorizon.simulation.time.time_loop import TimeLoop


def write_state(
    path: Path, time_loop: TimeLoop, step: int, arrays: Arrays, kept: Mapping[str, Any], given: Mapping[str, Any]
) -> None:
    """Write the state of a run, further arrays (on several processes the same on all) and values for JSON, and the
    arguments of the run, on several processes with the sides as chosen.
    """
    team, folder = time_loop.team, folder_of(path)
    team.alike({"path": path})
    mine, meta = time_loop.state(step)
    meta |= {"fingerprint": facts_of(time_loop), **kept}
    if team:
        team.by_first(lambda: folder.mkdir(exist_ok=True))
        with team.agreed():
            write_checkpoint(_part(path, step, team.number), mine, {"step": step})
    arrays = {**arrays} if team else mine | arrays
    meta["setup"] = describe(given, arrays)

    def conclude() -> None:
        write_checkpoint(path, arrays, meta)
        for part in folder.iterdir() if folder.is_dir() else ():
            if not (team and part.name.startswith(f"{step}-")):
                part.unlink()
        if not team and folder.is_dir():
            folder.rmdir()

    team.by_first(conclude)


def read_state(path: Path, time_loop: TimeLoop) -> tuple[int, Arrays, dict[str, Any]]:
    """Restore the state stored in a checkpoint, whichever processes wrote it; returns its step, and the further arrays
    and values. FileFormatError if it is damaged, belongs to another set-up, or lacks a part.
    """
    with time_loop.team.agreed():
        arrays, meta = read_checkpoint(path)
        time_loop.team.alike({"path": [meta, arrays]})
        check_alike(path, meta, facts_of(time_loop), OF_A_BOX if time_loop.team or len(meta["boxes"]) > 1 else ())
        if not time_loop.take(_states_in(path, arrays, meta, time_loop.box), meta):
            raise FileFormatError(
                "the parts of the checkpoint do not fit together, or to this run",
                value=str(path),
                remedy="use the folder that the run has written beside the file, or start anew",
            )
    time_loop.complete()
    return int(meta["step"]), arrays, meta


def _states_in(path: Path, arrays: Arrays, meta: Mapping[str, Any], box: Box) -> Iterator[tuple[Box, Arrays]]:
    """Yield the boxes of a checkpoint that share nodes with a box, and their arrays."""
    boxes = meta["boxes"]
    for number, stored in enumerate(boxes):
        if common(box, stored, (0, 1, 2)) is None:
            continue
        part = _part(path, int(meta["step"]), number)
        if len(boxes) > 1 and not part.is_file():
            raise FileFormatError(
                f"{path} lacks its part {part}", remedy=f"keep the folder {part.parent.name} beside the file"
            )
        yield stored, arrays if len(boxes) == 1 else read_checkpoint(part)[0]


def facts_of(time_loop: TimeLoop) -> dict[str, Any]:
    """What a checkpoint and the run that resumes from it must have in common."""
    lattice = time_loop.parts.near.lattice.whole
    ends = time_loop.team.gather([end for _, end in time_loop.box])
    return fingerprint(time_loop.setup, time_loop.parts, time_loop.first_cuts) | {
        "box": [max(end[axis] for end in ends) for axis in range(3)],
        "whole": list(lattice.shape),
        "corner": lattice.lower.tolist(),
    }


def remove_checkpoint(path: Path) -> None:
    """Remove a checkpoint, and its parts if several processes wrote it."""
    path.unlink(missing_ok=True)
    if (folder := folder_of(path)).is_dir():
        for part in folder.iterdir():
            part.unlink()
        folder.rmdir()


def _part(path: Path, step: int, number: int) -> Path:
    return folder_of(path) / f"{step}-{number:04d}.ckpt"
