"""A one-dimensional bar on plain arrays, which verifies the exact boundary and computes the published examples.

`Bar` advances a row of nodes whose ends are free or continue into a half-infinite chain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from farhorizon import InputError
from farhorizon.analysis.exact.chain import Recursion, ground
from farhorizon.analysis.exact.convolution import BlockConvolution
from farhorizon.analysis.exact.exponential_sum import ExponentialSum
from farhorizon.papers.bar_loops import BarEnds, HeldNodes, bar_acceleration, bar_steps

_CHUNK = 1024  # steps per call of the compiled loop if there is no convolution


def bonds_of(weights: np.ndarray, nodes: int, coefficient: np.ndarray | None = None) -> np.ndarray:
    """Bonds of a row of nodes, shape (K, nodes), from the weights a_1 .. a_K: entry (k - 1, i) joins i and i + k, and
    is 0 if i + k is beyond the end. A coefficient of each node multiplies each bond by the smaller of the values at its
    two nodes.
    """
    bonds = np.zeros((weights.size, nodes))
    for k in range(1, min(weights.size, nodes - 1) + 1):
        bonds[k - 1, :-k] = weights[k - 1] * (
            1.0 if coefficient is None else np.minimum(coefficient[:-k], coefficient[k:])
        )
    return bonds


class Bar:
    """A row of nodes with ends that are free or exact.

    The stencil a_1 .. a_K is that of the medium beyond the ends; the increment is the initial velocity times dt. An end
    is None (free), a force kernel (`chain.force_form`) of shape (steps + 1, K, K), which is convolved in blocks of
    `block` steps, or an `ExponentialSum`. Held nodes have prescribed values as functions of the step, see also
    `release`. The sample at step 0 has the weight `first`, that of the recursion unless given.
    """

    def __init__(
        self,
        weights: np.ndarray,
        recursion: Recursion,
        u: np.ndarray,
        increment: np.ndarray | None = None,
        *,
        bonds: np.ndarray | None = None,
        ends: Sequence[np.ndarray | ExponentialSum | None] = (None, None),
        held: dict[int, Callable[[int], float]] | None = None,
        first: float | None = None,
        block: int | None = 64,
    ) -> None:
        reach = weights.size
        if u.size < reach:
            raise InputError("the bar is shorter than its stencil", value=f"{u.size} nodes", limit=f">= {reach}")
        self.recursion, self.u, self.step = recursion, np.array(u, float), 0
        self.bonds = bonds_of(weights, u.size) if bonds is None else bonds
        self.held = dict(held or {})
        self.sums = [e if isinstance(e, ExponentialSum) else None for e in ends]
        self.histories = [BlockConvolution(e, block) if isinstance(e, np.ndarray) else None for e in ends]
        self._first = recursion.first if first is None else first
        lengths = {h.block for h in self.histories if h is not None}
        self._block = min(lengths, default=_CHUNK)
        heads = [
            h.head if h is not None else np.zeros((self._block if lengths else 1, reach, reach)) for h in self.histories
        ]
        grounds = np.array([np.zeros(reach) if e is None else ground(weights) for e in ends])
        past, samples = np.zeros((2, 2, self._block, reach))
        self._ends = BarEnds(grounds, np.array(heads), past, samples, *self._modes(reach))
        self.d = np.zeros(u.size)
        if recursion.keep:
            self._set_velocity(np.zeros(u.size) if increment is None else increment)

    def _modes(self, reach: int) -> tuple[np.ndarray, ...]:
        """Poles, input and output vectors and zero states of both ends, padded with zeros to a common shape."""
        most = max((s.modes for s in self.sums if s is not None), default=0)
        poles, states = np.zeros((2, 2, most), complex)
        inputs, outputs = np.zeros((2, 2, most, reach), complex)
        for side, response in enumerate(self.sums):
            if response is not None:
                used = slice(response.modes)
                poles[side, used], inputs[side, used], outputs[side, used] = (
                    response.poles,
                    response.inputs,
                    response.outputs,
                )
        return poles, inputs, outputs, states

    def acceleration(self) -> np.ndarray:
        """A u without the contribution of the past beyond the ends, shape (N,)."""
        out = np.empty(self.u.size)
        bar_acceleration(self.u, self.bonds, out)
        left, right = self._ends.grounds
        out[: left.size] -= left * self.u[: left.size]
        out[: -right.size - 1 : -1] -= right * self.u[: -right.size - 1 : -1]
        return out

    def _set_velocity(self, increment: np.ndarray) -> None:
        """Set the increment at step 0 such that the first step is ``u + (1 - d dt) dt v + dt^2/2 A u``."""
        r = self.recursion
        self.d = 2 * r.first * increment + (r.first - 1) * r.scale / r.keep * self.acceleration()

    def exchange(self, sums: Sequence[ExponentialSum | None], histories: Sequence[np.ndarray]) -> None:
        """Replace the sums by ones that hold for more steps, given the history of the K drivers of each side so far,
        numbered from the end inwards, of shape (step, K), the first sample multiplied by its weight.
        """
        self.sums = list(sums)
        names = ("poles", "inputs", "outputs", "states")
        modes = self._modes(self._ends.grounds.shape[1])
        self._ends = self._ends._replace(**dict(zip(names, modes, strict=True)))
        for side, response in enumerate(self.sums):
            if response is not None:
                self._ends.states[side, : response.modes] = response.replay(histories[side])

    def release(self, node: int, increment: float) -> None:
        """Release a held node that is not a driver; `increment` is its velocity times dt."""
        del self.held[node]
        r = self.recursion
        self.d[node] = 2 * r.first * increment + (r.first - 1) * r.scale / r.keep * self.acceleration()[node]

    def run(self, steps: int) -> np.ndarray:
        """Advance by a number of steps and return u, shape (N,); InputError if a kernel or a sum ends before."""
        limit = min(
            [s.steps for s in self.sums if s is not None] + [h.steps for h in self.histories if h is not None],
            default=None,
        )
        if limit is not None and self.step + steps > limit:
            raise InputError(
                "the run outlives its kernel",
                value=self.step + steps,
                limit=f"{limit} steps",
                remedy="a kernel of more steps",
            )
        while steps:
            offset = self.step % self._block
            count = min(steps, self._block - offset)
            self._advance(offset, count)
            self.step += count
            steps -= count
        return self.u

    def _advance(self, offset: int, count: int) -> None:
        """Advance by `count` steps within the current block, starting at its step `offset`."""
        for side, history in enumerate(self.histories):
            if history is not None and offset == 0:
                if self.step:
                    history.samples[:] = self._ends.samples[side]
                    history.next_block()
                self._ends.past[side] = history.past
        nodes = np.array(sorted(self.held), np.int64)
        values = np.array([[self.held[node](self.step + n) for node in nodes] for n in range(1, count + 1)]).reshape(
            count, len(nodes)
        )
        bar_steps(
            self.u,
            self.d,
            self.bonds,
            self.recursion.keep,
            self.recursion.scale,
            HeldNodes(nodes, values),
            self._ends,
            self._first if self.step == 0 else 1.0,
            offset,
            count,
        )
