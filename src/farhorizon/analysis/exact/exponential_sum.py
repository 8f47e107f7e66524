"""Compression of the exact boundary's force kernel to a sum of exponentials: a few states per side, and a step that
costs the same at all times.

    M[a] = Re sum over p of b_p c_p^T z_p^a,   a = 1, 2, ..

The half-infinite chain has one wave that propagates, so each exponential has one input and one output vector (rank 1).
The poles are found by the eigensystem realisation algorithm (Juang and Pappa, J. Guidance 8 (1985) 620) from samples of
the kernel as far apart as its band of frequencies allows; both vectors are then fitted to all time scales, from the
first steps to the last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from farhorizon.errors import InputError
from farhorizon.machine import one_blas_thread
from farhorizon.rounding import EQUAL, TINY

_NOISE = 1e-14  # eigenvalues of the Hankel matrix below this part of the largest are close to rounding
_LAGS = 1024  # at a time: with a number for each of 64 modes, a megabyte
_FIRST_RANK = 64  # number of eigenvectors that are computed first; all of them only where these are insufficient
_PATIENCE = 8  # orders tried below it without halving the error


@dataclass(frozen=True)
class ExponentialSum:
    """A force kernel as a sum of exponentials; each pole represents itself and its conjugate.

    A run keeps one complex state y_p per mode, zero at the start. With the state y at step n, ``force(y)`` is the
    ghosts' part of the acceleration at step n, and ``advance(y, u, h)`` gives the state at step n + 1 from the drivers'
    values u at step n; h = 1 except at step 0, where it is `chain.Recursion.first`.
    """

    poles: np.ndarray  # z_p, inside or on the unit circle, (P,)
    inputs: np.ndarray  # c_p, (P, K)
    outputs: np.ndarray  # b_p, (P, K)
    steps: int  # to which the sum was fitted, and for which it holds
    error: float  # `force_error` relative to the kernel

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
        """``Re sum_p b_p y_p``, the acceleration of the drivers 1 .. K; shape (K,)."""
        return (state @ self.outputs).real

    def replay(self, samples: np.ndarray) -> np.ndarray:
        """States at step n, (P,), after a history of the drivers' values at steps 0 .. n - 1, (n, K), the first
        multiplied by its weight: with these a run continues when its sum is replaced by one of more steps.
        """
        state = np.zeros(self.modes, complex)
        for start in range(0, len(samples), _LAGS):
            part = samples[start : start + _LAGS]
            powers = _powers(self.poles, np.arange(len(part), 0, -1))
            state = powers[0] * state + (powers * (part @ self.inputs.T)).sum(0)
        return state


def _powers(poles: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """poles ** lags, shape (lags, P)."""
    with np.errstate(divide="ignore", under="ignore"):
        return np.exp(np.multiply.outer(lags, np.log(poles.astype(complex))))


def _sums(poles: np.ndarray, count: int) -> np.ndarray:
    """``sum over a = 1 .. count of poles^a``, shape (P,)."""
    rate = np.log(np.where(poles == 0, TINY, poles).astype(complex))
    constant = np.abs(rate) < 1e-12
    rate = np.where(constant, -1.0, rate)
    with np.errstate(under="ignore"):
        return np.where(constant, count, poles * np.expm1(count * rate) / np.expm1(rate))


def _hankel_times(spectrum: np.ndarray, columns: np.ndarray, length: int) -> np.ndarray:
    """Block Hankel matrix of samples 1 .. 2 n - 1 (transformed: `spectrum`) times columns of shape (n, K, r)."""
    n = len(columns)
    product = spectrum @ fft.rfft(columns[::-1], length, axis=0)
    return fft.irfft(product, length, axis=0)[n - 1 : 2 * n - 1]


def _hankel_eigenvectors(samples: np.ndarray, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest eigenvalues (in modulus, descending) and eigenvectors of the symmetric block Hankel matrix of samples 1
    .. 2 n - 1, by subspace iteration from a random start (Halko, Martinsson and Tropp, SIAM Review 53 (2011) 217).
    """
    n, reach = (len(samples) + 1) // 2, samples.shape[1]
    length = fft.next_fast_len(3 * n, real=True)
    spectrum = fft.rfft(samples[: 2 * n - 1], length, axis=0)
    rank = min(rank, n * reach)
    basis = np.random.default_rng(1).standard_normal((n * reach, min(rank + 10, n * reach)))  # ten more, as there

    def times(x: np.ndarray) -> np.ndarray:
        return _hankel_times(spectrum, x.reshape(n, reach, -1), length).reshape(n * reach, -1)

    for _ in range(3):
        basis, _ = np.linalg.qr(times(basis))
    small = basis.T @ times(basis)
    values, vectors = np.linalg.eigh((small + small.T) / 2)
    order = np.argsort(-np.abs(values))[:rank]
    return values[order], basis @ vectors[:, order]


def _poles(samples: np.ndarray, values: np.ndarray, vectors: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Poles of the sampled kernel and their input vectors for a given order, from the shift invariance of the Hankel
    eigenvectors.
    """
    reach = samples.shape[1]
    up, down, last = vectors[:-reach, :order], vectors[reach:, :order], vectors[-reach:, :order]
    root = np.sqrt(np.abs(values[:order]))
    shift = np.linalg.solve(np.eye(order) - last.T @ last, up.T @ down) * root / root[:, None]
    poles, modes = np.linalg.eig(shift)
    # poles at 0 last one lag; of two conjugates, which rounding leaves apart by less than 1e-14, one is used
    used = (poles.imag >= -1e-14) & (np.abs(poles) > 1e-12)
    return poles[used], _unit(((vectors[:reach, :order] * root) @ modes[:, used]).T)


def _fit_vectors(kernel: np.ndarray, lags: np.ndarray, poles: np.ndarray, other_vectors: np.ndarray) -> np.ndarray:
    """Vectors b_p (P, K) with the least squared error over time, for given poles and vectors c_p on their other side.

    Each of the samples at `lags` has the weight of the lags that it represents. The sum over all lags, the force of a
    constant history, is an additional sample, because the field accumulates its error from step to step.
    """
    weight = np.sqrt(np.gradient(lags.astype(float)))
    modes = (
        np.concatenate([_powers(poles, lags) * weight[:, None], _sums(poles, len(kernel) - 1)[None]])[:, None, :]
        * other_vectors.T
    )
    count = poles.size
    matrix = np.concatenate([modes.real, -modes.imag], 2).reshape(-1, 2 * count)
    samples = np.concatenate([kernel[lags] * weight[:, None, None], kernel[1:].sum(0)[None]])
    target = samples.swapaxes(1, 2).reshape(len(matrix), -1)
    vectors = np.linalg.lstsq(matrix, target, rcond=1e-15)[0]
    return vectors[:count] + 1j * vectors[count:]


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Rows divided by their norms."""
    size = np.linalg.norm(vectors, axis=1)[:, None]
    return vectors / np.where(size > 0, size, 1.0)


def _fit(kernel: np.ndarray, lags: np.ndarray, poles: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Input and output vectors for all time scales, by three alternating fits that begin with those of the Hankel
    matrix: the kernel is symmetric, so that each fit may take the vectors on one side as known and determine those on
    the other.
    """
    for _ in range(2):
        inputs = _unit(_fit_vectors(kernel, lags, poles, inputs))
    return inputs, _fit_vectors(kernel, lags, poles, inputs)


def force_error(kernel: np.ndarray, approximation: ExponentialSum, lags: np.ndarray | None = None) -> float:
    """Largest error of the force on any driver over all histories within -1 .. 1, relative to the largest such force of
    the kernel (steps + 1, K, K) itself: the sum over lags and drivers of the modulus of the difference; from some
    `lags`, if given, each with the weight of those that it represents.
    """
    all_lags = np.arange(1, len(kernel)) if lags is None else lags
    weight = np.ones(all_lags.size) if lags is None else np.gradient(lags.astype(float))
    error, size = np.zeros((2, *kernel.shape[1:]))
    for start in range(0, all_lags.size, 4 * _LAGS):
        part = slice(start, start + 4 * _LAGS)
        at = all_lags[part]
        error += np.tensordot(weight[part], np.abs(approximation.kernel(at) - kernel[at]), 1)
        size += np.tensordot(weight[part], np.abs(kernel[at]), 1)
    return float(error.sum(1).max() / size.sum(1).max())


@one_blas_thread()
def compress(kernel: np.ndarray, tolerance: float = 1e-12, band: float = np.pi, most: int = 64) -> ExponentialSum:
    """The shortest sum of exponentials of at most `most` modes whose `ExponentialSum.error` meets a tolerance, or the
    best one; an InputError for a force kernel (`chain.force_form`) that is not symmetric or too short. It is sampled as
    sparsely as its oscillations allow, whose largest angle per step is `band`; less than a hundred steps do not
    determine the poles.
    """
    steps = len(kernel) - 1
    if (
        kernel.ndim != 3
        or kernel.shape[1] != kernel.shape[2]
        or np.abs(kernel - kernel.swapaxes(1, 2)).max() > EQUAL * np.abs(kernel).max()
    ):
        raise InputError(
            "only a symmetric force kernel can be compressed",
            value=kernel.shape,
            limit="(steps + 1, K, K)",
            remedy="chain.force_form",
        )
    if not tolerance > 0:
        raise InputError("the tolerance must be positive", value=tolerance, limit="> 0", key="compress")
    if steps < 8:
        raise InputError(
            "too few steps to compress a kernel", value=steps, limit=">= 8", remedy="evaluate the convolution directly"
        )
    best, complete = _search(kernel, tolerance, band, min(most, _FIRST_RANK // 2))
    if best.error > tolerance and not complete:
        best, _ = _search(kernel, tolerance, band, most)
    return best


def _search(kernel: np.ndarray, tolerance: float, band: float, most: int) -> tuple[ExponentialSum, bool]:
    """`compress` with orders up to 2 `most`, and whether a higher order would be useless."""
    steps = len(kernel) - 1
    stride = _stride(steps, band)
    samples = kernel[stride::stride]
    values, vectors = _hankel_eigenvectors(samples, 2 * most)
    lags = np.unique(
        np.concatenate([np.arange(1, min(steps, 8 * stride + 64) + 1), np.geomspace(1, steps, 800).round().astype(int)])
    )
    size = np.abs(values) / abs(values[0])
    best: ExponentialSum | None = None
    improved_at, complete = 0, False  # the last order that halved the error
    for order in range(min(max(2, int((size > 100 * tolerance).sum())), len(values)), len(values) + 1):
        complete = best is not None and bool(size[order - 1] < _NOISE) and order > improved_at + _PATIENCE
        if complete:
            break
        poles, inputs = _poles(samples, values, vectors, order)
        poles = poles ** (1 / stride)
        # poles that would grow are moved onto the unit circle before the vectors are fitted
        poles = poles / np.maximum(np.abs(poles), 1.0)
        inputs, outputs = _fit(kernel, lags, poles, inputs)
        sum_of_order = ExponentialSum(poles, inputs, outputs, steps, np.inf)
        error = force_error(kernel, sum_of_order, lags)
        if error <= tolerance:
            error = force_error(kernel, sum_of_order)
        sum_of_order = ExponentialSum(poles, inputs, outputs, steps, error)
        if error <= tolerance:
            return sum_of_order, True
        if best is None or error < best.error / 2:
            best, improved_at = sum_of_order, order
    assert best is not None
    return ExponentialSum(best.poles, best.inputs, best.outputs, steps, force_error(kernel, best)), complete


def _stride(steps: int, band: float) -> int:
    """Number of lags between two samples of the Hankel matrix: up to an eighth of a period of the fastest oscillation
    in long kernels.
    """
    # 0.8 rad is an eighth of a period; from 40 samples, which determine the poles, to 20 000, a few seconds
    finest, coarsest = int(0.4 / band), int(0.8 / band)
    return max(1, min(max(finest, steps // 20_000), coarsest, steps // 40))
