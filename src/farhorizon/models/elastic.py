"""Elasticity on the lattice: bond-based, ordinary state-based, correspondence and finite elements, each as one stencil
of matrices.

With Lame's constants of the plane or of space, ``lam`` and ``mu``, every material is built of two pieces. The bonds
``(dim + 2) mu w(r) n n`` with half second moment 1 make a Cauchy solid, lam = mu; a nonlocal gradient ``g`` makes what
derivatives make.
"""

from __future__ import annotations

import copy
import itertools
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.medium.fracture import fracture_energy as energy_of_fracture
from farhorizon.medium.integrators import Verlet
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.stencil import Stencil
from farhorizon.models.model import LatticeModel

MATERIALS = ("bond-based", "state-based", "correspondence", "finite-element")
_CAUCHY = {"strain": 0.25, "stress": 1 / 3, None: 0.25}  # Poisson's ratio of central forces
_PAIRS = "two of young, poisson, bulk, shear"
#: For messages; docs/explanation/elasticity.md has it as a table.
COMBINATIONS = (
    'free sides: material="bond-based" (Poisson\'s ratio 1/4, in plane stress 1/3) with LatticePML or Sponge, or, of '
    "any ratio, Body "
    '(type = "correspondence" in a case file) with NonlocalPML (cross = 0.1) or Sponge; no free sides: every material '
    "with LatticePML or Sponge"
)
_MODULI = "one of young, bulk, shear"
_CLOSE = 1e-6  # of Poisson's ratio

Table = tuple[np.ndarray, np.ndarray]


class Elastic(LatticeModel):
    r"""Linear elastic waves, :math:`\rho\,(u_{tt} + 2 d\,u_t) = \int W(\xi)\,(u' - u)\,dV' + b`, by velocity Verlet, in
    two and three dimensions.

    Parameters
    ----------
    kernel : Kernel, Stencil or None
        Influence function ``w(r)/r^p`` of the bonds (exponent 1 and constant influence: the prototype microelastic
        material), or of the weights of state-based and correspondence materials; None for finite elements. A `Stencil`
        of matrices, for unit P modulus, replaces the material's.
    young, poisson, bulk, shear : float, optional
        Young's modulus, Poisson's ratio, bulk and shear modulus: two of the four; bond-based materials, whose Poisson's
        ratio is fixed, need one.
    density : float
        Mass per volume.
    material : {"bond-based", "state-based", "correspondence", "finite-element"}
    plane : {"strain", "stress"}, optional
        In two dimensions; "strain" unless given.
    damping : float
        Viscous damping d (1 / time).
    stabilisation : float
        Correspondence: strength of the force against zero-energy modes, 0 to 1 of the P modulus.
    nonlinear : bool
        Bond-based: the force ``c (|xi + eta| - |xi|)`` along the deformed bond (the prototype microelastic material),
        not linearised in eta.
    critical_stretch : float, optional
        Bond-based: bonds whose length has grown by more than this part break for good.
    fracture_energy : float, optional
        Instead of the critical stretch the energy that a new crack takes per area; see `critical_stretch_on`.

    Attributes
    ----------
    lame : float
        Lame's first constant, in plane stress that of the plane, ``2 lam mu / (lam + 2 mu)``.
    shear : float
    coefficient : float
        Squared speed of P waves.

    Raises
    ------
    InputError
        Constants that are missing, superfluous or impossible: Poisson's ratio outside -1..0.5, bond-based other than
        1/4 (1/3 in plane stress).

    Notes
    -----
    Bonds: Silling (2000), linearised unless `nonlinear`; bonds that break: Silling and Askari (2005). State-based:
    Silling, Epton, Weckner, Xu and Askari (2007), eq 104, linearised: its dilatation acts with lam - mu.
    Correspondence: the same, section 18, with the gradient of Wildman and Gazonas (2012), eqs 2-8 to 2-13; the
    stabilisation is that of Silling (2017), eq 21. Bonds of the last three are no springs: they cannot be cut or
    weakened one by one.

    Examples
    --------
    >>> import farhorizon as fh
    >>> rock = fh.Elastic(fh.Kernel(2.0), young=50.0, density=2.0)  # bond-based: Poisson's ratio is 1/4
    >>> round(rock.p_speed / rock.s_speed, 6)  # sqrt(3)
    1.732051
    """

    target = 1e-4  # a tenth of it costs as many nodes again: strong backward waves decide

    def __init__(
        self,
        kernel: Kernel | Stencil | None = None,
        young: float | None = None,
        poisson: float | None = None,
        *,
        bulk: float | None = None,
        shear: float | None = None,
        density: float = 1.0,
        material: str = "bond-based",
        plane: str | None = None,
        damping: float = 0.0,
        stabilisation: float = 0.0,
        nonlinear: bool = False,
        critical_stretch: float | None = None,
        fracture_energy: float | None = None,
    ) -> None:
        kinds.one_of(material, "model.material", MATERIALS, "unknown material")
        if plane is not None:
            kinds.one_of(plane, "model.plane", ("strain", "stress"), "unknown plane state")
        if (kernel is None) != (material == "finite-element") and not isinstance(kernel, Stencil):
            raise InputError(
                f"a {material} material takes " + ("a kernel" if kernel is None else "no kernel"),
                value=kinds.said(kernel),
                key="model.kernel",
                remedy="Kernel(horizon=3*spacing, exponent=1)" if kernel is None else "leave it out",
            )
        if kernel is not None:
            super().__init__(kernel)
        self.kernel, self.material, self.plane = kernel, material, plane
        self.stabilisation = kinds.number(stabilisation, "model.stabilisation", least=0, most=1)
        if stabilisation and material != "correspondence":
            raise InputError(
                "stabilisation is for correspondence materials",
                value=material,
                limit="correspondence",
                key="model.stabilisation",
                remedy="leave it out",
            )
        self.bonds = material == "bond-based"
        self.nonlinear, self.critical_stretch, self.fracture_energy = (
            kinds.flag(nonlinear, "model.nonlinear"),
            critical_stretch,
            fracture_energy,
        )
        self._check_law()
        self.density, self.damping = (
            kinds.number(density, "model.density", above=0),
            kinds.number(damping, "model.damping", least=0),
        )
        self._constants(young=young, poisson=poisson, bulk=bulk, shear=shear)
        self.source_factor = 1 / self.density
        self.coefficient = self.p_modulus / self.density
        self.integrator = Verlet()

    mechanical = True

    def serves(self, side: Any) -> bool:
        """Whether a side goes with the material; where `bonds` may not be cut, those of vector fields do that bonds
        cross.
        """
        return super().serves(side) and (self.bonds or side.vectors)

    def _check_law(self) -> None:
        """What bonds that follow a law of their own stretch need."""
        if self.critical_stretch is not None and self.fracture_energy is not None:
            raise InputError(
                "critical_stretch and fracture_energy are two names of one thing",
                value=self.fracture_energy,
                key="model.fracture_energy",
                remedy="give one of them",
            )
        for name in ("critical_stretch", "fracture_energy"):
            if getattr(self, name) is not None:
                setattr(self, name, kinds.number(getattr(self, name), f"model.{name}", above=0))
        if self.bondwise and (not self.bonds or not isinstance(self.kernel, Kernel)):
            key = (
                "nonlinear"
                if self.nonlinear
                else "critical_stretch"
                if self.critical_stretch is not None
                else "fracture_energy"
            )
            raise InputError(
                "only bonds of a bond-based material with a kernel are nonlinear or break",
                value=self.material,
                key=f"model.{key}",
                remedy='material="bond-based", or Body for correspondence with damage',
            )

    combinations = COMBINATIONS

    @property
    def title(self) -> str:
        """Elastic, and of which material."""
        return f"Elastic of {self.material} material"

    @property
    def bondwise(self) -> bool:
        """Whether bonds follow a law of their own stretch one by one: nonlinear, or breaking, or both."""
        return self.nonlinear or self.critical_stretch is not None or self.fracture_energy is not None

    @property
    def bond_law(self) -> Elastic | None:
        """Itself where bonds follow a law one by one, else None."""
        return self if self.bondwise else None

    @property
    def linearised(self) -> Elastic:
        """The same material, linear and unbreakable."""
        model = copy.copy(self)
        model.nonlinear, model.critical_stretch, model.fracture_energy = False, None, None
        return model

    def bond_stiffness(self, stencil: Stencil, spacing: float) -> np.ndarray:
        """Force density over elongation of each bond of the material's stencil."""
        return np.asarray(np.trace(stencil.weights, axis1=1, axis2=2) * self.p_modulus / spacing**2)

    def critical_stretch_on(self, spacing: float, dim: int) -> float:
        """The stretch at which bonds break: the one given, or from the fracture energy and the bonds of the lattice;
        infinite without.

        The bonds' energy across a plane, averaged over its directions (`medium.fracture.fracture_energy`), is the
        fracture energy. That of a crack along an axis of the lattice differs by what the lattice is not a continuum.
        """
        if self.critical_stretch is not None:
            return self.critical_stretch
        if self.fracture_energy is None:
            return np.inf
        stencil = self.stencil(spacing, dim)
        of_one = energy_of_fracture(spacing * stencil.offsets, self.bond_stiffness(stencil, spacing), 1.0)
        return float(np.sqrt(self.fracture_energy / of_one))

    def _constants(self, **constants: float | None) -> None:
        """Set all elastic constants from those that are given."""
        varies = (
            "one number; Body takes constants that vary, and the coefficient of a Simulation multiplies the "
            "stiffness of bonds"
        )
        given = {
            name: kinds.number(value, f"model.{name}", above=None if name == "poisson" else 0, remedy=varies)
            for name, value in constants.items()
            if value is not None
        }
        fixed = _CAUCHY[self.plane] if self.bonds else None
        nu = given.get("poisson", _poisson(given, fixed))
        if nu is None or not set(given) - {"poisson"}:
            one = fixed is not None
            raise InputError(
                f"a {self.material} material needs {'one modulus' if one else 'two elastic constants'}",
                value=f"only {', '.join(sorted(given))}" if given else "none",
                limit=_MODULI if one else _PAIRS,
                key="model",
                remedy="give young" if one else "give young and poisson",
            )
        if not -1 < nu < 0.5:
            raise InputError(
                "Poisson's ratio is out of range",
                value=nu,
                limit="above -1, below 0.5",
                key="model.poisson",
                remedy="0.49 for a nearly incompressible material" if nu >= 0.5 else "",
            )
        if fixed is not None and abs(nu - fixed) > _CLOSE:
            state = "plane stress" if self.plane == "stress" else "three dimensions and plane strain"
            raise InputError(
                f"bond-based materials have one Poisson's ratio, in {state}",
                value=nu,
                limit=fixed,
                key="model.poisson",
                remedy=COMBINATIONS,
            )
        if "shear" in given:
            self.shear = given["shear"]
        else:
            self.shear = (
                given["young"] / (2 * (1 + nu))
                if "young" in given
                else 3 * given["bulk"] * (1 - 2 * nu) / (2 * (1 + nu))
            )
        self.poisson, self.young = nu, 2 * self.shear * (1 + nu)
        space = 2 * self.shear * nu / (1 - 2 * nu)
        self.bulk = space + 2 * self.shear / 3
        self.lame = 2 * space * self.shear / (space + 2 * self.shear) if self.plane == "stress" else space
        for name, value in given.items():
            if abs(getattr(self, name) - value) > _CLOSE * max(abs(value), 1.0 if name == "poisson" else 0.0):
                raise InputError(
                    "elastic constants do not agree",
                    value=value,
                    limit=f"{getattr(self, name):.6g}",
                    key=f"model.{name}",
                    remedy="give two of them",
                )

    @property
    def p_modulus(self) -> float:
        """Modulus of P waves, ``lam + 2 mu``."""
        return self.lame + 2 * self.shear

    @property
    def p_speed(self) -> float:
        """Speed of long P waves."""
        return float(np.sqrt(self.p_modulus / self.density))

    @property
    def s_speed(self) -> float:
        """Speed of long S waves."""
        return float(np.sqrt(self.shear / self.density))

    def with_stencil(self, stencil: Stencil) -> Elastic:
        """The same model, linear, with a stencil in place of its material's."""
        model = super().with_stencil(stencil).linearised
        model.kernel = stencil
        return model

    def stencil(self, spacing: float, dim: int) -> Stencil:
        """Stencil for unit P modulus."""
        if dim == 1:
            raise InputError(
                "elasticity needs two or three dimensions", value=dim, key="lattice", remedy="Wave is the bar"
            )
        if dim == 3 and self.plane is not None:
            raise InputError(
                "only two dimensions have a plane state", value=self.plane, key="model.plane", remedy="leave it out"
            )
        if isinstance(self.kernel, Stencil):
            found = super().stencil(spacing, dim)
            if found.components == 1:
                raise InputError("elasticity needs a stencil of matrices", value=str(found), key="model.kernel")
            return found
        lame, shear = self.lame / self.p_modulus, self.shear / self.p_modulus
        if self.kernel is None:
            return _stencil(finite_element(lame, shear, dim))
        offsets, weights = Stencil.family(self.kernel, spacing, dim)
        calibrate = self.kernel.calibrate
        if self.material == "correspondence":
            made = correspondence(offsets, weights, lame, shear, self.stabilisation)
        else:
            made = central(offsets, isotropic(offsets, weights) if calibrate else weights, shear)
            if self.material == "state-based":
                made = _sum(made, dilatation(offsets, weights, lame - shear, calibrate))
        return _checked(_stencil(made))


def _poisson(given: dict[str, float], fixed: float | None) -> float | None:
    """Poisson's ratio from two moduli; the material's own with one; None if it has none."""
    if {"young", "shear"} <= set(given):
        return given["young"] / (2 * given["shear"]) - 1
    if {"bulk", "shear"} <= set(given):
        return (3 * given["bulk"] - 2 * given["shear"]) / (6 * given["bulk"] + 2 * given["shear"])
    if {"young", "bulk"} <= set(given):
        return (3 * given["bulk"] - given["young"]) / (6 * given["bulk"])
    return fixed


def isotropic(offsets: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weights of bonds made so that the lattice is exactly isotropic for long waves, with half second moment 1 on
    average.

    The fourth moments of a lattice's family have cubic symmetry only. The factor ``alpha + beta sum_a n_a^4`` gives
    them the two values that they have in the continuum, ``sum w r^2 n_x^4 / 2 = 3/(dim + 2)`` and ``sum w r^2 n_x^2
    n_y^2 / 2 = 1/(dim + 2)``.

    Raises
    ------
    InputError
        A family too small for that.
    """
    dim = offsets.shape[1]
    r2 = (offsets**2).sum(1)
    n = offsets / np.sqrt(r2)[:, None]
    shape = np.stack([np.ones(len(r2)), (n**4).sum(1)])
    moments = np.stack([n[:, 0] ** 4, n[:, 0] ** 2 * n[:, 1] ** 2]) * weights * r2 / 2
    try:
        factors = np.linalg.solve(moments @ shape.T, np.array([3.0, 1.0]) / (dim + 2)) @ shape
    except np.linalg.LinAlgError:
        factors = np.zeros(1)
    if factors.min() <= 0:
        raise InputError(
            "no positive bonds of so small a family are isotropic",
            value=f"{len(weights)} neighbours",
            key="model.kernel",
            remedy="a larger horizon, or calibrate = false",
        )
    return weights * factors


def central(offsets: np.ndarray, weights: np.ndarray, shear: float) -> Table:
    """Springs along the bonds: ``(dim + 2) shear w n n`` for weights with half second moment 1 along an axis."""
    n = offsets / np.linalg.norm(offsets, axis=1)[:, None]
    return offsets, (offsets.shape[1] + 2) * shear * weights[:, None, None] * n[:, :, None] * n[:, None, :]


def dilatation(offsets: np.ndarray, weights: np.ndarray, lame: float, calibrate: bool = True) -> Table:
    """The pressure ``lame theta`` of the nonlocal dilatation ``theta = sum_k g_k . (u_k - u)``, g = w xi over half the
    second moment's trace.
    """
    moment = (weights * offsets[:, 0] ** 2).sum() if calibrate else 2.0
    g = weights[:, None] * offsets / moment
    return _convolution(offsets, g, lambda one: lame * one[:, None] * g[:, None, :])


def correspondence(
    offsets: np.ndarray, weights: np.ndarray, lame: float, shear: float, stabilisation: float = 0.0
) -> Table:
    """``div (lame tr(e) + 2 shear e)`` with the gradient ``g_k = K^-1 w xi`` and its negative transpose as divergence.

    The stabilisation adds ``c sum_k w_k (2 (u_k - u) - G_k u xi_k)``, c = stabilisation / K (in P moduli), which no
    linear field feels.
    """
    moment = (weights * offsets[:, 0] ** 2).sum()
    g = weights[:, None] * offsets / moment
    eye = np.eye(offsets.shape[1])
    push = (lame + shear, shear, -stabilisation)
    made = _convolution(
        offsets,
        g,
        lambda one: push[0] * one[:, None] * g[:, None, :] + (push[1] + push[2]) * eye * (g @ one)[:, None, None],
    )
    return _sum(made, (offsets, 2 * stabilisation / moment * weights[:, None, None] * eye)) if stabilisation else made


def finite_element(lame: float, shear: float, dim: int) -> Table:
    """Bilinear or trilinear elements with lumped mass: products of one-dimensional stiffness, mass and difference."""
    stiffness, mass, difference = (
        np.array([1.0, -2.0, 1.0]),
        np.array([1.0, 4.0, 1.0]) / 6,
        np.array([-1.0, 0.0, 1.0]) / 2,
    )

    def product(kinds: list[np.ndarray]) -> np.ndarray:
        return np.einsum(",".join("ijk"[:dim]) + "->" + "ijk"[:dim], *kinds)

    offsets = np.array([o for o in itertools.product((-1, 0, 1), repeat=dim) if any(o)])
    found = np.zeros((len(offsets), dim, dim))
    for a, b in itertools.product(range(dim), repeat=2):
        if a == b:
            along = [
                (lame + 2 * shear if c == a else shear) * product([stiffness if d == c else mass for d in range(dim)])
                for c in range(dim)
            ]
            table = np.sum(along, axis=0)
        else:
            table = (lame + shear) * product([difference if c in (a, b) else mass for c in range(dim)])
        found[:, a, b] = table[tuple(offsets.T + 1)]
    return offsets, found


def _convolution(offsets, g, product) -> Table:  # type: ignore[no-untyped-def]
    """Stencil whose weight at o is the sum over all k + l = o of ``product(g_k)[l]``, which has the products with all
    g_l at once.
    """
    reach, dim = int(np.abs(offsets).max()), offsets.shape[1]
    table = np.zeros((*[4 * reach + 1] * dim, dim, dim))
    for o, one in zip(offsets, g, strict=True):
        table[tuple((offsets + o + 2 * reach).T)] += product(one)
    return _listed(table)


def _listed(table: np.ndarray) -> Table:
    """Offsets and matrices of a dense table, without the centre and what is rounding."""
    size = np.abs(table).max((-2, -1))
    reach = np.array(size.shape) // 2
    size[tuple(reach)] = 0
    offsets = np.argwhere(size > 1e-14 * size.max())
    return offsets - reach, table[tuple(offsets.T)]


def _sum(one: Table, two: Table) -> Table:
    reach = max(int(np.abs(offsets).max(initial=0)) for offsets, _ in (one, two))  # a part may vanish
    dim = one[0].shape[1]
    table = np.zeros((*[2 * reach + 1] * dim, dim, dim))
    for offsets, weights in (one, two):
        table[tuple((offsets + reach).T)] += weights
    return _listed(table)


def _stencil(table: Table) -> Stencil:
    """A stencil with all symmetries of the lattice to the last digit: each weight is the mean over its mirror
    images."""
    offsets, weights = table
    dim = offsets.shape[1]
    known = dict(zip(map(tuple, offsets.tolist()), weights, strict=True))
    for axis in range(dim):
        sign = np.where(np.arange(dim) == axis, -1, 1)
        known = {o: (w + np.outer(sign, sign) * known[tuple((sign * o).tolist())]) / 2 for o, w in known.items()}
    return Stencil(np.array(list(known)), np.array(list(known.values())))


def _checked(stencil: Stencil) -> Stencil:
    """Refuse a stencil that gains energy for some waves."""
    lowest = float(stencil.branches(*stencil._zone()).min())
    if lowest < -1e-9:
        raise InputError(
            "the lattice material is unstable for short waves",
            value=lowest,
            limit=">= 0",
            key="model.poisson",
            remedy="a larger Poisson's ratio, or another kernel",
        )
    return stencil
