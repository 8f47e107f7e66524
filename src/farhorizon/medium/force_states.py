"""Materials whose bond forces follow from a state of the node at each end (Silling et al. 2007), linearised.

The state of a node is a sum over its bonds, ``q_i = sum_k G_k (u_k - u_i)``; the material law maps it to
``p_i = M_i q_i``; and the force density is ``sum_k D_k (p_k + p_i)``, in addition to that of spring bonds.

Where a node has all its bonds, the second p cancels, and a single stencil, the convolution ``D M G``, gives the same
forces; waves, layers and certificates are derived from it. Where bonds are absent, the sums run over the remaining
bonds, and the law may depend on the node's shape tensor.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from farhorizon.engine.shape_tensors import inverse_shapes
from farhorizon.medium.stencil import Stencil


@dataclass(frozen=True)
class ForceStates:
    """State, law and forces as sums over the K bonds of a lattice, in units of its spacing, for unit P modulus; a state
    has n numbers.
    """

    offsets: np.ndarray
    #: Springs in addition to the states, (K, dim, dim).
    bonds: np.ndarray
    #: G, which gives the state, (K, n, dim).
    gradient: np.ndarray
    #: D, (K, dim, n).
    divergence: np.ndarray
    #: Contribution of a bond to the shape tensor of its node, which is the identity where all bonds are present,
    #: (K, dim, dim).
    shapes: np.ndarray
    #: Takes shape tensors, (S, dim, dim), and moduli, (S, 3), in which it is linear, and returns M, (S, n, n).
    law: Callable[[np.ndarray, np.ndarray], np.ndarray]
    #: Lame's constant and the shear modulus of the law, and the stabilisation.
    moduli: tuple[float, float, float]
    #: For each number of a state and each axis, whether the number changes its sign (1) or not (0) when the axis is
    #: reversed.
    signs: tuple[tuple[int, ...], ...]
    #: Whether the shape tensors of nodes stay as they are when their bonds are cut or break.
    kept: bool = False
    #: Whether the last bonds of a node bear its full stress, see `engine.shape_tensors.stress_left`.
    unweakened: bool = False
    #: For bonds that break by energy, the energy that is lost with them in an intact body, see `energy_of_bonds`,
    #: (K, 3); such bonds leave the shape tensors as they were at first. None where bonds break by their stretch.
    released: np.ndarray | None = None
    #: Springs along the bonds, (K, dim, dim), for absent bonds that are shorter than at first; None where absent bonds
    #: carry nothing.
    closed: np.ndarray | None = None


def energy_of_bonds(states: ForceStates) -> np.ndarray:
    """Energy that is lost with each bond of an intact, evenly stretched body, shape (K, 3), for a unit of each modulus
    of one of its ends.

    The stretch of the longest bonds is 1, and the others are elongated by the same length, as all bonds across a crack
    are when its faces move apart. With a stretch that is the same for all, or an energy for bonds of a kernel ``1 /
    |xi|``, the energy spent by a crack depends more strongly on its angle to the lattice
    (`farhorizon.studies.toughness`). The criterion that bonds break by their energy is due to Foster, Silling and Chen
    (2011), International Journal for Multiscale Computational Engineering 9, 675.
    """
    dim, lengths = states.offsets.shape[1], np.linalg.norm(states.offsets, axis=1)
    stretch = (lengths.max() / lengths)[:, None]
    eta = stretch * states.offsets
    state = stretch * np.einsum("kqa,ka->q", states.gradient, states.offsets)  # state of a node in such a body
    of_bond = np.einsum("kqa,ka->kq", states.gradient, eta)
    units = states.law(np.broadcast_to(np.eye(dim), (3, dim, dim)), np.eye(3))
    forces = np.einsum("kaq,mqp,kp->kma", states.divergence, units, state - of_bond / 2)
    energies = np.einsum("kma,ka->km", forces, eta)
    if states.moduli[2]:
        springs = np.einsum("ka,kab,kb->k", eta, states.bonds, eta)
        energies[:, 2] += springs / states.moduli[2] / 4
    return np.asarray(energies)


def closing_rate(states: ForceStates, softest: float = 1.0) -> float:
    """Upper bound of what closed bonds add to the largest value of the symbol.

    Each of them replaces an absent bond, and with it the spring of that bond beside the states: along the bond, or the
    same in all directions. What it adds is smaller by the stiffness of that spring. `softest` is the least stiffness of
    the springs over that of closed bonds, where the medium varies, relative to the model.
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
    """Force states of `solids.correspondence`.

    The state is the displacement gradient before its multiplication by the inverse shape tensor. The law maps it to the
    stress times that inverse, less the contribution of the stabilisation.

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
        matrices = np.einsum("s,sab,sdc->sabcd", moduli[:, 0], inverse, inverse)
        matrices += np.einsum("s,ac,sdj,sjb->sabcd", moduli[:, 1], eye, inverse, inverse)
        matrices += np.einsum("s,scb,sda->sabcd", moduli[:, 1], inverse, inverse)
        matrices -= np.einsum("s,ac,sdb->sabcd", moduli[:, 2], eye, inverse)
        return np.asarray(matrices.reshape(len(shapes), dim * dim, dim * dim))

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
    """Force states of `solids.dilatation` beside springs: the state is the nonlocal dilatation, the law gives a
    pressure.

    The weighted volume is that of a node with all its bonds, as is the stiffness of the springs. The energy of every
    node is then positive for any Poisson's ratio, and surfaces are as soft as those of springs.

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


def corrected_dilatation_states(
    offsets: np.ndarray, bonds: np.ndarray, weights: np.ndarray, lame: float, calibrate: bool = True
) -> ForceStates:
    """Force states of `dilatation_states`, but with a dilatation that is also that of the solid for uniform strains
    where bonds are absent from the start.

    The state is the displacement gradient before its multiplication by the inverse shape tensor, and the law maps it to
    the pressure times that inverse. Bonds that break leave the shape tensors as they are.
    """
    states = correspondence_states(offsets, weights, lame, 0.0)
    moment = (weights * offsets[:, 0] ** 2).sum()
    factor = 1.0 if calibrate else moment / 2
    return replace(
        states, bonds=bonds, gradient=factor * states.gradient, divergence=factor * states.divergence, kept=True
    )
