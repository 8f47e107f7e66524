"""The instability guard."""

from __future__ import annotations

from farhorizon.checks.examined import Examined


def likely_cause(run: Examined) -> str:
    """What is likely to be wrong with a run that explodes."""
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
