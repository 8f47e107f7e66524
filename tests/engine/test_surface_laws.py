"""The law of nodes that lack bonds, row by row, against their matrices node by node."""

import os

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.engine.point_law import ALIKE, EACH
from farhorizon.engine.rows.build import load_rows
from farhorizon.engine.rows.compiled import njit
from farhorizon.engine.rows.matrices import call_map
from farhorizon.engine.surface_laws import law_rows
from helpers import lattice_of

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.SeedSequence().entropy % 2**32))


@njit()
def product(function, src, read, out, written, matrix, step, nodes, factor):
    """The map, called as compiled code does."""
    call_map(function, src, read, out, written, matrix, step, nodes, factor)


@pytest.mark.parametrize("real", ["float64", "float32"])
@pytest.mark.parametrize("added", [False, True])
@pytest.mark.parametrize("each", [False, True])
@pytest.mark.parametrize("shape", [(1, 1), (3, 1), (2, 3), (9, 3)])
def test_numbers_of_nodes_times_matrices(shape, each, added, real):
    """Any number of nodes, whether a multiple of the vector length or not; nothing else is written."""
    rng = np.random.default_rng(SEED)
    print(f"seed {SEED}")
    rows, columns = shape
    entries = [np.flatnonzero(rng.random(columns) < 0.7) for _ in range(rows)]
    entries = tuple(tuple(e.tolist()) if len(e) else (0,) for e in entries)
    mask = np.array([[c in e for c in range(columns)] for e in entries])
    (function,) = load_rows("map_rows", entries=entries, columns=columns, each=each, added=added, real=real)
    apart = 40
    for nodes in (1, 3, 8, 19):
        values = rng.normal(size=(columns, apart)).astype(real)
        before = rng.normal(size=(rows, apart)).astype(real)
        matrix = np.zeros(rows * columns * (nodes if each else 1) + 16, real)
        entries_of_nodes = (mask[..., None] * rng.normal(size=(rows, columns, nodes if each else 1))).astype(real)
        matrix[: entries_of_nodes.size] = entries_of_nodes.ravel()
        after, size = before.copy(), before.itemsize
        step = (nodes if each else 1) * size
        given = values.ctypes.data, apart * size, after.ctypes.data, apart * size, matrix.ctypes.data, step, nodes, 0.3
        product(function, *given)
        expected = before.copy()
        products = np.einsum("rcn,cn->rn", np.broadcast_to(entries_of_nodes, (rows, columns, nodes)), values[:, :nodes])
        expected[:, :nodes] = before[:, :nodes] + 0.3 * products if added else products
        np.testing.assert_allclose(after, expected, atol=1e-13 if real == "float64" else 1e-5)


@pytest.mark.parametrize("shape", [(23,), (9, 21), (5, 4, 19)])
def test_rows_hold_the_matrix_of_each_node(shape):
    """Nodes occur alone, beside others, and in runs that share their matrix; identical rows share theirs."""
    rng = np.random.default_rng(SEED)
    print(f"seed {SEED}")
    box = fh.Simulation(lattice_of(shape), fh.Wave(fh.Kernel(2.0)), fh.Periodic()).engine.layout.box
    places = box.node_indices()
    numbers = rng.integers(-2, 3, shape[-1])[None, None] * np.ones(places.shape, int)
    numbers[..., 2:12] = np.where(rng.random((*places.shape[:2], 1)) < 0.5, 1, numbers[..., 2:12])
    odd = numbers >= 0
    matrices = rng.normal(size=(3, 4, 4))
    table = law_rows(box, places[odd], numbers[odd], matrices)
    got = np.full((*places.shape, 16), np.nan)
    for row, (first, end) in enumerate(table.ranges):
        for place, stop, function, weight, step, first_kind in table.stretches[first:end]:
            for i in range(stop - place):
                start = weight + i * (function == EACH)
                at = row // places.shape[1], row % places.shape[1], place + i
                assert np.isnan(got[at]).all()
                got[at] = table.weights[start : start + 16 * step : step]
                assert table.kinds[first_kind + i] == numbers[at]
                assert function in (ALIKE, EACH)
    np.testing.assert_array_equal(np.isnan(got[..., 0]), ~odd)
    np.testing.assert_array_equal(got[odd].reshape(-1, 4, 4), matrices[numbers[odd]])
