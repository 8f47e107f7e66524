"""Curves are drawn for awkward data, and can be told apart."""

import numpy as np
import pytest

from drawn import axes_of, is_picture, wave
from farhorizon.errors import InputError
from farhorizon.pictures import curves as drawing
from farhorizon.pictures import fields as fields_module
from farhorizon.pictures.panels import Panel


def test_neighbouring_curves_differ_in_colour_and_dashes(tmp_path, monkeypatch):
    """Curves that coincide, such as ours and that of the infinite medium, are both visible."""
    from matplotlib.axes import Axes

    lines = []
    monkeypatch.setattr(Axes, "legend", lambda *_a, **_k: None)
    original = Axes.plot
    monkeypatch.setattr(Axes, "plot", lambda *a, **k: lines.extend(drawn := original(*a, **k)) or drawn)
    axes = axes_of(1)
    fields_module.field_panels([Panel(f"{k}", wave(axes, k)) for k in range(4)], axes, tmp_path / "u.png")
    assert len({line.get_color() for line in lines}) == len({line.get_linestyle() for line in lines}) == 4


def test_error_history(tmp_path):
    times = np.linspace(0, 10, 50)
    curves = {
        "lattice-pml": (times, np.where(times < 2, 0, 1e-9 * times)),
        "exact": (times, np.zeros(50)),
        "sponge": (times, 10.0 ** (times - 12)),
        "explodes": (times, np.where(times < 9, 1e-3, np.inf)),
        "tiny": (times, np.full(50, 1e-300)),
    }
    drawing.error_history(curves, tmp_path / "e.png", "error", "title")
    drawing.error_history({"exact": curves["exact"]}, tmp_path / "zero.png", "error", "")
    drawing.error_history({"short": (times[:1], times[1:2])}, tmp_path / "one.png", "error", "")
    assert all(is_picture(tmp_path / name) for name in ("e.png", "zero.png", "one.png"))
    with pytest.raises(InputError, match="one curve or more"):
        drawing.error_history({}, tmp_path / "e.png", "", "")
    with pytest.raises(InputError, match="'a' do not match"):
        drawing.error_history({"a": (times, times[1:])}, tmp_path / "e.png", "", "")


@pytest.mark.parametrize("number", [1, 2, 4])
def test_curve_panels(tmp_path, number):
    """One, two or four panels; a panel with one curve has no legend."""
    x = np.linspace(0, 1, 20)
    panels = [
        (f"panel {n}", [("one", x, x), ("other", x, x**2), ("third", x, x**3)][: 3 - n % 3]) for n in range(number)
    ]
    drawing.curve_panels(panels, tmp_path / "c.png", xlabel="x", ylabel="y")
    assert is_picture(tmp_path / "c.png")


def test_values_between_gaps_are_points(tmp_path, monkeypatch):
    """A line that connects neighbouring values would not show them."""
    from matplotlib.axes import Axes

    markers, plotted = [], Axes.plot
    monkeypatch.setattr(Axes, "plot", lambda *a, **options: markers.append(options["marker"]) or plotted(*a, **options))
    x, gap = np.arange(4.0), np.array([1.0, np.nan, 2.0, np.nan])
    panels = [("panel", [("line", x, x), ("points", x, gap), ("broken line", x, np.array([1.0, 2.0, np.nan, 3.0]))])]
    drawing.curve_panels(panels, tmp_path / "c.png", xlabel="x", ylabel="y")
    assert markers == ["", "o", ""]


def test_few_values_are_points_without_chords(tmp_path, monkeypatch):
    """A chord between values far apart would lie beside the curve on which they lie."""
    from matplotlib.figure import Figure

    made, x = [], np.linspace(0, 1, 50)
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: made.append(figure))
    curves = [("exact", x, x**2), ("few", x[::9], x[::9] ** 2), ("fewer", x[::11], x[::11] ** 2)]
    drawing.curve_panels([("panel", curves)], tmp_path / "c.png", xlabel="x", ylabel="y", points=["few", "fewer"])
    styles = [(line.get_linestyle(), line.get_marker()) for line in made[0].axes[0].get_lines()]
    assert styles == [("-", ""), ("None", "o"), ("None", "x")]


def test_thin_curves_of_panels_all_have_dashes_of_their_own(tmp_path, monkeypatch):
    """In grey the colours cannot be told apart."""
    from matplotlib.figure import Figure

    made, x = [], np.linspace(0, 1, 20)
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: made.append(figure))
    curves = [(f"{k}", x, x + k) for k in range(8)]
    drawing.curve_panels([("panel", curves)], tmp_path / "c.png", xlabel="x", ylabel="y")
    dashes = [line._unscaled_dash_pattern for line in made[0].axes[0].get_lines()[1:]]
    assert len({str(one) for one in dashes}) == len(dashes) == 7


def test_panels_of_places_have_equal_axes(tmp_path, monkeypatch):
    """Both axes have the same scale, so that angles are not distorted."""
    from matplotlib.figure import Figure

    made, x = [], np.linspace(-10, 10, 20)
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: made.append(figure))
    panels = [("speed", [("one", x, x**2), ("other", x, x)]), ("place", [("one", x, x / 5), ("other", x, -x / 5)])]
    drawing.curve_panels(panels, tmp_path / "c.png", xlabel="x", ylabel="y", equal=[1])
    made[0].draw_without_rendering()
    (rise, *_), (along, *_) = (np.diff(axes.transData.transform([[0, 0], [1, 1]]), axis=0) for axes in made[0].axes)
    assert along[0] == pytest.approx(along[1], rel=0.01) and rise[0] > 2 * rise[1]


@pytest.mark.parametrize("panels", [[], [("empty", [])]])
def test_no_curves_are_refused(tmp_path, panels):
    for draw in (drawing.curve_panels, drawing.log_panels):
        with pytest.raises(InputError, match="each with a curve"):
            draw(panels, tmp_path / "c.png", xlabel="x", ylabel="y")


def test_log_panels(tmp_path, monkeypatch):
    """Histories with zeros and overflow; a convergence plot has two logarithmic axes, a line of its order, and the
    printed values.
    """
    from matplotlib.axes import Axes

    x = np.array([0.1, 0.2, 0.4])
    histories = [("one", x, x), ("zero", x, 0 * x), ("diverges", x, np.array([1, np.inf, np.nan]))]
    drawing.log_panels([("a", histories)], tmp_path / "a.png", xlabel="t", ylabel="e")
    assert is_picture(tmp_path / "a.png")
    drawn, legends = [], []
    plotted, legend = Axes.plot, Axes.legend
    monkeypatch.setattr(
        Axes, "plot", lambda axes, x, y, *args, **options: drawn.append((x, y)) or plotted(axes, x, y, *args, **options)
    )
    monkeypatch.setattr(
        Axes, "legend", lambda axes, *args, **options: legends.append(axes) or legend(axes, *args, **options)
    )
    curves = [("two", x, x**2), ("other", x, 3 * x**2)]
    drawing.log_panels(
        [("b", curves)], tmp_path / "b.png", xlabel="dt", ylabel="e", order=2, printed=[[1.1 * x**2, 3.1 * x**2]]
    )
    assert is_picture(tmp_path / "b.png")
    (axes,) = legends
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert axes.get_legend_handles_labels()[1] == ["two", "other", "as printed", "order 2"]
    np.testing.assert_allclose(np.diff(np.log(drawn[-1][1])), 2 * np.diff(np.log(drawn[-1][0])))


def test_reflection_that_is_rounding_leaves_a_gap(monkeypatch):
    """At normal incidence waves are not converted, which is not a curve down to -280 dB."""
    seen = []
    monkeypatch.setattr(drawing, "lines", lambda curves, *_, **__: seen.extend(curves))
    drawing.reflection_picture(np.array([0.0, 5.0, 10.0]), [("P to S", np.array([1e-14, 1e-4, 1e-2]))], "", "a.png")
    np.testing.assert_allclose(seen[0][2], [np.nan, -80.0, -40.0])


def test_waterfall(tmp_path):
    """Lines over time, with another curve behind the last."""
    x, times = np.linspace(0, 1, 51), np.linspace(0, 1, 6)
    lines = np.array([np.exp(-200 * (x - 0.3 - 0.4 * t) ** 2) for t in times])
    drawing.waterfall(x, times, lines, tmp_path / "w.png", xlabel="x", ylabel="u", backdrop=("ramp", x**2))
    assert (tmp_path / "w.png").stat().st_size > 10_000
    with pytest.raises(InputError, match="no directory"):
        drawing.waterfall(x, times, lines, tmp_path / "none" / "w.png", xlabel="x", ylabel="u", backdrop=("ramp", x**2))
