"""A solid and its temperature."""

from __future__ import annotations

from typing import Any

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.models.elastic import Elastic
from farhorizon.models.heat import Heat
from farhorizon.models.model import BondLaw, Constant, LatticeModel, material_constant


class Thermoelastic(LatticeModel):
    r"""Displacements and the temperature of a solid on one lattice: heat strains it, and what is deformed heats.

    .. math::

        \rho\,u_{tt} = \mathrm{div}\,\sigma(u) - \nabla(\beta\,(T - T_0)) + b, \qquad
        \rho c\,T_t = \kappa\,\Delta T - T_0\,\beta\,\mathrm{div}\,u_t + w, \qquad \beta = \alpha\,(3 \lambda + 2 \mu)

    The fields are u and T. A `Setup` keeps the displacements with a `ThermalLoad`, whose temperature is the set-up of
    the heat. `boundary`, `sources` and `coefficient` may be given by field, ``{"u": ..., "T": ...}``; sides are those
    of both fields otherwise, sources forces on the solid; `initial` has "u", "v" and "T", which is `reference` unless
    given. Of the constraints `Prescribed` is one of displacements, all others are those of the temperature. Cracks are
    in both fields: no heat crosses them, but for the factor of a `Crack`.

    Parameters
    ----------
    elastic : Elastic
        The solid: bond-based, state-based or correspondence, with `coupled` without `contact`.
    heat : Heat
        Its conduction; the specific heat is that at constant strain, in plane stress of the strains in the plane. The
        density is one of its own, which only the capacity goes by.
    expansion : float, str, ndarray or callable
        Coefficient of linear expansion (1/temperature).
    reference : float
        Temperature of the solid that is free of stress; with `coupled` absolute, and positive.
    coupled : bool
        Whether what is deformed heats and cools. Without, the temperature is computed by itself.

    Raises
    ------
    InputError
        What is no such model; an expansion or a reference that is missing or no finite number, a material that heat
        does not strain, or that does not heat.

    Notes
    -----
    Biot (1956), Journal of Applied Physics 27, 240. Long waves are adiabatic, and faster than without heat by half of
    :math:`T_0 \beta^2 / (\rho c\,(\lambda + 2 \mu))`, a percent or so in metals. On the lattice mechanical energy and
    that of the temperature, ``rho c (T - T0)^2 / 2 T0``, exchange to rounding
    (`farhorizon.simulation.heat_of_deformation`). Through a `LatticePML` or an `Extended` domain that both fields have
    on a side they go on together (`farhorizon.simulation.warm_sides`), if the heat is integrated by Euler's method.
    Beside other sides that absorb, and those that are held, the solid must be at the reference temperature, and with
    `coupled` the expansion falls smoothly to zero.

    Examples
    --------
    >>> import farhorizon as fh
    >>> solid = fh.Elastic(fh.Kernel(2.0, exponent=1), young=1.0)
    >>> heat = fh.Heat(fh.Kernel(2.0), specific_heat=0.5, conductivity=0.05)
    >>> both = fh.Thermoelastic(solid, heat, expansion=0.01, reference=300.0)
    >>> plate = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0))
    >>> hot = {"T": "300 + 10*exp(-(x**2 + y**2)/8)"}
    >>> sim = fh.Simulation(plate, both, fh.Free(), initial=hot)
    >>> sim.step(20)
    >>> bool(sim.fields["T"][12, 12] < 310), sorted(sim.fields)[:2]
    (True, ['T', 'damage'])
    """

    mechanical = True

    def __init__(
        self,
        elastic: Elastic,
        heat: Heat,
        expansion: Constant | None = None,
        reference: float | None = None,
        coupled: bool = True,
    ) -> None:
        self.elastic = kinds.instance(elastic, "model.elastic", Elastic, "an Elastic solid", remedy="Elastic(...)")
        self.heat = self.of_temperature = kinds.instance(
            heat, "model.heat", Heat, "a Heat", remedy="Heat(kernel, conductivity=...)"
        )
        for name, value in (("expansion", expansion), ("reference", reference)):
            if value is None:
                raise InputError(
                    f"heat strains a solid by its expansion from a reference temperature: the {name} is missing",
                    value="none",
                    key=f"model.{name}",
                    limit="a number",
                    remedy="the coefficient of linear expansion, such as 1e-5 per kelvin"
                    if name == "expansion"
                    else "the temperature at which the solid is free of stress",
                )
        self.expansion = material_constant(expansion, "model.expansion", positive=False)
        self.coupled = kinds.flag(coupled, "model.coupled")
        above = 0.0 if self.coupled else None
        remedy = "heat of deformation goes by the absolute temperature; or coupled=False"
        self.reference = kinds.number(reference, "model.reference", above=above, beyond=remedy)
        try:
            self.elastic.heated(self.coupled)
        except InputError as error:
            raise error.at("model.coupled" if error.key == "load.coupled" else "model.elastic") from None
        self.integrator = self.elastic.integrator
        if not self.elastic.uneven:
            self.coefficient = self.elastic.coefficient

    @property
    def varying(self) -> dict[str, Any]:
        return self.elastic.varying

    @property
    def bond_law(self) -> BondLaw | None:
        return self.elastic.bond_law

    @property
    def moduli(self) -> tuple[float, float] | None:
        return self.elastic.moduli
