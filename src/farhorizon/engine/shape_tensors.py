"""Shape tensors of the nodes of correspondence materials, which are the identity if a node has all its bonds."""

from __future__ import annotations

import numpy as np

SINGULAR = 1e-3  # determinant below which a node has no gradient: its bonds hardly span the space
FACE = 0.5  # harmonic mean of the eigenvalues on a flat face


def inverse_shapes(shapes: np.ndarray) -> np.ndarray:
    """Inverse shape tensors, zero where the present bonds hardly span the space; shape (S, dim, dim)."""
    regular = np.linalg.det(shapes) > SINGULAR
    inverses = np.zeros_like(shapes)
    inverses[regular] = np.linalg.inv(shapes[regular])
    return inverses


def harmonic_eigenvalue(shapes: np.ndarray) -> np.ndarray:
    """Harmonic means of the eigenvalues of shape tensors, shape (S,): 1 for nodes with all bonds, 1/2 on a flat face;
    also 1 for nodes without a gradient.
    """
    traces = np.trace(inverse_shapes(shapes), axis1=1, axis2=2)
    return np.divide(shapes.shape[1], traces, out=np.ones(len(shapes)), where=traces > 0)


def stress_left(shapes: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Fraction (S,) of the stress that nodes bear after bonds have broken, from their shape tensors and initial
    `harmonic_eigenvalue`: all of it until fewer bonds are left than on a flat face, or with `first` 0 down to the last
    bond.

    Otherwise the last bonds would bear it all through the inverse of a nearly singular tensor, stiffer than the step
    allows. The energy of a node falls with the factor, so that energies still add up.
    """
    with np.errstate(divide="ignore"):
        return np.asarray(np.minimum(harmonic_eigenvalue(shapes) / (FACE * first), 1.0) ** 2)
