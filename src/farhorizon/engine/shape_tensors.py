"""Shape tensors of the nodes of correspondence materials, which are 1 where a node has all its bonds."""

from __future__ import annotations

import numpy as np

SINGULAR = 1e-3  # determinant of a shape tensor below which a node has no gradient
FACE = 0.5  # harmonic mean of the eigenvalues of one on a flat face


def inverse_shapes(shapes: np.ndarray) -> np.ndarray:
    """Inverse shape tensors, zero where the bonds that are there hardly span the space; shape (S, dim, dim)."""
    whole = np.linalg.det(shapes) > SINGULAR
    found = np.zeros_like(shapes)
    found[whole] = np.linalg.inv(shapes[whole])
    return found


def firmness(shapes: np.ndarray) -> np.ndarray:
    """Harmonic means of the eigenvalues of shape tensors: 1 of nodes with all bonds, 1/2 on a flat face; 1, too, where
    there is no gradient that could be stiff; shape (S,).
    """
    traces = np.trace(inverse_shapes(shapes), axis1=1, axis2=2)
    return np.divide(shapes.shape[1], traces, out=np.ones(len(shapes)), where=traces > 0)


def stress_left(shapes: np.ndarray, first: np.ndarray) -> np.ndarray:
    """What nodes bear of their stress when bonds have broken, by their shape tensors and what their `firmness` was at
    first: all of it until fewer bonds are left than on a flat face, and however few are left where that is given as 0;
    shape (S,).

    Without the factor the last bonds of a node would bear its whole stress, by the inverse of what little they span:
    stiffer than any step bears that was stable before. The energy of a node falls with the factor, so that energies
    still add up.
    """
    with np.errstate(divide="ignore"):
        return np.asarray(np.minimum(firmness(shapes) / (FACE * first), 1.0) ** 2)
