"""Pictures of the histories in a results file: energies, tips, power."""

import numpy as np
import pytest

from farhorizon.files.records import Recorded
from farhorizon.files.results import open_results
from farhorizon.files.results_writer import ResultsWriter
from farhorizon.pictures import histories
from farhorizon.pictures.result_pictures import plot_results
from farhorizon.pictures.views import View

TIMES = np.arange(100.0)


def drawn(monkeypatch, name):
    """Record the arguments of a function of `histories`."""
    seen = []
    monkeypatch.setattr(histories, name, lambda *given, **named: seen.append((given, named)))
    return seen


def recorded(path, *records, units=None):
    made = {"shape": (5, 5), "spacing": 1.0, "lower": (0.0, 0.0), "fields": ("u",), "dtype": "float64"}
    writer = ResultsWriter.create(path, **made, units=units)
    for one in records:
        writer.conclude(one)
    return open_results(path)


def test_tips_that_are_seen_for_a_moment_are_left_out_and_counted(tmp_path, monkeypatch):
    """Of seven tips two are always present, two for three records only, and three never: the latter five have no
    line, and no tip has a spectrum.
    """
    places = np.full((100, 7, 2), np.nan)
    places[:, :2], places[50:53, 2:4] = 1.0, 2.0
    advance = np.where(np.isnan(places[..., 0]), np.nan, TIMES[:, None])
    names = tuple(f"tip {k + 1}" for k in range(7))
    tips = Recorded("tips", np.arange(1.0, 8)[:, None], TIMES, {"position": places, "advance": advance}, labels=names)
    seen = drawn(monkeypatch, "lines")
    made = plot_results(recorded(tmp_path / "a.h5", tips, units={"length": "mm", "time": "us"}), tmp_path)
    assert [path.stem for path in made] == ["tips_position_x", "tips_position_y", "tips_advance"]
    for (curves, _, frame), _ in seen:
        assert [name for name, _, _ in curves] == ["tip 1", "tip 2"]
        assert frame.title == "without 2 seen for a moment" and frame.xlabel == "t (\N{MICRO SIGN}s)"
    assert [given[2].ylabel for given, _ in seen] == ["position $x$ (mm)", "position $y$ (mm)", "advance (mm)"]


def test_power_is_named_by_its_surface(tmp_path, monkeypatch):
    """It is drawn in time and over frequency, with units; files of earlier versions have only points."""
    surfaces = {"points": np.array([[2.5, 0.0], [0.0, 0.0]]), "times": TIMES, "data": {"power": np.ones((100, 2))}}
    spectra = {"frequencies": np.array([0.1, 0.2]), "spectra": {"energy": np.ones((2, 2))}}
    names = ("plane x = 2.5", "disc around (0, 0)")
    units = {"power": "W/m", "energy": "J/m", "time": "s"}
    new, old = (
        recorded(tmp_path / f"{k}.h5", Recorded("power", **surfaces, **spectra, labels=labels), units=units)
        for k, labels in enumerate((names, ()))
    )
    assert (new.recorded["power"].labels, old.recorded["power"].labels) == (names, ())
    (made, spectrum), seen = plot_results(new, tmp_path), drawn(monkeypatch, "lines")
    assert made.stat().st_size and spectrum.stat().st_size
    over = drawn(monkeypatch, "spectrum_picture")
    plot_results(new, tmp_path)
    ((curves, _, frame), _), *_ = seen
    assert tuple(name for name, _, _ in curves) == names and frame.ylabel == "power (W/m)"
    assert over[0][1] == {"label": "energy", "measured": "energy", "labels": names}
    assert [path.name for path in plot_results(old, tmp_path)] == ["power_power.png", "power_energy.png"]


def test_one_surface_stands_in_the_title(tmp_path, monkeypatch):
    """A single curve has no legend."""
    power = Recorded("power", np.zeros((1, 2)), TIMES, {"power": np.ones((100, 1))}, labels=("plane x = 2.5",))
    seen = drawn(monkeypatch, "lines")
    plot_results(recorded(tmp_path / "a.h5", power), tmp_path)
    assert seen[0][0][2].title == "plane x = 2.5"


def test_tips_of_no_crack_have_no_picture(tmp_path):
    nowhere = Recorded("tips", np.ones((1, 1)), TIMES, {"advance": np.full((100, 1), np.nan)}, labels=("tip 1",))
    assert plot_results(recorded(tmp_path / "a.h5", nowhere), tmp_path) == []


def test_patterns_have_units(tmp_path, monkeypatch):
    """In 2D a cross section is a length."""
    around = {"points": np.eye(2), "times": np.zeros(0), "data": {}, "frequencies": np.ones(1), "directions": True}
    seen = drawn(monkeypatch, "polar_picture")
    for name in ("cross_section", "intensity_P"):
        pattern = Recorded("pattern", **around, spectra={name: np.ones((1, 2))})
        units = {"length": "mm", "energy": "J/m", "time": "s"}
        plot_results(recorded(tmp_path / f"{name}.h5", pattern, units=units), tmp_path)
    assert [given[-1] for given, _ in seen] == [
        "scattering cross section per angle (mm)",
        "energy per frequency and angle (J/m s)",
    ]


def test_energies_and_balances_have_units(tmp_path, monkeypatch):
    options = {"accounts": ("kinetic", "work"), "units": {"energy": "J", "time": "s"}}
    shape = {"shape": (5,), "spacing": 1.0, "lower": (0.0,), "dtype": "float64"}
    writer = ResultsWriter.create(tmp_path / "a.h5", **shape, fields=("u",), **options)
    for k in range(3):
        writer.append(k, float(k), {"u": np.zeros(5)}, 1.0 + k / 1e9, {"kinetic": 1.0, "work": 0.0})
    seen = drawn(monkeypatch, "lines")
    plot_results(open_results(tmp_path / "a.h5"), tmp_path, View(quantities={"energy": "stored energy"}))
    energy, balance = (given[2] for given, _ in seen)
    assert energy.ylabel == "stored energy (J)" and balance.ylabel == "energy (J)"
    low, high = energy.limits
    assert low == 0 and high > 1  # rounding errors do not count as a change


def test_tensors_that_are_symmetric_are_drawn_once(tmp_path):
    """In 2D a stress has three components, a gradient four."""
    path = tmp_path / "a.h5"
    writer = ResultsWriter.create(
        path, shape=(5, 5), spacing=1.0, lower=(0.0, 0.0), fields=("u",), dtype="float64", probes=None
    )
    stress = np.random.default_rng(20261123).normal(size=(4, 1, 2, 2))
    data = {"stress": stress + stress.swapaxes(2, 3), "gradient": stress, "u": stress[..., 0]}
    writer.conclude(Recorded("line", np.zeros((1, 2)), np.arange(4.0), data))
    drawn = {one.stem for one in plot_results(open_results(path), tmp_path)}
    names = {f"stress_{one}" for one in ("xx", "xy", "yy")} | {f"gradient_{a}{b}" for a in "xy" for b in "xy"}
    assert drawn == {f"line_{name}" for name in names | {"u_x", "u_y"}}


@pytest.mark.parametrize(
    ("energy", "log"),
    [
        ([1, 0.5, 0.02], False),
        ([1, 0.5, 0.005], True),
        ([1, 0.5, 0], False),
        ([np.nan, 1, 0.005], True),
        ([1e-13, 1, 0.02], False),
        ([0, 1, 0.005], True),
    ],
)
def test_energy_scale(tmp_path, monkeypatch, energy, log):
    """Logarithmic if it falls by more than two decades after its largest value, however it rose."""
    shape = {"shape": (11,), "spacing": 1.0, "lower": (0.0,), "dtype": "float64"}
    writer = ResultsWriter.create(tmp_path / "a.h5", **shape, fields=("u", "v"))
    for k, value in enumerate(energy):
        writer.append(k, float(k), {name: np.zeros(11) for name in ("u", "v")}, value)
    seen = {}
    monkeypatch.setattr(histories, "lines", lambda _curves, path, frame: seen.update({path.name: frame.log}))
    plot_results(open_results(tmp_path / "a.h5"), tmp_path)
    assert seen == {"energy.png": log}


def test_energies_are_seen_down_to_a_millionth(tmp_path, monkeypatch):
    """The initial energy and the rounding errors at the end would fill the axis."""
    shape = {"shape": (11,), "spacing": 1.0, "lower": (0.0,), "dtype": "float64"}
    writer = ResultsWriter.create(tmp_path / "a.h5", **shape, fields=("u",))
    for k, value in enumerate([1e-15, 2.0, 1e-3, 1e-12]):
        writer.append(k, float(k), {"u": np.zeros(11)}, value)
    figures, draw = [], histories.lines
    monkeypatch.setattr(histories, "lines", lambda *given, **named: figures.append(draw(*given, **named)))
    plot_results(open_results(tmp_path / "a.h5"), tmp_path)
    (axes,) = figures[0].axes
    assert axes.get_yscale() == "log" and axes.get_ylim()[0] == pytest.approx(2e-6)
