"""Compression of the exact boundary's force kernel to a sum of exponentials: a few states a side, and a step that costs the same at all times.

    M[a] = Re sum over p of b_p c_p^T z_p^a,   a = 1, 2, ..

The half-infinite chain has one wave that propagates, so each exponential has one input and one output vector (rank 1). The poles are found by
the eigensystem realisation algorithm (Juang and Pappa, J. Guidance 8 (1985) 620) on samples of the kernel as far apart as its band of frequencies
allows; the output vectors are fitted anew to all scales of time, from the first steps to the last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from farhorizon.errors import InputError


@dataclass(frozen=True)
class ExponentialSum:
    """A force kernel as a sum of exponentials; one pole stands for itself and its conjugate.

    A run keeps one complex state y_p a mode, zero at the start. With the state y at step n, ``force(y)`` is the ghosts' share
    of the acceleration at step n, and ``advance(y, u, h)`` leads to step n + 1 from the drivers' values u at step n; h = 1 except at
    step 0, where it is `chain.Recursion.first`.

    Attributes
    ----------
    poles : ndarray of complex, shape (P,)
        z_p, not beyond the unit circle.
    inputs, outputs : ndarray of complex, shape (P, K)
        c_p and b_p.
    steps : int
        The sum was fitted to, and holds for, so many steps.
    error : float
        Largest error of the force that all drivers exert by a stay at 1 from any step to any other, relative to the boundary's stiffness.
        The error of a run, relative to its largest value, is about the same.
    """

    poles: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    steps: int
    error: float

    @property
    def modes(self) -> int:
        """Number of complex states."""
        return self.poles.size

    def kernel(self, lags: np.ndarray) -> np.ndarray:
        """M at some lags >= 1; shape (lags, K, K)."""
        powers = _powers(self.poles, np.asarray(lags))
        return np.matmul((powers[:, None, :] * self.outputs.T), self.inputs).real

    def advance(self, state: np.ndarray, drivers: np.ndarray, weight: float = 1.0) -> np.ndarray:
        """States one step later, ``z (y + weight c . u)``; shape (P,)."""
        return self.poles * (state + weight * (self.inputs @ drivers))

    def force(self, state: np.ndarray) -> np.ndarray:
        """``Re sum_p b_p y_p``, acceleration of the drivers 1 .. K; shape (K,)."""
        return (state @ self.outputs).real


def _powers(poles: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """poles ** lags, shape (lags, P)."""
    with np.errstate(divide="ignore", under="ignore"):
        return np.exp(np.multiply.outer(lags, np.log(poles.astype(complex))))


def _hankel_times(spectrum: np.ndarray, columns: np.ndarray, length: int) -> np.ndarray:
    """Block Hankel matrix of samples 1 .. 2 n - 1 (transformed: `spectrum`) times columns of shape (n, K, r)."""
    n = len(columns)
    product = spectrum @ fft.rfft(columns[::-1], length, axis=0)
    return fft.irfft(product, length, axis=0)[n - 1 : 2 * n - 1]


def _hankel_eigenvectors(samples: np.ndarray, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest eigenvalues (by modulus, falling) and eigenvectors of the symmetric block Hankel matrix of samples 1 .. 2 n - 1.

    Subspace iteration from a random start (Halko, Martinsson and Tropp, SIAM Review 53 (2011) 217).
    """
    n, reach = (len(samples) + 1) // 2, samples.shape[1]
    length = fft.next_fast_len(3 * n, real=True)
    spectrum = fft.rfft(samples[: 2 * n - 1], length, axis=0)
    rank = min(rank, n * reach)
    basis = np.random.default_rng(1).standard_normal((n * reach, min(rank + 10, n * reach)))

    def times(x: np.ndarray) -> np.ndarray:
        return _hankel_times(spectrum, x.reshape(n, reach, -1), length).reshape(n * reach, -1)

    for _ in range(3):
        basis, _ = np.linalg.qr(times(basis))
    small = basis.T @ times(basis)
    values, vectors = np.linalg.eigh((small + small.T) / 2)
    order = np.argsort(-np.abs(values))[:rank]
    return values[order], basis @ vectors[:, order]


def _poles(samples: np.ndarray, values: np.ndarray, vectors: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Poles of the sampled kernel and their input vectors at an order, from the shift invariance of the Hankel eigenvectors."""
    reach = samples.shape[1]
    up, down, last = vectors[:-reach, :order], vectors[reach:, :order], vectors[-reach:, :order]
    root = np.sqrt(np.abs(values[:order]))
    shift = np.linalg.solve(np.eye(order) - last.T @ last, up.T @ down) * root / root[:, None]
    poles, modes = np.linalg.eig(shift)
    used = (poles.imag >= -1e-14) & (np.abs(poles) > 1e-12)
    inputs = ((vectors[:reach, :order] * root) @ modes[:, used]).T
    return poles[used], inputs / np.linalg.norm(inputs, axis=1)[:, None]


def _fit_outputs(kernel: np.ndarray, lags: np.ndarray, poles: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Output vectors of least squared error over time, from samples at `lags`, each weighted with the lags it stands for."""
    weight = np.sqrt(np.gradient(lags.astype(float)))
    modes = _powers(poles, lags)[:, None, :] * inputs.T * weight[:, None, None]
    count = poles.size
    matrix = np.concatenate([modes.real, -modes.imag], 2).reshape(-1, 2 * count)
    target = (kernel[lags] * weight[:, None, None]).swapaxes(1, 2).reshape(len(matrix), -1)
    found = np.linalg.lstsq(matrix, target, rcond=1e-15)[0]
    return found[:count] + 1j * found[count:]


def _drift(kernel_sums: np.ndarray, found: ExponentialSum) -> float:
    """Largest error of the force that all drivers exert by a stay at 1 from any step to any other, before division by the stiffness."""
    steps, total = len(kernel_sums) - 1, np.zeros(kernel_sums.shape[1])
    low, high = total, total
    held = found.outputs * found.inputs.sum(1)[:, None]
    for start in range(1, steps + 1, 8192):
        lags = np.arange(start, min(start + 8192, steps + 1))
        error = total + np.cumsum((_powers(found.poles, lags) @ held).real - kernel_sums[lags], 0)
        total, low, high = error[-1], np.minimum(low, error.min(0)), np.maximum(high, error.max(0))
    return float((high - low).max())


def compress(kernel: np.ndarray, tolerance: float = 1e-12, band: float = np.pi, most: int = 64) -> ExponentialSum:
    """The shortest sum of exponentials that meets a tolerance, or the best one if none does (its `error` says so).

    Parameters
    ----------
    kernel : ndarray, shape (steps + 1, K, K)
        Force kernel M (`chain.force_form`).
    tolerance : float
        Wanted `ExponentialSum.error`.
    band : float
        Largest angle a step of the kernel's oscillations (`chain.band`); the kernel is sampled as sparsely as it allows.
    most : int
        Largest number of modes.

    Raises
    ------
    InputError
        A kernel that is not symmetric, too short a kernel, a tolerance that is not positive.
    """
    steps = len(kernel) - 1
    if kernel.ndim != 3 or kernel.shape[1] != kernel.shape[2] or np.abs(kernel - kernel.swapaxes(1, 2)).max() > 1e-12 * np.abs(kernel).max():
        raise InputError("only a symmetric force kernel can be compressed", value=kernel.shape, limit="(steps + 1, K, K)", remedy="chain.force_form")
    if not tolerance > 0:
        raise InputError("the tolerance must be positive", value=tolerance, limit="> 0", key="compress")
    if steps < 8:
        raise InputError("too few steps to compress a kernel", value=steps, limit=">= 8", remedy="evaluate the convolution directly")
    sums = kernel.sum(2)
    stiffness = float(np.abs(np.cumsum(sums, 0)).max())
    best: ExponentialSum | None = None
    stride = max(1, min(int(0.8 / band), steps // 40))
    while True:
        found = _compress_sampled(kernel, sums, stiffness, tolerance, stride, most)
        if best is None or found.error < best.error:
            best = found
        if best.error <= tolerance or stride == 1:
            return best
        stride //= 2


def _compress_sampled(kernel: np.ndarray, sums: np.ndarray, stiffness: float, tolerance: float, stride: int, most: int) -> ExponentialSum:
    """`compress` for poles found on every stride-th sample."""
    steps = len(kernel) - 1
    samples = kernel[stride::stride]
    values, vectors = _hankel_eigenvectors(samples, 2 * most)
    lags = np.unique(np.concatenate([np.arange(1, min(steps, 8 * stride + 64) + 1), np.geomspace(1, steps, 800).round().astype(int)]))
    size = np.abs(values) / abs(values[0])
    start = max(2, int((size > 100 * tolerance).sum()))
    best: ExponentialSum | None = None
    for order in range(start, len(values) + 1):
        poles, inputs = _poles(samples, values, vectors, order)
        poles = poles ** (1 / stride)
        poles = poles / np.maximum(np.abs(poles), 1.0)  # one that would grow is put on the circle, and the outputs fitted to it
        outputs = _fit_outputs(kernel, lags, poles, inputs)
        found = ExponentialSum(poles, inputs, outputs, steps, np.inf)
        found = ExponentialSum(poles, inputs, outputs, steps, _drift(sums, found) / stiffness)
        if best is None or found.error < best.error:
            best = found
        if best.error <= tolerance or size[order - 1] < 1e-15:
            break
    assert best is not None
    return best
