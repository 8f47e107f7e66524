"""The list of reproductions, and `farhorizon reproduce`."""

import re
from pathlib import Path

import numpy as np
import pytest

from farhorizon import InputError
from farhorizon.cli import main
from farhorizon.papers.reproductions import REPRODUCTIONS
from farhorizon.studies.collection import Outcome, Row, outcome_table
from outputs import written


def test_rows():
    """A misprint is compared with its correction; without a printed number there is no deviation."""
    assert Row("a", 1.01, 1.0).deviation == pytest.approx(0.01)
    assert Row("a", 1.01, 10.0, 1.0, "why").deviation == pytest.approx(0.01)
    assert Row("a", 1.01).deviation is None
    text = outcome_table(Outcome([Row("a", 1.01, 10.0, 1.0, "why"), Row("bb", 2.0)], {"PML": 1e-9}), "printed")
    assert "misprint, read 1: why" in text and "+1.0 %" in text and "PML: 1.0e-09" in text


def test_counted_numbers_keep_their_digits():
    """Integers are printed as such, measured numbers to five digits."""
    text = outcome_table(Outcome([Row("nodes", 33949, 33949), Row("few", np.int64(7)), Row("e", 33949.4)]), "printed")
    assert text.splitlines()[1].split()[:5] == ["nodes", "33", "949", "33", "949"]
    assert text.splitlines()[2].split() == ["few", "7"] and text.splitlines()[3].split() == ["e", "33949"]


def test_remarks_follow_the_table():
    outcome = Outcome([Row("a", 1.0)], remarks=["The paper leaves a open."])
    assert outcome_table(outcome, "printed").splitlines()[-1] == "The paper leaves a open."
    entry = REPRODUCTIONS.find("ji2021-fig3")
    assert entry.as_json(outcome)["remarks"] == outcome.remarks and "remarks" not in entry.as_json(Outcome([]))


def test_one_paper_has_one_name():
    """Entries of one author list and year cite one title; no two papers here share both."""
    titles = {}
    for entry in REPRODUCTIONS.entries().values():
        authors, year, title = re.fullmatch(r"(.+) \((\d{4})\), (.+)", entry.paper).groups()
        assert titles.setdefault((authors, year), title) == title


def test_all_published_items_are_there():
    known = set(REPRODUCTIONS.entries())
    assert {f"hermann2023-{name}" for name in ("ex1", "ex2", "ex3", "appB", "fig6", "fig10")} <= set(
        REPRODUCTIONS.entries()
    )
    assert {f"shojaei2020-{name}" for name in ("ex1-fem", "ex1-pd", "ex1-layers", "table1")} <= set(
        REPRODUCTIONS.entries()
    )
    assert {f"ji2021-table{n}" for n in range(1, 7)} | {"ji2021-fig2", "ji2021-fig3"} <= known
    assert {f"ji2021-fig{n}" for n in (4, 8, 9, 13)} <= known
    assert {f"wildman2012-fig{n}" for n in (2, 3, 4, 5, 7, 9)} <= known


def test_the_documents_name_what_there_is():
    """Every entry is in the table of docs/explanation/published.md, with ranges expanded, and no entry that does not
    exist is named there or in the README.
    """
    root = Path(__file__).parents[2]
    text = "".join((root / name).read_text(encoding="utf-8") for name in ("docs/explanation/published.md", "README.md"))
    named = set(re.findall(r"\b(?:ji2021|hermann2023|shojaei2020|wildman2012|bobaru2010)-[\w-]+", text))
    for first, last in re.findall(r"`([\w-]+\d)` to `([\w-]+\d)`", text):
        stem = first.rstrip("0123456789")
        named |= {f"{stem}{n}" for n in range(int(first[len(stem) :]), int(last[len(stem) :]) + 1)}
    assert named == set(REPRODUCTIONS.entries())


def test_unknown_name():
    with pytest.raises(InputError, match="did you mean 'ji2021-table4'"):
        REPRODUCTIONS.find("ji2021-tabel4")


def test_command_lists(capsys, tmp_path):
    assert main(["reproduce", "--json", str(tmp_path / "list.json")]) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in REPRODUCTIONS.entries())
    found = written(tmp_path / "list.json", "reproduce")
    assert set(found) == set(REPRODUCTIONS.entries())
    assert {entry["takes"] for entry in found.values()} <= {"seconds", "a minute"}
    assert {entry["full"] for entry in found.values()} <= {"", "a minute", "minutes", "an hour"}


CONSTANTS = {"shojaei2020-table1"}  # nothing is run there that could be drawn


@pytest.mark.slow
@pytest.mark.parametrize("name", REPRODUCTIONS.entries())
def test_command_runs_each(name, capsys, tmp_path):
    """With default arguments it runs to the end: rows of numbers, pictures that exist and are not empty, and the same
    in the JSON file.
    """
    assert main(["reproduce", name, "--out", str(tmp_path), "--json", str(tmp_path / "f.json")]) == 0
    found = written(tmp_path / "f.json", "reproduce")
    assert found["name"] == name and found["rows"]
    assert found["pictures"] or name in CONSTANTS
    assert all(isinstance(row["ours"], float | int) or row["note"] for row in found["rows"])  # overflows have a note
    assert {path.name for path in tmp_path.glob("*.png")} == set(found["pictures"])
    for picture in found["pictures"]:
        content = (tmp_path / picture).read_bytes()
        assert content.startswith(b"\x89PNG") and len(content) > 10_000
    assert found["rows"][0]["what"] in capsys.readouterr().out


def test_command_refuses_an_unknown_name(capsys):
    assert main(["reproduce", "ji2021-figure3"]) == 2
    assert "ji2021-fig3" in capsys.readouterr().err


def test_command_draws_and_writes(capsys, tmp_path):
    """Figure 3: picture, rows, and the keys of the JSON file."""
    assert main(["reproduce", "ji2021-fig3", "--out", str(tmp_path), "--json", str(tmp_path / "f.json")]) == 0
    assert "fully discrete kernel" in capsys.readouterr().out
    assert (tmp_path / "ji2021-fig3.png").stat().st_size > 20_000
    found = written(tmp_path / "f.json", "reproduce")
    assert set(found) == {"name", "paper", "rows", "infinite_error", "pictures"}
    assert all(set(row) == {"what", "ours", "printed", "corrected", "note"} for row in found["rows"])
    assert found["infinite_error"]["fully discrete kernel"] < 1e-13


@pytest.mark.slow
def test_figure_2(tmp_path):
    """The numerical kernel agrees with the analytical one: 1e-8 of 1e-6 (table 1 at 3000 pi: 9e-9 for all four)."""
    outcome = REPRODUCTIONS.find("ji2021-fig2").function(tmp_path)
    assert outcome.pictures[0].exists()
    assert outcome.rows[-1].ours < 1e-8 < 1e-6 < outcome.rows[0].ours
