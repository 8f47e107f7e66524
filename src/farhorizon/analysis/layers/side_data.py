"""Data in front of a side, and which of the waves they contain are significant there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from farhorizon.analysis.layers.chain_modes import all_modes
from farhorizon.analysis.layers.choice import weak
from farhorizon.analysis.layers.layer import LatticeMedium
from farhorizon.analysis.layers.reflection import factor_of_wave
from farhorizon.analysis.layers.short_waves import high_pass, short_share

_FELT_BACKWARD = 0.3  # share of the target error from which on backward waves in the data are followed
# forward waves from this part of the first backward wavenumber on have nearly the frequency of backward waves, and
# leave as such; for scalars only: for vectors, the prediction obtained in this way is too large where there are few
# such waves
TURNING = 0.8
_STATIC = 1e-9  # eigenvalue over the rate at which modes that do not travel are distinguished from the longest waves


@dataclass(frozen=True)
class Datum:
    """A field of the data at one side.

    Attributes
    ----------
    values : ndarray
        On the near field, the first axis along the normal and towards the side.
    kind : {"u", "v", "source"}
        Initial values, initial velocities, or a source, ``u_tt = .. + values time``.
    time : ndarray, shape (steps,)
        Factor of a source at each step; empty otherwise.
    component : int
        Component of a vector field to which the values belong.
    behind : tuple of (int, float), or None
        Number of nodes next to the side beyond which the medium is slower, and the ratio of its squared speed to that
        at the side. Waves keep their frequency at such an interface, so that they arrive with a longer wavelength than
        they had at the start.
    """

    values: np.ndarray
    kind: str
    time: np.ndarray = field(default_factory=lambda: np.zeros(0))
    component: int = 0
    behind: tuple[int, float] | None = None

    def turned(self, axis: int, side: int) -> Datum:
        """Return the datum with a given axis first, pointing towards its lower (-1) or upper (1) end."""
        values = np.moveaxis(self.values, axis, 0)
        return replace(self, values=values if side > 0 else values[::-1])

    def with_entrance(self) -> Datum:
        """Return the datum with one more, empty, node between the side towards which it is turned and the layer."""
        values = np.pad(self.values, [(0, 1), *[(0, 0)] * (self.values.ndim - 1)])
        behind = self.behind and (self.behind[0] + 1, self.behind[1])
        return replace(self, values=values, behind=behind)


def hold_backward_waves(medium: LatticeMedium, data: Sequence[Datum], wanted: float) -> bool:
    """Whether the data contain a significant amount of backward waves, so that all modes of the chain in front of a
    side have to be followed. In a medium that varies they are not followed, and for vectors only in the plane.
    """
    stencil = medium.stencil
    plane = stencil.components == stencil.dim == 2 and all(stencil.even_along(axis) for axis in range(2))
    damped = high_pass(stencil) if stencil.components == 1 or plane else None
    if damped is None or weak(damped):
        return False
    first = damped.first * (TURNING if stencil.components == 1 else 1.0)
    return any(share_of_short(medium, datum, first) > _FELT_BACKWARD * wanted for datum in data)


def share_of_short(medium: LatticeMedium, datum: Datum, first: float) -> float:
    """Return the share of a datum in waves from a wavenumber times spacing `first` on; for a source, of the waves it
    radiates.
    """
    if not datum.values.any():
        return 0.0
    line = np.linspace(first, np.pi, 9)
    symbol = medium.stencil.symbol(line, *[np.zeros_like(line)] * (medium.stencil.dim - 1))
    values = symbol if medium.stencil.components == 1 else np.linalg.eigvalsh(symbol).ravel()
    return float(short_share(datum.values, first) * briskness(medium, values, datum.time))


def reach_the_end(medium: LatticeMedium, data: Sequence[Datum], wanted: float) -> bool:
    """Whether data near the end of a line also reach the layer significantly through modes that do not travel. A layer
    amplifies some of these, so that all modes then have to be followed. Along a side, long waves at grazing incidence
    matter more than these modes.
    """
    if medium.stencil.dim > 1 or medium.stencil.reach[0] == 1:
        return False
    roots = all_modes(medium, np.array([_STATIC * medium.rate + 0j]), np.zeros((0, 1)))[0]
    fall = np.sort(np.abs(roots.ravel()))[-2]
    sizes = [np.abs(datum.values) for datum in data if datum.values.any()]
    return any(size[::-1] @ fall ** np.arange(len(size)) > _FELT_BACKWARD * wanted * size.max() for size in sizes)


def frequency_of_slow_waves(medium: LatticeMedium, speed: float) -> float:
    """Return the frequency above which no wave is faster than a speed; the largest frequency if no wave is that slow.

    Waves of the largest frequency stand still, and those of nearby frequencies travel slowly, forward and backward.
    """
    _, values, slopes = medium.stencil.zone_branches
    turn = np.minimum(medium.dt * np.sqrt(np.maximum(medium.rate * values, 0.0)) / 2, 1.0)
    # group velocity of the discrete scheme: d(omega)/dk with sin(omega dt / 2) = turn
    rise = medium.spacing * medium.rate * np.sqrt(sum(slope**2 for slope in slopes)) * medium.dt
    fast = rise > speed * 4 * turn * np.sqrt(1 - turn**2)
    return float(2 * np.arcsin(turn[fast].max(initial=0.0)) / medium.dt)


def briskness(medium: LatticeMedium, eigenvalues: np.ndarray, course: np.ndarray) -> float:
    """Largest amplitude that a source with a given time function radiates in waves of some eigenvalues of the symbol,
    over that of a source that is switched on at once; 1 for initial data.

    A field that follows its source slowly contains no waves: their amplitude is that of the changes of the source at
    their frequency.
    """
    if not course.any():
        return 1.0
    turns = np.angle([factor_of_wave(-medium.rate * float(one), medium.recursion) for one in eigenvalues])
    changes = np.diff(course, prepend=0.0)
    heard = np.abs(np.exp(-1j * np.outer(turns, np.arange(len(course)))) @ changes).max()
    return min(1.0, float(heard / np.abs(course).max()))
