"""Reports on stderr what is compiled, if anything is, and how long it took: otherwise a first run seems to hang."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from farhorizon.engine.codegen.numba_internals import event

#: Purpose of compiled functions, by the beginning of their module's name; those of other modules are not ours.
_PURPOSES = {
    "farhorizon.engine.program": "the time loop",
    "stencil_rows_": "the sweep of a stencil",
    "matrix_rows_": "the sweep of a stencil",
    **dict.fromkeys(("intact_rows_", "damaged_rows_", "steep_rows_"), "the sweep of breaking bonds"),
    "farhorizon.": "other kernels",
}
_SHORT = 0.2  # seconds below which no line is printed: nobody notices the wait


class _Notice(event.Listener):
    """A line before the first compilation of a process, and one after each; nothing where Numba's cache has everything.

    Numba reports the functions that it compiles, the innermost last, and the passes that each requires. For functions
    that are compiled while their module is imported (`importing`) it reports passes alone.
    """

    def __init__(self) -> None:
        self._thread = threading.local()  # simulations may be set up in parallel
        self._begun = False
        self.spent = 0.0

    def on_start(self, event: Any) -> None:
        """Take note that a function, or a pass of one, begins."""
        if event.kind == "numba:compile":
            self.enter(event.data["dispatcher"].py_func.__module__ or "")  # what is typed at a prompt may have none
        if event.kind == "numba:run_pass" and getattr(self._thread, "names", None):
            self._thread.busy = True
            if not self._begun and _purpose(self._thread.names[0]):
                self._begun = True
                _say("compiling for this machine, once: later runs find it on disk")

    def on_end(self, event: Any) -> None:
        """Take note that a function, or a pass of one, ends."""
        if event.kind == "numba:compile":
            self.leave()

    def enter(self, name: str) -> None:
        """Attribute what this thread compiles from here on to a module, unless it is attributed to one already."""
        thread = self._thread
        if not getattr(thread, "names", None):
            thread.names, thread.begin, thread.busy = [], time.perf_counter(), False
        thread.names.append(name)

    def leave(self) -> None:
        """Undo `enter`."""
        thread = self._thread
        name = thread.names.pop()
        seconds = time.perf_counter() - thread.begin
        if not thread.names and thread.busy:
            self.spent += seconds
        if not thread.names and thread.busy and _purpose(name) and seconds > _SHORT:
            _say(f"compiled {_purpose(name)} in {seconds:.1f} s")


def _purpose(module: str) -> str:
    return next((purpose for start, purpose in _PURPOSES.items() if module.startswith(start)), "")


def _say(text: str) -> None:
    print(f"farhorizon: {text}", file=sys.stderr, flush=True)


_NOTICE = _Notice()
for _kind in ("numba:compile", "numba:run_pass"):
    event.register(_kind, _NOTICE)


@contextmanager
def importing(name: str) -> Iterator[None]:
    """Attribute what is compiled meanwhile to a module that is imported."""
    _NOTICE.enter(name)
    try:
        yield
    finally:
        _NOTICE.leave()


def compile_seconds() -> float:
    """Seconds that this process has spent compiling so far."""
    return _NOTICE.spent
