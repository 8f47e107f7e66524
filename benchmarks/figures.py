"""Figures of README.md and docs/: measured by the commands that users have, kept in docs/figures.json, and written into
the documents where they are marked.

A document marks a figure as ``<!-- figure: KEY -->VALUE<!-- end -->``. This script runs the given commands, takes the
figures of each from the output of its ``--json`` option, and keeps them with the command, the date and the processor;
then it rewrites all marked places. ``tests/test_documents.py`` compares the places with the file, and in its slow tier
the file with the current output of some commands.

Run: ``python benchmarks/figures.py [NAME...]``; without a name it only rewrites the places. ``--list`` prints names and
commands.
"""

from __future__ import annotations

import argparse
import datetime
import json
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
STORE = ROOT / "docs" / "figures.json"
WRITTEN = ("generated", "gallery", "api")  # folders that the build of the site writes
DOCUMENTS = [ROOT / "README.md", *(p for p in sorted((ROOT / "docs").rglob("*.md")) if p.parent.name not in WRITTEN)]
PLACE = re.compile(r"<!-- figure: (\S+) -->(.*?)<!-- end -->")
PICTURE_COLOURS = 256  # of docs/demo.png: with a palette it has a third of the size


class Measurement(NamedTuple):
    """A command, and functions that read figures from its JSON: one number per figure, or the smallest and the
    largest."""

    command: tuple[str, ...]
    figures: dict[str, Callable[[Any], float | tuple[float, float]]]


def reproduced(name: str, wanted: dict[str, tuple[str, str]]) -> Measurement:
    """Errors of a reproduction: for each key, the range, "best" or "first" over boundaries whose names begin so."""

    def reader(start: str, how: str) -> Callable[[Any], float | tuple[float, float]]:
        def read(found: Any) -> float | tuple[float, float]:
            given = [value for boundary, value in found["infinite_error"].items() if boundary.startswith(start)]
            # JSON has no infinity: an overflow is null
            errors = [float("inf") if value is None else value for value in given]
            if how == "first":
                return errors[0]
            return min(errors) if how == "best" else (min(errors), max(errors))

        return read

    command = ("farhorizon", "reproduce", name)
    return Measurement(command, {key: reader(*how) for key, how in wanted.items()})


def validated(name: str, *, ours: dict[str, int] | None = None, off: dict[str, int] | None = None) -> Measurement:
    """Numbers of a problem with an exact solution, by their row in its table: the numbers themselves (`ours`), or their
    relative differences from the exact ones (`off`).
    """

    def number(row: int, found: Any) -> float:
        return float(found["rows"][row]["ours"])

    def deviation(row: int, found: Any) -> float:
        return abs(number(row, found) / found["rows"][row]["printed"] - 1)

    readers = {f"{name}.{key}": partial(number, row) for key, row in (ours or {}).items()}
    readers |= {f"{name}.{key}": partial(deviation, row) for key, row in (off or {}).items()}
    return Measurement(("farhorizon", "validate", name), readers)


def ends(found: Any, what: str) -> tuple[float, float]:
    """Smallest and largest number over the rows of a table whose name contains a text."""
    given = [float(row["ours"]) for row in found["rows"] if what in row["what"]]
    return min(given), max(given)


def reach(m: int, nodes: int) -> Callable[[Any], float]:
    """Error with a layer of `nodes` nodes for a stencil of reach m."""
    return lambda found: next(
        row[f"{nodes} nodes/initial"] for row in found["rows"] if row["2D wave to t=60"] == f"m={m}"
    )


def spread(case: str, column: str, word: str = "", percent: bool = False) -> Callable[[Any], tuple[float, float]]:
    """Smallest and largest value in a column of a benchmark, over the rows whose case contains a word; with `percent`,
    the excess of ratios over 1 in per cent.
    """

    def read(found: Any) -> tuple[float, float]:
        given = [float(row[column]) for row in found["rows"] if word in row[case]]
        values = [100 * (value - 1) for value in given] if percent else given
        return min(values), max(values)

    return read


def at_error(program: str, error: float, found: Any) -> float:
    """Time of another program over ours for an error; infinity if none of its settings reached the error."""
    row = next(r for r in found["rows"] if r["program"] == program and abs(r["error at most"] / error - 1) < 1e-9)
    return float("inf") if row["times ours"] == "-" else float(row["times ours"])


MEASUREMENTS = {
    "demo": Measurement(
        ("farhorizon", "demo"),
        {
            "demo.error": lambda found: found["lattice PML"]["error_max_over_run"],
            "demo.fixed": lambda found: found["fixed edge"]["error_max_over_run"],
        },
    ),
    "square": reproduced(
        "hermann2023-ex1",
        {
            "square.published": ("published", "first"),
            "square.readings": ("published", "all"),
            "square.repaired": ("repaired", "first"),
            "square.sharp": ("repaired, hardly regularised", "best"),
            "square.higdon": ("Higdon (0, 45)", "best"),
            "square.first": ("first order", "best"),
            "square.pml": ("lattice PML", "best"),
        },
    ),
    "discs": reproduced(
        "hermann2023-ex2",
        {
            f"disc{m}.{key}": (f"horizon {m} spacings: {start}", how)
            for m in (3, 6)
            for key, start, how in (
                ("published", "published", "first"),
                ("readings", "published", "all"),
                ("repaired", "repaired", "first"),
                ("sharp", "repaired, hardly regularised", "best"),
                ("higdon", "Higdon (0, 45)", "best"),
                ("pml", "lattice PML", "best"),
            )
        },
    ),
    "notches": reproduced(
        "hermann2023-ex3",
        {
            f"notches.{key}": (f"radius 26, {start}", how)
            for key, start, how in (
                ("published", "published", "first"),
                ("readings", "published", "all"),
                ("repaired", "repaired", "first"),
                ("sharp", "repaired, hardly regularised", "best"),
                ("higdon", "Higdon (0, 45)", "best"),
                ("pml", "lattice PML", "best"),
            )
        },
    ),
    "wide": Measurement(
        ("python", "benchmarks/accuracy.py", "waves2d"),
        {f"reach{m}.{nodes}": reach(m, nodes) for m in (4, 5, 6) for nodes in (12, 20)},
    ),
    "gaussian-bar": validated("gaussian-bar", ours={"error": 0, "order": 2}),
    "gaussian-solid": validated("gaussian-solid", ours={"error": 0}),
    "gaussian-plane": validated("gaussian-plane", ours={"error": 0, "layers": 3}),
    "mach-cone": validated("mach-cone", ours={"error": 1, "order": 2}, off={"angle": 3}),
    "mach-cones": validated("mach-cones", ours={"error": 1, "order": 2}),
    "explosion": validated("explosion", ours={"error": 2, "order": 4}, off={"static": 6}),
    "pressed-cavity": validated("pressed-cavity", ours={"passing": 2, "error": 3, "order": 5}),
    "garvin": validated("garvin", ours={"error": 1, "order": 2}),
    "pekeris": validated("pekeris", ours={"passing": 0, "error": 1, "order": 4}),
    "cylinders": validated("cylinders", ours={"soft": 1, "rigid": 5, "soft-order": 2, "rigid-order": 6}),
    "crack-scattering": validated("crack-scattering", ours={"error": 1, "order": 2}),
    "cavity": validated("cavity", ours={"error": 1, "order": 2}),
    "mode-three": validated("mode-three", off={"early": 0, "late": 2, "static": 6}),
    "mode-one": validated("mode-one", off={"early": 1, "late": 3, "static": 6, "size": 7}),
    "kalthoff": validated("kalthoff", ours={"one": 2, "two": 3, "one-order": 4, "two-order": 5}),
    "lattice-crack": validated("lattice-crack", ours={"coarse": 2, "fine": 5}),
    "lattice-line": validated("lattice-line", ours={"coarse": 2, "fine": 5}),
    "lattice-fracture": validated(
        "lattice-fracture",
        ours={"slow": 1, "fast": 22, "history": 11, "slow-history": 3},
        off={"load": 8, "goes-on": 24, "heals": 25},
    ),
    "griffith-crack": validated("griffith-crack", ours={"sliding": 3, "opening": 5}, off={"intensity": 2}),
    "penny-pressure": validated("penny-pressure", off={"opening": 1, "intensity": 2}),
    "branching": validated("branching", ours={"time": 0, "echo": 2, "boxed": 4, "speed": 5}),
    "branching-patterns": Measurement(
        ("farhorizon", "validate", "branching-patterns"),
        {
            "branching-patterns.before": lambda found: ends(found, "speed before"),
            "branching-patterns.ever": lambda found: ends(found, "any time")[1],
            **{
                f"branching-patterns.{key}": partial(lambda what, found: ends(found, what)[0], what)
                for key, what in {
                    "coarse-three": "horizon 0.5, 3 spacings: branches",
                    "coarse-four": "horizon 0.5, 4 spacings: branches",
                    "three": "horizon 0.25, 3 spacings: branches",
                    "four": "horizon 0.25, 4 spacings: branches",
                }.items()
            },
        },
    ),
    "penny-crack": validated("penny-crack", ours={"order": 2}, off={"jump": 1}),
    "pencil-electrode": validated("pencil-electrode", off={"rate": 2}),
    "open-electrolyte": validated("open-electrolyte", off={"rate": 2}),
    "thermal-shock": validated(
        "thermal-shock", ours={"inside": 4, "left": 5, "computed": 6, "order": 8, "coupled": 11, "coupled-order": 12}
    ),
    "receivers": Measurement(
        ("python", "benchmarks/receivers.py", "points", "shell"),
        {
            f"receivers.{key}": spread("recorder", "added %", word)
            for key, word in {
                "nodes": "on nodes",
                "linear": "linear",
                "sinc": "sinc",
                "shell": "every = 1",
                "thirds": "every = 3",
            }.items()
        },
    ),
    "far-field": Measurement(
        ("python", "benchmarks/far_field.py"),
        {
            "far-field.frequencies": spread("far field", "added %", "20 frequencies"),
            "far-field.history": spread("far field", "added %", "history"),
        },
    ),
    "passes": Measurement(
        ("python", "benchmarks/elastic.py", "passes"),
        {
            f"passes.{key}{dim}": spread("case", "stencil/passes", f"{dim}D {material}")
            for key, material in (("states", "state-based"), ("correspondence", "correspondence"))
            for dim in (2, 3)
        }
        | {
            "passes.free": spread("case", "free/periodic", "3D", percent=True),
            "passes.hole": spread("case", "hole/periodic", "3D", percent=True),
            "passes.bytes": spread("case", "bytes/node"),
        },
    ),
    "peers-acoustic": Measurement(  # these three: in an environment with benchmarks/peers/requirements.txt
        ("python", "benchmarks/peers/acoustic.py", "--quick"),
        {
            f"acoustic.{key}{exponent}": partial(at_error, name, 10.0**-exponent)
            for key, name in {"deepwave": "Deepwave", "devito": "Devito"}.items()
            for exponent in (2, 3)
        },
    ),
    "peers-slices": Measurement(
        ("python", "benchmarks/peers/slices.py"),
        {
            f"slices.{key}": spread("2D, 36 neighbours", "times ours", name)
            for key, name in {"csr": "scipy CSR", "numpy": "NumPy", "jax": "JAX"}.items()
        },
    ),
    "peers-bonds": Measurement(
        ("python", "benchmarks/peers/bonds.py"),
        {
            "bonds.lammps": spread("122 bonds", "times ours", "LAMMPS"),
            "bonds.difference": spread("122 bonds", "difference", "LAMMPS"),
        },
    ),
    "bar": Measurement(
        ("python", "benchmarks/layer.py", "bar"),
        {
            "bar.ratio": lambda found: found["rows"][0]["layers us"] / found["rows"][0]["bare us"],
            "bar.added": lambda found: found["rows"][0]["added us"],
        },
    ),
}


def written(value: float | tuple[float, float]) -> str:
    """Text of a figure in the documents: two digits, and a range as "a to b" if these differ."""
    if isinstance(value, tuple):
        ends = written(value[0]), written(value[1])
        return ends[0] if ends[0] == ends[1] else " to ".join(ends)
    if value == float("inf"):
        return "overflow"
    if 1e2 <= abs(value) < 1e3:
        return f"{value:.0f}"
    if value != 0 and not 1e-2 <= abs(value) < 1e3:
        mantissa, exponent = f"{value:.1e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    return f"{value:.2g}"


def processor() -> str:
    """Name of the processor, if the operating system provides it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def measure(name: str, picture: Path | None = None) -> dict[str, dict[str, Any]]:
    """Run one command and read its figures; the picture of the demo is written to `picture`."""
    import farhorizon

    command, figures = MEASUREMENTS[name]
    with tempfile.TemporaryDirectory() as folder:
        made, out = Path(folder) / "found.json", Path(folder) / "out"
        program = {"farhorizon": [sys.executable, "-m", "farhorizon"], "python": [sys.executable]}[command[0]]
        more = ["--out", str(out)] if command[0] == "farhorizon" else []
        subprocess.run([*program, *command[1:], *more, "--json", str(made)], cwd=ROOT, check=True)
        found = json.loads(made.read_text())
        if name == "demo" and picture is not None:
            shrink(out / "compare.png", picture)
    about = {
        "command": " ".join(command),
        "date": datetime.date.today().isoformat(),
        "processor": processor(),
        "version": farhorizon.__version__,
    }
    return {key: {"value": written(read(found)), **about} for key, read in figures.items()}


def shrink(source: Path, target: Path) -> None:
    """Write the picture with a palette, which makes it small enough for a document."""
    from PIL import Image

    with Image.open(source) as image:
        image.convert("RGB").quantize(PICTURE_COLOURS).save(target, optimize=True)


def rewrite(figures: dict[str, dict[str, Any]]) -> None:
    """Write the figures where the documents mark them."""
    for path in DOCUMENTS:
        text = path.read_text(encoding="utf-8")
        new = PLACE.sub(
            lambda place: (
                f"<!-- figure: {place[1]} -->{figures.get(place[1], {'value': place[2]})['value']}<!-- end -->"
            ),
            text,
        )
        if new != text:
            path.write_text(new, encoding="utf-8")


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(MEASUREMENTS)}, or all")
    parser.add_argument("--list", action="store_true", help="names and commands")
    given = parser.parse_args()
    if given.list:
        for name, measurement in MEASUREMENTS.items():
            print(f"{name:18}{' '.join(measurement.command)}")
        return
    names = list(MEASUREMENTS) if given.names == ["all"] else given.names
    if unknown := set(names) - set(MEASUREMENTS):
        parser.error(f"unknown measurement {', '.join(sorted(unknown))}; known: {', '.join(MEASUREMENTS)}")
    for name in names:
        figures = json.loads(STORE.read_text()) if STORE.exists() else {}
        figures |= measure(name, ROOT / "docs" / "demo.png")
        STORE.write_text(json.dumps(dict(sorted(figures.items())), indent=1) + "\n")
    rewrite(json.loads(STORE.read_text()))


if __name__ == "__main__":
    main()
