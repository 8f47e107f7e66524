"""Plane waves in a stack of layers of the continuum, by the conditions at each interface.

N. A. Haskell, Bull. Seism. Soc. Am. 43 (1953) 17.
"""

from typing import NamedTuple

import numpy as np


class Layer(NamedTuple):
    """A layer of a solid with P and SV waves, or of a scalar field, whose `p_speed` is None."""

    thickness: float  # of no meaning for the half-space
    p_speed: float | None
    s_speed: float
    density: float


def _waves(layer, slowness, omega, height):
    """Displacement and traction on a horizontal plane at a height of the waves in a layer, those that go up first, as
    columns; time dependence exp(-i omega t).
    """
    shear, columns = layer.density * layer.s_speed**2, []
    for up in (1, -1):
        if layer.p_speed is None:
            rise = up * np.sqrt(layer.s_speed**-2 - slowness**2 + 0j)
            columns.append(np.exp(1j * omega * rise * height) * np.array([1, 1j * omega * shear * rise]))
            continue
        lame = layer.density * layer.p_speed**2 - 2 * shear
        for speed, is_p in ((layer.p_speed, True), (layer.s_speed, False)):
            rise = up * np.sqrt(speed**-2 - slowness**2 + 0j)
            x, z = (slowness * speed, rise * speed) if is_p else (-rise * speed, slowness * speed)
            sheared = shear * (rise * x + slowness * z)
            pulled = (lame + 2 * shear) * rise * z + lame * slowness * x
            columns.append(
                np.exp(1j * omega * rise * height) * np.array([x, z, 1j * omega * sheared, 1j * omega * pulled])
            )
    return np.array(columns).T


def motion(layers, slowness, omega, incoming, free):
    """Displacement (x, z), of a scalar field (u,), as a function of the height in the uppermost layer, above the
    half-space, due to a wave of unit amplitude from there, by number among P and S.

    The layers are in the order from the half-space up; the uppermost one ends at a free surface, or never.
    """
    levels = np.append(0.0, np.cumsum([layer.thickness for layer in layers[1:]]))

    def waves(k, height):
        return _waves(layers[k], slowness, omega, height)

    size = len(waves(0, 0.0))
    unknown = [np.arange(size // 2, size), *[np.arange(size)] * (len(layers) - 1)]
    if not free:
        unknown[-1] = np.arange(size // 2)
    start = np.append(0, np.cumsum([len(numbers) for numbers in unknown]))
    matrix, right = np.zeros((start[-1], start[-1]), complex), np.zeros(start[-1], complex)
    for k in range(len(layers) - 1):
        rows = slice(k * size, (k + 1) * size)
        matrix[rows, start[k] : start[k + 1]] = waves(k, levels[k])[:, unknown[k]]
        matrix[rows, start[k + 1] : start[k + 2]] = -waves(k + 1, levels[k])[:, unknown[k + 1]]
    right[:size] = -waves(0, 0.0)[:, incoming]
    if free:
        matrix[-(size // 2) :, start[-2] :] = waves(-1, levels[-1])[size // 2 :]
    amplitudes = np.linalg.solve(matrix, right)[start[-2] :]
    return lambda height: waves(-1, height)[: size // 2, unknown[-1]] @ amplitudes
