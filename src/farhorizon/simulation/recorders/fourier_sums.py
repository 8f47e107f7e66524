"""Fourier sums of values that are recorded step by step, at chosen frequencies: memory by frequency, not by time."""

from __future__ import annotations

import numpy as np
from scipy.linalg.blas import dgemm

_TINY = float(np.finfo(float).tiny)
BLOCK = 64  # steps that are summed by one product of matrices


class FourierSums:
    """``sum over steps n of dt * values(n) * exp(-2 pi i f n dt)`` of some values, the convention of `numpy.fft`.

    Steps are summed in blocks that begin at multiples of their length, so that a run which is saved and continued at
    any step has the same sums to the last bit. Frequencies are in cycles per time, `count` is the number of values per
    step; with `every`, samples of so many steps stand for all.
    """

    def __init__(self, frequencies: np.ndarray, dt: float, count: int, every: int = 1) -> None:
        self.frequencies, self.dt, self._every = np.asarray(frequencies, float), every * dt, every
        self._rows = np.zeros((BLOCK, count))
        self.clear()

    def clear(self) -> None:
        """Begin anew."""
        self._first, self._held = 0, 0  # samples that are not summed yet: the first one, and how many
        self._sums = np.zeros((2 * len(self.frequencies), self._rows.shape[1]))  # with cosines, then with sines

    def add(self, step: int, values: np.ndarray) -> None:
        """Take the values of the steps from number `step` on, each one once and in order, shape (steps, ...)."""
        if not self.frequencies.size:
            return
        samples = values[-step % self._every :: self._every]
        step, rows = -(-step // self._every), samples.reshape(len(samples), self._rows.shape[1])
        if not self._held:
            self._first = step
        done = 0
        while done < len(rows):
            end = done + min(BLOCK - (self._first + self._held) % BLOCK, len(rows) - done)
            complete = (self._first + self._held + end - done) % BLOCK == 0
            block = rows[done:end]
            if self._held or not complete:
                self._rows[self._held : self._held + end - done] = block
                self._held += end - done
                block = self._rows[: self._held]
            if complete:
                # one call that adds in place: forming the product first would take half as long again
                factors = self._factors(self._first, len(block))
                self._sums = dgemm(1.0, block.T, factors.T, 1.0, self._sums.T, overwrite_c=True).T
                self._first, self._held = self._first + len(block), 0
            done = end

    def _factors(self, step: int, count: int) -> np.ndarray:
        """Return the cosines and sines of some steps, times dt, shape (2 F, count)."""
        cycles = np.outer(self.frequencies * self.dt, step + np.arange(count))
        phases = 2 * np.pi * (cycles - np.round(cycles))  # small arguments stay accurate in long runs
        return self.dt * np.concatenate([np.cos(phases), np.sin(phases)])

    @property
    def values(self) -> np.ndarray:
        """The sums so far, complex, shape (F, count)."""
        sums = self._sums + self._factors(self._first, self._held) @ self._rows[: self._held]
        return sums[: len(self.frequencies)] - 1j * sums[len(self.frequencies) :]

    def state(self) -> dict[str, np.ndarray]:
        """Return the state, from which `take` continues."""
        return {"first": np.array(self._first), "rows": self._rows[: self._held], "sums": self._sums}

    def take(self, state: dict[str, np.ndarray]) -> None:
        """Restore a state returned by `state`."""
        self._first, self._held, self._sums = int(state["first"]), len(state["rows"]), state["sums"].copy()
        self._rows[: self._held] = state["rows"]


class SampledSums:
    """Fourier sums of samples taken every few steps, with an estimate of their difference from the sums of all steps.

    Anything too fast for the samples is aliased to lower frequencies. The error is estimated from a combination of all
    values with random signs, of which alone all steps are summed as well.
    """

    def __init__(self, frequencies: np.ndarray, dt: float, every: int, count: int) -> None:
        self.frequencies, self._every = frequencies, every
        self._sums, self._all_steps = FourierSums(frequencies, dt, count, every), FourierSums(frequencies, dt, 1)
        self._signs = np.random.default_rng(count).choice([-1.0, 1.0], count)

    def clear(self) -> None:
        """Begin anew."""
        self._sums.clear()
        self._all_steps.clear()

    def add(self, step: int, values: np.ndarray) -> None:
        """Take the values of the steps from number `step` on, each one once and in order, shape (steps, count)."""
        self._sums.add(step, values)
        if self._every > 1:
            self._all_steps.add(step, np.einsum("tn,n->t", values, self._signs)[:, None])

    @property
    def values(self) -> np.ndarray:
        """The sums so far, complex, shape (F, count)."""
        return self._sums.values

    @property
    def missed(self) -> float:
        """Largest difference from the sums of all steps over the largest of these, estimated; 0 if all are sampled."""
        if self._every == 1:
            return 0.0
        of_all = self._all_steps.values[:, 0]
        return float(np.abs(self.values @ self._signs - of_all).max() / max(np.abs(of_all).max(), _TINY))

    @property
    def _parts(self) -> tuple[tuple[str, FourierSums], ...]:
        return ("sums.", self._sums), ("whole.", self._all_steps)

    def state(self) -> dict[str, np.ndarray]:
        """Return the state, from which `take` continues."""
        return {f"{part}{name}": array for part, sums in self._parts for name, array in sums.state().items()}

    def take(self, state: dict[str, np.ndarray]) -> None:
        """Restore a state returned by `state`."""
        for part, sums in self._parts:
            sums.take({name.removeprefix(part): array for name, array in state.items() if name.startswith(part)})
