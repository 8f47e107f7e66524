"""Resources of the machine: threads, memory, garbage collection, interrupts, and a progress bar."""

from __future__ import annotations

import ctypes
import gc
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

_SET = (
    "openblas_set_num_threads",
    "openblas_set_num_threads64_",
    "scipy_openblas_set_num_threads",
    "scipy_openblas_set_num_threads64_",
)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Run small dense linear algebra on one thread: matrices of a few hundred rows gain nothing from more threads, and
    can take a hundred times as long when cores are busy.

    Applies to every OpenBLAS library that the process has loaded, where the operating system lists them (Linux);
    elsewhere it does nothing.
    """
    libraries = [(set_threads, count()) for set_threads, count in _openblas("scipy.linalg" in sys.modules)]
    for set_threads, _ in libraries:
        set_threads(1)
    try:
        yield
    finally:
        for set_threads, before in libraries:
            set_threads(before)


@cache
def _openblas(of_scipy: bool) -> list[tuple[Callable[[int], object], Callable[[], int]]]:
    """Functions that set and get the number of threads of each OpenBLAS in the process: NumPy's, and SciPy's if it has
    been loaded.
    """
    try:
        maps = Path("/proc/self/maps").read_text()
    except OSError:
        return []
    found = []
    for path in sorted(set(re.findall(r"(/\S*openblas\S*\.so\S*)", maps))):
        library = ctypes.CDLL(path)
        for name in _SET:
            if hasattr(library, name):
                found.append((getattr(library, name), getattr(library, name.replace("_set_", "_get_"))))
                break
    return found


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
    """Bytes of memory still available on this machine, according to the operating system; all of its memory if that is
    unknown.
    """
    try:
        with open("/proc/meminfo") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return 1024 * int(line.split()[1])
    except OSError:
        pass
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 1 << 62


def progress(total: float | None = None, unit: str = "step", show: bool | None = None, **look: Any) -> Any:
    """A progress bar on stderr, which disappears when it is closed.

    Parameters
    ----------
    total : float, optional
        Number of units.
    unit : str
    show : bool, optional
        Whether it is shown; by default if stderr is a terminal.
    **look
        As for `tqdm`.
    """
    from tqdm import tqdm

    return tqdm(
        total=total, unit=unit, leave=False, disable=not (sys.stderr.isatty() if show is None else show), **look
    )
