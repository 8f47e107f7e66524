"""Records by themselves: tables, arrays, traces, and in results files."""

import sys
from dataclasses import replace

import numpy as np
import obspy
import pytest

import farhorizon as fh
from farhorizon.cli import main
from farhorizon.files.records import Recorded
from farhorizon.files.results import open_results
from farhorizon.files.results_writer import ResultsWriter
from farhorizon.pictures import result_pictures

POINTS = np.array([[0.5, 1.0], [1.5, -1.0], [2.5, 0.25]])


def records(rows=4, first=0, name="line"):
    times = 0.25 * np.arange(first, first + rows)
    u = np.arange(3.0) + 10 * times[:, None]
    stress = u[:, :, None, None] + np.array([[1.0, 2.0], [3.0, 4.0]])
    return Recorded(name, POINTS, times, {"u": u, "v": np.stack([u, -u], -1), "stress": stress})


def test_columns_are_named_by_their_components():
    found = records()
    assert list(found.columns("u")) == ["u"] and list(found.columns("v")) == ["v_x", "v_y"]
    assert list(found.columns("stress")) == ["stress_xx", "stress_xy", "stress_yx", "stress_yy"]
    np.testing.assert_array_equal(found.columns("stress")["stress_yx"], found.data["stress"][:, :, 1, 0])
    with pytest.raises(fh.InputError, match="no such quantity"):
        found.columns("w")


def test_tables_and_arrays(tmp_path):
    """All digits are preserved."""
    found = records()
    found.data["u"] /= 3
    found.to_csv(tmp_path / "u.csv")
    found.to_csv(tmp_path / "v.csv", "v")
    table = np.loadtxt(tmp_path / "u.csv", delimiter=",", skiprows=3)
    np.testing.assert_array_equal(table, np.column_stack([found.times, found.data["u"]]))
    lines = (tmp_path / "v.csv").read_text().splitlines()
    assert lines[2].split(",")[:3] == ["t", "v_x at 0.5 1", "v_x at 1.5 -1"] and len(lines) == 3 + 4
    found.to_npz(tmp_path / "all.npz")
    with np.load(tmp_path / "all.npz") as arrays:
        assert set(arrays) == {"points", "times", "u", "v", "stress"}
        np.testing.assert_array_equal(arrays["stress"], found.data["stress"])
    with pytest.raises(fh.InputError, match="no directory"):
        found.to_csv(tmp_path / "none" / "u.csv")


def test_without_obspy_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "obspy", None)
    with pytest.raises(fh.InputError, match=r"farhorizon\[obspy\]"):
        records().to_obspy()


def test_traces_of_obspy(tmp_path):
    """There is a trace for each receiver and component, with even time steps; SAC, miniSEED and SEG-Y are read back."""
    found = records(rows=50)
    stream = found.to_obspy("v", start="2026-01-01")
    assert [trace.stats.channel for trace in stream] == ["X"] * 3 + ["Y"] * 3
    assert stream[4].stats.station == "R00001" and stream[4].stats.delta == 0.25
    np.testing.assert_array_equal(stream[4].data, found.data["v"][:, 1, 1])
    for name, digits in (("MSEED", 15), ("SAC", 6)):
        stream.select(channel="X", station="R00002").write(str(tmp_path / name), format=name)
        (back,) = obspy.read(str(tmp_path / name))
        np.testing.assert_allclose(back.data, found.data["v"][:, 2, 0], rtol=10.0**-digits)
    found = replace(found, times=found.times / 64)  # SEG-Y has time steps up to 65 ms, and single precision
    single = found.to_obspy("v").select(channel="X", station="R00002")
    single[0].data = single[0].data.astype(np.float32)
    single.write(str(tmp_path / "SEGY"), format="SEGY")
    (back,) = obspy.read(str(tmp_path / "SEGY"))
    np.testing.assert_array_equal(back.data, single[0].data)
    with pytest.raises(fh.InputError, match="two rows"):
        records(rows=1).to_obspy()


def test_uneven_times_make_no_trace():
    found = records()
    found.times[2] += 0.01
    with pytest.raises(fh.InputError, match="even"):
        found.to_obspy()


def written(path, outputs=3):
    """Write a results file with an output every four rows and return its writer."""
    more = {"shape": (4, 3), "spacing": 1.0, "lower": (0.0, 0.0), "fields": ("u",), "dtype": "float64"}
    writer = ResultsWriter.create(path, **more)
    writer.hold(records(0))
    for k in range(outputs):
        writer.append_recorded(records(4, 4 * k))
        writer.append(4 * k + 3, 0.25 * (4 * k + 3), {"u": np.full((4, 3), float(k))})
    return writer


def test_results_have_the_rows_as_they_come(tmp_path):
    writer = written(tmp_path / "a.h5")
    found, whole = open_results(tmp_path / "a.h5").recorded["line"], records(12)
    np.testing.assert_array_equal(found.times, whole.times)
    np.testing.assert_array_equal(found.points, POINTS)
    assert list(found.data) == ["u", "v", "stress"] and writer.recorded == {"line": 12}
    for name, values in whole.data.items():
        np.testing.assert_array_equal(found.data[name], values)
    with pytest.raises(fh.InputError, match="something else of this name"):
        writer.hold(records(0))


@pytest.mark.parametrize(("given", "kept"), [(None, 8), ({"line": 9}, 9)])
def test_results_go_on_after_the_rows_of_the_checkpoint(tmp_path, given, kept):
    """If no number of rows is given, they continue after those of the last output that is kept."""
    written(tmp_path / "a.h5")
    writer = ResultsWriter.resume(tmp_path / "a.h5", 2, recorded=given)
    writer.append_recorded(records(3, kept))
    found = open_results(tmp_path / "a.h5").recorded["line"]
    np.testing.assert_array_equal(found.times, 0.25 * np.arange(kept + 3))
    with pytest.raises(fh.FileFormatError, match="fewer rows"):
        ResultsWriter.resume(tmp_path / "a.h5", 1, recorded={"line": 99})


def test_xarray_has_them_with_their_coordinates(tmp_path):
    written(tmp_path / "a.h5")
    dataset = open_results(tmp_path / "a.h5").to_xarray()
    assert dataset["line_stress"].dims == ("line_time", "line_point", "component", "along")
    assert dataset["line_v"].sel(component="y", line_time=0.5).shape == (3,)
    np.testing.assert_array_equal(dataset["line_y"], POINTS[:, 1])


def test_xarray_names_the_units_of_records(tmp_path):
    """Places, times, frequencies and recorded quantities have units; directions have none."""
    told = {"length": "mm", "time": "us", "frequency": "1/us", "stress": "GPa"}
    more = {"shape": (4, 3), "spacing": 1.0, "lower": (0.0, 0.0), "fields": ("u",), "dtype": "float64"}
    pattern = Recorded(
        "pattern", np.eye(2), np.zeros(0), {}, np.array([0.1]), {"P": np.ones((1, 2), complex)}, directions=True
    )
    writer = ResultsWriter.create(tmp_path / "a.h5", **more, units=told)
    writer.hold(records(0))
    writer.append_recorded(records(3))
    writer.conclude(pattern)
    sums = {"u": np.ones((1, 2), complex), "stress": np.ones((1, 2), complex), "energy": np.ones((1, 2))}
    writer.conclude(Recorded("sums", np.eye(2), np.zeros(0), {}, np.array([0.1]), sums))
    dataset = open_results(tmp_path / "a.h5").to_xarray()
    found = {str(name): one.attrs.get("units") for name, one in dataset.variables.items()}
    assert found["sums_stress_spectrum"] == "GPa us" and found["sums_energy_spectrum"] is None
    assert found["pattern_P_spectrum"] is None
    assert found["line_x"] == "mm" and found["line_time"] == "us" and found["line_stress"] == "GPa"
    assert found["pattern_frequency"] == "1/us" and found["pattern_x"] is None


CASE = """
[lattice]
spacing = 0.25
lower = [-5.0, -5.0]
upper = [5.0, 5.0]
[model]
type = "wave"
[model.kernel]
horizon = 0.5
[initial]
u = "exp(-4*(x**2+y**2))"
[boundary]
all = { type = "lattice-pml", nodes = 6 }
[run]
until = 2.0
[output]
every = 1.0
[[receivers]]
line = { start = [-2.1, 2.0], end = [2.1, 2.0], count = 9 }
record = ["u", "v"]
[[receivers]]
name = "well"
points = [[0.13, 1.0]]
every = 2
interpolation = "linear"
[[spectra]]
name = "spectra"
region = { box = { lower = [-0.5, -0.5], upper = [0.5, 0.5] } }
frequencies = [0.1, 0.3]
[[spectra]]
name = "across"
axis = "y"
position = 1.0
frequencies = [0.2]
[[power]]
region = { disc = { radius = 1.5 } }
[[power]]
name = "right"
axis = "x"
position = 0.4
"""


def test_recorders_of_a_case(tmp_path, monkeypatch, capsys):
    """A whole run and one in two parts have the data of a run in Python, those of receivers bitwise; they are drawn."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(CASE)
    assert main(["run", "a.toml", "--out", "whole", "--no-report"]) == 0
    monkeypatch.setattr(result_pictures, "plot_results", lambda *_: [])  # drawn once only
    assert main(["run", "a.toml", "--out", "part", "--until", "1.3", "--no-report"]) == 0
    assert main(["run", "a.toml", "--out", "part", "--resume", "--no-report"]) == 0
    whole, part = (open_results(f"{name}/a.h5").recorded for name in ("whole", "part"))
    sim = fh.read_case("a.toml").simulation()
    sim.run(2.0)
    names = {"receivers_0", "well", "spectra", "across", "power_0", "right"}
    assert set(whole) == names == {one.name for one in sim.recorders}
    for mine in (one.recorded for one in sim.recorders):
        for found in (whole[mine.name], part[mine.name]):
            np.testing.assert_array_equal(found.times, mine.times)
            np.testing.assert_array_equal(found.frequencies, mine.frequencies)
            for kind in ("data", "spectra"):
                assert getattr(found, kind).keys() == getattr(mine, kind).keys()
                for name, values in getattr(mine, kind).items():
                    np.testing.assert_allclose(getattr(found, kind)[name], values, rtol=1e-12, atol=1e-15)
            for name in mine.data if mine.name in ("receivers_0", "well") else ():
                np.testing.assert_array_equal(found.data[name], mine.data[name])
    assert open_results("part/a.h5").to_xarray()["spectra_u_spectrum"].shape == (2, 25)
    drawn = {path.name for path in (tmp_path / "whole" / "a").iterdir()}
    assert {"receivers_0_u.png", "receivers_0_v.png", "well_u.png", "spectra_u.png", "power_0_power.png"} <= drawn
    assert main(["check", "a.toml"]) == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("every = 2", "every = 0", r"receivers\[1\]\.every"),
        ('record = ["u", "v"]', 'record = ["w"]', r"receivers\[0\]\.record: unknown quantity"),
        ('record = ["u", "v"]', 'record = ["stress"]', "no such quantity"),
        ("points = [[0.13, 1.0]]", "", r"receivers\[1\]: give exactly one of points, line, grid"),
        ("points = [[0.13, 1.0]]", "points = [[0.13, 9.0]]", "outside the near field"),
        ("count = 9", "count = 0", r"receivers\[0\]"),
    ],
)
def test_cases_that_are_refused(tmp_path, monkeypatch, capsys, old, new, message):
    """Each is refused before any work, with the key."""
    monkeypatch.chdir(tmp_path)
    assert old in CASE
    (tmp_path / "a.toml").write_text(CASE.replace(old, new))
    assert main(["run", "a.toml"]) == 2
    from re import search

    assert search(message, capsys.readouterr().err)
    assert not list(tmp_path.glob("*.h5"))
