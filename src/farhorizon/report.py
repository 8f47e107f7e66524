"""What `Simulation.check` finds out before a run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from farhorizon.certificate import BUDGET, NOT_CERTIFIED, UNDECIDED, Certificate
from farhorizon.lattice import AXES
from farhorizon.stencil import BackwardWaves

if TYPE_CHECKING:
    from farhorizon.simulation import Simulation


@dataclass
class Report:
    """Facts about a set-up; `str` gives them as a table.

    Attributes
    ----------
    rows : list of (str, str)
        Name and value.
    warnings : list of str
    notes : list of str
        Not wrong, but to be known.
    certificate : Certificate
        Whether the complete update is stable.
    """

    rows: list[tuple[str, str]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    certificate: Certificate | None = None

    @classmethod
    def of(cls, sim: Simulation, until: float | None = None, budget: float | None = None) -> Report:
        """Examine a simulation; see `Simulation.check`."""
        from farhorizon.boundaries import Exact, Fixed, LatticePML

        lattice, stencil, engine = sim.lattice, sim.stencil, sim.engine
        report = cls()
        duration = None if until is None else sim.seconds_per_step() * int(np.ceil(until / sim.dt))
        if budget is None:
            budget = BUDGET if duration is None else min(BUDGET, max(2.0, duration))

        def say(name: str, value: str) -> None:
            report.rows.append((name, value))

        say("near field", f"{' x '.join(map(str, lattice.shape))} nodes, {lattice.nodes} shown, spacing {lattice.spacing:g}")
        say("stencil", f"{len(stencil.weights)} neighbours, reach {' x '.join(map(str, stencil.reach))} nodes")
        say("time step", f"{sim.dt:.6g}, {sim.dt / sim.step_limit:.3g} of the stable limit {sim.step_limit:.6g} ({sim.model.integrator.name})")
        lead = 3 - lattice.dim
        for (axis, side), layer in engine.layers.items():
            boundary = sim.sides[axis - lead, side]
            assert isinstance(boundary, LatticePML)
            name = AXES[axis - lead] + "-+"[side > 0]
            say(f"layer {name}", f"{layer.columns} nodes = {layer.columns / stencil.reach[axis - lead]:.3g} horizons, "
                f"length {layer.columns * lattice.spacing:g}, target {boundary.wanted(sim.model.order):g}")  # fmt: skip
        for (axis, side), boundary in sim.sides.items():
            if not isinstance(boundary, LatticePML | Exact):
                say(f"side {AXES[axis]}{'-+'[side > 0]}", repr(boundary))
        for name, serves in sim.ends.items():
            say(f"exact end {name}", serves)
        total = int(np.prod(engine.core.nodes))
        extra = sum(int(np.prod(b.nodes)) for b in engine.layout.blocks.values()) - int(np.prod(lattice.shape))
        say("nodes computed", f"{total} in the core, {extra} beyond the near field")
        say("memory", f"{engine.nbytes / 2**20:.3g} MiB = {engine.nbytes / (np.prod(lattice.shape) * engine.dtype.itemsize):.3g} near fields")
        say("absent bonds", str(engine.absent_bonds))
        backward = stencil.backward_waves()
        say("backward waves", f"{100 * backward.fraction:.3g} % of the Brillouin zone from |k| spacing = {backward.first_wavenumber:.3g}"
            if backward else "none")  # fmt: skip
        if duration is not None and until is not None:
            say("time", f"about {_seconds(duration)} for {int(np.ceil(until / sim.dt))} steps to t = {until:g}")
        report.certificate = certificate = sim.certificate(budget)
        say("stability", str(certificate))
        if certificate.verdict == NOT_CERTIFIED:
            report.warnings.append(f"the run is not stable: {certificate.reason}. {_remedy(sim, backward)}")
        elif certificate.verdict == UNDECIDED:
            report.warnings.append(f"stability is undecided: {certificate.reason}; watch the energy")
        if any(isinstance(b, Fixed) for b in sim.sides.values()) and engine.layers:
            report.warnings.append("a Fixed side reflects")
        report.notes = sim.notes
        return report

    def as_json(self) -> dict[str, Any]:
        """Facts, warnings, notes and the certificate as plain data."""
        certificate = {} if self.certificate is None else self.certificate.as_json()
        return {"facts": dict(self.rows), "warnings": self.warnings, "notes": self.notes, "certificate": certificate}

    def __str__(self) -> str:
        width = max(len(name) for name, _ in self.rows)
        lines = [f"{name:<{width}}  {value}" for name, value in self.rows]
        return "\n".join(lines + [f"warning: {w}" for w in self.warnings] + [f"note: {n}" for n in self.notes])


def _remedy(sim: Simulation, backward: BackwardWaves) -> str:
    """What to do about growth in a layer."""
    other = "Exact ends, or " if sim.lattice.dim == 1 else ""
    if not backward:
        return f"Use {other}a thicker layer or one with a gentler profile, a smaller step, or a Sponge."
    kernel = "exponent 2 with a reach of at most 3 nodes" if sim.lattice.dim < 3 else "exponent 2 with the linear influence function"
    return (f"The stencil has backward waves, which grow in the layer, by up to {backward.growth:.2g} sigma per unit time, from rounding or noise. "
            f"Use {other}{kernel}; or keep the data smooth and the run short.")  # fmt: skip


def _seconds(duration: float) -> str:
    """A duration in words."""
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if duration >= 2 * length:
            return f"{duration / length:.2g} {unit}"
    return f"{duration:.2g} s"
