"""Processes that are not given the same, or of which one fails: all end, with one message, and none waits for ever."""

import json
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from farhorizon.simulation.setup.digests import digest_of

PROGRAM = Path(__file__).parents[2] / "on_unlike_processes.py"
GLOBAL = np.arange(20.0)


@pytest.fixture
def mpi():
    pytest.importorskip("mpi4py", reason="mpi4py is not installed: python -m pip install 'farhorizon[mpi]'")
    if shutil.which("mpiexec") is None:
        pytest.skip("there is no mpiexec: python -m pip install mpich")


def done(processes, *arguments):
    """Run the program on several processes without the help of mpi4py; they end within a minute, or hang."""
    command = ["mpiexec", "-n", str(processes), sys.executable, str(PROGRAM), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


@pytest.mark.parametrize("processes", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_each_difference_and_each_failure_is_told_once_and_on_all(mpi, tmp_path, processes):
    run = done(processes, str(tmp_path))
    assert run.returncode == 0, run.stderr[-2000:]
    lines = [json.loads(line) for line in run.stdout.splitlines() if line.startswith("{")]
    assert len(lines) > 50
    for line in lines:
        kinds, words, tells = zip(*line["errors"], strict=True)
        assert "nothing" not in kinds and all(line["word"] in message for message in words), line
        assert sum(tells) == 1, line


#: Cases whose error nobody handles: what the processes print, and their exit code.
UNHANDLED = {
    "until": ("run.until: the processes were given different values", 1),
    "observer that fails": ("ZeroDivisionError: nothing to divide by", 1),
    "source anywhere that fails": ("ZeroDivisionError: nothing to divide by", 1),
    "script that fails": ("ZeroDivisionError: nothing to divide by", 1),
    "script that is refused": ("lattice.spacing: must be finite and positive", 2),
    "script that ends": ("a process has ended before the others", 1),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("case", UNHANDLED)
def test_errors_that_nobody_handles_end_all_processes(mpi, tmp_path, case):
    words, code = UNHANDLED[case]
    run = done(2, str(tmp_path), case)
    assert run.returncode == code
    assert run.stderr.count(words) == 1 == run.stderr.count("Traceback"), run.stderr


class Given:
    """An object of a user."""

    def __init__(self, factor):
        self.factor = factor

    def __call__(self, x):
        return self.factor * x


def with_default(x, factor=GLOBAL):
    return factor * x


def closed(factor):
    def inner(x):
        return [factor * value for value in x]

    return inner


def reads_global(x):
    return closed(GLOBAL)(x)


CHANGED = np.where(np.arange(20) == 7, 7.0 + 2**-49, GLOBAL)  # the next number after 7


@pytest.mark.parametrize(
    "made",
    [
        lambda values: values,
        lambda values: {"a": [1, (values, "text")]},
        lambda values: values.tolist(),
        closed,
        Given,
        lambda values: Given(values).__call__,
        lambda values: partial(with_default, factor=values),
        lambda values: Given(closed(Given(values))),
        lambda values: np.array([values, None], object),
        lambda values: {float(value) for value in values},
    ],
)
def test_digests_depend_on_the_values_alone(made):
    """On copies they are equal, and they differ by the last bit of a number in a function."""
    assert digest_of(made(GLOBAL)) == digest_of(made(GLOBAL.copy())) != digest_of(made(CHANGED))


def test_digests_of_functions_that_read_their_module(monkeypatch):
    before = digest_of(reads_global), digest_of(with_default)
    monkeypatch.setitem(globals(), "GLOBAL", CHANGED)
    assert digest_of(reads_global) != before[0] and digest_of(with_default) == before[1]


def test_values_computed_on_demand_and_cycles_change_no_digest():
    import farhorizon as fh

    lattice, again = (fh.Lattice(1.0, (-3.0, -3.0), (3.0, 3.0), body=fh.Disc(2.0)) for _ in range(2))
    assert lattice.mask.any() and digest_of(lattice) == digest_of(again)
    lists = [[1.0], [1.0]]
    for inner in lists:
        inner.append(inner)
    assert digest_of(lists[0]) == digest_of(lists[1])
