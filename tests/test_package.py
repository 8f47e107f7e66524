"""What is released: consistent metadata, and the files that a wheel and a source distribution have to contain."""

import ast
import importlib.util
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

import farhorizon
from farhorizon.engine.codegen import numba_internals

ROOT = Path(__file__).parents[1]
TABLES = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT, BUILD, URLS = TABLES["project"], TABLES["build-system"], TABLES["project"]["urls"]


def test_the_package_asks_for_the_versions_of_numba_whose_internals_are_known():
    assert f"numba>={numba_internals.FIRST},<{numba_internals.UNTRIED}" in PROJECT["dependencies"]


def test_the_recipe_asks_for_what_the_package_asks_for():
    recipe = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    python, *needed = (line.replace(" ", "") for line in recipe["requirements"]["run"])
    assert sorted(needed) == sorted(PROJECT["dependencies"]) and python == f"python{PROJECT['requires-python']}"
    assert recipe["requirements"]["host"][-1].replace(" ", "") == BUILD["requires"][0]
    assert recipe["schema_version"] == 1 and recipe["context"]["version"] == farhorizon.__version__
    assert recipe["about"]["license"] == PROJECT["license"] and recipe["about"]["homepage"] == URLS["Homepage"]
    [script] = recipe["build"]["python"]["entry_points"]
    assert script == f"farhorizon = {PROJECT['scripts']['farhorizon']}"


def test_version_date_and_addresses_are_the_same_everywhere():
    """`[project.urls]` is where addresses are changed, and `__version__` is the version."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    newest = re.search(r"^## (\S+) \((\S+)\)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert (citation["version"], str(citation["date-released"])) == newest.groups()
    assert citation["version"] == farhorizon.__version__ and citation["license"] == PROJECT["license"]
    assert (citation["url"], citation["repository-code"]) == (URLS["Homepage"], URLS["Repository"])
    for path in (ROOT / "docs" / "conf.py", ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        assert not any(url in path.read_text(encoding="utf-8") for url in URLS.values()), path


def test_the_description_of_a_release_has_absolute_links(tmp_path):
    """Nothing in it is relative, and what it leads to exists in the repository."""
    text, version = (ROOT / "README.md").read_text(encoding="utf-8"), farhorizon.__version__
    described = _hook().published(text, URLS["Repository"], version)
    for mark, target in re.findall(r"(!?)\[[^\]]*\]\(([^)]+)\)", described):
        base = f"{URLS['Repository']}/{'raw' if mark else 'blob'}/v{version}/"
        assert target.startswith(base) and (ROOT / target.removeprefix(base).partition("#")[0]).exists(), target
    assert re.sub(re.escape(URLS["Repository"]) + rf"/(raw|blob)/v{re.escape(version)}/", "", described) == text


def _hook():
    pytest.importorskip("hatchling", reason="`python -m pip install hatchling`")
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_what_the_package_imports_is_declared():
    """Each module at the top of a file or in a function is of the standard library, a dependency or an extra."""
    given = [*PROJECT["dependencies"], *(one for extra in PROJECT["optional-dependencies"].values() for one in extra)]
    known = {re.match(r"[\w-]+", one)[0].replace("-", "_").lower() for one in given}
    known |= {"PIL" if name == "pillow" else "skimage" if name == "scikit_image" else name for name in known}
    known |= {"mpl_toolkits", "farhorizon", *sys.stdlib_module_names}
    for path in (ROOT / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and not node.level else []
            assert {name.partition(".")[0] for name in names} <= known, (path.name, names)


def test_the_paper_has_the_form_that_its_journal_asks_for():
    """JOSS: sections, length, and a DOI for each reference, all of which are cited."""
    text, known = ((ROOT / "paper" / name).read_text(encoding="utf-8") for name in ("paper.md", "paper.bib"))
    entries = dict(re.findall(r"^@\w+\{(\w+),(.*)$", known, re.MULTILINE))
    assert set(re.findall(r"@([a-z]+\d{4})", text)) == set(entries)
    assert [name for name, entry in entries.items() if not re.search(r"doi = \{10\.\d{4,}/\S+\}", entry)] == []
    _, _, body = text.split("---\n", 2)
    assert 750 <= len(body.split()) <= 1750
    assert re.findall(r"^# (.*)$", body, re.MULTILINE) == [
        "Summary",
        "Statement of need",
        "State of the field",
        "Software design",
        "Research impact statement",
        "AI usage disclosure",
        "Acknowledgements",
        "References",
    ]


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
    wheel = zipfile.ZipFile(next(tmp_path.glob("*.whl")))
    held = set(wheel.namelist())
    written = wheel.read(next(name for name in held if name.endswith("/METADATA"))).decode()
    assert "\nLicense-Expression: BSD-3-Clause\n" in written and "\nLicense-File: LICENSE\n" in written
    assert f"]({URLS['Repository']}/raw/v{farhorizon.__version__}/docs/demo.webp)" in written
    package = ROOT / "src"
    wanted = {
        str(p.relative_to(package))
        for p in (package / "farhorizon").rglob("*")
        if p.suffix in (".py", ".toml", ".typed")
    }
    assert wanted <= held and "farhorizon/py.typed" in held
