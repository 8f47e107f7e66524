"""Comparison of a truncated run with the infinite medium, for the given boundary and for a fixed and a free edge.

In one dimension, exact ends are run in addition to layers, and layers in addition to exact ends.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NotRequired

import numpy as np
from typing_extensions import TypedDict

from farhorizon.analysis.references.infinite_lattice import InfiniteLattice, undisturbed
from farhorizon.boundaries import Exact, Fixed, Free, LatticePML
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.geometry.shapes import Shape
from farhorizon.inputs.incidence import Incident
from farhorizon.inputs.loads import BodyForce
from farhorizon.inputs.sources import Source, widened
from farhorizon.machine import progress
from farhorizon.rounding import TINY
from farhorizon.simulation.setup.reference_medium import constants_of
from farhorizon.simulation.setup.setup import Setup
from farhorizon.simulation.simulation import Simulation
from farhorizon.simulation.time.source_terms import ends_of

_KERNEL = 1e7  # steps times squared reach for which the kernel of an exact end takes half a minute to compute


class Curve(TypedDict):
    """Errors of one boundary against the infinite medium."""

    times: list[float]
    """Times of the comparison."""
    error: list[float]
    """Largest difference from the infinite medium over the near field."""
    error_rel_current: list[float]
    """The error relative to the largest value of the infinite medium in the near field at the same time."""
    error_rel_initial: list[float]
    """The error relative to the initial maximum or, for zero initial values, constraints or incident waves, to the
    largest value of the run."""
    error_max_over_run: float
    """Largest of the errors."""
    growth_rate: NotRequired[float]
    """With layers and backward waves: rate at which the error grows over the second half of the run, per unit time."""


@dataclass
class Comparison:
    """Errors of each boundary against the infinite medium."""

    reference: str  # how the infinite medium was computed
    initial: float  # to which relative errors refer, in words `scale`
    times: list[float] = field(default_factory=list)
    curves: dict[str, Curve] = field(default_factory=dict)
    fields: dict[str, np.ndarray] = field(default_factory=dict)  # at `shown_time`: "infinite medium", each boundary
    shown_time: float = 0.0
    edges: str = ""  # where the fixed and the free edges lie
    scale: str = "initial maximum"
    growth: dict[str, float] = field(
        default_factory=dict
    )  # of errors with backward waves, over the second half, 1/time
    growth_bound: float = 0.0  # of backward waves in the layer, to first order in its strength
    left_out: str = ""  # an absorber that would be applicable but was not run, and why

    @property
    def headline(self) -> str:
        """Error of the given boundary, in one line."""
        name, curve = next(iter(self.curves.items()))
        return f"error of the {name} at most {curve['error_max_over_run'] / self.initial:.2g} of the {self.scale}"

    def as_json(self) -> dict[str, Curve]:
        """The errors by boundary as plain data."""
        growing: dict[str, Curve] = {
            name: {**self.curves[name], "growth_rate": rate} for name, rate in self.growth.items()
        }
        return self.curves | growing

    def table(self) -> str:
        """The errors at up to eight times as text, one row per time, relative to the initial maximum."""
        names = list(self.curves)
        rows = [f"{'t':>10}" + "".join(f"{n:>16}" for n in names)]
        some = sorted({round(i) for i in np.linspace(0, len(self.times) - 1, 8)})
        rows += [
            f"{self.times[i]:>10.4g}" + "".join(f"{self.curves[n]['error_rel_initial'][i]:>16.2e}" for n in names)
            for i in some
        ]
        rows.append(
            f"{'max':>10}" + "".join(f"{self.curves[n]['error_max_over_run'] / self.initial:>16.2e}" for n in names)
        )
        rows += self._growth_lines() + ([f"left out: {self.left_out}"] if self.left_out else [])
        head = [f"error max|u - u_infinite| over the near field / {self.scale}", f"infinite medium: {self.reference}"]
        return "\n".join(head + ([f"fixed and free edge: {self.edges}"] if self.edges else []) + rows)

    def _growth_lines(self) -> list[str]:
        if not self.growth:
            return []
        lines = [
            f"backward waves grow in the layer, to first order by up to {self.growth_bound:.3g} per unit time; "
            "measured over the second half:"
        ]
        for name, rate in self.growth.items():
            size = f"to {self.curves[name]['error'][-1] / self.initial:.2g} of the {self.scale}"
            tenfold = f"grows by {rate:.3g} per unit time (tenfold in {np.log(10) / rate:.3g}) {size}"
            lines.append(f"  error of the {name} " + (tenfold if rate > 0 else f"does not grow (rate {rate:.2g})"))
        ours, edge = next(iter(self.curves)), self.curves.get("fixed edge")
        if edge is not None and self.curves[ours]["error_max_over_run"] > edge["error_max_over_run"]:
            lines.append(
                f"warning: the {ours} is worse than a fixed edge here; use a sponge, a shorter run or another kernel"
            )
        return lines


def growth_rate(times: Sequence[float], values: Sequence[float]) -> float:
    """Slope of the logarithm of positive values over the second half of the times, by least squares; 0 if there are
    fewer than two.
    """
    t, v = np.asarray(times, float), np.asarray(values, float)
    late = (t >= 0.5 * t[-1]) & (v > 0) & np.isfinite(v)
    return float(np.polyfit(t[late], np.log(v[late]), 1)[0]) if late.sum() > 1 else 0.0


def compare(
    setup: Setup | Mapping[str, Any],
    until: float,
    times: Sequence[float] | None = None,
    shown: float | None = None,
    beside: bool = True,
) -> Comparison:
    """Run a set-up and the infinite medium at the same time step, at 40 even times unless given; with `beside` also
    with a fixed and a free edge where the near field ends, and in one dimension with the other absorber. Fields are
    shown when the smaller of the field of the medium and the largest error is largest.
    """
    moments = _moments(until, times)
    if not isinstance(setup, Setup):
        setup = Setup(**setup)
    ours = Simulation.of(setup)
    ours.prepare(until)
    steps = sorted({max(1, round(t / ours.dt)) for t in moments})
    runs: dict[str, Simulation] = {_name(ours): ours}
    if beside:
        runs |= _besides(setup, ours, steps[-1])
    how, exact_after = _infinite(setup, ours, steps[-1])
    initial = float(np.nanmax(np.abs(ours.fields["u"] - ours.background), initial=0.0))
    result = Comparison(how, initial, [n * ours.dt for n in steps])
    if beside:
        result.edges, result.left_out = _edges(ours), _left_out(ours, steps[-1])
    shown_step = None if shown is None else min(steps, key=lambda n: abs(n * ours.dt - shown))
    errors, size = _step_together(result, runs, steps, exact_after, shown_step)
    # initially zero, or driven by constraints or incident waves: the scale is the largest value of the run
    driven = setup.constraints or any(isinstance(s, Incident) for s in setup.sources)
    if result.initial == 0 or driven:
        result.initial, result.scale = max(size), "largest value of the run"
    if not result.initial > 0:
        raise InputError(
            "nothing moves at any of the times that are compared",
            value=f"to t = {result.times[-1]:.6g}",
            key="times",
            remedy="later times, or initial data or sources that the run sees",
        )
    result.curves = {name: _curve(result, error, size) for name, error in errors.items()}
    _measure_growth(result, ours)
    return result


def _moments(until: float, times: Sequence[float] | None) -> np.ndarray:
    """The times of comparison in ascending order."""
    if times is None:
        return np.linspace(0, until, 41)[1:]
    if not (np.size(times) and np.isfinite(times).all() and np.min(times) > 0):
        raise InputError("the times of a comparison must be positive", value=list(times), limit="> 0", key="times")
    return np.sort(np.asarray(times, float))


def _edges(ours: Simulation) -> str:
    """Where the fixed and the free edges lie, in words."""
    if ours.lattice.window is not None:
        return "on the outline of the window"
    return "at the absorbing sides of the near field"


def _left_out(ours: Simulation, steps: int) -> str:
    """The absorber that would be applicable in one dimension but is not run, and why; empty if there is none."""
    if not (_has_layers(ours) and ours.lattice.dim == 1 and _long_kernel(ours, steps)):
        return ""
    return f'exact ends, whose kernel for {steps} steps would take minutes to make: compare a case of type = "exact"'


def _step_together(
    result: Comparison,
    runs: Mapping[str, Simulation],
    steps: Sequence[int],
    exact_after: Callable[[int], np.ndarray],
    shown_step: int | None,
) -> tuple[dict[str, list[float]], list[float]]:
    """The errors of each run after some steps, and the largest values of the infinite medium; the fields to be
    shown are stored in the result.
    """
    ours, most = next(iter(runs.values())), -1.0
    errors: dict[str, list[float]] = {name: [] for name in runs}
    size: list[float] = []
    with progress(steps[-1]) as bar:
        for step in steps:
            exact = exact_after(step)
            if ours.lattice.mask is not None:
                exact = np.where(ours.lattice.mask, exact, np.nan)
            size.append(float(np.nanmax(np.abs(exact - ours.background))))
            now = {"infinite medium": exact}
            for name, sim in runs.items():
                sim.step(step - sim.step_count)
                now[name] = sim.fields["u"]
                errors[name].append(float(np.nanmax(np.abs(now[name] - exact))))
            worth = min(size[-1], max(error[-1] for error in errors.values()))
            if step == shown_step or (shown_step is None and worth > most):
                result.fields, result.shown_time, most = now, step * ours.dt, worth
            bar.update(step - bar.n)
    return errors, size


def _curve(result: Comparison, error: list[float], size: Sequence[float]) -> Curve:
    return {
        "times": result.times,
        "error": error,
        "error_rel_current": [e / max(s, TINY) for e, s in zip(error, size, strict=True)],
        "error_rel_initial": [e / max(result.initial, TINY) for e in error],
        "error_max_over_run": max(error),
    }


def _measure_growth(result: Comparison, ours: Simulation) -> None:
    """Measure how fast the error of the given boundary grows if backward waves grow in a layer."""
    layers = ours.engine.layers.values()
    undamped = ours.model.order == 2 and any(not layer.damping.any() for layer in layers)
    backward = ours.stencil.backward_waves() if undamped else None
    if backward:
        result.growth_bound = backward.growth * max(float(layer.sigma.max()) for layer in layers)
        result.growth[_name(ours)] = growth_rate(result.times, result.curves[_name(ours)]["error"])


def _infinite(setup: Setup, ours: Simulation, steps: int) -> tuple[str, Callable[[int], np.ndarray]]:
    """How the infinite medium is computed, and a function that returns its field on the near field after a
    number of steps, which must not decrease from call to call.
    """
    if _homogeneous(setup, ours):
        lattice = InfiniteLattice(
            ours.stencil,
            ours.model.coefficient / ours.lattice.spacing**2,
            ours.model.integrator,
            ours.dt,
            steps,
            ours.start_u,
            ours.start_v,
            ours.model.damping,
        )
        return "exact solution on the infinite lattice by FFT", lambda step: lattice.after(step) + ours.background
    far = _extended(setup, ours, steps * ours.dt)

    def after(step: int) -> np.ndarray:
        far.step(step - far.step_count)
        return np.asarray(far.fields["u"][far_slices(far, ours)])

    return f"domain of {' x '.join(map(str, far.lattice.shape))} nodes", after


def _homogeneous(setup: Setup, ours: Simulation) -> bool:
    """Whether the set-up consists of an unbounded, homogeneous, linear medium and initial data only."""
    uneven = setup.cracks or setup.constraints or setup.specimens or setup.coefficient is not None or ours.varied
    uneven = uneven or ours.of_field
    endless = all(b.endless for b in ours.sides.values()) and ours.lattice.body is None
    plain = ours.model.bond_law is None and not ours.model.drag and ours.model.attenuation is None
    return endless and plain and not uneven and not ours.sources


def _besides(setup: Setup, ours: Simulation, steps: int) -> dict[str, Simulation]:
    """What is run in addition to a set-up: the other absorber, a fixed and a free edge, as far as applicable."""
    ends = (("fixed", Fixed), ("free", Free))
    refused = {"no drift"} if ours.stencil.drifting else set()
    served = [rim for rim, end in ends if ours.model.serves(end) and not refused & end.assumes]
    return {**_other_absorber(setup, ours, steps), **{f"{rim} edge": _ended(setup, ours, rim) for rim in served}}


def _with(ours: Simulation, end: Any) -> dict[str, Any]:
    """The sides by name, with the absorbing ones replaced by another boundary."""
    return {name: end if b.endless else b for name, b in _by_name(ours).items()}


def _has_layers(ours: Simulation) -> bool:
    return any(b.stretched for b in ours.sides.values())


def _long_kernel(ours: Simulation, steps: int) -> bool:
    """Whether the kernel of exact ends would take minutes to compute."""
    return steps * ours.stencil.reach[0] ** 2 > _KERNEL


def _other_absorber(setup: Setup, ours: Simulation, steps: int) -> dict[str, Simulation]:
    """Return, in one dimension, the set-up with exact ends in place of layers or vice versa, if applicable.

    Exact ends whose kernel would take minutes are left out.
    """
    for old, new in ((LatticePML, None if _long_kernel(ours, steps) else Exact()), (Exact, LatticePML())):
        if new is not None and ours.lattice.dim == 1 and any(isinstance(b, old) for b in ours.sides.values()):
            boundary = {name: new if isinstance(b, old) else b for name, b in _by_name(ours).items()}
            try:
                absorbing = Simulation.of(replace(setup, boundary=boundary, dt=ours.dt))
                absorbing.prepare(steps * ours.dt)
            except InputError:  # not applicable to this model, integrator or data
                continue
            return {_name(absorbing): absorbing}
    return {}


def _ended(setup: Setup, ours: Simulation, rim: str) -> Simulation:
    """The same set-up in a medium that ends at the edge of the near field, or on the outline of a window, with a
    fixed or a free edge.
    """
    changes: dict[str, Any] = {
        "boundary": _with(ours, Fixed(ours.background) if rim == "fixed" else Free()),
        "dt": ours.dt,
    }
    lattice = ours.lattice
    if lattice.window is not None:
        body = lattice.window if lattice.body is None else lattice.window & lattice.body
        changes |= {"lattice": Lattice(lattice.spacing, lattice.lower, lattice.upper, body=body), "rim": rim}
    return Simulation.of(replace(setup, **changes))


def _by_name(sim: Simulation) -> dict[str, Any]:
    return {"xyz"[a] + "-+"[s > 0]: b for (a, s), b in sim.sides.items()}


def _name(sim: Simulation) -> str:
    absorbing = {b.label for b in sim.sides.values() if b.endless}
    return " + ".join(sorted(absorbing or {b.label for b in sim.sides.values()}))


def far_slices(far: Simulation, ours: Simulation) -> tuple[Any, ...]:
    """The slices of the near field in a field of the extended domain."""
    first = np.round((ours.lattice.lower - far.lattice.lower) / ours.lattice.spacing).astype(int)
    return (..., *(slice(i, i + n) for i, n in zip(first, ours.lattice.shape, strict=True)))


def _extended(setup: Setup, ours: Simulation, until: float) -> Simulation:
    """The same set-up on a domain so large that nothing returns from its ends."""
    lattice = ours.lattice
    more = undisturbed(ours.stencil.with_reaction(0.0), ours.fastest_rate, ours.model.order, until)
    open_sides = {key: more for key, b in ours.sides.items() if b.endless}
    if open_sides and setup.heat is not None and setup.heat.coupled:
        raise InputError(
            "the medium beyond the near field is computed for one field, not for displacements and a temperature",
            value="coupled",
            key="model.coupled",
            remedy="false, or by hand the same case with a larger near field",
        )

    def widen(value: Any, mode: Literal["constant", "edge"] = "constant") -> Any:
        if isinstance(value, Incident):
            return value.resolved(lattice, ours.stencil.reach, ends_of(ours.sides))
        if isinstance(value, Source):
            return Source(widen(value.value), value.time)
        return widened(value, lattice, open_sides, mode)

    changed: dict[str, Any] = {
        "lattice": lattice.extended(open_sides),
        "boundary": _with(ours, Fixed(ours.background)),
        "dt": ours.dt,
        "initial": {k: widen(v) for k, v in (setup.initial or {}).items()},
        "sources": [widen(s) for s in setup.sources],
        "loads": _widened_loads(setup.loads, lattice, open_sides),
        "constraints": [
            replace(c, where=widen(c.where)) if np.asarray(c.where).dtype == bool else c for c in setup.constraints
        ],
        "specimens": [
            replace(s, where=widen(s.where)) if not isinstance(s.where, Shape) else s for s in setup.specimens
        ],
        "coefficient": None if setup.coefficient is None else widen(setup.coefficient, "edge"),
        "model": setup.model.with_constants(
            {name: widen(value, "edge") for name, value in constants_of(setup).items()}
        ),
    }
    return Simulation.of(replace(setup, **changed))


def _widened_loads(loads: Sequence[Any], lattice: Lattice, nodes: dict[tuple[int, int], int]) -> list[Any]:
    """The loads for a larger lattice, where they act at the same places."""
    return [
        replace(load, value=widened(load.value, lattice, nodes))
        if isinstance(load, BodyForce)
        else load.bounded(lattice)
        for load in loads
    ]
