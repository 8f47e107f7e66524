"""Behaviour of the command line when several processes were started together, by mpiexec or srun."""

from __future__ import annotations

import argparse
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout, suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from farhorizon.simulation.processes.process_group import ProcessGroup

#: Environment variables in which launchers tell each process how many there are, and its number.
_COUNTS = "PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "MPI_LOCALNRANKS", "PMIX_SIZE", "SLURM_STEP_NUM_TASKS"
_NUMBERS = "PMI_RANK", "OMPI_COMM_WORLD_RANK", "PMIX_RANK", "SLURM_PROCID"


def started() -> int:
    """Number of processes that were started together."""
    return max((_number_in(name) for name in _COUNTS), default=1)


def _number_in(name: str) -> int:
    """Number in an environment variable; 0 if it has none."""
    text = os.environ.get(name, "")
    return int(text) if text.isdecimal() else 0


@contextmanager
def silence() -> Iterator[None]:
    """Context in which everything printed is discarded."""
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        yield


def first_process_prints() -> Any:
    """Context in which only the first process prints."""
    return silence() if started() > 1 and any(map(_number_in, _NUMBERS)) else nullcontext()


def refuse_processes() -> None:
    """Refuse to be one of several processes: each would compute the complete case, into the same files."""
    from farhorizon.errors import InputError

    if started() > 1:
        raise InputError(
            "this command computes on one process: each of these would compute the whole",
            value=f"{started()} processes",
            key="mpiexec",
            remedy="without mpiexec; 'farhorizon run' computes on all of them together",
        )


def communicator() -> Any:
    """Communicator of all processes that were started together, None if there is only one; InputError if mpi4py is
    missing, or does not see the other processes.
    """
    from farhorizon.errors import InputError

    count = started()
    if count <= 1:
        return None
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:  # RuntimeError: it finds no MPI library
        raise InputError(
            f"mpi4py is missing, without which each process would compute the whole case ({error})",
            value=f"{count} processes",
            key="mpiexec",
            remedy="python -m pip install 'farhorizon[mpi]', or without mpiexec",
        ) from None
    if MPI.COMM_WORLD.Get_size() == 1:
        raise InputError(
            "mpi4py uses another MPI than the one that started the processes: each would compute the whole",
            value=f"{count} processes, of which mpi4py sees one",
            limit=MPI.Get_library_version().splitlines()[0].strip("\0 "),
            key="mpiexec",
            remedy="the mpiexec of this MPI, or MPI4PY_LIBMPI=PATH of the library of that mpiexec",
        )
    return MPI.COMM_WORLD


def all_processes() -> ProcessGroup:
    """All processes that were started together; raises as `communicator` does."""
    from farhorizon.simulation.processes.process_group import ProcessGroup

    return ProcessGroup(communicator())


def _pass_on(error: BaseException) -> None:
    """Report an error that came before this process knew of the others, which may wait for it when they do."""
    if started() > 1 and isinstance(error, Exception):
        with suppress(Exception):  # there is no mpi4py; or another process fails, too
            with all_processes().agreed():
                raise error


def pass_on_refusal(arguments: Sequence[str]) -> None:
    """Report that the parser has refused the arguments of this process, to others that wait for it."""
    from farhorizon.errors import InputError

    remedy = "the same command on all processes; this one by itself says what is wrong"
    _pass_on(InputError("a process was given another command line", value=" ".join(arguments), remedy=remedy))


def end_all(options: argparse.Namespace | None, error: BaseException, report: Callable[[], int]) -> None:
    """If this process failed alone among several, report it and end them all: they would wait for it for ever."""
    processes: ProcessGroup | None = getattr(options, "team", None)
    if processes is None:
        _pass_on(error)
        return

    def reported() -> int:
        with redirect_stderr(sys.__stderr__):
            try:
                return report()
            except Exception:
                traceback.print_exc()
        return 1

    processes.end_all(error, reported)
