"""The set-up of quasi-static loading: what it supports, and its fictitious masses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from farhorizon.errors import InputError
from farhorizon.inputs.load_steps import LoadSteps
from farhorizon.medium.integrators import Verlet
from farhorizon.simulation.setup.setup import Setup, Sides, side_name

#: Note on what is said of waves and of the time of a run.
ITERATED = (
    "each load step takes hundreds to many thousands of iterations, as many as the slowest mode needs: times that are "
    "foretold are those of one iteration per step, and what is said of waves does not matter"
)
STABLE = 0.9  # iterations are as long as this fraction of the largest stable time step


def check_load_steps(setup: Setup, sides: Sides) -> None:
    """Refuse what load steps do not support: whatever has no state of equilibrium, or a time of its own."""
    model = setup.model
    moving = setup.initial is not None and "v" in setup.initial
    law = getattr(model, "law", None)
    unlimited = [key for key, side in sides.items() if side.endless or "one stage" in side.assumes]
    refused: list[tuple[bool, str, object, str]] = [
        (not model.mechanical or model.of_temperature is not None, "model", model.title, "Elastic or Correspondence"),
        (not isinstance(model.integrator, Verlet), "model.integrator", model.integrator.name, 'integrator = "verlet"'),
        (law is not None and law.timed, "model.law", type(law).__name__, "a law that does not depend on dt"),
        (model.attenuation is not None, "model.attenuation", "given", "the moduli of slow loading, without it"),
        (moving, "initial.v", "given", "a body at rest"),
        (setup.dtype != "float64", "dtype", setup.dtype, 'dtype = "float64"'),
        (setup.heat is not None, "load", "a thermal load", "a run in time, with a steady temperature"),
        (bool(setup.impactors), "load", "an impactor", "prescribed nodes in its place"),
    ]
    refused += [
        (True, f"boundary.{side_name(*key)}", type(sides[key]).__name__, 'Free or Fixed sides, or until = "static"')
        for key in unlimited
    ]
    for wrong, key, value, remedy in refused:
        if wrong:
            raise InputError(
                "load steps end in the equilibrium of a solid body",
                value=value,
                limit="a solid at rest of finite size, in double precision",
                key=key,
                remedy=remedy,
            )


def check_loads(setup: Setup, unsplit: Sequence[Any]) -> None:
    """Refuse loads that do not move in a straight line from one load step to the next."""
    if unsplit or setup.depends_on_field:
        raise InputError(
            "load steps need loads that are products of a function of space and one of time",
            value=f"{len(unsplit)} others",
            limit="0",
            key="load",
            remedy="value = ... and time = ..., or several loads",
        )


def with_fictitious_masses(model: Any, limit: float, load_steps: LoadSteps) -> Any:
    """Return a uniform solid, of which the interval of load steps is a stable time step; `limit` is the largest one of
    the given solid.
    """
    heavy = model.with_constants({"density": model.density * (load_steps.interval / (STABLE * limit)) ** 2})
    heavy.damping = heavy.drag = 0.0
    return heavy
