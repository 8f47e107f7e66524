"""Tips, branches and lengths of known cracks, from the bonds that they cut."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.analysis.fracture.crack_paths import find_cracks, followed, saturated_damage
from farhorizon.inputs.cracks import cut_bonds

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))
LOWER, SHAPE = np.array([-25.0, -25.0]), (51, 51)


def damaged(lines, reach, spacing=1.0):
    """The cracks found where polylines cut the bonds of a kernel."""
    stencil = fh.Stencil.from_kernel(fh.Kernel(float(reach), exponent=1), 1.0, 2)
    lost = np.zeros((*SHAPE, len(stencil.offsets)), bool)
    for points in lines:
        nodes, bonds = cut_bonds(fh.Polyline(points), LOWER, 1.0, SHAPE, stencil.offsets)
        lost[nodes[:, 0], nodes[:, 1], bonds] = True
    half = saturated_damage(stencil.offsets) / 2
    return find_cracks(lost.mean(-1), spacing * LOWER, spacing, half, spacing * reach)


@pytest.mark.parametrize("reach", [2, 3, 4])
def test_straight_cracks_in_any_direction(reach):
    """Tips are found to within about half a horizon, with at most two exceptions, and always to within a horizon; the
    length to half a horizon and 2 %.
    """
    print(f"seed {SEED}")
    rng, missed = np.random.default_rng(SEED), []
    for turn in (0.0, np.pi / 4, *rng.uniform(0, np.pi, 50)):
        way, middle = np.array([np.cos(turn), np.sin(turn)]), rng.uniform(-0.5, 0.5, 2)
        ends = np.array([middle - 12.3 * way, middle + 14.1 * way])
        found = damaged([ends], reach)
        assert len(found.tips) == 2 and not len(found.branches)
        for end, sign in zip(ends, (-1, 1), strict=True):
            nearest = np.linalg.norm(found.tips - end, axis=1).argmin()
            missed.append(np.linalg.norm(found.tips[nearest] - end))
            assert sign * way @ found.ahead[nearest] > 0.95
        assert abs(found.length - 26.4) < 0.02 * 26.4 + 0.5 * reach
    missed = np.array(missed)
    assert missed.max() < reach
    assert np.count_nonzero(missed > 0.5 + reach / 4) <= 2


def test_a_branch_and_an_end_beyond_the_edge():
    found = damaged([[(-40.0, 0.2), (0.0, 0.2)], [(0.0, 0.2), (15.0, 9.0)], [(0.0, 0.2), (15.0, -8.0)]], 3)
    order = np.argsort(found.tips[:, 1])
    assert np.abs(found.tips[order] - [[15.0, -8.0], [15.0, 9.0]]).max() < 1.5
    assert found.branches.shape == (1, 2) and np.linalg.norm(found.branches - [0.0, 0.2]) < 2 * 3
    assert len(found.paths) == 3


def test_lengths_are_in_the_units_of_the_lattice():
    line = [[(-10.0, 0.5), (10.0, 0.5)]]
    metres, millimetres = damaged(line, 3), damaged(line, 3, spacing=1e3)
    assert millimetres.length == pytest.approx(1e3 * metres.length)
    assert millimetres.tips == pytest.approx(1e3 * metres.tips)


def test_nothing_is_found_where_nothing_is_broken():
    found = find_cracks(np.zeros((9, 9)), np.zeros(2), 1.0, 0.2, 2.0)
    assert not len(found.tips) and not found.paths and found.length == 0.0


def test_tips_keep_their_numbers():
    before = np.array([[0.0, 0.0], [np.nan, np.nan], [5.0, 0.0]])
    now = np.array([[5.4, 0.2], [0.3, 0.0], [9.0, 9.0]])
    assert followed(before, now, farthest=1.0).tolist() == [2, 0, -1]
    assert followed(before, now[:0], farthest=1.0).tolist() == []
