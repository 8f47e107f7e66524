"""`farhorizon invert`: what it writes and draws, that it goes on after it was killed, and what it refuses."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import farhorizon as fh
from drawn import is_picture
from farhorizon.case.inversion import InversionFile
from farhorizon.case.keys import explain_keys
from farhorizon.cli import main
from outputs import written

CASE = """[units]
length = "mm"
time = "us"
mass = "g"
[lattice]
spacing = 1.0
lower = [-12.0, -12.0]
upper = [12.0, 12.0]
[model]
type = "wave"
speed = "1000 m/s"
kernel = { horizon = 2.0 }
[boundary]
all = { type = "lattice-pml", nodes = 6 }
[[source]]
type = "point-source"
at = [-9.0, 0.0]
interpolation = "linear"
time = { type = "ricker", frequency = 0.09 }
[[receivers]]
name = "ring"
points = [[7.0, 0.0], [5.0, 5.0], [0.0, 7.0], [0.0, -7.0], [5.0, -5.0]]
interpolation = "linear"
[run]
until = 9.0
dt = 0.45
"""
FILE = """[inversion]
wrt = "speed"
until = "36 us"
bounds = { speed = ["800 m/s", "1.3 mm/us"] }
region = { disc = { radius = 6.0 } }
iterations = 4
smooth = "1.5 mm"
[[shot]]
case = "plate.toml"
data = "west.npy"
[[shot]]
case = "plate.toml"
data = "north.h5"
receivers = "ring"
set = { "source.0.at" = [0.0, 9.0] }
"""
TRUTH = {"model.speed": "1 + 0.15*exp(-((x-1)**2+(y+0.5)**2)/6)", "run.until": 36.0}


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A folder with a case, the data of two shots, and the file of an inversion."""
    folder = tmp_path_factory.mktemp("inversion")
    (folder / "plate.toml").write_text(CASE)
    (folder / "find.toml").write_text(FILE)
    run = fh.read_case(folder / "plate.toml", TRUTH).simulation()
    run.run(36.0, progress=False)
    np.save(folder / "west.npy", run.recorders[0].data["u"])
    north = [f"--set={key}={value}" for key, value in TRUTH.items()]
    command = ["run", str(folder / "plate.toml"), "--out", str(folder / "north"), "--set=source.0.at=[0.0, 9.0]"]
    assert main([*command, *north, "--quiet"]) == 0
    (folder / "north" / "plate.h5").rename(folder / "north.h5")
    return folder


@pytest.fixture
def folder(measured, tmp_path, monkeypatch):
    """The same in a folder of one's own."""
    for path in measured.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_file_is_what_the_function_takes(folder, capsys):
    """The words mean the same as in Python; numbers with units are those of the first case."""
    assert main(["invert", "find.toml", "--json", "found.json"]) == 0
    said = capsys.readouterr().out
    facts = written("found.json", "invert")
    asked = InversionFile.read("find.toml")
    known = fh.invert(
        asked.shots, "speed", 36.0, bounds={"speed": (0.8, 1.3)}, region=fh.Disc(radius=6.0), iterations=4, smooth=1.5
    )
    assert [step["misfit"] for step in facts["history"]] == [step.misfit for step in known.history]
    assert facts["largest"]["speed"] == known.maps["speed"].max() > 1.02
    with h5py.File("find_inversion.h5") as file:
        np.testing.assert_array_equal(file["models/speed"][-1], known.maps["speed"])
    assert [Path(path).name for path in facts["pictures"]] == [
        "speed.png",
        "speed_change.png",
        "misfit.png",
        "records_u.png",
    ]
    assert all(is_picture(Path(path)) for path in facts["pictures"])
    assert f"misfit {known.history[2].misfit:.4g}" in said and "in 4 iterations" in said
    sources = [setup.sources[0].at for setup, _ in asked.shots]
    assert sources == [(-9.0, 0.0), (0.0, 9.0)]


def test_frequencies_and_one_more_iteration(folder, capsys):
    """A later call continues; --force begins anew; false stands for all frequencies."""
    changes = ["--set", "inversion.frequencies=[0.06, false]", "--set", "inversion.iterations=1", "--quiet"]
    assert main(["invert", "find.toml", *changes, "--json", "found.json"]) == 0
    history = written("found.json", "invert")["history"]
    assert [step["stage"] for step in history] == [0, 0, 1, 1]
    changes[3] = "inversion.iterations=2"
    assert main(["invert", "find.toml", *changes, "--json", "found.json"]) == 0
    more = written("found.json", "invert")["history"]
    assert more[:4] == history and [step["stage"] for step in more] == [0, 0, 1, 1, 1]
    capsys.readouterr()
    assert main(["invert", "find.toml", "--quiet"]) == 2
    assert "not the file of this inversion" in capsys.readouterr().err
    assert main(["invert", "find.toml", "--quiet", "--force", "--set", "inversion.iterations=0"]) == 0


def test_an_inversion_that_was_killed_goes_on(folder):
    """The process is ended without warning after its second iteration; the same command goes on from there."""
    command = [sys.executable, "-m", "farhorizon", "invert", "find.toml", "--set", "inversion.iterations=60"]
    path = folder / "find_inversion.h5"
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    for line in running.stdout:
        if line.startswith("iteration 2"):
            os.kill(running.pid, signal.SIGKILL)
            break
    running.communicate(timeout=60)
    assert running.returncode == -signal.SIGKILL
    with h5py.File(path) as file:
        kept = file["history"][()]
    assert len(kept) >= 3
    assert main(["invert", "find.toml", "--set", f"inversion.iterations={len(kept) + 1}", "--json", "found.json"]) == 0
    history = written("found.json", "invert")["history"]
    assert [step["iteration"] for step in history] == list(range(len(kept) + 2))
    assert [step["misfit"] for step in history[: len(kept)]] == kept[:, 2].tolist()
    assert history[-1]["misfit"] < kept[-1, 2]


def test_other_misfits_and_a_solid(folder):
    """Displacements of an elastic medium are data of vectors; their largest component is drawn."""
    case = CASE.replace('type = "wave"\nspeed = "1000 m/s"', 'type = "elastic"\nyoung = "1 GPa"\ndensity = "1 g/cm^3"')
    case = case.replace('type = "point-source"', 'type = "point-force"\nforce = [1.0, 0.0]')
    Path("plate.toml").write_text(case)
    run = fh.read_case("plate.toml", {"run.until": 36.0}).simulation()
    run.run(36.0, progress=False)
    np.save("west.npy", run.recorders[0].data["u"])
    text = FILE[: FILE.rindex("[[shot]]")].replace("800 m/s", "0.5 GPa").replace("1.3 mm/us", "1.5 GPa")
    text = text.replace("speed", "young").replace("iterations = 4", "iterations = 0") + 'misfit = "envelope"\n'
    Path("find.toml").write_text(text)
    assert main(["invert", "find.toml", "--json", "found.json"]) == 0
    facts = written("found.json", "invert")
    assert facts["history"][0]["misfit"] < 1e-20 and len(facts["pictures"]) == 4


REFUSED = {
    "no file": ("west.npy", "east.npy", "shot[0].data: there is no such file; value: ", "remedy: a .npy file"),
    "no case": ('case = "plate.toml"\ndata = "west', 'case = "other.toml"\ndata = "west', "shot[0].case", "other.toml"),
    "another shape": ('until = "36 us"', 'until = "18 us"', "shot[0].data", "one row for each step"),
    "unknown receivers": ('"ring"', '"rong"', "shot[1].receivers", "did you mean 'ring'"),
    "bounds of another map": (
        'speed = ["800 m/s", "1.3 mm/us"]',
        "density = [0.8, 1.3]",
        "inversion.bounds",
        "{'speed': (low, high)}",
    ),
    "a unit of something else": (
        '"800 m/s"',
        '"800 m"',
        "inversion.bounds.speed[0]",
        "the unit measures something else",
    ),
    "a start outside": ('"800 m/s"', '"1100 m/s"', "inversion.bounds.speed", "wider bounds"),
    "a misspelt word": ("smooth", "smoth", "inversion.smoth", "smooth"),
    "a misspelt misfit": (
        'data = "west.npy"',
        'data = "west.npy"\nmisfit = "squares"',
        "shot[0].misfit",
        "least-squares",
    ),
    "no shot": (FILE[FILE.index("[[shot]]") :], "", "shot: there is no shot", "[[shot]]"),
    "a region near layers": ("radius = 6.0", "radius = 11.5", "inversion.region", "larger lattice"),
    "no array": ("west.npy", "plate.npy", "shot[0].data", "numpy.save"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case, folder, capsys):
    """Nothing is written before the key, the value and the remedy are named."""
    old, new, key, remedy = REFUSED[case]
    assert old in FILE
    Path("plate.npy").write_text("nothing")
    Path("find.toml").write_text(FILE.replace(old, new, 1))
    assert main(["invert", "find.toml"]) == 2
    said = capsys.readouterr().err
    assert "find.toml" in said and key in said and remedy in said, said
    assert not Path("find_inversion.h5").exists()


def test_data_of_another_run_are_refused(folder, capsys):
    """Points, times and quantities of a results file must be those of the case."""
    text = FILE.replace("west.npy", "north.h5").replace('"plate.toml"', '"other.toml"', 1)
    Path("find.toml").write_text(text)
    changes = {
        "other points": ("[7.0, 0.0]", "[7.5, 0.0]"),
        "other times": ("dt = 0.45", "dt = 0.4"),
        "no receivers of this name": ('name = "ring"', 'name = "circle"'),
        "no records of u or v": ('name = "ring"', 'name = "ring"\nrecord = ["gradient"]'),
        "the case has no receivers": (CASE[CASE.index("[[receivers]]") : CASE.index("[run]")], ""),
    }
    for words, (old, new) in changes.items():
        Path("other.toml").write_text(CASE.replace(old, new))
        assert main(["invert", "find.toml"]) == 2
        assert words in capsys.readouterr().err
    both = CASE.replace("[run]", '[[receivers]]\nname = "more"\npoints = [[0.0, 0.0]]\n[run]')
    Path("other.toml").write_text(both)
    assert main(["invert", "find.toml"]) == 2
    assert "shot[0].receivers: the case has several receivers; value: ring, more" in capsys.readouterr().err


def test_keys_are_explained(capsys):
    """The words of the function are those of the file."""
    assert "Length of the Gaussian means" in explain_keys("inversion.smooth")
    assert "unit m" in explain_keys("inversion.smooth")
    listed = explain_keys("inversion")
    assert "illumination" in listed and "callback" not in listed and "output" not in listed
    assert "Name of the receivers" in explain_keys("shot")
