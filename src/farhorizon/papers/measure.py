"""What the reproductions of absorbing conditions measure: errors against the infinite medium, and stability."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.analysis.references.infinite import InfiniteLattice
from farhorizon.boundaries import Side
from farhorizon.checks.certificate import UNDECIDED
from farhorizon.errors import UnstableError
from farhorizon.simulation.simulation import Simulation

_SECONDS = 8.0  # that a certificate may take
_CLOSELY = 200  # first steps, after each of which the norm is taken: fast growth is over soon

Reference = Callable[[int], np.ndarray]


@dataclass
class Measured:
    """One condition's run.

    Attributes
    ----------
    errors : ndarray, shape (times,)
        Largest difference from the infinite medium over the near field; infinite from the time on at which the run
        overflowed.
    fields : list of ndarray
        The near field at the times at which it is kept.
    history : ndarray, shape (times,)
        At one node; nan without one, and from the overflow on.
    """

    errors: np.ndarray
    fields: list[np.ndarray] = field(default_factory=list)
    history: np.ndarray = field(default_factory=lambda: np.zeros(0))


def infinite(setup: Mapping[str, Any], until: float) -> Reference:
    """The field of a homogeneous set-up after a number of steps, on the infinite lattice by FFT; nan outside a
    window."""
    sim = Simulation(**setup)
    rate = sim.model.coefficient / sim.lattice.spacing**2
    last = round(until / sim.dt) + 1
    exact = InfiniteLattice(sim.stencil, rate, sim.model.integrator, sim.dt, last, sim.start_u, None, sim.model.damping)
    mask = sim.lattice.mask
    return cache(lambda steps: exact.after(steps) if mask is None else np.where(mask, exact.after(steps), np.nan))


def measured_run(
    setup: Mapping[str, Any],
    boundary: Side,
    times: Sequence[float],
    reference: Reference,
    kept: Sequence[float] | None = None,
    probe: tuple[int, ...] | None = None,
) -> Measured:
    """Run a set-up with a boundary and compare it with the infinite medium.

    Parameters
    ----------
    setup : mapping
        Arguments of `Simulation`.
    boundary : Side
    times : sequence of float
        At which it is compared.
    reference : callable
        The infinite medium after a number of steps.
    kept : sequence of float, optional
        Those of the times at which the field is kept, all unless given.
    probe : tuple of int, optional
        Node of which the history is recorded.
    """
    sim = Simulation(**{**setup, "boundary": boundary})
    found = Measured(np.full(len(times), np.inf), history=np.full(len(times), np.nan))
    for number, t in enumerate(times):
        steps = round(t / sim.dt)
        try:
            sim.step(steps - sim.step_count)
        except UnstableError:
            break
        u = sim.fields["u"]
        if kept is None or t in kept:
            found.fields.append(u)
        if probe is not None:
            found.history[number] = u[probe]
        found.errors[number] = np.nanmax(np.abs(u - reference(steps)))
    return found


def growth_from_noise(setup: Mapping[str, Any], boundary: Side, until: float) -> float:
    """Rate at which the near field grows from white noise: slope of the logarithm of its norm over the last third of
    the run.

    A measurement, no proof: growth that is slow against the run, or that noise does not excite, goes unseen. A run that
    overflows is judged by the last third of what there is of it.
    """
    lattice = setup["lattice"]
    noise = np.random.default_rng(1).standard_normal(lattice.shape)
    noise = noise if lattice.mask is None else np.where(lattice.mask, noise, 0.0)
    sim = Simulation(**{**setup, "boundary": boundary, "initial": {"u": noise}})
    last = round(until / sim.dt)
    times, norms = [0.0], [float(np.linalg.norm(noise))]
    try:
        while sim.step_count < last:
            sim.step(1 if sim.step_count < _CLOSELY else min(max(1, last // 500), last - sim.step_count))
            times.append(sim.time)
            norms.append(float(np.sqrt(np.nansum(sim.fields["u"] ** 2))))
    except UnstableError:
        pass
    late = np.array(times) >= 2 / 3 * times[-1]
    return (
        float(np.polyfit(np.array(times)[late], np.log(np.maximum(norms, 1e-300))[late], 1)[0])
        if late.sum() > 1
        else np.inf
    )


def stability(setup: Mapping[str, Any], boundary: Side, until: float) -> tuple[float, str]:
    """Spectral radius of the complete step, less 1, and how it is known: from the certificate, or measured where that
    is undecided within seconds.

    Parameters
    ----------
    setup : mapping
        Arguments of `Simulation`; a small near field, for which a certificate is soon made.
    boundary : Side
    until : float
        End of the run from white noise in which growth is measured.
    """
    sim = Simulation(**{**setup, "boundary": boundary, "initial": None})
    found = sim.certificate(_SECONDS)
    if found.verdict == UNDECIDED:
        return float(np.expm1(growth_from_noise(setup, boundary, until) * sim.dt)), "measured from noise"
    if np.isnan(found.rate):
        return 0.0, "at most: proof"
    return float(np.expm1(found.rate * sim.dt)), found.verdict


def stability_note(setup: Mapping[str, Any], boundary: Side, until: float) -> str:
    """The words of `stability` for a row."""
    less_one, how = stability(setup, boundary, until)
    return (
        f"spectral radius less 1: {less_one:+.1e} ({how})"
        if np.isfinite(less_one)
        else f"spectral radius beyond bounds ({how})"
    )


def errors_picture(path: Path, times: Sequence[float], runs: Mapping[str, Measured]) -> None:
    """Errors over time of all runs."""
    from farhorizon.pictures.curves import error_history

    ylabel = r"largest $|u - u_\infty|$ in the near field"
    error_history(
        {label: (np.array(times), found.errors) for label, found in runs.items()}, path, ylabel, "", xlabel="$t$"
    )


def differences_picture(
    path: Path,
    axes: Sequence[np.ndarray],
    t: float,
    exact: np.ndarray,
    runs: Mapping[str, Measured],
    cracks: Sequence[np.ndarray] = (),
) -> None:
    """How far the fields of those runs that reach the last time are from the infinite medium."""
    from farhorizon.pictures.fields import field_panels

    panels = [
        (f"{label}, $t = {t:g}$", found.fields[-1] - exact)
        for label, found in runs.items()
        if np.isfinite(found.errors[-1])
    ]
    field_panels(panels, axes, path, shared_scale=False, cracks=cracks, label=r"$u - u_\infty$")
