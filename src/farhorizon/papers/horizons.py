"""Studies of nonlocal models: a measured number as a function of the horizon and of the number of nodes in it.

m-convergence: the horizon is fixed and the number m of nodes in it increases; delta-convergence: m is fixed and the
horizon decreases.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from farhorizon import InputError


@dataclass(frozen=True)
class Study:
    """Values (H, M) as a function of the horizon (H,) and of the number of nodes in it (M,)."""

    horizons: np.ndarray
    ratios: np.ndarray
    values: np.ndarray

    def increments(self) -> np.ndarray:
        """Change by each refinement at the same horizon, shape (H, M - 1): in m-convergence it tends to zero
        geometrically.
        """
        return np.diff(self.values, axis=1)

    def rates(self, last: int | None = None) -> np.ndarray:
        """Slope of the logarithm of the values over that of the horizon for each m, by least squares, shape (M,), over
        the `last` horizons (all unless given). InputError for values that are not positive.
        """
        first = 0 if last is None else max(0, len(self.horizons) - last)
        horizons, values = self.horizons[first:], self.values[first:]
        _need_two(horizons, "a rate")
        if (values <= 0).any():
            raise InputError(
                "a rate needs positive values",
                value=values.min(),
                limit="> 0",
                key="study",
                remedy="study an error, not a value",
            )
        return np.polyfit(np.log(horizons), np.log(values), 1)[0]

    def crossing(self) -> tuple[float, float]:
        """The number of nodes m* at which the curves over log m of the last two horizons cross, and the value there;
        nan if they do not cross.
        """
        _need_two(self.horizons, "a crossing")
        coarse, fine = self.values[-2:]
        place = np.log(self.ratios)
        gap = coarse - fine
        for i in range(len(gap)):
            if gap[i] == 0:
                return float(self.ratios[i]), float(fine[i])
            if i and gap[i - 1] * gap[i] < 0:
                fraction = gap[i - 1] / (gap[i - 1] - gap[i])
                at = place[i - 1] + fraction * (place[i] - place[i - 1])
                return float(np.exp(at)), float(np.interp(at, place, fine))
        return np.nan, np.nan


def _need_two(horizons: np.ndarray, what: str) -> None:
    """Refuse a study of fewer than two horizons."""
    if len(horizons) < 2:
        raise InputError(
            f"{what} needs two horizons",
            value=len(horizons),
            limit="2 or more",
            key="study",
            remedy="study more horizons",
        )


def over_horizons(
    measure: Callable[[float, int], dict[str, float]],
    horizons: Sequence[float],
    ratios: Sequence[int],
    workers: int | None = None,
) -> dict[str, Study]:
    """Measure numbers by name for all combinations of horizons and numbers m of nodes in the horizon, several at a
    time: in threads, of which there is one for each core unless given, because the compiled loop releases the
    interpreter lock. Simulations in `measure` should use one thread.
    """
    if not len(horizons) or not len(ratios) or min(horizons) <= 0 or min(ratios) < 1:
        raise InputError(
            "a study needs positive horizons and at least one node in each",
            value=(list(horizons), list(ratios)),
            key="study",
        )
    cells = [(h, m) for h in horizons for m in ratios]
    # start with the finest grid, so that no worker is left alone with it at the end
    cost = sorted(range(len(cells)), key=lambda i: cells[i][0] / cells[i][1])
    measured: list[dict[str, Any]] = [{}] * len(cells)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    with ThreadPoolExecutor(workers or cores) as pool:
        for i, result in zip(cost, pool.map(lambda i: measure(*cells[i]), cost), strict=True):
            measured[i] = result
    shape = len(horizons), len(ratios)
    return {
        name: Study(
            np.asarray(horizons, float),
            np.asarray(ratios, int),
            np.array([f[name] for f in measured], float).reshape(shape),
        )
        for name in measured[0]
    }
