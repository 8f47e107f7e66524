"""Resources of the machine: threads, memory, garbage collection, interrupts, and a progress bar."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from threadpoolctl import ThreadpoolController

from farhorizon.errors import InputError

_FEW = 2**24  # bytes up to which what is available is not asked for, which takes longer than setting up a small run


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Run small dense linear algebra on one thread: matrices of a few hundred rows gain nothing from more threads, and
    can take a hundred times as long when cores are busy.
    """
    with _blas("scipy.linalg" in sys.modules).limit(limits=1, user_api="blas"):
        yield


@cache
def _blas(of_scipy: bool) -> ThreadpoolController:
    """The libraries of linear algebra in the process: NumPy's, and SciPy's if it has been loaded."""
    return ThreadpoolController()


@contextmanager
def without_collection() -> Iterator[None]:
    """Switch off garbage collection: where many lasting objects are created, as when modules are loaded or functions
    are compiled, a seventh of the time is spent on collections that find nothing.
    """
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            gc.enable()


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold Ctrl-C back until the context ends, where it then raises the KeyboardInterrupt. Python raises it as soon as
    compiled code returns, and thus between a change of a state and the note that it has been made. A second one acts at
    once.

    Applies where Python handles the signal itself, in the main thread; other handlers do as they were told to.
    """
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    came: list[int] = []

    def hold(number: int, frame: Any) -> None:
        if came:
            raise KeyboardInterrupt
        came.append(number)

    signal.signal(signal.SIGINT, hold)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if came:
            raise KeyboardInterrupt


def available_memory() -> int:
    """Bytes of memory that this process may still take: the least of what the machine has available (all of its memory
    if that is unknown), what each of its control groups leaves (those of a container, a service or a job), what its
    own limits leave (`ulimit -v` and `-d`), and what Slurm has granted on this machine.
    """
    return max(0, min([_of_machine(), *_left_by_groups(), *_left_by_limits(), *_granted_by_slurm()]))


def check_fits(need: float, what: str, key: str, remedy: str, size: str = "") -> None:
    """Refuse something that needs more bytes than `available_memory`, before they are asked for, with an InputError;
    `what` is it and a verb, such as "the run does", and `size` what its size is due to.
    """
    if need <= _FEW or need <= (most := available_memory()):
        return
    raise InputError(
        f"{what} not fit into memory",
        value=" for ".join(filter(None, (f"about {need / 2**30:.3g} GiB", size))),
        limit=f"{most / 2**30:.3g} GiB available",
        key=key,
        remedy=remedy,
    )


def _of_machine() -> int:
    available = _numbers_in(Path("/proc/meminfo")).get("MemAvailable:")
    if available is not None:
        return 1024 * available
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 1 << 62


def _numbers_in(path: Path) -> dict[str, int]:
    """Return the numbers that follow the first word of each line of a file, by that word; none if it cannot be read."""
    try:
        rows = [line.split() for line in path.read_text().splitlines()]
    except (OSError, ValueError):
        return {}
    return {row[0]: int(row[1]) for row in rows if len(row) > 1 and row[1].isdecimal()}


def _number_in(path: Path) -> int | None:
    """Return the number that a file consists of; None if it cannot be read, or holds a word such as `max`."""
    try:
        text = path.read_text().strip()
    except (OSError, ValueError):
        return None
    return int(text) if text.isdecimal() else None


def _left_by_groups(process: Path = Path("/proc/self")) -> Iterator[int]:
    """Yield what the memory controllers of Linux leave: those of the groups of a process and of all groups around
    them, of both versions. Pages of files that are not in use count as free, because the kernel drops them first.
    """
    try:
        mounts = [line.split() for line in (process / "mountinfo").read_text().splitlines()]
        groups = [line.split(":", 2) for line in (process / "cgroup").read_text().splitlines()]
    except (OSError, ValueError):
        return
    for mount in mounts:
        version, options = mount[mount.index("-") + 1], mount[-1].split(",")
        if version == "cgroup2":
            controller, limit, used, cached = "", "memory.max", "memory.current", "inactive_file"
        elif version == "cgroup" and "memory" in options:
            controller, limit, used, cached = (
                "memory",
                "memory.limit_in_bytes",
                "memory.usage_in_bytes",
                "total_inactive_file",
            )
        else:
            continue
        top = Path(mount[4])
        paths = [Path(path) for _, names, path in groups if controller in names.split(",")]
        for path in paths:
            # a container may see only its own group, mounted at the top, under a path of the machine
            below = path.relative_to(mount[3]) if path.is_relative_to(mount[3]) else Path()
            for folder in (top / below, *(top / parent for parent in below.parents)):
                most, taken = _number_in(folder / limit), _number_in(folder / used)
                if most is not None and taken is not None:
                    yield most - taken + _numbers_in(folder / "memory.stat").get(cached, 0)


def _left_by_limits() -> Iterator[int]:
    """Yield what the limits of the process on its address space and its data leave."""
    try:
        import resource

        pages = [int(n) for n in Path("/proc/self/statm").read_text().split()]
    except (ImportError, OSError, ValueError):  # not Linux
        return
    for limit, taken in ((resource.RLIMIT_AS, pages[0]), (resource.RLIMIT_DATA, pages[5])):
        most = resource.getrlimit(limit)[0]
        if most != resource.RLIM_INFINITY:
            yield most - taken * resource.getpagesize()


def _granted_by_slurm() -> Iterator[int]:
    """Yield the memory that a job has on this machine, less what this process has taken: Slurm may end a job that takes
    more, also where no control group keeps it from doing so. The variables are in MiB; 0 stands for all memory.
    """
    granted = {name: os.environ.get(f"SLURM_{name}", "") for name in ("MEM_PER_NODE", "MEM_PER_CPU", "CPUS_ON_NODE")}
    amounts = {name: int(text) for name, text in granted.items() if text.isdecimal()}
    granted_here = amounts.get("MEM_PER_NODE", 0) or amounts.get("MEM_PER_CPU", 0) * amounts.get("CPUS_ON_NODE", 1)
    if granted_here:
        yield 2**20 * granted_here - 1024 * _numbers_in(Path("/proc/self/status")).get("VmRSS:", 0)


def progress(total: float | None = None, unit: str = "step", show: bool | None = None, **look: Any) -> Any:
    """A progress bar of `total` units on stderr, which disappears when it is closed; shown by default if stderr is a
    terminal. `look` is passed to `tqdm`.
    """
    from tqdm import tqdm

    return tqdm(
        total=total, unit=unit, leave=False, disable=not (sys.stderr.isatty() if show is None else show), **look
    )
