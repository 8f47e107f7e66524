r"""Sudden heating of the face of a half-space: the wave that runs ahead of the heat.

From t = 0 on, the stress-free face x = 0 has the temperature :math:`T_0`. The heat diffuses inwards,
:math:`T = T_0\,\mathrm{erfc}(x / 2\sqrt{\kappa t})`, and the solid, whose inertia prevents immediate expansion, emits a
compression wave (Danilovskaya, 1950, Prikl. Mat. Mekh. 14, 316; without the heat released by the deformation). In units
of the length :math:`\kappa / c`, of the time :math:`\kappa / c^2` and of the displacement
:math:`\gamma T_0 \kappa / (M c)`, with the speed c of P waves, :math:`M = \rho c^2` and
:math:`\gamma = E \alpha / (1 - 2\nu)`, the Laplace transform of the displacement is

.. math:: \hat u = \frac{e^{-px} - e^{-x\sqrt p} / \sqrt p}{p\,(1 - p)}

With the heat released by the deformation, and the coupling constant :math:`\epsilon = \gamma^2 T_a / \rho c M` at the
absolute temperature :math:`T_a`, two coupled waves replace sound and heat. They belong to the roots of
:math:`(k^2 - p^2)(k^2 - p) = \epsilon\,p\,k^2`:

.. math:: \hat u = -\frac{k_1 e^{-k_1 x} - k_2 e^{-k_2 x}}{p\,(k_1^2 - k_2^2)}
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.special import erfc, erfcx

from farhorizon import (
    Diffusion,
    Elastic,
    Free,
    Heat,
    Kernel,
    Lattice,
    LatticePML,
    Periodic,
    Setup,
    Side,
    Simulation,
    Temperature,
    ThermalLoad,
    Thermoelastic,
)
from farhorizon.studies.collection import Outcome, Row
from farhorizon.validation import validation

SHOCK = "Danilovskaya (1950), Thermal stresses in an elastic half-space due to a sudden heating of its boundary"
POISSON = 0.25
YOUNG = (1 + POISSON) * (1 - 2 * POISSON) / (1 - POISSON)  # so that M is 1, and with the density 1 also the speed c
STRAIN = 1e-3  # gamma T0 / M
EXPANSION = STRAIN * (1 - 2 * POISSON) / YOUNG
DEPTH, UNTIL = 80.0, 100.0  # by then the front has left, and the heat has reached a quarter of the depth
SPACINGS = (0.4, 0.2)
EARLY = 20.0  # time at which the front is inside
COUPLING, ABSOLUTE = 0.5, 300.0
_TERMS, _FAR = 1 << 15, 9.2  # of the inverse transform: terms, and abscissa times `period` (aliases are 1e-8)
_EVERY = 4  # nodes between the depths at which the coupled solution is computed


def displacement(x: np.ndarray, t: float) -> np.ndarray:
    """Exact displacement at depths x >= 0 and a time t > 0, in its unit."""
    root, spread = np.sqrt(t), np.exp(-(x**2) / (4 * t))
    near, far = root - x / (2 * root), root + x / (2 * root)
    # erfcx of positive numbers avoids exp(t), which overflows; behind the front the exponentials cancel
    beside = spread * erfcx(np.abs(near)) / 2
    wave = np.where(x < t, beside - 1, np.where(near > 0, beside - np.exp(np.minimum(t - x, 0)), -beside))
    return -(2 * root / np.sqrt(np.pi) * spread - x * erfc(x / (2 * root)) + wave + spread * erfcx(far) / 2)


def coupled_displacement(x: np.ndarray, t: float, coupling: float) -> np.ndarray:
    """Exact displacement with coupling at depths x >= 0 and a time t > 0, in its unit: inverse Laplace transform along
    a line, accurate to 1e-5.
    """
    period = 2 * t
    angles = np.pi * np.arange(_TERMS) / period
    p = _FAR / period + 1j * angles
    turns = np.exp(1j * angles * t)
    turns[0] /= 2
    half = (p * p + p * (1 + coupling)) / 2
    apart = np.sqrt(half * half - p**3)
    first, second = np.sqrt(half + apart), np.sqrt(half - apart)
    factor = -np.exp(_FAR * t / period) / period * turns / (2 * p * apart)
    waves = ((factor * (first * np.exp(-first * at) - second * np.exp(-second * at))).real.sum() for at in x)
    return np.fromiter(waves, float, len(x))


def coupled_run(spacing: float, coupling: float = COUPLING) -> Simulation:
    """The part of the half-space of `run` as one model of both fields, whose face is suddenly heated."""
    lattice, sides, kernel = _layer(spacing, -1.5 * spacing)
    capacity = ABSOLUTE * STRAIN**2 / coupling
    heat = Heat(kernel, specific_heat=capacity, conductivity=capacity, integrator="rk4")
    model = Thermoelastic(_solid(spacing), heat, EXPANSION, ABSOLUTE)
    return Simulation(lattice, model, sides, constraints=[Temperature("x-", ABSOLUTE + 1)])


def _layer(spacing: float, lower: float) -> tuple[Lattice, dict[str, Side], Kernel]:
    """Lattice of the part of the half-space from the depth `lower` on, its sides, and the kernel of the conducting
    bonds."""
    lattice = Lattice(spacing, (lower, -4 * spacing), (DEPTH - spacing / 2, 4 * spacing))
    return lattice, {"x-": Free(), "x+": LatticePML(nodes=24), "y": Periodic()}, Kernel(2 * spacing)


def _solid(spacing: float) -> Elastic:
    return Elastic(Kernel(2 * spacing, exponent=1), young=YOUNG)


def run(spacing: float, computed: bool = False) -> Simulation:
    """Part of the half-space, periodic along its face, before the first step; the temperature is exact or `computed` in
    a run of its own, whose outermost nodes are held.
    """
    lower = -1.5 * spacing if computed else spacing / 2  # the wall is the inner edge of two layers of held nodes
    lattice, sides, kernel = _layer(spacing, lower)
    heat = Setup(lattice, Diffusion(kernel, 1.0), sides, constraints=[Temperature("x-", 1.0)])
    load = ThermalLoad(heat if computed else temperature, EXPANSION, 0.0)
    return Simulation(lattice, _solid(spacing), sides, loads=[load])


def temperature(x: np.ndarray, y: np.ndarray, t: float) -> np.ndarray:
    """Exact temperature."""
    return np.asarray(erfc(x / (2 * np.sqrt(max(t, 1e-12)))) + 0 * y)


def compared(sim: Simulation, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run up to a time; return depths, and the computed and exact displacements there in their unit."""
    sim.run(time, progress=False)
    x = sim.lattice.axes[0]
    return x[x > 0], sim.fields["u"][0, x > 0, 4] / STRAIN, displacement(x[x > 0], sim.time)


@validation("thermal-shock", SHOCK, "the face of a half-space is heated at once")
def shock(folder: Path) -> Outcome:
    """Bond-based solid in plane strain: at t = 20 the front is inside, at t = 100 it has left through the layer. Then
    both fields as one model, in which the solid cools as it is stretched.
    """
    from farhorizon.pictures.curves import curve_panels

    rows, errors, panels = [], [], []
    for spacing in SPACINGS:
        for computed in (False, True):
            sim = run(spacing, computed)
            for time in (EARLY, UNTIL):
                x, moved, exact = compared(sim, time)
                error = float(np.abs(moved - exact).mean() / np.abs(exact).max())
                of = "computed" if computed else "exact"
                rows.append(Row(f"mean difference, t = {time:g}, {of} temperature, spacing {spacing:g}", error))
                if not computed:
                    errors.append(error)
                if spacing == SPACINGS[-1] and not computed:
                    panels.append((f"t = {time:g}", [("exact", x, exact), ("computed", x, moved)]))
    orders = np.log2(np.array(errors[:2]) / errors[2:])
    rows += [
        Row(f"order in the spacing, t = {time:g}", float(o)) for time, o in zip((EARLY, UNTIL), orders, strict=True)
    ]
    errors = []
    for spacing in SPACINGS:
        sim = coupled_run(spacing).run(EARLY, progress=False)
        x = sim.lattice.axes[0]
        some = np.flatnonzero(x > 0)[::_EVERY]
        moved, exact = sim.fields["u"][0, some, 4] / STRAIN, coupled_displacement(x[some], sim.time, COUPLING)
        errors.append(float(np.abs(moved - exact).mean() / np.abs(exact).max()))
        rows.append(Row(f"mean difference, t = {EARLY:g}, coupled ({COUPLING:g}), spacing {spacing:g}", errors[-1]))
    rows.append(Row(f"order in the spacing, t = {EARLY:g}, coupled", float(np.log2(errors[0] / errors[1]))))
    panels.append((f"t = {EARLY:g}, coupled", [("exact", x[some], exact), ("computed", x[some], moved)]))
    picture = folder / "thermal-shock.png"
    curve_panels(panels, picture, xlabel="depth", ylabel="displacement")
    return Outcome(rows, pictures=[picture])
