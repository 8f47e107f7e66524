"""The report of a run: one file without external references that says what was computed."""

import base64
import shlex
from html.parser import HTMLParser
from pathlib import Path

import pytest

from browser import PROGRAM, Browser
from doubtful import CRACK_AT_THE_RIM
from farhorizon.cli import main
from farhorizon.files.html import page, picture, table
from farhorizon.files.results import open_results

CASE = """# A <b>pulse</b> & "more"
lattice = { spacing = 0.25, lower = [-3.0, -3.0], upper = [3.0, 3.0] }
model = { type = "wave", kernel = { horizon = 0.75 } }
initial = { u = "where(x < 9, 1, 0)*exp(-9*(x**2 + y**2))" }
run = { until = 2.0 }
output = { probes = [[1.0, 0.0]] }
"""
EMPTY = {"meta", "img"}  # elements without an end tag


class Page(HTMLParser):
    """Elements, attributes and text of a page; refuses tags that are not closed in their order."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.attributes, self.texts, self.open = [], [], {}, []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.attributes += [(tag, *pair) for pair in attributes]
        self.open += [tag] * (tag not in EMPTY)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.setdefault(self.open[-1] if self.open else "", []).append(data)


@pytest.fixture
def there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a case.toml").write_text(CASE)


def test_the_page_stands_alone(there, capsys):
    """Every picture is embedded; there is no script, link, style sheet or address; the case is shown as it is."""
    assert main(["run", "a case.toml", "--threads", "1"]) == 0
    said = capsys.readouterr().out
    assert said.rstrip().endswith(f"report: {Path('a case/report.html')}")
    text = Path("a case/report.html").read_text(encoding="utf-8")
    found = Page(text)
    images = [value for tag, name, value in found.attributes if (tag, name) == ("img", "src")]
    pictures = [Path("a case", f"{name}.png").read_bytes() for name in ("u", "probes", "energy")]
    assert [base64.b64decode(src.removeprefix("data:image/png;base64,")) for src in images] == pictures
    assert not {"script", "link", "iframe", "object", "embed", "base", "a", "b"} & set(found.tags)
    assert {name for _, name, _ in found.attributes} <= {"src", "alt", "lang", "charset", "class"}
    rest = text
    for src in images:
        rest = rest.replace(src, "")
    assert not any(word in rest.lower() for word in ("http:", "https:", "//", "url(", "@import"))
    assert "run.threads" not in rest and 'A <b>pulse</b> & "more"' not in rest
    case = open_results("a case.h5").case
    assert found.texts["pre"] == [case] and "threads = 1" in case  # the changed case, as it was run
    assert found.texts["h2"] == [
        "Result",
        "Pictures",
        "Probes at the end",
        "Stability",
        "Files",
        "Case",
        "Computed with",
        "To cite",
    ]
    cells = dict(zip(found.texts["th"], found.texts["td"], strict=True))
    results = open_results("a case.h5")
    assert cells["1, 0"] == f"{results.probe_values[-1, 0]:.6g}" and cells["threads"] == "1"
    assert cells["energy"].endswith(f"{results.energy[-1]:.6g} at the end") and "numba" in cells
    assert cells["error of the layers"] == results.provenance["error of the layers"]
    assert 0 < float(cells["error of the layers"].partition(" ")[0]) <= 1e-5
    assert float(cells["steps and files"].removesuffix(" s")) > 0


def test_its_command_goes_on_with_the_run(there, capsys):
    assert main(["run", "a case.toml", "--set", "model.speed=0.5", "--until", "1"]) == 0
    found = Page(Path("a case/report.html").read_text(encoding="utf-8"))
    words = shlex.split(dict(zip(found.texts["th"], found.texts["td"], strict=True))["go on with it"])
    assert words[0] == "farhorizon" and words[-2:] == ["--until", "T"] and words.count("--until") == 1
    assert main([*words[1:-1], "3"]) == 0
    assert open_results("a case.h5").times[-1] >= 3


def test_no_page_where_none_is_wanted(there, capsys):
    assert main(["run", "a case.toml", "--no-report"]) == 0
    assert "report" not in capsys.readouterr().out and not Path("a case/report.html").exists()


def test_doubts_are_said_first(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("a.toml").write_text(CRACK_AT_THE_RIM + "balance = true\n")
    assert main(["run", "a.toml"]) == 0
    (doubt,) = open_results("a.h5").cautions
    text = Path("a/report.html").read_text(encoding="utf-8")
    assert f"not valid from t = {doubt.time:.6g} on: " in text and text.index("not valid from") < text.index("<img")
    assert "Balance at the end" in text


def test_everything_is_escaped(tmp_path):
    (tmp_path / "a.png").write_bytes(b"\x89PNG")
    text = page(
        "<t>", [("<h>", table([("<n>", "</td><script>")], "<c>")), ("none", ""), ("p", picture(tmp_path / "a.png"))]
    )
    found = Page(text)
    assert "script" not in found.tags and found.texts["td"] == ["</td><script>"] and found.texts["h2"] == ["<h>", "p"]


@pytest.mark.slow
@pytest.mark.skipif(PROGRAM is None, reason="no Chromium to look at the page")
def test_a_browser_shows_it(there, tmp_path, capsys):
    """The title and every picture are displayed, and nothing else is requested."""
    assert main(["run", "a case.toml"]) == 0
    browser = Browser(tmp_path / "profile")
    try:
        browser.open(Path("a case/report.html").resolve().as_uri())
        assert browser.errors == [] and browser.ask("document.title") == "a case"
        widths = browser.ask("Array.from(document.images, one => one.naturalWidth)")
        assert len(widths) == 3 and min(widths) > 300
        assert browser.ask("document.querySelector('pre').innerText").strip() == open_results("a case.h5").case.strip()
        assert browser.ask("document.documentElement.scrollWidth <= window.innerWidth")
        browser.open((tmp_path / "none.html").as_uri())
        assert browser.errors  # missing resources are reported
    finally:
        browser.close()


def test_what_is_measured_has_its_name_and_its_unit(tmp_path, monkeypatch, capsys):
    """The sum that is recorded of a temperature is no energy."""
    monkeypatch.chdir(tmp_path)
    heat = CASE.replace('"wave"', '"heat"').replace("x < 9, 1", "x < 9, 20") + 'units = { length = "mm", time = "s" }\n'
    Path("a.toml").write_text(heat)
    assert main(["run", "a.toml", "--threads", "1"]) == 0
    said, text = capsys.readouterr().out, Path("a/report.html").read_text(encoding="utf-8")
    cells = Page(text).texts["td"] + Page(text).texts["th"]
    assert "energy" not in cells and "half the integral of (u - background)^2" in cells
    assert any("spacing 0.25 mm" in cell for cell in cells) and any(cell.startswith("t = 2 s: ") for cell in cells)
    assert "outputs every 0.05 s = " in said


def test_one_step_is_a_step(there, capsys):
    assert main(["run", "a case.toml", "--set", "run.dt=0.1", "--set", "output.every=0.1", "--threads", "1"]) == 0
    assert "outputs every 0.1 = 1 step;" in capsys.readouterr().out
