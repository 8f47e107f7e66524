"""The micromodulus of a nonlocal diffusion or scalar wave operator: influence function, scaling, continuum dispersion.

The operator is ``L u(x) = c * integral over |xi| < horizon of w(r) r^-p (u(x + xi) - u(x)) dV`` and the constant
c makes ``L u -> coefficient * laplace(u)`` for long waves. Scaling constants and closed forms of the dispersion
follow Shojaei, Hermann, Seleson and Cyron (2020), table 1, and Hermann, Shojaei, Seleson, Cyron and Silling (2023), eqs
22 to 30.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from farhorizon import kinds
from farhorizon.arguments import Length
from farhorizon.errors import InputError
from farhorizon.files.storable import Storable

INFLUENCES = ("constant", "linear", "gaussian")
POINTS = 60  # of a quadrature over the family; the dispersion takes one more for each radian of k times horizon
_SPHERE = {1: 2.0, 2: 2 * np.pi, 3: 4 * np.pi}  # measure of the unit sphere in 1D, 2D, 3D
_SERIES_BELOW = 2.0  # closed forms suffer from cancellation for smaller arguments


@dataclass(frozen=True)
class Kernel(Storable):
    """Kernel of a scalar peridynamic operator.

    Parameters
    ----------
    horizon : float
        Radius of the family, within which nodes interact; three spacings are usual.
    exponent : int
        p in the weight ``w(r) / r^p`` of a bond, 0 to 3.
    influence : {"constant", "linear", "gaussian"} or callable
        Influence function w(r) = 1, ``1 - r/horizon`` or ``exp(-(r/width)^2)``, zero beyond the horizon; or a function
        of r/horizon that accepts arrays, from 0 to 1, and half a spacing further with the ramp. Integrals over such a
        function are sums over `POINTS` points, exact to rounding error if it is smooth.
    width : float, optional
        Width of the Gaussian, horizon / 3 unless given.
    volume : {"ramp", "full"}
        "ramp": linear volume correction, with which bonds reach horizon + spacing/2; "full": whole cells whose centre
        lies within the horizon.
    calibrate : bool
        Rescale the discrete stencil so that its diffusivity or squared wave speed is exactly the given one.

    Raises
    ------
    InputError
        An unknown influence or volume, an exponent outside 0..3, a horizon or width that is not positive, a function
        whose values are not finite, negative or all zero, or that does not return one value per distance.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> kernel = fh.Kernel(horizon=3.0, exponent=1)
    >>> k = np.array([0.01, 1.0])
    >>> np.round(kernel.dispersion(k, dim=2) / k**2, 3)  # long waves travel with the speed, short ones are slower
    array([1.   , 0.717])
    """

    horizon: Length
    exponent: int = 2
    influence: str | Callable[[np.ndarray], np.ndarray] = "constant"
    width: Length | None = None
    volume: str = "ramp"
    calibrate: bool = True

    def __post_init__(self) -> None:
        kinds.set_fields(
            self,
            horizon=kinds.number(self.horizon, "kernel.horizon", above=0),
            exponent=kinds.integer(self.exponent, "kernel.exponent", least=0, most=3),
            influence=_checked(self.influence),
            width=None if self.width is None else kinds.number(self.width, "kernel.width", above=0),
            volume=kinds.one_of(self.volume, "kernel.volume", ("ramp", "full"), "unknown volume rule"),
            calibrate=kinds.flag(self.calibrate, "kernel.calibrate"),
        )
        if self.width is not None and self.influence != "gaussian":
            raise InputError(
                "only a gaussian influence has a width",
                value=self.influence,
                limit="gaussian",
                key="kernel.width",
                remedy="leave it out",
            )

    @property
    def gaussian_width(self) -> float:
        """Width of the Gaussian influence function."""
        return self.horizon / 3 if self.width is None else self.width

    def influence_at(self, r: np.ndarray) -> np.ndarray:
        """Influence function w at distances r, without the cut-off at the horizon."""
        r = np.asarray(r, float)
        if callable(self.influence):
            return np.asarray(self.influence(r / self.horizon), float)
        if self.influence == "constant":
            return np.ones_like(r)
        if self.influence == "linear":
            return np.maximum(0.0, 1 - r / self.horizon)
        return np.exp(-((r / self.gaussian_width) ** 2))

    def _check_dim(self, dim: int) -> None:
        if dim == 1 and self.exponent == 3:
            raise InputError(
                "in 1D the second moment diverges for exponent 3", value=3, limit="<= 2", key="kernel.exponent"
            )

    def scaling_constant(self, dim: int, coefficient: float = 1.0) -> float:
        """Constant c for a diffusivity or squared speed `coefficient`, ``c = 2 dim coefficient / (|S| I)``.

        I is the integral of ``w(r) r^(dim + 1 - p)`` over 0..horizon, ``|S|`` the measure of the unit sphere.
        """
        self._check_dim(dim)
        q = dim + 2 - self.exponent
        if self.influence == "gaussian":
            s, width = q / 2, self.gaussian_width
            moment = 0.5 * width**q * special.gamma(s) * special.gammainc(s, (self.horizon / width) ** 2)
        elif callable(self.influence):
            r, gauss = _points()
            moment = self.horizon**q * float((gauss * self.influence(r) * r ** (q - 1.0)).sum())
        else:
            moment = self.horizon**q * (1 / q if self.influence == "constant" else 1 / q - 1 / (q + 1))
        return float(2 * dim * coefficient / (_SPHERE[dim] * moment))

    def series(self, dim: int, terms: int) -> np.ndarray:
        """Coefficients a_1, a_2, .. of the continuum symbol ``S(k) = coefficient k^2 (1 + a_1 z^2 + a_2 z^4 + ..)``, z
        = k horizon.

        The numbers are those of Shojaei et al. (2020), eq 26, with the signs of the growing modes of diffusion
        reversed, and of Hermann et al. (2023), eqs 24 and 29.

        Parameters
        ----------
        dim : {1, 2, 3}
        terms : int

        Returns
        -------
        ndarray, shape (terms,)
            Empty for a Gaussian influence and for functions, for which no closed form exists.
        """
        self._check_dim(dim)
        if self.influence not in ("constant", "linear"):
            return np.zeros(0)
        j = np.arange(1, terms + 2)
        mean = {1: special.gamma(2 * j + 1.0), 2: 4.0**j * special.gamma(j + 1.0) ** 2, 3: special.gamma(2 * j + 2.0)}[
            dim
        ]
        n = 2 * j + dim - self.exponent
        a = (-1.0) ** (j + 1) / mean * (1 / n if self.influence == "constant" else 1 / n - 1 / (n + 1))
        return np.asarray(a[1:] / a[0])

    def dispersion(self, k: np.ndarray | float, dim: int) -> np.ndarray:
        """Continuum symbol S(k) for a unit coefficient: squared frequency (waves) or decay rate (diffusion).

        Parameters
        ----------
        k : float or ndarray
            Wavenumbers.
        dim : {1, 2, 3}

        Returns
        -------
        ndarray, same shape as k
        """
        self._check_dim(dim)
        z = np.abs(np.asarray(k, float)) * self.horizon
        s = dim - 1 - self.exponent
        scale = self.scaling_constant(dim) * _SPHERE[dim] * self.horizon ** (dim - self.exponent)
        if self.influence == "constant":
            mean = _family_mean(dim, s, z)
        elif self.influence == "linear":
            mean = _family_mean(dim, s, z) - _family_mean(dim, s + 1, z)
        elif callable(self.influence):
            mean = _quadrature(dim, s, z, self.influence)
        else:
            ratio = self.horizon / self.gaussian_width
            mean = _quadrature(dim, s, z, lambda r: np.exp(-((ratio * r) ** 2)))
        return scale * mean


def _wave_mean(dim: int, z: np.ndarray) -> np.ndarray:
    """1 - (mean of exp(i k.x) over the sphere of radius z/k)."""
    if dim == 1:
        return 2 * np.sin(z / 2) ** 2
    # below 0.1 the difference from 1 would lose three digits; four terms leave out 3e-15 of it
    if dim == 2:
        series = z**2 / 4 * (1 - z**2 / 16 * (1 - z**2 / 36 * (1 - z**2 / 64)))
        return np.where(z < 0.1, series, 1 - special.j0(z))
    series = z**2 / 6 * (1 - z**2 / 20 * (1 - z**2 / 42 * (1 - z**2 / 72)))
    return np.where(z < 0.1, series, 1 - np.sinc(z / np.pi))


def _checked(influence: object) -> str | Callable[[np.ndarray], np.ndarray]:
    """Return the checked influence: a known name, or a function with a finite, non-negative value for each distance."""
    if not callable(influence):
        return kinds.one_of(influence, "kernel.influence", INFLUENCES, "unknown influence function")
    given = kinds.array(kinds.function(influence, "kernel.influence", "r")(_points()[0]), "kernel.influence")
    if given.shape != (POINTS,):
        raise InputError(
            "an influence function returns one value a distance",
            value=f"shape {given.shape}",
            limit=f"shape ({POINTS},)",
            key="kernel.influence",
            remedy="lambda r: 0*r + 1 for a constant",
        )
    if given.min() < 0 or not given.any():
        raise InputError(
            "an influence function is not negative and not zero everywhere",
            value=float(given.min()),
            limit=">= 0",
            key="kernel.influence",
        )
    return influence


def _points(count: int = POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Points in 0..1 and weights of Gauss-Legendre quadrature."""
    points, gauss = np.polynomial.legendre.leggauss(count)
    return (points + 1) / 2, gauss / 2


def _quadrature(dim: int, s: int, z: np.ndarray, weight) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Integral over r in 0..1 of ``weight(r) r^s (1 - mean)`` by Gauss-Legendre (the integrand is entire)."""
    r, gauss = _points(int(POINTS + np.max(z, initial=0.0)))
    return (_wave_mean(dim, z[..., None] * r) * r ** float(s) * weight(r) * gauss).sum(-1)


def _family_mean(dim: int, s: int, z: np.ndarray) -> np.ndarray:
    """Closed form of the integral over r in 0..1 of ``r^s (1 - mean over the sphere of exp(i z r))``."""
    small = z < _SERIES_BELOW
    x = np.where(small, _SERIES_BELOW, z)
    closed = _CLOSED_FORMS[dim, s](x)
    j = np.arange(1, 16)
    terms = {1: special.gamma(2 * j + 1.0), 2: 4.0**j * special.gamma(j + 1.0) ** 2, 3: special.gamma(2 * j + 2.0)}[dim]
    series = ((-1.0) ** (j + 1) / terms / (2 * j + s + 1) * np.where(small, z, 0.0)[..., None] ** (2 * j)).sum(-1)
    return np.where(small, series, closed)


def _si(z: np.ndarray) -> np.ndarray:
    return special.sici(z)[0]


def _cin(z: np.ndarray) -> np.ndarray:
    return np.euler_gamma + np.log(z) - special.sici(z)[1]


def _integral_j0(z: np.ndarray) -> np.ndarray:
    struve = special.struve
    return z * special.j0(z) + np.pi * z / 2 * (special.j1(z) * struve(0, z) - special.j0(z) * struve(1, z))


_CLOSED_FORMS = {
    (1, 1): lambda z: 0.5 - (z * np.sin(z) + np.cos(z) - 1) / z**2,
    (1, 0): lambda z: 1 - np.sin(z) / z,
    (1, -1): _cin,
    (1, -2): lambda z: z * _si(z) - 1 + np.cos(z),
    (2, 2): lambda z: 1 / 3 - (z**2 * special.j1(z) + z * special.j0(z) - _integral_j0(z)) / z**3,
    (2, 1): lambda z: 0.5 - special.j1(z) / z,
    (2, 0): lambda z: 1 - _integral_j0(z) / z,
    (2, -1): lambda z: _quadrature(2, -1, z, np.ones_like),  # a 2F3, which scipy lacks
    (2, -2): lambda z: special.j0(z) - 1 + z * (_integral_j0(z) - special.j1(z)),
    (3, 3): lambda z: 0.25 - (-np.cos(z) / z + 2 * np.sin(z) / z**2 + 2 * (np.cos(z) - 1) / z**3) / z,
    (3, 2): lambda z: 1 / 3 - (np.sin(z) - z * np.cos(z)) / z**3,
    (3, 1): lambda z: 0.5 - (1 - np.cos(z)) / z**2,
    (3, 0): lambda z: 1 - _si(z) / z,
    (3, -1): lambda z: _cin(z) - 1 + np.sin(z) / z,
}
