"""Materials whose bonds' forces follow from a state of the node at each end (Silling et al. 2007), linearised.

A sum over its bonds makes the state of a node, ``q_i = sum_k G_k (u_k - u_i)``; a law of the node makes of it
``p_i = M_i q_i``; and the force density is ``sum_k D_k (p_k + p_i)``, beside that of bonds which are springs.

Where a node has all its bonds the second p cancels, and one stencil, the convolution ``D M G``, makes the same forces:
from it follow waves, layers and certificates. Where bonds are absent the sums are those over the bonds that are there,
and the law may go by the node's shape tensor.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from farhorizon.engine.shape_tensors import inverse_shapes
from farhorizon.medium.stencil import Stencil


@dataclass(frozen=True)
class ForceStates:
    """Sums over the bonds of a lattice, in units of its spacing, for unit P modulus.

    Attributes
    ----------
    offsets : ndarray of int, shape (K, dim)
    bonds : ndarray, shape (K, dim, dim)
        Springs beside the states.
    gradient : ndarray, shape (K, n, dim)
        G, which makes the n numbers of a state.
    divergence : ndarray, shape (K, dim, n)
        D.
    shapes : ndarray, shape (K, dim, dim)
        What a bond adds to the shape tensor of its node, which is 1 where all are there.
    law : callable
        Takes shape tensors, shape (S, dim, dim), and moduli, shape (S, 3), in which it is linear, and returns M, shape
        (S, n, n).
    moduli : tuple of three floats
        Lame's constant that the law goes by, the shear modulus, and what stabilises.
    signs : tuple of tuple of int
        Of each number of a state whether it changes its sign (1) or not (0) where an axis is turned.
    kept : bool
        Whether bonds that are cut or break leave the shape tensors of their nodes as they are.
    unweakened : bool
        Whether nodes bear all of their stress on the last of their bonds, see `engine.shape_tensors.stress_left`.
    released : ndarray, shape (K, 3), or None
        Of bonds that break by the energy which is lost with them what that is in an intact body, see
        `energy_of_bonds`; they leave the shape tensors as they were at first. None where bonds break by their stretch.
    closed : ndarray, shape (K, dim, dim), or None
        Springs along the bonds, for those that are absent and shorter than in the beginning; None where absent bonds
        carry nothing.
    """

    offsets: np.ndarray
    bonds: np.ndarray
    gradient: np.ndarray
    divergence: np.ndarray
    shapes: np.ndarray
    law: Callable[[np.ndarray, np.ndarray], np.ndarray]
    moduli: tuple[float, float, float]
    signs: tuple[tuple[int, ...], ...]
    kept: bool = False
    unweakened: bool = False
    released: np.ndarray | None = None
    closed: np.ndarray | None = None


def energy_of_bonds(states: ForceStates) -> np.ndarray:
    """Energy that is lost with each bond of an intact body which is stretched evenly, shape (K, 3), for a unit of each
    of the moduli of one of its ends.

    The stretch of the longest bonds is 1, and the others become longer by as much: where the faces of a crack move
    apart, all bonds across them do. With a stretch that is the same for all, or an energy for bonds of a kernel
    ``1 / |xi|``, what a crack spends goes more by its angle to the lattice (`farhorizon.studies.toughness`); that bonds
    break by their energy is due to Foster, Silling and Chen (2011), International Journal for Multiscale Computational
    Engineering 9, 675.

    Parameters
    ----------
    states : ForceStates
    """
    dim, lengths = states.offsets.shape[1], np.linalg.norm(states.offsets, axis=1)
    stretch = (lengths.max() / lengths)[:, None]
    eta = stretch * states.offsets
    whole = stretch * np.einsum("kqa,ka->q", states.gradient, states.offsets)  # of a node in such a body
    own = np.einsum("kqa,ka->kq", states.gradient, eta)
    units = states.law(np.broadcast_to(np.eye(dim), (3, dim, dim)), np.eye(3))
    forces = np.einsum("kaq,mqp,kp->kma", states.divergence, units, whole - own / 2)
    found = np.einsum("kma,ka->km", forces, eta)
    if states.moduli[2]:
        springs = np.einsum("ka,kab,kb->k", eta, states.bonds, eta)
        found[:, 2] += springs / states.moduli[2] / 4
    return np.asarray(found)


def closing_rate(states: ForceStates, softest: float = 1.0) -> float:
    """What bonds that close may add to the largest value of the symbol.

    Each of them stands for a bond that is absent, with what this was of a spring beside the states: along the bond, or
    alike in all directions. By so much it adds less than all of it.

    Parameters
    ----------
    states : ForceStates
    softest : float
        Where the medium varies, the least stiffness of the springs over that of bonds that close, in that of the model.
    """
    if states.closed is None:
        return 0.0
    n = states.offsets / np.linalg.norm(states.offsets, axis=1)[:, None]
    closed, springs = (np.einsum("ka,kab,kb->k", n, table, n) for table in (states.closed, states.bonds))
    return (
        max(0.0, 1 - softest * float((springs / closed).min())) * Stencil(states.offsets, states.closed).symbol_maximum
    )


def correspondence_states(
    offsets: np.ndarray, weights: np.ndarray, lame: float, shear: float, stabilisation: float = 0.0
) -> ForceStates:
    """Those of `solids.correspondence`: the state is the displacement gradient before it is multiplied by the inverse
    shape tensor, what the law makes of it the stress times that inverse, less what the stabilisation takes.

    Silling, Epton, Weckner, Xu and Askari (2007), section 18; stabilisation: Silling (2017), eq 21.
    """
    dim = offsets.shape[1]
    moment = (weights * offsets[:, 0] ** 2).sum()
    g = weights[:, None] * offsets / moment
    eye = np.eye(dim)
    # the number a dim + b of a state belongs to the derivative of component a along b
    gradient = np.einsum("ac,kb->kabc", eye, g).reshape(len(g), dim * dim, dim)

    def law(shapes: np.ndarray, moduli: np.ndarray) -> np.ndarray:
        inverse = inverse_shapes(shapes)  # e = q K^-1, p = sigma(e) K^-1 - pull e
        found = np.einsum("s,sab,sdc->sabcd", moduli[:, 0], inverse, inverse)
        found += np.einsum("s,ac,sdj,sjb->sabcd", moduli[:, 1], eye, inverse, inverse)
        found += np.einsum("s,scb,sda->sabcd", moduli[:, 1], inverse, inverse)
        found -= np.einsum("s,ac,sdb->sabcd", moduli[:, 2], eye, inverse)
        return np.asarray(found.reshape(len(shapes), dim * dim, dim * dim))

    return ForceStates(
        offsets,
        2 * stabilisation / moment * weights[:, None, None] * eye,
        gradient,
        gradient.transpose(0, 2, 1),
        g[:, :, None] * offsets[:, None, :],
        law,
        (lame, shear, stabilisation),
        tuple(
            tuple(int((axis == a) != (axis == b)) for axis in range(dim))
            for a, b in itertools.product(range(dim), repeat=2)
        ),
    )


def dilatation_states(
    offsets: np.ndarray, bonds: np.ndarray, weights: np.ndarray, lame: float, calibrate: bool = True
) -> ForceStates:
    """Those of `solids.dilatation` beside springs: the state is the nonlocal dilatation, of which the law makes a
    pressure.

    Its weighted volume is that of a node with all its bonds, as the springs' stiffness is: the energy of every node is
    positive then for any Poisson's ratio, and surfaces are soft as those of springs are.

    Silling, Epton, Weckner, Xu and Askari (2007), eq 104.
    """
    dim = offsets.shape[1]
    moment = (weights * offsets[:, 0] ** 2).sum() if calibrate else 2.0
    g = weights[:, None] * offsets / moment
    return ForceStates(
        offsets,
        bonds,
        g[:, None, :],
        g[:, :, None],
        g[:, :, None] * offsets[:, None, :],
        lambda shapes, moduli: moduli[:, :1, None],
        (lame, 0.0, 0.0),
        ((0,) * dim,),
    )
