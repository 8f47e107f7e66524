"""Deformed lattices: cells that stay connected where the lattice is whole, and the factor of the displacements."""

import numpy as np

from farhorizon.pictures.deformed import chosen_factor, deformed_cells, deformed_panels
from farhorizon.pictures.panels import Look, Panel

AXES = [0.5 * np.arange(7), 0.5 * np.arange(5)]
AT = np.stack(np.meshgrid(*AXES, indexing="ij"))


def shared_edges(cells):
    """Return whether each cell begins where the previous one along x ends."""
    return np.isclose(cells[:-1, :, [1, 2]], cells[1:, :, [0, 3]]).all((2, 3))


def test_cells_of_a_whole_lattice_have_their_corners_in_common():
    """Under an affine map inner corners are mapped by it: there are no gaps between cells."""
    slope = np.array([[0.1, 0.2], [-0.05, 0.15]])
    cells = deformed_cells(np.tensordot(slope, AT, 1), AXES)
    assert shared_edges(cells).all()
    corner = np.array([AXES[0][2] + 0.25, AXES[1][2] + 0.25])
    np.testing.assert_allclose(cells[2, 2, 2], corner + slope @ corner)
    np.testing.assert_allclose(deformed_cells(np.zeros(AT.shape), AXES).mean(2), np.moveaxis(AT, 0, -1))


def test_a_crack_opens_between_cells():
    """Cells that have moved apart by more than half a spacing keep their own edges; so do those without a neighbour."""
    moves = np.zeros(AT.shape)
    moves[0, 4:] = 0.4
    cells = deformed_cells(moves, AXES)
    assert (shared_edges(cells) == (np.arange(6) != 3)[:, None]).all()
    np.testing.assert_allclose(cells[4, :, [0, 3], 0] - cells[3, :, [1, 2], 0], 0.4)
    moves[:, 0, 0] = np.nan
    assert np.isfinite(deformed_cells(moves, AXES)[1:]).all()


def test_no_seams_between_cells_and_a_label_at_the_colours():
    figure = deformed_panels([Panel("t = 1", AT[0], moves=0.1 * AT)], AXES, None, Look("|u| (mm)"), factor=2.0)
    panel, bar = figure.axes
    (cells,) = panel.collections
    assert not cells.get_antialiased().any() and bar.get_ylabel() == "|u| (mm)"
    assert figure.get_suptitle() == "displacements times 2"


def test_the_factor_is_round_and_shows_the_largest_displacement():
    rng = np.random.default_rng(5)
    for _ in range(50):
        size, length = 10.0 ** rng.uniform(-9, 9, 2)
        u = size * rng.normal(size=(2, 4, 4))
        factor = chosen_factor([u], length)
        top = factor * np.hypot(*u).max()
        assert 0.0199 * length <= top <= 0.0501 * length  # steps of 2 and 2.5 below a twentieth
        assert f"{factor:.0e}"[0] in "125"
    assert chosen_factor([np.zeros((2, 3, 3))], 1.0) == 1.0
