"""The far field of a case: in its results, in pictures, and what is refused before any work."""

import re

import numpy as np
import pytest

import farhorizon as fh
from drawn import is_picture
from farhorizon.case.case import Case
from farhorizon.cli import main
from scaling import in_units

CASE = """
lattice = { spacing = 1.0, lower = [-12.0, -12.0], upper = [12.0, 12.0] }
model = { type = "wave", kernel = { horizon = 2.0 } }
boundary = { all = { type = "lattice-pml", nodes = 12 } }
crack = [{ points = [[-2.5, 0.3], [2.5, 0.3]] }]
source = [{ value = "exp(-((x-0.5)**2 + (y+0.7)**2))*sin(0.6*(t-15))*exp(-((t-15)/6)**2)" }]
run = { until = 60.0 }
output = { every = 20.0 }
[far_field]
box = { lower = [-9.0, -9.0], upper = [9.0, 9.0] }
frequencies = [0.07, 0.1]
points = [[25.0, 0.0], [-20.0, 20.0]]
directions = 24
"""


def test_a_far_field_is_in_the_results_and_drawn(tmp_path, monkeypatch, capsys):
    """The far fields of one run and of a run in two parts are bitwise that of a run in Python."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(CASE)
    assert main(["run", "a.toml", "--out", "whole", "--no-report"]) == 0
    assert main(["run", "a.toml", "--out", "part", "--until", "30", "--no-report"]) == 0
    assert main(["run", "a.toml", "--out", "part", "--resume", "--no-report"]) == 0
    whole, part = (fh.open_results(f"{name}/a.h5").recorded for name in ("whole", "part"))
    assert set(whole) == set(part) == {"far_field_points", "far_field_pattern"}
    sim = fh.read_case("a.toml").simulation()
    sim.run(60.0)
    (far,) = sim.recorders
    times, values = far.at()
    pattern = far.pattern()
    for found in (whole, part):
        points, waves = found["far_field_points"], found["far_field_pattern"]
        np.testing.assert_array_equal(points.times, times)
        np.testing.assert_array_equal(points.points, [(25, 0), (-20, 20)])
        np.testing.assert_array_equal(points.data["u"], values)
        assert waves.directions and not points.directions
        np.testing.assert_array_equal(waves.points, pattern.directions)
        np.testing.assert_array_equal(waves.spectra["wave"], pattern.amplitudes[:, 0])
        np.testing.assert_array_equal(waves.spectra["intensity_wave"], pattern.intensities[:, 0])
        assert waves.spectra["intensity_wave"].dtype == float and np.iscomplexobj(waves.spectra["wave"])
    for name in ("far_field_points_u", "far_field_pattern"):
        assert is_picture(tmp_path / "whole" / "a" / f"{name}.png")
    assert main(["check", "a.toml"]) == 0


def test_a_far_field_is_the_same_in_si():
    """The units are millimetres and two microseconds: fields have no unit, amplitudes have that of time and of the
    root of a length, energies that of length^2 / time per frequency.
    """
    length, time = 1e-3, 2e-6
    unit = length**2 / time
    found = []
    for text in (CASE, in_units(CASE, length, time, 1.0)):
        sim = Case(text).simulation()
        sim.run(sim.dt * 105)
        found.append(sim.recorders[0])
    (one, other), (pattern, scaled) = found, [far.pattern() for far in found]
    largest = np.abs(one.at()[1]).max()
    np.testing.assert_allclose(other.at()[1], one.at()[1], atol=1e-11 * largest)
    size = np.abs(pattern.amplitudes).max()
    np.testing.assert_allclose(scaled.amplitudes / (time * length**0.5), pattern.amplitudes, atol=1e-9 * size)
    np.testing.assert_allclose(scaled.intensities.sum((1, 2)) / unit, pattern.intensities.sum((1, 2)), rtol=1e-9)
    np.testing.assert_allclose(other.energy() / unit, one.energy(), rtol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "frequencies = [0.07, 0.1]",
            "frequencies = [0.07, 2.0]",
            r"far_field\.frequencies: the lattice does not carry",
        ),
        ("[25.0, 0.0]", "[5.0, 0.0]", r"far_field\.points: a receiver of the far field lies inside the box"),
        ("directions = 24", "directions = 0", r"far_field\.directions"),
        ("upper = [9.0, 9.0]", "upper = [11.0, 9.0]", r"far_field\.box: .*leave one reach"),
        ("upper = [9.0, 9.0]", "upper = [2.0, 9.0]", r"far_field\.box: .*cuts a crack"),
        ("directions = 24", "direction = 24", "directions"),
    ],
)
def test_cases_with_far_fields_that_are_refused(tmp_path, monkeypatch, capsys, old, new, message):
    monkeypatch.chdir(tmp_path)
    assert old in CASE
    (tmp_path / "a.toml").write_text(CASE.replace(old, new))
    assert main(["run", "a.toml"]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not list(tmp_path.glob("*.h5"))
