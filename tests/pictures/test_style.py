"""Common properties of all pictures."""

import subprocess
import sys

import numpy as np
import pytest

from drawn import axes_of, wave
from farhorizon.pictures import fields, style
from farhorizon.pictures.panels import Panel


def test_a_few_nodes_do_not_dim_the_others():
    """The colours are cut off below a spike at a few nodes, with an arrow on the bar, but not below a narrow pulse."""
    x, y = np.meshgrid(np.arange(40.0), np.arange(30.0), indexing="ij")
    wave = np.sin(x / 5) * np.cos(y / 4)
    spiked = wave.copy()
    spiked[[3, 30, 31], [5, 20, 21]] = 7.0
    scale = style.scale_of([spiked], None, None, usual=True)
    assert 0.95 < scale["vmax"] <= 1.0 and scale["vmin"] == -scale["vmax"]
    assert style.extent_beyond([spiked], None, scale) == "max"
    assert style.scale_of([spiked], None, None)["vmax"] == 7.0
    assert style.scale_of([spiked], None, "magma_r", usual=True)["vmax"] == 7.0
    pulse = np.exp(-((x - 20) ** 2 + (y - 15) ** 2) / 8)  # two nodes wide
    scale = style.scale_of([pulse], None, None, usual=True)
    assert scale["vmax"] == 1.0 and style.extent_beyond([pulse], None, scale) == "neither"


def test_color_range():
    """Diverging and symmetric for both signs, from zero for one sign, tight for small variations of a large value."""
    assert style.color_range([np.array([-1.0, 3.0])]) == {"cmap": "RdBu_r", "vmin": -3, "vmax": 3}
    assert style.color_range([np.array([0.1, np.nan]), np.array([3.0])]) == {"cmap": "viridis", "vmin": 0, "vmax": 3}
    assert style.color_range([np.array([-1e-6, 1.0])]) == {"cmap": "viridis", "vmin": 0, "vmax": 1}
    assert style.color_range([np.array([300.0, 310.0])]) == {"cmap": "viridis", "vmin": 300, "vmax": 310}


def test_one_color_map_in_all_panels():
    """With their own scales, panels of a wave keep its diverging map, even if a field has only one sign or is zero."""
    assert style.color_range([np.array([0.0, 3.0])], signed=True) == {"cmap": "RdBu_r", "vmin": -3, "vmax": 3}
    assert style.color_range([np.zeros(2)], signed=True) == {"cmap": "RdBu_r", "vmin": -1, "vmax": 1}


def test_matplotlib_and_xarray_are_imported_late():
    code = (
        "import sys, farhorizon.pictures.result_pictures, farhorizon.files.results; "
        "sys.exit('matplotlib' in sys.modules or 'xarray' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_pictures_leave_matplotlib_as_it_was(tmp_path):
    import matplotlib

    before = dict(matplotlib.rcParams)
    fields.field_panels([Panel("", wave(axes_of(2), 0))], axes_of(2), tmp_path / "u.png")
    assert dict(matplotlib.rcParams) == before


def test_a_given_range_is_about_zero_where_it_has_both_signs():
    """Equal magnitudes are equally dark, as in a symmetric range; the bar ends at the limits."""
    from matplotlib import colormaps

    assert style.scale_of([np.ones(2)], (-3.0, 3.0), None)["cmap"] == style.DIVERGING
    for limits in ((-1.0, 3.0), (-3.0, 1.0)):
        both = style.scale_of([np.ones(2)], limits, None)
        assert (both["norm"].vmin, both["norm"].vmax) == limits
        values = np.linspace(*limits, 30)
        symmetric = colormaps[style.DIVERGING](0.5 + values / 6)
        np.testing.assert_allclose(both["cmap"](both["norm"](values)), symmetric, atol=0.02)
    one = style.scale_of([np.ones(2)], (1.0, 3.0), None)
    assert one["cmap"] == style.SEQUENTIAL and one["norm"](2.0) == 0.5
    ends = [style.extent_beyond([np.array([low, np.nan, high])], (0.0, 1.0)) for low in (-1, 0) for high in (1, 2)]
    assert ends == ["min", "both", "neither", "max"] and style.extent_beyond([np.ones(1)], None) == "neither"


@pytest.mark.parametrize(
    ("time", "text"),
    [
        (0.0, "0"),
        (47.158, "47.16"),
        (9999.0, "9999"),
        (2.592e6, r"$2.592 \times 10^{6}$"),
        (1e-6, r"$1 \times 10^{-6}$"),
    ],
)
def test_times_are_round(time, text):
    assert style.time_text(time) == text


def test_maps_are_readable_by_the_colour_blind():
    """Lightness alone orders the values, on either side of the middle in the diverging map."""
    from matplotlib import colormaps

    def lightness(name):
        red, green, blue = colormaps[name](np.linspace(0, 1, 33))[:, :3].T
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue

    for name in (style.SEQUENTIAL, style.DAMAGE):
        steps = np.diff(lightness(name))
        assert (steps > 0).all() or (steps < 0).all()
    half = lightness(style.DIVERGING)
    assert (np.diff(half[:17]) > 0).all() and (np.diff(half[16:]) < 0).all()


def test_figures_show_themselves_in_notebooks():
    with style.figure_at(None, (1.0, 1.0)) as figure:
        figure.add_subplot().plot([0, 1])
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_pictures_have_no_empty_edges(tmp_path):
    """They have none however large the layout makes its figure."""
    from matplotlib.image import imread

    with style.figure_at(tmp_path / "a.png", (4.0, 6.0), "compressed") as figure:
        figure.add_subplot().imshow(np.eye(4))
    drawn = np.argwhere(imread(tmp_path / "a.png")[..., :3].min(2) < 0.5)
    height, width = imread(tmp_path / "a.png").shape[:2]
    empty = [*drawn.min(0), height - 1 - drawn[:, 0].max(), width - 1 - drawn[:, 1].max()]
    assert max(empty) <= 15 and height < 1.2 * width


def test_units_of_products_are_named_where_all_are_known():
    with style.counted_in({"u": "mm", "time": "us"}):
        assert style.with_unit("a", "u", "time") == "a (mm \N{MICRO SIGN}s)"
        assert style.with_unit("a", "v", "time") == "a"
    with style.counted_in({"K_I": "GPa mm^(1/2)"}):
        assert style.with_unit("a", "K_I") == "a (GPa \N{SQUARE ROOT}mm)"


def test_degrees_have_their_sign():
    with style.counted_in({"u": "degC"}):
        assert style.with_unit("temperature", "u") == "temperature (\N{DEGREE SIGN}C)"
