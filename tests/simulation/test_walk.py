"""What a run does not use is not entered, and functions of users are called once."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import farhorizon as fh

ROOT = Path(__file__).parents[2]
# rooms and files of features that a wave between fixed sides does not have
FEATURES = (
    "simulation/heat/",
    "simulation/recorders/",
    "simulation/processes/subdomain.py",
    "simulation/setup/cuts.py",
    "simulation/setup/laws.py",
    "simulation/setup/reference_medium.py",
    "simulation/sides/extension.py",
    "simulation/sides/outline_condition.py",
    "simulation/sides/side_selection.py",
    "simulation/sides/trials.py",
    "simulation/time/breaking.py",
    "simulation/time/of_field.py",
    "simulation/time/output.py",
    "simulation/time/source_terms.py",
    "simulation/time/steady_state.py",
    "inputs/conditions.py",
)


def test_a_plain_run_enters_no_feature_that_it_does_not_use():
    spec = importlib.util.spec_from_file_location("walk", ROOT / "benchmarks" / "walk.py")
    walk = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(walk)
    walk.plain_run()  # imports what is imported late
    entered = {Path(code.co_filename).relative_to(walk.PACKAGE).as_posix() for code in walk.followed()}
    assert "simulation/time/time_loop.py" in entered
    assert [file for file in sorted(entered) if file.startswith(FEATURES)] == []


class Counted:
    """A function of the coordinates that counts its calls."""

    def __init__(self, function):
        self.function, self.calls = function, 0

    def __call__(self, x, y):
        self.calls += 1
        return self.function(x, y)


def bell(x, y):
    return np.exp(-(x**2 + y**2) / 6)


def inclusion(x, y):
    return 1 + 0.2 * (abs(x) < 3) * (abs(y) < 5)


# in the near field, and beyond all absorbing sides together; once more when layers have been chosen
@pytest.mark.parametrize(("boundary", "calls"), [(fh.Fixed(), 1), (fh.LatticePML(nodes=8), 2), (fh.LatticePML(), 4)])
def test_functions_of_users_are_called_once(boundary, calls):
    lattice = fh.Lattice(1.0, (-16.0, -16.0), (16.0, 16.0))
    initial, speed = Counted(bell), Counted(inclusion)
    fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), boundary, initial={"u": initial}).run(until=10.0)
    assert initial.calls == calls
    fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0), speed=speed), boundary, initial={"u": bell}).run(until=10.0)
    assert speed.calls == 1  # also by trials of layers
