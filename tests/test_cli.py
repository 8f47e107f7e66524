"""The command line, run as a user runs it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from farhorizon.cli import main
from farhorizon.results import open_results

EXAMPLES = Path(__file__).parent.parent / "examples"


BOUNDED = EXAMPLES / "quenched_bar.toml"  # no side is open
BREAKING = [EXAMPLES / "branching.toml", EXAMPLES / "notch_blast.toml"]  # slow at full size; tests/test_examples.py has them on coarser lattices
GROWING = EXAMPLES / "dispersive_pulse.toml"  # a kernel that the layer cannot absorb: it has a test of its own
BODY = EXAMPLES / "indentation.toml"
ABSORBERS = {  # that are not a lattice PML, and the part of a fixed edge's error that is asserted
    "exact_bar": ("exact", 1e-3), "closed_disc": ("plane wave", 1e-2), "indentation": ("nonlocal PML", 1e-2), "inclusion": ("nonlocal PML", 1e-2),
}  # fmt: skip


@pytest.mark.parametrize(
    "case",
    sorted(set(EXAMPLES.glob("*.toml")) - {GROWING, BOUNDED, *BREAKING}) + [pytest.param(case, marks=pytest.mark.slow) for case in BREAKING],
    ids=lambda p: p.stem,
)
def test_examples_run_and_agree_with_the_infinite_medium(case, tmp_path, monkeypatch):
    """Each example: results, pictures, and an error a thousand times below that of a fixed edge; of published conditions a hundred times."""
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(case), "--json", "run.json"]) == 0
    facts = json.loads(Path("run.json").read_text())
    assert all(Path(p).stat().st_size > 10_000 for p in facts["pictures"])
    results = open_results(f"{case.stem}.h5")
    assert len(results.times) > 5 and np.isfinite(results.energy).all()
    times = ["--times", "4", "8"] if case.stem.endswith("3d") else []
    assert main(["compare", str(case), "--json", "compare.json", *times]) == 0
    curves = json.loads(Path("compare.json").read_text())
    ours, part = ABSORBERS.get(case.stem, ("lattice PML", 1e-3))
    assert curves[ours]["error_max_over_run"] < part * curves["fixed edge"]["error_max_over_run"]


def test_dispersive_pulse_says_that_it_grows(tmp_path, monkeypatch, capsys):
    """Appendix B of Hermann et al. (2023): warned of before the run, which stops soon after the front has arrived."""
    monkeypatch.chdir(tmp_path)
    assert main(["check", str(GROWING), "--json", "check.json"]) == 0
    checked = json.loads(Path("check.json").read_text())
    assert any("backward waves" in w for w in checked["warnings"])
    assert checked["certificate"]["rate"] > 1
    assert main(["run", str(GROWING), "--until", "9", "--allow-unstable"]) == 1  # it explodes, and stops
    assert "backward waves" in capsys.readouterr().err
    assert main(["compare", str(GROWING), "--json", "compare.json", "--times", "1", "2"]) == 0
    assert json.loads(Path("compare.json").read_text())["lattice PML"]["error"][0] < 1e-9  # before the front arrives at speed 3.2 from 10 away


def test_dispersive_pulse_leaves_through_the_sponge_of_its_comment(tmp_path):
    """The remedy that the example names keeps what it says: 2e-2 of the pulse over the whole run, and no growth."""
    lines = [line for line in GROWING.read_text().splitlines() if not line.startswith("all = ")]
    text = "\n".join(line.removeprefix("# ") if line.startswith("# all = ") else line for line in lines)
    assert text.count("all = {") == 1
    (tmp_path / "sponge.toml").write_text(text.replace("dt = 1e-4", "dt = 2e-3"))
    assert main(["compare", str(tmp_path / "sponge.toml"), "--out", str(tmp_path), "--json", str(tmp_path / "c.json")]) == 0
    assert json.loads((tmp_path / "c.json").read_text())["sponge"]["error_max_over_run"] < 2e-2


def test_two_notches_against_a_domain_from_which_nothing_returns(tmp_path):
    """Example 3 of Hermann et al. (2023) at their times; their method: 1e-3 and slowly growing."""
    out = tmp_path / "c.json"
    main(["compare", str(EXAMPLES / "two_notches.toml"), "--out", str(tmp_path), "--times", "30", "40", "50", "70", "--json", str(out)])
    assert max(json.loads(out.read_text())["lattice PML"]["error_rel_initial"]) <= 1e-6


def test_script_example():
    sys.path.insert(0, str(EXAMPLES))
    import two_notches

    sim = two_notches.main()
    assert sim.time >= 70 and sim.energy() < 0.1


def test_demo(tmp_path, capsys):
    assert main(["demo", "--out", str(tmp_path)]) == 0
    assert "lattice PML" in capsys.readouterr().out
    assert (tmp_path / "compare.png").exists()


def test_plot_check_info(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    case = str(EXAMPLES / "blob.toml")
    main(["run", case])
    assert main(["plot", "blob.h5", "--out", "pictures", "--times", "0", "5"]) == 0
    assert main(["check", case, "--json", "check.json"]) == 0
    assert "time step" in json.loads(Path("check.json").read_text())["facts"]
    assert main(["info"]) == 0
    assert "numba" in capsys.readouterr().out


def test_check_tunes_an_outline(tmp_path, capsys, monkeypatch):
    """The line for the case file is one: it reads as the boundary that was found, and is certified."""
    monkeypatch.chdir(tmp_path)
    words = """[lattice]\nspacing = 0.25\nwindow = { disc = { radius = 5.12 } }
[model]\ntype = "wave"\nspeed = 1.0\ndamping = 0.0125\nkernel = { horizon = 0.75, exponent = 2 }
[initial]\nu = "exp(-2*(x**2+y**2))"\n[run]\nuntil = 1.0\n[boundary]\nall = { type = "plane-wave" }\n"""
    Path("disc.toml").write_text(words)
    assert main(["check", "disc.toml", "--tune", "--json", "tuned.json"]) == 0
    found = json.loads(Path("tuned.json").read_text())["tuned"]
    assert f"all = {found['boundary']}" in capsys.readouterr().out and found["verdict"] == "certified"
    Path("disc.toml").write_text(words.replace('{ type = "plane-wave" }', found["boundary"]))
    assert main(["check", "disc.toml", "--json", "check.json"]) == 0
    assert json.loads(Path("check.json").read_text())["certificate"]["verdict"] == "certified"


@pytest.mark.parametrize(
    "arguments",
    [["run", "missing.toml"], ["check", "bad.toml"], ["plot", "missing.h5"], ["plot", "bad.toml"], ["run", "good.toml", "--resume"],
     ["run", "good.toml", "--until", "nan"], ["run", "good.toml", "--out", "bad.toml"], ["run", "good.toml", "--json", "none/x.json"],
     ["check", "good.toml", "--json", "."], ["compare", "good.toml", "--times", "nan"], ["compare", "good.toml", "--times", "-1"],
     ["compare", "good.toml", "--out", "bad.toml"], ["compare", "wide.toml", "--out", "new"], ["demo", "--out", "bad.toml/x"],
     ["run", "moving.toml"], ["check", "moving.toml"]],
)  # fmt: skip
def test_bad_input_exits_with_2_and_writes_nothing(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("bad.toml").write_text("[lattice]\nspacing = -1\n")
    Path("good.toml").write_text((EXAMPLES / "blob.toml").read_text())
    Path("wide.toml").write_text((EXAMPLES / "blob.toml").read_text().replace("(x-0.5)**2", "0.1*x**2"))
    Path("moving.toml").write_text((EXAMPLES / "waveguide.toml").read_text().replace("(x+4)", "(x-2*t)"))
    before = sorted(p.name for p in tmp_path.iterdir())
    assert main(arguments) == 2
    assert sorted(p.name for p in tmp_path.iterdir()) == before
    message = capsys.readouterr().err
    assert message.startswith("farhorizon: ")
    assert arguments[1] not in ("wide.toml", "moving.toml") or f"{arguments[1]}: " in message


MISTAKES = {
    "misspelt key": ("speed = 1.0", "sped = 1.0", "model.sped", "did you mean 'speed'"),
    "nan": ("spacing = 0.25", "spacing = nan", "lattice.spacing", "value: nan"),
    "horizon below spacing": ("horizon = 0.75", "horizon = 0.1", "kernel.horizon", "limit: >= 0.25; remedy: horizon = 0.75"),
    "horizon far too wide": ("horizon = 0.75", "horizon = 75.0", "kernel.horizon", "limit: 157 nodes in 2D; remedy"),
    "dt too large": ("until = 70.0", "until = 70.0\ndt = 2.0", "run.dt", "limit: 0.38"),
    "unknown function": ("exp(-log", "expp(-log", "initial.u", "did you mean exp?"),
    "forbidden expression": ("exp(-log(2)/9*(x**2+y**2))", "().__class__", "initial.u", "value: '().__class__'"),
    "crack outside": ("[[0.0, 10.0], [7.0, 10.0]]", "[[40.0, 10.0], [47.0, 10.0]]", "crack", "limit: [-26.0, -26.0] to [26.0, 26.0]; remedy"),
    "near field too thin": ("window = { disc = { radius = 26.0 } }", "lower = [-26.0, 0.0]\nupper = [26.0, 0.5]", "lattice", "limit: >= 7; remedy"),
    "data beyond": ("log(2)/9", "0.001", "initial.u", "error of about"),
    "radius": ("radius = 26.0", "radius = -26.0", "lattice.window", "value: -26"),
    "memory": ("spacing = 0.25", "spacing = 1e-4", "lattice.spacing", "GiB available; remedy"),
    "probe": ("[[20.0, 10.0]]", "[[20.0]]", "output.probes", "limit: 2 coordinates"),
}


@pytest.mark.parametrize(("old", "new", "key", "rest"), MISTAKES.values(), ids=MISTAKES)
def test_wrong_cases_exit_with_2_and_say_where_and_what(old, new, key, rest, tmp_path, monkeypatch, capsys):
    """The file, the key, the value, the limit and a remedy, and nothing written."""
    monkeypatch.chdir(tmp_path)
    text = (EXAMPLES / "two_notches.toml").read_text()
    assert old in text
    Path("wrong.toml").write_text(text.replace(old, new).replace("probes = [[20.0, 10.0]]", "" if key == "lattice" else "probes = [[20.0, 10.0]]"))
    assert main(["run", "wrong.toml", "--out", "new"]) == 2
    message = capsys.readouterr().err
    assert message.startswith("farhorizon: wrong.toml: ") and key in message and rest in message
    assert [p.name for p in tmp_path.iterdir()] == ["wrong.toml"]


def test_damaged_and_foreign_files_are_refused_and_stay(tmp_path, monkeypatch, capsys):
    """A truncated results file, the checkpoint of another case, and text under their names."""
    monkeypatch.chdir(tmp_path)
    Path("blob.toml").write_text((EXAMPLES / "blob.toml").read_text())
    main(["run", "blob.toml", "--until", "2"])
    whole = Path("blob.h5").read_bytes()
    for content in (whole[:20_000], b"no results"):
        Path("blob.h5").write_bytes(content)
        for arguments in (["plot", "blob.h5", "--out", "new"], ["run", "blob.toml", "--resume"], ["run", "blob.toml"]):
            assert main(arguments) == 2
            assert "blob.h5" in capsys.readouterr().err and Path("blob.h5").read_bytes() == content
    Path("blob.h5").write_bytes(whole)
    Path("blob.toml").write_text(Path("blob.toml").read_text().replace("horizon = 0.75", "horizon = 0.5"))
    assert main(["run", "blob.toml", "--resume"]) == 2
    assert "another set-up" in capsys.readouterr().err
    Path("blob.ckpt").write_text("no checkpoint")
    assert main(["run", "blob.toml", "--resume"]) == 2
    assert "blob.ckpt" in capsys.readouterr().err and Path("blob.h5").read_bytes() == whole
    assert sorted(p.name for p in tmp_path.iterdir()) == ["blob", "blob.ckpt", "blob.h5", "blob.toml"]


def test_interrupted_run_resumes_to_the_same_result(tmp_path):
    """Ctrl-C leaves a valid results file and a checkpoint; the resumed run equals the whole one bitwise."""
    text = (EXAMPLES / "two_notches.toml").read_text().replace("until = 70.0", "until = 150.0").replace("every = 1.0", "every = 0.5")
    (tmp_path / "long.toml").write_text(text)
    command = [sys.executable, "-m", "farhorizon", "run", "long.toml"]
    run = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    while not (tmp_path / "long.ckpt").exists():
        assert run.poll() is None, run.stderr.read()
        time.sleep(0.05)
    time.sleep(1.0)
    os.kill(run.pid, signal.SIGINT)
    run.communicate()
    assert run.returncode == 130
    part = open_results(tmp_path / "long.h5").times
    assert 1 <= len(part) < 301
    assert subprocess.run([*command, "--resume"], cwd=tmp_path, capture_output=True).returncode == 0
    subprocess.run([*command, "--out", "whole"], cwd=tmp_path, capture_output=True, check=True)
    resumed, whole = open_results(tmp_path / "long.h5"), open_results(tmp_path / "whole" / "long.h5")
    np.testing.assert_array_equal(resumed.times, whole.times)
    np.testing.assert_array_equal(resumed.field("u"), whole.field("u"))
    np.testing.assert_array_equal(resumed.energy, whole.energy)


def test_corrosion_goes_on_after_an_interrupt(tmp_path, monkeypatch):
    """Run half of it, resume: phases, times of dissolution and balance are bitwise those of one run; the front is drawn."""
    monkeypatch.chdir(tmp_path)
    case = str(EXAMPLES / "pitting.toml")
    assert main(["run", case, "--out", "whole", "--until", "0.4"]) == 0
    assert main(["run", case, "--out", "part", "--until", "0.2"]) == 0
    assert main(["run", case, "--out", "part", "--until", "0.4", "--resume"]) == 0
    whole, part = (open_results(f"{name}/pitting.h5") for name in ("whole", "part"))
    for field in ("u", "dissolved"):
        assert np.array_equal(whole.field(field), part.field(field), equal_nan=True)
    for name, values in whole.balance.items():
        assert np.array_equal(values[-1], part.balance[name][-1])
    assert abs(whole.balance["residual"][-1]) < 1e-12 < 0.1 < whole.balance["dissolved"][-1]
    assert {p.name for p in Path("part/pitting").iterdir()} >= {"u.png", "front.png", "balance.png"}


def test_a_killed_run_of_a_breaking_body_goes_on(tmp_path, monkeypatch, capsys):
    """Half of it, a resumed run that is killed, resumed again: displacements, damage, probes and balance are bitwise those of one run."""
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(BODY), "--out", "whole", "--json", "run.json"]) == 0
    pictures = {Path(p).name for p in json.loads(Path("run.json").read_text())["pictures"]}
    assert pictures == {"u.png", "u_x.png", "u_y.png", "damage.png", "probes.png", "energy.png", "balance.png"}
    assert main(["run", str(BODY), "--out", "part", "--until", "40"]) == 0
    command = [sys.executable, "-m", "farhorizon", "run", str(BODY), "--out", "part", "--resume"]
    killed = subprocess.Popen([sys.executable, "-u", *command[1:]], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    while b"resumed at step" not in killed.stdout.readline():
        assert killed.poll() is None
    time.sleep(0.3)
    killed.kill()
    killed.stdout.close()
    killed.wait()
    assert main(["run", str(BODY), "--out", "part", "--resume"]) == 0
    whole, part = (open_results(f"{name}/indentation.h5") for name in ("whole", "part"))
    assert whole.field("damage")[whole.field("damage") > 0.15].size > 20  # nodes of both cracks
    late = np.searchsorted(whole.times, 41)  # the run to t = 40 ends with an output of its own
    for name in ("u", "damage"):
        for index in range(late - len(whole.times), 0):
            np.testing.assert_array_equal(whole.field(name, index), part.field(name, index))
    np.testing.assert_array_equal(whole.probe_values[-1], part.probe_values[-1])
    assert {name: v[-1] for name, v in whole.balance.items()} == {name: v[-1] for name, v in part.balance.items()}
    assert abs(whole.balance["residual"]).max() < 1e-12 * whole.balance["work"][-1]
    assert main(["check", str(BODY)]) == 0
    said = capsys.readouterr().out
    assert all(word in said for word in ("stable limit", "memory", "stability", "steps to t = 90"))
    assert main(["check", str(BODY), "--tune"]) == 2
