"""Text in the pictures of validations and papers, drawn from made-up results: no names of program variables."""

from types import SimpleNamespace

import numpy as np
import pytest

from farhorizon.medium.kernel import Kernel
from farhorizon.models import Elastic
from farhorizon.papers import shojaei2020_corrosion, wildman2012
from farhorizon.pictures import curves, fields, fronts
from farhorizon.validation import branching, crack_impact, stress_intensity, surface_motion

LINE = np.linspace(0.0, 10.0, 40)


@pytest.fixture
def panels(monkeypatch):
    """Arguments of the pictures of curves, which are drawn as well."""
    seen, draw = [], curves.curve_panels

    def drawn(given, path, **named):
        seen.append((given, named))
        draw(given, path, **named)

    monkeypatch.setattr(curves, "curve_panels", drawn)
    return seen


def is_formula(text):
    return text.count("$") == 2 and "_I" not in text


def test_intensities_of_an_impact(tmp_path, monkeypatch, panels):
    found = SimpleNamespace(times=LINE, data={mode: LINE[:, None] for mode in ("K_I", "K_II")})
    monkeypatch.setattr(crack_impact, "hit", lambda _spacing: found)
    monkeypatch.setattr(crack_impact, "intensities", lambda times: np.array([times, times]) + 1)
    crack_impact.kalthoff(tmp_path)
    ((given, named),) = panels
    assert [title for title, _ in given] == [rf"stress intensity $K_{{\mathrm{{{mode}}}}}$" for mode in ("I", "II")]
    assert is_formula(named["xlabel"]) and is_formula(named["ylabel"])


def test_the_surface_above_a_blast(tmp_path, monkeypatch, panels):
    still = np.ones((len(surface_motion.PLACES), 2, LINE.size))
    monkeypatch.setattr(surface_motion, "run_blast", lambda _spacing: (LINE, still))
    monkeypatch.setattr(surface_motion, "buried_blast", lambda *_: 2 * still[0])
    surface_motion.garvin(tmp_path)
    ((given, named),) = panels
    assert all(map(is_formula, (named["xlabel"], *(title for title, _ in given))))


def test_intensities_of_mode_one(tmp_path, monkeypatch, panels):
    run = SimpleNamespace(run=lambda *_, **__: None, time=1.0)
    monkeypatch.setattr(stress_intensity, "opened", lambda *_: (run, 1.0))
    for name in ("pulled_intensity", "intensity"):
        monkeypatch.setattr(stress_intensity, name, lambda *_: 1.0)
    stress_intensity.mode_one(tmp_path)
    assert panels[0][1]["ylabel"] == r"$K_{\mathrm{I}}$"


def test_paths_of_branches_have_equal_axes(tmp_path, monkeypatch, panels):
    paths = [np.array([[-2.0, 0.0], [2.0, 0.0]]), np.array([[2.0, 0.0], [4.0, 1.0]])]
    now = SimpleNamespace(tips=np.array([[4.0, 1.0], [4.0, -1.0]]), branches=np.array([[2.0, 0.0]]), paths=paths)
    data = {"position": np.ones((LINE.size, 3, 2)), "speed": np.ones((LINE.size, 1))}
    data["position"][:3, 2] = np.nan
    model = Elastic(Kernel(1.0, exponent=1), young=1.0)
    tips = SimpleNamespace(times=LINE, data=data, now=now)
    monkeypatch.setattr(branching, "running", lambda *_: (SimpleNamespace(model=model), tips))
    branching.branching(tmp_path)
    ((given, named),) = panels
    assert [given[number][0] for number in named["equal"]] == ["cracks at t = 36"]


def test_damage_is_drawn_as_elsewhere(tmp_path, monkeypatch):
    """It is in the colours of damage, on axes with units."""
    damage = np.linspace(0.0, 0.5, 81 * 41).reshape(81, 41)
    axes = [0.0005 * np.arange(-40.0, 41), 0.0005 * np.arange(-40.0, 1)]
    balance = dict.fromkeys(("work", "kinetic", "strain", "lost", "drag", "broken"), 1.0)
    sim = SimpleNamespace(fields={"damage": damage}, lattice=SimpleNamespace(axes=axes), broken_bonds=1)
    sim.balance = lambda: balance
    monkeypatch.setattr(wildman2012, "indent", lambda *_: (sim, 0 * damage))
    figures, draw = [], fields.field_panels
    monkeypatch.setattr(fields, "field_panels", lambda *given, **named: figures.append(draw(*given, **named)))
    wildman2012.figure_7(tmp_path)
    for figure in figures:
        panel, bar = figure.axes
        assert (panel.get_xlabel(), panel.get_ylabel(), bar.get_ylabel()) == ("x (mm)", "y (mm)", "damage")
        assert panel.images[0].get_cmap().name == "magma_r" and "mm" not in panel.get_title()
    assert len(figures) == 2


def test_closures_are_called_by_words(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(curves, "error_history", lambda given, *_, **__: seen.extend(given))
    for name in ("field_panels", "gradient_panels"):
        monkeypatch.setattr(fields, name, lambda panels, *_, **__: seen.extend(panel.title for panel in panels))
    monkeypatch.setattr(fronts, "front", lambda *_, **__: None)
    u, names = np.ones((3, 3)), ("LatticePML", "infinite medium")
    runs = {"LatticePML": SimpleNamespace(lattice=SimpleNamespace(axes=[np.arange(3.0)] * 2))}
    course = SimpleNamespace(
        fields={name: [u] for name in names},
        initial=u,
        dissolved=u,
        times=[1.0],
        energy=[1.0],
        errors={"LatticePML": [0.1]},
        energies={"LatticePML": [0.9]},
    )
    shojaei2020_corrosion._pictures(tmp_path, "a", course, runs, (1.0,))
    assert {"lattice PML", "lattice PML, t = 1", "infinite medium"} <= set(seen)
    assert not any("LatticePML" in name for name in seen)
