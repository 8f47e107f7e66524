"""What is known of a `Body` before its run: facts, cost, and whether its linear form is stable."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from farhorizon.analysis.stability import krylov_growth, noise_growth
from farhorizon.checks.certificate import (
    BUDGET,
    CERTIFIED,
    NOT_CERTIFIED,
    PATIENCE,
    UNDECIDED,
    Certificate,
    ExaminedPart,
    judge,
    told,
)
from farhorizon.checks.report import LEAST, Report, options_shown
from farhorizon.geometry.lattice import AXES, Lattice
from farhorizon.machine import one_blas_thread

_MARGIN = 1 - 1e-9  # at the step limit itself the shortest wave grows linearly


@one_blas_thread()
def certify_body(body: Any, budget: float = BUDGET, until: float = np.inf) -> Certificate:
    """Whether the linear form of a body can grow: without loads, and before any bond breaks.

    Without layers a proof holds: the forces have a potential that is never negative, drag and sponges take energy.
    Layers of `NonlocalPML` are examined by white noise and by Krylov spaces of the one-step map of a body with the same
    sides on a small near field, without cracks and holes. Forward Euler on split fields grows.

    Parameters
    ----------
    body : Body
    budget : float
        Seconds.
    until : float
        Length of the run for which this is asked, see `farhorizon.checks.certificate.certify`.
    """
    begin = time.monotonic()
    if body.split:
        rate = body.largest_frequency**2 * body.dt / 2
        fast = told(rate * body.crossing, body.crossing)
        reason = (
            f"forward Euler on split fields grows everywhere, by half of frequency^2 dt, the shortest wave by {fast}"
        )
        return Certificate(NOT_CERTIFIED, reason, rate, crossing=body.crossing, seconds=time.monotonic() - begin)
    if not any(b.split for b in body.sides.values()):
        if body.dt <= _MARGIN * body.step_limit:
            reason = (
                "until bonds break: the forces have a potential that is never negative and the step is below the limit"
            )
            return Certificate(CERTIFIED, reason, seconds=time.monotonic() - begin)
        return Certificate(UNDECIDED, "the step is the limit itself", seconds=time.monotonic() - begin)
    lattice, reach = body.lattice, np.array(body.stencil.reach)
    count = np.minimum(lattice.shape, 2 * reach + 1)
    small = body.remade(lattice=Lattice(lattice.spacing, lattice.lower, lattice.lower + lattice.spacing * (count - 1)))
    size, advance = small.linear_map()
    crossing = int(np.ceil(max(small.box) * lattice.spacing / body.fast / body.dt))
    pace, span, asked = body.dt / body.crossing, crossing * body.dt, until / (crossing * body.dt)
    seen, crossings = noise_growth(advance, size, pace, crossing, budget / 3 if np.isinf(until) else PATIENCE, asked)
    quiet = 0.0 if seen is not None else until if asked <= crossings * (1 + 1e-9) else crossings * span
    name = (
        f"all sides, a near field of {' x '.join(map(str, count))} nodes without cracks and holes, before bonds break"
    )
    name += ", of the fastest material alone" if body.varied else ""
    if seen is None and until > quiet:
        growth = krylov_growth(advance, size, pace, crossing, budget - (time.monotonic() - begin))
        seen = growth if growth.rate or np.isfinite(growth.error) else None
    skipped = [] if seen is not None else [f"modes of {name}"]
    parts = [] if seen is None else [ExaminedPart(name, seen, np.zeros(0))]
    return judge(parts, skipped, body.crossing, time.monotonic() - begin, quiet)


def report(body: Any, until: float | None = None, budget: float | None = None) -> Report:
    """Facts about a body; see `Body.check`."""
    found = Report(until=np.inf if until is None else until)
    lattice, stencil = body.lattice, body.stencil
    say = found.rows.append
    say(
        (
            "near field",
            f"{' x '.join(map(str, lattice.shape))} nodes, {lattice.nodes} shown, spacing {lattice.spacing:g}",
        )
    )
    say(("kernel", f"{len(stencil.weights)} neighbours, reach {' x '.join(map(str, stencil.reach))} nodes"))
    say(("time step", f"{body.dt:.6g}, {body.dt / body.step_limit:.3g} of the stable limit {body.step_limit:.6g}"))
    say(
        (
            "wave speeds",
            f"{body.fast:.6g} longitudinal, {body.slow:.6g} transverse" + (", the largest" if body.varied else ""),
        )
    )
    sides: dict[str, list[str]] = {}
    for (axis, side), boundary in body.sides.items():
        sides.setdefault(options_shown(boundary), []).append(AXES[axis] + "-+"[side > 0])
    for text, names in sides.items():
        say((f"side {', '.join(names)}", text))
    nodes = int(np.prod(body.box))
    say(("nodes computed", f"{nodes}, {nodes - int(np.prod(lattice.shape))} of them in layers"))
    say(("memory", f"{body.nbytes / 2**20:.3g} MiB = {body.nbytes / nodes:.3g} bytes a node"))
    found.numbers |= {"dt": body.dt, "step_limit": body.step_limit, "memory": float(body.nbytes)}
    if until is not None:
        found.estimate(body, body.prepare(until), until)
    share = min(BUDGET, max(LEAST, found.numbers.get("seconds", BUDGET))) if budget is None else budget
    found.certificate = body.certificate(share)
    say(("stability", str(found.certificate)))
    if found.certificate.verdict == NOT_CERTIFIED:
        remedy = 'form = "displacement"' if body.split else "cross = 0.1 to 0.5 in the layers, or a Sponge"
        found.warnings.append(f"the run is not stable: {found.certificate.reason}. Use {remedy}.")
    elif remark := found.certificate.remark(found.until):
        found.warnings.append(remark)
    if not any(b.endless or not b.bonded for b in body.sides.values()):
        found.warnings.append("Fixed sides reflect")
    found.notes = body.notes
    return found
