"""The processes that compute one run together, and their communication outside the compiled loop."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np

from farhorizon import errors
from farhorizon.engine.exchange import Link
from farhorizon.errors import InputError, shown
from farhorizon.geometry.lattice import Lattice
from farhorizon.simulation.setup.digests import digest_of

T = TypeVar("T")
E = TypeVar("E", bound=BaseException)
_POLLS = 2000  # for the other processes, before a waiting one sleeps between polls
_NAP = 5e-4  # seconds of such a sleep
_WIDTH = 60  # characters of a value in a message that shows two of them on a line
_PARTING = 2.0  # seconds for which a process that ends waits for the others; then MPI does, as at any end
_HEAD_START = 1.0  # seconds in which the first process reports an error that all have met at once


class _Failure:
    """An error on one process, as reported to all others."""

    def __init__(self, error: BaseException) -> None:
        self.kind, self.text = type(error).__name__, str(error)
        self.system = (error.errno, error.strerror, error.filename) if isinstance(error, OSError) else None

    def error(self) -> BaseException:
        """Return the same error for another process, which need not report it."""
        if self.system is not None:
            return agreed(OSError(*self.system), told=True)
        kind = getattr(errors, self.kind, None)
        return agreed(RuntimeError(f"{self.kind}: {self.text}") if kind is None else kind(self.text), told=True)


def agreed(error: E, told: bool = False) -> E:
    """Mark an error as one that all processes of a run raise, and that another one reports if `told`."""
    error.agreed, error.told = True, told  # type: ignore[attr-defined]
    return error


class ProcessGroup:
    """The processes of an MPI communicator.

    All of them make the same calls in the same order. A process that fails reports this in the next call, which then
    fails on all of them with the same error, so that none waits for ever; so does a call in which they do not all take
    part. An error that leaves the program of one process, outside these calls, ends all of them.

    Parameters
    ----------
    communicator : mpi4py.MPI.Intracomm or None
        Duplicated, once for the same processes, so that no other messages mix with those of runs; None for a single
        process.

    Attributes
    ----------
    number, size : int
        Rank of this process, and how many there are.

    Raises
    ------
    InputError
        Not a communicator, or processes with different versions.
    """

    def __init__(self, communicator: Any = None) -> None:
        self._communicator = None
        self._ended: list[int] = []  # ranks of processes that take no part any more
        self.number, self.size = 0, 1
        if communicator is None:
            return
        for name in ("Get_rank", "Get_size", "Dup", "allgather"):
            if not hasattr(communicator, name):
                raise InputError(
                    "must be a communicator of mpi4py",
                    value=type(communicator).__name__,
                    key="communicator",
                    remedy="from mpi4py import MPI; MPI.COMM_WORLD",
                )
        self.number, self.size = int(communicator.Get_rank()), int(communicator.Get_size())
        if self.size > 1:
            known = next((group for group in _GROUPS if _of_the_same(communicator, group._communicator)), None)
            self._communicator = communicator.Dup() if known is None else known._communicator
            if known is None:
                _end_together(self)
            else:
                self._ended = known._ended
            self._check_versions()

    @classmethod
    def of(cls, communicator: Any) -> ProcessGroup:
        """Return the processes of a communicator; a group is returned as it is."""
        return communicator if isinstance(communicator, ProcessGroup) else cls(communicator)

    def __bool__(self) -> bool:
        """Whether there are other processes."""
        return self.size > 1

    def _check_versions(self) -> None:
        import numba

        from farhorizon import __version__

        versions = self.gather({"farhorizon": __version__, "numpy": np.__version__, "numba": numba.__version__})
        for number, installed in enumerate(versions):
            if installed != versions[0]:
                raise self._refusal(
                    "the processes run different versions",
                    value=f"process {number}: {installed}",
                    limit=f"process 0: {versions[0]}",
                    key="communicator",
                    remedy="one environment on all machines",
                )

    def _refusal(self, message: str, **words: str) -> InputError:
        """Return an error that all processes raise at once, and that the first one reports."""
        return agreed(InputError(message, **words), told=self.number > 0)

    def alone(self, what: str, key: str = "communicator") -> None:
        """Refuse, with InputError, something that several processes cannot do together yet."""
        if self:
            raise InputError(f"{what} are not for several processes yet", key=key, remedy="one process")

    def alike(self, given: Mapping[str, Any]) -> None:
        """Refuse, with InputError, values that differ between processes: values by their keys in messages; the entries
        of mappings and tuples are compared one by one.
        """
        if self._communicator is None:
            return
        values = dict(_entries(given))
        digests = self.gather({key: digest_of(value) for key, value in values.items()})
        first = digests[0]
        for number, digest in enumerate(digests):
            key = next((key for key in {**first, **digest} if digest.get(key) != first.get(key)), None)
            if key is not None:
                words = self.gather(" ".join(shown(values[key]).split())[:_WIDTH] if key in values else "nothing")
                same = words[number] == words[0]
                raise self._refusal(
                    "the processes were given different values",
                    value=f"process {number}: {'another one' if same else words[number]}",
                    limit=f"process 0: {words[0]}",
                    key=key,
                    remedy="the same on all processes; files on a file system that all machines share",
                )

    # --- communication ------------------------------------------------------------------------------------------

    def gather(self, value: Any, numbers: tuple[int, ...] = ()) -> list[Any]:
        """Return the values of all processes, in order.

        Raises the error with which one of them has failed, or InputError if they call it from different places or with
        different `numbers`, which describe what they do next.
        """
        if self._communicator is None:
            return [value]
        calls = self._exchanged((_place(), numbers, value))
        failure = next((call for call in calls if isinstance(call, _Failure)), None)
        if failure is not None:
            raise failure.error()
        for number, (*call, _) in enumerate(calls):
            if call != [*calls[0][:2]]:
                words = [f"{place} {list(said) if said else ''}".rstrip() for place, said, _ in calls]
                raise self._refusal(
                    "the processes no longer do the same",
                    value=f"process {number}: {words[number]}",
                    limit=f"process 0: {words[0]}",
                    key="communicator",
                    remedy="call the methods of a run on all processes, with the same arguments, also in observers",
                )
        return [gathered for _, _, gathered in calls]

    def _exchanged(self, value: Any) -> list[Any]:
        """Return the values of all processes; while one of them works for long, the others leave it the processor."""
        assert self._communicator is not None
        self._check_present()
        ended, polls = np.zeros(self.size, np.uint8), 0
        request = self._communicator.Iallgather(np.zeros(1, np.uint8), ended)
        while not request.Test():
            polls += 1
            if polls > _POLLS:
                time.sleep(_NAP)
        self._ended += np.flatnonzero(ended).tolist()
        self._check_present()
        return list(self._communicator.allgather(value))

    def _check_present(self) -> None:
        if self._ended:
            told = self.number != next(number for number in range(self.size) if number not in self._ended)
            raise agreed(
                InputError(
                    "a process has ended before the others",
                    value=f"process {self._ended[0]}",
                    key="communicator",
                    remedy="the same calls on all processes, until all end",
                ),
                told,
            )

    def _leave(self) -> Any:
        """Let the others know, once they wait for it, that this process has ended; return the request, if any."""
        if self._communicator is None or self._ended:
            return None
        return self._communicator.Iallgather(np.ones(1, np.uint8), np.zeros(self.size, np.uint8))

    @contextmanager
    def agreed(self) -> Iterator[None]:
        """Context in which an error on one process is raised on all."""
        try:
            yield
        except (Exception, SystemExit) as error:
            if self.knows(error):
                raise
            calls = self._exchanged(_Failure(error))
            failed = next(number for number, call in enumerate(calls) if isinstance(call, _Failure))
            if failed != self.number:
                raise calls[failed].error() from None
            raise agreed(error) from None
        self.gather(None)

    def knows(self, error: BaseException) -> bool:
        """Whether all processes know of an error."""
        return self._communicator is None or getattr(error, "agreed", False)

    def by_first(self, work: Callable[[], T]) -> T | None:
        """Return the result of `work` on the first process, for which the others wait, and None on these; its errors
        are raised on all.
        """
        result: T | None = None
        with self.agreed():
            if self.number == 0:
                result = work()
        return result

    def first(self, value: Any) -> Any:
        """Return the value of the first process."""
        return value if self._communicator is None else self.gather(value if self.number == 0 else None)[0]

    def any(self, condition: bool) -> bool:
        """Whether it is true on any process."""
        return any(self.gather(condition))

    def largest(self, value: float) -> float:
        """Return the largest value of all processes."""
        return max(self.gather(value))

    def total(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the sums over all processes, added in their order."""
        parts = self.gather(dict(values))
        names = dict.fromkeys(name for part in parts for name in part)  # a support may end at one process
        return {name: sum(part.get(name, 0.0) for part in parts) for name in names}

    def summed(self, values: np.ndarray) -> np.ndarray:
        """Return, on all processes, the sum of arrays of equal shape."""
        if self._communicator is None:
            return values
        self.gather(None, values.shape)  # a process that has failed makes no further calls
        sums = np.empty_like(values)
        self._communicator.Allreduce(np.ascontiguousarray(values), sums)
        return sums

    def completed(self, values: np.ndarray, which: np.ndarray, count: int, axis: int) -> np.ndarray:
        """Return, on all processes, sums at `count` places along an axis; this process has values at the places
        `which`.
        """
        if self._communicator is None:
            return values
        sums = np.zeros((*values.shape[:axis], count, *values.shape[axis + 1 :]))
        np.moveaxis(sums, axis, 0)[which] = np.moveaxis(values, axis, 0)
        return self.summed(sums) if count else sums

    def joined(self, lattice: Lattice, field: np.ndarray) -> np.ndarray | None:
        """Return a field (whose last axes are those of the lattice) on the whole lattice, joined on the first process;
        None on the others.
        """
        parts: list[tuple[Any, np.ndarray]] | None = [(lattice.first, field)]
        if self._communicator is not None:
            self.gather(None)  # a process that has failed makes no further calls
            parts = self._communicator.gather((lattice.first, field))
        if parts is None:
            return None
        joined = np.zeros((*field.shape[: -lattice.dim], *lattice.whole.shape), field.dtype)
        for first, part in parts:
            box = tuple(slice(a, a + n) for a, n in zip(first, part.shape[-lattice.dim :], strict=True))
            place: tuple[Any, ...] = (..., *box)
            joined[place] = part
        return joined

    def all_to_all(self, values: Sequence[Any]) -> list[Any]:
        """Return what each process has for this one, given what this one has for each."""
        if self._communicator is None:
            return list(values)
        self.gather(None)  # a process that has failed makes no further calls
        return list(self._communicator.alltoall(values))

    def halos(
        self, values: np.ndarray, axis: int, width: int, below: int, above: int
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Return the next `width` layers of values along an axis, before the first and after the last one here, from
        the neighbours with these ranks; None where there is none (-1). A neighbour may be this process: then the axis
        repeats itself, if need be several times.
        """
        lowest, highest = (np.take(values, ends, axis, mode="wrap") for ends in (range(width), range(-width, 0)))
        return self._shifted(highest, above, below), self._shifted(lowest, below, above)

    def _shifted(self, value: Any, to: int, of: int) -> Any:
        """Return the value that the process `of` sends to this one, while this one sends `value` to the process `to`;
        -1 stands for no process.
        """
        if self._communicator is None:
            return None if of < 0 else value
        from mpi4py import MPI

        self.gather(None)  # a process that has failed makes no further calls
        dest, source = (MPI.PROC_NULL if number < 0 else number for number in (to, of))
        return self._communicator.sendrecv(value, dest=dest, source=source)

    def end_all(self, error: BaseException, report: Callable[[], int]) -> None:
        """If this process has failed alone, end all, which would wait for it for ever, with the exit code that `report`
        returns after it has reported the error.
        """
        if self.knows(error):
            return
        if self.number:
            time.sleep(_HEAD_START)
        code = 1
        try:
            code = report()
        finally:
            sys.stderr.flush()
            assert self._communicator is not None
            self._communicator.Abort(code)

    # --- for compiled code ----------------------------------------------------------------------------------------

    @property
    def link(self) -> Link:
        """Addresses and handles by which compiled code communicates with the other processes."""
        if self._communicator is None:
            return Link((0, 0, 0, 0), 0, 0, False, 0)
        from mpi4py import MPI

        # compiled code checks no error codes: after an error it would wait for ever
        self._communicator.Set_errhandler(MPI.ERRORS_ARE_FATAL)
        library = ctypes.CDLL(MPI.__file__)
        sends, receives, waits, tests = (
            int(ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0)
            for name in ("MPI_Isend", "MPI_Irecv", "MPI_Waitall", "MPI_Testall")
        )
        functions = sends, receives, waits, tests
        handles = _handle(self._communicator), _handle(MPI.BYTE)
        return Link(functions, *handles, _wide(), self.number, lambda numbers: self.gather(None, numbers))

    def threads(self) -> int:
        """Return the number of threads for each process unless one is given: those of its machine, divided among the
        processes that may run on the same processors.
        """
        from farhorizon.engine.engine import available_threads

        if self._communicator is None:
            return available_threads()
        import platform

        cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
        processors = platform.node(), tuple(cores)
        return max(1, available_threads() // self.gather(processors).count(processors))


#: The group of a single process.
ALONE = ProcessGroup()


def _entries(given: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield values by their keys, those in mappings and tuples one by one."""
    for key, value in given.items():
        if isinstance(value, Mapping):
            yield from ((f"{key}.{name}", entry) for name, entry in value.items())
        elif isinstance(value, tuple):
            yield from ((f"{key}[{i}]", entry) for i, entry in enumerate(value))
        else:
            yield key, value


def _place() -> str:
    """Return what the program has called in the package, and from which line of this a group was called."""
    frame, outer, inner = sys._getframe(1), "", ""
    while frame is not None:
        code, module = frame.f_code, str(frame.f_globals.get("__name__", ""))
        if module.partition(".")[0] == "farhorizon":
            outer = code.co_qualname
            if not inner and module != __name__:
                inner = f" ({code.co_name}, line {frame.f_lineno})"
        elif code.co_filename != contextlib.__file__:
            break
        frame = frame.f_back  # type: ignore[assignment]
    return outer + inner


def _of_the_same(communicator: Any, other: Any) -> bool:
    """Whether two communicators are those of the same processes in the same order."""
    from mpi4py import MPI

    return bool(MPI.Comm.Compare(communicator, other) in (MPI.IDENT, MPI.CONGRUENT))


_GROUPS: list[ProcessGroup] = []  # of several processes, in the order in which all of them were made


def _end_together(group: ProcessGroup) -> None:
    """From now on, let an error that no part of a program has handled end all processes of the latest group, reported
    once, by the process that has met it; and let a process that has ended be missed by those that wait for it.
    """
    _GROUPS.append(group)
    if len(_GROUPS) > 1:
        return
    show = sys.excepthook

    def hook(kind: type[BaseException], error: BaseException, trace: Any) -> None:
        def report() -> int:
            show(kind, error, trace)
            return 130 if kind is KeyboardInterrupt else 1 + isinstance(error, InputError)  # the command line's codes

        if not getattr(error, "told", False):
            _GROUPS[-1].end_all(error, report)
            report()

    sys.excepthook = hook
    atexit.register(_part)


def _part() -> None:
    """Leave all groups, and wait a moment until the others have noticed."""
    requests = [request for group in _GROUPS if (request := group._leave()) is not None]
    start = time.monotonic()
    while not all([request.Test() for request in requests]) and time.monotonic() - start < _PARTING:
        time.sleep(_NAP)


def _wide() -> bool:
    """Whether handles of this MPI are pointers instead of integers of four bytes."""
    from mpi4py import MPI

    return int(MPI._sizeof(MPI.Comm)) == 8


def _handle(of: Any) -> int:
    """Return the handle of a communicator or a data type as a number."""
    from mpi4py import MPI

    kind = ctypes.c_void_p if _wide() else ctypes.c_int
    return int(kind.from_address(MPI._addressof(of)).value or 0)
