"""The ratios of the benchmarks from commit to commit and at each tag: a table of the history of docs/figures.json.

`figures.py` keeps what it measures with the command; each state of that file in the history of the repository is one
measurement of the code of that time. The table has the figures of scripts in this folder, one column for each commit
that measured one of them, and one for each tag. They are ratios, errors and bytes; of absolute times there is one,
``bar.added`` in microseconds. Whether the machine was the same, says docs/figures.json of that commit.

Run: ``python benchmarks/tracked.py [--write]``; it prints the table, or writes docs/evidence/tracked.md. After a change
that may cost time, measure (``python benchmarks/figures.py passes receivers far-field bar``), commit, and run it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "evidence" / "tracked.md"
STORE = "docs/figures.json"
HEAD = """# Tracked figures

How the ratios of the benchmarks changed from commit to commit and at each release: the history of `docs/figures.json`,
written by `python benchmarks/tracked.py --write`. A cell is empty where the figure was not measured anew.

"""


class State(NamedTuple):
    """The figures of the benchmarks at one commit, by their keys."""

    name: str  # tag, or the short hash
    date: str
    figures: dict[str, tuple[str, str]]  # value, and the day when it was measured


def _git(*words: str, root: Path) -> str:
    return subprocess.run(["git", *words], cwd=root, check=True, capture_output=True, text=True).stdout


def states(root: Path = ROOT) -> list[State]:
    """States of the store from the oldest: at each commit that changed a figure of a benchmark, and at each tag."""
    tags: dict[str, list[str]] = {}
    for tag in _git("tag", root=root).split():
        tags.setdefault(_git("rev-list", "-n", "1", tag, root=root).strip(), []).append(tag)
    log = _git("log", "--reverse", "--topo-order", "--format=%H %h %cs", root=root).splitlines()
    changed = set(_git("log", "--format=%H", "--", STORE, root=root).split())
    found: list[State] = []
    for full, short, date in map(str.split, log):
        if full not in changed | tags.keys():
            continue
        try:
            store = json.loads(_git("show", f"{full}:{STORE}", root=root))
        except subprocess.CalledProcessError:  # before there was one
            continue
        figures = {
            k: (v["value"], v["date"]) for k, v in store.items() if v["command"].startswith("python benchmarks/")
        }
        if full in tags or not found or figures != found[-1].figures:
            found.append(State(" ".join(tags.get(full, [short])), date, figures))
    return [state for state in found if state.figures]


def table(found: list[State]) -> str:
    """The table in Markdown: one row for each figure."""
    keys = sorted({key for state in found for key in state.figures})
    lines = [["figure", *(f"{state.name} ({state.date})" for state in found)], ["---"] * (len(found) + 1)]
    for key in keys:
        values = [None, *(state.figures.get(key) for state in found)]
        lines.append([key, *(new[0] if new and new != old else "" for old, new in pairwise(values))])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def main() -> None:
    """Print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.relative_to(ROOT)}")
    text = table(states())
    if parser.parse_args().write:
        PAGE.write_text(HEAD + text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":
    main()
