"""Reactions: the forces that hold prescribed nodes, step by step."""

from __future__ import annotations

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError, shown
from farhorizon.geometry.shapes import Shape
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.recorders.recorder import Arrays, RecordRequest, RowRecorder, StepValues, Window
from farhorizon.simulation.setup.setup import Setup

_ROUNDING = 2.0**-24  # of a number in single precision, relative to it


class Reaction(RowRecorder):
    r"""Forces that constraints exert on the nodes that they hold (`Prescribed`), recorded in every step.

    It is passed to a run in ``observe=[...]``. The force on a node follows from where it is put, and from where it
    would have moved freely in the same step: it is exact for every law of the bonds, also while they break. It includes
    the inertia and the damping of the held nodes themselves, which vanish where these are at rest or move uniformly
    without damping.

    Parameters
    ----------
    region : Shape, optional
        Region of the held nodes whose forces are added, such as a grip or a support; unless given, the nodes of each
        constraint are recorded by themselves.
    every : int
        Steps from one record to the next.
    name : str
        Name that distinguishes several of them in one run.

    Attributes
    ----------
    points : ndarray, shape (n, dim)
        The centre of the held nodes of each group.
    times : ndarray, shape (rows,)
        Times of the records; the force at a step is known after the next one.
    data : dict of str to ndarray
        "force", the sum over the held nodes of each group, and "displacement", the mean of the field over them; each of
        shape (rows, n), for vector fields (rows, n, dim). In two dimensions forces are per unit thickness, in one
        dimension per unit area. A free component has no force, nor has a node that has been released. At t = 0, where
        the nodes begin to be held, the force is half of that just after.

    Raises
    ------
    InputError
        When the simulation is created: no prescribed nodes, or none in the region; a field that diffuses.

    Notes
    -----
    A force F and a displacement u of nodes that move together give the work in ``Simulation.energies()["work"]``:
    from half a step before to half a step after the record it grows by ``F . (u(t + dt) - u(t - dt)) / 2``, so that F
    is the derivative of the work with respect to the displacement, to rounding error.

    The force is the difference of two positions over the square of the step. In single precision it is therefore
    rounded by about 6e-8 of the force that would move a single held node by its whole displacement.

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(1.0, (-9.0, -9.0), (9.0, 9.0))
    >>> rest = fh.Prescribed(fh.Box((-9.0, -9.0), (9.0, -8.0)), [0.0, 0.0])
    >>> grip = fh.Prescribed(fh.Box((-9.0, 8.0), (9.0, 9.0)), velocity=[None, 1e-3])
    >>> reaction = fh.Reaction()
    >>> model = fh.Elastic(fh.Kernel(2.0, 1), 1.0, damping=0.3)
    >>> sim = fh.Simulation(lattice, model, fh.Free(), constraints=[rest, grip], observe=[reaction])
    >>> _ = sim.run(until=400.0)
    >>> below, above = reaction.data["force"][-1, :, 1]
    >>> bool(below < 0 < above)
    True
    """

    shared = True
    after = 1

    def __init__(self, region: Shape | None = None, every: int = 1, name: str = "reaction") -> None:
        super().__init__(name)
        self.region = None if region is None else kinds.instance(region, "reaction.region", Shape, "a shape")
        self.every = kinds.integer(every, "reaction.every", least=1)
        self.points = np.zeros((0, 1))

    def __repr__(self) -> str:
        return f"Reaction({'each constraint' if self.region is None else self.region!r}, every={self.every})"

    # --- in a run ----------------------------------------------------------------------------------------------

    def begin(self, setup: Setup, parts: RunParts) -> RecordRequest:
        near, lattice = parts.near, parts.whole.near.lattice
        if near.model.order != 2:
            raise InputError(
                "a field that diffuses is not held by forces",
                value=near.model.title,
                limit="waves and elastic media",
                key="reaction",
                remedy="balance=True, which tells what flows into prescribed nodes",
            )
        groups = [self._joined(nodes, parts) for nodes in near.prescribed.nodes]
        if self.region is not None and self.region.dim != lattice.dim:
            raise InputError(
                "shape and lattice differ in dimension",
                value=f"{self.region.dim} dimensions",
                limit=f"{lattice.dim}",
                key="reaction.region",
                remedy="a shape of the lattice's dimension",
            )
        if self.region is not None and groups:
            prescribed = np.unique(np.concatenate(groups))
            groups = [prescribed[np.isin(prescribed, lattice.inside(self.region))]]
        if not any(map(len, groups)):
            raise InputError(
                "no node in the region is prescribed" if near.prescribed.nodes else "no node of the run is prescribed",
                value=shown(self.region) if near.prescribed.nodes else "no constraint",
                limit="at least one prescribed node",
                key="reaction.region",
                remedy="Prescribed nodes in the region; a fixed side lies beyond the nodes: prescribe the outermost "
                "ones, and let the side be free",
            )
        self._labels = tuple(f"constraint {i}" for i in range(len(groups))) if self.region is None else (self.name,)
        centres = [np.stack(np.unravel_index(nodes, lattice.shape), -1).mean(0) for nodes in groups]
        self.points = np.array([np.array(lattice.lower) + lattice.spacing * centre for centre in centres])
        self._ends = np.cumsum([0, *map(len, groups)])
        self._mass, self.dt, self._background = near.mass, near.dt, near.background
        self._vector = near.stencil.components > 1
        self.notes = [_rounded(self.name)] if parts.grid.engine.dtype.itemsize < 8 else []
        return RecordRequest(np.concatenate(groups), (), held=tuple(groups))

    def _joined(self, nodes: np.ndarray, parts: RunParts) -> np.ndarray:
        """Return the numbers in the whole lattice of nodes that each process has in its part."""
        inside = np.zeros(parts.near.lattice.shape, bool)
        inside.flat[nodes] = True
        return parts.whole.numbers(inside, parts.near.lattice)

    def functional(self, step_values: StepValues) -> np.ndarray:
        """Return the mean of the field over each group, shape (steps, groups, components)."""
        pairs, nodes = zip(self._ends[:-1], self._ends[1:], strict=True), step_values.nodes
        return np.stack([nodes[:, first:end].mean(1) for first, end in pairs], 1) + self._background

    def rows(self, window: Window) -> Arrays:
        rows = {"force": self._mass * window.forces, "displacement": window.values[0]}
        return rows if self._vector else {name: values[..., 0] for name, values in rows.items()}


def _rounded(name: str) -> str:
    return (
        f"{name} in single precision: forces are rounded by about {_ROUNDING:.0e} of the force that would move a held "
        'node by its whole displacement; dtype = "float64" where displacements are large beside strains'
    )
