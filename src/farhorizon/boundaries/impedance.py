"""A side on springs and dashpots: Robin's condition."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated

import numpy as np

from farhorizon import kinds
from farhorizon.arguments import Unit
from farhorizon.boundaries.plain import Free
from farhorizon.errors import InputError


@dataclass(frozen=True)
class Impedance(Free):
    r"""The body ends here, on springs and dashpots to the state of rest: :math:`\sigma n = -k\,u - \eta\,u_t`.

    A dashpot of the medium's own impedance absorbs long waves that arrive along the normal, as in Lysmer and
    Kuhlemeyer (1969), Journal of the Engineering Mechanics Division 95: ``rho c_p`` along the normal and ``rho c_s``
    across it. Springs support a body, as a subgrade does a foundation. For waves and elastic solids.

    Parameters
    ----------
    stiffness : float
        Force per area and displacement, k.
    viscosity : float
        Force per area and velocity, eta.
    tangential_stiffness, tangential_viscosity : float, optional
        The same for displacements along the side of a solid; as along the normal unless given.

    Raises
    ------
    InputError
        A negative value, or nothing but zeros; later, a model of first order in time, or tangential values for a field
        of a single component.

    Notes
    -----
    The forces act on the last nodes, as those of a `Traction` do. Dashpots see the mean velocity over two steps, so
    that they never supply energy; springs shorten the largest step. A bar of the impedance ``Z0 = rho c`` reflects ``R
    = (Z0 - Z) / (Z0 + Z)`` of the displacement of long waves of the frequency w, with ``Z = eta + i k / w`` for
    ``exp(-i w t)``. What dashpots take is "lost" in `Simulation.balance`, as at absorbing sides; springs store
    "support". Correspondence materials require a stabilisation.

    Examples
    --------
    >>> import farhorizon as fh
    >>> bar, model = fh.Lattice(0.1, 0.0, 10.0), fh.Wave(fh.Kernel(0.1), speed=1.0)
    >>> matched = {"x-": fh.Free(), "x+": fh.Impedance(viscosity=1.0)}
    >>> sim = fh.Simulation(bar, model, matched, {"u": "exp(-(x - 5)**2)"})
    >>> _ = sim.run(until=20.0)
    >>> bool(abs(sim.fields["u"]).max() < 0.01)
    True
    """

    stiffness: Annotated[float, Unit("Pa/m")] = 0.0
    viscosity: Annotated[float, Unit("Pa*s/m")] = 0.0
    tangential_stiffness: Annotated[float | None, Unit("Pa/m")] = None
    tangential_viscosity: Annotated[float | None, Unit("Pa*s/m")] = None

    def __post_init__(self) -> None:
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        numbers = {
            name: kinds.number(value, f"boundary.{name}", least=0)
            for name, value in given.items()
            if value is not None or not name.startswith("tangential")
        }
        kinds.set_fields(self, **numbers)
        if not any(numbers.values()):
            raise InputError(
                "neither springs nor dashpots",
                value=0,
                limit="> 0",
                key="boundary.viscosity",
                remedy="a stiffness, a viscosity, or a side that is Free",
            )

    def node_rule(self, axis: int, components: int) -> np.ndarray:
        """Return stiffness and viscosity per area of each component at the last nodes, shape (2, components)."""
        along = self.stiffness, self.viscosity
        across = [
            normal if given is None else given
            for normal, given in zip(along, (self.tangential_stiffness, self.tangential_viscosity), strict=True)
        ]
        if components == 1 and (self.tangential_stiffness, self.tangential_viscosity) != (None, None):
            raise InputError(
                "a field of one component has no tangential one",
                value=across,
                key="boundary.tangential_stiffness",
                remedy="leave it out",
            )
        rule = np.repeat(np.array(across)[:, None], components, 1)
        rule[:, axis if components > 1 else 0] = along
        return rule
