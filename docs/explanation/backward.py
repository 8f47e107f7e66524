"""Waves of two kernels on a line: their frequencies, and where they run backward."""

import matplotlib.pyplot as plt
import numpy as np

import farhorizon as fh

k = np.linspace(0, np.pi, 400)
for exponent, colour in ((2, "C0"), (0, "C1")):
    stencil = fh.Wave(fh.Kernel(horizon=3.0, exponent=exponent), speed=1.0).stencil(1.0, 1)
    frequency = np.sqrt(np.maximum(stencil.symbol(k), 0.0))
    slope = np.gradient(frequency, k)
    plt.plot(k, frequency, colour, label=f"exponent {exponent}")
    plt.plot(k, np.where(slope < -1e-6, frequency, np.nan), colour, lw=5, alpha=0.4)
    found = stencil.backward_waves()
    said = f"from k = {found.first_wavenumber:.2f}, gamma up to {found.growth:.2f}" if found else "none"
    print(f"exponent {exponent}: backward waves {said}")
plt.xlabel("wavenumber times spacing")
plt.ylabel("frequency times spacing over speed")
plt.legend()
plt.savefig("backward.png", dpi=150)
