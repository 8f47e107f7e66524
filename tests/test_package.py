"""What is released: consistent metadata, and the files that a wheel and a source distribution have to contain."""

import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

import farhorizon

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_recipe_asks_for_what_the_package_asks_for():
    recipe = (ROOT / "conda" / "meta.yaml").read_text(encoding="utf-8")
    needed = re.search(r"  run:\n((?:    - .*\n)+)", recipe)[1].replace(" ", "").split("-python>=3.11\n")[1]
    assert sorted(line.removeprefix("-") for line in needed.split()) == sorted(PROJECT["dependencies"])
    assert f'version: "{farhorizon.__version__}"' in recipe and PROJECT["requires-python"] == ">=3.11"


def test_the_paper_cites_what_its_bibliography_has():
    text, known = ((ROOT / "paper" / name).read_text(encoding="utf-8") for name in ("paper.md", "paper.bib"))
    cited = set(re.findall(r"@([a-z]+\d{4})", text))
    assert cited == set(re.findall(r"^@\w+\{(\w+),", known, re.MULTILINE))


@pytest.mark.slow
def test_wheel_and_source_distribution_are_whole(tmp_path):
    """The wheel is built from the source distribution and contains everything that is read at run time."""
    pytest.importorskip("hatchling", reason="builds with what `python -m pip install hatchling` brings")
    for target, place in (("sdist", ROOT), ("wheel", tmp_path / "unpacked")):
        subprocess.run(
            [sys.executable, "-m", "hatchling", "build", "-t", target, "-d", str(tmp_path)], cwd=place, check=True
        )
        if target == "sdist":
            with tarfile.open(next(tmp_path.glob("*.tar.gz"))) as source:
                source.extractall(tmp_path, filter="data")
            next(path for path in tmp_path.iterdir() if path.is_dir()).rename(tmp_path / "unpacked")
    held = set(zipfile.ZipFile(next(tmp_path.glob("*.whl"))).namelist())
    package = ROOT / "src"
    wanted = {
        str(p.relative_to(package))
        for p in (package / "farhorizon").rglob("*")
        if p.suffix in (".py", ".toml", ".typed")
    }
    assert wanted <= held and "farhorizon/py.typed" in held
