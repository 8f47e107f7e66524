"""The lattice PML: a perfectly matched layer that is exact on the lattice.

Along a side's normal every shift of the stencil is replaced by a stretched shift with memory. A wave that gains the
factor (1 + z)/(1 - z) over one node in the medium, z = tanh(spacing * lambda / 2), gains (1 + g z)/(1 - g z) over one
layer node, with the stretch g(s) = kappa + sigma/(s + alpha). The relation between a node's field and its continuation
by k real nodes is then bilinear and holds for every wave that the lattice carries, so nothing is reflected at the
entrance; what returns from the outer end is the product over the nodes of ((1 + g z)/(1 - g z))^2.

It extends the reflectionless discrete layer of Chern (2019, J. Comput. Phys. 381) for the 5-point wave equation and
that of Du, Li and Zhang (2025, arXiv 2502.03713) for peridynamic waves in 2D to any stencil, order in time and
dimension.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import InitVar, dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from scipy import special

from farhorizon import kinds
from farhorizon.analysis.layers.profiles import Profile, largest_gain, weak
from farhorizon.analysis.layers.short_waves import HighPass, high_pass
from farhorizon.arguments import Duration
from farhorizon.boundaries.side import Side, checked_target
from farhorizon.engine.engine import Layer
from farhorizon.errors import InputError
from farhorizon.medium.stencil import Stencil

# largest sigma in layers with backward waves, over twice the largest frequency of the stencil; measured: with it a
# reach of 6 is stable
_CREST = 1.26
# largest logarithm of the gain of a mode in a layer that damps strong backward waves; measured: reach 10 and 12 grow at
# 7
_GAIN = 6.2
_GAIN_ALONE = 7.5  # the same in a layer without damping or with weak damping; measured: reach 8 to 12 grow from 8.3 on
# for layers of vector fields: logarithm of a mode's gain times the growth of backward waves over sigma; measured: 0.18
# grows
_FEEDBACK = 0.15
_FEEDBACK_SHIFTED = 0.3  # the same if alpha rises towards the outer end; measured: 0.38 grows at 0.95 of the step limit
_SHIFTS = (0.3, 0.5, 0.8, 1.2, 1.8, 2.5, 3.5, 5.0)  # shifts of alpha that are tried, see `Profile`
# smallest eigenvalue of the symbol, in units of P waves, of damped waves that move: those of zero-energy modes (of
# correspondence without stabilisation) are below 2e-4, those of solids with a Poisson's ratio up to 0.499 above 2e-3
_AT_REST = 1e-3
_STEEPEST = 60  # largest power of a ramp: almost all of sigma is then in the last column
_LEAST = 1.95  # smallest sum of sigma over the edges, with which 2 percent of a long wave return

BY_TARGET = "target=...: the layer follows from the desired error, the data and the length of the run"
_MOST_NODES = 1000  # in a layer: its echo is predicted by dense algebra of that size

# default numbers of nodes: for diffusion, for waves, and with strong backward waves
_DIFFUSIVE, _THIN, _STRONG = 12, 12, 16


@dataclass(frozen=True)
class LatticePML(Side):
    """Absorbing side whose only error is the leakage through the outer end of the layer.

    Parameters
    ----------
    target : float, optional
        Desired error, for waves relative to the largest value, for diffusion relative to the largest value at the same
        time; 1e-5, for elastic solids 1e-4, unless given. The layer is the thinnest with which trial runs of the set-up
        keep the target (`farhorizon.simulation.sides.trials`). It is chosen when the length of the run is known: by
        `run` and `check`, or where `until` is given. A target that no layer of up to 60 nodes keeps is refused, with
        the smallest one that can be had; without a target the best layer is taken then, with a warning.
    nodes : int, optional
        Fixes the thickness in nodes. If a target is given as well, a trial run shows whether these nodes meet it; a
        target of 1e-5 or more allows dampers to replace the filter in layers of up to 12 nodes for scalar fields in 3D,
        if these then reflect no more than before (`docs/explanation/absorbing_layers.md`).
    profile : mapping or Layer, optional
        Stretch specified by hand: "kappa" (>= 1), "sigma" (1/time), "alpha" (1/time), each a number or an array of
        ``nodes + 1`` values from the near field outwards; names left out default to 1, 0 and 0. Requires `nodes`; if a
        target is given, a trial run shows whether it is met. Alternatively a complete `Layer`, which is not assessed.
    until : float, optional
        Length of the run for which a target is to hold: in a case file the end of the run, otherwise 20 crossings of
        the near field, for diffusion 10 R^2/diffusivity.
    angle, wavelengths
        Refused: in earlier versions layers were chosen by the angle of plane waves.

    Raises
    ------
    InputError
        A target outside 1e-14..0.1, a thickness below 1, a profile with unknown names or impossible values; an angle or
        wavelengths, by which layers were chosen in earlier versions.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(1.0, (-20.0, -20.0), (20.0, 20.0))
    >>> layer = fh.LatticePML(target=1e-4, until=100.0)
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2.0)), layer, {"u": "exp(-(x**2 + y**2)/8)"})
    >>> max(found.predicted for found in sim.thickness.values()) <= 1e-4
    True
    """

    label: ClassVar[str] = "lattice PML"
    cracks: ClassVar[Literal["continue"]] = "continue"
    target: float | None = None
    nodes: int | None = None
    profile: Mapping[str, np.ndarray | float] | Layer | None = None
    until: Duration | None = None
    angle: InitVar[object] = None
    wavelengths: InitVar[object] = None

    def __post_init__(self, angle: object, wavelengths: object) -> None:
        for name, given in (("angle", angle), ("wavelengths", wavelengths)):
            if given is not None:
                raise InputError(
                    "layers are no longer chosen by angle", value=given, key=f"boundary.{name}", remedy=BY_TARGET
                )
        kinds.set_fields(
            self,
            target=checked_target(self.target, 1e-14),
            nodes=None
            if self.nodes is None
            else kinds.integer(self.nodes, "boundary.nodes", least=1, most=_MOST_NODES),
            until=None if self.until is None else kinds.number(self.until, "boundary.until", above=0),
        )
        if self.profile is not None:
            kinds.instance(
                self.profile, "boundary.profile", (Mapping, Layer), "a mapping of kappa, sigma and alpha to numbers"
            )
            if self.nodes is None:
                raise InputError("a profile by hand needs nodes", key="boundary.profile", remedy="give nodes=...")
            unknown = set() if isinstance(self.profile, Layer) else set(self.profile) - {"kappa", "sigma", "alpha"}
            if unknown:
                raise InputError(
                    "unknown profile",
                    value=sorted(map(str, unknown)),
                    limit="kappa, sigma, alpha",
                    key="boundary.profile",
                )

    @property
    def open_ended(self) -> bool:
        """Whether the thickness is chosen from the data and the length of the run."""
        return self.nodes is None and self.profile is None

    @property
    def whole(self) -> bool:
        """Whether the profile is a complete `Layer`."""
        return isinstance(self.profile, Layer)

    def wanted(self, default: float) -> float:
        """Return the target if one is given, otherwise that of the model."""
        return default if self.target is None else self.target

    def undamped(self) -> LatticePML:
        """Return the same layer without its filter of short waves, if the profile is a complete `Layer`."""
        if not isinstance(self.profile, Layer) or not self.profile.filtered:
            return self
        return replace(self, profile=replace(self.profile, damping=np.zeros(0)))

    def make_layer(self, order: int, stencil: Stencil, coefficient: float, spacing: float, half_width: float) -> Layer:
        """Return the layer of one side for a given number of nodes, or with a default number for unknown data and run
        length.

        Parameters
        ----------
        order : {1, 2}
            Order of the equation in time.
        stencil : Stencil
            The stencil, whose first axis is the normal.
        coefficient : float
            Diffusivity or squared speed.
        spacing : float
        half_width : float
            Half the largest extent of the near field: the length scale of the diffusive far field.
        """
        if isinstance(self.profile, Layer):
            return self.profile
        if self.profile is not None and self.nodes is not None:
            values = {}
            for name, default in (("kappa", 1.0), ("sigma", 0.0), ("alpha", 0.0)):
                given = kinds.array(self.profile.get(name, default), f"boundary.profile.{name}")
                if given.shape not in ((), (1,), (self.nodes + 1,)):
                    raise InputError(
                        "a profile needs nodes + 1 values",
                        value=f"shape {given.shape}",
                        limit=self.nodes + 1,
                        key=f"boundary.profile.{name}",
                    )
                values[name] = np.broadcast_to(given, (self.nodes + 1,)).copy()
                low = 1.0 if name == "kappa" else 0.0
                if not (values[name] >= low).all():
                    raise InputError(
                        "profile out of range",
                        value=values[name].min(),
                        limit=f">= {low:g}",
                        key=f"boundary.profile.{name}",
                    )
            if order == 1 and np.any(values["sigma"]):
                raise InputError("diffusion takes kappa only", key="boundary.profile.sigma", remedy="leave sigma out")
            return Layer(values["kappa"], values["sigma"], values["alpha"])
        if order == 1:
            return _diffusion_layer(self.nodes or _DIFFUSIVE, spacing, half_width)
        damped = high_pass(stencil)
        nodes = self.nodes or _wave_nodes(stencil.reach[0], damped)
        return _wave_profile(nodes, stencil, damped).layer(nodes, float(np.sqrt(coefficient)), spacing, damped)


def _wave_nodes(reach: int, damped: HighPass | None) -> int:
    """Number of nodes for waves if neither data nor run length are known: 12 keep the error at 1e-8 in short runs in
    2D; where strong backward waves are damped, 16 keep it at 1e-6.
    """
    least, wide = (_THIN, 3) if weak(damped) else (_STRONG, 4)
    return max(least, wide * reach if reach > 3 else 0)


def _wave_profile(nodes: int, stencil: Stencil, damped: HighPass | None) -> Profile:
    """Member of the family of profiles for waves of all angles.

    In two and three dimensions the waves that come back are those along the side, near cut-off: sigma/s turns their
    decay by a right angle, so that none remains, and sigma/(s + alpha) turns it by less. An alpha that rises only
    towards the outer end leaves the long waves to the columns before it. A strong entrance makes stencils grow, wide
    ones more than others: beyond a reach of 3 nodes a higher power of the ramp is used. Where short waves are damped as
    strongly as backward waves require, sigma follows the smooth ramp of the damping; wide kernels have a weaker and
    shorter one.
    """
    reach, dim = stencil.reach[0], stencil.dim
    if damped is not None and damped.whole:
        return (
            Profile(0.3, 1.0, 4, smooth=True)
            if damped.still
            else _emptied(Profile(0.6, 1.0, 5, smooth=True), nodes, stencil, damped)
        )
    if not weak(damped):
        # shear waves are slower and affected more; between thin layers long waves along them would grow without alpha
        if stencil.components > 1:
            thick = Profile(0.6, 1.0, 5, smooth=reach < 5)
            plain = thick if nodes >= 25 else Profile(0.7, 1.0, 4, 0.1 if nodes < 16 else 0.0, smooth=reach < 5)
            return _emptied(_drained(plain, nodes, stencil), nodes, stencil, damped)
        if reach < 5:
            return _bounded(Profile(1.0, 1.0, 5, smooth=True), nodes, stencil)
        if dim > 1:  # nearly as strong as `_bounded` allows
            return _bounded(Profile(0.8 if reach < 6 else 0.7, 1.0, 4), nodes, stencil)
        # otherwise the smooth ramp is too steep, and waves grow
        return _bounded(Profile(0.7, 1.0, 5, smooth=reach < 7 and nodes < 40), nodes, stencil)
    if reach > 3:
        profile = Profile(0.5 if reach > 7 and stencil.components > 1 else 1.0, 1.0, 2 if reach < 6 else 3)
        # the gain is known for scalar fields only
        return profile if stencil.components > 1 else _shortened(profile, nodes, stencil, _GAIN_ALONE)
    if dim == 1:
        return Profile(1.5, 1.0, 1)
    # from scans over sigma (0.7 to 3.3, powers 0.8 to 3), alpha (1e-3 to 3) and kappa (to 20: no gain), 8 to 40 nodes
    thin = 12 / nodes
    strength = 1.0 if dim == 3 and reach > 1 else 2.6 * thin**0.85 if reach < 3 else 1.9 * thin**0.6
    # where three layers meet there are slow waves that only alpha drives out
    return Profile(strength, 1.0, 1, 0.7 if dim == 2 else 1.5)


def _bounded(profile: Profile, nodes: int, stencil: Stencil) -> Profile:
    """Return the profile, or a gentler one if its sigma is too large, relative to the frequencies of the waves, for the
    theory of first order to hold.

    The waves of a wide kernel are slow: its largest frequency is about that of a wave as long as the horizon. If there
    are backward waves, sigma stays below a multiple of that frequency, and twice the rate of first order then damps
    them. Moreover, the ramp is so short that no mode that decays in the medium gains more on its way through the layer
    than what returns from the outer end loses again. A profile that would absorb next to nothing is not used: then the
    given one is kept, and its stability is left to the certificate.
    """
    most, gentle = _CREST * float(np.sqrt(stencil.symbol_maximum)), profile
    if profile.strength > most and stencil.backward_waves():
        gentle = replace(gentle, strength=most, smooth=False, rate=2.0)
    gentle = _shortened(gentle, nodes, stencil, _GAIN)
    return gentle if gentle.edges(nodes, 1.0, 1.0)[1].sum() >= _LEAST else profile


def _drained(profile: Profile, nodes: int, stencil: Stencil) -> Profile:
    """Return the profile for a vector field, or one whose alpha rises towards the outer end until modes no longer
    sustain themselves in the layer.

    Modes that decay in the medium gain in the layer and meet backward waves at its end; the faster these grow, the less
    of that gain is stable. The product of both ordered all materials and thicknesses that were run from noise
    (exponents 0 and 1, reach 3 to 8, 16 to 32 nodes). A larger alpha reduces the gain at the cost of absorption, so the
    smallest of a few is chosen. Stencils with a reach below 4 are below the bound without it.
    """
    growth = stencil.backward_waves().growth

    def feedback(candidate: Profile) -> float:
        return growth * largest_gain(stencil, *candidate.edges(nodes, 1.0, 1.0))

    if feedback(profile) <= _FEEDBACK:
        return profile
    shifted = [replace(profile, shift=shift, smooth=False) for shift in _SHIFTS]
    return next((candidate for candidate in shifted if feedback(candidate) <= _FEEDBACK_SHIFTED), shifted[-1])


def _emptied(profile: Profile, nodes: int, stencil: Stencil, damped: HighPass | None) -> Profile:
    """Return the profile; for a vector field whose short waves must be damped faster than the layer absorbs, as those
    of nearly incompressible solids, one whose alpha reaches sigma at the outer end.

    Waves that are damped so much hardly move any more, and what moves more slowly than sigma is stretched without
    bound: it would gather at the outer end and grow there. With alpha = sigma it is stretched by two at most. This
    costs absorption, which materials with zero-energy modes need not pay: those do not move at all.
    """
    if stencil.components == 1 or damped is None or damped.strength < 1 or damped.lowest < _AT_REST:
        return profile
    equal = 2 * nodes / 12  # `Profile.edges` counts alpha in 12 strength / nodes, and sigma in 2 strength
    return replace(profile, shift=max(profile.shift, equal))


def _shortened(profile: Profile, nodes: int, stencil: Stencil, most: float) -> Profile:
    """Return the profile, or one with a higher power of the ramp, such that no mode gains more than exp(most)."""
    while largest_gain(stencil, *profile.edges(nodes, 1.0, 1.0)) > most and profile.power < _STEEPEST:
        profile = replace(profile, power=profile.power + 1, smooth=False)
    return profile


def _diffusion_layer(nodes: int, spacing: float, half_width: float) -> Layer:
    """Return the layer with the stretch kappa = 1/tau at Zolotarev points tau between the slowest and the steepest
    decay of the far field.
    """
    low = 0.3 * spacing / half_width
    high = min(1.0, 0.02 * nodes**2 * spacing / half_width)
    low = min(low, 0.5 * high)
    parameter = 1 - (low / high) ** 2
    place = (np.arange(nodes + 1) + 0.5) / (nodes + 1) * special.ellipk(parameter)
    tau = high * special.ellipj(place, parameter)[2]
    return Layer(1 / tau, np.zeros(nodes + 1), np.zeros(nodes + 1))
