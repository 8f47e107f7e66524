"""Images of what has scattered or emitted waves: records sent back into the medium."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.inverse.adjoint import adjoint_run
from farhorizon.inverse.checks import shots_of
from farhorizon.inverse.gradient import gradient, residuals_of
from farhorizon.inverse.history import PatchRecorder, advance
from farhorizon.inverse.misfits import Misfit
from farhorizon.inverse.patch import Patch
from farhorizon.simulation.recorders.recorder import StepValues
from farhorizon.simulation.setup.setup import Setup

_DARK = 1e-3  # of the mean illumination: where less was seen, an image is not made brighter any more
_CONDITIONS = ("reflectors", "sources")


def image(
    shots: Sequence[tuple[Setup, Misfit | Sequence[Misfit]]],
    until: float,
    *,
    show: str = "reflectors",
    region: Any = None,
    memory: float | None = None,
    precision: str = "float64",
) -> np.ndarray:
    """Return an image of what the records of some shots differ by from the runs of the set-ups.

    The residuals are sent back from the receivers, reversed in time, through the medium of the set-ups.

    Parameters
    ----------
    shots : sequence of (Setup, Misfit or sequence of Misfit)
        Runs of one medium as far as it is known, with what was recorded.
    until : float
        End of the runs.
    show : {"reflectors", "sources"}
        "reflectors": a reverse-time image, the derivative of the misfit by the density over the illumination by the
        sources: it is large where the waves of the sources meet those that come back from the receivers.
        "sources": time reversal, the largest value that the waves which come back have at each node: they meet where
        something has emitted them that the set-ups lack. Set-ups without sources show all of it.
    region : Shape or ndarray of bool, optional
        As for `gradient`; for "sources" all nodes.
    memory, precision
        As for `gradient`.

    Returns
    -------
    ndarray
        Of the lattice's shape, zero outside the region.

    Raises
    ------
    InputError
        As `gradient`; a model without a density.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> lattice = fh.Lattice(1.0, (-12.0, -12.0), (12.0, 12.0))
    >>> ring = [(9.0 * np.cos(a), 9.0 * np.sin(a)) for a in np.linspace(0.1, 6.2, 16)]
    >>> line = fh.Receivers(ring, interpolation="linear")
    >>> still = fh.Setup(lattice, fh.Wave(fh.Kernel(2.0)), fh.LatticePML(nodes=10), dt=0.4)
    >>> event = fh.PointSource((3.0, -2.0), time=fh.Ricker(0.1))
    >>> run = fh.Simulation(lattice, still.model, fh.LatticePML(nodes=10), sources=[event], dt=0.4, observe=[line])
    >>> run.step(80)
    >>> seen = fh.image([(still, fh.LeastSquares(line, line.data["u"]))], until=32.0, show="sources")
    >>> [int(i) - 12 for i in np.unravel_index(seen.argmax(), seen.shape)]
    [3, -2]
    """
    kinds.one_of(show, "show", _CONDITIONS, "unknown image")
    given = shots_of(shots)
    total: Any = 0.0
    if show == "sources":
        for setup, misfits in given:
            total = np.maximum(total, _peaks(setup, misfits, until))
        return np.asarray(total)
    for i, (setup, _) in enumerate(given):
        if "density" not in setup.model.wave_constants or setup.model.order == 1:
            raise InputError(
                "only what has a density reflects waves",
                value=setup.model.title,
                limit="Wave, Elastic",
                key=f"shots[{i}].setup.model",
                remedy='show="sources"',
            )
    light: Any = 0.0
    for setup, misfits in given:
        shot = gradient(
            setup, misfits, "density", until, region=region, memory=memory, precision=precision, illumination=True
        )
        total, light = total + shot["density"], light + shot.illumination
    inside = np.asarray(light) > 0
    if not inside.any():
        return np.asarray(total)
    return np.asarray(total) / (light + _DARK * light[inside].mean())


class _Peaks(PatchRecorder, offered=False):
    """The largest value at each node so far."""

    def __init__(self, patch: Patch) -> None:
        super().__init__(patch)
        self.largest = np.zeros(patch.places)

    def add(self, step: int, heard: StepValues) -> None:
        self.largest = np.maximum(self.largest, np.sqrt((self.rows(heard) ** 2).sum(1)).max(0))


def _peaks(setup: Setup, misfits: Sequence[Misfit], until: float) -> np.ndarray:
    """Return the largest values of the adjoint of a run, of the lattice's shape."""
    run = residuals_of(setup, misfits, until)
    lattice = setup.lattice
    every = Patch(lattice, (0,) * lattice.dim, (0,) * lattice.dim, lattice.shape, frozenset())
    peaks = _Peaks(every)
    back = adjoint_run(run.setup, run.residuals, run.shift, [peaks])
    advance(back, every, run.shift)
    return peaks.largest.reshape(lattice.shape)
