"""Fields are drawn in every dimension and for awkward data."""

import numpy as np
import pytest

from drawn import axes_of, is_picture, wave
from farhorizon.errors import InputError
from farhorizon.files.region_numbers import Regions
from farhorizon.pictures import fields as drawing
from farhorizon.pictures.panels import Grid, Look, Panel, cell_edges


@pytest.mark.sampled(2)
@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("number", [1, 2, 5])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_field_panels(tmp_path, dim, number, shared):
    axes = axes_of(dim)
    panels = [Panel(f"t = {k}", wave(axes, k)) for k in range(number)]
    crack = np.zeros((2, dim))
    crack[1, 0] = 0.5
    drawing.field_panels(panels, axes, tmp_path / "u.png", Look(shared=shared, cracks=[crack]))
    assert is_picture(tmp_path / "u.png")


@pytest.mark.parametrize("dim", [2, 3])
def test_gradient_panels(tmp_path, dim):
    """The fields are constant somewhere, outside a window and beside a solid."""
    axes = axes_of(dim)
    fields = {"a": wave(axes, 0.0), "b": np.zeros([a.size for a in axes])}
    drawing.gradient_panels([Panel(name, u, solid=u > 0.9) for name, u in fields.items()], axes, tmp_path / "u.png")
    assert is_picture(tmp_path / "u.png")


@pytest.mark.parametrize("value", [0.0, 3.0, -2.0, np.nan])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_constant_and_empty_fields(tmp_path, dim, value):
    axes = axes_of(dim)
    drawing.field_panels([Panel("", np.full([a.size for a in axes], value))], axes, tmp_path / "u.png")
    assert is_picture(tmp_path / "u.png")


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (300, 4), (4, 300)])
def test_long_and_thin_lattices(tmp_path, shape):
    axes = [0.5 * np.arange(n) for n in shape]
    field = np.arange(float(np.prod(shape))).reshape(shape)
    drawing.field_panels([Panel("a", field), Panel("b", field)], axes, tmp_path / "u.png")
    assert is_picture(tmp_path / "u.png")


def test_field_panels_refuses(tmp_path):
    axes = axes_of(2)
    field = wave(axes, 0)
    with pytest.raises(InputError, match="one field or more"):
        drawing.field_panels([], axes, tmp_path / "u.png")
    with pytest.raises(InputError, match="field 'a' does not match"):
        drawing.field_panels([Panel("a", field.T)], axes, tmp_path / "u.png")
    with pytest.raises(InputError, match=r"limit: \(n, 2\)"):
        drawing.field_panels([Panel("a", field)], axes, tmp_path / "u.png", Look(cracks=[np.zeros((2, 3))]))
    with pytest.raises(InputError, match="no directory"):
        drawing.field_panels([Panel("a", field)], axes, tmp_path / "none" / "u.png")
    assert list(tmp_path.iterdir()) == []


def test_field_table(tmp_path, monkeypatch):
    """There is one scale per row, up to five times the first column; a run that ended early leaves a panel blank."""
    from matplotlib.axes import Axes

    axes = axes_of(2)
    limits, image = [], Axes.imshow
    monkeypatch.setattr(
        Axes, "imshow", lambda axes, *args, **options: limits.append(options["vmax"]) or image(axes, *args, **options)
    )
    first = [wave(axes, t) for t in (0.0, 1.0)]
    columns = [("reference", first), ("twice", [2 * u for u in first]), ("ended", [100 * first[0]])]
    look = Look(cracks=[np.array([[-0.5, 0.0], [0.5, 0.0]])])
    drawing.field_table(["t = 0", "t = 1"], columns, axes, tmp_path / "u.png", look)
    assert is_picture(tmp_path / "u.png")
    peaks = [np.nanmax(np.abs(u)) for u in first]
    np.testing.assert_allclose(limits, [5 * peaks[0]] * 3 + [2 * peaks[1]] * 2)
    with pytest.raises(InputError, match="first column that is complete"):
        drawing.field_table(["t = 0", "t = 1"], columns[::-1], axes, tmp_path / "u.png")


def test_coarse_fields_are_drawn_between_nodes_and_broken_bonds_over_them():
    """At the nodes the colours are those of the values; broken bonds are black; a panel ends where its field does."""
    axes = axes_of(2)
    field = np.nan_to_num(wave(axes, 0))
    broken = np.zeros(field.shape)
    broken[3, 4] = 1.0
    beyond = np.array([[-9.0, 0.0], [9.0, 0.0]])
    look = Look(smooth=True, cracks=[beyond])
    panel = drawing.field_panels([Panel("", field, broken=broken)], axes, None, look).axes[0]
    image, over = panel.images
    assert image.get_interpolation() == "bilinear"
    np.testing.assert_array_equal(image.get_array(), field.T)
    np.testing.assert_array_equal(over.get_array()[4, 3], [0, 0, 0, 1])
    assert over.get_array().sum() == 1
    assert (*panel.get_xlim(), *panel.get_ylim()) == cell_edges(axes)
    field[0, 0] = np.nan  # outside a window
    plain = drawing.field_panels([Panel("", field)], axes, None, Look(smooth=True)).axes[0].images[0]
    assert plain.get_interpolation() != "bilinear"


def test_names_of_materials_stand_in_the_first_panel_alone():
    axes = axes_of(2)
    numbers = np.zeros(wave(axes, 0).shape, int)
    numbers[:3], numbers[8:] = 1, 2
    regions = Regions(numbers, ("rock, young = 1", "steel", "rock, young = 3"))
    figure = drawing.field_panels([Panel("", wave(axes, k)) for k in (0, 1)], axes, None, Look(regions=regions))
    first, second = ([text for text in panel.texts if text.get_text()] for panel in figure.axes[:2])
    assert {text.get_text(): numbers[axes_index(axes, text)] for text in first} == {"rock": 0, "steel": 1}
    assert len(first) == 2 and not second


def axes_index(axes, text):
    return tuple(int(np.abs(axis - x).argmin()) for axis, x in zip(axes, text.get_position(), strict=True))


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_outline_of_metal(tmp_path, dim):
    axes = axes_of(dim)
    field = wave(axes, 0)
    for name, solid in (("a", None), ("b", np.abs(field) > 0.5)):
        drawing.field_panels([Panel("", field, solid)], axes, tmp_path / f"{name}.png")
    same = (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert same == (dim == 1)


@pytest.mark.parametrize("dim", [2, 3])
def test_titles_are_no_wider_than_their_panels(dim):
    """Long titles are wrapped, formulas are not split."""
    axes = axes_of(dim)
    name = r"t = $1.5 \times 10^{-6}$ s, crack where bonds cannot break, and so on"
    draw = drawing.field_panels if dim == 2 else drawing.slice_panels
    figure = draw([Panel(name, wave(axes, k)) for k in range(4)], axes, None, Look(title=3 * name))
    figure.draw_without_rendering()
    panels = [one for one in figure.axes if one.get_title()]
    for panel in panels:
        title = panel.title
        assert title.get_window_extent().width <= 1.02 * panel.get_window_extent().width
        assert title.get_text().replace("\n", " ").startswith(name) and "10^{-6}$ s" in title.get_text().replace(
            "\n", " "
        )
    assert len(panels) == (4 if dim == 2 else 12)
    assert figure._suptitle.get_window_extent().width <= figure.bbox.width


@pytest.mark.parametrize("bars", [False, True])
@pytest.mark.parametrize("ratio", [0.2, 0.4, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("number", [1, 2, 3, 4, 6])
def test_no_place_among_panels_stays_empty(number, ratio, bars):
    grid = Grid.of(number, ratio, bars)
    assert grid.rows * grid.columns == number


@pytest.mark.parametrize(("number", "rows", "named"), [(1, 1, 1), (3, 1, 1), (4, 2, 2), (5, 2, 2), (8, 2, 2)])
def test_bars_of_panels_are_named_at_the_ends_of_rows(number, rows, named):
    """Elsewhere a name would seem to belong to the axis of the next panel; four panels with bars form two rows."""
    axes = axes_of(2)
    panels = [Panel("", wave(axes, k)) for k in range(number)]
    figure = drawing.field_panels(panels, axes, None, Look("u", shared=False))
    assert figure.axes[0].get_gridspec().nrows == rows
    bars = [one.get_ylabel() for one in figure.axes[number:]]
    assert len(bars) == number and bars.count("u") == named and bars[-1] == "u"


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("dim", [2, 3])
def test_colours_reach_as_far_as_what_is_seen(dim, shared):
    """Nodes with broken bonds are dark, whatever their value: they do not affect the range, nor the arrows of the
    bar.
    """
    axes = axes_of(dim)
    field, broken = np.nan_to_num(wave(axes, 0)), np.zeros([axis.size for axis in axes])
    broken[:3] = 0.5
    seen = np.abs(field[broken == 0]).max()
    field[broken > 0] = -50 * seen
    draw = drawing.field_panels if dim == 2 else drawing.slice_panels

    def drawn(part):
        """Return the upper ends of the colours, and the arrows of the bars."""
        figure = draw(2 * [Panel("", field, broken=part)], axes, None, Look(shared=shared))
        bars = [panel._colorbar for panel in figure.axes if hasattr(panel, "_colorbar")]
        return {bar.vmax for bar in bars}, {bar.extend for bar in bars}

    assert drawn(broken) == ({seen}, {"neither"})
    assert drawn(0 * broken) == ({50 * seen}, {"neither"})
