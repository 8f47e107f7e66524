"""Meshes of volumes as regions, against the shapes that they mesh; files as Gmsh writes them."""

import sys
from pathlib import Path

import numpy as np
import pytest

import farhorizon as fh

# A square of two triangles "left" (1), one of two "right" (2), and the line between them, as Gmsh 4 writes it.
TWO_SQUARES = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
3
1 3 "seam"
2 1 "left"
2 2 "right"
$EndPhysicalNames
$Entities
0 1 2 0
1 1 0 0 1 1 0 1 3 0
1 0 0 0 1 1 0 1 1 0
2 1 0 0 2 1 0 1 2 0
$EndEntities
$Nodes
1 6 1 6
2 1 0 6
1
2
3
4
5
6
0 0 0
1 0 0
2 0 0
0 1 0
1 1 0
2 1 0
$EndNodes
$Elements
3 5 1 5
1 1 1 1
1 2 5
2 1 2 2
2 1 2 5
3 1 5 4
2 2 2 2
4 2 3 6
5 2 6 5
$EndElements
"""


def mesh_file(folder):
    path = Path(folder, "two.msh")
    path.write_text(TWO_SQUARES)
    return path


def test_groups_are_the_rectangles_that_they_mesh(tmp_path):
    pytest.importorskip("meshio")
    path = mesh_file(tmp_path)
    at = np.stack(fh.Lattice(0.125, (-0.5, -0.5), (2.5, 1.5)).coordinates(), -1)
    for group, box in (("left", ((0, 0), (1, 1))), ("right", ((1, 0), (2, 1))), (None, ((0, 0), (2, 1)))):
        np.testing.assert_array_equal(fh.Elements(path, group).contains(at), fh.Box(*box).contains(at))
    large = fh.Elements(path, "left", scale=2.0)
    np.testing.assert_array_equal(large.contains(at), fh.Box((0, 0), (2, 2)).contains(at))
    again = fh.Elements(large.elements, large.group, large.scale)
    np.testing.assert_array_equal(again.elements, large.elements)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_triangulated_hull_is_the_hull(dim):
    """Delaunay elements of random points, also at points on faces, and a single element."""
    from scipy.spatial import Delaunay

    points = np.random.default_rng(dim).normal(size=(40, dim))
    made = Delaunay(points)
    at = np.concatenate(
        [np.random.default_rng(7).normal(size=(2000, dim)), points, points[made.simplices[:9, :2]].mean(1)]
    )
    np.testing.assert_array_equal(
        fh.Elements((points, made.simplices)).contains(at), made.find_simplex(at, tol=1e-9) >= 0
    )
    first = made.simplices[:1]
    inside = Delaunay(points[first[0]]).find_simplex(at, tol=1e-9) >= 0
    np.testing.assert_array_equal(fh.Elements((points, first)).contains(at), inside)


CASE = """
lattice = { spacing = 0.125, lower = [-0.5, -0.5], upper = [2.5, 1.5] }
model = { type = "wave", speed = 1.0, kernel = { horizon = 0.125 } }
run = { until = 1.0 }
boundary = { all = { type = "fixed" } }
[[material]]
region = { elements = { file = "two.msh", group = "left" } }
speed = 2.0
"""


def test_cases_have_materials_by_group(tmp_path):
    pytest.importorskip("meshio")
    mesh_file(tmp_path)
    case = fh.read_case(_case(tmp_path, CASE))
    results = fh.open_results(case.simulation().write(tmp_path / "a.h5"))
    at = np.stack(case.lattice.coordinates(), -1)
    np.testing.assert_array_equal(results.regions == 1, fh.Box((0, 0), (1, 1)).contains(at))
    assert results.region_names == ("speed = 1", "speed = 2")


@pytest.mark.parametrize(
    "changed, message",
    [
        (
            ('"left"', '"middle"'),
            r"material\[0\].region.elements.group: the mesh has no physical group of this name; value: middle; "
            "limit: left, right",
        ),
        (('"left"', '"seam"'), "the group 'seam' has no triangles and no tetrahedra"),
        (('"left"', '"left", scale = 1e-3'), r"material\[0\].region: the region has no node of the near field"),
        (("two.msh", "one.msh"), "one.msh"),
        (
            ("speed = 2.0", ""),
            r"material\[0\]: a region without a material; limit: .*speed.*; remedy: give it constants",
        ),
        (('"two.msh", group = "left"', '"bad.msh"'), "cannot read the mesh .*MSH 4.1"),
    ],
)
def test_what_is_wrong_is_told(tmp_path, changed, message):
    pytest.importorskip("meshio")
    mesh_file(tmp_path)
    Path(tmp_path, "bad.msh").write_text("no mesh")
    text = CASE.replace(*changed) if changed[0] != "speed = 2.0" else CASE.replace("speed = 2.0", "")
    if "scale" in changed[1]:  # between two nodes
        text = text.replace(
            "lower = [-0.5, -0.5], upper = [2.5, 1.5]", "lower = [-0.4375, -0.4375], upper = [2.5625, 1.5625]"
        )
    with pytest.raises(fh.InputError, match=message):
        fh.read_case(_case(tmp_path, text))


def test_surfaces_in_space_and_wrong_arrays_are_refused(tmp_path):
    pytest.importorskip("meshio")
    path = tmp_path / "bent.msh"
    path.write_text(TWO_SQUARES.replace("2 1 0\n$EndNodes", "2 1 1\n$EndNodes"))
    with pytest.raises(fh.InputError, match="a surface, and cover no volume"):
        fh.Elements(path)
    with pytest.raises(fh.InputError, match="triangles in 2D or tetrahedra in 3D"):
        fh.Elements(np.zeros((3, 4, 2)))
    with pytest.raises(fh.InputError, match="0 to 2, whole"):
        fh.Elements(([(0, 0), (1, 0), (0, 1)], [(0, 1, 3)]))
    with pytest.raises(fh.InputError, match="only files have groups"):
        fh.Elements(([(0, 0), (1, 0), (0, 1)], [(0, 1, 2)]), group="left")


def test_without_meshio_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(fh.InputError, match=r"meshio is not installed.*farhorizon\[gmsh\]"):
        fh.Elements(mesh_file(tmp_path))


def _case(folder, text):
    path = Path(folder, "case.toml")
    path.write_text(text)
    return path
