"""Attenuation by relaxation mechanisms: standard linear solids in parallel, fitted to a quality factor over a band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
from scipy.optimize import nnls

from farhorizon import kinds
from farhorizon.arguments import Frequency, Unit
from farhorizon.errors import InputError
from farhorizon.files.storable import Storable
from farhorizon.geometry.lattice import Lattice, nodes_in
from farhorizon.geometry.shapes import Shape

_LEAST = 5.0  # a wave that keeps less than exp(-2 pi / 5), 28 %, of its energy per cycle is hardly one
_ALLOWED = 0.02  # largest relative error of Q in the band
_MOST = 16  # mechanisms: each is one more field in memory
_SAMPLES = 20  # frequencies per mechanism at which Q is fitted, many more than it has wiggles
_ROUNDS = 10  # of the fit, after which its largest error hardly falls any more
_BEYOND = np.linspace(0, 1, 9)  # how far the mechanisms may extend beyond the band, in distances between them


class Relaxation(NamedTuple):
    """Mechanisms of a modulus: of each its relaxation time, and its share of the unrelaxed modulus; shape (N,)."""

    times: np.ndarray
    shares: np.ndarray


@dataclass(frozen=True)
class LossyRegion(Storable):
    """A region of another quality factor in a medium with attenuation.

    Parameters
    ----------
    region : Shape
        Where Q differs.
    quality : float
        The quality factor Q there at the reference frequency, 5 or more.

    Raises
    ------
    InputError
        A region that is no shape, a quality below 5.

    Examples
    --------
    >>> import farhorizon as fh
    >>> basin = fh.LossyRegion(fh.Disc(20.0, (0.0, 0.0)), quality=15)
    >>> rock = fh.Attenuation(quality=80, band=(0.1, 1.0), regions=[basin])
    """

    region: Shape
    quality: float

    def __post_init__(self) -> None:
        kinds.instance(self.region, "region.region", Shape, "a shape", remedy="Disc(2.0)")
        kinds.set_fields(self, quality=_quality(self.quality, "region.quality"))


@dataclass(frozen=True)
class Attenuation(Storable):
    r"""A quality factor Q over a band of frequencies, in the whole medium or by region.

    The modulus relaxes, :math:`M(f) = M_\infty\,(1 - \sum_l a_l / (1 + 2\pi i f \tau_l))`, where the times span the
    band evenly on a logarithmic scale and the shares :math:`a_l \ge 0` are those with the least largest error of
    :math:`Q = \operatorname{Re} M / \operatorname{Im} M`. Waves of higher frequency travel faster.

    Parameters
    ----------
    quality : float
        The quality factor Q at the reference frequency, 5 or more: in one cycle a wave keeps exp(-2 pi / Q) of its
        energy.
    band : tuple of float
        Lowest and highest frequency (1/time) for which Q is fitted.
    exponent : float
        Exponent of a power law, ``Q = quality (f / reference)^exponent``, from -1 to 1; 0 for a constant Q.
    reference : float, optional
        Frequency at which the waves have the speed of the model; by default the geometric mean of the band.
    mechanisms : int, optional
        Number of mechanisms, each of which needs memory and time; by default as many as keep Q within 2 % of what is
        asked for in the band.
    regions : sequence of LossyRegion
        Where Q differs; later ones take precedence. They continue into layers as at the edge of the near field.

    Raises
    ------
    InputError
        Q below 5 somewhere in the band, a band that is empty, a Q that no 16 mechanisms have within 2 %.

    Notes
    -----
    Emmerich and Korn (1987), Geophysics 52, 1252; Blanch, Robertsson and Symes (1995), Geophysics 60, 176. With
    :math:`Q\,\operatorname{Im} M = \operatorname{Re} M` the fit is linear in the shares.

    Examples
    --------
    >>> import farhorizon as fh
    >>> rock = fh.Attenuation(quality=50, band=(0.1, 10.0))
    >>> wave = fh.Wave(fh.Kernel(2.0), speed=3.0, attenuation=rock)
    >>> round(float(rock.quality_at(1.0)), 1), round(float(rock.speed_at(1.0)), 3)
    (50.8, 1.0)
    """

    quality: float
    band: Annotated[tuple[float, float], Unit("1/s")]
    exponent: float = 0.0
    reference: Frequency | None = None
    mechanisms: int | None = None
    regions: Sequence[LossyRegion] = ()

    def __post_init__(self) -> None:
        quality = _quality(self.quality, "model.attenuation.quality")
        band = tuple(kinds.array(self.band, "model.attenuation.band", shape=(2,)).tolist())
        if not 0 < band[0] < band[1]:
            raise InputError(
                "a band extends from a lower to a higher frequency",
                value=list(band),
                limit="0 < lowest < highest",
                key="model.attenuation.band",
            )
        exponent = kinds.number(self.exponent, "model.attenuation.exponent", least=-1, most=1)
        reference, mechanisms = self.reference, self.mechanisms
        if reference is not None:
            reference = kinds.number(reference, "model.attenuation.reference", above=0)
        if mechanisms is not None:
            mechanisms = kinds.integer(mechanisms, "model.attenuation.mechanisms", least=1, most=_MOST)
        regions = tuple(kinds.sequence(self.regions, "model.attenuation.regions", "regions"))
        for number, region in enumerate(regions):
            remedy = "LossyRegion(Disc(2.0), quality=20)"
            kinds.instance(region, f"model.attenuation.regions[{number}]", LossyRegion, "a LossyRegion", remedy=remedy)
        given = {"quality": quality, "band": band, "exponent": exponent, "reference": reference}
        kinds.set_fields(self, **given, mechanisms=mechanisms, regions=regions)
        least = float(self._asked(np.array(band)).min())
        if least < _LEAST:
            raise InputError(
                "the power law of Q is too small at an end of the band",
                value=least,
                limit=f">= {_LEAST:g}",
                key="model.attenuation.exponent",
                remedy="a narrower band, a higher quality, or an exponent closer to 0",
            )
        _ = self.relaxation, self.spectra  # refuse what cannot be fitted

    @property
    def reference_frequency(self) -> float:
        """Frequency at which the waves have the speed of the model."""
        return float(np.sqrt(self.band[0] * self.band[1])) if self.reference is None else self.reference

    @cached_property
    def relaxation(self) -> Relaxation:
        """The mechanisms with the least largest error of Q at frequencies throughout the band."""
        counts = range(1, _MOST + 1) if self.mechanisms is None else (self.mechanisms,)
        for count in counts:
            fitted, error = min((self._fitted(count, beyond) for beyond in _BEYOND), key=lambda pair: pair[1])
            if error <= _ALLOWED:
                break
        if error > _ALLOWED and self.mechanisms is None:
            raise InputError(
                f"no {_MOST} mechanisms of relaxation have this Q",
                value=f"an error of {error:.2g}",
                limit=f"{_ALLOWED:g} of Q in the band",
                key="model.attenuation.band",
                remedy="a narrower band, an exponent closer to 0, or a number of mechanisms, whatever its error",
            )
        return fitted

    @property
    def unrelaxed(self) -> float:
        """Squared speed of waves of infinite frequency over that of waves of the reference frequency."""
        relaxed = _relaxed(self.relaxation, np.array(self.reference_frequency))
        return float((relaxed**-0.5).real ** 2)

    @cached_property
    def spectra(self) -> tuple[Attenuation, ...]:
        """The attenuation elsewhere and in each of the regions."""
        found = [replace(self, regions=())] if self.regions else [self]
        for number, region in enumerate(self.regions):
            try:
                found.append(replace(self, quality=region.quality, regions=()))
            except InputError as error:
                raise error.at(f"model.attenuation.regions[{number}].quality") from None
        return tuple(found)

    @property
    def strongest(self) -> Attenuation:
        """That of the region with the largest `unrelaxed`, by which the operator is scaled."""
        return max(self.spectra, key=lambda spectrum: spectrum.unrelaxed)

    @property
    def memories(self) -> int:
        """Number of mechanisms of the region that has most of them."""
        return max(len(spectrum.relaxation.times) for spectrum in self.spectra)

    def numbers(self, lattice: Lattice) -> np.ndarray:
        """Number in `spectra` of each node of a lattice; raises InputError for regions of another dimension."""
        numbers = np.zeros(lattice.shape, np.int64)
        for number, region in enumerate(self.regions):
            key = f"model.attenuation.regions[{number}].region"
            numbers[nodes_in(region.region, lattice, key)] = number + 1
        return numbers

    def modulus(self, frequency: Any) -> np.ndarray:
        """Complex modulus at frequencies (1/time), in units of density times the squared speed of the model; waves
        ``exp(2 pi i f t)`` have a positive imaginary part.
        """
        return self.unrelaxed * _relaxed(self.relaxation, np.asarray(frequency, float))

    def quality_at(self, frequency: Any) -> np.ndarray:
        """Q of the mechanisms at frequencies (1/time), ``Re M / Im M``."""
        modulus = self.modulus(frequency)
        return np.asarray(modulus.real / modulus.imag)

    def speed_at(self, frequency: Any) -> np.ndarray:
        """Phase velocity of long waves at frequencies (1/time), over the speed of the model."""
        return np.asarray(1 / (self.modulus(frequency) ** -0.5).real)

    def _asked(self, frequency: np.ndarray) -> np.ndarray:
        """Q that is asked for."""
        return self.quality * (frequency / self.reference_frequency) ** self.exponent

    def _fitted(self, count: int, beyond: float) -> tuple[Relaxation, float]:
        """A number of mechanisms, and the largest error of their Q: ``Im M = Re M / Q``, times Q, is linear in the
        shares. Weights that grow with the errors make the largest one small (Lawson's algorithm).
        """
        low, high = np.log(self.band)
        further = beyond * (high - low) / max(count - 1, 1)
        corners = np.exp(np.linspace(low - further, high + further, count) if count > 1 else [(low + high) / 2])
        frequency = np.geomspace(*self.band, _SAMPLES * count)
        asked, ratio = self._asked(frequency), frequency[:, None] / corners
        lost = (asked[:, None] * ratio + 1) / (1 + ratio**2)
        weights, fits = np.ones(len(frequency)), []
        for _ in range(_ROUNDS):
            root = np.sqrt(weights / weights.sum())
            shares = nnls(root[:, None] * lost, root)[0]
            fitted = Relaxation(1 / (2 * np.pi * corners[shares > 0]), shares[shares > 0])
            relaxed = _relaxed(fitted, frequency)
            with np.errstate(divide="ignore"):  # shares that add up to one
                fits.append((fitted, float(np.abs(relaxed.imag * asked / relaxed.real - 1).max())))
            weights *= np.abs(lost @ shares - 1)
            if not weights.any():  # they vanish where a fit is far off, except at frequencies that it meets
                break
        return min(fits, key=lambda fit: fit[1])


def _quality(value: Any, key: str) -> float:
    """A quality factor of a wave; InputError for anything else."""
    remedy = "a damping, or a boundary that absorbs, if waves are to vanish"
    return kinds.number(value, key, least=_LEAST, beyond=remedy)


def _relaxed(relaxation: Relaxation, frequency: np.ndarray) -> np.ndarray:
    """Complex modulus over the unrelaxed one."""
    parts = relaxation.shares / (1 + 2j * np.pi * frequency[..., None] * relaxation.times)
    return np.asarray(1 - parts.sum(-1))
