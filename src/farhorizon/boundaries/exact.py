"""Exact boundary in one dimension: the half-infinite chain beyond an end, fully discrete in time.

The chain takes the same steps as the near field, so that no error remains, see `farhorizon.analysis.exact.chain`. Its
force on the K nodes next to it (K being the reach of the stencil) depends on their entire past; a sum of exponentials
keeps the cost of a step constant.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.exact import chain, exponential_sum
from farhorizon.analysis.exact.chain import Recursion
from farhorizon.analysis.exact.convolution import BlockConvolution
from farhorizon.analysis.exact.exponential_sum import ExponentialSum
from farhorizon.boundaries.side import Side
from farhorizon.engine.engine import Engine
from farhorizon.engine.features.ends import ends_table
from farhorizon.files.cache import cache_folder, keep, kept
from farhorizon.machine import check_fits

Weights = tuple[float, ...] | tuple[tuple[float, ...], ...]

BLOCK = 64  # steps of a convolution between two returns to Python
_AIM = 0.25  # a sum is computed to this fraction of its tolerance: the field accumulates the errors of the force
_SHORTEST = 1024  # smallest number of steps for which a kernel is made
_SLOW = 1e6  # number of steps times reach squared from which making a kernel takes seconds and is announced


@dataclass(frozen=True)
class Exact(Side):
    """End of a bar beyond which the medium continues indefinitely, represented exactly; one dimension only.

    Works for every symmetric stencil, for waves with and without damping, and for diffusion by forward Euler; for
    diffusion also for stencils whose weights ahead and behind differ, so that what diffuses drifts. Beyond the end
    everything is initially zero (the background), the bonds are those of the last nodes, and there are no
    sources.

    Parameters
    ----------
    compress : float or None
        Bound on the error of the force on the last nodes, over all histories and relative to the same norm of the force
        itself, within which the history is compressed to a sum of exponentials. For smooth data the error of the field
        is of the same size; noise that fills the near field adds up to a few times as much. With None, and where no sum
        meets the bound, the history is stored and convolved: exact to rounding error, at a cost per step that grows
        with the square of the logarithm of the number of steps. So it is for stencils that drift.

    Raises
    ------
    InputError
        A value of `compress` outside 1e-15..0.1.

    Examples
    --------
    >>> import farhorizon as fh
    >>> bar = fh.Lattice(0.1, -3, 3)
    >>> sim = fh.Simulation(bar, fh.Wave(fh.Kernel(0.3)), fh.Exact(), {"u": "exp(-4*x**2)"})
    >>> _ = sim.run(until=20.0)
    >>> bool(abs(sim.fields["u"]).max() < 1e-6)  # all has left
    True
    """

    exact: ClassVar[bool] = True
    assumes = frozenset({"one component", "no losses", "one stage"})
    alone = "they sum over the whole past of the nodes at the end, step by step"
    dims: ClassVar[tuple[int, ...]] = (1,)
    compress: float | None = 1e-12

    def __post_init__(self) -> None:
        none = self.compress is None or self.compress is False  # a case file has no None
        kinds.set_fields(
            self, compress=None if none else kinds.number(self.compress, "boundary.compress", least=1e-15, most=0.1)
        )

    def wanted(self, default: float) -> float:
        """Return the fraction of the largest value that may be neglected beyond the end."""
        return 1e-15 if self.compress is None else self.compress


def _hashable(weights: np.ndarray) -> Weights:
    return tuple(weights.tolist()) if weights.ndim == 1 else tuple(map(tuple, weights.tolist()))


def _steps_of_kernel(steps: int) -> int:
    """Number of steps for which to make a kernel that must cover `steps`: powers of the square root of two, so that it
    can serve other runs.
    """
    return max(_SHORTEST, int(np.ceil(2 ** (np.ceil(2 * np.log2(max(steps, 1))) / 2))))


@lru_cache(maxsize=1)  # for the other end, and where no sum meets the tolerance; cleared by `ExactEnds.cover`
def _make_kernel(weights: Weights, recursion: Recursion, steps: int) -> np.ndarray:
    """Compute the force kernel of the chain, shape (steps + 1, K, K)."""
    a = np.array(weights)
    reach = a.shape[-1]
    size = 6 * 8.0 * (steps + 1) * reach**2  # F, M, and memory for transforms and convolutions
    check_fits(size, "the kernel of so many steps does", "boundary", "a shorter run or LatticePML", f"{steps} steps")
    if steps * reach**2 > _SLOW and sys.stderr.isatty():
        print(f"exact boundary: kernel of {steps} steps ...", file=sys.stderr)
    return chain.force_form(chain.ghost_kernel(a, recursion, steps), a)


def _cache_file(weights: np.ndarray, recursion: Recursion, steps: int, tolerance: float) -> Path:
    mark = hashlib.sha256("".join(Path(str(m.__file__)).read_text() for m in (chain, exponential_sum)).encode())
    mark.update(np.ascontiguousarray(weights).tobytes())
    mark.update(repr((recursion, steps, tolerance)).encode())
    return cache_folder() / f"exact_{mark.hexdigest()[:24]}.npz"


@lru_cache(maxsize=16)
def _compressed(weights: Weights, recursion: Recursion, steps: int, tolerance: float) -> ExponentialSum:
    """Return the kernel as a sum of exponentials, from the cache folder if it is there."""
    a = np.array(weights)
    path = _cache_file(a, recursion, steps, tolerance)
    stored = kept(path)
    if stored is not None:
        return ExponentialSum(stored["poles"], stored["inputs"], stored["outputs"], steps, float(stored["error"]))
    computed = exponential_sum.compress(
        _make_kernel(weights, recursion, steps), tolerance, chain.largest_angle(a, recursion)
    )
    keep(path, poles=computed.poles, inputs=computed.inputs, outputs=computed.outputs, error=computed.error)
    return computed


class ExactEnds:
    """Exact ends of one run, named "x-" or "x+": their sums and kernels, which are made when the run needs them, and
    again if it outlives them.

    Parameters
    ----------
    weights : (K,) or (2, K) for each, bonds beyond the end, over the mass of its nodes (`chain.half_weights`)
    masses : mass of a node beyond each end over that of a node of the model: the engine divides forces by those of its
        nodes
    nodes : (ends, K), drivers in a level of the engine, from each end inwards
    """

    def __init__(
        self,
        engine: Engine,
        names: Sequence[str],
        boundaries: Sequence[Exact],
        weights: Sequence[np.ndarray],
        masses: Sequence[float],
        recursion: Recursion,
        nodes: np.ndarray,
    ) -> None:
        self.engine, self.names, self.nodes = engine, list(names), nodes
        self.weights, self.masses = list(weights), list(masses)
        # of a sum of exponentials; none where the past is convolved, as it is where the medium drifts
        self.tolerances = [b.compress if w.ndim == 1 else None for b, w in zip(boundaries, weights, strict=True)]
        self.recursion, self.steps = recursion, 0
        engine.replace(ends=ends_table(nodes, recursion.first))
        self.sums: list[ExponentialSum | None] = [None] * len(self.names)
        self.convolutions: list[BlockConvolution | None] = [None] * len(self.names)

    @property
    def step(self) -> int:
        """Number of the next step."""
        return int(self.engine.get("ends.clock")[0])

    @property
    def convolved(self) -> bool:
        """Whether the entire past is stored at every end."""
        return all(
            tolerance is None or (self.steps > 0 and s is None)
            for tolerance, s in zip(self.tolerances, self.sums, strict=True)
        )

    def cover(self, last: int) -> None:
        """Extend the ends to `last` steps; a run under way continues from the history of its drivers."""
        if last <= self.steps:
            return
        steps = _steps_of_kernel(max(last, 2 * self.steps if self.step else 0))
        sums = [self._sum_of(i, steps) for i in range(len(self.names))]
        self._take(sums, steps)
        _make_kernel.cache_clear()

    def _sum_of(self, end: int, steps: int) -> ExponentialSum | None:
        """Return the sum of an end, or None if its past is to be convolved: as requested, because the medium drifts, or
        because no sum meets the tolerance.
        """
        tolerance = self.tolerances[end]
        if tolerance is None:
            return None
        computed = _compressed(_hashable(self.weights[end]), self.recursion, steps, _AIM * tolerance)
        return computed if computed.error <= tolerance else None

    def _take(self, sums: list[ExponentialSum | None], steps: int, history: np.ndarray | None = None) -> None:
        """Continue with these sums, and with convolutions where there is none, from a history (ends, n, K), by default
        the engine's own.
        """
        engine = self.engine
        history = np.array(engine.get("ends.history")[:, : self.step] if history is None else history)
        count, forces = history.shape[1], engine.get("ends.forces")
        kernels = {
            w.tobytes(): _make_kernel(_hashable(w), self.recursion, steps)
            for w, s in zip(self.weights, sums, strict=True)
            if s is None
        }
        poles = [
            None if s is None else (s.poles, s.inputs, mass * s.outputs)
            for s, mass in zip(sums, self.masses, strict=True)
        ]
        ends = ends_table(self.nodes, self.recursion.first, poles, BLOCK if kernels else 0)
        engine.replace(ends=ends._replace(history=history))
        engine.put("ends.clock", count)
        engine.put("ends.forces", forces)
        self.sums, self.steps = list(sums), steps
        for end, end_sum in enumerate(sums):
            if end_sum is None:
                kernel = self.masses[end] * kernels[self.weights[end].tobytes()]
                self.convolutions[end] = self._convolution(end, kernel)
            else:
                self.convolutions[end] = None
                state, half = end_sum.replay(history[end]), engine.get("ends.states").shape[1] // 2
                engine.put("ends.states", state.real, (end, slice(end_sum.modes)))
                engine.put("ends.states", state.imag, (end, slice(half, half + end_sum.modes)))

    def _convolution(self, end: int, kernel: np.ndarray) -> BlockConvolution:
        """Return a convolution that has processed the history except for the current block, which the engine holds."""
        convolution = BlockConvolution(kernel, BLOCK)
        for start in range(0, self.step - BLOCK + 1, BLOCK):
            convolution.samples[:] = self.engine.get("ends.history")[end, start : start + BLOCK]
            if start + BLOCK < self.step:
                convolution.next_block()
        self.engine.put("ends.heads", convolution.head, end)
        self.engine.put("ends.past", convolution.past, end)
        return convolution

    def allow(self, steps: int) -> int:
        """Prepare the next steps; return how many of them may be run at once."""
        self.cover(self.step + steps)
        if not self.engine.get("ends.heads").shape[1]:
            return steps
        place = self.step % BLOCK
        if place == 0 and self.step:
            for end, convolution in enumerate(self.convolutions):
                if convolution is not None:
                    convolution.samples[:] = self.engine.get("ends.history")[end, self.step - BLOCK : self.step]
                    convolution.next_block()
                    self.engine.put("ends.past", convolution.past, end)
        return min(steps, BLOCK - place)

    def describe(self, end: int, dt: float) -> str:
        """Describe the representation of an end, for the report."""
        tolerance, end_sum = self.tolerances[end], self.sums[end]
        until = f"to step {self.steps} (t = {self.steps * dt:.4g}), then recomputed"
        if not self.steps:
            return "past convolved" if tolerance is None else f"past compressed to {tolerance:g} when the run begins"
        if end_sum is not None:
            return f"{end_sum.modes} modes, error of the force <= {end_sum.error:.2g}, {until}"
        return f"past convolved, exact to rounding, {until}"

    def notes(self) -> list[str]:
        """Return notes about ends where no sum meets the tolerance."""
        missed = [
            (name, tolerance)
            for name, tolerance, s in zip(self.names, self.tolerances, self.sums, strict=True)
            if tolerance is not None and s is None
        ]
        return [
            f"no sum of exponentials meets the tolerance {c:g} at {name}: the past is convolved there"
            for name, c in missed
            if self.steps
        ]

    def forces(self) -> np.ndarray:
        """Force of each chain on its drivers at the present step, as an acceleration; shape (ends, K)."""
        engine, step = self.engine, self.step
        forces = np.zeros(self.nodes.shape)
        for end, (end_sum, convolution) in enumerate(zip(self.sums, self.convolutions, strict=True)):
            states, history = engine.get("ends.states")[end], engine.get("ends.history")[end]
            half = len(states) // 2
            if end_sum is not None:
                forces[end] = end_sum.force(states[: end_sum.modes] + 1j * states[half : half + end_sum.modes])
            elif convolution is not None:
                forces[end] = np.einsum("aim,am->i", convolution.kernel[1 : step + 1], history[:step][::-1])
        return forces

    def fill(self, level: np.ndarray, older: np.ndarray) -> None:
        """Compute the values of the chains' first nodes from their forces, in the halos of the present level and of the
        one before.
        """
        reach = self.nodes.shape[1]
        for values, forces in ((level, self.forces()), (older, self.engine.get("ends.forces")[:, :reach])):
            for weights, nodes, force, name in zip(self.weights, self.nodes, forces, self.names, strict=True):
                ghosts = np.linalg.lstsq(chain.driver_matrix(weights).T, force, rcond=None)[0]
                values[nodes[0] + (1 if name == "x+" else -1) * np.arange(1, reach + 1)] = ghosts

    # --- state -------------------------------------------------------------------------------------------------

    def save(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return the arrays and numbers of a checkpoint."""
        arrays = {f"exact_{name}": self.engine.get(f"ends.{name}") for name in ("history", "states", "forces")}
        arrays["exact_history"] = arrays["exact_history"][:, : self.step]
        meta: dict[str, Any] = {"steps": self.steps, "errors": [None if s is None else s.error for s in self.sums]}
        for end, end_sum in enumerate(self.sums):
            if end_sum is not None:
                arrays |= {f"exact{end}_{name}": getattr(end_sum, name) for name in ("poles", "inputs", "outputs")}
        return arrays, meta

    def load(self, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> None:
        """Restore the state returned by `save`."""
        steps = int(meta["steps"])
        sums: list[ExponentialSum | None] = []
        for end, error in enumerate(meta["errors"]):
            poles, inputs, outputs = (
                arrays.get(f"exact{end}_{name}", np.zeros(0)) for name in ("poles", "inputs", "outputs")
            )
            sums.append(None if error is None else ExponentialSum(poles, inputs, outputs, steps, error))
        if steps:
            self._take(sums, steps, arrays["exact_history"])
            self.engine.put("ends.states", arrays["exact_states"])
            self.engine.put("ends.forces", arrays["exact_forces"])
