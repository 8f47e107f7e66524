"""Solutions of the classical heat equation: products of slabs, the half-space, the infinite medium.

Carslaw and Jaeger (1959), chapters 1, 2 and 10.
"""

import numpy as np
from scipy import special


def box(slabs, axes, t, error=1e-13):
    """Temperature of a rectangle or a block as the product of one slab per axis, whose ends are at temperature 0 or
    insulated (Carslaw and Jaeger, section 1.15).
    """
    total = np.ones(())
    for slab, x in zip(slabs, axes, strict=True):
        total = np.multiply.outer(total, slab.temperature(x, t, error))
    return total


def half_space(x, t, diffusivity, surface=0.0, initial=1.0):
    """Half-space x > 0, initially at `initial`, whose surface is kept at `surface` from t = 0 on."""
    return surface + (initial - surface) * special.erf(np.asarray(x, float) / np.sqrt(4 * diffusivity * t))


def half_space_flux(x, t, diffusivity, conductivity, flux):
    """Half-space x > 0, initially at 0, with a constant flux into it at x = 0 (Carslaw and Jaeger, 2.9)."""
    scaled = np.asarray(x, float) / np.sqrt(4 * diffusivity * t)
    return (
        flux
        / conductivity
        * np.sqrt(4 * diffusivity * t)
        * (np.exp(-(scaled**2)) / np.sqrt(np.pi) - scaled * special.erfc(scaled))
    )


def half_space_convection(x, t, diffusivity, conductivity, transfer):
    """Half-space x > 0, initially at 0, next to a fluid at 1, with a heat transfer coefficient (Carslaw and Jaeger,
    2.7)."""
    x = np.asarray(x, float)
    scaled, biot = x / np.sqrt(4 * diffusivity * t), transfer / conductivity * np.sqrt(diffusivity * t)
    return special.erfc(scaled) - np.exp(-(scaled**2)) * special.erfcx(scaled + biot)


def gaussian(r, t, diffusivity, width, dim):
    """Infinite medium that starts as ``exp(-(r / width)^2)``, in 1 to 3 dimensions."""
    spread = width**2 + 4 * diffusivity * t
    return (width**2 / spread) ** (dim / 2) * np.exp(-(np.asarray(r, float) ** 2) / spread)
