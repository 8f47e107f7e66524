"""Compiled loops over the columns of a layer."""

import os

import numpy as np
import pytest

from farhorizon.analysis.layers.columns import continuations, take_stencil

SEED = int(os.environ.get("FARHORIZON_SEED", np.random.default_rng().integers(2**31)))


@pytest.fixture
def random():
    print(f"seed {SEED}")
    return np.random.default_rng(SEED)


def complex_numbers(random, *shape):
    return random.normal(size=shape) + 1j * random.normal(size=shape)


def test_a_layer_without_stretch_continues_the_lattice():
    """Unstretched edges are transparent: continued by k nodes, the field of a column is that of the k-th column from
    it.
    """
    columns, reach = 5, 3
    near = 1 + np.arange(reach + 1)  # the nodes 0, -1 .. -reach
    field = 11.0 + np.arange(columns)  # the columns 1 .. L
    for k, (inwards, outwards) in enumerate(continuations(np.ones((1, columns + 1), complex), reach), 1):
        line = np.concatenate([near[:1], field, np.zeros(k)])
        np.testing.assert_array_equal(inwards[0] @ line[: columns + 1], line[k : columns + 1 + k])
        line = np.concatenate([near[::-1], field])
        np.testing.assert_array_equal(
            outwards[0] @ np.concatenate([field, near]), line[reach + 1 - k : reach + 1 - k + columns]
        )


def test_continued_fields_obey_the_recursion_over_each_edge(random):
    """``(1 - g) U(p+1, k+1) + (1 + g) U(p+1, k) = (1 + g) U(p, k+1) + (1 - g) U(p, k)``, inwards from k = 0, and
    outwards towards it.
    """
    columns, reach = 4, 3
    stretch = 2 + complex_numbers(random, 2, columns + 1)
    found = list(continuations(stretch, reach))
    for wave, g in enumerate(stretch):
        field, near = complex_numbers(random, columns + 1), complex_numbers(random, reach + 1)
        inside = np.array([field, *(inwards[wave] @ field for inwards, _ in found)])
        inside = np.pad(inside, ((0, 0), (0, 1)))  # nothing beyond the last column
        own = np.concatenate([field[1:], near])
        outside = np.array([field[1:], *(outwards[wave] @ own for _, outwards in found)])
        outside = np.concatenate([near[:, None], outside], axis=1)
        for p in range(columns + 1):
            for k in range(reach):
                u, v = inside[:, p], inside[:, p + 1]
                assert (1 - g[p]) * v[k + 1] + (1 + g[p]) * v[k] == pytest.approx(
                    (1 + g[p]) * u[k + 1] + (1 - g[p]) * u[k], rel=1e-9, abs=1e-9
                )
                if p < columns:  # the same, k + 1 nodes outwards
                    u, v = outside[:, p], outside[:, p + 1]
                    assert (1 - g[p]) * v[k] + (1 + g[p]) * v[k + 1] == pytest.approx(
                        (1 + g[p]) * u[k] + (1 - g[p]) * u[k + 1], rel=1e-9, abs=1e-9
                    )


def test_a_stencil_is_taken_as_by_sums_over_all_columns(random):
    n, d, columns, reach = 3, 2, 4, 2
    stretch = 2 + complex_numbers(random, n, columns + 1)
    system = np.zeros((n, d, columns, d, columns), complex)
    drive, sums, driven = np.zeros((n, reach + 1, d, columns, d), complex), 0.0, 0.0
    for inwards, outwards in continuations(stretch, reach):
        ahead, behind = complex_numbers(random, 2, n, d, d)
        take_stencil(ahead, inwards, behind, outwards, system, drive)
        sums = sums + np.einsum("nce,npq->ncpeq", ahead, inwards[:, 1:, 1:])
        sums = sums + np.einsum("nce,npq->ncpeq", behind, outwards[:, :, :columns])
        driven = driven + np.einsum("nce,npk->nkcpe", behind, outwards[:, :, columns:])
    np.testing.assert_allclose(system, -sums, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(drive, driven, rtol=1e-12, atol=1e-12)
