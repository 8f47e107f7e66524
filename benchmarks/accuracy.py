"""Error of the absorbing layers against the infinite lattice.

The reference is the exact result of the same time integrator on an unbounded lattice, computed from the symbol of the
stencil by FFT in a periodic box so large that nothing wraps into the near field. The tables therefore contain only the
error of the absorbing boundary, not that of the discretisation. Errors are the largest |u - u_infinite| over the near
field at 12 (waves) or 40 (diffusion) output times, once relative to the initial maximum and once to the maximum of
|u_infinite| at that time.

- waves2d: 12 x 12 near field, spacing 0.25 (49 nodes), pulse exp(-2 r^2) at (2, -1), a third of the stable step, to t =
  60 (five crossings); kernel |xi|^-2, m = 1..6, and Gaussian influence; 12, 16 and 20 layer nodes.
- waves1d: the same on 49 nodes, 20 and 40 layer nodes. The pulse leaves, so that the second ratio means little there.
- waves3d: 25^3 nodes, pulse at (1, -0.5, 0.25), to t = 20, m = 2 and 3, 10 layer nodes.
- diffusion: m = 3, forward Euler and Runge-Kutta 4, 12 and 20 layer nodes, to T = 10 R^2/diffusivity with R half the
  near field: 201 nodes in 1D, 24 in 2D; a third of the stable step. Target: 1e-5 of the current maximum with 12 nodes.
- diffusion3d: the same on 12^3 nodes, 12 layer nodes only (the cost of the corners grows as the cube of the thickness).

The box for diffusion is at least 12 sqrt(T) wider than the near field, so that images contribute exp(-12^2/4) = 2e-16
of the maximum.

Run: ``python benchmarks/accuracy.py [waves1d] [waves2d] [waves3d] [diffusion] [diffusion3d] [--json FILE]``.
Takes about seven minutes and 0.7 GB on a loaded machine; diffusion3d alone takes four.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from common import run_parts, verdict
from scipy import fft

from farhorizon import Diffusion, Kernel, Lattice, LatticePML, Simulation, Stencil, Wave
from farhorizon.medium.integrators import Euler, RungeKutta4, Verlet

Propagator = Callable[[np.ndarray, int, np.ndarray], np.ndarray]
DX = 0.25


class InfiniteLattice:
    """Exact solution on the unbounded lattice, restricted to the near field, for data u0 at rest.

    Parameters
    ----------
    stencil : Stencil
    rate : float
        Factor that multiplies the symbol of the stencil, coefficient / spacing^2.
    u0 : ndarray
    box : int
        Number of nodes of the periodic box along each axis.
    propagate : callable
        Function of (symbol, steps, coefficients) that returns the coefficients after that many steps.
    """

    def __init__(self, stencil: Stencil, rate: float, u0: np.ndarray, box: int, propagate: Propagator) -> None:
        self.shape, self.box, self.propagate = u0.shape, fft.next_fast_len(box, real=True), propagate
        self.start = fft.rfftn(u0, [self.box] * u0.ndim)
        angles = [2 * np.pi * np.fft.fftfreq(self.box)] * (u0.ndim - 1) + [2 * np.pi * np.fft.rfftfreq(self.box)]
        self.symbol = stencil.symbol(*np.ix_(*angles)) * rate

    def after(self, steps: int) -> np.ndarray:
        """Near field after a number of steps, computed slab by slab, since propagators need many temporaries."""
        u = np.empty_like(self.start)
        for rows in np.array_split(np.arange(len(u)), max(1, u.size // 500_000)):
            u[rows] = self.propagate(self.symbol[rows], steps, self.start[rows])
        for axis in range(u.ndim - 1):  # only the near field is transformed back
            u = fft.ifft(u, axis=axis).take(np.arange(self.shape[axis]), axis)
        return fft.irfft(u, self.box, axis=-1)[..., : self.shape[-1]]


def pulse(lattice: Lattice, centre: tuple[float, ...], steepness: float) -> np.ndarray:
    """Pulse exp(-steepness r^2) on the near field."""
    return np.exp(
        -steepness * sum((x - c) ** 2 for x, c in zip(lattice.coordinates(), centre, strict=False))
    ) + np.zeros(lattice.shape)


def output_steps(total: int, count: int) -> list[int]:
    """`count` step numbers up to `total`, evenly spaced."""
    return sorted({max(1, total * q // count) for q in range(1, count + 1)})


def errors(sim: Simulation, references: list[np.ndarray], at: list[int]) -> tuple[float, float]:
    """Largest error relative to the initial maximum, and relative to the current one."""
    first = float(np.abs(sim.fields["u"]).max())
    absolute, relative = 0.0, 0.0
    for number, reference in zip(at, references, strict=True):
        sim.step(number - sim.step_count)
        worst = float(np.abs(sim.fields["u"] - reference).max())
        absolute = max(absolute, worst / first)
        relative = max(relative, worst / float(np.abs(reference).max()))
    return absolute, relative


def wave_rows(
    dim: int, half: float, until: float, kernels: dict[str, Kernel], nodes: tuple[int, ...]
) -> Iterator[dict[str, Any]]:
    """Errors for several kernels (one row each) and layer thicknesses (two columns each)."""
    lattice = Lattice(DX, (-half,) * dim, (half,) * dim)
    u0 = pulse(lattice, (half / 3, -half / 6, half / 12), 2.0)
    for name, kernel in kernels.items():
        stencil = Stencil.from_kernel(kernel, DX, dim)
        dt = Verlet.step_limit(stencil.symbol_maximum / DX**2) / 3
        at = output_steps(int(until / dt), 12)
        box = int(1.3 * until / DX) + 2 * max(lattice.shape)
        exact = InfiniteLattice(stencil, DX**-2, u0, box, lambda s, n, u, dt=dt: Verlet.propagate(s, dt, n, u, 0 * u))
        references = [exact.after(n) for n in at]
        row: dict[str, Any] = {f"{dim}D wave to t={until:g}": name, "neighbours": len(stencil.weights), "steps": at[-1]}
        for count in nodes:
            sim = Simulation(lattice, Wave(kernel), LatticePML(nodes=count), {"u": u0}, dt=dt)
            row[f"{count} nodes/initial"], row[f"{count}/current"] = errors(sim, references, at)
        yield row


def waves1d() -> list[dict[str, Any]]:
    """Waves in 1D, 20 and 40 layer nodes."""
    return list(wave_rows(1, 6.0, 60.0, {f"m={m}": Kernel(m * DX) for m in (1, 2, 3)}, (20, 40)))


def waves2d() -> list[dict[str, Any]]:
    """Waves in 2D, 12 to 20 layer nodes, reach up to 6."""
    kernels = {f"m={m}": Kernel(m * DX) for m in range(1, 7)}
    kernels |= {f"m={m} gaussian": Kernel(m * DX, influence="gaussian") for m in (3, 6)}
    return list(wave_rows(2, 6.0, 60.0, kernels, (12, 16, 20)))


def waves3d() -> list[dict[str, Any]]:
    """Waves in 3D, 10 layer nodes."""
    return list(wave_rows(3, 3.0, 20.0, {f"m={m}": Kernel(m * DX) for m in (2, 3)}, (10,)))


def diffusion(cases: tuple[tuple[int, int], ...], nodes: tuple[int, ...]) -> list[dict[str, Any]]:
    """Diffusion of an off-centre pulse, spacing 1."""
    rows = []
    for dim, n in cases:
        lattice = Lattice(1.0, (0.0,) * dim, (n - 1.0,) * dim)
        radius, kernel = (n - 1) / 2, Kernel(3.0)
        stencil = Stencil.from_kernel(kernel, 1.0, dim)
        u0 = pulse(lattice, (1.25 * radius, 0.9 * radius, 1.1 * radius), 0.5)
        until = 10 * radius**2
        box = n + int(12 * np.sqrt(until))
        for name, scheme in (("euler", Euler), ("rk4", RungeKutta4)):
            dt = scheme.step_limit(stencil.symbol_maximum) / 3
            at = output_steps(int(np.ceil(until / dt)), 40)
            exact = InfiniteLattice(
                stencil, 1.0, u0, box, lambda s, k, u, scheme=scheme, dt=dt: scheme.growth(s, dt) ** k * u
            )
            references = [exact.after(k) for k in at]
            row: dict[str, Any] = {"diffusion to T=10 R^2": f"{dim}D {n}^{dim} {name}", "steps": at[-1]}
            for count in nodes:
                sim = Simulation(lattice, Diffusion(kernel, integrator=name), LatticePML(nodes=count), {"u": u0}, dt=dt)
                row[f"{count} nodes/initial"], row[f"{count}/current"] = errors(sim, references, at)
            rows.append(row | {"target at 12": 1e-5, "met": verdict(row["12/current"], 1e-5, larger=False)})
    return rows


if __name__ == "__main__":
    title = "largest error over the near field, relative to the initial and to the current maximum"
    run_parts(
        __doc__,
        {
            "waves1d": (f"waves1d: {title}", lambda given: waves1d()),
            "waves2d": (f"waves2d: {title}", lambda given: waves2d()),
            "waves3d": (f"waves3d: {title}", lambda given: waves3d()),
            "diffusion": (f"diffusion: {title}", lambda given: diffusion(((1, 201), (2, 24)), (12, 20))),
            "diffusion3d": (f"diffusion3d: {title}", lambda given: diffusion(((3, 12),), (12,))),
        },
    )
