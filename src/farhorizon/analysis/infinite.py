"""The exact solution of the fully discrete scheme on the infinite lattice."""

from __future__ import annotations

import numpy as np
from scipy import fft

from farhorizon.errors import InputError
from farhorizon.integrators import Integrator, Verlet
from farhorizon.stencil import Stencil


def largest_speed(stencil: Stencil) -> float:
    """Largest group speed of waves on the lattice in units of the long-wave speed, ``max |grad omega|``."""
    zone = stencil._zone()
    omega = np.sqrt(np.maximum(stencil.symbol(*zone), 1e-300))
    squared = sum((stencil.symbol_gradient(a, *zone) / (2 * omega)) ** 2 for a in range(stencil.dim))
    return float(np.sqrt(np.max(np.where(omega > 1e-6, squared, 1.0))))


def infinite_lattice(
    stencil: Stencil, rate: float, integrator: Integrator, dt: float, steps: int, u: np.ndarray, v: np.ndarray | None = None, damping: float = 0.0
) -> np.ndarray:
    """State after `steps` steps on the infinite lattice from data that vanish outside the given box.

    The update is diagonal in Fourier space; the periodic box is made so large that nothing that wraps around is
    back in time (waves) or above rounding (diffusion).

    Parameters
    ----------
    stencil : Stencil
    rate : float
        Factor on the stencil, ``coefficient / spacing^2``.
    integrator, dt, steps
        The scheme.
    u, v : ndarray
        Initial values (less the background) and velocities.
    damping : float

    Returns
    -------
    ndarray, shape of u

    Raises
    ------
    InputError
        A time so late that the box does not fit into memory.
    """
    time = steps * dt
    if isinstance(integrator, Verlet):
        travel = largest_speed(stencil) * np.sqrt(rate) * time
        travel += 20 * max(stencil.reach) + 10 * np.cbrt(travel)  # the front has an Airy tail ahead of it
    else:
        travel = 13 * np.sqrt(rate * time) + 12 * max(stencil.reach)
    box = [fft.next_fast_len(int(n + travel) + 1, real=True) for n in u.shape]
    if 16 * 8 * float(np.prod(box)) > 20 * 2**30:
        raise InputError("the infinite lattice at so late a time does not fit into memory", value=f"{box} nodes", key="run.until",
                         remedy="an earlier time or a coarser lattice")  # fmt: skip
    angles = [2 * np.pi * np.fft.fftfreq(n) for n in box[:-1]] + [2 * np.pi * np.fft.rfftfreq(box[-1])]
    symbol = stencil.symbol(*np.ix_(*angles)) * rate
    start = fft.rfftn(u, box)
    if isinstance(integrator, Verlet):
        speed = fft.rfftn(v, box) if v is not None and np.any(v) else np.zeros(1)
        end = integrator.propagate(symbol, dt, steps, start, speed, damping)
    else:
        end = integrator.growth(symbol, dt) ** steps * start
    return fft.irfftn(end, box)[tuple(slice(n) for n in u.shape)]
