"""Elasticity on the lattice: bond-based, ordinary state-based, correspondence and finite elements, each as one stencil
of matrices.

The tables of the bonds are in `farhorizon.medium.solids`.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Frequency, Unit
from farhorizon.engine.codegen.bond_sweeps import SOFTENINGS
from farhorizon.errors import InputError
from farhorizon.medium.attenuation import Attenuation
from farhorizon.medium.bond_laws import BondLaw
from farhorizon.medium.force_states import (
    ForceStates,
    corrected_dilatation_states,
    correspondence_states,
    dilatation_states,
    energy_of_bonds,
)
from farhorizon.medium.fracture import fracture_energy as energy_of_fracture
from farhorizon.medium.fracture import stretch_that_spends
from farhorizon.medium.integrators import Integrator
from farhorizon.medium.kernel import Kernel
from farhorizon.medium.moduli import Moduli, check_ratio, moduli_of
from farhorizon.medium.solids import (
    Table,
    central,
    correspondence,
    dilatation,
    finite_element,
    isotropic,
    neutral_stabilisation,
    stable_solid,
    stencil_of,
    sum_of,
)
from farhorizon.medium.stencil import Stencil
from farhorizon.medium.variation import Variation
from farhorizon.models.model import (
    Constant,
    Density,
    LatticeModel,
    Modulus,
    Ordered,
    attenuation_of,
    material_constant,
    second_order,
)

MATERIALS = ("bond-based", "state-based", "correspondence", "finite-element")
CALIBRATIONS = ("running", "static")
_BREAKABLE = MATERIALS[:3]
_SOFT = MATERIALS[:2]  # at surfaces
_CAUCHY = {"strain": 0.25, "stress": 1 / 3, None: 0.25}  # Poisson's ratio of central forces
#: For messages; docs/explanation/elasticity.md contains it as a table.
COMBINATIONS = (
    'with LatticePML or Sponge: free sides, bodies and cracks of material="bond-based" (Poisson\'s ratio 1/4, in plane '
    'stress 1/3), "state-based" and "correspondence" (any ratio); "finite-element" without them. '
    'With NonlocalPML (cross = 0.1): "correspondence" without stabilisation'
)


class Elastic(LatticeModel):
    r"""Linear elastic waves, :math:`\rho\,(u_{tt} + 2 d\,u_t) = \int W(\xi)\,(u' - u)\,dV' + b`, by velocity Verlet, in
    two and three dimensions.

    Parameters
    ----------
    kernel : Kernel, Stencil or None
        Influence function ``w(r)/r^p`` of the bonds (exponent 1 and constant influence: the prototype microelastic
        material), or of the weights of state-based and correspondence materials; None for finite elements. A `Stencil`
        of matrices, for unit P modulus, replaces that of the material.
    young : float, str, ndarray or callable, optional
        Young's modulus. Two of the four moduli are required, but only one for bond-based materials, whose Poisson's
        ratio is fixed. Where the material varies, an expression or a function of the coordinates, or the values at the
        nodes.
    poisson : float, str, ndarray or callable, optional
        Poisson's ratio; given like `young`.
    bulk : float, str, ndarray or callable, optional
        Bulk modulus; given like `young`.
    shear : float, str, ndarray or callable, optional
        Shear modulus; given like `young`.
    density : float, str, ndarray or callable
        Mass per volume; given like `young`.
    material : {"bond-based", "state-based", "correspondence", "finite-element"}
    plane : {"strain", "stress"}, optional
        Plane strain or plane stress in two dimensions; "strain" unless given.
    damping : float
        Viscous damping d (1 / time): the equation has 2 d u_t, so that waves decay as exp(-d t).
    stabilisation : float
        For correspondence materials: strength of the force against zero-energy modes, 0 to 1 times the P modulus.
    nonlinear : bool
        For bond-based materials: the force ``c (|xi + eta| - |xi|)`` acts along the deformed bond (the prototype
        microelastic material) and is not linearised in eta.
    critical_stretch : float, str, ndarray or callable, optional
        Bonds whose relative elongation exceeds this value break permanently; not available for finite elements. Those
        of a correspondence material break when as much energy is lost with them as in an intact body that is stretched
        uniformly until the longest bonds have this stretch (`farhorizon.medium.force_states.energy_of_bonds`). In
        uniaxial tension this requires a larger stretch, starting at about ``1 / sqrt(1 - poisson)`` times the value in
        plane stress and ``sqrt((1 - poisson) / (1 - 2 poisson))`` times the value in plane strain: 1.12 and 1.15 for a
        ratio of 0.2, 1.35 and 2.35 for 0.45. May vary like `young`: a bond breaks when its weaker end would.
    fracture_energy : float, str, ndarray or callable, optional
        Instead of the critical stretch, the energy that a new crack takes per area; see `critical_stretch_on`. For
        bond-based materials with softening, in addition to the critical stretch.
    calibrate : {"running", "static"}
        Which crack takes the fracture energy: one that runs, or one at rest in a slowly pulled strip when it begins to
        grow, which takes more, because its tip waits at each row of nodes
        (`farhorizon.simulation.setup.crack_calibration`).
    softening : {"linear", "exponential"}, optional
        For bond-based materials with a critical stretch and a fracture energy: bonds do not break at that stretch but
        begin to soften there (by a bilinear or an exponential law), so that a new crack absorbs the fracture energy;
        they unload along the secant.
    law : BondLaw, optional
        For bond-based materials: the law of bonds as a function, which says when they break, instead of a critical
        stretch, a fracture energy and softening.
    contact : bool, optional
        Bonds that are cut or broken transmit compression when they are shorter than initially, so that the faces of a
        closing crack do not pass through each other; not available for finite elements. In state-based and
        correspondence materials such bonds act like the springs of a bond-based material of the same P modulus. The
        same as `nonlinear` unless given. Linear bonds across the given cracks push along the normal of the crack
        instead, so that its faces slide (`farhorizon.engine.features.faces`).
    friction : float
        Coulomb's coefficient between such faces.
    integrator : {"verlet", "modified-equation"}
        As for `Wave`: the modified equation serves solids whose bonds neither break nor have a law of their own.
    attenuation : Attenuation, optional
        The quality factor of the medium, the same everywhere and for P and S waves, of a solid whose bonds neither
        break nor have a law of their own; the moduli are then those at its reference frequency.
    surface : {"energy"}, optional
        For bond-based and state-based materials: the bonds of nodes near free sides and at the surface of a body are
        stiffened such that the energy of each node, and its dilatation, under unit stretches along each axis and each
        pair of axes are those inside the solid (`farhorizon.medium.surface`). Bodies of 3 nodes and more then have the
        given moduli in tension and shear, within 2 %. Faces of cracks are not corrected. Steps are shorter, and
        take four to nine times the time, in state-based bodies five to 43 times (`benchmarks/features.py surface`).

    Attributes
    ----------
    young, poisson, bulk, shear, lame : float
        All moduli; `lame` is Lame's first constant, in plane stress the effective one of the plane,
        ``2 lam mu / (lam + 2 mu)``. Where moduli or density vary, only the given ones are set, in the form in which
        they were given; the others are None.
    coefficient : float
        Squared speed of P waves, with attenuation of those of infinite frequency; not defined where moduli or density
        vary.

    Raises
    ------
    InputError
        Constants that are missing, superfluous or impossible: a Poisson's ratio outside -1..0.5, or for bond-based
        materials other than 1/4 (1/3 in plane stress). Also raised later when wave speeds are requested where moduli or
        density vary, since they have no single value there; `Simulation.model`, the uniform medium with the median
        constants, provides them.

    Notes
    -----
    Bonds: Silling (2000), linearised unless `nonlinear`; breaking bonds: Silling and Askari (2005). State-based:
    Silling, Epton, Weckner, Xu and Askari (2007), eq 104, linearised: its dilatation acts with lam - mu.
    Correspondence: the same paper, section 18, with the gradient of Wildman and Gazonas (2012), eqs 2-8 to 2-13; the
    stabilisation is that of Silling (2017), eq 21. The forces of state-based and correspondence materials follow from
    states of the nodes (`farhorizon.medium.force_states`): their bonds may be cut and may break, but cannot be
    weakened. A bond between nodes of different strengths breaks at the smaller of their critical stretches, as in
    Parks, Lehoucq, Plimpton and Silling (2008), Computer Physics Communications 179. The surface is corrected by the
    energy method of Madenci and Oterkus (2014), Peridynamic Theory and Its Applications, section 4.2 (Le and Bobaru
    2018, Computational Mechanics 61, 499), which compares stretches along the axes alone and takes the factor of a bond
    from an ellipsoid; that leaves 3 to 12 % in tension and up to 40 % in shear of bodies of 3 and more nodes.

    Examples
    --------
    >>> import farhorizon as fh
    >>> rock = fh.Elastic(fh.Kernel(2.0), young=50.0, density=2.0)  # bond-based: Poisson's ratio is 1/4
    >>> round(rock.p_speed / rock.s_speed, 6)  # sqrt(3)
    1.732051
    >>> seam = fh.Elastic(fh.Kernel(2.0), young=50.0, critical_stretch="where(abs(y) < 1, 0.001, 0.01)")
    """

    young: Any
    poisson: Any
    bulk: Any
    shear: Any
    lame: Any
    density: Any
    others: ClassVar[Mapping[str, str]] = {
        "speed": "young and poisson, as of a solid of fh.materials; a fluid is a Wave of its pressure: "
        "fh.Wave(kernel, **fh.materials.water.constants)"
    }
    energy_factor: float | None = None  # see `farhorizon.simulation.setup.crack_calibration.energy_factor`
    each_bond: bool = True  # whether bonds that are stiffer near surfaces are swept one by one
    spent_by_running: float | None = None  # energy of a running crack over the fracture energy, where it is at rest
    quantity, field_unit = "displacement", "m"
    target = 1e-4  # a tenth of it doubles the number of nodes, because of strong backward waves

    def __init__(
        self,
        kernel: Kernel | Stencil | None = None,
        young: Modulus | None = None,
        poisson: Constant | None = None,
        *,
        bulk: Modulus | None = None,
        shear: Modulus | None = None,
        density: Density = 1.0,
        material: str = "bond-based",
        plane: str | None = None,
        damping: Frequency = 0.0,
        stabilisation: float = 0.0,
        nonlinear: bool = False,
        critical_stretch: Constant | None = None,
        fracture_energy: Annotated[Constant | None, Unit("J/m^2")] = None,
        softening: str | None = None,
        law: BondLaw | None = None,
        contact: bool | None = None,
        friction: float = 0.0,
        integrator: str | Integrator = "verlet",
        attenuation: Attenuation | None = None,
        surface: str | None = None,
        calibrate: str = "running",
    ) -> None:
        kinds.one_of(material, "model.material", MATERIALS, "unknown material")
        if plane is not None:
            kinds.one_of(plane, "model.plane", ("strain", "stress"), "unknown plane state")
        _check_kernel(kernel, material)
        if kernel is not None:
            super().__init__(kernel)
        self.kernel, self.material, self.plane = kernel, material, plane
        self.stabilisation = _checked_stabilisation(stabilisation, material)
        self.bonds = material == "bond-based"
        self.nonlinear = kinds.flag(nonlinear, "model.nonlinear")
        self.critical_stretch, self.fracture_energy = critical_stretch, fracture_energy
        if softening is not None:
            kinds.one_of(softening, "model.softening", SOFTENINGS, "unknown softening")
        self.softening = softening
        if law is not None:
            kinds.instance(law, "model.law", BondLaw, "a law of bonds", remedy=", ".join(sorted(BondLaw.known)))
        self.law = law
        self.contact = self.nonlinear if contact is None else kinds.flag(contact, "model.contact")
        self.friction = kinds.number(friction, "model.friction", least=0)
        self.calibrate = kinds.one_of(calibrate, "model.calibrate", CALIBRATIONS, "unknown calibration")
        self._check_law()
        self.surface = surface
        self._check_surface()
        self.damping = kinds.number(damping, "model.damping", least=0)
        self.integrator = second_order(integrator, self.damping)
        self.attenuation = attenuation_of(attenuation)
        moduli = {"young": young, "poisson": poisson, "bulk": bulk, "shear": shear}
        self._given_moduli = {
            name: material_constant(value, f"model.{name}", positive=name != "poisson")
            for name, value in moduli.items()
            if value is not None
        }
        self.density = material_constant(density, "model.density")
        uneven = sorted(set(self.uneven) - {"density"})
        if uneven and not self.cuttable:
            raise InputError(
                f"the moduli of {self.title} are the same everywhere",
                value=kinds.said(self.uneven[uneven[0]]),
                limit="a number",
                key=f"model.{uneven[0]}",
                remedy='material = "bond-based", "state-based" or "correspondence" with a kernel; the density may vary',
            )
        self._set_derived()

    mechanical = True

    def serves(self, side: Any) -> bool:
        """Whether a side can be used with the material: it must support vector fields and, where bonds cannot be cut,
        be one that bonds cross.
        """
        if side.derivatives:
            return self.material == "correspondence" and isinstance(self.kernel, Kernel) and not self.stabilisation
        return super().serves(side) and "one component" not in side.assumes

    def _check_law(self) -> None:
        """Check the parameters of bonds that have a law of their own stretch."""
        if self.softening is None and len(self._strength) == 2:
            raise InputError(
                "critical_stretch and fracture_energy are two names of one thing where bonds break at once",
                value=self.fracture_energy,
                key="model.fracture_energy",
                remedy='give one of them, or softening="linear"',
            )
        for name, value in self._strength.items():
            setattr(self, name, material_constant(value, f"model.{name}"))
        flags = {"nonlinear": self.nonlinear, "contact": self.contact, "softening": self.softening, "law": self.law}
        given = [*(name for name, value in flags.items() if value), *self._strength]
        if self.law is not None and (self._strength or self.softening):
            raise InputError(
                "a law says itself when bonds soften and break",
                value=self.softening or next(iter(self._strength.values())),
                key="model.softening" if self.softening else f"model.{next(iter(self._strength))}",
                remedy="leave it out, or leave law out",
            )
        of_bonds = [name for name in ("nonlinear", "softening", "law") if flags[name]]
        served, asked = (("bond-based",), of_bonds) if of_bonds else (_BREAKABLE, given)
        if given and (self.material not in served or not isinstance(self.kernel, Kernel)):
            raise InputError(
                f"bonds of this material have no {asked[0]}",
                value=self.material,
                limit=f"{' or '.join(served)} with a kernel",
                key=f"model.{asked[0]}",
                remedy='material="bond-based", or critical_stretch, fracture_energy and contact alone',
            )
        if self.friction and not self.slides:
            raise InputError(
                "friction acts between faces of cracks that touch and slide, of linear bonds",
                value=self.friction,
                limit="0 without contact, and for nonlinear bonds",
                key="model.friction",
                remedy="nonlinear=False" if self.contact else "contact=True",
            )
        if self.calibrate == "static" and (self.fracture_energy is None or self.softening is not None):
            raise InputError(
                "a crack at rest calibrates the critical stretch of bonds that break at once",
                value=self.calibrate,
                limit="a fracture_energy without softening",
                key="model.calibrate",
                remedy="leave it out",
            )
        if self.softening is not None and len(self._strength) < 2:
            raise InputError(
                "bonds that soften have a critical stretch, where they begin to, and a fracture energy",
                value=self._strength or None,
                key="model.softening",
                remedy="critical_stretch = tensile strength / Young's modulus, and fracture_energy",
            )

    def _check_surface(self) -> None:
        """Check that surfaces of the material can be corrected."""
        if self.surface is None:
            return
        kinds.one_of(self.surface, "model.surface", ("energy",), "unknown correction of surfaces")
        if self.material not in _SOFT or not isinstance(self.kernel, Kernel):
            raise InputError(
                "surfaces of this material are not softer by bonds that are absent",
                value=self.material,
                limit=f"{' or '.join(_SOFT)} with a kernel",
                key="model.surface",
                remedy="leave it out",
            )
        if self.law is not None:
            raise InputError(
                "surfaces are corrected only for bonds whose law is built in",
                value=type(self.law).__name__,
                limit="critical_stretch, fracture_energy, softening",
                key="model.law",
                remedy="leave model.law or model.surface out",
            )

    combinations = COMBINATIONS

    @property
    def title(self) -> str:
        """The title, which includes the kind of material."""
        return f"Elastic of {self.material} material"

    @property
    def _strength(self) -> dict[str, Any]:
        """Parameters of the strength of bonds, in the form in which they were given."""
        given = {name: getattr(self, name) for name in ("critical_stretch", "fracture_energy")}
        return {name: value for name, value in given.items() if value is not None}

    @property
    def bondwise(self) -> bool:
        """Whether bonds follow individual laws of stretch: nonlinear, breaking, closing or thermally strained; also if
        they are stiffer near surfaces, because sweeping them one by one takes less than correcting a sweep.
        """
        stiffer = self.bonds and self.surface is not None and self.each_bond
        return self.nonlinear or self.contact or self.warm or self.law is not None or stiffer or bool(self._strength)

    @property
    def slides(self) -> bool:
        """Whether the faces of cracks slide where they are in contact: normals stay as they are at small strains."""
        return self.contact and not self.nonlinear

    @property
    def bond_law(self) -> Elastic | None:
        """The model itself where bonds follow individual laws, else None."""
        return self if self.bondwise else None

    @property
    def soft_at_surfaces(self) -> Elastic | None:
        """The model itself if it is bond-based or state-based and not corrected; the gradients of correspondence
        materials are exact at surfaces.
        """
        soft = self.material in _SOFT and isinstance(self.kernel, Kernel) and self.surface is None
        return self if soft else None

    @property
    def stiffens_surfaces(self) -> bool:
        """Whether bonds of nodes that lack some are stiffer than others."""
        return self.surface is not None

    @property
    def cuttable(self) -> bool:
        """Whether bonds may be absent."""
        return self.bonds or isinstance(self.kernel, Kernel)

    @property
    def caution(self) -> str | None:
        """Warning that stabilisation makes short S waves faster than long ones, see `neutral_stabilisation`."""
        neutral = float(np.min(neutral_stabilisation(self.lame, self.shear)))
        if self.stabilisation <= neutral * (1 + 1e-9):
            return None
        return (
            f"a stabilisation of {self.stabilisation:g} makes short S waves faster than long ones: above {neutral:.3g} "
            "cracks may outrun Rayleigh waves, and dissipate more across the lattice than along it"
        )

    @property
    def linearised(self) -> Elastic:
        """The same material, linear and unbreakable."""
        model = copy.copy(self)
        model.nonlinear, model.contact, model.critical_stretch, model.fracture_energy = False, False, None, None
        model.friction = 0.0
        model.softening, model.law, model.warm, model.each_bond = None, None, False, False
        return model

    def heated(self, coupled: bool = False) -> Elastic:
        """The same material with thermal strains: its bonds are then computed one by one."""
        if self.law is not None:
            raise InputError(
                "thermal strain is available only for bonds whose law is built in",
                value=type(self.law).__name__,
                limit="critical_stretch, fracture_energy, softening",
                key="load",
                remedy="leave model.law out",
            )
        if self.material not in _BREAKABLE or not isinstance(self.kernel, Kernel) or self.nonlinear:
            raise InputError(
                "thermal strain is available only for solids of bonds or states with small strains",
                value="nonlinear = True" if self.nonlinear else self.material,
                limit=f"{', '.join(_BREAKABLE)} with a kernel",
                key="load",
                remedy="nonlinear=False" if self.nonlinear else 'material="bond-based"',
            )
        if self.surface is not None:
            raise InputError(
                "thermal strain is not available with corrected surfaces",
                value=self.surface,
                key="model.surface",
                remedy="leave it out, or fh.surface_factor on young",
            )
        if coupled and self.contact:
            raise InputError(
                "the heat of deformation requires bonds that carry nothing once they are broken",
                value="contact = True",
                limit="contact = False",
                key="load.coupled",
                remedy="contact=False, or coupled=False",
            )
        model = copy.copy(self)
        model.warm = True
        return model

    def bond_stiffness(self, stencil: Stencil, spacing: float) -> np.ndarray:
        """Force density per elongation of each bond of the material's stencil."""
        return np.asarray(np.trace(stencil.weights, axis1=1, axis2=2) * self.p_modulus / spacing**2)

    def critical_stretch_on(self, spacing: float, dim: int, strength: Any = 1.0, stiffness: Any = 1.0) -> Any:
        """The stretch at which bonds break: the given one, or that from the fracture energy and the bonds of the
        lattice; infinite if neither is given. The elastic limit of a law that is a function, minus infinity if it has
        none.

        For a bond-based material, the energy of the bonds across a plane, averaged over its directions
        (`medium.fracture.fracture_energy`), equals the fracture energy. That of a crack along an axis of the lattice
        differs from it, because the lattice is not a continuum. For the other materials it is the energy spent by a
        running crack (`farhorizon.simulation.setup.crack_calibration`), and with `calibrate` "static" for all of them
        that at which a crack at rest grows; a simulation computes either when it is set up.

        Parameters
        ----------
        spacing : float
        dim : int
        strength : float or ndarray
            Critical stretch, or fracture energy, relative to that of the material.
        stiffness : float or ndarray
            Stiffness of the bonds relative to those of the material: stiffer bonds stretch less for the same energy.

        Returns
        -------
        float or ndarray

        Raises
        ------
        InputError
            A fracture energy for which the energy spent by a running crack has not been computed yet.
        """
        if self.law is not None:
            return -np.inf if self.law.elastic_limit is None else self.law.elastic_limit
        if self.critical_stretch is not None:
            return self.critical_stretch * strength
        if self.fracture_energy is None:
            return np.inf
        if not self.bonds or self.calibrate == "static":
            if self.energy_factor is None or not isinstance(self.kernel, Kernel):
                raise InputError(
                    "what a crack dissipates in this material is found when a simulation is set up",
                    value=self.title,
                    key="model.fracture_energy",
                    remedy="Simulation(...).model, or fh.calibrated_stretch",
                )
            energy = self.fracture_energy * strength / np.asarray(stiffness, float)
            return stretch_that_spends(energy, self.energy_factor, self.young, self.kernel.horizon)
        stencil = self.stencil(spacing, dim)
        of_one = energy_of_fracture(spacing * stencil.offsets, self.bond_stiffness(stencil, spacing), 1.0)
        with np.errstate(divide="ignore"):  # bonds without stiffness never break
            return np.sqrt(self.fracture_energy * strength / (of_one * np.asarray(stiffness, float)))

    def _set_derived(self) -> None:
        """Compute all constants from those that are given."""
        given = self._given_moduli
        if self.uneven:
            self.young, self.poisson, self.bulk, self.shear, self.lame = (
                given.get(name) for name in ("young", "poisson", "bulk", "shear", "lame")
            )
            return
        self.young, self.poisson, self.bulk, self.shear, self.lame = _moduli(self, given)
        self.source_factor = 1 / self.density
        stiffer = 1.0 if self.attenuation is None else self.attenuation.strongest.unrelaxed
        self.coefficient = stiffer * self.p_modulus / self.density

    @property
    def uneven(self) -> dict[str, Any]:
        """The moduli and the density, as far as they vary."""
        return {name: value for name, value in self.wave_constants.items() if not isinstance(value, float)}

    @property
    def wave_constants(self) -> dict[str, Any]:
        """The moduli that were given, and the density."""
        return self._given_moduli | {"density": self.density}

    @property
    def varying(self) -> dict[str, Any]:
        """All varying constants: those of `uneven`, and the critical stretch or fracture energy."""
        return self.uneven | {name: value for name, value in self._strength.items() if not isinstance(value, float)}

    def with_constants(self, constants: Mapping[str, Any]) -> Elastic:
        """The same material with other constants."""
        model = copy.copy(self)
        model._given_moduli = {name: constants.get(name, value) for name, value in self._given_moduli.items()}
        model.density = constants.get("density", self.density)
        for name, value in self._strength.items():
            setattr(model, name, constants.get(name, value))
        model._set_derived()
        return model

    @classmethod
    def check_constant(cls, name: str, values: np.ndarray, key: str) -> None:
        """Refuse values that are not positive; for Poisson's ratio, values outside its range."""
        if name == "poisson":
            check_ratio(values, key)
        else:
            super().check_constant(name, values, key)

    def ordered(self, values: Mapping[str, np.ndarray]) -> list[Ordered]:
        """Nodes are ordered by the speed of P waves, and for each strength separately."""
        by_strength: list[Ordered] = [(values[name], {name: values[name]}) for name in self._strength if name in values]
        if not self.uneven:
            return by_strength
        solids = _moduli(self, values)
        modulus, density = np.broadcast_arrays(solids.lame + 2 * solids.shear, values.get("density", self.density))
        given = {name: values.get(name, value) for name, value in self._given_moduli.items()}
        of_solid = {name: np.broadcast_to(value, modulus.shape) for name, value in given.items()}
        return [*by_strength, (modulus / density, of_solid | {"density": density})]

    def beside(self, values: Mapping[str, np.ndarray]) -> Variation:
        """Variation of moduli, density and strength relative to this model."""
        variation = _solid_beside(self, {name: value for name, value in values.items() if name not in self._strength})
        over = {name: values[name] / value for name, value in self._strength.items() if name in values}
        if self.softening is None:
            return replace(variation, strength=next(iter(over.values()), None))
        return replace(variation, strength=over.get("critical_stretch"), toughness=over.get("fracture_energy"))

    def expansion(self, dim: int) -> float:
        """Strain across a body over its compression by forces along one axis."""
        lame, shear = self.moduli
        return lame / ((dim - 1) * lame + 2 * shear)

    def of_ratio(self, lame: float) -> Elastic:
        """The same material of unit P modulus, `lame` of which is Lame's constant."""
        model = copy.copy(self)
        model._given_moduli, model.density = {}, 1.0
        model.lame, model.shear = lame, (1 - lame) / 2
        return model

    @property
    def moduli(self) -> tuple[float, float]:
        """Lame's constants; raises InputError where moduli or density vary."""
        for name, value in self.uneven.items():
            raise InputError(
                "where constants vary from node to node there is no single modulus or wave speed",
                value=kinds.said(value),
                limit="a number",
                key=f"model.{name}",
                remedy="Simulation(...).model, which is the uniform medium in the middle of all speeds",
            )
        return self.lame, self.shear

    @property
    def p_modulus(self) -> float:
        """Modulus of P waves, ``lam + 2 mu``."""
        lame, shear = self.moduli
        return lame + 2 * shear

    @property
    def p_speed(self) -> float:
        """Speed of long P waves."""
        return float(np.sqrt(self.p_modulus / self.density))

    @property
    def speed_ratio(self) -> float:  # type: ignore[override]
        """Ratio of the speeds of P and S waves."""
        return self.p_speed / self.s_speed

    @property
    def s_speed(self) -> float:
        """Speed of long S waves."""
        return float(np.sqrt(self.moduli[1] / self.density))

    @property
    def speeds(self) -> dict[str, float]:
        """The speeds of long P and S waves."""
        return {"P": self.p_speed, "S": self.s_speed}

    def with_stencil(self, stencil: Stencil) -> Elastic:
        """The same model, linear, with a stencil instead of that of its material."""
        model = super().with_stencil(stencil).linearised
        model.kernel, model.surface = stencil, None
        return model

    def force_states(self, spacing: float, dim: int) -> ForceStates | None:
        """Gradients and stresses of a correspondence material, dilatations and pressures of a state-based one.

        Bonds that close act as springs of a bond-based material, whose P modulus is three times its shear modulus.
        """
        if self.bonds or not isinstance(self.kernel, Kernel) or self._given is not None:
            return None
        offsets, weights = Stencil.family(self.kernel, spacing, dim)
        lame, shear = self.lame / self.p_modulus, self.shear / self.p_modulus
        if self.material == "correspondence":
            states = correspondence_states(offsets, weights, lame, shear, self.stabilisation)
            states = replace(states, released=energy_of_bonds(states))
        else:
            bonds = _springs(self.kernel, offsets, weights, shear)[1]
            dilatations = dilatation_states if self.surface is None else corrected_dilatation_states
            states = dilatations(offsets, bonds, weights, lame - shear, self.kernel.calibrate)
        if not self.contact:
            return states
        return replace(states, closed=stencil_of(_springs(self.kernel, offsets, weights, 1 / 3)).weights)

    def stencil(self, spacing: float, dim: int) -> Stencil:
        """Stencil for unit P modulus."""
        if dim == 1:
            raise InputError(
                "elasticity needs two or three dimensions",
                value=dim,
                limit="2 or 3",
                key="lattice",
                remedy="Wave is the bar",
            )
        if dim == 3 and self.plane is not None:
            raise InputError(
                "only two dimensions have a plane state",
                value=self.plane,
                limit="2 dimensions",
                key="model.plane",
                remedy="leave it out",
            )
        if isinstance(self.kernel, Stencil):
            given = super().stencil(spacing, dim)
            if given.components == 1:
                raise InputError("elasticity needs a stencil of matrices", value=str(given), key="model.kernel")
            return given
        lame, shear = self.lame / self.p_modulus, self.shear / self.p_modulus
        if self.kernel is None:
            return stencil_of(finite_element(lame, shear, dim))
        offsets, weights = Stencil.family(self.kernel, spacing, dim)
        if self.material == "correspondence":
            table = correspondence(offsets, weights, lame, shear, self.stabilisation)
        else:
            table = _springs(self.kernel, offsets, weights, shear)
            if self.material == "state-based":
                table = sum_of(table, dilatation(offsets, weights, lame - shear, self.kernel.calibrate))
        return stable_solid(stencil_of(table))


def _check_kernel(kernel: Kernel | Stencil | None, material: str) -> None:
    """Check that all materials except finite elements have a kernel, or a stencil instead."""
    if (kernel is None) != (material == "finite-element") and not isinstance(kernel, Stencil):
        raise InputError(
            f"a {material} material needs " + ("a kernel" if kernel is None else "no kernel"),
            value=kinds.said(kernel),
            key="model.kernel",
            remedy="Kernel(horizon=3*spacing, exponent=1)" if kernel is None else "leave it out",
        )


def _checked_stabilisation(strength: float, material: str) -> float:
    checked = kinds.number(strength, "model.stabilisation", least=0, most=1)
    if checked and material != "correspondence":
        raise InputError(
            "stabilisation is for correspondence materials",
            value=material,
            limit="correspondence",
            key="model.stabilisation",
            remedy="leave it out",
        )
    return checked


def _springs(kernel: Kernel | Stencil | None, offsets: np.ndarray, weights: np.ndarray, shear: float) -> Table:
    """Return the bonds of a bond-based material, or those in addition to the dilatation of a state-based one."""
    calibrate = isinstance(kernel, Kernel) and kernel.calibrate
    return central(offsets, isotropic(offsets, weights) if calibrate else weights, shear)


def _moduli(model: Elastic, values: Mapping[str, Any]) -> Moduli:
    """Return the moduli of a solid with other values of the given constants."""
    fixed = _CAUCHY[model.plane] if model.bonds else None
    given = {name: values.get(name, value) for name, value in model._given_moduli.items()}
    return moduli_of(given, fixed, model.plane, model.material, COMBINATIONS)


def _solid_beside(model: Elastic, values: Mapping[str, np.ndarray]) -> Variation:
    """Return the variation of moduli and density relative to a uniform solid."""
    if not values:
        return Variation()
    solids = _moduli(model, values)
    modulus, density = np.broadcast_arrays(solids.lame + 2 * solids.shear, values.get("density", model.density))
    variation = Variation(modulus / model.p_modulus, density / model.density)
    if model.bonds or set(values) <= {"density"}:
        return variation
    lame, shear = np.array([np.broadcast_to(constant, modulus.shape) for constant in (solids.lame, solids.shear)])
    variation = replace(variation, lame=np.stack([lame, shear]))
    lame, shear = lame / model.p_modulus, shear / model.p_modulus
    if model.material == "state-based":
        moduli = np.stack([lame - shear, 0 * shear, 0 * shear])
        return replace(variation, moduli=moduli, springs=shear * model.p_modulus / model.shear)
    relative = modulus / model.p_modulus
    moduli = np.stack([lame, shear, model.stabilisation * relative])
    return replace(variation, moduli=moduli, springs=relative if model.stabilisation else None)
