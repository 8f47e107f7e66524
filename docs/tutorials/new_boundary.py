"""A boundary of one's own, judged against the infinite medium beside ours."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import farhorizon as fh


@dataclass(frozen=True)
class PowerSponge(fh.Side):
    """Nodes beyond the side, damped by ``strength * (depth / thickness)^power``."""

    endless: ClassVar[bool] = True  # the medium goes on beyond it
    damped: ClassVar[bool] = True  # `damping` tells by how much
    passive: ClassVar[bool] = True  # it gives no energy
    nodes: int = 40
    strength: float = 0.5
    power: float = 3.0

    def wanted(self, default):
        return default

    def width(self, reach, spacing):
        return self.nodes

    def damping(self, order, coefficient, spacing):
        return self.strength * ((np.arange(self.nodes) + 1) / self.nodes) ** self.power


square, pulse = fh.Lattice(0.25, (-6, -6), (6, 6)), {"u": "exp(-(x**2 + y**2))"}
fields = {}
for side in (fh.Extended(1e-9, until=30.0), PowerSponge(), PowerSponge(80), fh.Sponge(40), fh.LatticePML(nodes=12)):
    sim = fh.Simulation(square, fh.Wave(fh.Kernel(0.75)), side, pulse, dt=0.08)
    fields[side] = [sim.run(until=t, progress=False).fields["u"] for t in np.arange(1.0, 31.0)]
exact, *others = fields
for side in others:
    error = np.abs(np.array(fields[side]) - fields[exact]).max()
    print(f"{error:8.1e}  {side}")
