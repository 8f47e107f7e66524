"""Probes: the field u at some nodes, step by step."""

from __future__ import annotations

from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.geometry.lattice import Lattice


class Probes:
    """Values recorded by a run at some nodes, after every step or every few steps; created by `Run.record`.

    Parameters
    ----------
    lattice : Lattice
    points : array_like, shape (n, dim), or (n,) in 1D
        Each point is replaced by the nearest node.
    stride : int
        Steps from one row to the next.

    Attributes
    ----------
    places : ndarray, shape (n, dim)
        Coordinates of the nodes that are used.
    nodes : ndarray of int, shape (n,)
        Their flat indices in the lattice.

    Raises
    ------
    InputError
        A point outside the near field.

    Examples
    --------
    >>> import farhorizon as fh
    >>> sim = fh.Simulation(fh.Lattice(1.0, -9, 9), fh.Wave(fh.Kernel(1.0)), initial={"u": "exp(-x**2)"})
    >>> probes = sim.record([0.0, 4.0])
    >>> sim.step(6)
    >>> probes.values.shape
    (7, 2)
    """

    def __init__(self, lattice: Lattice, points: Any, stride: int = 1) -> None:
        kinds.instance(lattice, "lattice", Lattice, "a Lattice")
        stride, given = kinds.integer(stride, "stride", least=1), kinds.array(points, "probes")
        if given.ndim < 2 and (lattice.dim == 1 or not given.size):  # numbers along a line, or none at all
            given = given.reshape(-1, lattice.dim)
        asked = kinds.array(np.atleast_2d(given), "probes", shape=(None, lattice.dim))
        found = np.array([lattice.index(point, "probes") for point in asked], int).reshape(-1, lattice.dim)
        self.places, self.stride = lattice.lower + lattice.spacing * found, stride
        self.nodes = np.ravel_multi_index(tuple(found.T), lattice.shape) if len(found) else np.zeros(0, int)
        apart = np.abs(self.places - asked).max(1, initial=0) > 1e-6 * lattice.spacing
        pairs = zip(asked[apart].tolist(), self.places[apart].round(12).tolist(), strict=True)
        self.notes = [f"the probe at {point} is recorded at the nearest node, {place}" for point, place in pairs]
        self._steps: list[np.ndarray] = []
        self._rows: list[np.ndarray] = []
        self._dt = 0.0

    def add(self, step: int, dt: float, rows: np.ndarray) -> None:
        """Record the values after the steps from number `step` on, shape (steps, n[, components])."""
        steps = step + np.arange(len(rows))
        kept = steps % self.stride == 0
        self._steps.append(steps[kept])
        self._rows.append(rows[kept])
        self._dt = dt

    @property
    def times(self) -> np.ndarray:
        """Times of the rows, shape (rows,)."""
        return np.concatenate([np.zeros(0), *self._steps]) * self._dt

    @property
    def values(self) -> np.ndarray:
        """Values, shape (rows, n[, components])."""
        return np.concatenate(self._rows) if self._rows else np.zeros((0, len(self.nodes)))

    def take(self) -> tuple[np.ndarray, np.ndarray]:
        """Return times and values since the last call, and discard them here."""
        found = self.times, self.values
        self._steps, self._rows = [], [found[1][:0]]
        return found
