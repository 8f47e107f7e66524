"""Exact online convolution with a matrix kernel, whose result determines the next sample: block by block, with the past
by FFT.
"""

from __future__ import annotations

import numpy as np
from scipy import fft

from farhorizon.errors import InputError


class BlockConvolution:
    """``sum over a = 1 .. n of kernel[a] x[n - a]`` for a kernel (steps + 1, K, M) while the samples x arrive, at a
    cost of steps log^2 steps; with `block` None by the direct sum.

    Within a block of steps the caller adds the products with the block's own samples from `head` (block, K, M); the
    contribution of all earlier blocks is in `past`. At the end of block n the last L blocks of samples, L the largest
    power of two that divides n, act by FFT on the next L (Hairer, Lubich and Schlichte, SIAM J. Sci. Stat. Comput. 6
    (1985) 532): nothing is approximated.
    """

    def __init__(self, kernel: np.ndarray, block: int | None = 64) -> None:
        steps = len(kernel) - 1
        self.steps, self.block = steps, steps + 1 if block is None else block
        if self.block < 1 or kernel.ndim != 3:
            raise InputError(
                "a convolution needs a kernel of shape (steps + 1, K, M) and a block of one step or more",
                value=(kernel.shape, block),
            )
        self.kernel = kernel
        blocks = -(-(steps + 1) // self.block)
        self.head = np.zeros((self.block, *kernel.shape[1:]))
        known = min(self.block, steps + 1)
        self.head[1:known] = kernel[1:known]
        self._history = np.zeros((blocks * self.block, kernel.shape[2]))
        self._force = np.zeros((blocks * self.block, kernel.shape[1]))
        self._spectra: dict[int, np.ndarray] = {}
        self._number = 0

    @property
    def past(self) -> np.ndarray:
        """Contribution of all earlier blocks to the current one, shape (block, K)."""
        return self._force[self._number * self.block : (self._number + 1) * self.block]

    @property
    def samples(self) -> np.ndarray:
        """Samples of the current block, shape (block, M), to be written by the caller."""
        return self._history[self._number * self.block : (self._number + 1) * self.block]

    def _spectrum(self, length: int) -> np.ndarray:
        if length not in self._spectra:
            part = np.zeros((2 * length, *self.kernel.shape[1:]))
            known = min(2 * length, self.steps + 1)
            part[1:known] = self.kernel[1:known]
            self._spectra[length] = fft.rfft(part, axis=0)
        return self._spectra[length]

    def next_block(self) -> None:
        """Close the current block, all samples of which have been written, and compute `past` for the next one; an
        InputError where the kernel ends.
        """
        self._number += 1
        end = self._number * self.block
        if end >= len(self._history):
            raise InputError(
                "the run outlives its kernel", value=end, limit=f"{self.steps} steps", remedy="a kernel of more steps"
            )
        length = (self._number & -self._number) * self.block
        source = fft.rfft(self._history[end - length : end], 2 * length, axis=0)
        result = fft.irfft(np.matmul(self._spectrum(length), source[:, :, None])[:, :, 0], 2 * length, axis=0)[length:]
        rows = min(length, len(self._force) - end)
        self._force[end : end + rows] += result[:rows]

    def extended(self, kernel: np.ndarray) -> BlockConvolution:
        """The same history with a kernel of more steps, at the same step of the same block."""
        longer = BlockConvolution(kernel, self.block)
        for number in range(self._number):
            longer.samples[:] = self._history[number * self.block : (number + 1) * self.block]
            longer.next_block()
        longer.samples[:] = self.samples
        return longer
