"""Motion and forces of impactors, step by step."""

from __future__ import annotations

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.recorders.recorder import Arrays, RecordRequest, RowRecorder, Window
from farhorizon.simulation.setup.setup import Setup


class Impacts(RowRecorder):
    r"""Motion of the impactors of a run, and the forces that they exert, recorded in every step.

    It is passed to a run in ``observe=[...]``.

    Parameters
    ----------
    every : int
        Steps from one record to the next.
    name : str
        Name that distinguishes several of them in one run.

    Attributes
    ----------
    points : ndarray, shape (n, dim)
        The middle of each impactor where it is put; adding the displacement gives its position.
    times : ndarray, shape (rows,)
        Times of the records; a step is recorded once the next one is known.
    data : dict of str to ndarray
        "force" that each impactor exerts on the solid, its "displacement" and "velocity", each of shape (rows, n, dim),
        and "stored", the energy of its contact, shape (rows, n). In two dimensions forces and energies are per unit
        thickness.

    Raises
    ------
    InputError
        When the simulation is created: it has no impactor.

    Examples
    --------
    >>> import farhorizon as fh
    >>> roller = fh.Impactor(fh.Disc(2.0, (0.0, 2.0)), path=[0.0, "-1e-3*t"])
    >>> motion = fh.Impacts()
    >>> plate = fh.Lattice(0.5, (-6.0, -4.0), (6.0, 0.0))
    >>> sides = {"all": fh.LatticePML(nodes=8), "y+": fh.Free()}
    >>> model = fh.Elastic(fh.Kernel(1.0, exponent=1), young=1.0)
    >>> sim = fh.Simulation(plate, model, sides, loads=[roller], observe=[motion])
    >>> _ = sim.run(until=20.0)
    >>> bool(motion.data["force"][-1, 0, 1] < 0)
    True
    """

    after = 1

    def __init__(self, every: int = 1, name: str = "impacts") -> None:
        super().__init__(name)
        self.every = kinds.integer(every, "impacts.every", least=1)
        self.points = np.zeros((0, 1))

    def __repr__(self) -> str:
        return f"Impacts(every={self.every})"

    def begin(self, setup: Setup, parts: RunParts) -> RecordRequest:
        if parts.impactors is None:
            raise InputError(
                "the run has no impactor",
                value=f"{len(setup.loads)} loads",
                limit="an Impactor among them",
                key="impacts",
                remedy="loads=[Impactor(...)]",
            )
        shapes = [impactor.shape for impactor in parts.impactors.given.values()]
        self.points = np.zeros((len(shapes), parts.near.lattice.dim))
        for point, shape in zip(self.points, shapes, strict=True):
            point[: shape.dim] = np.mean(shape.bounds(), axis=0)
        self._labels = tuple(f"impactor {number}" for number in range(len(shapes)))
        self._mass, self.dt = parts.near.mass, parts.near.dt
        return RecordRequest(np.zeros(0, np.int64), (), impactors=len(shapes))

    def rows(self, window: Window) -> Arrays:
        dim, values = self.points.shape[1], window.forces
        displacement, velocity, force = (values[..., dim * i : dim * (i + 1)] for i in range(3))
        return {
            "force": self._mass * force,
            "displacement": displacement,
            "velocity": velocity,
            "stored": self._mass * values[..., -1],
        }
