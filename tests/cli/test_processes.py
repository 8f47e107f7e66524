"""Errors of runs on several processes: one of them reports the error, and all end."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import farhorizon as fh

README = Path(__file__).parents[2] / "README.md"
CASE = """
lattice = { spacing = 0.3, lower = [-7.2, -7.2], upper = [7.2, 7.2] }
model = { type = "wave", kernel = { horizon = 0.6 } }
initial = { u = "exp(-2*(x**2 + y**2))" }
boundary = { all = { type = "fixed" } }
run = { until = 100.0, threads = 1 }
output = { every = 10.0 }
"""
RUN = "import sys; from farhorizon.cli import main; sys.exit(main(sys.argv[1:]))"
RANK = "import os; rank = int(os.environ['PMI_RANK']); "
#: What a process does before it runs the case, its arguments, and the message of the reporting process.
BAD = {
    "too many": ("", ["--set", "lattice.upper=[-5.1, -5.1]"], "cannot be cut into so many boxes"),
    "topology": ("", ["--set", "run.topology=[3, 1]"], "do not multiply to the number of processes"),
    "no mpi4py": ("import sys; sys.modules['mpi4py'] = None; ", [], "mpi4py is missing"),
    "versions": (f"{RANK}import farhorizon; farhorizon.__version__ += '.other' * rank; ", [], "different versions"),
    "cases": (
        f"{RANK}import sys; sys.argv += ['--set', f'model.speed={{rank + 1}}']; ",
        [],
        "case.model: the processes were given different",
    ),
    "ends": (f"{RANK}import sys; sys.argv += ['--until', f'{{rank + 1}}']; ", [], "--until: the processes were given"),
    "options": (f"{RANK}import sys; sys.argv += ['--until', 'soon'] * rank; ", [], "another command line"),
    "samples": (
        f"{RANK}import numpy as np; np.save(f'{{rank}}.npy', np.sin(0.3 * np.arange(40.0)) * (np.arange(40) > 1)); "
        "os.replace(f'{rank}.npy', 'samples.npy'); load = np.load; np.load = lambda at, **_: load(at) * (1 + rank); ",
        ["--set", 'source=[{ value = "exp(-x**2)", time = { type = "samples", values = "samples.npy", dt = 0.1 } }]'],
        "sources[0]: the processes were given different",
    ),
    "folders of the same name": (
        f"{RANK}os.makedirs(['0', '1/case.h5.parts'][rank]); os.chdir(str(rank)); ",
        [],
        "the folder of the results is not the same",
    ),
    "folders": (
        f"{RANK}os.makedirs(str(rank)); os.chdir(str(rank)); ",
        [],
        "the folder of the results is not the same",
    ),
}


@pytest.fixture(autouse=True)
def mpi():
    pytest.importorskip("mpi4py", reason="mpi4py is not installed: python -m pip install 'farhorizon[mpi]'")
    if shutil.which("mpiexec") is None:
        pytest.skip("there is no mpiexec: python -m pip install mpich")


def started(folder, before="", *arguments):
    (folder / "case.toml").write_text(CASE)
    command = ["mpiexec", "-n", "2", sys.executable, "-c", before + RUN, "run", str(folder / "case.toml"), *arguments]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


# a number of processes that does not fit is tested in the fast tier by "too many", and by `tests/on_processes.py`
@pytest.mark.sampled(4)
@pytest.mark.parametrize("what", [pytest.param(w, marks=pytest.mark.slow) if w == "topology" else w for w in BAD])
def test_bad_input_ends_all_processes(tmp_path, what):
    before, arguments, words = BAD[what]
    run = started(tmp_path, before, *arguments)
    _, said = run.communicate(timeout=120)
    assert run.returncode == 2 and words in said, said
    assert said.count("farhorizon: ") - said.count("farhorizon: compil") == 1, said


def test_the_case_of_the_readme_runs_on_several_processes_and_on_one(tmp_path):
    """The results are bitwise equal; the layers are chosen for the length of the run."""
    (text,) = re.findall(r"```toml\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    fields = []
    for name, before in [("one", []), ("two", ["mpiexec", "-n", "2"])]:
        case = tmp_path / f"{name}.toml"
        case.write_text(text)
        command = [*before, sys.executable, "-c", RUN, "run", str(case), "--threads", "1", "--no-report"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        fields.append(fh.open_results(tmp_path / f"{name}.h5").field("u", -1))
    np.testing.assert_array_equal(*fields)


def children(number):
    """Return the processes that a process has started, and their descendants."""
    found = []
    for one in Path("/proc").glob("[0-9]*/stat"):
        try:
            text = one.read_text()
        except OSError:  # the process has ended
            continue
        if int(text.rpartition(")")[2].split()[1]) == number:
            found += [int(one.parent.name), *children(int(one.parent.name))]
    return found


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_a_killed_process_ends_all_and_the_run_goes_on_from_its_checkpoint(tmp_path):
    run = started(tmp_path, "", "--until", "100000.0", "--set", "output.every=1000.0", "--no-report")
    end = time.monotonic() + 120
    while not (tmp_path / "case.ckpt").exists():
        assert run.poll() is None and time.monotonic() < end, run.communicate()
        time.sleep(0.1)
    every = children(run.pid)
    ranks = [one for one in every if b"PMI_RANK=1" in Path(f"/proc/{one}/environ").read_bytes().split(b"\0")]
    os.kill(ranks[0], signal.SIGKILL)
    out, said = run.communicate(timeout=60)
    assert run.returncode != 0 and "signal 9" in out + said
    assert not [one for one in every if Path(f"/proc/{one}/environ").exists() and state(one) not in "ZX"]
    again = started(tmp_path, "", "--resume", "--until", "10.0", "--no-report")
    out, said = again.communicate(timeout=120)
    assert again.returncode == 0 and "resumed at step 0" in out, said
    assert fh.open_results(tmp_path / "case.h5").finished


def state(number):
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "X"
