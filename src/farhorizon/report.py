"""What `Simulation.check` finds out before a run."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from farhorizon.lattice import AXES

if TYPE_CHECKING:
    from farhorizon.simulation import Simulation


def shown(boundary: Any) -> str:
    """A boundary with the options that differ from their defaults."""
    given = {f.name: getattr(boundary, f.name) for f in fields(boundary) if getattr(boundary, f.name) != f.default}
    return f"{type(boundary).__name__}({', '.join(f'{k}={v!r}' for k, v in given.items())})"


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
    """

    rows: list[tuple[str, str]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, sim: Simulation) -> Report:
        """Examine a simulation."""
        from farhorizon.boundaries import Closing, Exact, Fixed, LatticePML

        lattice, stencil, engine = sim.lattice, sim.stencil, sim.engine
        report = cls()

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
            if not isinstance(boundary, LatticePML | Exact) and not (isinstance(boundary, Closing) and lattice.window is not None):
                say(f"side {AXES[axis]}{'-+'[side > 0]}", shown(boundary))
        if sim.closure is not None:
            if lattice.window is not None:
                say("outline", shown(sim.sides[0, -1]))
            say("fitted", sim.closure.describe())
            report.warnings += sim.closure.warnings()
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
        if backward and sim.model.order == 2 and engine.layers:
            better = "exponent 2 with a reach of at most 3 nodes" if lattice.dim < 3 else "exponent 2 with the linear influence function"
            report.warnings.append(
                f"the stencil has backward waves: they grow in the layer, by up to {backward.growth:.2g} sigma per unit time, from rounding or "
                f"noise. Keep the data smooth and the run short, or use {better}."
            )
        if max(stencil.reach) > 3 and sim.model.order == 2 and engine.layers:
            report.warnings.append("stability of wide stencils (reach above 3 nodes) is not certified: watch the energy")
        if any(isinstance(b, Fixed) for b in sim.sides.values()) and engine.layers:
            report.warnings.append("a Fixed side reflects")
        report.notes = sim.notes
        return report

    def __str__(self) -> str:
        width = max(len(name) for name, _ in self.rows)
        lines = [f"{name:<{width}}  {value}" for name, value in self.rows]
        return "\n".join(lines + [f"warning: {w}" for w in self.warnings] + [f"note: {n}" for n in self.notes])
