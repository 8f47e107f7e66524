"""The documentation site: built without warnings, complete, without network access; and what its pages are made of."""

import ast
import fcntl
import importlib
import json
import re
import subprocess
import sys
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import jsonschema
import pytest

import farhorizon as fh
from browser import PROGRAM, Browser, served
from farhorizon.case.case import Case

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
SEEN = {  # pages that a browser opens, and words in their titles
    "index.html": "farhorizon",
    "tutorials/crack.html": "crack",
    "howto/read_check.html": "check",
    "explanation/lattice_pml.html": "lattice PML",
    "reference/keys.html": "case file",
    "gallery/two_notches_toml.html": "two notches",
}
sys.path.insert(0, str(DOCS / "_extensions"))
key_page = importlib.import_module("keys")  # the extension that generates the page of keys
mentions = importlib.import_module("mentions")
sys.path.pop(0)
PROGRAMS = sorted(p for p in (DOCS / "tutorials").iterdir() if p.suffix in (".py", ".toml"))


def properties():
    """Return table and key of everything that a case file may contain."""
    return [(name, key) for name, table in key_page.tables().items() for key in table.get("properties", {})]


def test_the_schema_is_one():
    for name in key_page.FILES:
        jsonschema.Draft202012Validator.check_schema(key_page.tables()[name])


def test_inversion_files_are_on_the_page_of_keys():
    text = key_page.markdown()
    for words in ("## The inversion file", "## `[inversion]`", "## `[[shot]]`", "`wrt = ", "`bounds = "):
        assert words in text, words


def test_each_key_of_the_schema_is_on_the_page():
    """The page has each key of the schema, and a section for each table."""
    sections = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", key_page.markdown(), re.MULTILINE | re.DOTALL))
    listed = [re.findall(r"^`(\w+)`$", text, re.MULTILINE) for text in sections.values()]
    assert sorted(key for names in listed for key in names) == sorted(key for _, key in properties())
    assert len(sections) == len(key_page.tables())


@pytest.mark.parametrize(("name", "key"), properties())
def test_examples_of_keys_are_of_their_kind(name, key):
    value = tomllib.loads(f"{key} = {key_page.example(name, key)}")[key]
    wanted = key_page.tables()[name]["properties"][key]
    jsonschema.Draft202012Validator({**wanted, "$defs": key_page.tables()}).validate(value)
    assert key_page.meaning(name, key).strip()


def test_each_public_name_is_in_the_reference():
    listed = re.findall(r"^   (\w+)$", (DOCS / "reference" / "api.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(fh.__all__)


def test_public_names_lead_to_pages_that_use_them():
    places = {name: mentions.mentions(name) for name in fh.__all__}
    pages = {place for found in places.values() for place in found if not place.startswith("/gallery/")}
    assert all((DOCS / f"{place[1:]}.md").is_file() for place in pages)
    assert places["Ricker"][0] == "/howto/signals" and places["Crack"][0] == "/howto/cracks"
    bare = {name for name in places if not places[name]}  # errors, and what functions return
    assert all(name.endswith("Error") or name in ("Certificate", "Gradient", "Probes", "Expression") for name in bare)


def test_each_example_script_has_a_picture_of_its_own():
    """The build draws the pictures; this test fails early."""
    drawn = ast.parse((DOCS / "_extensions" / "scripts.py").read_text()).body
    names = {node.name for node in drawn if isinstance(node, ast.FunctionDef)}
    assert {path.stem for path in (ROOT / "examples").glob("*.py")} <= names


def test_each_page_is_in_a_table_of_contents():
    """The build warns of this, too; this test fails early."""
    listed = set()
    for page in DOCS.rglob("*.md"):
        for block in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(), re.DOTALL):
            listed |= {(page.parent / line).resolve() for line in re.findall(r"^[\w./]+$", block, re.MULTILINE)}
    written = [p for p in DOCS.rglob("*.md") if p.parent.name not in ("gallery", "api", "generated")]
    assert {p.with_suffix("") for p in written} - listed == {DOCS / "index"}


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_tutorials_are_short_and_shown(path):
    """A tutorial has at most 40 lines, is shown on a page and uses no private name; a case is read and advanced by
    two steps.
    """
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 40
    pages = "".join(p.read_text(encoding="utf-8") for p in path.parent.glob("*.md"))
    assert f"<!-- run: {path.name} -->" in pages
    if path.suffix == ".toml":
        case = Case(text)
        case.simulation().step(2)
    else:
        names = {node.attr for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)}
        assert not [name for name in names if name.startswith("_")]


class Page(HTMLParser):
    """The identifiers, links and assets of a page."""

    def __init__(self, path):
        super().__init__()
        self.anchors, self.links, self.assets = set(), [], []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.anchors |= {given[key] for key in ("id", "name") if given.get(key)}
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        if tag in ("script", "img", "iframe", "source") and given.get("src"):
            self.assets.append(given["src"])
        if tag == "link" and given.get("rel") not in ("canonical", "next", "prev", "index", "search", "author"):
            self.assets.append(given["href"])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site built with the documented command, in which warnings are errors."""
    pytest.importorskip("sphinx", reason="the site needs what `python -m pip install '.[docs]'` brings")
    made = tmp_path_factory.mktemp("site")
    with (tmp_path_factory.getbasetemp().parent / "site.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # workers that build it one after the other share what the examples wrote
        done = subprocess.run(
            [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", str(DOCS), str(made)],
            cwd=ROOT,
            capture_output=True,
            text=True,
        )
    assert done.returncode == 0 and not done.stderr.strip(), done.stderr[-5000:]
    return made


@pytest.fixture(scope="module")
def pages(site):
    return {path: Page(path) for path in site.rglob("*.html") if "_static" not in path.parts}


@pytest.mark.slow
def test_links_within_the_site_lead_somewhere(site, pages):
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            there = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert there.exists(), (path.name, link)
            if parts.fragment and there in pages:
                assert unquote(parts.fragment) in pages[there].anchors, (path.name, link)


@pytest.mark.slow
def test_nothing_is_loaded_from_the_network_and_nothing_is_missing(site, pages):
    count = 0
    for path, page in pages.items():
        for asset in page.assets:
            parts = urlsplit(asset)
            assert not parts.scheme and not parts.netloc, (path.name, asset)
            assert (path.parent / unquote(parts.path)).resolve().exists(), (path.name, asset)
            count += asset.endswith(".png")
    assert count > len(PROGRAMS)
    for sheet in site.rglob("*.css"):
        assert not re.findall(r"url\([\"']?https?:", sheet.read_text(encoding="utf-8", errors="ignore")), sheet


@pytest.mark.slow
def test_each_example_and_each_tutorial_has_its_picture(site):
    for path in [*PROGRAMS, *(p for p in (ROOT / "examples").iterdir() if p.suffix in (".py", ".toml"))]:
        name = path.stem if path in PROGRAMS else f"{path.stem}_{path.suffix[1:]}"
        text = (site / ("tutorials" if path in PROGRAMS else "gallery") / f"{name}.html").read_text()
        # the first only prints its errors, the second is refused
        assert path.stem in ("new_boundary", "dispersive_pulse") or "../_images/" in text, path.name
        assert "on the machine on which this page was built" in text, path.name


@pytest.mark.slow
@pytest.mark.skipif(PROGRAM is None, reason="no Chromium to look at the pages")
def test_a_browser_shows_the_site(site, tmp_path):
    """Titles, all pictures and formulas are displayed, nothing is missing, and the search leads to pages."""
    browser = Browser(tmp_path / "profile")
    try:
        with served(site) as address:
            for name, words in SEEN.items():
                browser.open(f"{address}/{name}")
                assert browser.errors == [], name
                assert words in browser.ask("document.title") and words in browser.ask("document.body.innerText")
                assert browser.ask("Array.from(document.images).every(one => one.complete && one.naturalWidth > 0)"), (
                    name
                )
            browser.open(f"{address}/tutorials/crack.html")
            assert browser.ask("document.querySelectorAll('article img').length") >= 1
            browser.open(f"{address}/search.html?q=zolotarev")
            found = browser.wait("Array.from(document.querySelectorAll('#search-results li a'), one => one.href)")
            assert browser.errors == []
            browser.open(found[0])
            assert "zolotarev" in browser.ask("document.body.innerText").lower()
    finally:
        browser.close()


@pytest.mark.slow
def test_the_search_finds_words(site):
    index = json.loads((site / "searchindex.js").read_text().removeprefix("Search.setIndex(").removesuffix(")"))
    for word in ("horizon", "zolotarev", "seismolog"):
        assert word in index["terms"], word


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "pattern", "holds"),
    [
        ("echo_py", r"depth ([\d.]+) mm; it is ([\d.]+)", lambda found, depth: abs(found - depth) < 0.3),  # two samples
        (
            "seismogram_py",
            r"wave: (\d+) m/s, the first layer has (\d+)",
            lambda a, b: abs(a / b - 1) < 0.03,
        ),  # a sample
        ("pit_py", r"in the liquid (\d+)", lambda largest: largest <= 5100),  # the saturation
        ("crack_py", r"of the tip ([\d.]+), of Rayleigh waves ([\d.]+)", lambda tip, rayleigh: 0 < tip < rayleigh),
        ("new_boundary_py", r"(\S+)  Sponge.*\n *(\S+)  LatticePML", lambda sponge, layer: layer < 1e-6 * sponge),
    ],
)
def test_what_tutorials_print_is_what_theory_says(site, name, pattern, holds):
    said = json.loads((DOCS / "generated" / "tutorials" / f"{name}_run" / "run.json").read_text())["printed"]
    assert holds(*map(float, re.search(pattern, said).groups())), said
