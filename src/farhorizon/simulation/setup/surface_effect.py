"""The surface effect: bonds are absent beyond free surfaces. By what factor bonds near a surface must be stiffer to
make up for it, and how soft bodies a few horizons thick are without such factors.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from farhorizon import kinds
from farhorizon.boundaries import Free, Side
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Box
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models import Elastic
from farhorizon.simulation.assembly import assemble
from farhorizon.simulation.setup.setup import Setup, Sides

_SOFT = 0.05  # error of Young's modulus from which on there is a note: that of a good tension test
_THICK = 8  # horizons from which on a body is softer by less, since the softness is about 0.2 horizons over thickness
_OFTEN = 0.1  # fraction of the nodes of a body from which on a part of it counts, unlike single nodes at its rim
_SLENDER = 2  # a part is thin along an axis if it is longer than this times its thickness along another one
_MOST = 2**22  # nodes for which thicknesses are looked for, in less than a second


def thickness_of(lattice: Lattice, sides: Sides) -> dict[int, int]:
    """Return, by axis, the thickness, in nodes between free surfaces, of the thinnest part of a body that has at least
    a tenth of its nodes; without axes along which no part is thin.
    """
    mask = lattice.existing
    exists = np.ones(lattice.shape, bool) if mask is None else mask
    spans = [_spans(exists, axis, sides) for axis in range(lattice.dim)]
    longest = np.max(spans, axis=0)
    thickness = {}
    for axis, span in enumerate(spans):
        thin = span[exists & np.isfinite(span) & (span * _SLENDER <= longest)]
        if thin.size >= _OFTEN * exists.sum():
            counts = np.bincount(thin.astype(int))
            thickness[axis] = int(np.argmax(np.cumsum(counts) >= _OFTEN * exists.sum()))
    return thickness


def _spans(exists: np.ndarray, axis: int, sides: Sides) -> np.ndarray:
    """Return for each node the number of consecutive nodes along an axis to which it belongs, infinite where they reach
    a side that is not free.
    """
    along = np.moveaxis(exists, axis, -1)
    n = along.shape[-1]
    places = np.arange(n)
    before = np.maximum.accumulate(np.where(along, -1, places), axis=-1)  # the last absent node, -1 for none
    after = np.minimum.accumulate(np.where(along, n, places)[..., ::-1], axis=-1)[..., ::-1]
    span = (after - before - 1).astype(float)
    for side, reached in ((-1, before < 0), (1, after == n)):
        if sides[axis, side].bonded:
            span[reached] = np.inf
    return np.moveaxis(span, -1, axis)


@lru_cache(maxsize=64)
def apparent_modulus(
    kernel: Kernel, spacing: float, dim: int, material: str, plane: str | None, poisson: float, nodes: int
) -> float:
    """Return Young's modulus of a plate, `nodes` thick between free surfaces, over that of the material: the stress
    under a uniform strain, with no forces on its faces and across its width, over the strain.

    The plate is a piece that is so wide that the bonds from its middle do not reach its ends. The forces on its right
    half, added, are those that bonds carry through the middle.
    """
    model = Elastic(kernel, 1.0, None if material == "bond-based" else poisson, material=material, plane=plane)
    reach = max(model.medium(spacing, dim).reach)
    half, inner = 2 * reach + 1, nodes // 2
    wide, thick = 2 * half, nodes + 2 * reach
    shape = (*(wide,) * (dim - 1), thick)
    upper = [spacing * (n - 1) for n in shape]
    low, high = spacing * (reach - 0.5), spacing * (reach + nodes - 0.5)
    far = spacing * wide
    body = Box([*[-far] * (dim - 1), low], [*[far] * (dim - 1), high])
    lattice = Lattice(spacing, [0.0] * dim, upper, body=body)
    exists = lattice.existing
    assert exists is not None
    parts = assemble(Setup(lattice, model, Free(), threads=1))
    engine, indices = parts.grid.engine, parts.grid.indices

    def forces(values: np.ndarray) -> np.ndarray:
        level = engine.level()
        level[indices] = values.reshape(indices.shape)
        return np.asarray(engine.apply_core(level)[indices], float).reshape(dim, *shape)

    fields = []
    for axis in range(dim - 1):  # uniform strains in the plane of the plate
        field = np.zeros((dim, *shape))
        field[axis] = np.expand_dims(lattice.axes[axis], [a for a in range(dim) if a != axis])
        fields.append(field)
    for layer in range(inner):  # faces move towards each other, symmetrically
        field = np.zeros((dim, *shape))
        field[-1, ..., reach + layer], field[-1, ..., reach + nodes - 1 - layer] = 1.0, -1.0
        fields.append(field)
    rows = []
    for field in fields:
        accelerations = forces(field * exists) * exists  # nodes that do not exist feel the others
        through = [-np.moveaxis(accelerations[a], a, 0)[half:, ..., :].sum(0) for a in range(dim - 1)]
        resultants = [force[(half,) * (dim - 2)].sum() for force in through]
        middle = accelerations[(-1, *(half,) * (dim - 1))]
        rows.append([*resultants, *middle[reach : reach + inner]])
    response = np.array(rows).T  # of resultants and of forces on the layers, to each of the fields
    free = np.linalg.lstsq(response[1:, 1:], -response[1:, 0], rcond=None)[0]
    stress = (response[0, 0] + response[0, 1:] @ free) / nodes  # acceleration times spacing: mass over face, density 1
    lame, shear = model.moduli
    of_plane, of_space = 4 * (lame + shear) / (lame + 2 * shear), (3 * lame + 2 * shear) / (lame + shear)
    return float(stress * spacing / (shear * (of_plane if dim == 2 else of_space)))


def thin_note(setup: Setup, sides: Sides) -> list[str]:
    """Return a note on a body that is softer than its material since it is only a few horizons thick."""
    model, lattice = setup.model.soft_at_surfaces, setup.lattice.whole
    if model is None or lattice.dim < 2 or setup.rim != "free" or int(np.prod(lattice.shape)) > _MOST:
        return []
    if set(model.varying) - {"density"}:  # such as a modulus with the factor of `surface_factor`
        return []
    horizons = model.kernel.horizon / lattice.spacing
    parts = {axis: n for axis, n in thickness_of(lattice, sides).items() if n <= _THICK * horizons}
    given = model.kernel, lattice.spacing, lattice.dim, model.material, model.plane, model.poisson
    left = float(np.prod([apparent_modulus(*given, n) for n in parts.values()]))
    if not parts or abs(1 - left) < _SOFT:
        return []
    thick = " and ".join(f"{n} nodes ({n / horizons:.2g} horizons) along {'xyz'[axis]}" for axis, n in parts.items())
    word = "soft" if left < 1 else "stiff"
    return [
        f"the body is {thick} thick: near its free surfaces bonds are absent, so that in tension it is about "
        f"{100 * abs(1 - left):.0f} % too {word} (apparent over given Young's modulus {left:.3f}); "
        'surface = "energy" corrects it, material = "correspondence" is exact; surface_factor overshoots in tension'
    ]


_SERVED = ("bond-based", "state-based")


def surface_factor(lattice: Lattice, model: Elastic, boundary: Side | Mapping[str, Side] | None = None) -> np.ndarray:
    """Factor on Young's modulus near free surfaces that makes a surface no softer than the solid: the sum over all
    bonds of a node, weighted as in the material, divided by that over the existing ones.

    This is the volume method: since the moduli of a bond's ends are combined by their harmonic mean, a bond becomes
    stiffer by ``2 V0 / (V + V')``. Along a flat face the factor does not change, so that the face may run into layers.
    It makes up for what is lacking in all directions alike, so that it overshoots in tension along the face: a strip of
    5 to 8 nodes with a horizon of two is 6 to 11 % too stiff. ``Elastic(surface="energy")`` is not.

    Parameters
    ----------
    lattice : Lattice
        The lattice; outside its body, if it has one, there are no bonds.
    model : Elastic
        Bond-based or state-based, with a kernel.
    boundary : Side or mapping, optional
        As in `Simulation`: beyond `Free` sides there are no bonds.

    Returns
    -------
    ndarray
        Of the lattice's shape, at least 1; 1 where all bonds exist, outside a body, and where no bond exists.

    Raises
    ------
    InputError
        Another material: the gradients of a correspondence material are exact at surfaces.

    Notes
    -----
    Le and Bobaru (2018), Surface corrections for peridynamic models in elasticity and fracture, Computational
    Mechanics 61, 499-518.

    Examples
    --------
    >>> import farhorizon as fh
    >>> ground = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 0.0))
    >>> sides = {"all": fh.LatticePML(), "y+": fh.Free()}
    >>> soil = fh.Elastic(fh.Kernel(2.0, 1), young=3.0)
    >>> factor = fh.surface_factor(ground, soil, sides)
    >>> factor[0, [-1, -2, -3]].round(2).tolist()
    [1.56, 1.06, 1.0]
    >>> sim = fh.Simulation(ground, fh.Elastic(fh.Kernel(2.0, 1), young=3.0 * factor), sides)
    """
    kinds.instance(model, "model", Elastic, "an Elastic model")
    if model.material not in _SERVED or not isinstance(model.kernel, Kernel):
        raise InputError(
            "surfaces of this material are not softer by bonds that are absent",
            value=model.title,
            limit=f"{' or '.join(_SERVED)} with a kernel",
            key="model.material",
            remedy="leave the factor out",
        )
    sides = Setup(lattice, model, boundary).sides
    offsets, weights = Stencil.family(model.kernel, lattice.spacing, lattice.dim)
    exists = np.ones(lattice.shape) if lattice.existing is None else lattice.existing.astype(float)
    padded, reach = exists, np.abs(offsets).max(0)
    for axis, m in enumerate(reach):
        if sides[axis, -1].periodic:
            padded = np.pad(padded, [(m, m) if a == axis else (0, 0) for a in range(lattice.dim)], mode="wrap")
            continue
        for side, width in ((-1, (m, 0)), (1, (0, m))):
            widths = [width if a == axis else (0, 0) for a in range(lattice.dim)]
            padded = np.pad(padded, widths, mode="edge") if sides[axis, side].bonded else np.pad(padded, widths)
    left = np.zeros(lattice.shape)
    for offset, weight in zip(offsets, weights, strict=True):
        left += (
            weight * padded[tuple(slice(m + o, m + o + n) for m, o, n in zip(reach, offset, exists.shape, strict=True))]
        )
    has_bonds = (exists > 0) & (left > 0)
    return np.divide(weights.sum(), left, out=np.ones(lattice.shape), where=has_bonds)
