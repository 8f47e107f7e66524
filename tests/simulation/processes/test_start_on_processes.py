"""No process sees the whole lattice: what it evaluates and holds at the start depends on its own nodes."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parents[2] / "start_on_processes.py"
TWICE = "states that vary in a body"  # is assembled once more when its fastest oscillation is known


def start_of(processes):
    pytest.importorskip("mpi4py", reason="mpi4py is not installed: python -m pip install 'farhorizon[mpi]'")
    if shutil.which("mpiexec") is None:
        pytest.skip("there is no mpiexec: python -m pip install mpich")
    command = ["mpiexec", "-n", str(processes), sys.executable, "-m", "mpi4py", str(PROGRAM)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr[-2000:]
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    return {line.pop("case"): line for line in lines}


@pytest.mark.slow
def test_the_start_of_a_process_does_not_depend_on_the_whole():
    """With as many nodes per process, on two and on four: points and bytes per node stay the same."""
    two, four = start_of(2), start_of(4)
    assert two.keys() == four.keys()
    for name, counts in two.items():
        for what, of_a_node in counts.items():
            grown = four[name][what] / max(of_a_node, 1e-12)
            assert grown < 1.15 or four[name][what] < 0.1, (name, what, two, four)
        # metal is evaluated for the cuts, for the check that there is some, and when it is laid, with what bonds reach;
        # a medium that varies for its median, for its extremes, for the cuts, and when it is laid
        assert counts["points"] < 5 * (1 + (name == TWICE)), (name, counts)
