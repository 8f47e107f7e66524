"""Reflection of plane waves by a flat side, without a run in time: by the map of one step of any side, and by the
equations of a lattice PML itself.

Near field, layer and memory of the side obey ``z x = G x`` with the map G of one step; their solution must continue in
the incoming wave and the modes that leave (`farhorizon.analysis.layers.chain_modes`). A side converts P into S
waves and back.

In a lattice PML the columns along the normal hold x(1) .. x(L), and U(p, k) is column p continued by k nodes. At a
factor z per step the recursion over the edge p between columns p and p + 1, with the stretch ``g = kappa +
sigma/(s + alpha)`` and ``s = 2/dt (z - 1)/(z + 1)``,

    (1 - g) U(p+1,k+1) + (1 + g) U(p+1,k) = (1 + g) U(p,k+1) + (1 - g) U(p,k),

is solved inwards for k >= 0 (with zeros beyond the last column) and outwards for k <= 0 (from the near field's nodes at
the entrance). The operator A of the columns is therefore a matrix. With the part F = D F D of the increments that the
filter of `engine.features.filter` removes in a step, the scheme ``(z - 1) x = (1 - F)(keep (1 - 1/z) x + scale A x)``
and the modes of the medium in front of the layer form one small linear system.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import linalg

from farhorizon.analysis.layers.chain_modes import ALIKE, ArrivingWave, LatticeMedium, Modes, polarisations, types_of
from farhorizon.engine.engine import Layer
from farhorizon.engine.features.dampers import response, springs_of, strengths_of
from farhorizon.engine.features.filter import line_damping


def reflection(
    matrix: np.ndarray, columns: np.ndarray, levels: Sequence[complex], factor: complex, modes: Modes, reach: int
) -> np.ndarray:
    """Amplitudes of all leaving modes for an incoming wave of amplitude 1, both at the side's end of the near field,
    from the map (n, n) of one step; `columns` (levels, d, columns) are the entries of the near field's last nodes,
    `levels` the amplitude of a wave in each time level.
    """
    count, width, size = len(modes.leaving), columns.shape[-1], len(matrix)
    place = np.arange(width) - (width - 1)
    wave = np.multiply.outer(modes.vector, modes.incoming**place)
    away = modes.vectors.T[:, None, :] * modes.leaving ** place[:, None]  # (d, columns, modes)
    system, right = np.zeros((size + count, size + count), complex), np.zeros(size + count, complex)
    system[:size, :size] = factor * np.eye(size) - matrix
    for nodes, amplitude in zip(columns, levels, strict=True):  # modes replace the nodes that the low end affects
        rows = nodes[:, :reach].ravel()
        system[rows] = 0
        system[rows, rows] = 1
        system[rows, size:] = -amplitude * away[:, :reach].reshape(len(rows), count)
        right[rows] = amplitude * wave[:, :reach].ravel()
    # match them at the next nodes, which have at least as many values as there are modes
    known = away[:, reach : 2 * reach].reshape(-1, count)
    projection = linalg.qr(known / np.abs(known).max(0), mode="economic")[0].conj().T
    system[size:, columns[0, :, reach : 2 * reach].ravel()], system[size:, size:] = projection, -projection @ known
    right[size:] = projection @ wave[:, reach : 2 * reach].ravel()
    return np.asarray(np.linalg.solve(system, right)[size:])


def by_type(modes: Modes, amplitudes: np.ndarray, along: np.ndarray, azimuth: float = 0.0) -> dict[str, complex]:
    """Amplitudes of the leaving waves by type, without the types that do not travel; for several of one type, the root
    of the sum of squares. `along` are the tangential wavenumbers times spacing, `azimuth` their direction in radians.
    """
    by_name: dict[str, complex] = {}
    components, dim, left = len(modes.vector), len(along) + 1, modes.travels.copy()
    while left.any():
        degenerate = left & (np.abs(modes.leaving - modes.leaving[np.argmax(left)]) < ALIKE)
        left &= ~degenerate
        field = amplitudes[degenerate] @ modes.vectors[degenerate]
        angle = np.arctan2(np.linalg.norm(along), np.angle(modes.leaving[degenerate][0]))
        basis = linalg.qr(modes.vectors[degenerate].T, mode="economic")[0]
        projections = polarisations(components, dim, float(angle), azimuth) @ basis.conj() @ basis.T
        lengths = np.linalg.norm(projections, axis=1)
        for number in np.argsort(-lengths)[: basis.shape[1]]:
            name = types_of(components, dim)[number]
            part = complex(np.vdot(projections[number], field) / lengths[number])
            by_name[name] = complex(np.sqrt(by_name[name] ** 2 + part**2)) if name in by_name else part
    return by_name


@dataclass(frozen=True)
class LayerSide:
    """A flat side with a lattice PML; `diffusive` says whether the medium carries diffusion waves, which come from a
    source of one frequency and decay on their way.
    """

    medium: LatticeMedium
    layer: Layer
    diffusive: bool = False
    #: Time of one angle on a typical core.
    seconds: ClassVar[float] = 0.005

    @property
    def types(self) -> tuple[str, ...]:
        """Types of waves, see `types_of`."""
        return types_of(self.medium.stencil.components, self.medium.stencil.dim)

    def reflections(
        self, wavelength: float, angle: float, azimuth: float = 0.0, incoming: str | None = None
    ) -> dict[str, complex]:
        """Amplitudes, by type, of the waves into which a plane wave of amplitude 1 is reflected; see
        `farhorizon.checks.reduced_setups.Strip.reflections`.
        """
        length = wavelength / self.medium.spacing
        if self.diffusive:
            wave = self.medium.diffusion_wave(length, angle)
        else:
            wave = self.medium.plane_wave(length, angle, azimuth, self.types.index(incoming or self.types[0]))
        return by_type(wave.modes, layer_amplitudes(wave, self.layer), wave.along, float(np.radians(azimuth)))


def layer_amplitudes(wave: ArrivingWave, layer: Layer) -> np.ndarray:
    """Amplitudes of all leaving modes for an incoming wave of amplitude 1, both at the last node before a lattice PML;
    shape (leaving modes,), complex.
    """
    blocks = wave.weights.reshape(len(wave.weights), *wave.weights.shape[1:] or (1, 1))
    reach, d, columns = len(blocks) // 2, blocks.shape[1], layer.columns
    # equations of the columns, and what they read of the near field's nodes 0, -1 .. -reach
    system = (wave.eigenvalue * np.eye(d) - blocks[reach])[:, None, :, None] * np.eye(columns)[:, None]
    drive: np.ndarray = np.zeros((reach + 1, d, columns, d), complex)
    entrance = np.zeros((reach, columns + 1), complex)  # U(0, k), k = 1 .. K, from the last node and the columns
    stretch = layer.kappa + layer.sigma / (wave.s + layer.alpha)
    for k, (inwards, outwards) in enumerate(continuations(stretch, reach), 1):
        entrance[k - 1] = inwards[0]
        outer, inner = blocks[reach + k][:, None, :, None], blocks[reach - k][:, None, :, None]
        system -= outer * inwards[1:, None, 1:] + inner * outwards[:, None, :columns]
        drive += inner[..., 0] * outwards[:, columns:].T[:, None, :, None]
    system, drive = system.reshape(d * columns, -1), drive.reshape(reach + 1, -1, d)
    if layer.tuned.size:
        system = system + np.diag(_dampers(wave, layer))
    elif layer.damping.size:
        damping = line_damping(layer.damping, layer.taps, wave.dt, wave.along)  # the same for each component
        lost = (wave.factor - 1) * damping  # from the increment
        if layer.whole:  # from both time levels
            lost = wave.factor * damping - wave.recursion.keep / wave.factor * (damping - damping @ damping)
        of_each = np.kron(np.eye(d), damping)
        system = system - of_each @ system + np.kron(np.eye(d), lost / wave.recursion.scale)
        drive = drive - of_each @ drive
    # modes that decay within a node are scaled by their values ahead
    roots, shapes = (
        np.append(wave.modes.leaving, wave.modes.incoming),
        np.vstack([wave.modes.vectors, wave.modes.vector]).T,
    )
    size = np.maximum(np.abs(roots) ** reach, 1.0)
    behind, ahead = roots ** -np.arange(reach + 1)[:, None] / size, roots ** np.arange(1, reach + 1)[:, None] / size
    inside = np.linalg.solve(system, (drive @ (shapes * behind[:, None])).sum(0)).reshape(d, columns, -1)
    # what the columns continue in, less what the modes do, at the nodes 1 .. K; (K, d, modes)
    continued = (entrance[:, 1:] @ inside).swapaxes(0, 1)
    continued += entrance[:, 0, None, None] * (shapes * behind[0]) - shapes * ahead[:, None]
    missing = np.concatenate([(blocks[reach + 1 + i :] @ continued[: reach - i]).sum(0) for i in range(reach)])
    missing = missing / np.linalg.norm(missing[:, :-1], axis=0).max()
    dependent = max(missing.shape) * np.finfo(float).eps
    amplitudes = -(np.linalg.pinv(missing[:, :-1], rcond=dependent) @ missing[:, -1])
    return np.asarray(amplitudes * size[-1] / size[:-1])


def continuations(stretch: np.ndarray, reach: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Matrices that continue the field of a layer by k = 1 .. reach nodes, for the stretch of its edges, (L + 1,).

    The first, (L + 1, L + 1), gives U(., k) at the columns 0 .. L from the values there, the second, (L, L + reach +
    1), U(., -k) at the columns 1 .. L from the values there and at the near field's nodes 0, -1 .. -reach.
    """
    ratio, edges = (1 - stretch) / (1 + stretch), len(stretch)
    nodes = edges - 1 + np.arange(reach + 1)  # the near field's nodes among the unknowns
    inwards, outwards = np.eye(edges, dtype=complex), np.eye(edges - 1, edges + reach, dtype=complex)
    for k in range(1, reach + 1):
        before, inwards = inwards, np.zeros_like(inwards)
        inwards[-1] = -ratio[-1] * before[-1]
        for p in range(edges - 2, -1, -1):
            inwards[p] = before[p + 1] + ratio[p] * (inwards[p + 1] - before[p])
        before, outwards = outwards, np.zeros_like(outwards)
        outwards[0, nodes[k - 1 : k + 1]] = 1.0, ratio[0]
        outwards[0] -= ratio[0] * before[0]
        for p in range(1, edges - 1):
            outwards[p] = before[p - 1] + ratio[p] * (outwards[p - 1] - before[p])
        yield inwards, outwards


def _dampers(wave: ArrivingWave, layer: Layer) -> np.ndarray:
    """Contribution of tuned dampers to the eigenvalue at the columns, shape (components * columns,)."""
    keep, pull = springs_of(layer.tuned, wave.dt)
    factor = np.array(wave.factor)
    passed = 1 + strengths_of(layer.damping, keep, pull, wave.dt) * response(factor, keep, pull)
    change = (factor - 1) * (1 - 1 / factor) * (1 / passed - 1) / wave.recursion.scale
    return np.tile(change, wave.modes.vectors.shape[1])
