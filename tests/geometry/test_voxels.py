"""Regions made of cells, against the arrays from which they are made."""

import numpy as np
import pytest
from PIL import Image

import farhorizon as fh
from farhorizon.simulation.setup.reference_medium import constants_of


def labels(*shape):
    return np.random.default_rng(1).integers(0, 4, shape)


@pytest.mark.parametrize("shape", [(7,), (5, 4), (4, 3, 5)])
def test_points_within_cells_are_in_those_that_are_taken(shape):
    cells, rng = labels(*shape), np.random.default_rng(2)
    grid = fh.Voxels(cells, 0.5, lower=(-1.0,) * len(shape), labels=[1, 3])
    index = np.stack(np.indices(shape), -1)
    at = -1.0 + 0.5 * (index + rng.uniform(0.01, 0.99, index.shape))
    np.testing.assert_array_equal(grid.contains(at), (cells == 1) | (cells == 3))
    assert not grid.contains(at + 0.5 * max(shape) + 1).any()


def test_faces_belong_to_the_cells_on_both_sides():
    row = fh.Voxels(np.array([False, True, False]), 0.1, lower=0.0)
    np.testing.assert_array_equal(row.contains([[0.0999], [0.1], [0.2], [0.2001]]), [False, True, True, False])
    np.testing.assert_allclose(row.bounds(), [[0.1], [0.2]])


def test_files(tmp_path):
    cells = labels(4, 3, 5).astype(np.uint8)
    np.save(tmp_path / "c.npy", cells)
    # columns run along x, rows down y, pages along z
    pages = [Image.fromarray(np.ascontiguousarray(cells[:, ::-1, k].T)) for k in range(5)]
    pages[0].save(tmp_path / "c.tif", save_all=True, append_images=pages[1:])
    pages[0].save(tmp_path / "one.tiff")
    for name in ("c.npy", "c.tif"):
        np.testing.assert_array_equal(fh.Voxels(tmp_path / name, 1.0, labels=2).voxels, cells == 2)
    np.testing.assert_array_equal(fh.Voxels(str(tmp_path / "one.tiff"), 1.0).voxels, cells[..., 0] != 0)


def test_a_mask_is_a_body():
    """It has the same nodes as the shape; a mask with a cavity is the medium around it."""
    disc = fh.Disc(1.0)
    whole = fh.Lattice(0.25, (-2, -2), (2, 2))
    there = ~disc.contains(np.stack(whole.coordinates(), -1))
    masked = fh.Lattice(0.25, (-2, -2), (2, 2), body=there)
    np.testing.assert_array_equal(masked.mask, there)
    shape = fh.Lattice(0.25, (-2, -2), (2, 2), body=fh.Box((-9, -9), (9, 9)) - disc)
    given = {"initial": {"u": "exp(-9*((x+1.5)**2+y**2))"}, "boundary": fh.Fixed()}
    runs = [fh.Simulation(one, fh.Wave(fh.Kernel(0.5)), **given) for one in (masked, shape)]
    values = [np.nan_to_num(sim.run(2.0).fields["u"]) for sim in runs]
    np.testing.assert_array_equal(*values)
    assert np.abs(values[0]).max() > 0.01


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda: fh.Voxels(labels(3, 3), 1.0, labels=7), r"no voxel has this label; value: \[7.*limit: 0, 1, 2, 3"),
        (lambda: fh.Voxels(np.zeros((3, 3), int), 1.0), "no voxel is taken"),
        (lambda: fh.Voxels(np.ones((3, 3)), 1.0), "bool or whole numbers"),
        (lambda: fh.Voxels(labels(3, 3), 0.0), "size: must be finite and positive"),
        (lambda: fh.Voxels("nowhere.npy", 1.0), "cannot read the voxels"),
        (lambda: fh.Voxels("scan.raw", 1.0), "unknown kind of voxel file; value: scan.raw"),
        (lambda: fh.Lattice(1.0, (0, 0), (3, 3), body=np.ones((4, 5), bool)), r"lattice.body: has another shape"),
        (
            lambda: fh.Lattice(1.0, (0, 0), (3, 3), body=np.ones((4, 4))),
            "lattice.body: must be an array of true and fal",
        ),
    ],
)
def test_refusals(given, message):
    with pytest.raises(fh.InputError, match=message):
        given()


CASE = """
[lattice]
spacing = 0.25
lower = [-2.0, -2.0]
upper = [2.0, 2.0]
[model]
type = "correspondence"
young = 1.0
poisson = 0.25
kernel = { horizon = 0.5 }
[[material]]
region = { voxels = { file = "grains.npy", size = 2.0, labels = [3] } }
young = 5.0
[run]
until = 0.1
"""


def test_labels_have_materials_in_a_case(tmp_path):
    np.save(tmp_path / "grains.npy", np.array([[1, 2], [3, 3]]))
    (tmp_path / "case.toml").write_text(CASE)
    young = constants_of(fh.read_case(tmp_path / "case.toml").setup)["young"]
    assert (young[9:] == 5.0).all() and (young[:8] == 1.0).all()
