"""Cost of a run with layers and on the extended domain, measured on this machine before the run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from farhorizon.analysis.references.infinite_lattice import undisturbed
from farhorizon.boundaries import Fixed, LatticePML
from farhorizon.checks.examined import Examined
from farhorizon.engine.state import as_before
from farhorizon.errors import InputError
from farhorizon.geometry.lattice import AXES, Lattice

_PROBED = 200_000  # largest number of nodes of a plain run that is timed
# Strain of waves over the critical stretch, and their length in nodes: bonds of some nodes are stretched a little less,
# and all groups of nodes in which bonds are looked at together contain a crest.
_STRAINED, _WAVE = 0.6, 8.0
_FEW_STEPS = 4  # in which waves of that length hardly change
_ROUNDS, _ENOUGH_TIME = 20, 0.1  # most rounds, and seconds after which no other begins
_LEAST_ERROR = 1e-12  # smallest error asked of an extended domain, in place of exact ends


@dataclass(frozen=True)
class RunCost:
    """Cost of one way to compute the medium beyond the near field."""

    nodes: float  # computed nodes
    seconds: float  # of a step
    memory: float  # bytes

    def over(self, base: RunCost) -> str:
        """Time and memory relative to those of another run, in words."""
        time, memory = self.seconds / max(base.seconds, 1e-300), self.memory / max(base.memory, 1.0)
        words = f"{two_digits(time)} times" if time >= 1 else f"only {time:.2g} of"
        return f"{words} the time, {two_digits(memory)} times the memory"


def two_digits(value: float) -> str:
    """Text of a number with two digits, without an exponent where it is below a million: 120 rather than 1.2e+02."""
    return f"{float(f'{value:.2g}'):g}"


def run_cost(sim: Examined, seconds: float | None = None) -> RunCost:
    """The cost of a simulation as it is; `seconds` is the time of a step, measured if not given."""
    return RunCost(
        float(sim.engine.size), sim.seconds_per_step() if seconds is None else seconds, float(sim.engine.nbytes)
    )


def seconds_near_breaking(sim: Examined) -> float:
    """Time of a step in seconds while bonds everywhere are strained to about half of what breaks them, when each must
    be looked at: the shortest of some, started anew from waves in the whole near field. The state is not changed.
    """
    engine = sim.engine
    lead, axes = 3 - sim.lattice.dim, range(sim.lattice.dim)
    size = engine.bonds.critical_stretches[0] * sim.lattice.spacing * _STRAINED * _WAVE / (2 * np.pi)
    least, spent = np.inf, 0.0
    with as_before(engine):
        for number in range(_ROUNDS):
            for name in ("u", "u_old"):
                for axis in axes:
                    place = np.indices(engine.core.nodes)[lead + axis]
                    at = engine.core.node_indices() + axis * engine.layout.size
                    engine.put(name, size * np.sin(2 * np.pi * place / _WAVE), at)
            begin = perf_counter()
            engine.advance(_FEW_STEPS)
            took = perf_counter() - begin
            least, spent = min(least, took / _FEW_STEPS if number else np.inf), spent + took  # the first loads code
            if spent > _ENOUGH_TIME and number:
                break
    return least


def extended_run_cost(sim: Examined, until: float, sides: Sequence[tuple[int, int]]) -> RunCost:
    """The cost of the extended domain in place of some absorbing sides, measured on a domain without data; if the
    domain is large, on a smaller one and scaled in proportion.

    If the domain would not fit into memory, its size follows from the front of the waves alone.
    """
    errors = {key: max(sim.targets[key], _LEAST_ERROR) for key in sides}
    try:
        added = {key: extent.nodes for key, extent in sim.extents_for(errors, until).items()}
    except InputError:
        front = undisturbed(sim.stencil.with_reaction(0.0), sim.fastest_rate, sim.model.order, until)
        added = dict.fromkeys(errors, front)
    lattice = sim.lattice
    wide = np.array([float(n + added.get((a, -1), 0) + added.get((a, 1), 0)) for a, n in enumerate(lattice.shape)])
    shrunk = max(1.0, (np.prod(wide) / _PROBED) ** (1 / lattice.dim))
    count = [max(int(n / shrunk), 2 * m + 1) for n, m in zip(wide, sim.stencil.reach, strict=True)]
    box = Lattice(lattice.spacing, lattice.lower, lattice.lower + lattice.spacing * (np.array(count) - 1))
    plain = sim.remade(lattice=box, boundary=Fixed(sim.background))
    stored = np.array(plain.engine.layout.box.nodes[-lattice.dim :], float)  # with margins, which do not grow
    larger = float(np.prod((wide + stored - count) / stored))
    return RunCost(
        float(np.prod(wide)), plain.seconds_per_step() * float(np.prod(wide / count)), plain.engine.nbytes * larger
    )


def layered(sim: Examined, until: float) -> Examined:
    """The same set-up with layers of the same targets in place of the sides that extend the domain; InputError if no
    layer keeps the target.
    """
    sides: Mapping[str, object] = {
        AXES[axis] + "-+"[side > 0]: LatticePML(target=b.wanted(sim.model.target), until=until) if b.extended else b
        for (axis, side), b in sim.sides.items()
    }
    return sim.remade(boundary=sides)
