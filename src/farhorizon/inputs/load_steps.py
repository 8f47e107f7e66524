"""Quasi-static loading: load steps in place of time steps."""

from __future__ import annotations

from dataclasses import dataclass

from farhorizon import kinds
from farhorizon.files.storable import Storable

#: Largest number of iterations of a load step, unless given: some ten times what a bar of a thousand nodes takes.
MOST_ITERATIONS = 100_000


@dataclass(frozen=True)
class LoadSteps(Storable):
    """Quasi-static loading of a solid: each step of the run goes on until the body is in equilibrium.

    It is given in place of a time step, ``dt=LoadSteps(...)``. In each step prescribed values and loads move in a
    straight line from those at the last step to those at the present one, and stay; displacements follow by adaptive
    dynamic relaxation (Kilic and Madenci 2010), and bonds break on the way. The next step starts from there. Recorders
    have one row for each load step.

    Masses are fictitious: all are multiplied by the number that makes the load step a stable time step. Damping is
    chosen from Rayleigh's quotient; the damping and the drag of the model play no part. Equilibrium depends on none of
    them, but where a crack runs during a step, as under a load that is given, its path may, and so may slips of faces
    with friction.

    Parameters
    ----------
    interval : float
        Time between two load steps, in which loads and prescribed values are given; it need not be small.
    tolerance : float
        What displacements are still going to change in a step, relative to their size (root mean squares over the
        nodes): the acceleration over the squared frequency, and the velocity over the frequency, of the slowest mode.
        Rounding errors are not waited for, of about 1e-15 over its squared frequency per iteration.
    limit : int
        Largest number of iterations of a step; a `ValidityWarning` is issued where it ends a step.

    Raises
    ------
    InputError
        An interval or a limit that is not positive, a tolerance outside (0, 1).

    Examples
    --------
    >>> import farhorizon as fh
    >>> lattice = fh.Lattice(1.0, (0.0, 0.0), (19.0, 4.0))
    >>> rest = fh.Prescribed(fh.Box((-0.5, 0.0), (0.5, 4.0)), [0.0, None])
    >>> corner = fh.Prescribed([(10.0, 2.0)], [None, 0.0])
    >>> grip = fh.Prescribed(fh.Box((18.5, 0.0), (19.5, 4.0)), ["1e-3*t", None])
    >>> reaction = fh.Reaction(fh.Box((18.5, 0.0), (19.5, 4.0)))
    >>> model, sides = fh.Elastic(fh.Kernel(2.0, 1), 1.0), fh.Free()
    >>> steps, held = fh.LoadSteps(1.0), [rest, corner, grip]
    >>> sim = fh.Simulation(lattice, model, sides, constraints=held, observe=[reaction], dt=steps)
    >>> first, second = sim.run(until=2.0).recorders[0].data["force"][:, 0, 0]  # one row for each load step
    >>> bool(abs(second / first - 2) < 1e-4)
    True
    """

    interval: float
    tolerance: float = 1e-6
    limit: int = MOST_ITERATIONS

    def __post_init__(self) -> None:
        kinds.set_fields(
            self,
            interval=kinds.number(self.interval, "load_steps.interval", above=0),
            tolerance=kinds.number(self.tolerance, "load_steps.tolerance", above=0, below=1),
            limit=kinds.integer(self.limit, "load_steps.limit", least=1),
        )
