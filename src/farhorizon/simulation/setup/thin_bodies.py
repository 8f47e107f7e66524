"""Softness of bodies a few horizons thick, whose bonds are absent beyond their free surfaces."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from farhorizon.boundaries import Free
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Box
from farhorizon.medium.kernel import Kernel
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
        level = np.zeros(engine.levels.shape[1], engine.dtype)
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
        'material = "correspondence" is exact; surface_factor overshoots in tension by about as much'
    ]
