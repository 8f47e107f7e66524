"""Misfits: what the records of receivers cost, and the derivative of that by each record."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from farhorizon import kinds
from farhorizon.errors import InputError
from farhorizon.simulation.recorders.receivers import Receivers

#: Quantities whose misfit has a gradient: the field, and its rate half a step before.
RECORDS = ("u", "v")
Arrays = dict[str, np.ndarray]
_NEWTON = 12  # steps to the largest correlation: they converge quadratically from the nearest step of the run


class Misfit(ABC):
    """What the records of some receivers cost.

    Derive from this class, or use `OwnMisfit`, for a misfit of one's own.

    Parameters
    ----------
    receivers : Receivers
        They record "u", "v" or both.

    Raises
    ------
    InputError
        Something other than receivers, or receivers of other quantities.

    Examples
    --------
    >>> import farhorizon as fh
    >>> class LastValue(fh.Misfit):
    ...     def of(self, records, times):
    ...         slope = 0 * records["u"]
    ...         slope[-1] = records["u"][-1]
    ...         return float((records["u"][-1] ** 2).sum() / 2), {"u": slope}
    >>> bar = fh.Setup(fh.Lattice(1.0, -30, 30), fh.Wave(fh.Kernel(2.0)), initial={"u": "exp(-x**2/8)"})
    >>> found = fh.gradient(bar, LastValue(fh.Receivers([3.0])), "u", until=10.0)
    >>> found["u"].shape
    (61,)
    """

    def __init__(self, receivers: Receivers) -> None:
        self.receivers = kinds.instance(receivers, "misfit.receivers", Receivers, "Receivers")
        for name in receivers.record:
            kinds.one_of(name, "misfit.receivers.record", RECORDS, "this quantity has no gradient")

    @abstractmethod
    def of(self, records: Arrays, times: np.ndarray) -> tuple[float, Arrays]:
        """Return the misfit of records, and its derivative by each of them.

        Parameters
        ----------
        records : dict of str to ndarray
            As `Receivers.data`.
        times : ndarray, shape (rows,)
            As `Receivers.times`.

        Returns
        -------
        float
        dict of str to ndarray
            Of the shapes of the records.
        """

    def below(self, frequency: float) -> Misfit:
        """Return the same misfit of records and data whose frequencies above one are left out.

        Raises
        ------
        InputError
            Misfits other than least squares have no such form, unless their class defines it.
        """
        raise InputError(
            "this misfit cannot leave out high frequencies",
            value=type(self).__name__,
            limit="LeastSquares",
            key="frequencies",
            remedy="leave them out, or define `below` in its class",
        )

    def check(self, rows: int, components: int) -> None:  # noqa: B027
        """Refuse data that do not fit records of a number of rows.

        Raises
        ------
        InputError
        """


class DataMisfit(Misfit):
    """What the difference of records from data costs. `LeastSquares`, `Envelope` and `TravelTime` derive from it.

    Parameters
    ----------
    receivers : Receivers
    data : array_like, shape (rows, n) or (rows, n, dim), or mapping of str to such arrays
        What was measured at the steps of the run that the receivers record, as in `Receivers.data`: of "u" unless given
        by quantity.
    weights : float or array_like
        Not negative: a number, or anything that NumPy broadcasts to the data. Zeros leave values out.

    Raises
    ------
    InputError
        Data that are not numbers, weights that are negative, quantities that the receivers do not record. Before a run:
        data of another shape than the records.

    Examples
    --------
    >>> import farhorizon as fh
    >>> issubclass(fh.Envelope, fh.DataMisfit)
    True
    """

    def __init__(self, receivers: Receivers, data: Any, weights: Any = 1.0) -> None:
        super().__init__(receivers)
        given = data if isinstance(data, Mapping) else {"u": data}
        for name in given:
            kinds.one_of(name, "misfit.data", receivers.record, "the receivers do not record this quantity")
        self.data = {name: kinds.array(values, f"misfit.data.{name}") for name, values in given.items()}
        self.frequency: float | None = None
        self.weights = kinds.array(weights, "misfit.weights")
        if self.weights.min(initial=0) < 0:
            raise InputError(
                "a weight must not be negative", value=float(self.weights.min()), limit=">= 0", key="misfit.weights"
            )

    def check(self, rows: int, components: int) -> None:
        """Refuse data of another shape than the records."""
        points = len(self.receivers.points)
        shape = (rows, points) if components == 1 else (rows, points, components)
        for name, values in self.data.items():
            if values.shape != shape:
                raise InputError(
                    "the data do not have the shape of the records",
                    value=values.shape,
                    limit=shape,
                    key=f"misfit.data.{name}",
                    remedy="one row for each step that the receivers record, from t = 0 to the end of the run; "
                    "interpolate the data to these times",
                )
            try:
                np.broadcast_to(self.weights, shape)
            except ValueError:
                raise InputError(
                    "the weights do not fit the data",
                    value=self.weights.shape,
                    limit=shape,
                    key="misfit.weights",
                    remedy="a number, or an array that broadcasts to the data",
                ) from None

    def below(self, frequency: float) -> DataMisfit:
        """Return the same misfit of records and data whose frequencies above one are left out, smoothly, by the square
        of a Butterworth filter of fourth order, without a shift in time.
        """
        lower = copy.copy(self)
        lower.frequency = kinds.number(frequency, "frequency", above=0)
        return lower

    def of(self, records: Arrays, times: np.ndarray) -> tuple[float, Arrays]:
        """Return the misfit of records, and its derivative by each of them."""
        total, slopes = 0.0, {}
        for name, data in self.data.items():
            value, slope = self.cost(self._passed(records[name], times), self._passed(data, times), times)
            total += value
            slopes[name] = self._passed(slope, times)  # the filter is symmetric
        return total, slopes

    @abstractmethod
    def cost(self, values: np.ndarray, data: np.ndarray, times: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the misfit of one record from its data, and its derivative by the record; all arrays have the shape of
        the record.
        """

    def _passed(self, values: np.ndarray, times: np.ndarray) -> np.ndarray:
        if self.frequency is None or len(times) < 2:
            return values
        return _filtered(values, lambda f: 1 / (1 + (f / self.frequency) ** 8), times[1] - times[0])


class LeastSquares(DataMisfit):
    r"""Half the sum of the squared differences from data, :math:`\frac12 \sum W\,(u - d)^2`.

    Parameters
    ----------
    receivers : Receivers
    data : array_like, shape (rows, n) or (rows, n, dim), or mapping of str to such arrays
        What was measured at the steps of the run that the receivers record, as in `Receivers.data`: of "u" unless given
        by quantity.
    weights : float or array_like
        W, not negative: a number, or anything that NumPy broadcasts to the data. Zeros leave values out.

    Raises
    ------
    InputError
        Data that are not numbers, weights that are negative, quantities that the receivers do not record. Before a run:
        data of another shape than the records.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> line = fh.Receivers([[3.0]])
    >>> bar = fh.Setup(fh.Lattice(1.0, -30, 30), fh.Wave(fh.Kernel(2.0)), initial={"u": "exp(-x**2/8)"}, dt=0.5)
    >>> found = fh.gradient(bar, fh.LeastSquares(line, np.zeros((21, 1))), "u", until=10.0)
    >>> bool(found.misfit > 0), found["u"].shape
    (True, (61,))
    """

    def cost(self, values: np.ndarray, data: np.ndarray, times: np.ndarray) -> tuple[float, np.ndarray]:
        """Return half the weighted sum of squared differences, and its derivative."""
        residual = values - data
        return float((self.weights * residual**2).sum()) / 2, self.weights * residual


class Envelope(DataMisfit):
    r"""Half the sum of the squared differences of envelopes, :math:`\frac12 \sum W\,(E(u) - E(d))^2`.

    The envelope is the magnitude of the analytic signal, :math:`E(u)^2 = u^2 + (H u)^2` with the Hilbert transform H in
    time. It has no cycles that could be skipped: a first model may be off by more than half a period.

    Parameters
    ----------
    receivers : Receivers
    data : array_like, shape (rows, n) or (rows, n, dim), or mapping of str to such arrays
        As of `LeastSquares`.
    weights : float or array_like
        W, not negative: a number, or anything that NumPy broadcasts to the data.

    Raises
    ------
    InputError
        As of `LeastSquares`.

    References
    ----------
    Bozdag, E., Trampert, J., Tromp, J. (2011). Misfit functions for full waveform inversion based on instantaneous
    phase and envelope measurements. Geophysical Journal International 185, 845-870.

    Examples
    --------
    >>> import farhorizon as fh
    >>> import numpy as np
    >>> line = fh.Receivers([[3.0]])
    >>> bar = fh.Setup(fh.Lattice(1.0, -30, 30), fh.Wave(fh.Kernel(2.0)), initial={"u": "exp(-x**2/8)"}, dt=0.5)
    >>> found = fh.gradient(bar, fh.Envelope(line, np.zeros((21, 1))), "u", until=10.0)
    >>> bool(found.misfit > 0)
    True
    """

    def cost(self, values: np.ndarray, data: np.ndarray, times: np.ndarray) -> tuple[float, np.ndarray]:
        """Return half the weighted sum of squared differences of envelopes, and its derivative."""
        other, envelope = _hilbert(values), np.hypot(values, _hilbert(values))
        residual = envelope - np.hypot(data, _hilbert(data))
        slope = self.weights * residual / np.where(envelope > 0, envelope, np.inf)
        # the transpose of H is -H
        return float((self.weights * residual**2).sum()) / 2, slope * values - _hilbert(slope * other)


class TravelTime(DataMisfit):
    r"""Half the sum of the squared delays of the records, :math:`\frac12 \sum \tau^2`.

    The delay of a record, positive where it arrives later than its data, is the shift :math:`\tau` at which
    :math:`\sum_t u(t)\,d(t - \tau)` is largest, found between the steps. Records and data are multiplied by the
    weights before: a window in time picks one arrival. Records or data without any motion have no delay.

    Parameters
    ----------
    receivers : Receivers
    data : array_like, shape (rows, n) or (rows, n, dim), or mapping of str to such arrays
        As of `LeastSquares`.
    weights : float or array_like
        Windows, not negative: a number, or anything that NumPy broadcasts to the data.

    Raises
    ------
    InputError
        As of `LeastSquares`.

    References
    ----------
    Luo, Y., Schuster, G. T. (1991). Wave-equation traveltime inversion. Geophysics 56, 645-653.

    Examples
    --------
    >>> import farhorizon as fh
    >>> line = fh.Receivers([[9.0]])
    >>> def bar(speed, observe=()):
    ...     wave = fh.Wave(fh.Kernel(2.0), speed=speed)
    ...     return fh.Simulation(
    ...         fh.Lattice(1.0, -30, 30), wave, initial={"u": "exp(-x**2/8)"}, dt=0.5, observe=observe
    ...     )
    >>> _ = bar(1.0, [line]).run(until=20.0)
    >>> found = fh.gradient(bar(0.9), fh.TravelTime(line, line.data["u"]), "speed", until=20.0)
    >>> bool(found["speed"].sum() < 0)  # faster means less delay
    True
    """

    def cost(self, values: np.ndarray, data: np.ndarray, times: np.ndarray) -> tuple[float, np.ndarray]:
        """Return half the sum of squared delays, and its derivative."""
        rows, step = len(times), times[1] - times[0] if len(times) > 1 else 1.0
        window = np.broadcast_to(self.weights, values.shape).reshape(rows, -1)
        records, measured = values.reshape(rows, -1) * window, data.reshape(rows, -1) * window
        omega = 2 * np.pi * np.fft.rfftfreq(2 * rows, step)[:, None]
        omega[-1] = 0  # the largest frequency has no derivative between the steps
        spectrum = np.fft.rfft(records, 2 * rows, axis=0)
        of_data = np.fft.rfft(measured, 2 * rows, axis=0)
        both = spectrum * of_data.conj()
        lags = np.fft.irfft(both, axis=0).argmax(0)
        delay = np.where(lags < rows, lags, lags - 2 * rows) * step

        def correlated(power: int) -> np.ndarray:
            return np.fft.irfft((1j * omega) ** power * both * np.exp(1j * omega * delay), axis=0)[0]

        for _ in range(_NEWTON):
            bend = correlated(2)
            known = bend < 0
            move = np.where(known, -correlated(1) / np.where(known, bend, 1.0), 0.0)
            delay = delay + np.clip(move, -step, step)
        known = (correlated(2) < 0) & (np.abs(records).max(0) > 0)
        delay = np.where(known, delay, 0.0)
        shifted = np.fft.irfft(1j * omega * of_data * np.exp(-1j * omega * delay), axis=0)[:rows]
        slope = delay / np.where(known, correlated(2), 1.0) * shifted * window
        return float((delay**2).sum()) / 2, slope.reshape(values.shape)


class OwnMisfit(Misfit):
    """A misfit that a function computes.

    Parameters
    ----------
    receivers : Receivers
    function : callable
        Takes the records, a dict of arrays as `Receivers.data`, and their times; returns the misfit, and a dict of its
        derivatives by the records, of the same shapes. A quantity may be left out where the derivative is zero.

    Raises
    ------
    InputError
        Something that is not a function. After the run: results of another form.

    Examples
    --------
    >>> import farhorizon as fh
    >>> def energy(records, times):
    ...     return float((records["u"] ** 2).sum()), {"u": 2 * records["u"]}
    >>> bar = fh.Setup(fh.Lattice(1.0, -30, 30), fh.Wave(fh.Kernel(2.0)), initial={"u": "exp(-x**2/8)"})
    >>> found = fh.gradient(bar, fh.OwnMisfit(fh.Receivers([[3.0]]), energy), "speed", until=10.0)
    >>> bool(found.misfit > 0)
    True
    """

    def __init__(self, receivers: Receivers, function: Callable[[Arrays, np.ndarray], tuple[float, Arrays]]) -> None:
        super().__init__(receivers)
        self.function = kinds.function(function, "misfit.function", "records, times")

    def of(self, records: Arrays, times: np.ndarray) -> tuple[float, Arrays]:
        """Return the misfit of records, and its derivative by each of them."""
        value, slopes = self.function(records, times)
        derivatives = {}
        for name, slope in dict(slopes).items():
            kinds.one_of(name, "misfit.function", records, "the function returns a derivative by no record")
            derivatives[name] = kinds.array(slope, f"misfit.function.{name}", shape=records[name].shape)
        return kinds.number(value, "misfit.function"), derivatives


def _filtered(values: np.ndarray, gain: Callable[[np.ndarray], np.ndarray], step: float = 1.0) -> np.ndarray:
    """Multiply the spectra in time, axis 0, by a gain that depends on the frequency."""
    count = 2 * len(values)  # zeros behind, so that the end does not wrap around to the start
    factor = gain(np.fft.rfftfreq(count, step)).reshape(-1, *[1] * (values.ndim - 1))
    return np.fft.irfft(np.fft.rfft(values, count, axis=0) * factor, count, axis=0)[: len(values)]


def _hilbert(values: np.ndarray) -> np.ndarray:
    """Return the Hilbert transform in time, axis 0."""
    return _filtered(values, lambda f: np.where(f > 0, -1j, 0.0))
