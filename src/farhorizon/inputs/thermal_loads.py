"""Thermal strains of a solid."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import PYTHON_ONLY, REQUIRED, Duration, Function, InFile, Unit
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.inputs.loads import Load
from farhorizon.models.model import material_constant

_SIDES = [axis + side for axis in "xyz" for side in "-+"]


@dataclass(frozen=True)
class ThermalLoad(Load):
    r"""Strains caused by a temperature, :math:`\alpha\,(T - T_0)` in all directions.

    These strains cause no force: the force in a bond follows from its stretch minus the mean thermal strain of its two
    ends, and so does its breaking; a state, in state-based and correspondence materials, follows from the strain of its
    node minus the thermal strain. The temperature strains the solid; the heating of the solid by its own deformation,
    of the order of :math:`T_0\,E\,\alpha^2/(\rho c)`, about a percent in metals, is neglected unless `coupled`.

    Parameters
    ----------
    temperature : float, ndarray, str, Expression, callable, Simulation or Setup
        A number or values at the nodes; an expression or a function of the coordinates and t; or a run of `Heat` or
        `Diffusion`, whose field it is. Such a run is repeated alongside this one, on the nodes of the same lattice or
        of a part of it, with its own sides and layers. Beyond that part everything is at the reference temperature.
    expansion : float, str, ndarray or callable
        Coefficient of linear expansion (1/temperature); where it varies, a function of the coordinates or the values at
        the nodes.
    reference : float
        Temperature at which the solid is free of stress.
    every : float, optional
        Interval at which a changing temperature is sampled, with linear interpolation in between; unless given, each
        time step, and for a run each of its steps.
    coupled : bool
        The temperature is a run of `Heat` on the nodes of the solid, which is advanced together with the solid;
        deformation heats and cools the solid:
        :math:`\rho c\,T_t = \kappa \Delta T - T_0\,\alpha\,\mathrm{tr}\,\sigma_t`, with the stress at the temperature
        `reference`, which is absolute, and c at constant strain. `Thermoelastic` is the model of both fields.
    contact_conductance : float
        Power per area and temperature difference that crosses a crack of broken bonds where its faces touch, for a
        temperature that is a run: a broken bond that is not longer than free of stress keeps the fraction of its
        conductance with which all bonds across a plane would conduct as much.
    joint : sequence of str
        Names of the sides that are common to both fields, whose layers they share if possible; set by `Thermoelastic`.

    Raises
    ------
    InputError
        An expansion or a reference temperature that is missing or not a finite number; a temperature of another type.

    Notes
    -----
    The bonds are those of Silling and Askari (2005) with the thermal stretch of Kilic and Madenci (2010), IEEE
    Transactions on Advanced Packaging 33, 97: ``s - alpha (T_i + T_j) / 2``, where T is the difference from the
    reference. In plane strain the expansion normal to the plane is suppressed, and all strains in the plane are
    :math:`1 + \nu` times as large. Near absorbing sides and near clamped ones, the solid must be at the reference
    temperature.

    Examples
    --------
    >>> import farhorizon as fh
    >>> plate = fh.Lattice(1.0, (-4.0, -4.0), (4.0, 4.0))
    >>> solid = fh.Elastic(fh.Kernel(2.0), young=1.0, plane="stress")
    >>> heat = fh.ThermalLoad("20 + 100*(1 - exp(-t))", expansion=1e-5, reference=20.0)
    >>> sim = fh.Simulation(plate, solid, fh.Free(), loads=[heat])
    >>> sim.step(5)
    >>> bool(sim.fields["u"][0, -1, 4] > 0)  # it grows
    True
    """

    tag: ClassVar[str] = "thermal"
    temperature: Annotated[Any, Function(), Unit("K"), "Temperature, a function of the coordinates and t."]
    expansion: Annotated[Any, Function(time=False), Unit("1/K"), InFile(REQUIRED)] = None
    reference: Annotated[float | None, Unit("K"), InFile(REQUIRED)] = None
    every: Duration | None = None
    coupled: Annotated[bool, PYTHON_ONLY] = False
    joint: Annotated[Sequence[str], PYTHON_ONLY] = ()
    contact_conductance: Annotated[float, PYTHON_ONLY] = 0.0

    def __post_init__(self) -> None:
        given = {"expansion": self.expansion, "reference": self.reference}
        for name, value in given.items():
            if value is None:
                raise InputError(
                    f"a thermal load needs {'its' if name == 'expansion' else 'a'} {name}",
                    value="none",
                    key=f"load.{name}",
                    limit="a number",
                    remedy="the temperature at which the solid is free of stress"
                    if name == "reference"
                    else "the coefficient of linear expansion, such as 1e-5 per kelvin",
                )
        run = getattr(self.temperature, "setup", self.temperature)  # a run is created anew from its set-up
        if not (self.of_run(run) or callable(run) or isinstance(run, str)):
            run = kinds.array(run, "load.temperature")
            run = run if run.ndim else float(run)
        kinds.set_fields(
            self,
            temperature=run,
            expansion=material_constant(self.expansion, "load.expansion", positive=False),
            reference=kinds.number(self.reference, "load.reference"),
            every=None if self.every is None else kinds.number(self.every, "load.every", above=0),
            coupled=kinds.flag(self.coupled, "load.coupled"),
            contact_conductance=kinds.number(self.contact_conductance, "load.contact_conductance", least=0),
            joint=tuple(
                kinds.one_of(name, "load.joint", _SIDES, "unknown side")
                for name in kinds.sequence(self.joint, "load.joint", "names of sides")
            ),
        )
        if self.coupled:
            self._check_coupling()

    def _check_coupling(self) -> None:
        """Check what a temperature needs that follows the deformation."""
        if not self.of_run(self.temperature):
            raise InputError(
                "a temperature that is given does not follow the deformation",
                value=kinds.said(self.temperature),
                key="load.temperature",
                limit="a run of Heat, or its set-up",
                remedy="coupled=False",
            )
        if self.every is not None:
            raise InputError(
                "a temperature that follows the deformation makes its steps",
                value=self.every,
                key="load.every",
                remedy="leave it out",
            )
        kinds.number(
            self.reference, "load.reference", above=0, beyond="heat of deformation depends on the absolute temperature"
        )

    @staticmethod
    def of_run(temperature: Any) -> bool:
        """Whether the temperature is the field of a run."""
        return hasattr(temperature, "lattice") and hasattr(temperature, "model")

    def bounded(self, lattice: Lattice) -> ThermalLoad:
        """The load itself: beyond its nodes everything is at the reference temperature."""
        return self

    @property
    def steady(self) -> bool:
        """Whether the temperature is known to be constant in time."""
        return isinstance(self.temperature, float | np.ndarray) or getattr(self.temperature, "uses_time", None) is False


@contextmanager
def of_the_heat() -> Iterator[None]:
    """Context in which the key of an InputError refers to the heat of a solid, whose field is T."""
    try:
        yield
    except InputError as error:
        raise error.at("initial.T" if error.key == "initial.u" else f"heat.{error.key}".rstrip(".")) from None
