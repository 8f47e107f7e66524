"""Pressure on the faces of cracks and on the rims of holes.

The force on a face is the force that its absent bonds would carry in a medium under the opposite uniform stress. By
superposition, a crack under a remote stress is therefore the uniform stress plus a crack with the same pressure on its
faces.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import OfTime, OneOf, Toml, Unit
from farhorizon.errors import InputError, shown
from farhorizon.geometry.lattice import Lattice, nodes_in
from farhorizon.geometry.shapes import Cut, Shape
from farhorizon.inputs.cracks import CUT_KEYS, Crack, as_crack, cut_bonds
from farhorizon.inputs.expressions import as_signal
from farhorizon.inputs.loads import Load
from farhorizon.medium.force_states import ForceStates
from farhorizon.medium.stencil import Stencil
from farhorizon.models import LatticeModel

_UNEVEN = 1e-9  # of a tensor: largest asymmetry that counts as rounding
# For each offset, indices, shape (n, dim), of the nodes at which the bond is absent across the face.
_Faces = Iterator[np.ndarray]


@dataclass(frozen=True)
class Pressure(Load):
    r"""A pressure in a crack, or in a hole of the body.

    Parameters
    ----------
    on : Cut, Crack, sequence of points, or Shape
        A crack of the set-up, or a part of one, given as in `cracks`: the pressure acts on its faces; or a region of
        the body without nodes: it acts on the rim.
    value : float or array_like, shape (dim, dim)
        Force per area, positive if it presses the faces apart; for a symmetric tensor P the traction is ``-P n`` on a
        face whose normal n points away from the body.
    time : callable, str, Expression or float, optional
        Factor of t; 1 unless given.

    Raises
    ------
    InputError
        An object that is neither a crack nor a shape, a value that is not a finite number or a symmetric matrix, a
        factor that is not a function of t.

    Notes
    -----
    The force on a node is the force that its missing bonds would carry under the uniform stress P, reversed. The forces
    on the two faces of a crack, and on the rim of a hole, sum to zero, and on a flat face along the lattice they are
    :math:`-P n` per unit area, to rounding error. If bonds are linear, a crack under a remote stress P opens as it does
    under the pressure P. The force acts on the faces that exist initially, over a depth of one horizon, and does not
    follow breaking bonds.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(0.5, (-7.75, -7.75), (7.75, 7.75))
    >>> crack = [(-3.0, 0.0), (3.0, 0.0)]
    >>> model = fh.Elastic(fh.Kernel(1.0, exponent=1), young=1.0)
    >>> pump = fh.Pressure(crack, 1e-3, time=fh.Step(5.0))
    >>> sim = fh.Simulation(lattice, model, fh.LatticePML(nodes=8), cracks=[crack], loads=[pump])
    >>> _ = sim.run(until=20.0)
    >>> u = sim.fields["u"][1]
    >>> bool(u[16, 16] > 0 > u[16, 15])  # the faces move apart
    True
    """

    on: Annotated[
        Any, OneOf(**CUT_KEYS, region=Annotated[Shape, "A hole of the body instead: a region without nodes."])
    ]
    value: Annotated[Any, Toml(float | list[list[float]]), Unit("Pa")]
    time: OfTime = None

    def __post_init__(self) -> None:
        if not isinstance(self.on, Cut | Crack | Shape):
            kinds.array(self.on, "load.on")
        if not isinstance(self.value, list | tuple | np.ndarray):
            kinds.set_fields(self, value=kinds.number(self.value, "load.value"))
        elif (value := kinds.array(self.value, "load.value")).ndim != 2 or value.shape[0] != value.shape[1]:
            raise InputError(
                "a pressure is a number or a symmetric matrix",
                value=f"shape {value.shape}",
                limit="one row for each axis, as long as there are rows",
                key="load.value",
                remedy="a number where it presses alike in all directions",
            )
        elif np.abs(value - value.T).max() > _UNEVEN * np.abs(value).max():
            raise InputError(
                "the tensor of a pressure is symmetric",
                value=value,
                limit="P = P^T",
                key="load.value",
                remedy=f"{shown((value + value.T) / 2)}, which presses alike, but turns nothing",
            )
        kinds.set_fields(self, time=None if self.time is None else as_signal(self.time, "load.time"))

    def bounded(self, lattice: Lattice) -> Pressure:
        """The pressure itself: it stays where its crack or hole is."""
        return self

    def tensor(self, dim: int, key: str = "load") -> np.ndarray:
        """Force per area as a tensor; raises InputError if its dimension differs from that of the lattice."""
        if isinstance(self.value, float):
            return float(self.value) * np.eye(dim)
        tensor = np.array(self.value, float)
        if len(tensor) != dim:
            raise InputError(
                "the tensor of a pressure has a row for each axis", value=len(tensor), limit=dim, key=f"{key}.value"
            )
        return tensor


def pressing_force(
    load: Pressure,
    lattice: Lattice,
    model: LatticeModel,
    cracks: Sequence[Crack],
    rim: str,
    periodic: Mapping[int, bool],
    key: str = "load",
) -> np.ndarray:
    """Return the force per volume (dim, *lattice.shape) of a pressure on the nodes of a lattice, or of a part of it,
    without its factor of time; `model` is the reference medium, `cracks` all of the set-up. Raises InputError for bonds
    that cannot be absent, exist across the crack or in the hole, a face or rim that none crosses, and a tensor of
    another dimension.
    """
    spacing, dim = lattice.spacing, lattice.dim
    if not model.cuttable:
        raise InputError(
            "a pressure acts on faces of a medium of bonds",
            value=model.title,
            key=key,
            remedy='Elastic with a kernel, material = "bond-based", "state-based" or "correspondence"',
        )
    states = model.force_states(spacing, dim)
    stencil = model.stencil(spacing, dim) if states is None else None
    offsets = stencil.offsets if stencil is not None else states.offsets  # type: ignore[union-attr]
    pulls = forces_under_stress(offsets, _of_strains(stencil, states), load.tensor(dim, key)) / spacing
    if isinstance(load.on, Shape):
        faces = _around(load.on, lattice.whole, offsets, rim, periodic, key)
    else:
        faces = _across(as_crack(load.on, dim).cut, lattice.whole, offsets, cracks, key)
    force, met = np.zeros((dim, *lattice.shape)), False
    for nodes, pull in zip(faces, pulls, strict=True):
        own_nodes = nodes - np.array(lattice.first)
        own_nodes = own_nodes[((own_nodes >= 0) & (own_nodes < lattice.shape)).all(1)]
        force[:, *own_nodes.T] -= pull[:, None]
        met |= bool(len(nodes) and pull.any())
    if not met and load.tensor(dim, key).any():
        raise InputError(
            "the pressure meets no face", value=repr(load.on), key=f"{key}.on", remedy="a larger or another region"
        )
    return force


def forces_under_stress(offsets: np.ndarray, of_strains: np.ndarray, stress: np.ndarray) -> np.ndarray:
    """Return the forces of the bonds under a uniform symmetric stress, force densities times the spacing, (K, dim),
    from those for each entry of a displacement gradient, (K, dim, dim, dim). The strain is chosen such that ``sum_k f_k
    xi_k / 2`` is the stress: flat faces along the lattice carry exactly the given one.
    """
    dim = offsets.shape[1]
    pairs = list(itertools.combinations_with_replacement(range(dim), 2))
    strains = np.zeros((len(pairs), dim, dim))
    for number, (a, b) in enumerate(pairs):
        strains[number, a, b] = strains[number, b, a] = 1.0
    forces = np.einsum("kacd,ncd->nka", of_strains, strains)
    stresses = np.einsum("nka,kb->nab", forces, offsets) / 2
    stresses = (stresses + stresses.swapaxes(1, 2)) / 2
    table, asked = (np.stack([tensor[..., a, b] for a, b in pairs]) for tensor in (stresses, stress))
    return np.asarray(np.einsum("n,nka->ka", np.linalg.solve(table, asked), forces))


def _of_strains(stencil: Stencil | None, states: ForceStates | None) -> np.ndarray:
    """Force of each bond for each entry of a displacement gradient, if the nodes at both ends have all their bonds."""
    if states is None:
        assert stencil is not None
        return np.einsum("kab,kc->kabc", stencil.weights, stencil.offsets)
    shape_tensor = np.eye(states.offsets.shape[1])[None]
    law = states.law(shape_tensor, np.array([states.moduli]))[0]
    state = np.einsum("knb,kc->nbc", states.gradient, states.offsets)
    bonds = np.einsum("kab,kc->kabc", states.bonds, states.offsets)
    return np.asarray(bonds + 2 * np.einsum("kan,nm,mbc->kabc", states.divergence, law, state))


def _across(cut: Cut, lattice: Lattice, offsets: np.ndarray, cracks: Sequence[Crack], key: str) -> _Faces:
    """Yield, for each offset, the nodes whose bond the crack cuts; raises InputError if no crack of the set-up cuts
    such a bond.
    """
    severing = [crack.cut for crack in cracks if crack.factor == 0]
    for offset in offsets:
        nodes, _ = cut_bonds(cut, lattice.lower, lattice.spacing, lattice.shape, offset[None])
        nodes = nodes[((nodes + offset >= 0) & (nodes + offset < lattice.shape)).all(1)]
        if lattice.mask is not None:
            nodes = nodes[lattice.mask[tuple(nodes.T)] & lattice.mask[tuple((nodes + offset).T)]]
        ends = [lattice.lower + lattice.spacing * indices for indices in (nodes, nodes + offset)]
        severed = np.zeros(len(nodes), bool)
        for severing_cut in severing:
            severed |= severing_cut.cuts(*ends)
        if not severed.all():
            raise InputError(
                "a pressure acts on the faces of a crack",
                value=ends[0][~severed][0].tolist(),
                limit="bonds that cracks cut, with factor = 0",
                key=f"{key}.on",
                remedy="the same in cracks",
            )
        yield nodes


def _around(
    hole: Shape, lattice: Lattice, offsets: np.ndarray, rim: str, periodic: Mapping[int, bool], key: str
) -> _Faces:
    """Yield, for each offset, the nodes of the body with a bond into a hole; raises InputError if the hole contains
    nodes, or its rim is not free.
    """
    inside = nodes_in(hole, lattice, f"{key}.on")
    body = np.ones(lattice.shape, bool) if lattice.existing is None else lattice.existing
    if (inside & body).any() or rim != "free":
        raise InputError(
            "a pressure acts on the free rim of a hole",
            value=f"{int((inside & body).sum())} nodes in it" if rim == "free" else f'rim = "{rim}"',
            key=f"{key}.on",
            remedy='a shape that the lattice\'s body leaves out, with rim = "free"',
        )
    for offset in offsets:
        across, has_neighbour = inside, np.ones(lattice.shape, bool)
        for axis, (step, n) in enumerate(zip(offset.tolist(), lattice.shape, strict=True)):
            across = np.roll(across, -step, axis)
            if step and not periodic[axis]:
                beyond = np.arange(n) + step
                shape = [-1 if a == axis else 1 for a in range(lattice.dim)]
                has_neighbour = has_neighbour & ((beyond >= 0) & (beyond < n)).reshape(shape)
        yield np.argwhere(body & across & has_neighbour)
