"""Lines in results files (cracks, near field, layers), read back by `open_results` and by VTK."""

import numpy as np
import pytest

import farhorizon as fh


def plane(**options):
    lattice = fh.Lattice(0.5, (-2.0, -1.0), (2.0, 1.0))
    return fh.Simulation(lattice, fh.Wave(fh.Kernel(0.5)), initial={"u": "exp(-9*(x**2 + y**2))"}, **options)


def test_a_file_has_the_lines_of_its_run(tmp_path):
    sides = {"x": fh.LatticePML(nodes=4), "y-": fh.Fixed(), "y+": fh.Sponge(nodes=6)}
    crack = [(-1.0, 0.3), (0.0, 0.3), (1.0, 0.7)]
    sim = plane(boundary=sides, cracks=[crack, fh.Crack([(0.2, -0.8), (0.2, -0.6)], opens=9.0)])
    found = fh.open_results(sim.write(tmp_path / "a.h5")).outlines
    assert list(found) == ["cracks", "near field", "layers"] and len(found["cracks"]) == 2
    np.testing.assert_array_equal(found["cracks"][0], crack)
    ((x, y), _, (right, top), _, last) = found["near field"][0]
    assert (x, y, right, top) == (-2, -1, 2, 1) and tuple(last) == (x, y)
    (layers,) = found["layers"]
    np.testing.assert_allclose((layers.min(0), layers.max(0)), [(-4, -1), (4, 4)])


def test_without_cracks_and_layers_there_is_the_near_field(tmp_path):
    line = fh.Simulation(fh.Lattice(0.5, -2, 2), fh.Wave(fh.Kernel(0.5)), fh.Fixed())
    found = fh.open_results(line.write(tmp_path / "a.h5")).outlines
    assert list(found) == ["near field"] and [p.tolist() for p in found["near field"]] == [[[-2.0]], [[2.0]]]


CUTS = {
    "point": (fh.PointCut(0.3), 1, 0.0),
    "polyline": (fh.Polyline([(0.0, 0.0), (3.0, 4.0)]), 2, 5.0),
    "rectangle": (fh.Rectangle((0, 0, 1), (2, 0, 0), (0, 3, 0)), 5, 10.0),
    "disc": (fh.DiscCut((1, 2, 3), (1, 1, 1), 2.0), 49, 4 * np.pi),
    "polygon": (fh.PolygonCut([(0, 0, 1), (3, 0, 1), (3, 4, 1)]), 4, 12.0),
}


@pytest.mark.parametrize("name", CUTS)
def test_outlines_of_cuts_lie_on_them(name):
    """The outline has the length of the rim, and its extent is the bounds of the cut."""
    cut, count, length = CUTS[name]
    line = cut.outline()
    assert line.shape == (count, cut.dim)
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(length, rel=1e-3)
    np.testing.assert_allclose((line.min(0), line.max(0)), cut.bounds(), atol=0.01)


def test_edges_of_a_cube():
    from farhorizon.simulation.time.output import edges

    lines = edges(np.zeros(3), np.array([1.0, 2.0, 3.0]))
    assert len(lines) == 12 and sum(np.ptp(line, axis=0).sum() for line in lines) == 4 * (1 + 2 + 3)
    assert len({tuple(sorted(map(tuple, line.tolist()))) for line in lines}) == 12


@pytest.mark.parametrize("dim", [1, 2])
def test_vtk_reads_the_lines(tmp_path, dim):
    vtk = pytest.importorskip("vtk")
    if dim == 2:
        sim = plane(cracks=[[(-1.0, 0.3), (1.0, 0.7)]], boundary=fh.LatticePML(nodes=4))
    else:
        sim = fh.Simulation(fh.Lattice(0.5, -2, 2), fh.Wave(fh.Kernel(0.5)), fh.Fixed(), cracks=[0.3])
    results = fh.open_results(sim.write(tmp_path / "a.h5"))
    reader = vtk.vtkXMLPolyDataReader()
    reader.SetFileName(str(results.write_outlines(tmp_path / "a.vtp")))
    reader.Update()
    read = reader.GetOutput()
    lines = [line for some in results.outlines.values() for line in some]
    assert read.GetNumberOfCells() == len(lines)
    assert (read.GetNumberOfVerts(), read.GetNumberOfLines()) == ((0, 3) if dim == 2 else (3, 0))
    for number, line in enumerate(lines):
        cell = read.GetCell(number)
        places = [cell.GetPoints().GetPoint(k)[:dim] for k in range(cell.GetNumberOfPoints())]
        np.testing.assert_array_equal(places, line)
    kinds = [read.GetCellData().GetArray("kind").GetTuple1(k) for k in range(len(lines))]
    assert kinds == [k for k, some in enumerate(results.outlines.values()) for _ in some]
    with pytest.raises(fh.InputError, match="there is no directory"):
        results.write_outlines(tmp_path / "no" / "a.vtp")


def test_pictures_of_a_run_show_its_cracks():
    panel = plane(boundary=fh.Fixed(), cracks=[[(-1.0, 0.3), (1.0, 0.7)]]).plot("u").axes[0]
    assert any(np.array_equal(line.get_xydata(), [(-1.0, 0.3), (1.0, 0.7)]) for line in panel.lines)
