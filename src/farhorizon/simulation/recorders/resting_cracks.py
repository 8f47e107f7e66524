"""Energy per area at which a crack at rest begins to grow, in a strip that is pulled apart slowly.

The strip has a crack half way through, and its clamped edges move apart. Far ahead of the crack it stores the energy G
per area that the crack would open (Rivlin and Thomas 1953, Journal of Polymer Science 10, 291), whatever the material,
which is computed in a strip without a crack. A tip on a lattice waits at each row of nodes, so that starting a crack
takes more than keeping it running (`farhorizon.simulation.recorders.running_cracks`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from farhorizon.boundaries import Free, Periodic, Side
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Box, Rectangle
from farhorizon.inputs.prescribed import Prescribed
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models import Elastic
from farhorizon.simulation.setup.setup import Setup

_HALF = 7.0  # half the height of the strip, in horizons; with twice that the energy changes by at most 3 %
_LONG = 2.0  # half its length, in its half heights: the middle of each half does not feel its ends
# times that a wave takes over half the height, in which the edges move as far as the expected energy requires (thrice
# that changes the energy by 1 %); the time in which waves are damped, in the same unit: what the edges emit dies out
# long before, but what a bond emits as it breaks still shakes its neighbours
_SLOW, _FADES = 80.0, 2.5
_LATEST = 4.0  # of these times until a crack must have grown: sixteen times the expected energy
_LOOKS = 1000  # times in one of them at which bonds are counted: the energy is exact to 0.2 %


def energies_at_rest(
    runs: Callable[[Setup, Sequence[Any]], Any], model: Elastic, dim: int, expected: float
) -> tuple[float, float]:
    """Return the energy per area of a strip when the first bonds ahead of a crack at rest break, and when as many have
    broken as cross its plane at one row of nodes, for an estimate of it.

    The model is in units of its lattice, with a critical stretch; in 3D the strip is a slab of one node, in plane
    strain.
    """
    assert isinstance(model.kernel, Kernel)
    half = float(np.ceil(_HALF * model.kernel.horizon))
    offsets = Stencil.family(model.kernel, 1.0, dim)[0]
    reach, front = int(np.abs(offsets).max()), (0.0,) * (dim - 2)
    tried = model.with_constants({})
    tried.damping = 1.0 / (_FADES * half)
    planned = _SLOW * half  # waves in a bar have the speed 1
    speed = np.sqrt(expected * half / model.p_modulus) / planned
    far = _LONG * half
    pulled = [_clamped(sign, half - reach, far, speed, dim) for sign in (1, -1)]
    around: dict[str, Side] = {"all": Free()} if dim == 2 else {"x": Periodic(), "all": Free()}
    strip = Lattice(1.0, (*front, 0.5 - far, 0.5 - half), (*front, far - 0.5, half - 0.5))
    crack: Any = [(-2 * far, 0.0), (0.0, 0.0)]
    if dim == 3:
        crack = Rectangle([-far, -2 * far, 0.0], [2 * far, 0.0, 0.0], [0.0, 2 * far, 0.0])
    cracked = runs(Setup(strip, tried, around, cracks=[crack], constraints=pulled), [])
    width = 2 * reach + 1
    column = Lattice(1.0, (*front, 0.0, 0.5 - half), (*front, width - 1.0, half - 0.5))
    unbroken = tried.linearised
    sides: dict[str, Side] = {"xy"[a]: Periodic() for a in range(dim - 1)} | {"all": Free()}
    intact = runs(Setup(column, unbroken, sides, constraints=pulled, dt=cracked.dt), [])
    per_row = int(offsets[offsets[:, -1] > 0][:, -1].sum())  # bonds that cross the plane of the crack, for each row
    count, energies = max(1, int(planned / (_LOOKS * cracked.dt))), []
    for broken in (1, per_row):
        while cracked.broken_bonds < broken:
            if cracked.time > _LATEST * planned:
                raise InputError(
                    "no crack grows in a strip of this material",
                    value=model.title,
                    key="model.calibrate",
                    remedy='calibrate = "running", or a larger horizon',
                )
            cracked.step(count)
        intact.run(cracked.time, progress=False)
        energies.append(float(intact.energies()["strain"]) / width)
    return energies[0], energies[1]


def _clamped(sign: int, edge: float, far: float, speed: float, dim: int) -> Prescribed:
    """Return what moves one edge of the strip away from the plane of the crack."""
    low, high = sorted([sign * (edge + 0.1), sign * far])
    region = Box([*[-2 * far] * (dim - 1), low], [*[2 * far] * (dim - 1), high])
    return Prescribed(region, velocity=[*[0.0] * (dim - 1), sign * speed])
