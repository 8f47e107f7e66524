r"""The singular fields at the tip of a stationary crack (Williams, 1957, J. Appl. Mech. 24, 109).

In coordinates of the tip, with x ahead of it and y across, and with K = 1 and :math:`\kappa = (\lambda + 3\mu) /
(\lambda + \mu)` of the plane:

.. math:: u_I = \frac{1}{2\mu}\sqrt{\frac{r}{2\pi}}\,(\kappa - \cos\theta)
   \left(\cos\tfrac{\theta}{2}, \sin\tfrac{\theta}{2}\right), \quad
   u_{II} = \frac{1}{2\mu}\sqrt{\frac{r}{2\pi}} \left((\kappa + 2 + \cos\theta) \sin\tfrac{\theta}{2},
   -(\kappa - 2 + \cos\theta) \cos\tfrac{\theta}{2}\right), \quad
   w_{III} = \frac{2}{\mu}\sqrt{\frac{r}{2\pi}}\,\sin\tfrac{\theta}{2} .
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class NearTip:
    """The near-tip fields of a medium with Lame's constants of the plane (`lame` does not matter in mode III,
    `antiplane`).
    """

    lame: float
    shear: float
    antiplane: bool = False

    @property
    def modes(self) -> tuple[str, ...]:
        """Names of the intensities."""
        return ("K_III",) if self.antiplane else ("K_I", "K_II")

    @property
    def stiffness(self) -> float:
        """E' in ``G = K^2 / E'``: E in plane stress, E / (1 - nu^2) in plane strain, twice the shear modulus for mode
        III.
        """
        if self.antiplane:
            return 2 * self.shear
        return 4 * self.shear * (self.lame + self.shear) / (self.lame + 2 * self.shear)

    def fields(self, r: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacements (modes, n, components) and their gradients (modes, n, components, 2) for unit intensities, at
        distances r and angles theta (n,) from the direction ahead, -pi and pi at the faces.
        """
        cos, sin, c, s = np.cos(theta), np.sin(theta), np.cos(theta / 2), np.sin(theta / 2)
        if self.antiplane:
            shapes, slopes, factor = [[s]], [[c / 2]], 2 / self.shear
        else:
            k, factor = (self.lame + 3 * self.shear) / (self.lame + self.shear), 1 / (2 * self.shear)
            shapes = [[c * (k - cos), s * (k - cos)], [s * (k + 2 + cos), -c * (k - 2 + cos)]]
            slopes = [
                [-s / 2 * (k - cos) + c * sin, c / 2 * (k - cos) + s * sin],
                [c / 2 * (k + 2 + cos) - s * sin, s / 2 * (k - 2 + cos) + c * sin],
            ]
        size = factor / np.sqrt(2 * np.pi)
        f, df = (np.moveaxis(np.array(values), 1, -1) for values in (shapes, slopes))  # (modes, n, components)
        root = np.sqrt(r)[:, None]
        cos, sin = cos[:, None], sin[:, None]
        gradient = np.stack([f / 2 * cos - df * sin, f / 2 * sin + df * cos], axis=-1) / root[..., None]
        return size * root * f, size * gradient

    def stress(self, gradient: np.ndarray) -> np.ndarray:
        """Stress for a displacement gradient of shape (..., components, 2), of the same shape."""
        if self.antiplane:
            return self.shear * gradient
        trace = np.trace(gradient, axis1=-2, axis2=-1)[..., None, None]
        return np.asarray(self.lame * trace * np.eye(2) + self.shear * (gradient + gradient.swapaxes(-1, -2)))

    def release(self, intensities: np.ndarray) -> np.ndarray:
        """Energy released per new area, by Irwin's relation, for intensities of shape (..., modes)."""
        return np.asarray((np.asarray(intensities) ** 2).sum(-1) / self.stiffness)
