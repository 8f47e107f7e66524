"""Smoothing of maps, and what a rough map costs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter


@dataclass(frozen=True, eq=False)
class Smoothing:
    """Means of values under a Gaussian with a standard deviation in spacings, over the nodes that exist."""

    width: float
    exists: np.ndarray

    def _spread(self, values: np.ndarray) -> np.ndarray:
        return np.asarray(gaussian_filter(np.where(self.exists, values, 0.0), self.width, mode="constant"))

    @property
    def _whole(self) -> np.ndarray:
        return np.where(self.exists, self._spread(np.ones(self.exists.shape)), 1.0)

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Return the smooth values: between the least and the largest of those given."""
        return self._spread(values) / self._whole if self.width else values

    def transposed(self, slopes: np.ndarray) -> np.ndarray:
        """Return the derivative by the given values, from that by the smooth ones."""
        return self._spread(slopes / self._whole) * self.exists if self.width else slopes


def roughness(
    values: np.ndarray, region: np.ndarray, tikhonov: float, variation: float, floor: float
) -> tuple[float, np.ndarray]:
    """Return a penalty on differences between neighbours in a region, and its derivative: the mean of ``tikhonov / 2
    sum d^2 + variation (sqrt(sum d^2 + floor^2) - floor)`` with the differences d ahead of a node along each axis. The
    sum of squares prefers smooth maps, the total variation allows edges.
    """
    count, slope = max(1, int(region.sum())), np.zeros(values.shape)
    ahead, squares = [], np.zeros(values.shape)
    for axis in range(values.ndim):
        low = tuple(slice(None, -1) if a == axis else slice(None) for a in range(values.ndim))
        high = tuple(slice(1, None) if a == axis else slice(None) for a in range(values.ndim))
        step = np.where(region[low] | region[high], values[high] - values[low], 0.0)
        ahead.append((low, high, step))
        squares[low] += step**2
    length = np.sqrt(squares + floor**2)
    total = tikhonov / 2 * squares.sum() + variation * (length - floor).sum()
    for low, high, step in ahead:
        pull = (tikhonov + variation / length[low]) * step
        slope[high] += pull
        slope[low] -= pull
    return float(total) / count, slope / count
