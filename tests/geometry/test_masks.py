"""Regions from a font and from an image: position, size and holes of letters; position and brightness of pixels;
refusals.
"""

import numpy as np
import pytest
from matplotlib.image import imsave

import farhorizon as fh
from farhorizon.case.case import Case


def grid(n=201, half=1.0):
    x = np.linspace(-half, half, n)
    return np.stack(np.meshgrid(x, x, indexing="ij"), -1)


def test_letter_height_and_place():
    """A capital H has the requested height and centre, with its bar in the middle and gaps above and below it."""
    letter = fh.Text("H", 1.2, centre=(0.3, -0.1), bold=True)
    low, high = letter.bounds()
    np.testing.assert_allclose(low + high, [0.6, -0.2], atol=1e-12)
    np.testing.assert_allclose(high[1] - low[1], 1.2, rtol=1e-6)
    assert letter.contains([0.3, -0.1]) and not letter.contains([0.3, 0.3]) and not letter.contains([0.3, -0.5])
    assert letter.contains([[low[0] + 0.01, 0.4], [high[0] - 0.01, -0.6]]).all()


def test_holes_of_letters():
    """The inside of an O is empty; its area is that of the outline by the shoelace formula."""
    letter = fh.Text("O", 1.5)
    assert not letter.contains([0.0, 0.0])
    areas = [
        0.5 * abs(np.dot(p[:, 0], np.roll(p[:, 1], -1)) - np.dot(p[:, 1], np.roll(p[:, 0], -1))) for p in letter._loops
    ]
    assert len(areas) == 2
    found = letter.contains(grid(801)).mean() * 4
    assert found == pytest.approx(abs(areas[0] - areas[1]), rel=0.01)  # a node represents a cell of 1/400


def test_letters_are_polygons_like_others():
    """The same nodes as those of a Polygon from the only loop of a letter, including its edges; text combines with
    other shapes.
    """
    letter = fh.Text("L", 1.0)
    points = grid()
    assert np.array_equal(letter.contains(points), fh.Polygon(letter._loops[0]).contains(points))
    assert (letter - fh.Disc(0.2)).contains(points).sum() < letter.contains(points).sum()


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("a\nb", 1.0), "cannot draw"),
        ((" ", 1.0), "cannot draw"),
        (("a\u6c49", 1.0), "leave out"),
        (("a", 0.0), "height"),
        (("a", 1.0, None, "No Such Font"), "no such font"),
    ],
)
def test_text_refusals(arguments, message):
    with pytest.raises(fh.InputError, match=message):
        fh.Text(*arguments)


def test_pixels():
    """The first row of an image is at the top; a pixel is a square of width / columns."""
    pixels = np.array([[True, False, False], [False, False, True]])
    mask = fh.ImageMask(pixels, width=3.0, centre=(1.5, 1.0))
    points = np.stack(np.meshgrid([0.5, 1.5, 2.5], [1.5, 0.5]), -1)  # centres of the pixels, the top row first
    assert np.array_equal(mask.contains(points), pixels)
    assert not mask.contains([[-0.5, 1.5], [3.5, 0.5], [0.5, 2.5], [2.5, -0.5]]).any()
    np.testing.assert_allclose(mask.bounds(), [[0.0, 0.0], [3.0, 2.0]], atol=1e-12)
    narrow = fh.ImageMask(pixels[:, :2], width=2.0, centre=(1.0, 1.0))
    np.testing.assert_allclose(narrow.bounds(), [[0.0, 1.0], [1.0, 2.0]], atol=1e-12)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_image_files(tmp_path, channels):
    """Dark pixels of grey, coloured and transparent images; transparent pixels are white."""
    dark = np.random.default_rng(2).random((20, 30)) < 0.4
    values = np.where(dark, 0.2, 0.9)
    if channels == 1:
        imsave(tmp_path / "i.png", values, cmap="gray", vmin=0, vmax=1)
    else:
        colours = np.repeat(values[:, :, None], 3, 2)
        if channels == 4:
            colours = np.concatenate([np.zeros((20, 30, 3)), dark[:, :, None]], 2)
        imsave(tmp_path / "i.png", colours)
    assert np.array_equal(fh.ImageMask(tmp_path / "i.png", 3.0).image, dark)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"image": "nowhere.png"}, "cannot read the image"),
        ({"image": np.zeros((3, 3), bool)}, "no dark pixel"),
        ({"image": np.zeros((3, 3))}, "table of bool"),
        ({"threshold": 1.0}, "threshold"),
        ({"width": -1.0}, "width"),
    ],
)
def test_image_refusals(change, message):
    with pytest.raises(fh.InputError, match=message):
        fh.ImageMask(**{"image": np.ones((3, 3), bool), "width": 1.0, **change})


CASE = """
[lattice]
spacing = 0.1
lower = [-2.0, -2.0]
upper = [2.0, 2.0]
[model]
type = "corrosion"
saturation = 0.5
[model.kernel]
horizon = 0.2
[[specimen]]
region = { text = { text = "Fe", height = 1.0, centre = [0.0, 0.9], bold = true } }
[[specimen]]
region = { image = { file = "spot.png", width = 1.0, centre = [0.0, -1.0] } }
[run]
until = 0.1
"""


def test_drawn_specimens_in_a_case_and_in_a_checkpoint(tmp_path):
    """An image is searched for in the folder of the case file; a checkpoint contains its pixels."""
    imsave(
        tmp_path / "spot.png",
        np.where(np.add.outer(np.arange(-9, 10) ** 2, np.arange(-9, 10) ** 2) < 80, 0.0, 1.0),
        cmap="gray",
    )
    (tmp_path / "case.toml").write_text(CASE)
    sim = Case.read(tmp_path / "case.toml").simulation()
    solid = sim.fields["solid"]
    letters = fh.Text("Fe", 1.0, (0.0, 0.9), bold=True).contains(np.stack(sim.lattice.coordinates(), -1))
    assert np.array_equal(solid[:, 20:] > 0, letters[:, 20:]) and solid[20, 10] == 1
    sim.step(20)
    sim.save(tmp_path / "c.ckpt")
    (tmp_path / "spot.png").unlink()
    again = fh.Simulation.restore(tmp_path / "c.ckpt")
    for run in (sim, again):
        run.step(20)
    assert np.array_equal(sim.fields["u"], again.fields["u"])
