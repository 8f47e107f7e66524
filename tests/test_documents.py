"""README and docs/: what they show runs, what they link to exists, and the figures that they mark are those that were
measured.
"""

import importlib.util
import json
import re
import shlex
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image
from pydantic import ValidationError

import farhorizon as fh
from farhorizon.case.case import Case
from farhorizon.case.inversion_schema import ShotPart, inversion_part
from farhorizon.case.schema import case_part
from farhorizon.case.toml import document
from farhorizon.cli import main
from farhorizon.cli.parser import command_parser
from farhorizon.files.storable import Storable
from farhorizon.simulation.recorders.recorder import Recorder

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def _script(name, folder="benchmarks"):
    """Return a script as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / folder / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


figures = _script("figures")
sentences = _script("sentences", "docs/_extensions")
STORED = json.loads(figures.STORE.read_text())


def _blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def test_readme_is_a_door():
    assert len(README.splitlines()) <= 90
    assert (ROOT / "docs" / "demo.png").stat().st_size < 200_000
    assert set(re.findall(r"```(\w+)\n", README)) == {"sh", "toml", "python"}


def test_the_film_shows_what_it_says():
    """The film is short and small; at its end the layer looks like the infinite medium, and the fixed edge does not."""
    film = ROOT / "docs" / "demo.webp"
    assert "(docs/demo.webp)" in README and film.stat().st_size < 2_000_000
    with Image.open(film) as moving:
        moving.seek(moving.n_frames - 1)
        picture = np.asarray(moving.convert("RGB"), float)
        assert 10_000 < moving.info["timestamp"] + moving.info["duration"] <= 15_000  # milliseconds
    infinite, ours, fixed = (picture[60:300, first : first + 250] for first in (68, 347, 626))  # within the axes
    assert np.abs(infinite - ours).mean() < 2  # of 255: what is lost in compression
    assert np.abs(infinite - fixed).mean() > 10


def test_case_and_python_of_the_readme_are_one_run(capsys):
    (case,), (program,) = _blocks("toml"), _blocks("python")
    names = {}
    exec(compile(program, "README.md", "exec"), names)
    assert "layers reflect" in capsys.readouterr().out
    # the case also has outputs, which its own step has to divide
    sim = fh.Simulation.of(replace(Case(case).setup, dt=names["sim"].dt))
    sim.run(until=30.0)
    assert names["sim"].step_count == sim.step_count and np.abs(sim.fields["u"]).max() > 1e-4
    assert np.allclose(names["sim"].fields["u"], sim.fields["u"], rtol=0, atol=1e-13)


def test_commands_of_the_readme_exist(capsys):
    extras = (ROOT / "pyproject.toml").read_text()
    lines = [part for block in _blocks("sh") for part in re.split(r"&&|\n", block) if part.strip()]
    lines += re.findall(r"`(farhorizon [a-z][^`]*)`", README)
    ours = [shlex.split(line) for line in lines if line.strip().startswith("farhorizon")]
    assert {words[1] for words in ours} == {"demo", "check", "run", "compare"}
    for words in ours:
        with pytest.raises(SystemExit) as end:
            main([words[1], "--help"])
        assert end.value.code == 0
    assert "'.[test]'" in README and "\ntest = [" in extras


def _anchors(path):
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", figures.DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(path):
    for target in re.findall(r"\]\(([^)\s]+)\)", path.read_text(encoding="utf-8")):
        if not target.startswith("http"):
            name, _, anchor = target.partition("#")
            there = (path.parent / name).resolve() if name else path
            assert there.exists(), target
            assert not anchor or anchor in _anchors(there), target


#: Pages that say what to do and what to expect: how it was measured is on the pages of evidence.
GUIDANCE = [
    ROOT / "README.md",
    *(ROOT / "docs" / f"{name}.md" for name in ("index", "limits", "accuracy", "performance")),
    *(path for room in ("tutorials", "howto", "reference") for path in sorted((ROOT / "docs" / room).glob("*.md"))),
]


@pytest.mark.parametrize("path", GUIDANCE, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_guidance_names_no_tests_seeds_or_trials(path):
    """Neither names of tests, nor commands that run them, nor seeds, nor the inner workings of the choice of layers."""
    text = re.sub(r"\]\([^)\s]*\)", "]", path.read_text(encoding="utf-8"))  # links may lead anywhere
    text = text.replace("'.[test]'", "")  # the extra that an installation may have
    found = re.findall(r"(?i)\bpytest\b|\btests?/\w+|\btest_\w+|\bseeds?\b|\btrials?\b|measured once", text)
    assert not found, found


def test_pages_are_short_and_plain():
    """Neither many words, nor long sentences; `python docs/_extensions/sentences.py` prints the longest ones."""
    found = sentences.sentences()
    assert sentences.words() <= sentences.MOST_WORDS
    assert not [sentence for sentence in found if sentence.words > sentences.MOST_IN_A_SENTENCE]
    assert np.median([sentence.words for sentence in found]) <= sentences.MEDIAN


@pytest.mark.parametrize("path", figures.DOCUMENTS[1:], ids=lambda path: f"{path.parent.name}/{path.name}")
def test_pages_begin_with_what_they_are_for(path):
    """After the title there is a sentence, and neither a heading, a table nor a program."""
    title, first = re.split(r"\n\s*\n", path.read_text(encoding="utf-8"))[:2]
    assert title.startswith("# ") and re.match(r"\*{0,2}`?\w", first) and len(first.split()) > 5, first


EXTENSIONS = re.findall(
    r"^```python\n(.*?)```", (ROOT / "docs" / "extending.md").read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
)


@pytest.mark.parametrize(
    "program", EXTENSIONS, ids=lambda program: re.findall(r"^(?:class|def) (\w+)", program, re.M)[0]
)
def test_examples_of_extensions_run(program, monkeypatch):
    """Each has at most 40 lines and runs by itself; what it defines is forgotten afterwards."""
    assert len(program.splitlines()) <= 40
    defined = re.findall(r"^class (\w+)", program, re.MULTILINE)
    families = (fh.LatticeModel, fh.BondLaw, fh.Side, fh.Shape, fh.Load, fh.Signal, Recorder)
    for family, name in [*((family, "known") for family in families), (Storable, "stored_as")]:
        others = {key: known for key, known in getattr(family, name).items() if key not in defined}
        monkeypatch.setattr(family, name, others)
    made = ModuleType("extension")
    monkeypatch.setitem(sys.modules, made.__name__, made)
    exec(program, made.__dict__)


BLOCK = re.compile(r"^(?:<!-- not run: (.+) -->\n)?```(python|toml|sh)\n(.*?)^```", re.DOTALL | re.MULTILINE)
PAGES = [
    path
    for path in figures.DOCUMENTS
    if path.name not in ("README.md", "extending.md")
    and path.parent.name != "evidence"
    and BLOCK.search(path.read_text(encoding="utf-8"))
]
SMALL_CASE = """
lattice = { spacing = 0.5, lower = [-10.0, -10.0], upper = [10.0, 10.0] }
boundary = { all = { type = "lattice-pml", nodes = 6 } }
run = { until = 1.0 }
"""
MODELS = [  # one of them accepts the tables of a page that names no model
    'model = { type = "wave", kernel = { horizon = 1.0 } }',
    'model = { type = "elastic", young = 1.0, kernel = { horizon = 1.0 } }',
    'model = { type = "heat", kernel = { horizon = 1.0 } }',
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a case and its results, for blocks that read them."""
    made = tmp_path_factory.mktemp("blocks")
    (made / "case.toml").write_text(SMALL_CASE + MODELS[0] + '\ninitial = { u = "exp(-x**2 - y**2)" }\n')
    assert main(["run", str(made / "case.toml"), "--out", str(made)]) == 0
    return made


def completed(fragment, model):
    """Return the text of a case that has the tables of `fragment`, and what it lacks from the small case."""
    small, case = tomllib.loads(SMALL_CASE + model), tomllib.loads(fragment)
    if not {"kernel", "stencil", "elastic"} & case.get("model", {}).keys():  # the last has kernels of its own
        case["model"] = small["model"] | case.get("model", {})
    case["run"] = small["run"] | case.get("run", {})
    return document(small | case)


def accepts(fragment):
    """Raise what the last model says of the tables of a case, if none accepts them; of inversions the keys alone."""
    if "[inversion]" in fragment:
        given, table = tomllib.loads(fragment), inversion_part().model_fields["inversion"].annotation
        assert given["inversion"].keys() <= table.model_fields.keys()
        for shot in given["shot"]:
            ShotPart.model_validate(shot, context={"folder": Path(), "units": None})
        return
    for model in MODELS:
        text = completed(fragment, model)
        try:
            if re.search("file = |record = ", text):  # which are not there: the keys alone
                case_part().model_validate(tomllib.loads(text), context={"folder": Path(), "units": None})
            else:
                Case(text)
            return
        except (fh.InputError, ValidationError) as error:
            refused = error
    raise refused


def parsed(line):
    """Parse a command line of the program, also behind `mpiexec` and the like."""
    words = shlex.split(line, comments=True)
    if "farhorizon" in words:
        command_parser().parse_args(words[words.index("farhorizon") + 1 :])


@pytest.mark.parametrize("path", PAGES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_blocks_of_pages_run(path, folder, monkeypatch):
    """The programs of a page run one after the other, its tables of a case are accepted, its commands exist."""
    monkeypatch.chdir(folder)
    names = {}
    for reason, language, text in BLOCK.findall(path.read_text(encoding="utf-8")):
        if language == "toml":
            accepts(text)
        elif language == "sh":
            for line in text.splitlines():
                parsed(line)
        else:
            program = compile(text, path.name, "exec")
            if not reason:
                exec(program, names)


def test_few_blocks_do_not_run():
    """Those that need several processes or long times say so."""
    pages = [path.read_text(encoding="utf-8") for path in PAGES]
    assert sum(bool(reason) for page in pages for reason, _, _ in BLOCK.findall(page)) <= 10
    assert sum(page.count("<!-- not run: ") for page in pages) == 1


def test_marked_figures_are_the_measured_ones():
    places = [place for path in figures.DOCUMENTS for place in figures.PLACE.findall(path.read_text(encoding="utf-8"))]
    assert places and {key for key, _ in places} == set(STORED)
    for key, value in places:
        assert value == STORED[key]["value"], key
    known = {key: " ".join(m.command) for m in figures.MEASUREMENTS.values() for key in m.figures}
    for key, entry in STORED.items():
        assert entry["command"] == known[key] and entry["date"] and entry["processor"], key


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (2.8035e-11, "2.8e-11"),
        (0.23, "0.23"),
        (2.304, "2.3"),
        (182.3, "182"),
        ((0.0128, 0.0366), "0.013 to 0.037"),
        ((5.38, 5.41), "5.4"),
        ((2e-3, np.inf), "2.0e-3 to overflow"),
    ],
)
def test_figures_as_they_are_written(value, words):
    assert figures.written(value) == words


@pytest.mark.slow
@pytest.mark.parametrize("name", ["demo", "square", "wide"])
def test_figures_are_what_the_commands_print_now(name):
    """Measured figures are within a factor of 2 of those stored; errors below 1e-9 within a factor of 10, because
    some of them are rounding errors, which differ between processors. Times are not compared.
    """
    for key, entry in figures.measure(name).items():
        now, then = (np.array([float(word) for word in e["value"].split(" to ")]) for e in (entry, STORED[key]))
        factor = np.where(then < 1e-9, 10.0, 2.0)
        assert (now <= factor * then).all() and (then <= factor * now).all(), (
            key,
            entry["value"],
            STORED[key]["value"],
        )
