"""Regions in results files: the materials of the nodes, as `open_results`, xarray and VTK read them."""

from pathlib import Path

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.cli import main

LATTICE = fh.Lattice(0.5, (-4.0, -3.0), (4.0, 3.0))
X, Y = np.meshgrid(*LATTICE.axes, indexing="ij")


def written(path, lattice=LATTICE, model=None, **options):
    options = {"boundary": fh.Fixed(), **options}
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(0.5)) if model is None else model, **options)
    return fh.open_results(sim.write(path))


def grains():
    """Three phases of a label image, one of them a cavity: the labels of the nodes, and the shapes of phase 2 and of
    the cavity.
    """
    labels = np.where(np.hypot(X, Y) < 1.6, 2, 1) * np.where(X > 3.0, 0, 1)
    image = labels.repeat(2, 0).repeat(2, 1)  # two cells per node
    return labels, *(fh.Voxels(image, 0.25, lower=(-4.25, -3.25), labels=one) for one in (2, 0))


def test_regions_are_what_the_nodes_are_made_of(tmp_path):
    labels, stiff, cavity = grains()
    assert np.array_equal(stiff.contains(np.stack([X, Y], -1)), labels == 2)
    body = fh.Box((-9, -9), (9, 9)) - cavity
    lattice = fh.Lattice(0.5, (-4.0, -3.0), (4.0, 3.0), body=body)
    model = fh.Elastic(fh.Kernel(0.5), young=np.where(labels == 2, 3.0, 1.0), density=np.where(Y > 1, 2.0, 1.0))
    results = written(tmp_path / "a.h5", lattice, model, boundary=fh.Free())
    names = ["young = 1, density = 1", "young = 1, density = 2", "young = 3, density = 1", "young = 3, density = 2"]
    assert sorted(results.region_names) == names
    assert results.region_names[0] == names[0]  # most nodes
    said = np.array([*results.region_names, "none"])[results.regions]
    wanted = np.array(names)[2 * (labels == 2) + (Y > 1)]
    np.testing.assert_array_equal(said, np.where(labels == 0, "none", wanted))
    counts = np.bincount(results.regions[labels > 0])
    assert (np.diff(counts) <= 0).all()


def test_a_uniform_medium_has_no_regions(tmp_path):
    results = written(tmp_path / "a.h5")
    assert results.region_names == () and results.regions.shape == LATTICE.shape and not results.regions.any()


def test_what_grows_with_depth_tells_no_region(tmp_path):
    lattice = fh.Lattice(0.5, (-75.0, -1.0), (75.0, 1.0))  # 301 speeds along x, two coefficients
    (x, y) = lattice.coordinates()
    model = fh.Wave(fh.Kernel(0.5), speed="2 + x/100")
    results = written(
        tmp_path / "a.h5", lattice, model, coefficient=np.broadcast_to(np.where(y > 0, 0.5, 1.0), x.shape)
    )
    assert results.region_names == ("coefficient = 1", "coefficient = 0.5")
    np.testing.assert_array_equal(results.regions, np.broadcast_to(y > 0, lattice.shape))


NAMED = """
lattice = { spacing = 0.5, lower = [-4.0, -3.0], upper = [4.0, 3.0] }
units = { length = "mm", time = "us", pressure = "GPa" }
run = { until = 0.2 }
initial = { v = ["exp(-x**2 - y**2)", 0.0] }
[model]
type = "elastic"
of = "steel"
poisson = 0.25
[model.kernel]
horizon = 1.0
[[material]]
region = { box = { lower = [0.4, -9.0], upper = [9.0, 9.0] } }
of = "aluminium"
poisson = 0.25
name = "left of nothing"
[[material]]
region = { box = { lower = [2.4, -9.0], upper = [9.0, 9.0] } }
name = "lid"
young = 70.0
[[material]]
region = { box = { lower = [-9.0, 0.4], upper = [9.0, 9.0] } }
density = 1.0
"""


def test_materials_have_the_names_of_the_case(tmp_path, monkeypatch, capsys):
    """Names distinguish regions of equal constants; a region without a name keeps that of the one it changes."""
    monkeypatch.chdir(tmp_path)
    Path("a.toml").write_text(NAMED)
    assert main(["run", "a.toml", "--threads", "1"]) == 0
    results = fh.open_results("a.h5")
    materials, dense = np.where(X > 2.4, "lid", np.where(X > 0.4, "left of nothing", "steel")), Y > 0.4
    said = np.array(results.region_names)[results.regions]
    known = set()
    for what in ("lid", "left of nothing", "steel"):
        for there in (dense, ~dense):
            (name,) = set(said[(materials == what) & there])
            constants = dict(pair.split(" = ") for pair in name.split(", ")[1:])
            assert name.split(", ")[0] == what and (constants["density"] == "1") == (there is dense)
            assert float(constants["young"]) == (210.0 if what == "steel" else 70.0)
            known.add(name)
    assert known == set(results.region_names)
    assert results.region_names[0] in Path("a/report.html").read_text(encoding="utf-8")
    capsys.readouterr()
    assert main(["check", "a.toml", "--threads", "1"]) == 0
    assert "steel, young = 210" in capsys.readouterr().out


def test_metal_is_a_region_and_merged_files_keep_it(tmp_path):
    metal = np.hypot(X, Y) < 1.2
    model = fh.Corrosion(fh.Kernel(1.0), saturation=0.5)
    results = written(tmp_path / "a.h5", model=model, specimens=[fh.Specimen(metal, 1.0)])
    for one in (results, fh.open_results(results.merge(tmp_path / "b.h5"))):
        assert one.region_names == ("liquid", "metal")
        np.testing.assert_array_equal(one.regions == 1, metal)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_vtk_and_xarray_read_regions_at_every_output(tmp_path, dim):
    vtk = pytest.importorskip("vtk")
    pytest.importorskip("xarray")
    lattice = fh.Lattice(0.5, (-2.0, -1.0, -1.5)[:dim], (2.0, 1.0, 1.5)[:dim])
    x, *_ = lattice.coordinates()
    inside = np.broadcast_to(x > 0.6, lattice.shape)
    sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(0.5), speed=np.where(inside, 2.0, 1.0)), fh.Fixed())
    sim.run(3 * sim.dt, every=sim.dt, output=tmp_path / "a.h5")
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(tmp_path / "a.h5"))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    assert len(times) == 4
    for time in times:
        reader.UpdateTimeStep(time)
        data = reader.GetOutput().GetPointData().GetArray("region")
        read = [data.GetTuple1(k) for k in range(data.GetNumberOfTuples())]
        np.testing.assert_array_equal(read, inside.T.ravel())
    results = fh.open_results(tmp_path / "a.h5")
    np.testing.assert_array_equal(results.regions, inside)
    kept = results.to_xarray()["region"]
    np.testing.assert_array_equal(kept, inside)
    assert kept.attrs["names"] == ["speed = 1", "speed = 2"]
