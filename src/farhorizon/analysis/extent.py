"""The distance at which a fixed edge must lie for nothing to return: the extent of a domain that represents the
infinite medium.

A fixed edge reflects the mirror image of what reaches it. What returns from an edge of N nodes beyond a side is
therefore what the infinite lattice would have 2N nodes farther out than the side, and the question is how far the data
have travelled by the end of a run. Along the normal this is computed exactly, for the scheme and the lattice as they
are, including precursors that dispersion sends ahead of the front of a wave, and the tail of a diffusing field. Along
the side each line of nodes is treated separately, as if it were the profile of a plane wave: a field that also spreads
in the plane or in space is smaller, and travels no faster. The extent is therefore slightly larger than necessary, by
the nodes in which the front decreases as much as it would by spreading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import fft

from farhorizon.analysis.references.infinite_lattice import undisturbed, wave_travel
from farhorizon.medium.integrators import Integrator, ModifiedEquation
from farhorizon.medium.stencil import Stencil
from farhorizon.rounding import TINY

_AIM = 0.3  # part of the target error: in a corner several edges reflect
_TIMES = 16  # times of a run at which the field is evaluated
_LINES = 4096  # largest number of lines of nodes along the normal that are used
_FAINT = 1e-2  # part of the target error below which profiles are left out
_LONGEST = 2**20  # nodes of a line beyond which only the front is considered
_COARSE = 24  # nodes along each axis of the coarsened support on which the largest value of a field is estimated


@dataclass(frozen=True)
class Extent:
    """The number of nodes for which the medium is computed beyond a side."""

    nodes: int
    #: Length of the run for which it was chosen.
    until: float
    #: Largest fraction of the largest value that returns in that time; nan if it was not computed.
    predicted: float = np.nan

    def __str__(self) -> str:
        predicted = (
            ""
            if np.isnan(self.predicted)
            else f", of which {self.predicted:.1g} of the largest value comes back up to t = {self.until:.6g}"
        )
        return f"{self.nodes} nodes{predicted}"


@dataclass(frozen=True)
class Datum:
    """Initial values "u", initial velocities "v", or a source, ``u_tt = .. + values time``, on the near field; for one
    side with the first axis along the normal, towards the side.
    """

    values: np.ndarray
    kind: str
    time: np.ndarray = field(default_factory=lambda: np.zeros(0))  # factor of a source at each step

    def oriented(self, axis: int, side: int) -> Datum:
        """Return the datum with a given axis first, pointing towards its lower (-1) or upper (1) end."""
        values = np.moveaxis(self.values, axis, 0)
        return replace(self, values=values if side > 0 else values[::-1])


@dataclass(frozen=True)
class Waves:
    """A medium, and the time steps of a run in it; `rate` is the factor on the stencil, ``coefficient / spacing^2``, of
    the fastest part of the medium.
    """

    stencil: Stencil
    rate: float
    integrator: Integrator
    dt: float
    damping: float
    steps: int

    @property
    def order(self) -> int:
        """Order of the equation in time."""
        return self.integrator.equation_order

    @property
    def front(self) -> float:
        """Nodes that the front of a long wave travels in the run, or over which a diffusing field spreads."""
        time = self.steps * self.dt
        return float(np.sqrt(self.rate) * time if self.order == 2 else np.sqrt(self.rate * time))

    @property
    def travel(self) -> float:
        """Nodes beyond which nothing arrives in the run, not even as a precursor."""
        if self.order == 1:
            # exp(-13^2/4) = 4e-19 is left of a field that diffuses
            return float(13 * np.sqrt(self.rate * self.steps * self.dt) + 12 * max(self.stencil.reach))
        return wave_travel(self.stencil, self.rate, self.steps, self.dt)

    def moments(self) -> np.ndarray:
        """Numbers of the steps at which the field is evaluated."""
        return np.unique(np.ceil(self.steps * np.arange(1, _TIMES + 1) / _TIMES).astype(int))

    def responses(self, eigenvalue: np.ndarray, datum: Datum) -> np.ndarray:
        """Response of modes with given eigenvalues (1/time for diffusion, 1/time^2 for waves) to a unit datum; shape
        (moments, modes).
        """
        moments, scheme = self.moments(), self.integrator
        if scheme.equation_order == 1:
            return np.array([scheme.growth(eigenvalue, self.dt) ** n for n in moments])
        if datum.kind != "source":
            u, v = np.array(1.0 * (datum.kind == "u")), np.array(1.0 * (datum.kind == "v"))
            modes = scheme.modes(eigenvalue, self.dt, self.damping)
            return np.array([modes.after(n, u, v).real for n in moments])
        responses, damped, inner = [], self.damping * self.dt, np.ones_like(eigenvalue)
        if isinstance(scheme, ModifiedEquation):  # but for the second derivative of the source, which is small
            inner = 1 - self.dt**2 * eigenvalue / 12
        before, now = np.zeros_like(eigenvalue), np.zeros_like(eigenvalue)
        for number, strength in enumerate(datum.time[: self.steps], 1):
            force = self.dt**2 * inner * (strength - eigenvalue * now)
            now, before = (2 * now - (1 - damped) * before + force) / (1 + damped), now
            if number in moments:
                responses.append(now)
        return np.array(responses)


def extent(
    medium: Waves, data: Sequence[Datum], sizes: Sequence[float], mirror: int, target: float, given: int | None = None
) -> Extent:
    """The smallest number of nodes beyond a side (the first axis of the medium) for which a fixed edge at their end
    reflects less than `target`, relative to the largest value of each datum (`sizes`), or what the `given` number
    reflects; `mirror` is 1 for a free opposite side, -1 for a fixed, 0 for an open one.
    """
    until = medium.steps * medium.dt
    if medium.travel > _LONGEST:
        return Extent(given or undisturbed(medium.stencil, medium.rate, medium.order, until), until)
    returns = np.zeros(1)
    for datum, size in zip(data, sizes, strict=True):
        values = _far(medium, datum, size, mirror, target)
        count = max(values.size, returns.size)
        returns = np.maximum(*(np.pad(part, (0, count - part.size)) for part in (values, returns)))
    farthest = np.maximum.accumulate(returns[::-1])[::-1]  # the largest value at or beyond each place
    beyond = int(np.argmax(np.append(farthest, 0.0) <= _AIM * target))
    nodes = given or max(1, -(-beyond // 2))
    return Extent(nodes, until, float(np.append(farthest, 0.0)[min(2 * nodes, farthest.size)]))


def _far(medium: Waves, datum: Datum, size: float, mirror: int, target: float) -> np.ndarray:
    """Largest fraction of a datum, over the run, on the nodes beyond a side; the first of them is the first node beyond
    it.
    """
    values = datum.values
    inside = len(values)
    if mirror:
        values = np.concatenate([mirror * values[::-1], values])
    profiles, weights = _profiles(values.reshape(len(values), -1), target)
    travel = int(medium.travel)
    length = fft.next_fast_len(len(values) + 2 * travel, real=True)
    angles = [2 * np.pi * np.fft.rfftfreq(length)] + [np.zeros(1)] * (medium.stencil.dim - 1)
    eigenvalue = np.maximum(medium.rate * medium.stencil.branches(*angles)[..., -1].ravel(), 0.0)
    spectra = fft.rfft(profiles, length, axis=0)
    worst = np.zeros(travel)
    for response in medium.responses(eigenvalue, datum):
        field = weights * np.abs(fft.irfft(response[:, None] * spectra, length, axis=0))
        beyond = field[len(values) : len(values) + travel].sum(1)
        scale = size if medium.order == 2 else float(field[len(values) - inside : len(values)].max())
        worst = np.maximum(worst, beyond / max(scale, TINY))
    return worst


def _profiles(lines: np.ndarray, target: float) -> tuple[np.ndarray, np.ndarray]:
    """Profiles of which lines of nodes are composed, one a column, and the largest weight of each in any line."""
    peaks = np.abs(lines).max(0)
    if len(peaks) == 1:
        return lines, np.ones(1)
    largest = np.argsort(peaks)[-_LINES:]
    shapes, values, lines_of = np.linalg.svd(lines[:, largest], full_matrices=False)
    weights = values * np.abs(lines_of).max(1)
    used = weights > _FAINT * target * weights.max()
    return shapes[:, used], weights[used]


def largest(medium: Waves, datum: Datum) -> float:
    """Estimate, from below, of the largest value that a datum causes anywhere: of a source around its strongest time,
    of a velocity until waves have left, in a medium reduced to the support of the datum, with the symbol of long waves.
    """
    values = np.abs(datum.values)
    if datum.kind == "u" or not values.any():
        return float(values.max())
    support = values > 1e-3 * values.max()
    extents = [
        np.flatnonzero(np.moveaxis(support, axis, 0).reshape(n, -1).any(1)) for axis, n in enumerate(values.shape)
    ]
    part = datum.values[tuple(slice(h[0], h[-1] + 1) for h in extents)]
    stride = max(1, -(-max(part.shape) // _COARSE))
    part = part[(slice(None, None, stride),) * part.ndim]
    box = [2 * n + 2 for n in part.shape]
    place = np.unravel_index(int(np.argmax(np.abs(part))), part.shape)
    angles = np.meshgrid(*(2 * np.pi * np.fft.fftfreq(n) for n in box), indexing="ij")
    reaction = medium.rate * medium.stencil.reaction
    long = float(medium.stencil.branches(1e-3, *[0.0] * (medium.stencil.dim - 1)).max()) - medium.stencil.reaction
    # divided by the square of the wavenumber, which is so small that the next term of the symbol is 1e-7 of it
    squared = long * 1e6 * medium.rate / stride**2
    eigenvalue = squared * sum(4 * np.sin(angle / 2) ** 2 for angle in angles) + reaction
    weights = (
        fft.fftn(part, box) * np.exp(1j * sum(int(p) * angle for p, angle in zip(place, angles, strict=True)))
    ).real / np.prod(box)
    # a wide stencil's own step is too long for nearest neighbours
    finer = int(np.ceil(medium.dt * np.sqrt(4 * part.ndim * squared + reaction)))
    dt = medium.dt / finer
    leave = max(1, int(min(box) / 2 / (np.sqrt(squared) * dt)))
    strengths = np.zeros(leave) if datum.kind == "v" else np.repeat(datum.time, finer)
    peak = int(np.argmax(np.abs(strengths)))
    strengths = strengths[max(0, peak - leave // 2) :][:leave]
    before, now = np.zeros_like(eigenvalue), np.full_like(eigenvalue, dt * (datum.kind == "v"))
    sizes = [0.0]
    for strength in strengths:
        now, before = 2 * now - before + dt**2 * (strength - eigenvalue * now), now
        sizes.append(abs(float((weights * now).sum())))
    return max(sizes)
