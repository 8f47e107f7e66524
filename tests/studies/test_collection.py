"""The list of reproductions, and `farhorizon reproduce`."""

import re
from pathlib import Path

import numpy as np
import pytest

from farhorizon import InputError
from farhorizon.cli import main
from farhorizon.papers import REPRODUCTIONS
from farhorizon.studies.collection import Collection, Comparison, Outcome, Row, Setting, outcome_table
from outputs import written


def test_rows():
    """A misprint is compared with its correction; without a printed number there is no deviation."""
    assert Row("a", 1.01, 1.0).deviation == pytest.approx(0.01)
    assert Row("a", 1.01, 10.0, 1.0, "why").deviation == pytest.approx(0.01)
    assert Row("a", 1.01).deviation is None
    text = outcome_table(Outcome([Row("a", 1.01, 10.0, 1.0, "why"), Row("bb", 2.0)], {"PML": 1e-9}), "printed")
    assert "misprint, read 1: why" in text and "+1.0 %" in text and "PML: 1.0e-09" in text


def test_what_the_paper_prints_comes_first_and_the_rest_with_details():
    rows = [Row("not printed", 2.0), Row("key", 3.0, key=True), Row("printed", 1.0, 1.0)]
    outcome = Outcome(rows, {"PML": 1e-9})
    brief, whole = (outcome_table(outcome, "printed", details).splitlines()[1:] for details in (False, True))
    assert [line.split("  ")[0] for line in brief[:2]] == ["printed", "key"] and "2 more numbers" in brief[2]
    assert [line.split("  ")[0] for line in whole[:3]] == ["printed", "key", "not printed"] and "PML" in whole[3]


def test_reasons_are_those_of_deviations():
    """A reason that explains a deviation beyond the tolerance is not printed beside a smaller one."""
    rows = [Row("near", 1.04, 1.0, reason="why"), Row("far", 1.06, 1.0, reason="why")]
    near, far = outcome_table(Outcome(rows), "printed", tolerance=0.05).splitlines()[1:]
    assert near.split() == ["near", "1.04", "1", "+4.0", "%"] and far.endswith("why")


def test_sentences():
    """Settings say how far they are from the paper's, and comparisons why they differ."""
    assert str(Setting("nodes", 201, 201)) == "nodes 201 (as in the paper)"
    assert str(Setting("time step", 0.01, 5e-4)) == "time step 0.01 (paper: 0.0005, 20 times larger)"
    assert str(Setting("time step", 0.1 + 0.2, 0.3)) == "time step 0.3 (as in the paper)"
    assert str(Setting("time step", 1.6e-4, 3.33e-8)).endswith("4800 times larger)")
    assert str(Setting("spacing", 0.49645, 0.496)) == "spacing 0.49645 (paper: 0.496)"
    assert str(Setting("radius", 1.0, note="why")) == "radius 1 (not stated in the paper; why)"
    found = Comparison("figure 5", "a hump", "none", False, "it left")
    assert str(found) == "figure 5: the paper shows a hump; this run shows none: differs because it left."
    assert str(Comparison("figure 5", "a hump", "a hump", True)).endswith("this run shows a hump: agrees.")


def test_a_table_agrees_only_if_every_printed_number_does():
    rows = [Row("a", 1.04, 1.0), Row("b", 1.0, 2.0, 1.0, "misprint"), Row("c", 7.0)]
    assert Comparison.of_rows("table 1", rows).agrees
    assert not Comparison.of_rows("table 1", [*rows, Row("d", 1.06, 1.0)]).agrees
    reasons = [Row("d", 1.06, 1.0, reason="x"), Row("e", 1.06, 1.0, reason="y"), Row("f", 1.06, 1.0, reason="x")]
    assert Comparison.of_rows("table 1", [*rows, *reasons]).reason == "x; y"
    assert Comparison.of_rows("table 1", [*rows, *reasons, Row("g", 2.0, 1.0)]).reason == ""


def test_what_is_missed_without_a_reason():
    """Beyond the tolerance, after an overflow, and in sentences, unless a reason is given."""
    rows = [
        Row("near", 1.04, 1.0),
        Row("far", 1.06, 1.0),
        Row("explained", 1.06, 1.0, reason="why"),
        Row("overflow", float("nan"), 1.0),
        Row("not printed", 9.0),
    ]
    comparisons = [
        Comparison("figure 1", "a", "a", True),
        Comparison("figure 2", "a", "b", False),
        Comparison("figure 3", "a", "b", False, "why"),
    ]
    assert Outcome(rows, comparisons=comparisons).unexplained(0.05) == ["far", "overflow", "figure 2"]


def series(*outcomes):
    """A collection of one paper with an entry for each outcome, and a figure for each."""
    collection = Collection("reproduce", "farhorizon", (), "printed", 0.05)
    for number, outcome in enumerate(outcomes):
        enter = collection.enter(f"paper-table{number}", "A paper", "A table", figures=(f"fig{number}",))
        enter(lambda folder, outcome=outcome: outcome)
    return collection


def test_names_of_figures_papers_and_all():
    collection = series(Outcome([]), Outcome([]))
    first, second = collection.entries().values()
    assert collection.select("paper-table1") == collection.select("paper-fig1") == [second]
    assert collection.select("paper") == collection.select("all") == [first, second]
    assert collection.names() == ["paper-table0", "paper-table1", "paper-fig0", "paper-fig1", "paper", "all"]
    with pytest.raises(InputError, match="did you mean 'paper-fig1'"):
        collection.select("paper-figg1")


def test_no_name_has_two_meanings():
    names = REPRODUCTIONS.names()
    assert len(names) == len(set(names))


@pytest.mark.parametrize(("ours", "reason", "code"), [(1.0, "", 0), (1.1, "", 1), (1.1, "known", 0)])
def test_exit_code(ours, reason, code, monkeypatch, capsys, tmp_path):
    """1 where a number of any entry is missed without a reason; the file of several entries is by name."""
    collection = series(Outcome([Row("a", 1.0, 1.0)]), Outcome([Row("b", ours, 1.0, reason=reason)]))
    monkeypatch.setattr("farhorizon.papers.REPRODUCTIONS", collection)
    given = ["--out", str(tmp_path), "--json", str(tmp_path / "f.json")]
    assert main(["reproduce", "paper", *given]) == code
    assert ("no known reason: paper-table1, b" in capsys.readouterr().out) == (code == 1)
    assert set(written(tmp_path / "f.json", "reproduce")) == set(collection.entries())
    assert main(["reproduce", "paper-fig0", *given]) == 0
    assert written(tmp_path / "f.json", "reproduce")["name"] == "paper-table0"


def test_completion_knows_all_names():
    from farhorizon.cli.parser import command_parser

    (commands,) = (action for action in command_parser()._actions if action.choices)
    (name,) = (action for action in commands.choices["reproduce"]._actions if action.dest == "name")
    assert name.completer(prefix="") == REPRODUCTIONS.names()
    assert {"ji2021-fig5", "ji2021", "all"} <= set(name.completer())


def test_counted_numbers_keep_their_digits():
    """Integers are printed as such, measured numbers to five digits."""
    text = outcome_table(Outcome([Row("nodes", 33949, 33949), Row("few", np.int64(7)), Row("e", 33949.4)]), "printed")
    assert text.splitlines()[1].split()[:5] == ["nodes", "33", "949", "33", "949"]
    assert text.splitlines()[2].split() == ["few", "7"] and text.splitlines()[3].split() == ["e", "33949"]


def test_readings_of_the_paper_are_printed(monkeypatch, capsys, tmp_path):
    collection = series()
    collection.enter("paper-table1", "A paper", "A table", readings=("a is open",))(
        lambda folder: Outcome([Row("a", 1.0)])
    )
    monkeypatch.setattr("farhorizon.papers.REPRODUCTIONS", collection)
    assert main(["reproduce", "paper-table1", "--out", str(tmp_path), "--json", str(tmp_path / "f.json")]) == 0
    assert "reading of the paper: a is open" in capsys.readouterr().out
    assert written(tmp_path / "f.json", "reproduce")["readings"] == ["a is open"]


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
    """Every entry is in the table of docs/evidence/published.md, with ranges expanded, and no entry or figure that
    does not exist is named there or in the README.
    """
    root = Path(__file__).parents[2]
    text = "".join((root / name).read_text(encoding="utf-8") for name in ("docs/evidence/published.md", "README.md"))
    named = set(re.findall(r"\b(?:ji2021|hermann2023|shojaei2020|wildman2012|bobaru2010)-[\w-]+", text))
    for first, last in re.findall(r"`([\w-]+\d)` to `([\w-]+\d)`", text):
        stem = first.rstrip("0123456789")
        named |= {f"{stem}{n}" for n in range(int(first[len(stem) :]), int(last[len(stem) :]) + 1)}
    figures = {name for entry in REPRODUCTIONS.entries().values() for name in entry.other_names}
    assert named - figures == set(REPRODUCTIONS.entries())


def test_unknown_name():
    with pytest.raises(InputError, match="did you mean 'ji2021-table4'"):
        REPRODUCTIONS.find("ji2021-tabel4")


def test_command_lists(capsys, tmp_path):
    assert main(["reproduce", "--json", str(tmp_path / "list.json")]) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in REPRODUCTIONS.entries())
    found = written(tmp_path / "list.json", "reproduce")
    assert set(found) == set(REPRODUCTIONS.entries())
    assert found["ji2021-table2"]["figures"] == ["ji2021-fig5"] and "ji2021-table2, fig5 " in printed
    lasts = re.compile(r"seconds|minutes|a minute|an hour|\d+ (s|min|h)")
    assert all(lasts.fullmatch(entry["takes"]) and lasts.fullmatch(entry["full"] or "1 s") for entry in found.values())


CONSTANTS = {"shojaei2020-table1"}  # nothing is run there that could be drawn
BEYOND = {"wildman2012-lattice", "wildman2012-growth"}  # of which the papers show nothing


@pytest.mark.slow
@pytest.mark.parametrize("name", REPRODUCTIONS.entries())
def test_command_runs_each(name, capsys, tmp_path):
    """With default arguments it runs to the end: rows of numbers, pictures that exist and are not empty, and the same
    in the JSON file; what is missed has its reason, and there is a sentence for each figure that it is found by.
    """
    given = ["--details", "--out", str(tmp_path), "--json", str(tmp_path / "f.json")]
    assert main(["reproduce", name, *given]) == 0
    found = written(tmp_path / "f.json", "reproduce")
    assert found["name"] == name and found["rows"]
    assert found["pictures"] or name in CONSTANTS
    said = " ".join(comparison["item"] for comparison in found["comparisons"])
    shown = re.findall(r"-(?:fig|table)(\w+)", " ".join([name, *REPRODUCTIONS.find(name).other_names]))
    assert all(re.search(rf"\b{number}\b", said) for number in shown if name not in BEYOND) and bool(said) != (
        name in BEYOND
    )
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
    assert (
        main(["reproduce", "ji2021-fig3", "--details", "--out", str(tmp_path), "--json", str(tmp_path / "f.json")]) == 0
    )
    printed = capsys.readouterr().out
    assert "fully discrete kernel" in printed and "time step 0.005" in printed
    assert printed.splitlines()[-1].startswith("figure 3: the paper shows two humps")
    assert (tmp_path / "ji2021-fig3.png").stat().st_size > 20_000
    found = written(tmp_path / "f.json", "reproduce")
    documented = {"name", "paper", "rows", "infinite_error", "pictures"}
    assert set(found) == documented | {"comparisons", "settings", "readings"}
    assert all(set(row) == {"what", "ours", "printed", "corrected", "note", "reason"} for row in found["rows"])
    assert [c["agrees"] for c in found["comparisons"]] == [True]
    assert found["infinite_error"]["fully discrete kernel"] < 1e-13


@pytest.mark.slow
def test_figure_2(tmp_path):
    """The numerical kernel agrees with the analytical one: 1e-8 of 1e-6 (table 1 at 3000 pi: 9e-9 for all four)."""
    outcome = REPRODUCTIONS.find("ji2021-fig2").function(tmp_path)
    assert outcome.pictures[0].exists()
    assert outcome.rows[-1].ours < 1e-8 < 1e-6 < outcome.rows[0].ours
