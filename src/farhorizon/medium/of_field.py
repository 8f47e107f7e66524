"""Quantities that depend on the field."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.files.storable import Storable

_FIELD = re.compile(r"(?<![\w.])u(?!\w)")


@dataclass(frozen=True)
class OfField(Storable):
    """A source or a conductivity that depends on the field u.

    In place of a text, ``"u*(1 - u)"`` alone is enough: texts of sources and conductivities that contain u are taken as
    this. It is evaluated between the steps, with the values at their beginning, by numpy.

    Parameters
    ----------
    value : str or callable
        An expression of u and the coordinates, or a function ``f(u, x, y, ..)`` of arrays. A conductivity is one of u
        alone.

    Raises
    ------
    InputError
        Neither a text nor a function.

    Notes
    -----
    Sources, of scalar fields, are integrated by forward Euler or velocity Verlet. A conductivity k(u) multiplies no
    bond: what flows along a bond is that of the difference of :math:`\\int k\\,du` at its ends, so that the operator is
    that of :math:`\\nabla\\cdot(k(u)\\,\\nabla u)`, and what one node loses the other gains.

    Examples
    --------
    >>> import farhorizon as fh
    >>> steel = fh.Heat(fh.Kernel(0.3), conductivity=fh.OfField("50 - 0.02*u"))
    >>> spread = fh.Diffusion(fh.Kernel(0.3), diffusivity=2.0)
    >>> line = fh.Lattice(0.1, -3, 3)
    >>> sim = fh.Simulation(line, spread, fh.Free(), {"u": "exp(-x**2)"}, sources=[fh.OfField("u*(1 - u)")])
    >>> sim.step(10)
    """

    value: Any

    def __post_init__(self) -> None:
        if not (isinstance(self.value, str) or callable(self.value)):
            raise InputError(
                "must be an expression or a function of the field",
                value=kinds.said(self.value),
                limit="a text, or what can be called",
                key="of_field",
                remedy='"u*(1 - u)"',
            )


def names_field(value: Any) -> bool:
    """Whether a value is a text that contains the field u."""
    return isinstance(value, str) and _FIELD.search(value) is not None
