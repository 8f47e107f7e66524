"""Laws of sources and conductivities that depend on the field, before there is a run."""

from __future__ import annotations

from collections.abc import Callable
from numbers import Real
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import AXES
from farhorizon.inputs.conditions import Flux
from farhorizon.inputs.expressions import function_of
from farhorizon.inputs.sources import field
from farhorizon.medium.of_field import OfField

SAMPLES = 129
"""Values of the field between its extremes at the start, at which laws are examined before the run."""


def law_of(quantity: OfField, names: tuple[str, ...], key: str) -> Callable[..., np.ndarray]:
    """Return a quantity as a function of arrays with these names, the first of which is the field."""
    if isinstance(quantity.value, str):
        return function_of(quantity.value, names, key)
    given = kinds.function(quantity.value, key, ", ".join(names))
    return lambda *at: np.asarray(given(*at), float)


def range_of(setup: Any, gather: Callable[[Any], list[Any]] = lambda value: [value]) -> np.ndarray:
    """Return values of the field from its smallest at the start to its largest, with the background and numbers that
    conditions and sides prescribe; `gather` returns those of all processes.
    """
    initial = (setup.initial or {}).get("u")
    ends = [setup.background, *(side.held for side in setup.sides.values() if side.held is not None)]
    held = [condition for condition in setup.constraints if not isinstance(condition, Flux)]
    given = [getattr(condition, name, None) for condition in held for name in ("value", "ambient")]
    ends += [float(value) for value in given if isinstance(value, Real)]
    if initial is not None:
        lattice = setup.lattice
        if isinstance(initial, np.ndarray) and initial.ndim and initial.shape == lattice.whole.shape:
            initial = initial[lattice.within]
        values = field(initial, lattice, 1, "initial.u")
        ends += [float(values.min()), float(values.max())]
    ranges = gather((min(ends), max(ends)))
    return np.linspace(min(low for low, _ in ranges), max(high for _, high in ranges), SAMPLES)


def conductivity_ratio(setup: Any) -> float:
    """Return the largest conductivity at values of the field at the start, over that at the background; raises
    InputError for one that is not positive, or not finite.
    """
    largest, values = 1.0, range_of(setup)
    for name, quantity in setup.model.follows.items():
        key = f"model.{name}"
        conductivity = np.broadcast_to(law_of(quantity, ("u",), key)(values), values.shape)
        wrong = ~((conductivity > 0) & np.isfinite(conductivity))
        if wrong.any():
            at = int(np.argmin(np.where(wrong, conductivity, np.inf)))
            raise InputError(
                f"the {name} must be positive at all values that the field has at the start",
                value=f"{conductivity[at]:.6g} at u = {values[at]:.6g}",
                limit="> 0",
                key=key,
                remedy="a law that stays positive, such as max(..., smallest)",
            )
        largest = max(largest, float(conductivity.max() / law_of(quantity, ("u",), key)(np.array(setup.background))))
    return largest


def source_slope(setup: Any, gather: Callable[[Any], list[Any]] = lambda value: [value]) -> float:
    """Return the largest slope with which sources change with the field, at its values at the start (per mass); see
    `range_of`.
    """
    lattice, largest = setup.lattice, 0.0
    if not any(isinstance(source, OfField) for source in setup.sources):
        return largest
    values = range_of(setup, gather)
    if np.ptp(values) == 0:
        return largest
    for number, source in enumerate(setup.sources):
        if isinstance(source, OfField):
            law, before = law_of(source, ("u", *AXES[: lattice.dim]), f"source[{number}]"), None
            for value in values:
                now = law(np.full(lattice.shape, value), *lattice.coordinates())
                if before is not None:
                    with np.errstate(invalid="ignore"):
                        slope = np.abs(now - before) / (values[1] - values[0])
                    largest = max(largest, float(slope.max(initial=0, where=np.isfinite(slope))))
                before = now
    return max(gather(largest))
