"""`farhorizon invert`: find the medium for which the runs of some cases agree with data."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farhorizon.cli.common import GOOD, INTERRUPTED, check_folder, made_folder, thread_change, write_json
from farhorizon.cli.processes import refuse_processes

if TYPE_CHECKING:
    from farhorizon.cli.outputs import InvertFacts


def invert_command(options: argparse.Namespace) -> int:
    """Continue the inversion of a file, or begin it; then draw and print what was found."""
    from farhorizon.case.changes import parsed
    from farhorizon.case.inversion import InversionFile
    from farhorizon.files.storage import locked

    check_folder(options.out)
    refuse_processes()
    asked = InversionFile.read(options.file, dict(map(parsed, options.set)), thread_change(options))
    path = made_folder(options.out) / f"{asked.name}_inversion.h5"
    with locked(path.with_name(f".{path.stem}.lock")):
        if options.force:
            path.unlink(missing_ok=True)
        print(f"{asked.name}: {len(asked.shots)} shots; {'continues' if path.exists() else 'begins'} {path}")
        try:
            # a progress line on terminals shows the misfit; elsewhere each iteration has a line
            say = None if sys.stderr.isatty() else _say
            inversion = asked.run(output=path, callback=say, progress=False if options.quiet else None)
        except KeyboardInterrupt:
            print(f"\ninterrupted; the same command continues {path}", file=options.errors)
            return INTERRUPTED
        pictures = _draw(asked, inversion, made_folder(str(path.with_suffix(""))))
    first = next(step.misfit for step in inversion.history if step.stage == inversion.history[-1].stage)
    print(inversion.message)
    print(
        f"{asked.name}: misfit {first:.4g} -> {inversion.misfit:.4g} in {_iterations(inversion)} iterations; "
        f"results: {path}; pictures: {', '.join(map(str, pictures))}",
        file=options.output,
    )
    figures: InvertFacts = {
        "name": asked.name,
        "results": str(path),
        "pictures": [str(picture) for picture in pictures],
        "message": inversion.message,
        "history": [step._asdict() for step in inversion.history],  # type: ignore[misc]
        "least": {name: float(values.min()) for name, values in inversion.maps.items()},
        "largest": {name: float(values.max()) for name, values in inversion.maps.items()},
    }
    write_json(options.json, figures)
    return GOOD


def _iterations(inversion: Any) -> int:
    """Number of iterations in all stages, the first step of each of which is its start."""
    return len(inversion.history) - len({step.stage for step in inversion.history})


def _say(so_far: Any) -> None:
    step = so_far.history[-1]
    print(f"iteration {step.iteration}: misfit {step.misfit:.4g}", flush=True)


def _draw(asked: Any, inversion: Any, folder: Path) -> list[Path]:
    """Draw the maps, their changes, the misfits, and the records of the first shot; returns the paths."""
    import numpy as np

    from farhorizon.pictures.inversions import map_picture, misfit_picture, records_picture
    from farhorizon.pictures.panels import Look, Panel
    from farhorizon.pictures.style import counted_in, with_unit

    case, (_, misfit) = asked.cases[0], asked.shots[0]
    lattice, start, pictures = case.lattice, inversion.models[0], []
    line, exists = misfit.receivers, np.ones(lattice.shape, bool) if lattice.existing is None else lattice.existing
    places = {
        "sources": _places([setup for setup, _ in asked.shots], lattice.dim),
        "receivers": np.unique(np.concatenate([one.receivers.points for _, one in asked.shots]), axis=0),
    }
    with counted_in(case.unit_names):
        for name, values in inversion.maps.items():
            label = with_unit(name, name)
            ends = [float(values[exists].min()), float(values[exists].max())]
            limits = (ends[0], ends[1]) if ends[0] < ends[1] else None
            for kind, shown, scale in [(name, values, limits), (f"{name}_change", values - start[name], None)]:
                title = f"after {_iterations(inversion)} iterations" if kind == name else "change from the start"
                path = folder / f"{kind}.png"
                panel = Panel(title, np.where(exists, shown, np.nan))
                map_picture(panel, lattice.axes, places, path, Look(label, limits=scale))
                pictures.append(path)
        stages = asked.arguments.get("frequencies", [None])
        unit = case.unit_names.get("frequency", "")
        names = ["all frequencies" if one is None else f"frequencies below {one:g} {unit}".strip() for one in stages]
        pictures.append(folder / "misfit.png")
        misfit_picture(inversion.history, names, pictures[-1])
        for name, data in misfit.data.items():
            records, label = inversion.records[0][0][name], name
            if data.ndim == 3:  # the component that moves most
                component = int(np.abs(data).max((0, 1)).argmax())
                data, records, label = data[..., component], records[..., component], f"{name}_{'xyz'[component]}"
            pictures.append(folder / f"records_{name}.png")
            records_picture(line.points, line.times, data, records, pictures[-1], with_unit(label, name))
    return pictures


def _places(setups: Any, dim: int) -> Any:
    """Places of the sources of all shots that have some, shape (n, dim)."""
    import numpy as np

    sources = [source for setup in setups for source in setup.sources]
    given = [
        getattr(source, name) for source in sources for name in ("at", "points", "centres") if hasattr(source, name)
    ]
    found = [np.reshape(points, (-1, dim)) for points in given]
    return np.unique(np.concatenate([np.zeros((0, dim)), *found]), axis=0)
