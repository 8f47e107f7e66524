"""Measurements for reproductions of absorbing conditions: errors against the infinite medium, and stability."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon import Certificate, Side, Simulation, UnstableError
from farhorizon.analysis.references.infinite_lattice import InfiniteLattice

_SECONDS = 8.0  # time limit of a certificate
_CLOSELY = 200  # number of first steps after each of which the norm is recorded: fast growth soon overflows

Reference = Callable[[int], np.ndarray]


@dataclass
class Measured:
    """Errors (times,), relative to the infinite medium and infinite from an overflow on, of a run with one condition,
    its fields, values at one node (nan without one), and a few words of its certificate.
    """

    errors: np.ndarray
    fields: list[np.ndarray] = field(default_factory=list)
    history: np.ndarray = field(default_factory=lambda: np.zeros(0))
    stability: str = ""


def infinite(setup: Mapping[str, Any], until: float) -> Reference:
    """Field of a homogeneous set-up on the infinite lattice after a number of steps, by FFT; nan outside a window."""
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
    shown: Sequence[float] | None = None,
    probe: tuple[int, ...] | None = None,
    seconds: float = 0.0,
) -> Measured:
    """Run a set-up (arguments of `Simulation`) with a boundary and compare it at some times with the infinite medium,
    whose field after a number of steps is `reference`.

    The field is kept at a subset of the times (all unless given), the history at one node `probe`; a certificate takes
    up to `seconds`, and is not asked if that is 0.
    """
    sim = Simulation(**{**setup, "boundary": boundary})
    measured = Measured(np.full(len(times), np.inf), history=np.full(len(times), np.nan))
    if seconds:
        measured.stability = _in_words(sim.certificate(seconds))
    for number, t in enumerate(times):
        steps = round(t / sim.dt)
        try:
            sim.step(steps - sim.step_count)
        except UnstableError:
            break
        u = sim.fields["u"]
        if shown is None or t in shown:
            measured.fields.append(u)
        if probe is not None:
            measured.history[number] = u[probe]
        measured.errors[number] = np.nanmax(np.abs(u - reference(steps)))
    return measured


def _in_words(certificate: Certificate) -> str:
    """The verdict with the rate of the fastest-growing mode, if there is one."""
    if not np.isfinite(certificate.rate) or certificate.verdict == "undecided":
        return certificate.verdict
    if certificate.verdict == "not certified":
        return f"not certified: grows by {certificate.rate:.2g} per unit time"
    return f"{certificate.verdict}: decays by {-certificate.rate:.2g} per unit time"


def growth_from_noise(setup: Mapping[str, Any], boundary: Side, until: float) -> float:
    """Growth rate of the near field from white noise: slope of the logarithm of its norm over the last third of the
    run.

    This is a measurement, not a proof: growth that is slow compared with the run, or that noise does not excite,
    remains undetected. For a run that overflows, the last third of the time before the overflow counts.
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
    """Spectral radius of the complete step minus 1, and how it was determined: by the certificate, for which the near
    field should be small, or by the growth of white noise until a time if that remains undecided within seconds.
    """
    sim = Simulation(**{**setup, "boundary": boundary, "initial": None})
    certificate = sim.certificate(_SECONDS)
    if certificate.verdict == "undecided":
        return float(np.expm1(growth_from_noise(setup, boundary, until) * sim.dt)), "measured from noise"
    if np.isnan(certificate.rate):
        return 0.0, "at most: proof"
    return float(np.expm1(certificate.rate * sim.dt)), certificate.verdict


def stability_note(setup: Mapping[str, Any], boundary: Side, until: float) -> str:
    """Result of `stability` as the note of a row."""
    less_one, how = stability(setup, boundary, until)
    return (
        f"spectral radius less 1: {less_one:+.1e} ({how})"
        if np.isfinite(less_one)
        else f"spectral radius beyond bounds ({how})"
    )


def errors_picture(path: Path, times: Sequence[float], runs: Mapping[str, Measured]) -> None:
    """Draw the errors of all runs over time."""
    from farhorizon.pictures.curves import error_history

    ylabel = r"largest $|u - u_\infty|$ in the near field"
    error_history({label: (np.array(times), run.errors) for label, run in runs.items()}, path, ylabel, "", xlabel="$t$")


def differences_picture(
    path: Path,
    axes: Sequence[np.ndarray],
    t: float,
    exact: np.ndarray,
    runs: Mapping[str, Measured],
    cracks: Sequence[np.ndarray] = (),
) -> None:
    """Draw the last difference from the infinite medium for each run that reaches the last time."""
    from farhorizon.pictures.fields import field_panels
    from farhorizon.pictures.panels import Look, Panel

    panels = [
        Panel(f"{label}, $t = {t:g}$", run.fields[-1] - exact)
        for label, run in runs.items()
        if np.isfinite(run.errors[-1])
    ]
    field_panels(panels, axes, path, Look(r"$u - u_\infty$", shared=False, cracks=cracks))
