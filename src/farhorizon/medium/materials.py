"""Named materials: their constants in SI units, each with its source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from farhorizon.errors import suggestion


@dataclass(frozen=True)
class Solid:
    """Constants of an isotropic solid in SI units: Young's modulus, Poisson's ratio, the density, and the source of
    each.
    """

    young: float
    poisson: float
    density: float
    sources: Mapping[str, str]

    @property
    def constants(self) -> dict[str, float]:
        """Arguments of elastic models."""
        return {"young": self.young, "poisson": self.poisson, "density": self.density}


@dataclass(frozen=True)
class Fluid:
    """Constants of a fluid at rest in SI units: the speed of sound, the density, and the source of each."""

    speed: float
    density: float
    sources: Mapping[str, str]

    @property
    def constants(self) -> dict[str, float]:
        """Arguments of `Wave` for the pressure: the speed, and as density the compressibility ``1 / (density speed^2)``
        (1/Pa), with which the reflection of pressure at the interface of two fluids follows from their impedances.
        """
        return {"speed": self.speed, "density": 1 / (self.density * self.speed**2)}


def _of(**sources: str) -> Mapping[str, str]:
    return MappingProxyType(sources)


class _Named(type):
    """Metaclass that suggests the nearest name for an unknown material."""

    def __getattr__(cls, name: str) -> Any:
        raise AttributeError(f"there is no material {name!r}; {suggestion(name, named())}")


class materials(metaclass=_Named):
    """Named materials in SI units, with a source for each number.

    The ``constants`` of a material are the arguments of a model. Solids have Young's modulus, Poisson's ratio and
    density. A bond-based material, whose Poisson's ratio is fixed, refuses any other value: give it ``young`` and
    ``density`` only, which preserves Young's modulus and changes the other moduli. Fluids have the speed of sound and,
    as the density of `Wave`, the compressibility: the field is then the pressure. In case files ``of = "steel"`` in
    ``[model]`` and ``[[material]]`` has the same effect, in the units of the case.

    Strengths and fracture energies are not included: they depend on the specimen, its surface and the loading rate.

    Attributes
    ----------
    steel : Solid
        Structural steel.
    aluminium : Solid
        Structural alloys.
    glass : Solid
        Soda-lime glass.
    concrete : Solid
        C30/37, uncracked, without reinforcement.
    homalite : Solid
        Homalite-100, for waves and running cracks.
    pmma : Solid
        Poly(methyl methacrylate).
    granite : Solid
        Lac du Bonnet granite, intact.
    bone : Solid
        Human cortical bone, assumed to be isotropic: across the axis of a long bone it is about a third softer than
        along it (Reilly and Burstein 1975).
    water : Fluid
        At 20 degrees Celsius.
    air : Fluid
        Dry, at 15 degrees Celsius and 101 325 Pa.

    Examples
    --------
    >>> import farhorizon as fh
    >>> steel = fh.materials.steel
    >>> plate = fh.Elastic(fh.Kernel(0.01), **steel.constants, material="state-based")
    >>> round(plate.p_speed), round(plate.s_speed)
    (6001, 3208)
    >>> steel.sources["density"]
    'EN 1991-1-1:2002, table A.4'
    >>> bonds = fh.Elastic(fh.Kernel(0.01), young=steel.young, density=steel.density)  # Poisson's ratio is 1/4
    """

    steel = Solid(
        young=210e9,
        poisson=0.3,
        density=7850.0,
        sources=_of(
            young="EN 1993-1-1:2005, 3.2.6", poisson="EN 1993-1-1:2005, 3.2.6", density="EN 1991-1-1:2002, table A.4"
        ),
    )
    aluminium = Solid(
        young=70e9,
        poisson=0.3,
        density=2700.0,
        sources=_of(
            young="EN 1999-1-1:2007, 3.2.5", poisson="EN 1999-1-1:2007, 3.2.5", density="EN 1999-1-1:2007, 3.2.5"
        ),
    )
    glass = Solid(
        young=70e9,
        poisson=0.2,
        density=2500.0,
        sources=_of(young="EN 572-1:2012", poisson="EN 572-1:2012", density="EN 572-1:2012"),
    )
    concrete = Solid(
        young=33e9,
        poisson=0.2,
        density=2400.0,
        sources=_of(
            young="EN 1992-1-1:2004, table 3.1 (E_cm of C30/37)",
            poisson="EN 1992-1-1:2004, 3.1.3",
            density="EN 1991-1-1:2002, table A.1",
        ),
    )
    homalite = Solid(
        young=5.2e9,
        poisson=0.34,
        density=1230.0,
        sources=_of(
            young="Samudrala and Rosakis (2003), dynamic",
            poisson="Samudrala and Rosakis (2003), dynamic",
            density="Samudrala and Rosakis (2003)",
        ),
    )
    pmma = Solid(
        young=3.24e9,
        poisson=0.35,
        density=1190.0,
        sources=_of(
            young="Xu and Needleman (1994), J. Mech. Phys. Solids 42",
            poisson="Xu and Needleman (1994), J. Mech. Phys. Solids 42",
            density="Xu and Needleman (1994), J. Mech. Phys. Solids 42",
        ),
    )
    granite = Solid(
        young=69e9,
        poisson=0.26,
        density=2630.0,
        sources=_of(
            young="Potyondy and Cundall (2004), Int. J. Rock Mech. Min. Sci. 41, after Martin (1993)",
            poisson="Potyondy and Cundall (2004), Int. J. Rock Mech. Min. Sci. 41, after Martin (1993)",
            density="Potyondy and Cundall (2004), Int. J. Rock Mech. Min. Sci. 41",
        ),
    )
    bone = Solid(
        young=20.7e9,
        poisson=0.3,
        density=1920.0,
        sources=_of(
            young="Rho, Ashman and Turner (1993), J. Biomechanics 26, by ultrasound",
            poisson="Zysset, Guo, Hoffler, Moore and Goldstein (1999), J. Biomechanics 32, as assumed there",
            density="ICRU Report 44 (1989)",
        ),
    )
    water = Fluid(
        speed=1482.3,
        density=998.2,
        sources=_of(
            speed="Del Grosso and Mader (1972)",
            density="Tanaka, Girard, Davis, Peuto and Bignell (2001), Metrologia 38",
        ),
    )
    air = Fluid(
        speed=340.29,
        density=1.225,
        sources=_of(
            speed="ISO 2533:1975, standard atmosphere at sea level",
            density="ISO 2533:1975, standard atmosphere at sea level",
        ),
    )


def named() -> dict[str, Solid | Fluid]:
    """All named materials, by name."""
    return {name: material for name, material in vars(materials).items() if isinstance(material, Solid | Fluid)}
