"""Bodies bounded by triangles against the same bodies as inequalities; files against what was written into them."""

import struct

import numpy as np
import pytest

import farhorizon as fh

QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]  # of a cube, outwards


def cube():
    """Return the corners of the unit cube, and two triangles per face."""
    corners = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    return corners, np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])


def sphere(radius, parts=24):
    """Return the triangles of a sphere of longitudes and latitudes; those at the poles have no area."""
    lon, lat = np.linspace(0, 2 * np.pi, 2 * parts + 1), np.linspace(-np.pi / 2, np.pi / 2, parts + 1)
    lon[-1] = 0.0  # equal to the first, to the last bit
    up, round_about = np.sin(lat), np.stack([np.cos(lon), np.sin(lon)], -1)
    grid = np.concatenate([round_about[:, None] * np.cos(lat)[:, None], np.ones((lon.size, 1, 1)) * up[:, None]], -1)
    grid *= radius
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    return np.concatenate([np.stack(t, -2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))])


def nodes(lower, upper, spacing):
    return np.stack(fh.Lattice(spacing, (lower,) * 3, (upper,) * 3).coordinates(), -1)


def test_a_cube_with_faces_on_nodes_is_the_box():
    """Its surface is included on all sides."""
    at = nodes(-0.5, 1.5, 0.25)
    inside = fh.Mesh(cube()).contains(at)
    np.testing.assert_array_equal(inside, fh.Box((0, 0, 0), (1, 1, 1)).contains(at))


def test_a_turned_cube_is_what_lies_within_its_planes():
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    corners, faces = cube()
    at = nodes(-1.75, 1.75, 0.125)
    own = (at - 0.1) @ turn  # coordinates along the edges
    inside = fh.Mesh(((corners - 0.5) @ turn.T + 0.1, faces)).contains(at)
    np.testing.assert_array_equal(inside, (np.abs(own) <= 0.5).all(-1))


def test_a_sphere_and_a_cavity_in_it():
    at, radius = nodes(-1.25, 1.25, 0.125), np.linalg.norm(nodes(-1.25, 1.25, 0.125), axis=-1)
    inside = fh.Mesh(np.concatenate([sphere(1.1), sphere(0.6)])).contains(at)
    sure = (np.abs(radius - 1.1) > 0.02) & (np.abs(radius - 0.6) > 0.02)  # the flat triangles are at most 0.01 inside
    np.testing.assert_array_equal(inside[sure], ((radius < 1.1) & (radius > 0.6))[sure])


def test_scale_and_centre():
    mesh = fh.Mesh(cube(), scale=2.0, centre=(1.0, 0.0, 0.0))
    np.testing.assert_allclose(mesh.bounds(), [(0, -1, -1), (2, 1, 1)])
    again = fh.Mesh(mesh.triangles, mesh.scale, mesh.centre)
    np.testing.assert_array_equal(again.triangles, mesh.triangles)


def stl_text(corners, faces):
    points = ["".join(f"vertex {x} {y} {z}\n" for x, y, z in corners[face]) for face in faces]
    lines = [f"facet normal 0 0 0\nouter loop\n{inner}endloop\nendfacet" for inner in points]
    return "\n".join(["solid cube", *lines, "endsolid"]).encode()


def stl_binary(corners, faces):
    facets = [struct.pack("<12fH", 0, 0, 0, *corners[f].ravel(), 0) for f in faces]
    return b"solid, says the comment".ljust(80) + struct.pack("<I", len(faces)) + b"".join(facets)


def obj(corners, faces):
    points = [f"v {x} {y} {z}" for x, y, z in corners]
    return "\n".join(["# cube", *points, *(f"f {' '.join(f'{i + 1}//1' for i in quad)}" for quad in QUADS)]).encode()


def ply(kind, order=""):
    def written(corners, faces):
        head = f"ply\nformat {kind} 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
        head += "element face 6\nproperty list uchar int vertex_indices\nend_header\n"
        if not order:
            rows = [" ".join(map(str, p)) for p in corners] + [f"4 {' '.join(map(str, quad))}" for quad in QUADS]
            return (head + "\n".join(rows)).encode()
        body = b"".join(struct.pack(f"{order}3f", *p) for p in corners)
        return head.encode() + body + b"".join(struct.pack(f"{order}B4i", 4, *quad) for quad in QUADS)

    return written


FILES = {
    "text.stl": stl_text,
    "binary.STL": stl_binary,
    "cube.obj": obj,
    "text.ply": ply("ascii"),
    "little.ply": ply("binary_little_endian", "<"),
    "big.ply": ply("binary_big_endian", ">"),
}


@pytest.mark.parametrize(
    ("name", "line_end"),
    [(name, end) for name in FILES for end in (b"\n", b"\r\n") if name != "binary.STL" or end == b"\n"],
)
def test_files_hold_what_was_written(tmp_path, name, line_end):
    corners, faces = cube()
    head, end, body = FILES[name](corners, faces).partition(b"end_header\n")  # line ends occur in text only
    if name in ("text.stl", "cube.obj", "text.ply"):
        body = body.replace(b"\n", line_end)
    head, end = head.replace(b"\n", line_end), end.replace(b"\n", line_end)  # a binary STL has none
    (tmp_path / name).write_bytes(head + end + body)
    mesh = fh.Mesh(tmp_path / name)
    want = {frozenset(map(tuple, corners[face])) for face in faces}
    assert {frozenset(map(tuple, triangle)) for triangle in mesh.triangles} == want


@pytest.mark.parametrize("name", FILES)
def test_damaged_files_are_refused(tmp_path, name):
    content = FILES[name](*cube())
    for damaged in (content[: len(content) // 2], b"", b"\xff" * 200):
        (tmp_path / name).write_bytes(damaged)
        with pytest.raises(fh.InputError, match=r"damaged|no triangles|not closed"):
            fh.Mesh(tmp_path / name)


@pytest.mark.parametrize("without", [b"format ascii 1.0\n", b"ply\n", b"element face 6\n", b"end_header\n"])
def test_a_header_that_lacks_a_line_is_refused(tmp_path, without):
    (tmp_path / "part.ply").write_bytes(FILES["text.ply"](*cube()).replace(without, b""))
    with pytest.raises(fh.FileFormatError, match="damaged"):
        fh.Mesh(tmp_path / "part.ply")


def test_refusals(tmp_path):
    corners, faces = cube()
    with pytest.raises(fh.InputError, match=r"not closed.*value: 3 edges.*fill_holes"):
        fh.Mesh((corners, faces[1:]))
    with pytest.raises(fh.InputError, match="numbers of points; limit: 0 to 7"):
        fh.Mesh((corners, faces + 1))
    with pytest.raises(fh.InputError, match="flat"):
        fh.Mesh((corners * (1, 1, 0), faces))
    with pytest.raises(fh.InputError, match=r"unknown kind of surface file; value: part.step; limit: .stl, .obj, .ply"):
        fh.Mesh("part.step")
    with pytest.raises(fh.InputError, match="cannot read the surface"):
        fh.Mesh(tmp_path / "nowhere.stl")
    with pytest.raises(fh.InputError, match="scale: must be finite and positive"):
        fh.Mesh(cube(), scale=0.0)


CASE = """
[lattice]
spacing = 0.25
lower = [-1.0, -1.0, -1.0]
upper = [1.0, 1.0, 1.0]
[lattice.body]
box = { lower = [-9.0, -9.0, -9.0], upper = [9.0, 9.0, 9.0] }
without = [{ mesh = { file = "cube.stl", centre = [0.0, 0.0, 0.0] } }]
[model]
type = "wave"
kernel = { horizon = 0.25 }
[run]
until = 1.0
"""


def test_a_cavity_from_a_file_in_a_case_and_in_a_checkpoint(tmp_path):
    (tmp_path / "cube.stl").write_bytes(stl_binary(*cube()))
    (tmp_path / "case.toml").write_text(CASE)
    sim = fh.read_case(tmp_path / "case.toml").simulation(initial={"u": "x"}, boundary=fh.Fixed())
    there = sim.lattice.mask
    assert there.sum() == 9**3 - 5**3 and not there[4, 4, 4]
    sim.save(tmp_path / "c.ckpt")
    (tmp_path / "cube.stl").unlink()
    np.testing.assert_array_equal(fh.Simulation.restore(tmp_path / "c.ckpt").lattice.mask, there)
