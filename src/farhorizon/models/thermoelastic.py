"""A solid and its temperature."""

from __future__ import annotations

from typing import Annotated, Any

from farhorizon import kinds
from farhorizon.arguments import Function, Unit
from farhorizon.errors import InputError
from farhorizon.models.elastic import Elastic
from farhorizon.models.heat import Heat
from farhorizon.models.model import BondLaw, LatticeModel, material_constant


class Thermoelastic(LatticeModel):
    r"""Displacements and temperature of a solid on one lattice: temperature strains it, and deformation heats it.

    .. math::

        \rho\,u_{tt} = \mathrm{div}\,\sigma(u) - \nabla(\beta\,(T - T_0)) + b, \qquad
        \rho c\,T_t = \kappa\,\Delta T - T_0\,\beta\,\mathrm{div}\,u_t + w, \qquad \beta = \alpha\,(3 \lambda + 2 \mu)

    The fields are u and T. A `Setup` stores the displacements with a `ThermalLoad`, whose temperature is the set-up of
    the heat conduction. `boundary`, `sources` and `coefficient` may be given by field, ``{"u": ..., "T": ...}``;
    otherwise sides apply to both fields, and sources are forces on the solid. `initial` has "u", "v" and "T", which is
    `reference` unless given. Of the constraints, `Prescribed` applies to the displacements, all others to the
    temperature. Cracks exist in both fields: no heat crosses them, except for the factor of a `Crack`, nor bonds of the
    solid that have broken (Bobaru and Duangpanya 2010, eqs 13 to 15).

    Parameters
    ----------
    elastic : Elastic
        The solid: bond-based, state-based or correspondence; with `coupled`, it must not have `contact`.
    heat : Heat
        The heat conduction; the specific heat is that at constant strain, in plane stress at constant strains in the
        plane. Its density is independent of that of the solid and affects only the heat capacity.
    expansion : float, str, ndarray or callable
        Coefficient of linear expansion (1/temperature).
    reference : float
        Temperature at which the solid is free of stress; with `coupled`, absolute and positive.
    coupled : bool
        Whether deformation heats and cools the solid. If not, the temperature is computed independently of the
        deformation.
    contact_conductance : float
        Power per area and temperature difference that crosses a crack of broken bonds where its faces touch; open
        cracks insulate. See `ThermalLoad`.

    Raises
    ------
    InputError
        Models of another type; an expansion or a reference temperature that is missing or not a finite number; a
        material that has no thermal strain, or that is not heated by its deformation.

    Notes
    -----
    Biot (1956), Journal of Applied Physics 27, 240. Long waves are adiabatic, and faster than without heat, by half of
    :math:`T_0 \beta^2 / (\rho c\,(\lambda + 2 \mu))`, a percent or so in metals. On the lattice, mechanical energy and
    the energy of the temperature, ``rho c (T - T0)^2 / 2 T0``, are exchanged exactly to rounding error
    (`farhorizon.simulation.heat.coupled_temperature`). Through a `LatticePML` or an `Extended` domain shared by both
    fields on a side, they continue together (`farhorizon.simulation.heat.thermoelastic_sides`), provided that the heat
    is integrated by the forward Euler method. Next to other absorbing sides and clamped sides, the solid must be at the
    reference temperature, and with `coupled` the expansion is tapered smoothly to zero.

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

    quantity, field_unit = "displacement", "m"
    mechanical = True

    def __init__(
        self,
        elastic: Elastic,
        heat: Heat,
        expansion: Annotated[Any, Function(time=False), Unit("1/K")] = None,
        reference: Annotated[float | None, Unit("K")] = None,
        coupled: bool = True,
        contact_conductance: Annotated[float, Unit("W/(m^2*K)")] = 0.0,
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
        self.contact_conductance = kinds.number(contact_conductance, "model.contact_conductance", least=0)
        above = 0.0 if self.coupled else None
        remedy = "heat of deformation depends on the absolute temperature; or coupled=False"
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
