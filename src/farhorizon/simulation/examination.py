"""Examination of the stability of a run before it begins."""

from __future__ import annotations

from typing import Protocol

from farhorizon.analysis.stability import step_seconds
from farhorizon.checks.certificate import UNDECIDED, Certificate
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import Lattice
from farhorizon.medium.stencil import Stencil

_LEAST = 2.0  # smallest budget for the modes of a run


class Examinable(Protocol):
    """A run that can be examined."""

    lattice: Lattice
    stencil: Stencil
    dt: float
    step_count: int

    def certificate(self, budget: float, until: float) -> Certificate:
        """Determine whether the complete update is stable, in at most `budget` seconds."""


class Examination:
    """The certificate of a run, which is made again only if it is not sufficient."""

    def __init__(self) -> None:
        self._known: Certificate | None = None
        self._asked = 0.0  # length of the run for which it was made

    def of(self, run: Examinable, until: float, allow_unstable: bool) -> Certificate:
        """Return the certificate of a run up to a time; raises InputError if anything grows tenfold or more by then."""
        known = self._known
        # growth seen in a short run of noise need not continue in a longer one
        little = known is not None and (
            (known.verdict == UNDECIDED and known.quiet < until) or known.grows_within(until)
        )
        if known is None or (little and self._asked < until):
            # doubling the length keeps the number of examinations small for a run in many pieces
            asked = until if known is None else max(until, 2 * self._asked)
            known = run.certificate(modes_budget(run, until), asked)
            self._known, self._asked = known, asked
        if known.grows_within(until) and not allow_unstable:
            raise InputError(
                "the run is not stable",
                value=known.reason,
                limit=f"no tenfold growth until t = {until:.6g}",
                remedy="see the warnings of check; Extended in place of absorbing sides; "
                "allow_unstable=True (--allow-unstable) runs it anyway",
            )
        return known


def modes_budget(run: Examinable, until: float) -> float:
    """Return what the examination of the modes may take for a run to a time, half of the run's own operations, in
    seconds of a typical core.
    """
    steps = until / run.dt - run.step_count
    return max(_LEAST, 0.5 * steps * step_seconds(run.lattice.nodes * run.stencil.weights.size))
