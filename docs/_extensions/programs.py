"""Programs that pages show: run once for a state of the package, and kept with what they printed and drew."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import farhorizon

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
KEPT = DOCS / "generated"


class Run(NamedTuple):
    """What a program did. `folder` has its pictures."""

    command: str
    printed: str
    code: int
    seconds: float
    folder: Path

    @property
    def pictures(self) -> list[Path]:
        return sorted(self.folder.rglob("*.png"))


def run(path: Path, verb: str = "run", code: int = 0, drawn: Path | None = None) -> Run:
    """Run a case file or a script, unless this was done before with the same package and the same file.

    `verb` is what is done with a case. It has to end with `code`; `drawn` is a program that runs a script and draws
    what it has computed.
    """
    folder = KEPT / path.parent.name / f"{path.stem}_{path.suffix[1:]}_{verb}"
    said = folder / "run.json"
    state = hashlib.sha256(_package() + path.read_bytes() + (drawn.read_bytes() if drawn else b"")).hexdigest()
    if not (said.exists() and json.loads(said.read_text())["state"] == state):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        said.write_text(json.dumps({"state": state, **_do(path, folder, verb, code, drawn)}, indent=1) + "\n")
    kept = json.loads(said.read_text())
    return Run(kept["command"], kept["printed"], kept["code"], kept["seconds"], folder)


def _do(path: Path, folder: Path, verb: str, code: int, drawn: Path | None) -> dict[str, str | float]:
    """A case is run by the command line, a script by Python in the folder that takes its pictures."""
    shown = path.relative_to(ROOT)
    if path.suffix == ".toml":
        words, command = ["-m", "farhorizon", verb, str(path), "--out", str(folder)], f"farhorizon {verb} {shown}"
    else:
        words = [str(drawn), str(path), f"{path.stem}.png"] if drawn else [str(path)]
        command = f"python {shown}"
    start = time.perf_counter()
    done = _python(words, folder)
    seconds = time.perf_counter() - start
    if done.returncode != code:
        raise RuntimeError(f"{command} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    for large in (*folder.glob("*.h5"), *folder.glob("*.ckpt")):
        large.unlink()
    printed = done.stdout + (done.stderr if code else "")
    return {"command": command, "printed": _short(printed, folder), "code": code, "seconds": seconds}


def _python(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    package = str(Path(farhorizon.__file__).parents[1])
    environment = {**os.environ, "MPLBACKEND": "Agg", "COLUMNS": "100", "PYTHONPATH": package, "NUMBA_NUM_THREADS": "1"}
    return subprocess.run([sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True)


def _short(printed: str, folder: Path) -> str:
    """Without the folders of this machine."""
    return printed.replace(str(folder) + os.sep, "").replace(str(ROOT) + os.sep, "")


def took(ran: Run) -> str:
    """How long it took, and where."""
    end = f", and ended with exit code {ran.code}" if ran.code else ""
    machine = "on the machine on which this page was built"
    return f"{{.ran}}\nIt took {ran.seconds:.2g} s{end}, {machine}, compilation included.\n"


@lru_cache(maxsize=1)
def _package() -> bytes:
    """A hash of all of its source."""
    found = hashlib.sha256()
    for path in sorted(Path(farhorizon.__file__).parent.rglob("*.py")):
        found.update(path.read_bytes())
    return found.digest()
