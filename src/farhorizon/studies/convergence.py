"""Convergence under refinement: one computation at several spacings, with a fixed number of spacings per horizon."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from scipy.optimize import minimize_scalar

from farhorizon import kinds
from farhorizon.errors import InputError, shown
from farhorizon.pictures.curves import log_panels

_ROUNDING = 8 * float(np.finfo(float).eps)  # relative to the largest value
_ORDERS = np.linspace(0.1, 10.0, 100)  # orders among which the best fit is searched


class Refinable(Protocol):
    """A case file that has been read."""

    @property
    def end(self) -> float:
        """End of the run."""

    def refined(self, spacing: float) -> Refinable:
        """Return the same case at another spacing."""

    def run(self) -> Any:
        """Create a new run."""


@dataclass(frozen=True, eq=False)
class Convergence:
    """Values of a quantity at several spacings, and their limit.

    Attributes
    ----------
    spacings : ndarray, shape (n,)
        The largest first.
    values : ndarray, shape (n, ...)
    limit : ndarray, shape (...)
        The exact values or, where none are given, the fit at spacing 0.
    errors : ndarray, shape (n,)
        The largest difference from the limit.
    order : float
        Order of the error in the spacing.
    """

    spacings: np.ndarray
    values: np.ndarray
    limit: np.ndarray
    errors: np.ndarray
    order: float

    def __str__(self) -> str:
        rows = [f"{h:12.6g}  {e:12.4g}" for h, e in zip(self.spacings, self.errors, strict=True)]
        return "\n".join([f"{'spacing':>12}  {'error':>12}", *rows, f"order {self.order:.3g}"])

    def plot(self, path: str | Path) -> None:
        """Draw the error over the spacing, with the slope of the order, into a PNG file.

        Raises
        ------
        InputError
            There is no such directory.
        """
        curve = ("error", self.spacings, self.errors)
        log_panels([("", [curve])], path, xlabel="spacing", ylabel="error", order=self.order)


def convergence(
    case: Refinable | Callable[[float], Any],
    spacings: Sequence[float],
    quantity: Callable[[Any], Any],
    exact: Any = None,
) -> Convergence:
    """Compute one case at several spacings and fit the order of the error.

    With exact values, the order is the slope of the logarithm of the error over that of the spacing, by least squares.
    Without them, limit and order are those of ``q(h) = q(0) + C h^p``, fitted to all values, each with its own q(0) and
    C (Richardson extrapolation).

    Parameters
    ----------
    case : Case or callable
        A case file read by `read_case`, which is run to its end with the number of spacings per horizon that it has in
        the file; or a function that takes a spacing and returns the argument of `quantity`, such as a `Simulation` that
        has run.
    spacings : sequence of float
        Two or more; without exact values three or more.
    quantity : callable
        A function of the run that returns a number or an array, always of the same shape: fields at the same locations.
    exact : array_like, optional
        The exact value.

    Returns
    -------
    Convergence

    Raises
    ------
    InputError
        Too few spacings, or some that are not positive or appear twice; values of different shapes or not finite;
        values that are all exact, or, without exact values, that do not approach a limit. Anything that the case
        refuses at such a spacing.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> def swinging(spacing):
    ...     lattice = fh.Lattice(spacing, 0.0, 2 * np.pi - spacing)
    ...     sim = fh.Simulation(lattice, fh.Wave(fh.Kernel(2 * spacing)), fh.Periodic(), {"u": "cos(x)"}, threads=1)
    ...     _ = sim.run(round(1.0 / sim.dt) * sim.dt, progress=False)
    ...     return sim
    >>> found = fh.convergence(
    ...     swinging, 2 * np.pi / np.array([32, 64, 128]), lambda sim: sim.fields["u"][0] - np.cos(sim.time), exact=0.0
    ... )
    >>> round(found.order, 1)
    2.0
    """
    sizes = np.sort(kinds.array(spacings, "spacings", shape=(None,)))[::-1]
    least = 2 if exact is not None else 3
    if len(sizes) < least or sizes[-1] <= 0 or (np.diff(sizes) == 0).any():
        raise InputError(
            "an order is found from different positive spacings",
            value=shown(sizes),
            limit=f"{least} or more",
            key="spacings",
            remedy="more spacings" if exact is not None else "more spacings, or exact values",
        )
    compute = case if hasattr(case, "refined") else kinds.function(case, "case", "the spacing")
    measure = kinds.function(quantity, "quantity", "the run")
    measured = [kinds.array(measure(_computed(compute, float(h))), "quantity") for h in sizes]
    known = None if exact is None else kinds.array(exact, "exact")
    shapes = {values.shape for values in measured} | ({known.shape} if known is not None and known.ndim else set())
    if len(shapes) > 1:
        raise InputError(
            "the quantity must be of one shape at all spacings, and that of the exact values",
            value=[values.shape for values in measured],
            key="quantity",
            remedy="the field at the same places, as of Receivers",
        )
    values = np.stack(measured)
    limit, order = _fitted(sizes, values) if known is None else (np.broadcast_to(known, values.shape[1:]), 0.0)
    errors = np.abs(values - limit).reshape(len(sizes), -1).max(axis=1)
    if (errors <= _ROUNDING * np.abs(values).max()).any():
        raise InputError("no order follows from values without any error", value=shown(errors), key="quantity")
    if known is not None:
        order = float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])
    return Convergence(sizes, values, np.asarray(limit), errors, order)


def _computed(case: Refinable | Callable[[float], Any], spacing: float) -> Any:
    if callable(case):
        return case(spacing)
    finer = case.refined(spacing)
    run = finer.run()
    run.run(finer.end, progress=False)
    return run


def _fitted(spacings: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, float]:
    """Limit and order of ``q(0) + C h^p``, fitted by least squares."""
    flat, scaled = values.reshape(len(values), -1), spacings / spacings[0]

    def solved(order: float) -> tuple[np.ndarray, float]:
        table = np.stack([np.ones(len(scaled)), scaled**order], axis=1)
        fit = np.linalg.lstsq(table, flat, rcond=None)[0]
        return fit[0], float(((table @ fit - flat) ** 2).sum())

    left = [solved(order)[1] for order in _ORDERS]
    best = int(np.argmin(left))
    if best in (0, len(_ORDERS) - 1):
        raise InputError(
            "the values come no nearer to a limit by a power of the spacing",
            value=shown(flat[:, 0]),
            limit=f"orders between {_ORDERS[0]:g} and {_ORDERS[-1]:g}",
            key="quantity",
            remedy="finer spacings, or exact values",
        )
    ends = _ORDERS[best - 1], _ORDERS[best + 1]
    order = float(minimize_scalar(lambda p: solved(p)[1], bounds=ends, method="bounded", options={"xatol": 1e-9}).x)
    return solved(order)[0].reshape(values.shape[1:]), order
