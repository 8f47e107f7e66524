"""Runs on 2 and 4 processes against the same on one, bit by bit; what is refused ends on all of them."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parents[1] / "on_processes.py"


@pytest.fixture(autouse=True)
def mpi():
    pytest.importorskip("mpi4py", reason="mpi4py is not installed: python -m pip install 'farhorizon[mpi]'")
    if shutil.which("mpiexec") is None:
        pytest.skip("there is no mpiexec: python -m pip install mpich")


def lines(processes, *arguments):
    """What the program prints, which all processes must come through."""
    command = ["mpiexec", "-n", str(processes), sys.executable, str(PROGRAM), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1500)
    assert done.returncode == 0, done.stderr[-2000:]
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def check_all(found, least):
    cases = [line for line in found if "case" in line]
    assert len(cases) >= least
    for line in cases:
        # sums of energies are taken in another order
        assert line["same"] and line["moves"] > 1e-3 and line["energy"] < 1e-6, line
        assert line["energy"] < 1e-13 or line["case"] == "single precision", line


@pytest.mark.parametrize(("processes", "arguments"), [(2, ()), (4, ("few",))])
def test_fields_are_those_of_one_process(processes, arguments):
    """To the last bit: layers cut across, chosen, of either precision; periodic sides, sources, several dimensions."""
    found = lines(processes, *arguments)
    check_all(found, 1 if arguments else 8)
    for line in (line for line in found if "refused" in line):
        words = {"crack": "cracks", "too many": "so many", "one alone": "finite", "body": "bodies", "drag": "drag"}
        assert len(set(line["told"])) == 1, line  # the same on all
        assert words.get(line["refused"], "LatticePML") in line["told"][0], line
    (line,) = (line for line in found if "unstable" in line)
    assert len(set(line["unstable"])) == 1 and "unstable at step 3" in line["unstable"][0], line


@pytest.mark.slow
@pytest.mark.parametrize("processes", [2, 4])
def test_more_models(processes):
    check_all(lines(processes, "slow"), 25)
