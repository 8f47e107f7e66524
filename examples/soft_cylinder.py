"""The scattering cross section of a soft cylinder, over frequency, against the Hankel series.

Physics: scalar waves of speed 1 fall on a cylinder of radius 2 on which the field is held at zero. Its scattering cross
section is ``4/k sum |J_n(ka) / H_n(ka)|^2`` per length, twice the shadow (8) for short waves and more for long ones.

Grid: a square of side 10, two reaches wider than the box of the incident wave, at two spacings with horizons of two
spacings. One burst has all frequencies; what goes out through the box around it is summed at twelve of them.

Prints the total cross section (optical theorem, from what is sent straight on), what leaves the box over it, and the
error. The rim is a staircase of nodes, whose radius is one to a spacing: the error halves with the spacing.

Run: ``python examples/soft_cylinder.py``; about 5 seconds.
"""

import numpy as np
from scipy import special

import farhorizon as fh

RADIUS = 2.0
FREQUENCIES = np.linspace(0.06, 0.18, 12)


def series(frequency: float) -> float:
    """The exact cross section."""
    k, orders = 2 * np.pi * frequency, np.arange(-40, 41)
    return float(4 / k * (np.abs(special.jv(orders, k * RADIUS) / special.hankel1(orders, k * RADIUS)) ** 2).sum())


def measured(spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Scattering and total cross section at the frequencies."""
    far = fh.FarField(frequencies=FREQUENCIES, history=False)
    burst = fh.IncidentWave((1.0, 0.0), "sin(2*pi*(t-24)/8)*exp(-((t-24)/5)**2)", duration=48.0)
    sim = fh.Simulation(
        fh.Lattice(spacing, (-5.0, -5.0), (5.0, 5.0)),
        fh.Wave(fh.Kernel(2 * spacing)),
        fh.LatticePML(nodes=20),
        sources=[burst],
        constraints=[fh.Prescribed(fh.Disc(RADIUS), 0.0)],
        observe=[far],
    )
    sim.run(130.0, progress=False)
    return far.cross_sections()


def main() -> None:
    """Two spacings, side by side."""
    exact = np.array([series(frequency) for frequency in FREQUENCIES])
    for spacing in (0.5, 0.25):
        scattering, total = measured(spacing)
        print(f"spacing {spacing}: frequency, total, scattered/total - 1, series, error")
        for row in zip(FREQUENCIES, total, scattering / total - 1, exact, total / exact - 1, strict=True):
            print("  {:.3f}  {:7.4f}  {:+.1e}  {:7.4f}  {:+.3f}".format(*row))


if __name__ == "__main__":
    main()
