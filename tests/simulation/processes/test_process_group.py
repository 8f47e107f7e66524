"""Runs on 2 and 4 processes against the same runs on one, bit for bit; refusals end on all processes."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import farhorizon as fh
from farhorizon.cli import main
from outputs import written

PROGRAM = Path(__file__).parents[2] / "on_processes.py"
CASE = """
lattice = { spacing = 0.3, lower = [-7.2, -7.2], upper = [7.2, 7.2] }
model = { type = "wave", kernel = { horizon = 0.6 } }
initial = { u = "exp(-2*(x**2 + y**2))" }
boundary = { all = { type = "lattice-pml", nodes = 4 } }
run = { until = 1.0 }
output = { every = 0.25, probes = [[0.0, 0.0], [3.1, -2.0]], probe_every = 0.25 }
"""
REFUSED = CASE.replace('"lattice-pml", nodes = 4', '"higdon"')
BREAKS = """
lattice = { spacing = 0.3, lower = [-10.8, -10.8], upper = [10.8, 10.8] }
model = { type = "elastic", kernel = { horizon = 0.6 }, young = "where(y > 1, 1.2, 1)", critical_stretch = 0.005, nonlinear = true }
boundary = { all = { type = "lattice-pml", nodes = 4 } }
crack = [{ points = [[-2.0, 0.13], [0.7, 0.13]] }]
load = [{ type = "body-force", value = ["0", "0.02*(exp(-(y - 2)**2) - exp(-(y + 2)**2))*exp(-x**2/4)"], time = "1 - exp(-t)" }]
run = { until = 4.0 }
output = { every = 1.0, fields = ["damage"], balance = true, probes = [[0.0, 2.0]] }
"""  # noqa: E501


STATIC = [word for end in ("until=static", "limit=60.0", "tolerance=0.1") for word in ("--set", f"run.{end}")]
STATIC += ["--set", "output.every=10"]


@pytest.fixture(autouse=True)
def mpi():
    pytest.importorskip("mpi4py", reason="mpi4py is not installed: python -m pip install 'farhorizon[mpi]'")
    if shutil.which("mpiexec") is None:
        pytest.skip("there is no mpiexec: python -m pip install mpich")


def told(folder, processes, *arguments):
    """Return what the program prints on several processes, all of which must succeed; its files go into a folder."""
    python = [sys.executable, "-m", "mpi4py"]  # which ends all processes when one fails
    command = ["mpiexec", "-n", str(processes), *python, str(PROGRAM), str(folder), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1500)
    assert done.returncode == 0, done.stderr[-2000:]
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


#: Cases in which the order of a sum depends on the box: parts of rows in which no bond may break, values of an incident
#: wave, tiles of the liquid beside those with metal, tiles in which bonds of states have broken beside a crack.
TO_ROUNDING = (
    *("breaking", "breaking strata", "breaking along a weld", "states with drag"),
    *("an incident wave", "an incident wave below a surface", "an incident wave in strata"),
    *("states that break", "states that break by energy", "states that break and close"),
    *("metal that corrodes", "metal that corrodes, across a periodic side", "metal that corrodes in space"),
)


def check_all(lines, least):
    cases = [line for line in lines if "case" in line]
    assert len(cases) >= least
    for line in cases:
        assert line["same"] if line["case"] not in TO_ROUNDING else line["off"] < 1e-13, line
        assert line["broken"][0] == line["broken"][1] and (line["broken"][0] > 100) == ("break" in line["case"]), line
        # sums of energies are taken in another order
        assert line["moves"] > 1e-3 and line["energy"] < 1e-6, line
        assert line["energy"] < 1e-13 or line["case"] == "single precision", line
        foreseen, sent = line["bytes"]  # what a check predicts
        assert foreseen == sent > 0, line


ON_FOUR = pytest.param(4, "slow", marks=pytest.mark.slow)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("processes", [2, 4])
def test_several_processes_compute_what_one_does(tmp_path, processes):
    """One set-up of each kind; the slow tests have all."""
    lines = told(tmp_path, processes, "few", "fields", "files", "kept")
    check_all(lines, 4)
    check_refused(lines)
    check_files(lines, tmp_path, processes, 1)
    check_kept(lines, processes, 1)


@pytest.mark.slow
@pytest.mark.parametrize(("processes", "size"), [(2, "all"), (2, "slow"), (4, "slow")])
def test_fields_are_those_of_one_process(tmp_path, processes, size):
    """To the last bit: layers cut or chosen, in either precision; periodic sides, sources, several dimensions."""
    lines = told(tmp_path, processes, size, "fields")
    check_all(lines, {"all": 25, "slow": 55}[size])
    check_refused(lines)
    for line in (line for line in lines if line.get("case") == "a band of cracks"):
        first, *_, last = np.diff(line["cuts"][1])
        assert first < last - 5, line  # boxes with more work have fewer nodes


def check_refused(lines):
    """Check that all processes give one message, also for a run that becomes unstable."""
    for line in (line for line in lines if "refused" in line):
        words = {"too many": "so many", "one alone": "finite", "unshared": "Unshared"}
        words |= {"wet": "acts on solid nodes", "no metal": "a specimen holds no node"}
        words |= {"hot": "the stress-free temperature", "heat of deformation": "heat as they are deformed"}
        words |= {"load steps": "load steps are not computed on several processes yet"}
        words |= {"k(u)": "must be positive at all values", "w(u)": "depends on the field is not finite"}
        words |= {"layers": "nodes along the outline", "exact": "whole past", "derivatives": "remembered on all nodes"}
        words |= dict.fromkeys(("extended", "auto"), "the domain grows")
        words |= {"no node": "a constraint holds no node", "no load": "the traction meets no node"}
        assert len(set(line["told"])) == 1, line  # the same on all
        assert words.get(line["refused"], "LatticePML") in line["told"][0], line
    (line,) = (line for line in lines if "unstable" in line)
    assert len(set(line["unstable"])) == 1 and "unstable at step 3" in line["unstable"][0], line


@pytest.mark.parametrize(
    ("processes", "size"), [(2, "few"), *(pytest.param(n, "all", marks=pytest.mark.slow) for n in (2, 4))]
)
def test_gradients_are_those_of_one_process(tmp_path, processes, size):
    """To rounding, and the same to the last bit on all processes."""
    *lines, refused = told(tmp_path, processes, size, "gradients")
    assert len(lines) == {"few": 4, "all": 12}[size]
    for line in lines:
        assert line["same"], line
        assert max(line["off"].values()) < 1e-12, line
    assert len(set(refused["tiny"])) == 1 and "1 nodes" in refused["tiny"][0], refused


@pytest.mark.slow
@pytest.mark.parametrize(("processes", "size"), [(2, "all"), (4, "slow")])
def test_files_are_those_of_one_process(tmp_path, processes, size):
    check_files(told(tmp_path, processes, size, "files"), tmp_path, processes, 6)


def check_files(lines, folder, processes, count):
    """Fields and probes agree to the last bit; receivers between nodes of several boxes are sums in another order."""
    files = [line for line in lines if "files" in line]
    assert len(files) == count
    for line in files:
        assert line["probes"] == 0 and line["receivers"] < 1e-14, line
        for ending in (".h5", ".now.h5"):
            together, alone = (folder / f"{line['files']}-{name}{ending}" for name in ("together", "alone"))
            assert len(list(Path(f"{together}.parts").iterdir())) == processes
            assert_same_results(together, alone)
            fh.open_results(together).merge(folder / "flat.h5")
            assert_same_files(folder / "flat.h5", alone)


@pytest.mark.slow
@pytest.mark.parametrize(("processes", "size"), [(2, "all"), (4, "slow")])
def test_runs_go_on_on_other_boxes_and_on_fewer_processes(tmp_path, processes, size):
    """As if they had not been interrupted, including the memory of layers."""
    lines = told(tmp_path, processes, size, "kept")
    check_kept(lines, processes, {"all": 8, "slow": 20}[size])
    (line,) = (line for line in lines if "adopted" in line)
    assert line["adopted"] == [True] * 3 and line["nodes"][0] > line["nodes"][1], line  # layers for a longer run
    (line,) = (line for line in lines if "unlike" in line)
    assert len(set(line["unlike"])) == 1 and "the checkpoint belongs to another set-up" in line["unlike"][0]


def check_kept(lines, processes, count):
    kept = [line for line in lines if "kept" in line]
    assert len(kept) == count
    for line in kept:
        assert len(line["same"]) == {2: 5, 4: 6}[processes], line
        assert all(line["same"].values()) if line["kept"] not in TO_ROUNDING else line["off"] < 1e-13, line
        assert line["energy"] < 1e-13 or line["kept"] == "single precision", line
        assert line["answers"] == [42] and len(line["steps"]) == 1, line
        assert (line["broken"] > 0) == ("break" in line["kept"]), line


@pytest.mark.parametrize(("processes", "size"), [(2, "all"), ON_FOUR])
def test_records_are_those_of_one_process(tmp_path, processes, size):
    """Crack tips, spectra, power, intensities, far fields and shells; sums over nodes of several boxes to rounding."""
    lines = told(tmp_path, processes, size, "records")
    (line,) = (line for line in lines if "tips" in line)
    assert line["tips"] and line["sums"] < 1e-12
    assert line["length"][1] > line["length"][0] + 0.6, line  # by a horizon
    records = [line for line in lines if "recorded" in line]
    assert len(records) == 11
    for line in records:
        assert line["alike"] and line["keys"] == len(line["off"]) and line["least"] > 1e-4, line
        assert max(line["off"].values()) < 1e-13, line


def assert_same_results(path, reference):
    ours, theirs = fh.open_results(path), fh.open_results(reference)
    assert ours.finished and ours.shape == theirs.shape and len(ours.times) == len(theirs.times)
    for name in theirs.field_names:
        for index in range(len(theirs.times)):
            np.testing.assert_array_equal(ours.field(name, index), theirs.field(name, index))


def assert_same_files(path, reference):
    """Compare files dataset by dataset, except the provenance; energies and records are sums in another order."""
    ours, theirs = datasets(path), datasets(reference)
    assert ours.keys() == theirs.keys()
    for name, values in theirs.items():
        if name.startswith("farhorizon/recorded") or name == "farhorizon/history/energy":
            np.testing.assert_allclose(ours[name], values, rtol=1e-13, atol=1e-13 * np.abs(values).max(initial=0))
        else:
            np.testing.assert_array_equal(ours[name], values, name)


def datasets(path):
    """Return all datasets of a file, and its attributes except the provenance."""
    contents = {}

    def look(name, item):
        contents.update(
            {f"{name} {key}": np.asarray(value) for key, value in item.attrs.items() if key != "provenance"}
        )
        if isinstance(item, h5py.Dataset):
            contents[name] = item[()]

    with h5py.File(path) as file:
        file.visititems(look)
    return contents


def on_one(folder):
    """Return the folder of results of one process; one run stops half-way, and others continue it."""
    for name, text in (("case", CASE), ("breaks", BREAKS), ("refused", REFUSED)):
        (folder / f"{name}.toml").write_text(text)
    for name, out, more in (
        ("case", "alone", []),
        ("breaks", "alone", []),
        ("case", "alone/static", STATIC),
        ("case", "from_one", ["--until", "0.5"]),
    ):
        words = ["run", str(folder / f"{name}.toml"), *more, "--out", str(folder / out), "--quiet", "--no-report"]
        assert main(words) == 0
    return folder / "alone"


@pytest.mark.slow  # the fast tier has the case of the README, `tests/cli/test_processes.py`
@pytest.mark.parametrize(("processes", "size"), [(2, "all"), ON_FOUR])
def test_the_command_line_runs_a_case_on_all_processes(tmp_path, monkeypatch, processes, size):
    """The first process prints, and all return the same code; the files are those of one process."""
    folder, alone = tmp_path, on_one(tmp_path)
    (folder / "blocked" / "case.h5.parts").mkdir(parents=True)
    (folder / "blocked" / "case.h5.parts" / "0001.h5").write_text("mine")
    lines = told(folder, processes, size, "commands")
    lines = {line["command"]: line["told"] for line in lines if "command" in line}
    for every in lines.values():
        codes, outs, errors = zip(*every, strict=True)
        assert len(set(codes)) == 1 and not any(outs[1:]) and not any(errors[1:]), every
    code, out, _ = lines["run case.toml --out together --no-report --json together.json"][0]
    assert code == 0 and f"on {processes} processes in " in out
    monkeypatch.chdir(folder)
    written("together.json", "run")
    assert_same_results("together/case.h5", alone / "case.h5")
    one, other = fh.open_results("together/case.h5"), fh.open_results(alone / "case.h5")
    np.testing.assert_array_equal(one.probe_values, other.probe_values)
    assert_same_results("together/breaks.h5", alone / "breaks.h5")
    assert_same_results("static/case.h5", alone / "static" / "case.h5")
    code, out, errors = lines[f"run case.toml {' '.join(STATIC)} --out static --no-report"][0]
    assert code == 0 and "ended at t = " in out and "not static" not in errors
    code, out, _ = lines["run breaks.toml --out together --no-report"][0]
    assert code == 0 and re.search(r"[1-9]\d\d bonds have broken", out)
    ours, theirs = (fh.open_results(place / "breaks.h5").balance for place in (Path("together"), alone))
    assert ours.keys() == theirs.keys()
    for name, values in theirs.items():
        np.testing.assert_allclose(ours[name], values, rtol=0, atol=1e-12 * theirs["work"].max())
    assert {path.name for path in Path("together/case").iterdir()} == {path.name for path in (alone / "case").iterdir()}
    assert main(["run", "case.toml", "--resume", "--out", "one", "--quiet", "--no-report"]) == 0
    for place in ("goes_on", "one", "from_one"):  # on the same and then other boxes, on one process, from one
        assert_same_results(f"{place}/case.h5", alone / "case.h5")
        assert not [path.name for path in Path(place).iterdir() if "ckpt" in path.name or path.name.startswith(".")]
        np.testing.assert_array_equal(fh.open_results(f"{place}/case.h5").probe_values, other.probe_values)
    assert not Path("one/case.h5.parts").exists() and all(
        len(fh.open_results(f"{place}/case.h5").boxes) == processes for place in ("goes_on", "from_one")
    )
    for command, word in {
        "run case.toml --out together": "holds the results of a finished run",
        "run refused.toml": "sides of the kind Higdon are not computed on several processes yet",
        "run nowhere.toml": "cannot read the case file",
        "run case.toml --out blocked": "is not overwritten",
        "run case.toml --set run.topology=[3, 5] --force": "do not multiply to the number of processes",
        "run case.toml --resume": "no checkpoint case.ckpt",
        "check case.toml": "this command computes on one process",
    }.items():
        code, _, error = lines[command][0]
        assert code == 2 and word in error and error.count("farhorizon:") == 1, lines[command]


#: Endless steps, in the midst of which the second process ends.
ENDS = """
import os, signal, threading, time
from mpi4py import MPI
import farhorizon as fh

def leave():
    time.sleep(1.0)
    os.kill(os.getpid(), signal.SIGKILL)

lattice = fh.Lattice(1.0, (0.0, 0.0), (199.0, 199.0))
sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(3.0)), fh.Fixed(), communicator=MPI.COMM_WORLD)
sim.step(1)
if MPI.COMM_WORLD.rank == 1 and {killed}:
    threading.Thread(target=leave).start()
elif MPI.COMM_WORLD.rank == 1:
    raise RuntimeError("nothing left")
print("steps", flush=True)
sim.engine.advance(10**9)
"""


@pytest.mark.sampled(2)
@pytest.mark.parametrize("killed", [True, False], ids=["killed", "failing"])
def test_a_process_that_is_no_more_ends_all(killed):
    """No process waits for its messages for ever."""
    command = ["mpiexec", "-n", "2", sys.executable, "-m", "mpi4py", "-c", ENDS.format(killed=killed)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode != 0 and done.stdout.count("steps") == 1 + killed, done.stderr[-2000:]
    assert killed or "nothing left" in done.stderr
