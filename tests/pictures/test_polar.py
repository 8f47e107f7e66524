"""Polar plots: a panel for each frequency and plane, a line for each wave."""

import numpy as np
import pytest

from drawn import is_picture
from farhorizon.analysis.radiation import as_directions
from farhorizon.pictures.polar import polar_picture
from farhorizon.pictures.style import counted_in


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
