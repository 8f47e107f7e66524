"""The instability guard."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from farhorizon.checks.examined import Examined
from farhorizon.errors import UnstableError

EXPLODED = 1e6  # largest value over what initial data and drives explain, above which a run counts as unstable


def refuse_explosion(
    values: np.ndarray,
    first: np.ndarray,
    spacing: float,
    scale: float,
    step: int,
    time: float,
    cause: Callable[[], str],
) -> None:
    """Raise an UnstableError that names step, time, place and likely cause for a field, shape (..., n..), that is not
    finite, or has grown far beyond `scale`, the largest value that data and source terms explain.
    """
    top, low = float(values.max()), float(values.min())
    if np.isfinite(top) and np.isfinite(low) and max(top, -low) <= EXPLODED * scale:
        return
    worst = np.unravel_index(int(np.argmax(np.where(np.isfinite(values), np.abs(values), np.inf))), values.shape)
    place = first + spacing * np.array(worst[-first.size :])
    raise UnstableError(
        f"unstable at step {step}, t = {time:.6g}: u = {values[worst]:.3g} near {np.round(place, 6).tolist()}; "
        f"likely cause: {cause()}"
    )


def likely_cause(run: Examined) -> str:
    """Return the likely cause, in words, of the instability of a run."""
    if run.closure is not None:
        names = ", ".join(sorted({type(b).__name__ for b in run.sides.values() if b.closing}))
        return (
            f"{names} grows on this outline, which `check` tells before the run: try `farhorizon check "
            "--tune`, or LatticePML"
        )
    backward = run.stencil.backward_waves()
    if backward and run.engine.layers:
        return (
            "the stencil has backward waves, which grow in layers that do not damp them (up to "
            f"{backward.growth:.2g} sigma)"
        )
    return "check dt, sources and coefficient"
