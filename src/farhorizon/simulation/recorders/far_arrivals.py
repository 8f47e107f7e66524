"""When what leaves the box of a far field arrives at a receiver, and until when the field there is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from farhorizon.analysis.references.driven import Scheme
from farhorizon.analysis.references.infinite import largest_speed
from farhorizon.errors import shown
from farhorizon.medium.shell import Shell
from farhorizon.simulation.recorders.far_box import LEFT

_BLOCK = 16  # steps that share one maximum, which keeps the maxima small beside the history they come from
_STILL = 1e-6  # squared speeds below this part of the largest are rounding: such waves do not travel


@dataclass(frozen=True)
class FarArrivals:
    """What leaves a box and when it arrives at receivers.

    Parameters
    ----------
    scheme : Scheme
        The medium outside the box.
    shell : Shell
    receivers : ndarray of int, shape (P, dim)
        Nodes outside the box.
    places : ndarray, shape (P, dim)
        Their coordinates.
    """

    scheme: Scheme
    shell: Shell
    receivers: np.ndarray
    places: np.ndarray

    def late(self, rows: Sequence[np.ndarray], last: int, passing: bool) -> list[str]:
        """Return the warning that records which end with step `last` lack something: a value on the faces towards a
        receiver that is larger than all that arrive there by then, or, where an incident wave passes through the box
        and hides how large the others are, one that is not faint beside it.

        Parameters
        ----------
        rows : sequence of ndarray, shape (steps, components * W)
            Values on the shell, components first.
        last : int
        passing : bool
        """
        factor = LEFT if passing else 1 + LEFT
        steps, sizes = _block_maxima(rows, self.scheme.stencil.components)
        found: list[tuple[float, float, int]] = []  # step of arrival, largest value until then, receiver
        for number, receiver in enumerate(self.receivers):
            which, delays = _delays(self.scheme, self.shell, receiver)
            arrivals, size = steps[:, which] + delays, sizes[:, which]
            held = size[arrivals <= last].max(initial=0.0)
            lacking = np.where(arrivals <= last, 0.0, size)
            if lacking.max(initial=0.0) > factor * held:
                found.append((float(arrivals.flat[lacking.argmax()]), float(held / lacking.max()), number))
        if not found:
            return []
        arrival, share, number = max(found)
        end, later = (f"t = {step * self.scheme.dt:.6g}" for step in (last, arrival))
        return [
            f"the far field {self._at(number, len(found))} ends at {end}, but the largest of the waves on the box "
            f"arrives there at about {later}, and of those that arrive before the end the largest has {share:.2g} of "
            "its amplitude on the box; FarField.at(points, until=...) with a later end, or a longer run, contains it"
        ]

    def forget_unknown(self, values: np.ndarray, end: int, left: float, largest: float) -> list[str]:
        """Overwrite values by nan from the step on at which what leaves the box after the run may have arrived; return
        the warning that says so.

        Parameters
        ----------
        values : ndarray, shape (steps + 1, P[, components])
        end : int
            Last step of the run.
        left, largest : float
            Largest values on the shell at the end of the run and in all of it.
        """
        if left <= LEFT * largest:
            return []
        known = [end + _steps_of_travel(self.scheme, self.shell, receiver) for receiver in self.receivers]
        for number, step in enumerate(known):
            values[step + 1 :, number] = np.nan
        short = [(step, number) for number, step in enumerate(known) if step + 1 < len(values)]
        if not short:
            return []
        step, number = min(short)
        when, over = (f"t = {one * self.scheme.dt:.6g}" for one in (step, end))
        return [
            f"the far field {self._at(number, len(short))} is known up to {when} and is nan after it: at the end of "
            f"the run, at {over}, {left / largest:.2g} of the largest value remains on the box, and what leaves it "
            "later may arrive; a longer run supplies it"
        ]

    def _at(self, number: int, count: int) -> str:
        others = f" (the worst of {count} points)" if count > 1 else ""
        return f"at {shown(self.places[number].round(12))}{others}"


def _block_maxima(rows: Sequence[np.ndarray], components: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest value at each node within each few steps, and its step; each of shape (blocks, W)."""
    steps, sizes, first = [], [], 0
    for more in rows:
        for begin in range(0, len(more), _BLOCK):
            size = np.abs(more[begin : begin + _BLOCK]).reshape(-1, components, more.shape[1] // components).max(1)
            steps.append(first + begin + size.argmax(0))
            sizes.append(size.max(0))
        first += len(more)
    return np.array(steps), np.array(sizes)


def _delays(scheme: Scheme, shell: Shell, receiver: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of the shell's nodes at the faces that a receiver sees, and how many steps the slowest long
    wave takes from each of them; for diffusion, after how many steps a release there is largest, ``r^2 / (2 dim D)``.
    """
    first, last, reach = (np.array(one) for one in (shell.first, shell.last, shell.stencil.reach))
    seen = (receiver > last) & (shell.nodes > last - reach) | (receiver < first) & (shell.nodes < first + reach)
    which = np.flatnonzero(seen.any(1))
    distance = np.linalg.norm(receiver - shell.nodes[which], axis=1)
    towards = receiver - (first + last) / 2
    squares = _squared_speeds(scheme, towards / np.linalg.norm(towards))
    if scheme.order == 1:
        return which, distance**2 / (2 * len(first) * squares.max() * scheme.recursion.scale)
    return which, distance / (np.sqrt(squares[squares > _STILL * squares.max()].min()) * scheme.dt)


def _squared_speeds(scheme: Scheme, direction: np.ndarray) -> np.ndarray:
    """Squared speeds of long waves along a direction, in nodes per time; for diffusion, diffusivities."""
    along = (scheme.stencil.offsets @ direction) ** 2 / 2
    tensor = np.tensordot(along, scheme.stencil.weights, 1) * scheme.rate
    return np.asarray(np.linalg.eigvalsh(np.atleast_2d(tensor)))


def _steps_of_travel(scheme: Scheme, shell: Shell, receiver: np.ndarray) -> int:
    """Return in how many steps the fastest wave of the lattice travels from a box to a receiver; 0 for diffusion, which
    has no front.
    """
    if scheme.order == 1:
        return 0
    first, last = shell.nodes.min(0), shell.nodes.max(0)
    apart = np.maximum(np.maximum(first - receiver, receiver - last), 0)
    return int(np.linalg.norm(apart) / (largest_speed(scheme.stencil) * np.sqrt(scheme.rate) * scheme.dt))
