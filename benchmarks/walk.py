"""How many functions and files of the package does a plain run enter? A wave on 33 x 33 nodes between fixed sides.

    python benchmarks/walk.py --list

A feature that a run does not use should enter no function. The set-up, the run and its fields are followed, without
the import of the package, and with compiled loops from the cache.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import farhorizon as fh

PACKAGE = str(Path(fh.__file__).parent)


def plain_run() -> fh.Simulation:
    """Make and run the wave, and read its field."""
    lattice = fh.Lattice(spacing=1.0, lower=(-16.0, -16.0), upper=(16.0, 16.0))
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), fh.Fixed(), initial={"u": "exp(-(x**2 + y**2)/6)"})
    sim.run(until=20.0)
    _ = sim.fields["u"]
    return sim


def followed() -> Counter[CodeType]:
    """Return how often each function of the package is entered by `plain_run`, without comprehensions."""
    calls: Counter[CodeType] = Counter()

    def enter(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(PACKAGE) and not _is_expression(code):
            calls[code] += 1

    sys.setprofile(enter)
    try:
        plain_run()
    finally:
        sys.setprofile(None)
    return calls


def _is_expression(code: CodeType) -> bool:
    """Whether code is that of a comprehension, a generator expression or the body of a module or class."""
    return code.co_name in {"<listcomp>", "<dictcomp>", "<setcomp>", "<genexpr>", "<module>"} or not (
        code.co_flags & 0x2  # CO_NEWLOCALS: class bodies have none
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true", help="the functions of each file, with the number of calls")
    given = parser.parse_args()
    plain_run()  # compiles and caches, and imports what is imported late
    calls = followed()
    files: dict[str, list[CodeType]] = {}
    for code in sorted(calls, key=lambda code: (code.co_filename, code.co_firstlineno)):
        files.setdefault(Path(code.co_filename).relative_to(PACKAGE).as_posix(), []).append(code)
    if given.list:
        for file, functions in files.items():
            print(f"{len(functions):4d} {file}")
            for code in functions:
                print(f"         {calls[code]:4d} {code.co_qualname}")
    print(f"{len(calls)} functions in {len(files)} files, {sum(calls.values())} calls")


if __name__ == "__main__":
    main()
