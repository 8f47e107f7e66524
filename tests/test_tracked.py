"""The table of benchmarks from commit to commit is that of the history of their store."""

import importlib.util
import json
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def _tracked():
    spec = importlib.util.spec_from_file_location("tracked", ROOT / "benchmarks" / "tracked.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.skipif(shutil.which("git") is None, reason="reads the history of a repository")
def test_each_measurement_is_in_the_column_of_its_commit(tmp_path):
    """Commits that measure nothing of the benchmarks have no column, tags have one, and a figure that was measured
    again is shown although it is the same.
    """

    def git(*words):
        who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
        subprocess.run(["git", *who, *words], cwd=tmp_path, check=True, capture_output=True)

    def commit(store):
        (tmp_path / "docs").mkdir(exist_ok=True)
        (tmp_path / "docs" / "figures.json").write_text(json.dumps(store))
        git("add", "-A")
        git("commit", "-m", "measure", "--allow-empty")

    def figure(value, day, command="python benchmarks/step.py"):
        return {"value": value, "date": day, "command": command}

    git("init")
    git("commit", "-m", "begin", "--allow-empty")
    commit({"step": figure("5", "2026-01-01"), "error": figure("1e-9", "2026-01-01", "farhorizon demo")})
    commit({"step": figure("5", "2026-01-01"), "error": figure("2e-9", "2026-01-02", "farhorizon demo")})
    commit({"step": figure("5", "2026-01-03")})
    git("tag", "v1.0")
    commit({"step": figure("5", "2026-01-03"), "other": figure("2", "2026-01-04")})
    module = _tracked()
    first, tagged, last = module.states(tmp_path)
    assert tagged.name == "v1.0" and "error" not in first.figures
    head, _, other, step = module.table([first, tagged, last]).splitlines()
    assert head.startswith("| figure |") and "v1.0" in head
    assert (other, step) == ("| other |  |  | 2 |", "| step | 5 | 5 |  |")


def test_the_page_has_that_form():
    module = _tracked()
    text = module.PAGE.read_text(encoding="utf-8")
    assert (
        text.startswith(module.HEAD) and len({line.count("|") for line in text[len(module.HEAD) :].splitlines()}) == 1
    )
