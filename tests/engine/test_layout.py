"""Places of values: the halo of periodic axes."""

import itertools

import numpy as np
import pytest

from farhorizon.engine.layout import Layout


@pytest.mark.parametrize("periodic", [p for n in range(1, 4) for p in itertools.combinations(range(3), n)])
def test_copies_continue_the_box_across_periodic_axes(periodic):
    """In runs, each place once, as if the box were repeated; their order does not matter, for none copies a copy."""
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


@pytest.mark.parametrize("line", [8, 16])
def test_rows_are_whole_cache_lines_that_do_not_compete(line):
    """With at most one that nothing is in: rows take a large part of the memory."""
    for nodes in range(1, 9 * line):
        layout = Layout((4, 6, nodes), np.diag([1, 1, 3]), {}, frozenset(), line=line)
        plane, row, _ = layout.box.stride
        lines, rest = divmod(row, line)
        assert rest == 0 and lines % 4 and nodes + 6 <= row < nodes + 6 + 2 * line
        assert plane % row == 0 and plane // row % 2 and layout.box.origin % 16 == 0
