"""Recording of a run on the shell of a box, to be used as an incident wave in another run."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.files.records import Recorded
from farhorizon.geometry.shapes import Box
from farhorizon.inputs.cracks import cut_ends
from farhorizon.inputs.incidence import Region, region_of, resolved_box
from farhorizon.medium.integrators import Verlet
from farhorizon.rounding import TINY
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.recorders.recorder import (
    Arrays,
    RecordRequest,
    RowRecorder,
    StepValues,
    Window,
    check_from_start,
    size_of_record,
)
from farhorizon.simulation.setup.setup import Setup
from farhorizon.simulation.time.source_terms import ends_of, scheme_of

_KEY = "shell.box"
_ROUNDING = 1e-12  # of the largest value: data and sources below this in the box count as absent


class ShellRecorder(RowRecorder):
    """The field at the nodes with a bond through a face of a box, after every step: all that another run needs to know
    about the waves that enter the box, see `IncidentRecord`.

    It is passed to a run in ``observe=[...]``.

    Parameters
    ----------
    box : Box, optional
        Box that contains every part of the medium that the other run changes, at least two reaches of the stencil
        inside its faces. The near field minus two reaches unless given; it may stand on a free side.
    name : str
        Name that distinguishes several of them in one run, in results files too.

    Attributes
    ----------
    points : ndarray, shape (n, dim)
    times : ndarray, shape (rows,)
    data : dict of str to ndarray
        "u", shape (rows, n), for vectors (rows, n, dim).

    Raises
    ------
    InputError
        When the simulation is created: a model other than waves with linear bonds, a box that does not fit, a medium
        that is not uniform at its faces, initial data or sources inside it. When it is run: records that do not fit
        into memory.

    Examples
    --------
    >>> import farhorizon as fh
    >>> shell = fh.ShellRecorder(fh.Box((-4.0, -4.0), (4.0, 4.0)))
    >>> lattice = fh.Lattice(0.5, (-16.0, -10.0), (8.0, 10.0))
    >>> blow = "exp(-(x + 10)**2 - y**2)*exp(-(t - 3)**2)"
    >>> sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(1.0)), sources=[blow], observe=[shell])
    >>> sim.step(10)
    >>> shell.data["u"].shape == (11, len(shell.points))
    True
    """

    tag: ClassVar[str] = "shell"
    shared = unbroken = True

    def __init__(self, box: Box | None = None, name: str = "shell") -> None:
        super().__init__(name)
        self.box = None if box is None else kinds.instance(box, _KEY, Box, "a Box")
        self.points = np.zeros((0, 1))
        self._medium = 0.0

    def __repr__(self) -> str:
        return f"ShellRecorder({self.box}, name={self.name!r})"

    @property
    def recorded(self) -> Recorded:
        """The recorded data, independent of the run."""
        return Recorded(self.name, self.points, self.times, self.data, medium=self._medium)

    def begin(self, setup: Setup, parts: RunParts) -> RecordRequest:
        near, law = parts.whole.near, parts.near.model.bond_law
        if not isinstance(near.model.integrator, Verlet) or (law is not None and law.nonlinear):
            raise InputError(
                "waves for another run are those of linear bonds and of second order",
                value=type(near.model).__name__,
                key="shell",
                limit="Wave or Elastic with linear bonds",
                remedy="Receivers for other models",
            )
        ends = ends_of(parts.whole.sides)
        box = resolved_box(self.box, near.lattice, near.stencil.reach, ends, _KEY)
        scheme = scheme_of(near, 1.0)
        region = region_of(box, near.lattice, scheme, [end for end, free in ends.items() if free], near.states)
        nodes = region.shell.nodes
        of_whole = np.ravel_multi_index(tuple(nodes.T), near.lattice.shape)
        self._medium = scheme.rate * _factor(setup, parts, of_whole)
        self.notes = _check_rest(parts, region)
        self.points, self.dt = region.places(nodes), near.dt
        return RecordRequest(of_whole, ())

    def foresee(self, until: float, steps: int) -> None:
        """Determine, before a run, how much will be recorded; raises InputError if it does not fit into memory."""
        need = 8 * int(np.prod(self._rows["u"][0].shape[1:])) * (steps + 1)
        size = size_of_record(need, len(self.points), steps, _KEY, "a smaller box, or a shorter run")
        start = f"{self.name} records the shell of a box: "
        self.notes = [note for note in self.notes if not note.startswith(start)] + [start + size]

    def functional(self, step_values: StepValues) -> np.ndarray:
        values = np.array(step_values.nodes, float)
        return values[..., 0] if values.shape[2] == 1 else values

    def restart(self, step: int, values: np.ndarray, forces: np.ndarray) -> None:
        check_from_start(step, "the shell of a box", "shell")
        super().restart(step, values, forces)

    def rows(self, window: Window) -> Arrays:
        return {"u": window.values[0]}


def _factor(setup: Setup, parts: RunParts, nodes: np.ndarray) -> float:
    """Return the factor on the bonds at the nodes of a shell, given by flat numbers; refuse cracks, holes, other
    materials and conditions there.
    """
    near, lattice = parts.near, parts.near.lattice.whole
    material = parts.at(near.material, nodes)
    uneven = bool(np.ptp(material) != 0) or bool(parts.at(near.conditioned.astype(float), nodes).any())
    for crack in setup.cracks:
        ends = cut_ends(crack.cut, lattice, near.stencil.offsets)
        ends = ends[((ends >= 0) & (ends < lattice.shape)).all(1)]
        uneven |= bool(np.isin(np.ravel_multi_index(tuple(ends.T), lattice.shape), nodes).any())
    if uneven:
        raise InputError(
            "the medium is not uniform at the faces of a box whose shell is recorded",
            value=f"bonds of {material.min():.4g} to {material.max():.4g} of the medium's, or cracks or conditions",
            key=_KEY,
            limit="cracks, holes, other materials and conditions one reach away from the faces",
            remedy="a box with all of them inside, or outside",
        )
    return float(material[0])


def _check_rest(parts: RunParts, region: Region) -> list[str]:
    """Refuse data and sources inside a box; return notes on what cannot be checked."""
    part, largest = parts.near.lattice, parts.whole.team.largest
    inside = np.zeros(part.shape, bool)
    ends = zip(region.first, region.last, part.first, strict=True)
    inside[tuple(slice(max(low - first, 0), max(high + 1 - first, 0)) for low, high, first in ends)] = True
    for key, values in [("initial.u", parts.start.u), ("initial.v", parts.start.v)] + [
        ("source", space) for space, _ in parts.source_terms.sources if space is not None
    ]:
        sizes = np.abs(values).reshape(-1, *inside.shape).max(0)
        peak, peak_inside = largest(float(sizes.max())), largest(float(sizes[inside].max(initial=0)))
        if peak_inside > _ROUNDING * max(peak, TINY):
            raise InputError(
                "does not begin at rest in the box whose shell is recorded: the waves of another run come into it"
                if key != "source"
                else "acts inside the box whose shell is recorded: the waves of another run come into it",
                value=f"{peak_inside:.3g}",
                limit=f"{_ROUNDING:g} of the largest value, {peak:.3g}",
                key=key,
                remedy="a smaller box, or data farther away",
            )
    for incident in parts.incident:
        nodes = incident.region.shell.nodes
        if ((nodes >= region.first) & (nodes <= region.last)).all(1).any() or not incident.passage.rests:
            raise InputError(
                "an incident wave comes in inside the box whose shell is recorded",
                value="its box reaches into this one",
                limit="boxes apart",
                key=_KEY,
                remedy="a box outside that of the incident wave",
            )
    moving = any(space is None for space, _ in parts.source_terms.sources)
    return ["a source that does not split into space and time must not act inside the recorded box"] if moving else []
