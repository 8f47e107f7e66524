"""Case files: the same run as the Python interface, and clear refusals."""

from pathlib import Path

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.case import Case

GOOD = """
[lattice]
spacing = 0.25
lower = [-3.0, -3.0]
upper = [3.0, 3.0]
[model]
type = "wave"
[model.kernel]
horizon = 0.75
[initial]
u = "exp(-4*(x**2+y**2))"
[run]
until = 3.0
"""


def test_a_case_is_the_run_of_the_python_interface():
    sim = Case(GOOD).simulation().run(3.0)
    same = fh.Simulation(fh.Lattice(0.25, (-3, -3), (3, 3)), fh.Wave(fh.Kernel(0.75)), fh.LatticePML(),
                         {"u": lambda x, y: np.exp(-4 * (x**2 + y**2))}).run(3.0)  # fmt: skip
    np.testing.assert_allclose(sim.fields["u"], same.fields["u"], atol=1e-15)


def test_demo_is_the_published_example():
    """The packaged demo is the example file, word for word."""
    root = Path(__file__).parent.parent
    assert (root / "examples" / "two_notches.toml").read_text() == (root / "src" / "farhorizon" / "demo.toml").read_text()


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("spacing", "spaccing", "did you mean 'spacing'"),
        ("horizon = 0.75", "horizn = 0.75", "did you mean 'horizon'"),
        ("[run]", "[runn]", "did you mean 'run'"),
        ('type = "wave"', 'type = "wave"\nspeeed = 2.0', "did you mean 'speed'"),
        ('type = "wave"', 'type = "wav"', "model"),
        ("0.75", "0.1", "horizon is smaller"),
        ("until = 3.0", "until = -3.0", "run.until"),
        ("until = 3.0", "until = nan", "run.until"),
        ("until = 3.0", "until = 3.0\ndt = 9.0", "above the stable limit"),
        ("exp(", "ecp(", "exp"),
        ("exp(", "__import__('os').system(", "case.toml"),
        ("x**2", "t**2", "depend on t"),
        ("upper = [3.0, 3.0]", "upper = [3.1, 3.0]", "whole number of spacings"),
        ("upper = [3.0, 3.0]", "", "upper"),
        ("[run]", "[boundary]\nw = { type = 'free' }\n[run]", "unknown side"),
        ("[run]", "[boundary]\nall = { type = 'lattice-pml', node = 3 }\n[run]", "did you mean 'nodes'"),
        ("[run]", "[output]\nprobes = [[9.0, 0.0]]\n[run]", "outside the near field"),
        ("[run]", "[[crack]]\npoints = [[-9.0, 0.1], [9.0, 3.1]]\n[run]", "across the absorbing side"),
        ("[run]", "[run", "not valid TOML"),
    ],
)
def test_mistakes_are_named(old, new, message):
    with pytest.raises(fh.InputError, match=message) as error:
        Case(GOOD.replace(old, new)).simulation()
    assert "case.toml" in str(error.value)
