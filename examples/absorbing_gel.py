"""Ultrasound in a gel that absorbs by a power law of frequency, between two hydrophones (SI units).

Physics: a small transmitter sends a short burst into a gel, a fluid of 3 dB/cm at 1 MHz that absorbs more at higher
frequencies, by the power 1.2, as tissue does. What a wave loses between two hydrophones on a line with the transmitter
is the ratio of their spectra, after that of cylindrical spreading. Absorption alpha of waves of speed c is the quality
factor ``pi f / (alpha c)``, so that the power of Q is 1 - 1.2. The gel is unbounded on all sides.
Differences of eighth order disperse little: what disperses travels slowly, and is absorbed for longer.

Prints the measured quality factor beside that of the closed form at a few frequencies, and the power law that fits.

Run: ``python examples/absorbing_gel.py``; a few seconds.
"""

import numpy as np

import farhorizon as fh

MM, US, MHZ = 1e-3, 1e-6, 1e6
SPEED, POWER, BAND = 1500.0, 1.2, (0.3 * MHZ, 3 * MHZ)
REFERENCE = np.sqrt(BAND[0] * BAND[1])
DECIBELS = 20 / np.log(10)  # per neper
ALPHA = 300.0 / DECIBELS * (REFERENCE / MHZ) ** POWER  # 1/m, at the reference frequency
GEL = fh.Attenuation(np.pi * REFERENCE / (ALPHA * SPEED), BAND, exponent=1 - POWER)
SPACING, UNTIL = 0.125 * MM, 42 * US
HYDROPHONES = np.array([10 * MM, 40 * MM])
FREQUENCIES = MHZ * np.linspace(0.5, 1.3, 9)


def gel(until: float = UNTIL) -> tuple[fh.Simulation, fh.Receivers]:
    """Run the simulation; return it and the hydrophones."""
    burst = fh.ToneBurst(0.9 * MHZ, 2)
    line = fh.Receivers([(x, 0.0) for x in HYDROPHONES])
    sim = fh.Simulation(
        fh.Lattice(SPACING, (-4 * MM, -12 * MM), (44 * MM, 12 * MM)),
        fh.Wave(fh.Stencil.finite_difference(2, 8), SPEED, attenuation=GEL),
        fh.LatticePML(nodes=12),
        sources=[fh.PointSource((0.0, 0.0), 1.0, burst)],
        observe=[line],
    )
    return sim.run(until, progress=False), line


def absorption(line: fh.Receivers) -> np.ndarray:
    """Absorption (1/m) between the hydrophones at the frequencies, by the ratio of their spectra."""
    near, far = np.abs(np.exp(-2j * np.pi * np.outer(FREQUENCIES, line.times)) @ line.data["u"]).T
    spreading = np.sqrt(HYDROPHONES[1] / HYDROPHONES[0])
    return np.asarray(np.log(near / (far * spreading)) / np.diff(HYDROPHONES))


def quality(alpha: np.ndarray) -> np.ndarray:
    """Quality factors of absorptions."""
    return np.asarray(np.pi * FREQUENCIES / (alpha * SPEED * GEL.speed_at(FREQUENCIES)))


def main() -> tuple[fh.Simulation, fh.Receivers]:
    sim, line = gel()
    alpha = absorption(line)
    print("f in MHz   Q measured   closed form")
    for f, found, exact in zip(FREQUENCIES / MHZ, quality(alpha), GEL.quality_at(FREQUENCIES), strict=True):
        print(f"{f:8.2f} {found:12.1f} {exact:13.1f}")
    power, at_one = np.polyfit(np.log(FREQUENCIES / MHZ), np.log(alpha * DECIBELS / 100), 1)
    print(f"fitted: {np.exp(at_one):.2f} dB/cm f^{power:.2f}; asked for: 3 dB/cm f^{POWER}")
    return sim, line


if __name__ == "__main__":
    main()
