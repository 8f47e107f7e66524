"""The command line, run as users run it."""

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from doubtful import CRACK_AT_THE_RIM
from drawn import is_picture
from farhorizon.cli import main
from farhorizon.cli.parser import command_parser
from farhorizon.files.checkpoint_format import read_checkpoint
from farhorizon.files.results import open_results
from farhorizon.files.results_writer import ResultsWriter
from farhorizon.files.storage import locked
from outputs import written

EXAMPLES = Path(__file__).parents[2] / "examples"


BOUNDED = {EXAMPLES / "quenched_bar.toml", EXAMPLES / "wing_cracks.toml"}  # no side is open
LARGE = [  # slow at full size, or similar to another; tests/test_examples.py has some on coarser lattices
    EXAMPLES / f"{name}.toml"
    for name in (
        "branching",
        "notch_blast",
        "elastic_3d",
        "elastic_blast",
        "diffusion_3d",
        "exact_bar",
        "crack_scattering",
        "closed_disc",
        "backward_waves",
        "indentation",
        "surface_notch",
        "valley",
        "far_field",
        "inclusion",
        "half_space",
        "layered_ground",
        "letters",
        "wave_3d",
        "blob_classical",
        "pitting",
        "waveguide",
    )
]
GROWING = EXAMPLES / "dispersive_pulse.toml"  # a kernel that the layer cannot absorb, with a test of its own
BODY = EXAMPLES / "indentation.toml"
ABSORBERS = {  # other than a lattice PML, and the fraction of a fixed edge's error that is asserted
    "exact_bar": ("exact", 1e-3),
    "closed_disc": ("plane wave", 1e-2),
    "indentation": ("nonlocal PML", 1e-2),
    "inclusion": ("nonlocal PML", 1e-2),
}


@pytest.mark.parametrize(
    "case",
    sorted(set(EXAMPLES.glob("*.toml")) - {GROWING, *BOUNDED, *LARGE})
    + [pytest.param(case, marks=pytest.mark.slow) for case in LARGE],
    ids=lambda p: p.stem,
)
def test_examples_run_and_agree_with_the_infinite_medium(case, tmp_path, monkeypatch):
    """Results, pictures, and an error below 1e-3 of that of a fixed edge, or 1e-2 with published conditions."""
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(case), "--json", "run.json"]) == 0
    facts = written("run.json", "run")
    assert all(Path(p).stat().st_size > 10_000 for p in facts["pictures"])
    results = open_results(f"{case.stem}.h5")
    assert len(results.times) > 5 and np.isfinite(results.energy).all()
    # later a bond of the blast breaks in one run and not in the other, because their stretches differ by a millionth
    times = {"notch_blast": ["--times", "8", "14"]}.get(
        case.stem, ["--times", "4", "8"] if case.stem.endswith("3d") else []
    )
    assert main(["compare", str(case), "--json", "compare.json", *times]) == 0
    curves = written("compare.json", "compare")
    ours, part = ABSORBERS.get(case.stem, ("lattice PML", 1e-3))
    assert curves[ours]["error_max_over_run"] < part * curves["fixed edge"]["error_max_over_run"]


@pytest.mark.slow
def test_dispersive_pulse_says_that_it_grows(tmp_path, monkeypatch, capsys):
    """Appendix B of Hermann et al. (2023): a warning before the run, which stops soon after the front arrives."""
    monkeypatch.chdir(tmp_path)
    assert main(["check", str(GROWING), "--json", "check.json"]) == 2  # as with run
    assert "run refuses this case" in capsys.readouterr().err
    checked = written("check.json", "check")
    assert any("backward waves" in w for w in checked["warnings"])
    assert checked["certificate"]["rate"] > 1
    assert main(["run", str(GROWING), "--until", "9", "--allow-unstable"]) == 1  # it diverges, and stops
    assert "backward waves" in capsys.readouterr().err
    assert main(["compare", str(GROWING), "--json", "compare.json", "--times", "1", "2"]) == 0
    # before the front arrives from a distance of 10 at speed 3.2
    assert written("compare.json", "compare")["lattice PML"]["error"][0] < 1e-9


def test_dispersive_pulse_leaves_through_the_sponge_of_its_comment(tmp_path):
    """The remedy named in the example keeps its error: 2e-2 of the pulse over the whole run, and no growth."""
    lines = [line for line in GROWING.read_text().splitlines() if not line.startswith("all = ")]
    text = "\n".join(line.removeprefix("# ") if line.startswith("# all = ") else line for line in lines)
    assert text.count("all = {") == 1
    (tmp_path / "sponge.toml").write_text(text.replace("dt = 1e-4", "dt = 2e-3"))
    assert (
        main(["compare", str(tmp_path / "sponge.toml"), "--out", str(tmp_path), "--json", str(tmp_path / "c.json")])
        == 0
    )
    assert written(tmp_path / "c.json", "compare")["sponge"]["error_max_over_run"] < 2e-2


def test_two_notches_against_a_domain_from_which_nothing_returns(tmp_path):
    """Example 3 of Hermann et al. (2023) at their times; the error of their method is 1e-3 and grows slowly."""
    out = tmp_path / "c.json"
    main(
        [
            "compare",
            str(EXAMPLES / "two_notches.toml"),
            "--out",
            str(tmp_path),
            "--times",
            "30",
            "40",
            "50",
            "70",
            "--json",
            str(out),
        ]
    )
    assert max(written(out, "compare")["lattice PML"]["error_rel_initial"]) <= 1e-8


def test_script_example():
    sys.path.insert(0, str(EXAMPLES))
    import two_notches

    sim = two_notches.main()
    assert sim.time >= 70 and sim.energy() < 0.1


def test_demo(tmp_path, capsys):
    assert main(["demo", "--out", str(tmp_path), "--json", str(tmp_path / "demo.json")]) == 0
    assert "lattice PML" in capsys.readouterr().out
    assert set(written(tmp_path / "demo.json", "demo")) >= {"lattice PML", "fixed edge", "free edge"}
    assert (tmp_path / "compare.png").exists()


def test_compare_names_quantities_and_units(tmp_path, monkeypatch):
    """Colours and times are in the units of the case."""
    from farhorizon.pictures import curves, fields

    seen, whole = [], {"panels": fields.field_panels, "lines": curves.lines}
    monkeypatch.setattr(fields, "field_panels", lambda *given, **named: seen.append(whole["panels"](*given, **named)))
    monkeypatch.setattr(curves, "lines", lambda *given, **named: seen.append(whole["lines"](*given, **named)))
    (tmp_path / "bump.toml").write_text(BUMP)
    assert main(["compare", str(tmp_path / "bump.toml"), "--out", str(tmp_path), "--times", "2", "--quiet"]) == 0
    panels, history = seen
    *drawn, bar = panels.axes
    assert bar.get_ylabel() == "displacement $|u|$ (mm)" and len(drawn) == 3
    assert all(panel.get_title().replace("\n", " ").endswith("\N{MICRO SIGN}s") for panel in drawn)
    assert history.axes[0].get_xlabel() == "t (\N{MICRO SIGN}s)"


BUMP = """
[lattice]
spacing = "1 mm"
lower = ["-12 mm", "-5 mm"]
upper = ["12 mm", "5 mm"]
[units]
length = "mm"
time = "us"
pressure = "GPa"
[model]
type = "elastic"
young = "70 GPa"
density = "2700 kg/m^3"
kernel = { horizon = "2 mm" }
[initial]
u = ["0.01*exp(-x**2 - y**2)", 0.0]
[boundary]
all = { type = "lattice-pml", nodes = 3 }
[run]
until = "2 us"
"""


def test_plot_check_info(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    case = str(EXAMPLES / "blob.toml")
    main(["run", case])
    assert main(["plot", "blob.h5", "--out", "pictures", "--times", "0", "5"]) == 0
    assert main(["check", case, "--json", "check.json"]) == 0
    assert "time step" in written("check.json", "check")["facts"]
    assert main(["info"]) == 0
    assert "numba" in capsys.readouterr().out
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out)["required"] == ["lattice", "model", "run"]


def test_check_tunes_an_outline(tmp_path, capsys, monkeypatch):
    """The printed line for the case file gives the boundary that was found, and is certified."""
    monkeypatch.chdir(tmp_path)
    words = """[lattice]\nspacing = 0.25\nwindow = { disc = { radius = 5.12 } }
[model]\ntype = "wave"\nspeed = 1.0\ndamping = 0.0125\nkernel = { horizon = 0.75, exponent = 2 }
[initial]\nu = "exp(-2*(x**2+y**2))"\n[run]\nuntil = 1.0\n[boundary]\nall = { type = "plane-wave" }\n"""
    Path("disc.toml").write_text(words)
    assert main(["check", "disc.toml", "--tune", "--json", "tuned.json"]) == 0
    found = written("tuned.json", "check")["tuned"]
    assert f"all = {found['boundary']}" in capsys.readouterr().out and found["certificate"]["verdict"] == "certified"
    Path("disc.toml").write_text(words.replace('{ type = "plane-wave" }', found["boundary"]))
    assert main(["check", "disc.toml", "--json", "check.json"]) == 0
    assert written("check.json", "check")["certificate"]["verdict"] == "certified"


def test_an_end_that_is_no_time(capsys):
    for end, said in (("soon", "not a time: 'soon'"), ("static", "--set run.until=static --set run.limit=T")):
        with pytest.raises(SystemExit):
            main(["run", "blob.toml", "--until", end])
        assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "missing.toml"],
        ["check", "bad.toml"],
        ["plot", "missing.h5"],
        ["plot", "bad.toml"],
        ["run", "good.toml", "--resume"],
        ["run", "good.toml", "--until", "nan"],
        ["run", "good.toml", "--out", "bad.toml"],
        ["run", "good.toml", "--json", "none/x.json"],
        ["check", "good.toml", "--json", "."],
        ["compare", "good.toml", "--times", "nan"],
        ["compare", "good.toml", "--times", "-1"],
        ["compare", "good.toml", "--out", "bad.toml"],
        ["compare", "wide.toml", "--out", "new"],
        ["demo", "--out", "bad.toml/x"],
        ["run", "moving.toml"],
        ["check", "moving.toml"],
    ],
)
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
    "horizon below spacing": (
        "horizon = 0.75",
        "horizon = 0.1",
        "kernel.horizon",
        "limit: >= 0.25; remedy: horizon = 0.75",
    ),
    "horizon far too wide": ("horizon = 0.75", "horizon = 75.0", "kernel.horizon", "limit: 157 nodes in 2D; remedy"),
    "dt too large": ("until = 70.0", "until = 70.0\ndt = 2.0", "run.dt", "limit: 0.38"),
    "unknown function": ("exp(-log", "expp(-log", "initial.u", "did you mean exp?"),
    "forbidden expression": ("exp(-log(2)/9*(x**2+y**2))", "().__class__", "initial.u", "value: ().__class__"),
    "crack outside": (
        "[[0.0, 10.0], [7.0, 10.0]]",
        "[[40.0, 10.0], [47.0, 10.0]]",
        "crack",
        "limit: [-26, -26] to [26, 26]; remedy",
    ),
    "near field too thin": (
        "window = { disc = { radius = 26.0 } }",
        "lower = [-26.0, 0.0]\nupper = [26.0, 0.5]",
        "lattice",
        "limit: >= 7; remedy",
    ),
    "data beyond": ("log(2)/9", "0.001", "initial.u", "error of about"),
    "radius": ("radius = 26.0", "radius = -26.0", "lattice.window", "value: -26"),
    "memory": ("spacing = 0.25", "spacing = 1e-4", "lattice.spacing", "GiB available; remedy"),
    "probe": ("[[20.0, 10.0]]", "[[20.0]]", "output.probes", "limit: 2 coordinates"),
}


@pytest.mark.parametrize(("old", "new", "key", "rest"), MISTAKES.values(), ids=MISTAKES)
def test_wrong_cases_exit_with_2_and_say_where_and_what(old, new, key, rest, tmp_path, monkeypatch, capsys):
    """The message names the file, the key, the value, the limit and a remedy, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    text = (EXAMPLES / "two_notches.toml").read_text()
    assert old in text
    Path("wrong.toml").write_text(
        text.replace(old, new).replace("probes = [[20.0, 10.0]]", "" if key == "lattice" else "probes = [[20.0, 10.0]]")
    )
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
    same = Path("blob.toml").read_text()
    Path("blob.toml").write_text(same.replace("horizon = 0.75", "horizon = 0.5"))
    assert main(["run", "blob.toml", "--resume"]) == 2
    assert "the case has changed since this run began" in capsys.readouterr().err
    Path("blob.toml").write_text(same)
    Path("blob.ckpt").write_text("no checkpoint")
    assert main(["run", "blob.toml", "--resume"]) == 2
    assert "blob.ckpt" in capsys.readouterr().err and Path("blob.h5").read_bytes() == whole
    assert sorted(p.name for p in tmp_path.iterdir()) == ["blob", "blob.ckpt", "blob.h5", "blob.toml"]


def stopped(folder, number, *options):
    """Return the standard error and the exit code of a run of two notches that received a signal in its time loop."""
    text = (
        (EXAMPLES / "two_notches.toml")
        .read_text()
        .replace("until = 70.0", "until = 150.0")
        .replace("every = 1.0", "every = 0.5")
    )
    (folder / "long.toml").write_text(text)
    command = [sys.executable, "-m", "farhorizon", "run", "long.toml", *options]
    run = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not list(folder.rglob("long.ckpt")):
        assert run.poll() is None, run.stderr.read()
        time.sleep(0.05)
    time.sleep(0.3)  # it is in its loop, and even a fast machine has not finished
    os.kill(run.pid, number)
    return run.communicate()[1], run.returncode


def test_interrupted_run_resumes_to_the_same_result(tmp_path, monkeypatch):
    """Ctrl-C leaves a valid results file and a checkpoint; the command that is printed, taken literally, continues
    bitwise as the whole run.
    """
    words = "--until", "40", "--no-report"
    said, code = stopped(tmp_path, signal.SIGINT, "--out", "a folder", "--json", "run.json", *words)
    assert code == 130
    part = open_results(tmp_path / "a folder" / "long.h5")
    assert 1 <= len(part.times) < 81 and not part.finished
    advice = shlex.split(said.strip().splitlines()[-1].split("continue with: ")[1])
    assert advice[:4] == ["farhorizon", "run", "long.toml", "--resume"]
    monkeypatch.chdir(tmp_path)
    assert main(advice[1:]) == 0 and main(["run", "long.toml", "--out", "whole", *words]) == 0
    resumed, whole = open_results(tmp_path / "a folder" / "long.h5"), open_results(tmp_path / "whole" / "long.h5")
    np.testing.assert_array_equal(resumed.times, whole.times)
    np.testing.assert_array_equal(resumed.field("u"), whole.field("u"))
    np.testing.assert_array_equal(resumed.energy, whole.energy)
    assert resumed.finished and written(tmp_path / "run.json", "run")["time"] >= 40


def test_a_batch_system_that_ends_a_run_loses_nothing(tmp_path):
    """SIGTERM acts like Ctrl-C, with another exit code: the checkpoint is of that moment."""
    said, code = stopped(tmp_path, signal.SIGTERM)
    assert code == 143 and "continue with: farhorizon run long.toml --resume" in said
    _, meta = read_checkpoint(tmp_path / "long.ckpt")
    assert f"t = {meta['step'] * meta['fingerprint']['dt']:g};" in said
    assert not list(tmp_path.glob(".*"))  # no lock, no temporary file


SMALL = """lattice = { spacing = 0.25, lower = [-3.0], upper = [3.0] }
model = { type = "wave", kernel = { horizon = 0.75 } }
initial = { u = "max(0, 1-4*x**2)**2" }
run = { until = 2.0 }
"""


@pytest.fixture
def small(tmp_path, monkeypatch):
    """Folder with a case that takes an instant."""
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SMALL)
    return tmp_path


def test_finished_results_are_overwritten_by_force_alone(small, capsys):
    """Unfinished ones are overwritten without it; --resume continues finished ones whose checkpoint was kept."""
    assert main(["run", "small.toml", "--keep-checkpoint", "--set", "output.dtype=float32"]) == 0
    said, results = capsys.readouterr().out, open_results("small.h5")
    reached = results.steps[-1]
    assert f"reached, {reached} steps and their files in" in said
    assert results.provenance["command"] == "farhorizon run small.toml --keep-checkpoint --set output.dtype=float32"
    assert results.field("u", 0).dtype == np.float32 and "machine" in results.provenance
    before = Path("small.h5").read_bytes()
    assert main(["run", "small.toml"]) == 2
    message = capsys.readouterr().err
    assert "--force" in message and "--resume --until T" in message and Path("small.h5").read_bytes() == before
    words = ["--set", "output.dtype=float32"]
    assert main(["run", "small.toml", "--until", "3", "--resume", *words]) == 0
    more = open_results("small.h5").steps[-1] - reached
    assert f"reached, {more} steps and their files in" in capsys.readouterr().out
    assert open_results("small.h5").times[-1] >= 3 and open_results("small.h5").finished
    assert not Path("small.ckpt").exists() and "go on with it" not in Path("small/report.html").read_text()
    assert main(["run", "small.toml", "--until", "4", "--resume", *words]) == 2
    assert "--keep-checkpoint" in capsys.readouterr().err
    assert main(["run", "small.toml"]) == 2 and "--resume" not in capsys.readouterr().err
    assert main(["run", "small.toml", "--force"]) == 0
    assert open_results("small.h5").times[-1] < 3
    ResultsWriter.resume("small.h5", 1)  # as in a run that was killed
    assert main(["run", "small.toml"]) == 0


def test_two_runs_do_not_write_into_one_output(small, capsys):
    with locked(small / ".small.lock"):
        assert main(["run", "small.toml"]) == 2
    heard = capsys.readouterr().err.splitlines()
    (said,) = [line for line in heard if not line.startswith("farhorizon: compil")]  # compilation is reported, too
    assert "another run writes these results" in said
    assert not Path("small.h5").exists()
    assert main(["run", "small.toml"]) == 0
    assert not list(small.glob(".*"))


def test_left_temporary_files_are_removed(small):
    for name in (".small.h5.4711.tmp", ".small.ckpt.4711.tmp", ".other.h5.4711.tmp"):
        (small / name).touch()
    assert main(["run", "small.toml"]) == 0
    assert [p.name for p in small.glob(".*")] == [".other.h5.4711.tmp"]


@pytest.mark.parametrize(
    ("change", "table"),
    [
        ("initial.u='exp(-2*x**2)'", "initial"),
        ("output.probes=[[1.0]]", "output.probes"),
        ("output.fields=['u', 'v']", "output.fields"),
        ("output.dtype=float32", "output.dtype"),
        ("output.compress=true", ""),
    ],
)
def test_a_changed_case_does_not_go_on(small, capsys, change, table):
    """Its results would be attributed to the first case; the way in which they are written may change."""
    assert main(["run", "small.toml", "--keep-checkpoint"]) == 0
    assert main(["run", "small.toml", "--resume", "--until", "3", "--set", change]) == (2 if table else 0)
    said = capsys.readouterr().err
    assert f"limit: same {table}; remedy: resume with the case that wrote it" in said or not table


def test_a_disk_that_is_full_ends_a_run_in_one_line_and_blocks_nothing(small):
    """Limits from before the first output to the last checkpoint: exit code 1; then the command works, or --resume."""
    Path("small.toml").write_text(SMALL.replace("until = 2.0", "until = 12.0") + "output = { every = 0.2 }\n")
    assert main(["run", "small.toml", "--out", "whole", "--keep-checkpoint"]) == 0
    results, checkpoint = (Path(f"whole/small.{suffix}").stat().st_size // 1024 for suffix in ("h5", "ckpt"))
    assert results > checkpoint + 20
    whole = open_results("whole/small.h5")
    # blocks of 1024 bytes: no results, no checkpoint, no further output
    limits = (4, False), (checkpoint - 2, False), (results - 10, True)
    for blocks, begun in limits:
        script = f"trap '' XFSZ; ulimit -f {blocks}; exec {sys.executable} -m farhorizon run small.toml"
        run = subprocess.run(["bash", "-c", script], capture_output=True, text=True)
        told = [line for line in run.stderr.splitlines() if line.startswith("farhorizon: ")]
        assert (
            run.returncode == 1 and len(told) == 1 and "File too large" in told[0] and "Traceback" not in run.stderr
        ), run.stderr
        assert Path("small.ckpt").exists() == begun
        assert main(["run", "small.toml", *["--resume"] * begun]) == 0
        assert np.array_equal(open_results("small.h5").field("u"), whole.field("u")) and np.array_equal(
            open_results("small.h5").times, whole.times
        )
        assert not list(small.glob(".*"))
        shutil.rmtree("small")
        Path("small.h5").unlink()


@pytest.mark.sampled(3)
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full")
@pytest.mark.parametrize("arguments", [["info"], ["check", "small.toml"], ["run", "small.toml"]])
def test_an_output_that_cannot_be_written_is_told_in_one_line(small, arguments):
    with open("/dev/full", "w") as full:
        run = subprocess.run(
            [sys.executable, "-m", "farhorizon", *arguments], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert run.returncode == 1
    assert [line for line in run.stderr.splitlines() if "note" not in line and "warning" not in line] == [
        "farhorizon: No space left on device"
    ]


def test_a_picture_folder_that_cannot_be_made_is_refused_before_the_run(small, capsys):
    Path("small").write_text("a file")
    assert main(["run", "small.toml"]) == 2
    assert "small is a file: choose another folder" in capsys.readouterr().err and not Path("small.h5").exists()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("delay", [0.0, 0.1, 0.3, 0.6, 1.0, 1.5])
def test_ctrl_c_while_modules_are_imported_is_one_line(small, delay):
    """The same holds at any other time before the run begins; afterwards the message is that of the run."""
    script = (
        "import signal; from farhorizon.cli import process, _leave; signal.signal(signal.SIGINT, _leave); "
        'print("here", flush=True); process()'
    )
    run = subprocess.Popen(
        [sys.executable, "-c", script, "run", "small.toml"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert run.stdout.readline() == "here\n"
    time.sleep(delay)
    os.kill(run.pid, signal.SIGINT)
    heard = run.communicate()[1].strip().splitlines()
    # compilation is reported, too
    said = "\n".join(line for line in heard if not line.startswith("farhorizon: compil"))
    over = ((0, ""), (-signal.SIGINT, ""))  # Python itself had ended, or had restored its handlers to do so
    assert (run.returncode, said) in ((130, "farhorizon: interrupted"), *over) or (
        run.returncode == 130 and said.startswith("interrupted at t = ")
    )


def test_check_warns_of_runs_that_nobody_can_mean(small, capsys):
    closed = 'boundary = { all = { type = "fixed" } }\n'  # no layer has to be chosen for all that time
    Path("small.toml").write_text(closed + SMALL.replace("until = 2.0", "until = 6e14"))
    assert main(["check", "small.toml", "--budget", "1"]) == 0
    said = capsys.readouterr().out
    assert "warning: the run would take about" in said and " years: compare until = 6e+14 with dt = " in said


def test_corrosion_goes_on_after_an_interrupt(tmp_path, monkeypatch):
    """Phases, times of dissolution and balance of a resumed run are bitwise those of one run; the front is drawn."""
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


@pytest.mark.slow
def test_a_killed_run_of_a_breaking_body_goes_on(tmp_path, monkeypatch, capsys):
    """A run that is resumed, killed and resumed has bitwise the fields, probes and balance of one run."""
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(BODY), "--out", "whole", "--json", "run.json"]) == 0
    pictures = {Path(p).name for p in written("run.json", "run")["pictures"]}
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
    lost, work = whole.balance["lost"], whole.balance["work"][-1]
    assert lost[0] >= 0 and (np.diff(lost) >= -1e-12 * work).all() and lost[-1] < work
    assert main(["check", str(BODY), "--details"]) == 0
    said = capsys.readouterr().out
    assert all(word in said for word in ("stable limit", "memory", "stability", "steps to t = 90"))
    assert main(["check", str(BODY), "--tune"]) == 2


def test_version(capsys):
    import farhorizon

    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0 and capsys.readouterr().out == f"farhorizon {farhorizon.__version__}\n"


def test_quiet_leaves_errors_and_the_result(small, capsys):
    """The output does not depend on what is compiled, noted or estimated meanwhile."""
    Path("small.toml").write_text(SMALL.replace("1-4*x**2)**2", "1-4*x**2)**2 + 1e-9*exp(-x**2/9)"))
    assert main(["run", "small.toml", "--quiet"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("results: small.h5") and out.count("\n") == 1 and err == ""
    assert main(["run", "small.toml", "--force"]) == 0
    assert "note: " in capsys.readouterr().err  # which --quiet suppresses
    assert main(["check", "small.toml", "--quiet"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("small: ") and "certified" in out and out.count("\n") == 1 and err == ""
    assert main(["compare", "small.toml", "--quiet", "--json", "errors.json"]) == 0
    out, err = capsys.readouterr()
    curve = written("errors.json", "compare")["lattice PML"]
    assert out.count("\n") == 1 and "small: error of the lattice PML at most" in out and err == ""
    told = float(out.split("at most ")[1].split()[0])
    assert told == pytest.approx(max(curve["error_rel_initial"]), rel=0.05)
    assert main(["run", "small.toml", "--force", "--quiet", "--set", "run.dt=5"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("farhorizon: small.toml: run.dt") and err.count("\n") == 1


def test_a_doubtful_result_is_told_to_those_who_want_quiet(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("a.toml").write_text(CRACK_AT_THE_RIM)
    assert main(["run", "a.toml", "--quiet"]) == 0
    out, err = capsys.readouterr()
    (doubt,) = open_results("a.h5").cautions
    assert err == f"warning: not valid from t = {doubt.time:.6g} on: {doubt.brief}\n" and out.count("\n") == 1


def test_set_changes_the_case_and_what_the_results_keep(small, capsys):
    """A changed run is resumed with the same changes only; unknown keys are refused."""
    same = ["--set", "run.until=3.0", "--set", "model.speed=2"]
    assert main(["run", "small.toml", *same, "--keep-checkpoint", "--json", "run.json"]) == 0
    assert written("run.json", "run")["time"] >= 3
    assert "speed = 2" in open_results("small.h5").case and "until = 3.0" in open_results("small.h5").case
    assert main(["run", "small.toml", "--resume", "--until", "4"]) == 2
    assert "the case has changed since this run began" in capsys.readouterr().err
    assert main(["run", "small.toml", "--resume", "--until", "4", *same]) == 0
    capsys.readouterr()
    for command in ("run", "check", "compare"):
        assert main([command, "small.toml", "--set", "model.sped=2"]) == 2
        assert "unknown key model.sped; did you mean 'speed'?" in capsys.readouterr().err
    assert main(["check", "small.toml", "--set", "model.speed"]) == 2
    assert "--set: give a key" in capsys.readouterr().err
    assert main(["plot", "small.h5"]) == 0


def test_an_interrupted_run_goes_on_with_its_changes(tmp_path):
    said, code = stopped(tmp_path, signal.SIGINT, "--set", "model.damping=0.02", "--threads", "1", "--quiet")
    assert code == 130
    advice = shlex.split(said.strip().splitlines()[-1].split("continue with: ")[1])
    words = ["--threads", "1", "--set", "model.damping=0.02", "--quiet"]
    assert advice == ["farhorizon", "run", "long.toml", "--resume", *words]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--untill", "3"], "--untill 3; did you mean --until?"),
        (["--sett=model.speed=2"], "--sett=model.speed=2; did you mean --set?"),
        (["other.toml"], "other.toml"),
    ],
)
def test_what_a_command_does_not_have_is_told_with_its_own_usage(words, said, capsys):
    with pytest.raises(SystemExit) as end:
        main(["run", "small.toml", *words])
    told = capsys.readouterr().err
    assert end.value.code == 2 and told.startswith("usage: farhorizon run") and told.endswith(f"{said}\n")


def test_threads(small, capsys, monkeypatch):
    """The option overrides the case; more threads than there are, or fewer than one, are refused."""
    import farhorizon.engine.engine as engine

    monkeypatch.setattr("numba.config.NUMBA_NUM_THREADS", 2)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1}, raising=False)
    Path("small.toml").write_text(SMALL.replace("until = 2.0", "until = 2.0, threads = 2"))
    seen = []
    whole = engine.Engine.__init__

    def look(self, *given, **named):
        seen.append(named.get("threads"))
        whole(self, *given, **named)

    monkeypatch.setattr(engine.Engine, "__init__", look)
    assert main(["run", "small.toml", "--threads", "1"]) == 0
    assert seen and set(seen) == {1}
    for wrong in ("0", "3", "-1"):
        assert main(["run", "small.toml", "--threads", wrong, "--force"]) == 2
        assert "threads" in capsys.readouterr().err
    capsys.readouterr()
    assert main(["reproduce", "hermann2023-ex1", "--threads", "3"]) == 2
    assert "threads" in capsys.readouterr().err
    with engine.at_most(1):
        assert engine.available_threads() == 1
    assert engine.available_threads() == 2


def test_new_writes_a_case_and_overwrites_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new"]) == 0
    kinds = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert kinds == ["wave", "elastic", "fracture", "diffusion", "heat", "corrosion", "exact-bar"]
    assert main(["new", "heat"]) == 0
    text = capsys.readouterr().out
    Path("there.toml").write_text("mine")
    assert main(["new", "heat", "-o", "there.toml"]) == 2
    assert "--force" in capsys.readouterr().err and Path("there.toml").read_text() == "mine"
    assert main(["new", "heat", "-o", "there.toml", "--force"]) == 0
    assert Path("there.toml").read_text() == text
    assert main(["new", "haet"]) == 2
    assert "did you mean 'heat'?" in capsys.readouterr().err
    assert main(["new", "-o", "there.toml", "--force"]) == 2
    assert "farhorizon new wave -o there.toml" in capsys.readouterr().err
    assert main(["new", "heat", "-o", "none/x.toml"]) == 2
    assert capsys.readouterr().err.startswith("farhorizon: No such file or directory: none/x.toml")


def test_keys_are_explained_at_the_prompt(capsys):
    assert main(["keys", "model.kernel"]) == 0
    assert "horizon" in capsys.readouterr().out
    assert main(["keys", "model.kernl"]) == 2
    assert "did you mean model.kernel" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "answers"),
    [
        ("farhorizon ch", {"check"}),
        ("farhorizon keys model.kern", {"model.kernel"}),
        ("farhorizon keys model.kernel.inf", {"model.kernel.influence"}),
        ("farhorizon reproduce ji2021-fig5", {"ji2021-fig5"}),
        ("farhorizon new he", {"heat"}),
    ],
)
def test_shells_complete_commands_and_values(line, answers, tmp_path):
    """The request is that of bash: the answer arrives on file descriptor 8."""
    pytest.importorskip("argcomplete")
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": "\n"}
    script = f"exec 8>answer; {sys.executable} -m farhorizon"
    subprocess.run(["bash", "-c", script], cwd=tmp_path, env={**os.environ, **asked}, check=True)
    found = set((tmp_path / "answer").read_text().split())
    assert answers <= found and all(one.startswith(line.split()[-1]) for one in found)


def test_values_are_offered_to_the_shell():
    """What the shell is offered without argcomplete, which asks the same functions."""
    [commands] = [action.choices for action in command_parser()._actions if isinstance(action.choices, dict)]
    offered = {
        name: next(action.completer for action in commands[name]._actions if hasattr(action, "completer"))
        for name in ("keys", "new", "reproduce", "validate")
    }
    keys = offered["keys"](prefix="model.k")
    assert "model.kernel" in keys and all(key.count(".") == 1 for key in keys)
    assert "model" in offered["keys"](prefix="") and "wave" in offered["new"](prefix="")
    assert "ji2021-fig5" in offered["reproduce"](prefix="") and "all" in offered["validate"](prefix="")


def test_plot_draws_what_it_is_asked_for(small, capsys):
    assert main(["run", "small.toml"]) == 0
    capsys.readouterr()
    whole = Path("small/u.png").read_bytes()
    assert main(["plot", "small.h5", "--field", "u", "--time", "0", "2", "--db"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "small/u-t=0,2-dB.png"
    assert Path("small/u.png").read_bytes() == whole  # pictures of other times do not replace it
    assert main(["plot", "small.h5", "--field", "u", "--time", "1.001", "--range", "-1", "1", "--format", "pdf"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("t = 1.001 is not stored") and said.splitlines()[1:] == ["small/u-t=1.001-range=-1,1.pdf"]
    assert Path("small/u-t=1.001-range=-1,1.pdf").read_bytes().startswith(b"%PDF")
    many = [f"{0.02 * n:g}" for n in range(100)]
    assert main(["plot", "small.h5", "--field", "u", "--time", *many]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "small/u-t=0..1.98,100.png"
    assert main(["plot", "small.h5", "--movie", "--db"]) == 0
    assert "small/u-dB.gif" in capsys.readouterr().out
    for options, why in (
        (["--slice", "z=0.5"], "--slice: only a 3D lattice"),
        (["--slice", "0.5"], "--slice: a slice is an axis and a number"),
        (["--slice", "w=0.5"], "--slice"),
        (["--slice", "z=nan"], "--slice"),
        (["--field", "w"], "no such field; value: w; limit: u"),
        (["--range", "1", "-1"], "--range"),
        (["--deformed"], "--deformed"),
        (["--movie", "--time", "1"], "--movie"),
        (["--format", "jpg"], "--format"),
    ):
        assert main(["plot", "small.h5", "--out", "new", *options]) == 2
        assert why in capsys.readouterr().err
    assert not Path("new").exists()


GRAINS = """
[lattice]
spacing = 0.5
lower = [-2.0, -2.0]
upper = [2.0, 2.0]
body = { box = { lower = [-9.0, -9.0], upper = [9.0, 9.0] }, without = [{ disc = { radius = 1.0 } }] }
[model]
type = "correspondence"
young = 1.0
poisson = 0.25
kernel = { horizon = 1.0 }
[[material]]
region = { box = { lower = [0.0, -9.0], upper = [9.0, 9.0] } }
young = 2.0
[boundary]
all = { type = "fixed" }
[run]
until = 1.0
"""


def test_check_draws_the_geometry(tmp_path, capsys):
    (tmp_path / "grains.toml").write_text(GRAINS)
    main(["check", str(tmp_path / "grains.toml"), "--out", str(tmp_path / "seen"), "--budget", "0.1"])
    said = capsys.readouterr().out
    for name in ("grains-nodes.png", "grains-young.png"):
        assert is_picture(tmp_path / "seen" / name) and name in said
    assert "density" not in said.split("picture:", 1)[1]


@pytest.mark.parametrize("command", ["run", "check", "compare"])
def test_a_target_that_no_layer_keeps_is_refused_by_the_name_of_the_file(tmp_path, capsys, monkeypatch, command):
    """The data excite all waves of the line, over a long time; this was once a traceback."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "node.toml").write_text(
        "[lattice]\nspacing = 1.0\nlower = [-20.0]\nupper = [20.0]\n"
        '[model]\ntype = "wave"\nkernel = { horizon = 3.0 }\n'
        '[boundary]\nall = { type = "lattice-pml", target = 1e-9 }\n'
        '[initial]\nu = "max(0, 1 - 4*abs(x))"\n[run]\nuntil = 20000.0\n'
    )
    assert main([command, "node.toml"]) == 2
    said = capsys.readouterr().err
    assert "node.toml" in said and "no layer meets the target" in said and "Extended" in said
