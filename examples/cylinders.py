"""Scattering cross sections of a soft and of a rigid cylinder over frequency, compared with the Hankel series.

Physics: scalar waves of speed 1 are incident on a cylinder of radius 2, either soft (the field is held at zero in it)
or rigid (a hole with a free rim). The cross section per length is ``4/k sum |J_n(ka) / H_n(ka)|^2``, with derivatives
for the rigid one. For short waves both tend to twice the shadow, 8, the soft one from above and the rigid one from
below.

Grid: a square of side 14 around the box of the incident wave, with two spacings and horizons of two spacings. One burst
contains all frequencies; the waves that leave through a box around that of the incident wave are summed at five of
them.

Prints the total cross section (by the optical theorem, from the forward scattered wave), the relative difference of the
energy that leaves the box, and the error. The rim is a staircase of nodes, whose radius is defined to within a spacing:
the error halves with the spacing.

Run: ``python examples/cylinders.py``; about 5 seconds.
"""

import numpy as np
from scipy import special

import farhorizon as fh

RADIUS = 2.0
FREQUENCIES = np.linspace(0.06, 0.18, 5)
SPACINGS = 0.5, 0.25
ORDERS = np.arange(-40, 41)


def series(frequency: float, rigid: bool) -> float:
    """Exact cross section."""
    k = 2 * np.pi * frequency
    inner, outer = (special.jvp, special.h1vp) if rigid else (special.jv, special.hankel1)
    return float(4 / k * (np.abs(inner(ORDERS, k * RADIUS) / outer(ORDERS, k * RADIUS)) ** 2).sum())


def measured(spacing: float, rigid: bool) -> tuple[np.ndarray, np.ndarray]:
    """Scattering and total cross sections at the frequencies."""
    far = fh.FarField(frequencies=FREQUENCIES, history=False)
    burst = fh.IncidentWave((1.0, 0.0), "sin(2*pi*(t-24)/8)*exp(-((t-24)/5)**2)", duration=48.0)
    disc, everywhere = fh.Disc(RADIUS), fh.Box((-99.0, -99.0), (99.0, 99.0))
    sim = fh.Simulation(
        fh.Lattice(spacing, (-7.0, -7.0), (7.0, 7.0), body=everywhere - disc if rigid else None),
        fh.Wave(fh.Kernel(2 * spacing)),
        fh.LatticePML(nodes=20),
        sources=[burst],
        constraints=[] if rigid else [fh.Prescribed(disc, 0.0)],
        observe=[far],
    )
    sim.run(140.0, progress=False)
    return far.cross_sections()


def main() -> None:
    """Compute both cylinders at both spacings."""
    for rigid in (False, True):
        exact = np.array([series(frequency, rigid) for frequency in FREQUENCIES])
        for spacing in SPACINGS:
            scattering, total = measured(spacing, rigid)
            print(f"{'rigid' if rigid else 'soft'}, spacing {spacing}:")
            print("  frequency, total, scattered/total - 1, series, error")
            for row in zip(FREQUENCIES, total, scattering / total - 1, exact, total / exact - 1, strict=True):
                print("  {:.2f}  {:7.4f}  {:+.0e}  {:7.4f}  {:+.3f}".format(*row))


if __name__ == "__main__":
    main()
