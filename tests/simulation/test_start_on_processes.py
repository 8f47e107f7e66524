"""No process looks at the whole lattice: what it evaluates and holds at the start follows from its own nodes."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parents[1] / "start_on_processes.py"
WHOLE = ("varies",)  # what does look at it, as docs/howto/processes.md says


def start_of(processes):
    pytest.importorskip("mpi4py", reason="mpi4py is not installed: python -m pip install 'farhorizon[mpi]'")
    if shutil.which("mpiexec") is None:
        pytest.skip("there is no mpiexec: python -m pip install mpich")
    command = ["mpiexec", "-n", str(processes), sys.executable, "-m", "mpi4py", str(PROGRAM)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr[-2000:]
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    return {line.pop("case"): line for line in lines}


def test_the_start_of_a_process_does_not_depend_on_the_whole():
    """As many nodes each, on two processes and on four: points and bytes of a node stay as they are."""
    two, four = start_of(2), start_of(4)
    assert two.keys() == four.keys() and len(two) > len(WHOLE)
    for name, found in two.items():
        for what, of_a_node in found.items():
            grown = four[name][what] / max(of_a_node, 1e-12)
            if name in WHOLE and what != "held":
                assert grown > 1.3, (name, what, two, four)
            elif name not in WHOLE:
                assert grown < 1.15 or four[name][what] < 0.1, (name, what, two, four)
        # metal is looked at for the cuts, for the check that there is some, and to be laid; with what bonds reach
        assert name in WHOLE or found["points"] < 4, found
