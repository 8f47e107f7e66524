"""Traces as curves, wiggles, sections and spectra; patterns over directions."""

import numpy as np
import pytest

from drawn import is_picture
from farhorizon.analysis.radiation import as_directions
from farhorizon.pictures.style import counted_in
from farhorizon.pictures.traces import polar_picture, positions, spectrum_picture, trace_picture

TIMES = np.linspace(0.0, 20.0, 201)


def traces(points):
    """Return a pulse of 0.3 cycles per unit of time that passes with speed 1."""
    late = TIMES[:, None] - 6 - points[:, 0]
    return np.exp(-(late**2) / 4) * np.cos(2 * np.pi * 0.3 * late)


@pytest.mark.parametrize("count", [1, 3, 9, 60])
def test_pictures_of_few_and_many(tmp_path, count):
    """Curves and spectra for few receivers; wiggles, a section and spectra for many; the spectrum peaks at the
    pulse's frequency.
    """
    points = np.column_stack([np.linspace(0, 4, count), np.zeros(count)])
    figure = trace_picture(points, TIMES, traces(points), tmp_path / "u.png", label="u")
    assert is_picture(tmp_path / "u.png")
    axes = [one for one in figure.axes if one.get_label() != "<colorbar>"]
    assert len(axes) == (3 if count > 7 else 2)
    line = axes[-1].get_lines()[0]
    assert line.get_xdata()[np.argmax(line.get_ydata())] == pytest.approx(0.3, abs=0.05)
    assert line.get_xdata()[-1] < 1.5  # the empty part is not drawn
    if count > 7:
        wiggles = [one.get_xdata()[0] for one in axes[0].get_lines()]  # nothing has arrived yet
        np.testing.assert_allclose(wiggles, points[:: 1 if count < 42 else 2, 0], atol=0.02)
        assert axes[1].get_xlabel() == "x"
        assert axes[0].yaxis_inverted() and axes[1].yaxis_inverted()


def test_zeros_and_a_single_row(tmp_path):
    """Empty data give empty pictures."""
    points = np.zeros((9, 2))
    trace_picture(points, TIMES, np.zeros((201, 9)), tmp_path / "zero.png", label="u")
    trace_picture(points[:1], TIMES[:1], np.ones((1, 1)), tmp_path / "one.png", label="u")
    assert is_picture(tmp_path / "zero.png") and is_picture(tmp_path / "one.png")


def test_spectra_of_one_frequency_and_energies_with_signs():
    """One frequency is a marker instead of a line of zero length; energy that flows back is negative; the unit is
    given.
    """
    with counted_in({"frequency": "1/us"}):
        figure = spectrum_picture(np.zeros((1, 2)), np.array([0.2]), np.array([[-3.0]]), None, label="energy")
    (line,) = figure.axes[0].get_lines()
    assert line.get_marker() == "o" and line.get_ydata() == [-3.0]
    assert figure.axes[0].get_xlabel() == "frequency (1/µs)" and figure.axes[0].get_ylabel() == "energy per frequency"
    sums = np.array([[-3.0 + 4.0j], [1.0 + 0.0j]])
    (line,) = spectrum_picture(np.zeros((1, 2)), np.array([0.2, 0.3]), sums, None, label="u").axes[0].get_lines()
    np.testing.assert_array_equal(line.get_ydata(), [5.0, 1.0])


def test_a_legend_of_places_says_what_they_are():
    with counted_in({"length": "mm", "time": "us", "u": "mm"}):
        points = np.array([[1.0, 2.0], [3.0, 2.0]])
        figure = trace_picture(points, TIMES, traces(points), None, label="u (mm)", measured="u")
    first, second = figure.axes
    assert first.get_legend().get_title().get_text() == "(x, y) (mm)"
    assert second.get_ylabel() == "amplitude of the spectrum (mm \N{MICRO SIGN}s)"


def test_labels_stand_for_places_in_spectra():
    energy = np.ones((2, 1))
    with counted_in({"energy": "J", "time": "s"}):
        named = {"label": "energy", "measured": "energy", "labels": ("plane x = 2.5",)}
        (axes,) = spectrum_picture(np.zeros((1, 2)), np.array([0.2, 0.3]), energy, None, **named).axes
    assert axes.get_ylabel() == "energy per frequency (J s)"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["plane x = 2.5"]


def test_positions_along_a_line():
    """They are the coordinate along an axis, otherwise the distance, or numbers if the points do not lie on a line."""
    even = np.linspace(1.0, 3.0, 5)
    name, places = positions(np.column_stack([np.full(5, 2.0), even]))
    assert name == "y" and np.array_equal(places, even)
    name, places = positions(np.column_stack([3 * even, 4 * even]))
    assert name.startswith("distance") and places == pytest.approx(5 * (even - 1))
    for points in (np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]]), np.zeros((3, 2)), np.zeros((1, 2))):
        name, places = positions(points)
        assert name == "receiver" and places.tolist() == list(range(len(points)))


@pytest.mark.parametrize(("dim", "rows"), [(2, 1), (3, 3)])
def test_panels_of_frequencies_and_planes(tmp_path, dim, rows):
    """Lobes point in the directions of the largest levels; four of six frequencies are drawn; lines are closed."""
    directions, frequencies = as_directions(36, dim, "directions"), np.linspace(0.1, 0.6, 6)
    lobes = np.multiply.outer(frequencies, directions[:, 0] ** 2)
    figure = polar_picture(directions, frequencies, {"P": lobes, "S": 0.5 * lobes}, tmp_path / "a.png", "levels")
    assert is_picture(tmp_path / "a.png")
    assert len(figure.axes) == 4 * rows
    for panel in figure.axes:
        assert len(panel.get_lines()) == 2
    turn, level = figure.axes[3].get_lines()[0].get_data()
    assert len(turn) == 37 and turn[-1] == turn[0] and level[-1] == level[0]
    assert np.abs(np.cos(turn[np.argmax(level)])) == pytest.approx(1) and level.max() == pytest.approx(0.6)


def test_frequencies_have_their_unit():
    directions = as_directions(12, 2, "directions")
    with counted_in({"frequency": "1/us"}):
        figure = polar_picture(directions, np.array([0.5]), {"P": np.ones((1, 12))}, None)
    assert figure.axes[0].get_title() == "f = 0.5/µs"
