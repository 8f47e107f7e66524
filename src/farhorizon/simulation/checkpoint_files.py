"""The files of checkpoints.

One process writes one. Of several each writes what belongs to the nodes of its box into a file of its own, whose name
has the step (``NAME.ckpt.parts/120-0000.ckpt``); then the first one writes ``NAME.ckpt``, which says where the boxes
lie and has all that is the same for all, and removes the parts of earlier ones. Whenever they are stopped, there is a
whole one. A run goes on from it on any number of processes.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from farhorizon.engine.pieces import Assembly, common, pieces_of
from farhorizon.errors import FileFormatError
from farhorizon.files.parts import folder_of
from farhorizon.files.results import read_checkpoint, write_checkpoint
from farhorizon.simulation.checkpoint import Arrays, fingerprint
from farhorizon.simulation.described import describe
from farhorizon.simulation.march import March
from farhorizon.simulation.resume import check_alike

# facts that are others on each process
_OF_A_BOX = (
    *("levels", "memory", "shape", "lower", "held", "cuts", "conditions", "density", "strength", "toughness", "solid"),
)


def write_state(
    path: Path, march: March, step: int, arrays: Arrays, kept: Mapping[str, Any], given: Mapping[str, Any]
) -> None:
    """Write the state of a run.

    Parameters
    ----------
    path : Path
    march : March
    step : int
    arrays : mapping of str to ndarray
        What else is kept, on several processes the same on all.
    kept : mapping
        The same as JSON.
    given : mapping
        What was given for the run, which a checkpoint of one process has.
    """
    if march.team:
        _write_jointly(path, march, step, arrays, kept)
        return
    more, meta = march.state(step)
    arrays = more | arrays
    meta |= {"fingerprint": fingerprint(march.setup, march.parts, march.first_cuts), **kept}
    meta["setup"] = describe(given, arrays)
    write_checkpoint(path, arrays, meta)


def read_state(path: Path, march: March) -> tuple[int, Arrays, dict[str, Any]]:
    """Be in the state that a checkpoint has; returns its step, and what else was kept.

    Raises
    ------
    FileFormatError
        A damaged file, the checkpoint of another set-up, on several processes that of one.
    """
    with march.team.agreed():
        arrays, meta = read_checkpoint(path)
        jointly = "boxes" in meta
        if jointly:
            step = _read_jointly(path, march, meta)
        elif march.team:
            raise FileFormatError(
                "this is the checkpoint of one process", value=str(path), remedy="go on without mpiexec, or start anew"
            )
        else:
            check_alike(path, meta, fingerprint(march.setup, march.parts, march.first_cuts))
            step = march.take(arrays, meta)
    for level in march.parts.grid.engine.levels if jointly else ():
        march.parts.grid.engine.complete(level)  # no file has the halos
    if jointly and march.parts.phases is not None:
        march.parts.phases.set(march.parts.phases.steps)
    return step, arrays, meta


def _write_jointly(path: Path, march: March, step: int, arrays: Arrays, kept: Mapping[str, Any]) -> None:
    team, engine, folder = march.team, march.parts.grid.engine, folder_of(path)
    meta = {
        "boxes": team.gather(box_of(march)),
        "step": step,
        "phase": int(engine.phase),
        "scale": team.largest(march.feed.scale),
        "fingerprint": _facts(march),
        "sums": march.sums(),
        "first_amounts": {} if march.flow_balance is None else march.flow_balance.first,
        **kept,
    }
    team.by_first(lambda: folder.mkdir(exist_ok=True))
    with team.agreed():
        mine = {name: piece.held[piece.places] for name, piece in pieces_of(engine).items()}
        write_checkpoint(_part(path, step, team.number), mine, {"step": step})

    def conclude() -> None:
        write_checkpoint(path, arrays, meta)
        for one in folder.iterdir():
            if not one.name.startswith(f"{step}-"):
                one.unlink()

    team.by_first(conclude)


def _read_jointly(path: Path, march: March, meta: dict[str, Any]) -> int:
    check_alike(path, meta, _facts(march))
    grid, box, step = march.parts.grid, box_of(march), int(meta["step"])
    state = Assembly(grid.engine, box)
    for number, other in enumerate(meta["boxes"]):
        if common(box, other, (0, 1, 2)) is None:
            continue
        part = _part(path, step, number)
        if not part.is_file():
            raise FileFormatError(
                f"{path} lacks its part {part}", remedy=f"keep the folder {part.parent.name} beside the file"
            )
        if not state.add(other, read_checkpoint(part)[0]):
            raise _unlike(path)
    march.team.gather(None)  # of one that lacks a part nothing else comes
    march.go_on(step)
    if not state.put():
        raise _unlike(path)
    grid.engine.phase, grid.engine.steps_done = int(meta["phase"]), step
    if grid.engine.bonds:
        grid.engine.bonds.find_kinds()
    march.take_sums(meta.get("sums", {}), meta.get("first_amounts", {}))
    march.feed.scale = float(meta["scale"])
    return step


def remove_checkpoint(path: Path) -> None:
    """Remove a checkpoint, that of several processes with its parts."""
    path.unlink(missing_ok=True)
    if (folder := folder_of(path)).is_dir():
        for one in folder.iterdir():
            one.unlink()
        folder.rmdir()


def box_of(march: March) -> list[tuple[int, int]]:
    """Where the box of this process lies in that of the whole, layers counted, along the engine's axes."""
    grid, lattice = march.parts.grid, march.parts.near.lattice
    low = [grid.engine.layout.low[a] + (grid.margins[a - grid.lead, -1] if a >= grid.lead else 0) for a in range(3)]
    every = march.team.gather(low)
    first = (0,) * grid.lead + lattice.first
    starts = [f + max(one[a] for one in every) - low[a] for a, f in enumerate(first)]
    return [(int(start), int(start) + n) for start, n in zip(starts, grid.engine.layout.box.nodes, strict=True)]


def _part(path: Path, step: int, number: int) -> Path:
    return folder_of(path) / f"{step}-{number:04d}.ckpt"


def _facts(march: March) -> dict[str, Any]:
    """What a checkpoint and the run that goes on from it have in common, however many processes compute it."""
    own, whole = fingerprint(march.setup, march.parts, 0), march.parts.near.lattice.whole
    ends = march.team.gather([end for _, end in box_of(march)])
    box = [max(one[a] for one in ends) for a in range(3)]
    more = {"box": box, "shape": list(whole.shape), "lower": whole.lower.tolist()}
    return {name: value for name, value in own.items() if name not in _OF_A_BOX} | more


def _unlike(path: Path) -> FileFormatError:
    return FileFormatError(
        "the parts of the checkpoint do not fit together, or to this run",
        value=str(path),
        remedy="use the folder that the run has written beside the file, or start anew",
    )
