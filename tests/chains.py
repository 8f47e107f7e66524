"""Stencils for the tests of the exact boundary, and a domain so long that nothing returns from its ends."""

import numpy as np

from farhorizon.analysis.exact.chain import Recursion, fronts, symbol
from farhorizon.medium.integrators import Euler, Verlet
from farhorizon.papers.bar import Bar, bonds_of


def gaussian_weights(reach, spacing=None):
    """Return the micromodulus of Ji et al. (2021), eq 35, of width 0.25, cut off at 0.75, for `reach` nodes; the
    spacing is 0.75 / reach unless given.
    """
    spacing = 0.75 / reach if spacing is None else spacing
    r = spacing * np.arange(1, reach + 1)
    return 4 / (0.25**3 * np.sqrt(np.pi)) * np.exp(-((r / 0.25) ** 2)) * spacing


BAR = gaussian_weights(7, 0.1)  # the bar of Ji et al. (2021), section 4.1
BEAM = np.array([4.0, -1.0])  # Euler-Bernoulli, eq 29


def recursion_at(weights, kind, share):
    """Return the recursion at a fraction of the step limit; kind is "wave", "damped" (2 d u_t with d = 0.5) or
    "diffusion".
    """
    largest = symbol(weights, np.linspace(0, np.pi, 4097)).max()
    if kind == "diffusion":
        return Recursion.of(Euler(), share * 2 / largest)
    return Recursion.of(Verlet(), share * 2 / np.sqrt(largest), 0.5 if kind == "damped" else 0.0)


def long_chain(weights, recursion, u, steps, increment=None, coefficient=None, left=True, right=True, **options):
    """Return a bar on a domain so long that nothing returns, and the slice of the near field in it."""
    pad = int(fronts(weights, recursion, steps)[-1]) // 2 + 20
    pads = (pad if left else 0, pad if right else 0)

    def longer(values, fill=0.0):
        return None if values is None else np.pad(values, pads, constant_values=fill)

    whole = longer(u)
    grown = longer(coefficient, 1.0)
    held = {node + pads[0]: value for node, value in options.pop("held", {}).items()}
    bar = Bar(
        weights, recursion, whole, longer(increment), bonds=bonds_of(weights, whole.size, grown), held=held, **options
    )
    return bar, slice(pads[0], pads[0] + u.size)
