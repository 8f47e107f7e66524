"""Crack tips during a run: their positions and speeds, and the energy spent."""

from __future__ import annotations

from functools import reduce

import numpy as np

from farhorizon import kinds
from farhorizon.analysis.fracture.crack_paths import CrackPaths, find_cracks, followed, saturated_damage
from farhorizon.errors import InputError
from farhorizon.files.records import Recorded
from farhorizon.rounding import MARGIN
from farhorizon.simulation.assembly import RunParts
from farhorizon.simulation.recorders.recorder import Arrays, RecordRequest, RowRecorder, Window
from farhorizon.simulation.setup.setup import Setup
from farhorizon.simulation.time.breaking import BreakableBonds

_JUMP = 2.0  # horizon + distance of the fastest wave between records, times this: tips farther apart are different
_WINDOW = 10.0  # horizons travelled by the fastest wave while measuring a speed: tips are located to a fraction of one


class CrackTips(RowRecorder):
    """Crack tips in 2D while bonds break; passed to a run in ``observe=[...]``. In 3D those of a slab one node thick,
    in the plane of its other two axes.

    A tip is located where the damage ahead of a crack falls to half of the value that a long crack leaves beside
    itself; see `farhorizon.analysis.fracture.crack_paths`. It keeps its number as it runs. At a branching point one tip
    continues, and each of the others begins there with a new number. Where a crack ends at the edge of the near field
    there is no tip.

    Parameters
    ----------
    every : int
        Steps from one record to the next.
    most : int
        Largest number of tips that are followed; a note reports if there are more.
    name : str
        Name that distinguishes several of them in one run.

    Attributes
    ----------
    points : ndarray, shape (most, 1)
        Numbers of the tips, from 1 on.
    times : ndarray, shape (rows,)
    data : dict of str to ndarray
        "position", shape (rows, most, 2); "advance", the distance travelled by each tip since its first record, and
        "speed", both of shape (rows, most). The speed is the distance between the present position and that at the
        beginning of the preceding time in which P waves travel ten horizons, divided by that time. nan where there is
        no tip, and for speeds until the tip has been followed for that long.
    length : ndarray, shape (rows,)
        Total length of all cracks, including those that existed at the start.
    dissipated : ndarray, shape (rows,)
        Energy that bonds held when they broke, as in "broken" of `Simulation.energies`.
    now : CrackPaths
        The lines of the cracks, their tips and branches at the last record; for a run that continues from a file, at
        the time when it was saved.

    Raises
    ------
    InputError
        When the simulation is created: more or fewer than two axes with more than one node, bonds that do not break.

    Examples
    --------
    >>> import farhorizon as fh
    >>> tips = fh.CrackTips(every=10)
    >>> lattice = fh.Lattice(0.5, (-8.25, -8.25), (8.25, 8.25))
    >>> model = fh.Elastic(fh.Kernel(1.0, 1), 1.0, critical_stretch=0.1)
    >>> sim = fh.Simulation(lattice, model, cracks=[[(-3.0, 0.0), (3.0, 0.0)]], observe=[tips])
    >>> abs(tips.data["position"][0, :2, 0]).round().tolist()
    [3.0, 3.0]
    """

    shared = True

    def __init__(self, every: int = 20, most: int = 7, name: str = "crack_tips") -> None:
        super().__init__(name)
        self.every = kinds.integer(every, "crack_tips.every", least=1)
        self.most = kinds.integer(most, "crack_tips.most", least=1, most=1000)
        self.points = np.arange(1.0, self.most + 1)[:, None]
        self._nowhere = np.full((self.most, 2), np.nan)
        self.now = CrackPaths(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2)), [])
        self._horizon = self._reach = self._window = 0.0
        self._none = {"places": np.zeros((0, self.most, 2)), "sums": np.zeros((0, 2))}
        self._written = 0  # rows that a file has
        self._begin_rows(self._none)

    def __repr__(self) -> str:
        return f"CrackTips(every={self.every})"

    # --- what was recorded -------------------------------------------------------------------------------------

    @property
    def data(self) -> dict[str, np.ndarray]:
        """Positions, advances and speeds."""
        places = super().data["places"]
        steps = np.linalg.norm(np.diff(places, axis=0), axis=-1)
        advance = np.concatenate([np.zeros((min(1, len(places)), self.most)), np.nancumsum(steps, axis=0)])
        advance = np.where(np.isnan(places[..., 0]), np.nan, advance)
        return {"position": places, "advance": advance, "speed": _speeds(self.times, places, self._window)}

    @property
    def length(self) -> np.ndarray:
        """Total length of all cracks, shape (rows,)."""
        return super().data["sums"][:, 0]

    @property
    def dissipated(self) -> np.ndarray:
        """Energy of broken bonds, shape (rows,)."""
        return super().data["sums"][:, 1]

    def energy_release(self) -> float:
        """Energy spent per area of new crack: the energy of the bonds that broke, divided by the distance that all tips
        have travelled.

        Raises
        ------
        InputError
            No tip has advanced by a horizon yet.
        """
        distance = float(np.nansum(np.nanmax(self.data["advance"], axis=0, initial=0.0)))
        if not distance > self._horizon:
            raise InputError(
                "no crack has run yet", value=distance, limit=f"more than {self._horizon:.4g}", key="crack_tips"
            )
        return float(self.dissipated[-1] - self.dissipated[0]) / distance

    @property
    def recorded(self) -> Recorded:
        """The recorded data, independent of the run."""
        new = slice(self._written, None)
        rows = {name: values[new] for name, values in self.data.items()}
        labels = tuple(f"tip {number:g}" for number in self.points[:, 0])
        return Recorded(self.name, self.points, self.times[new], rows, labels=labels)

    @property
    def asked(self) -> Arrays:
        """Nothing: numbers of tips are no places."""
        return {}

    def forget(self) -> None:
        self._written = len(self.times)  # all rows are kept: advances and speeds depend on earlier ones

    # --- in a run ----------------------------------------------------------------------------------------------

    def begin(self, setup: Setup, parts: RunParts) -> RecordRequest:
        near = parts.near
        self._axes = [axis for axis, n in enumerate(near.lattice.whole.shape) if n > 1]
        if len(self._axes) != 2 or parts.breaking is None:
            raise InputError(
                "tips are found only in 2D, where bonds break",
                value=f"{near.model.title} in {near.lattice.dim}D",
                key="crack_tips",
                remedy="critical_stretch, fracture_energy; StressIntensity for cracks that stay as they are",
            )
        self._breaking: BreakableBonds = parts.breaking
        self._bonds, self._lattice, self.dt = parts.grid.engine.bonds, near.lattice, near.dt
        spacing = near.lattice.spacing
        offsets = parts.grid.engine.offsets[:, parts.grid.lead :][:, self._axes]
        self._horizon = int(np.abs(offsets).max()) * spacing
        self._threshold = saturated_damage(offsets) / 2
        fast = np.sqrt(self._breaking.law.p_modulus / self._breaking.law.density * near.strongest)
        self._window = _WINDOW * self._horizon / float(fast)
        self._reach = _JUMP * (self._horizon + float(fast) * self.every * near.dt)
        self.notes = []
        return RecordRequest(np.zeros(0, np.int64), (), self.every, stop=True)

    def restart(self, step: int, values: np.ndarray, forces: np.ndarray) -> None:
        self._written, self._latest = 0, self._nowhere
        self._begin_rows(self._none)
        self._append(np.array([step]), self._look())

    def rows(self, window: Window) -> Arrays:
        return self._look()  # the loop returns after each step that has a row

    def state(self) -> Arrays:
        return {"given": np.array([self._written]), **super().state()}

    def take(self, state: Arrays) -> None:
        super().take(state)
        self._written = int(state["given"][0])
        self._latest = reduce(_last_seen, state["places"], self._nowhere)
        self.now = self._found()

    def _found(self) -> CrackPaths:
        """Return the cracks as they are now."""
        lattice, breaking = self._lattice.whole, self._breaking
        damage = breaking.team.joined(self._lattice, breaking.damage)
        return breaking.team.first(
            None
            if damage is None  # the first process has it
            else find_cracks(
                np.squeeze(damage), lattice.lower[self._axes], lattice.spacing, self._threshold, self._horizon
            )
        )

    def _look(self) -> Arrays:
        """Return the row of the cracks as they are now."""
        cracks, breaking = self._found(), self._breaking
        places = self._nowhere.copy()
        free = [number for number in range(self.most) if np.isnan(self._latest[number]).all()]
        for tip, number in zip(cracks.tips, followed(self._latest, cracks.tips, self._reach), strict=True):
            if number < 0 and not free:
                self.notes = [f"{self.name} follows {self.most} tips, and there are more: most = {2 * self.most}"]
                continue
            places[free.pop(0) if number < 0 else number] = tip
        self.now = cracks
        self._latest = _last_seen(self._latest, places)
        broken = breaking.team.total({"energy": self._bonds.broken[0]})["energy"]
        return {"places": places[None], "sums": np.array([[cracks.length, breaking.near.mass * broken]])}


def _last_seen(last: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Return where each tip was last seen, from two consecutive records."""
    return np.where(np.isnan(present), last, present)


def _speeds(times: np.ndarray, places: np.ndarray, window: float) -> np.ndarray:
    """Return the distance between the position of each tip now and one window before, divided by the time between,
    where the tip existed at both times.

    The mean rate of its advance would be too large: where a crack splits, the end of its thinned line moves from side
    to side although the tip does not.
    """
    speeds = np.full(places.shape[:2], np.nan)
    for column in range(places.shape[1]):
        rows = np.flatnonzero(np.isfinite(places[:, column, 0]))
        before = np.searchsorted(times[rows], times[rows] - window * (1 - MARGIN), side="right") - 1
        now, earlier = rows[before >= 0], rows[before[before >= 0]]
        distances = np.linalg.norm(places[now, column] - places[earlier, column], axis=1)
        speeds[now, column] = distances / (times[now] - times[earlier])
    return speeds
