"""Isosurfaces of fields in 3D, against spheres of known area and radius."""

import io

import numpy as np
import pytest

from farhorizon.errors import InputError
from farhorizon.files.results import open_results
from farhorizon.files.results_writer import ResultsWriter
from farhorizon.pictures import result_pictures as drawing
from farhorizon.pictures.isosurfaces import chosen_levels, isosurface, isosurface_panels
from farhorizon.pictures.panels import Look, Panel
from farhorizon.pictures.views import View

AXES = [np.linspace(-2, 2, 41), np.linspace(-3, 1, 41), np.linspace(0, 4, 41)]
CENTRE = np.array([0.0, -1.0, 2.0])
DISTANCE = np.sqrt(sum((x - c) ** 2 for x, c in zip(np.meshgrid(*AXES, indexing="ij"), CENTRE, strict=True)))


@pytest.fixture(autouse=True)
def there():
    pytest.importorskip("skimage", reason="surfaces need what `python -m pip install '.[space]'` brings")


def area(triangles):
    one, other = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.linalg.norm(np.cross(one, other), axis=1).sum() / 2


def test_a_sphere_is_where_it_is():
    """Linear interpolation of a distance has an error below h^2 / (8 r) = 0.0013; chords have a smaller area."""
    found = isosurface(DISTANCE, AXES, 1.0)
    radii = np.linalg.norm(found - CENTRE, axis=-1)
    assert np.abs(radii - 1).max() < 0.00125 and area(found) == pytest.approx(4 * np.pi, rel=0.01)


def test_outside_a_window_there_is_no_surface():
    """Only the part of the sphere beyond the first plane of nodes, at x = 0.1, remains: 2 pi r (r - x)."""
    halved = np.where(np.broadcast_to(AXES[0][:, None, None] > 0.05, DISTANCE.shape), DISTANCE, np.nan)
    found = isosurface(halved, AXES, 1.0)
    assert found[..., 0].min() >= 0.1 - 1e-6 and area(found) == pytest.approx(2 * np.pi * 0.9, rel=0.01)


def test_a_value_that_there_is_not_has_no_surface():
    assert isosurface(DISTANCE, AXES, 9.0).shape == (0, 3, 3)
    with pytest.raises(InputError, match="--isosurfaces: the field has this value nowhere; value: 9"):
        isosurface_panels([Panel("", DISTANCE)], AXES, None, levels=[9.0])
    with pytest.raises(InputError, match="--isosurfaces: only a field in 3D has isosurfaces; value: 2D"):
        isosurface_panels([Panel("", DISTANCE[0])], AXES[1:], None)


def test_levels_are_shares_of_the_largest_value_on_both_sides_of_zero():
    assert chosen_levels([DISTANCE]) == pytest.approx([0.2 * DISTANCE.max(), 0.5 * DISTANCE.max()])
    assert chosen_levels([np.array([-1.0, 2.0])]) == pytest.approx([-1.0, -0.4, 0.4, 1.0])


def file(path, values):
    """Return a results file with one output."""
    place = {"spacing": 0.1, "lower": [axis[0] for axis in AXES[: values.ndim]]}
    writer = ResultsWriter.create(path, shape=values.shape, fields=("u",), dtype="float64", **place)
    writer.append(0, 0.0, {"u": values})
    return open_results(path)


def test_surfaces_of_a_results_file(tmp_path):
    results = file(tmp_path / "a.h5", DISTANCE[::8, ::8, ::8])
    (made,) = drawing.plot_results(results, tmp_path, View(isosurfaces=(), format="pdf"))
    assert made.name == "u-surfaces.pdf" and made.read_bytes().startswith(b"%PDF")
    with pytest.raises(InputError, match="--isosurfaces: levels are finite numbers"):
        View(isosurfaces=[np.nan])
    with pytest.raises(InputError, match="--isosurfaces: only a field in 3D"):
        drawing.plot_results(file(tmp_path / "b.h5", DISTANCE[0]), tmp_path / "new", View(isosurfaces=()))
    assert not (tmp_path / "new").exists()


def test_titles_are_whole_and_the_legend_has_what_is_seen():
    """With and without a title of the figure; the legend omits levels that no panel reaches."""
    pytest.importorskip("skimage")
    axes = [np.linspace(-1.0, 1.0, 9)] * 3
    x, y, z = np.meshgrid(*axes, indexing="ij")
    bell = np.exp(-3 * (x**2 + y**2 + z**2))
    for title in ("", "displacement u"):
        figure = isosurface_panels(
            [Panel("t = 0", bell), Panel("t = 1", 0.1 * bell)], axes, None, Look(title=title), [0.5, 0.05]
        )
        figure.savefig(io.BytesIO())
        for panel in figure.axes:
            box = panel.title.get_window_extent()
            assert 0 < box.y0 and box.y1 < figure.bbox.height
        (legend,) = figure.legends
        assert len(legend.get_texts()) == 2
    figure = isosurface_panels(
        [Panel("t = 0", bell), Panel("t = 1", 0.3 * bell)], axes, None
    )  # comparable: levels of all panels
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["u = 0.2", "u = 0.5"]
    figure = isosurface_panels([Panel("t = 0", bell - 0.25)], axes, None)  # also below zero, but less far
    levels = [float(text.get_text().removeprefix("u = ")) for text in figure.legends[0].get_texts()]
    np.testing.assert_allclose(levels, [-0.15, 0.15, 0.375])


def test_panels_that_are_not_comparable_have_levels_of_their_own():
    """A wave that leaves is visible to the end: common levels would leave its last panel empty."""
    axes = [np.linspace(-1.0, 1.0, 9)] * 3
    x, y, z = np.meshgrid(*axes, indexing="ij")
    bell = np.exp(-3 * (x**2 + y**2 + z**2))
    panels = [Panel("t = 0", bell), Panel("t = 1", 0.01 * bell), Panel("", 0 * bell)]
    figure = isosurface_panels(panels, axes, None, Look(title="whole"))
    figure.savefig(io.BytesIO())
    heads = [panel.get_title() for panel in figure.axes]
    assert heads == ["t = 0\nsurfaces at 0.2, 0.5", "t = 1\nsurfaces at 0.002, 0.005", ""]
    assert [len(panel.collections) for panel in figure.axes] == [1, 1, 0]
    boxes = [panel.title.get_window_extent() for panel in figure.axes]
    assert all(0 <= box.y0 and box.y1 <= figure.bbox.height for box in boxes)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["0.2", "0.5"]
    assert legend.get_title().get_text() == "u over the largest magnitude of its panel"
    given = isosurface_panels(panels[:2], axes, None, levels=[0.3])
    assert [panel.get_title() for panel in given.axes] == ["t = 0", "t = 1"]
