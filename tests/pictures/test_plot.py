"""Pictures: they are written for every dimension and for awkward data, and show what they should."""

import subprocess
import sys

import numpy as np
import pytest

from farhorizon.errors import InputError
from farhorizon.files.results import ResultsWriter, open_results
from farhorizon.pictures import plot

PNG = b"\x89PNG\r\n\x1a\n"


def is_picture(path):
    """Whether a file is a PNG with more than one colour."""
    from matplotlib.image import imread

    return path.read_bytes().startswith(PNG) and np.ptp(imread(path)) > 0


def axes_of(dim, nodes=21):
    return [np.linspace(-1, 1 + axis, nodes + 5 * axis) for axis in range(dim)]


def wave(axes, time):
    radius = np.sqrt(sum(x**2 for x in np.meshgrid(*axes, indexing="ij")))
    return np.where(radius < 1.9, np.cos(9 * radius - time) * np.exp(-time), np.nan)


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("number", [1, 2, 5])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_field_panels(tmp_path, dim, number, shared):
    axes = axes_of(dim)
    fields = [(f"t = {k}", wave(axes, k)) for k in range(number)]
    crack = np.zeros((2, dim))
    crack[1, 0] = 0.5
    plot.field_panels(fields, axes, tmp_path / "u.png", shared_scale=shared, cracks=[crack])
    assert is_picture(tmp_path / "u.png")


@pytest.mark.parametrize("dim", [2, 3])
def test_gradient_panels(tmp_path, dim):
    """Of a field that is constant somewhere, outside a window and beside a solid."""
    axes = axes_of(dim)
    fields = [("a", wave(axes, 0.0)), ("b", np.zeros([a.size for a in axes]))]
    plot.gradient_panels(fields, axes, tmp_path / "u.png", solids=[u > 0.9 for _, u in fields])
    assert is_picture(tmp_path / "u.png")


@pytest.mark.parametrize("value", [0.0, 3.0, -2.0, np.nan])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_constant_and_empty_fields(tmp_path, dim, value):
    axes = axes_of(dim)
    plot.field_panels([("", np.full([a.size for a in axes], value))], axes, tmp_path / "u.png")
    assert is_picture(tmp_path / "u.png")


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (300, 4), (4, 300)])
def test_long_and_thin_lattices(tmp_path, shape):
    axes = [0.5 * np.arange(n) for n in shape]
    field = np.arange(float(np.prod(shape))).reshape(shape)
    plot.field_panels([("a", field), ("b", field)], axes, tmp_path / "u.png")
    assert is_picture(tmp_path / "u.png")


def test_color_range():
    """Diverging and symmetric for both signs, from zero for one sign, tight for a small variation of a large value."""
    assert plot._color_range([np.array([-1.0, 3.0])]) == {"cmap": "RdBu_r", "vmin": -3, "vmax": 3}
    assert plot._color_range([np.array([0.1, np.nan]), np.array([3.0])]) == {"cmap": "viridis", "vmin": 0, "vmax": 3}
    assert plot._color_range([np.array([-1e-6, 1.0])]) == {"cmap": "viridis", "vmin": 0, "vmax": 1}
    assert plot._color_range([np.array([300.0, 310.0])]) == {"cmap": "viridis", "vmin": 300, "vmax": 310}


def test_one_color_map_in_all_panels():
    """With scales of their own, panels of a wave keep its diverging map, also where the field has one sign only, or is
    zero.
    """
    assert plot._color_range([np.array([0.0, 3.0])], signed=True) == {"cmap": "RdBu_r", "vmin": -3, "vmax": 3}
    assert plot._color_range([np.zeros(2)], signed=True) == {"cmap": "RdBu_r", "vmin": -1, "vmax": 1}


def test_panels_share_a_scale_unless_some_would_be_empty(tmp_path, monkeypatch):
    """A wave that leaves is still seen; a field that stays alike, or starts from nothing, is compared on one scale."""
    seen = []
    monkeypatch.setattr(plot, "field_panels", lambda _fields, *_args, **names: seen.append(names["shared_scale"]))
    for run, amplitudes in enumerate(([1.0, 0.5, 0.3], [1.0, 0.01, 0.001], [0.0, 1.0, 0.5], [0.0, 0.0, 0.0])):
        path = tmp_path / f"{run}.h5"
        writer = ResultsWriter.create(
            path, dim=1, shape=(5,), spacing=1.0, lower=(0.0,), fields=("u",), dtype="float64"
        )
        for k, amplitude in enumerate(amplitudes):
            writer.append(k, float(k), {"u": np.full(5, amplitude)})
        plot.plot_results(open_results(path), tmp_path)
    assert seen == [True, False, True, True]


def test_neighbouring_curves_differ_in_colour_and_dashes(tmp_path, monkeypatch):
    """Curves that coincide, as ours and the infinite medium, are both seen."""
    from matplotlib.axes import Axes

    lines = []
    monkeypatch.setattr(Axes, "legend", lambda *_a, **_k: None)
    original = Axes.plot
    monkeypatch.setattr(Axes, "plot", lambda *a, **k: lines.extend(drawn := original(*a, **k)) or drawn)
    axes = axes_of(1)
    plot.field_panels([(f"{k}", wave(axes, k)) for k in range(4)], axes, tmp_path / "u.png")
    assert len({line.get_color() for line in lines}) == len({line.get_linestyle() for line in lines}) == 4


def test_field_panels_refuses(tmp_path):
    axes = axes_of(2)
    field = wave(axes, 0)
    with pytest.raises(InputError, match="one field or more"):
        plot.field_panels([], axes, tmp_path / "u.png")
    with pytest.raises(InputError, match="field 'a' does not match"):
        plot.field_panels([("a", field.T)], axes, tmp_path / "u.png")
    with pytest.raises(InputError, match=r"limit: \(n, 2\)"):
        plot.field_panels([("a", field)], axes, tmp_path / "u.png", cracks=[np.zeros((2, 3))])
    with pytest.raises(InputError, match="no directory"):
        plot.field_panels([("a", field)], axes, tmp_path / "none" / "u.png")
    assert list(tmp_path.iterdir()) == []


def write_results(path, dim, outputs=6, observed=True):
    axes = axes_of(dim, 11)
    shape = tuple(a.size for a in axes)
    probes = np.zeros((2, dim)) if observed else None
    writer = ResultsWriter.create(
        path, dim=dim, shape=shape, spacing=0.2, lower=(-1.0,) * dim, fields=("u", "v"), dtype="float64", probes=probes
    )
    for k in range(outputs):
        data = {"u": wave(axes, k), "v": np.abs(wave(axes, k))}
        writer.append(k, float(k), data, np.exp(-2.0 * k) if observed else None)
        if observed:
            writer.append_probes(k + np.array([0.0, 0.5]), np.array([[k, -k], [k, 0.0]]))
    return open_results(path)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_plot_results(tmp_path, dim):
    results = write_results(tmp_path / "a.h5", dim)
    paths = plot.plot_results(results, tmp_path / "new" / "pictures")
    assert [p.name for p in paths] == ["u.png", "v.png", "probes.png", "energy.png"]
    assert all(is_picture(p) for p in paths)


@pytest.mark.parametrize(("outputs", "expected"), [(0, []), (1, ["u.png", "v.png"])])
def test_plot_few_outputs(tmp_path, outputs, expected):
    results = write_results(tmp_path / "a.h5", 2, outputs, observed=False)
    assert [p.name for p in plot.plot_results(results, tmp_path)] == expected
    assert [p.name for p in plot.plot_results(results, tmp_path, times=[0.0])] == expected


@pytest.mark.parametrize(
    ("times", "titles"), [(None, ["t = 0", "t = 2", "t = 3", "t = 5"]), ([1.2, 0.9, 99.0], ["t = 1", "t = 5"])]
)
def test_chosen_times(tmp_path, monkeypatch, times, titles):
    """Up to four evenly spaced outputs, or the nearest to the times asked for, each once."""
    results = write_results(tmp_path / "a.h5", 1)
    seen = []
    monkeypatch.setattr(
        plot, "field_panels", lambda fields, *_args, **_names: seen.append([title for title, _ in fields])
    )
    plot.plot_results(results, tmp_path, times=times)
    assert seen == [titles, titles]
    with pytest.raises(InputError, match="finite"):
        plot.plot_results(results, tmp_path, times=[np.nan])


@pytest.mark.parametrize(
    ("energy", "log"),
    [([1, 0.5, 0.02], False), ([1, 0.5, 0.005], True), ([1, 0.5, 0], False), ([np.nan, 1, 0.005], True)],
)
def test_energy_scale(tmp_path, monkeypatch, energy, log):
    """Logarithmic if positive and over more than two decades."""
    results = write_results(tmp_path / "a.h5", 1, 0)
    writer = ResultsWriter(results.path)
    for k, value in enumerate(energy):
        writer.append(k, float(k), {name: np.zeros(11) for name in ("u", "v")}, value)
    seen = {}
    monkeypatch.setattr(plot, "field_panels", lambda *_args, **_names: None)
    monkeypatch.setattr(plot, "_lines", lambda _curves, path, **names: seen.update({path.name: names["log"]}))
    plot.plot_results(results, tmp_path)
    assert seen == {"energy.png": log}


def test_error_history(tmp_path):
    times = np.linspace(0, 10, 50)
    curves = {
        "lattice-pml": (times, np.where(times < 2, 0, 1e-9 * times)),
        "exact": (times, np.zeros(50)),
        "sponge": (times, 10.0 ** (times - 12)),
        "explodes": (times, np.where(times < 9, 1e-3, np.inf)),
        "tiny": (times, np.full(50, 1e-300)),
    }
    plot.error_history(curves, tmp_path / "e.png", "error", "title")
    plot.error_history({"exact": curves["exact"]}, tmp_path / "zero.png", "error", "")
    plot.error_history({"short": (times[:1], times[1:2])}, tmp_path / "one.png", "error", "")
    assert all(is_picture(tmp_path / name) for name in ("e.png", "zero.png", "one.png"))
    with pytest.raises(InputError, match="one curve or more"):
        plot.error_history({}, tmp_path / "e.png", "", "")
    with pytest.raises(InputError, match="'a' do not match"):
        plot.error_history({"a": (times, times[1:])}, tmp_path / "e.png", "", "")


def test_matplotlib_and_xarray_are_imported_late():
    code = (
        "import sys, farhorizon.pictures.plot, farhorizon.files.results; sys.exit('matplotlib' in sys.modules or "
        "'xarray' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_pictures_leave_matplotlib_as_it_was(tmp_path):
    import matplotlib

    before = dict(matplotlib.rcParams)
    plot.field_panels([("", wave(axes_of(2), 0))], axes_of(2), tmp_path / "u.png")
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("number", [1, 2, 4])
def test_curve_panels(tmp_path, number):
    """One, two or four panels; a panel of one curve has no legend."""
    x = np.linspace(0, 1, 20)
    panels = [
        (f"panel {n}", [("one", x, x), ("other", x, x**2), ("third", x, x**3)][: 3 - n % 3]) for n in range(number)
    ]
    plot.curve_panels(panels, tmp_path / "c.png", xlabel="x", ylabel="y")
    assert is_picture(tmp_path / "c.png")


@pytest.mark.parametrize("panels", [[], [("empty", [])]])
def test_no_curves_are_refused(tmp_path, panels):
    for draw in (plot.curve_panels, plot.log_panels):
        with pytest.raises(InputError, match="each with a curve"):
            draw(panels, tmp_path / "c.png", xlabel="x", ylabel="y")


def test_log_panels(tmp_path, monkeypatch):
    """Histories with zeros and overflow; a convergence plot has two logarithmic axes, a line of its order, and the
    printed values.
    """
    from matplotlib.axes import Axes

    x = np.array([0.1, 0.2, 0.4])
    histories = [("one", x, x), ("zero", x, 0 * x), ("diverges", x, np.array([1, np.inf, np.nan]))]
    plot.log_panels([("a", histories)], tmp_path / "a.png", xlabel="t", ylabel="e")
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
    plot.log_panels(
        [("b", curves)], tmp_path / "b.png", xlabel="dt", ylabel="e", order=2, printed=[[1.1 * x**2, 3.1 * x**2]]
    )
    assert is_picture(tmp_path / "b.png")
    (axes,) = legends
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert axes.get_legend_handles_labels()[1] == ["two", "other", "as printed", "order 2"]
    np.testing.assert_allclose(np.diff(np.log(drawn[-1][1])), 2 * np.diff(np.log(drawn[-1][0])))


def test_field_table(tmp_path, monkeypatch):
    """One scale a row, up to five times the first column; a run that ended early leaves a panel blank."""
    from matplotlib.axes import Axes

    axes = axes_of(2)
    limits, image = [], Axes.imshow
    monkeypatch.setattr(
        Axes, "imshow", lambda axes, *args, **options: limits.append(options["vmax"]) or image(axes, *args, **options)
    )
    first = [wave(axes, t) for t in (0.0, 1.0)]
    columns = [("reference", first), ("twice", [2 * u for u in first]), ("ended", [100 * first[0]])]
    plot.field_table(
        ["t = 0", "t = 1"], columns, axes, tmp_path / "u.png", cracks=[np.array([[-0.5, 0.0], [0.5, 0.0]])]
    )
    assert is_picture(tmp_path / "u.png")
    peaks = [np.nanmax(np.abs(u)) for u in first]
    np.testing.assert_allclose(limits, [5 * peaks[0]] * 3 + [2 * peaks[1]] * 2)
    with pytest.raises(InputError, match="first column that is complete"):
        plot.field_table(["t = 0", "t = 1"], columns[::-1], axes, tmp_path / "u.png")


@pytest.mark.parametrize("dim", [2, 3])
def test_front(tmp_path, dim):
    """Times of dissolution, metal that is left, a window and a film; a field without metal is drawn too."""
    axes = axes_of(dim)
    radius = np.sqrt(sum(x**2 for x in np.meshgrid(*axes, indexing="ij")))
    dissolved = np.where(radius > 0.8, 0.0, np.where(radius < 0.3, np.nan, 1 - radius))
    outside = radius > 1.2
    film = [np.array([[-0.5] * dim, [0.5] * dim])]
    plot.front(np.where(outside, np.nan, dissolved), axes, tmp_path / "a.png", outside=outside, cracks=film)
    plot.front(np.zeros(dissolved.shape), axes, tmp_path / "b.png")
    assert is_picture(tmp_path / "a.png") and is_picture(tmp_path / "b.png")
    with pytest.raises(InputError, match="two or three axes"):
        plot.front(dissolved, axes[:1], tmp_path / "c.png")


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_outline_of_metal(tmp_path, dim):
    axes = axes_of(dim)
    field = wave(axes, 0)
    for name, solids in (("a", []), ("b", [np.abs(field) > 0.5])):
        plot.field_panels([("", field)], axes, tmp_path / f"{name}.png", solids=solids)
    same = (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert same == (dim == 1)


def test_waterfall(tmp_path):
    """Lines over time, with something behind the last."""
    x, times = np.linspace(0, 1, 51), np.linspace(0, 1, 6)
    lines = np.array([np.exp(-200 * (x - 0.3 - 0.4 * t) ** 2) for t in times])
    plot.waterfall(x, times, lines, tmp_path / "w.png", xlabel="x", ylabel="u", backdrop=("ramp", x**2))
    assert (tmp_path / "w.png").stat().st_size > 10_000
    with pytest.raises(InputError, match="no directory"):
        plot.waterfall(x, times, lines, tmp_path / "none" / "w.png", xlabel="x", ylabel="u", backdrop=("ramp", x**2))
