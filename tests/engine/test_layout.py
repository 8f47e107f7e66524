"""Indices of values: the halo of periodic axes."""

import itertools

import numpy as np
import pytest

from farhorizon.engine.layout import Layout, row_values


@pytest.mark.parametrize("periodic", [p for n in range(1, 4) for p in itertools.combinations(range(3), n)])
def test_copies_continue_the_box_across_periodic_axes(periodic):
    """The copies, in runs, fill each place of the halo once, as if the box were repeated. Their order does not matter,
    because none copies a copy.
    """
    layout = Layout((4, 5, 9), np.diag([2, 1, 3]), {}, frozenset(periodic))
    level = np.full(layout.size, np.nan)
    inside = layout.box.view(level)
    inside[...] = np.arange(inside.size).reshape(inside.shape)
    nodes, wide = set(layout.box.node_indices().ravel().tolist()), layout.box.all(level)
    expected = np.pad(inside, [(m if a in periodic else 0,) * 2 for a, m in enumerate(layout.reach)], mode="wrap")
    filled, read = [], set()
    for to, source, count in layout.copies().T.tolist():
        level[to : to + count] = level[source : source + count]
        filled += range(to, to + count)
        read |= set(range(source, source + count))
    assert len(filled) == len(set(filled))
    assert not (nodes | read) & set(filled)
    part = tuple(slice(None) if a in periodic else slice(m, -m) for a, m in enumerate(layout.reach))
    np.testing.assert_array_equal(wide[part], expected)


@pytest.mark.parametrize("itemsize", [4, 8])
def test_rows_take_whole_cache_lines_and_little_more(itemsize):
    """Long rows are not a multiple of 512 bytes apart, because the first-level cache would hold only a few of those."""
    line = 64 // itemsize
    for count in range(1, 3000):
        row = row_values(count, itemsize)
        assert row % line == 0
        assert count <= row < count + 2 * line
        assert row * itemsize % 512 or row * itemsize < 2048
