"""The number of nodes per shortest wave of a frequency on a lattice."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from farhorizon.medium.stencil import Stencil

ENOUGH = 6.0  # nodes per wavelength of a well-resolved wave
_SAMPLES = 512  # samples of a branch between the middle and the edge of the Brillouin zone


class Resolution(NamedTuple):
    """How a lattice resolves the waves of a frequency.

    Attributes
    ----------
    nodes : float
        Nodes per wavelength of the shortest wave along an axis or a diagonal; 0 where the lattice does not carry one of
        the waves, and infinite below the lowest frequency of a medium with a reaction.
    scale : float
        Factor on spacing and time step with which the shortest wave would have `ENOUGH` nodes.
    """

    nodes: float
    scale: float


def resolution(stencil: Stencil, rate: float, dt: float, frequency: float) -> Resolution:
    """How a lattice resolves the waves of a frequency, by the dispersion of stencil and velocity Verlet.

    Parameters
    ----------
    stencil : Stencil
    rate : float
        Factor on the stencil, squared speed over squared spacing.
    dt : float
    frequency : float
        In cycles per time.

    Examples
    --------
    >>> import farhorizon as fh
    >>> stencil = fh.Stencil.finite_difference(1)
    >>> nodes, scale = resolution(stencil, 1.0, 1.0, 0.1)  # with this step the line has no dispersion
    >>> round(nodes, 3), round(scale, 3)
    (10.0, 1.667)
    """
    lines = [_branches(stencil, np.array(direction)) for direction in _directions(stencil.dim)]
    lowest = [float(np.interp(2 * np.pi / ENOUGH, numbers, branch)) for numbers, values in lines for branch in values.T]
    enough = np.arcsin(min(1.0, min(lowest) * np.sqrt(rate) * dt / 2)) / (np.pi * dt)
    if frequency * dt >= 0.5:  # beyond the Nyquist frequency of the steps
        return Resolution(0.0, float(enough / frequency))
    wanted = 2 / dt * np.sin(np.pi * frequency * dt) / np.sqrt(rate)
    largest = max(_wavenumber(numbers, branch, wanted) for numbers, values in lines for branch in values.T)
    nodes = np.inf if largest == 0 else 2 * np.pi / largest
    return Resolution(float(nodes), float(enough / frequency))


def _directions(dim: int) -> list[tuple[int, ...]]:
    """Axes and diagonals, one of each pair of opposite directions."""
    return [way for way in itertools.product((-1, 0, 1), repeat=dim) if way > (0,) * dim]


def _branches(stencil: Stencil, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Wavenumbers times spacing along a direction, from zero to the edge of the zone, and the frequencies of the
    branches there, roots of the eigenvalues of the symbol, shape (n, components).
    """
    part = np.linspace(0.0, np.pi, _SAMPLES)
    symbol = stencil.branches(*(part * int(n) for n in direction))
    return part * float(np.linalg.norm(direction)), np.sqrt(np.maximum(symbol, 0.0))


def _wavenumber(numbers: np.ndarray, branch: np.ndarray, wanted: float) -> float:
    """The first wavenumber at which a branch has a value; 0 where it begins above, infinite where it stays below."""
    above = branch >= wanted
    if not above.any():
        return np.inf
    end = int(np.argmax(above))
    if end == 0:
        return 0.0
    return float(np.interp(wanted, branch[end - 1 : end + 1], numbers[end - 1 : end + 1]))
