"""What a run knows about its stability, and when that is examined again."""

from dataclasses import dataclass, field

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.checks.certificate import CERTIFIED, NOT_CERTIFIED, UNDECIDED, Certificate
from farhorizon.simulation.run import Examination


@dataclass
class Examined:
    """Stand-in for a run whose certificates are given; it records the durations for which they were requested."""

    certificates: dict[float, Certificate]
    asked: list[float] = field(default_factory=list)
    lattice = fh.Lattice(1.0, 0, 9)
    stencil = fh.Wave(fh.Kernel(2.0)).stencil(1.0, 1)
    dt = 0.1
    step_count = 0

    def seconds_per_step(self):
        return 1e-6

    def certificate(self, budget, until):
        self.asked.append(until)
        return self.certificates[until]


def grows(rate):
    return Certificate(NOT_CERTIFIED, "white noise", rate)


def test_what_rose_in_a_short_run_is_looked_at_again_before_a_longer_one():
    """Noise that grows in a short run may be transient; growth that is still there is refused, and examined once."""
    for longer, refused in ((Certificate(UNDECIDED, "noise", quiet=50.0), False), (grows(0.047), True)):
        run, known = Examined({12.5: grows(0.047), 50.0: longer}), Examination()
        assert known.of(run, 12.5, False).verdict == NOT_CERTIFIED
        for _ in range(2):
            if refused:
                with pytest.raises(fh.InputError, match="not stable"):
                    known.of(run, 50.0, False)
            else:
                assert known.of(run, 50.0, False) is longer
        assert run.asked == [12.5, 50.0]


def test_what_is_known_for_all_times_is_asked_for_once():
    for kept in (Certificate(CERTIFIED, "a proof"), grows(1e-3)):
        run, known = Examined({1.0: kept}), Examination()
        for until in np.arange(1.0, 60.0, 7.0):
            assert known.of(run, until, False) is kept
        assert run.asked == [1.0]
