"""Random case files with fences: every array ends, or begins, at a page that may be neither read nor written.

The compiled loop works with addresses, so that what it reads or writes beside an array goes unnoticed. Here it ends the
process, and faulthandler prints where. Memory that nobody has written holds NaN, and memory that has been given back is
never used again. Slack that an array has on purpose is a part of it.

    python tests/robustness/fences.py --cases 1000 --seed 7 --processes 4
"""

from __future__ import annotations

import argparse
import ctypes
import mmap
import sys
import tempfile
import warnings
from pathlib import Path

import cases
import fuzz
import machinery

PAGE, ROOM = mmap.PAGESIZE, 1 << 45  # bytes of a page, and of addresses for all arrays of a process
MOST = 20_000  # arrays with fences at a time: Linux allows 65 530 ranges of pages, and each takes up to two
_HANDLER = 306  # index of NumPy's default handler of memory in its table of functions, see NEP 49
_NONE, _ALL, _PRIVATE = 0, mmap.PROT_READ | mmap.PROT_WRITE, 0x4022  # anonymous, without reserved memory

_put_up: list[object] = []  # what NumPy calls must stay alive


_ADDRESS, _SIZE = ctypes.c_void_p, ctypes.c_size_t
KINDS = {
    "malloc": ctypes.CFUNCTYPE(_ADDRESS, _ADDRESS, _SIZE),
    "calloc": ctypes.CFUNCTYPE(_ADDRESS, _ADDRESS, _SIZE, _SIZE),
    "realloc": ctypes.CFUNCTYPE(_ADDRESS, _ADDRESS, _ADDRESS, _SIZE),
    "free": ctypes.CFUNCTYPE(None, _ADDRESS, _ADDRESS, _SIZE),
}


class Handler(ctypes.Structure):
    """The structure PyDataMem_Handler of NumPy."""

    _fields_ = (("name", ctypes.c_char * 127), ("version", ctypes.c_uint8), ("context", _ADDRESS), *KINDS.items())

    @classmethod
    def of_numpy(cls):
        import numpy as np

        get = ctypes.pythonapi.PyCapsule_GetPointer
        get.restype, get.argtypes = ctypes.c_void_p, (ctypes.py_object, ctypes.c_char_p)
        functions = ctypes.cast(get(np._core._multiarray_umath._ARRAY_API, None), ctypes.POINTER(ctypes.c_void_p))
        capsule = ctypes.cast(functions[_HANDLER], ctypes.POINTER(ctypes.py_object)).contents.value
        return cls.from_address(get(capsule, b"mem_handler"))

    def functions(self):
        """Callable copies of the functions, which remain what they are now."""
        return {name: kind(ctypes.cast(getattr(self, name), ctypes.c_void_p).value) for name, kind in KINDS.items()}


def put_up(after):
    """Put up a fence right behind every array of this process from now on if `after`, else right before it."""
    system, handler = ctypes.CDLL(None), Handler.of_numpy()
    system.mmap.restype = ctypes.c_void_p
    system.mmap.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long)
    system.mprotect.argtypes = system.madvise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    old, sizes = handler.functions(), {}
    free_from = system.mmap(None, ROOM, _NONE, _PRIVATE, -1, 0) + PAGE

    def allocate(size, content):
        nonlocal free_from
        if not size or len(sizes) >= MOST:
            return old["malloc"](None, size) if content else old["calloc"](None, size, 1)
        start, length = free_from, -(-size // PAGE) * PAGE
        free_from += length + PAGE
        system.mprotect(start, length, _ALL)
        if content:
            ctypes.memset(start, content, length)
        place = start + (length - size) * after
        sizes[place] = size
        return place

    def free(_, place, size):
        if place not in sizes:
            return old["free"](None, place, size)
        length = -(-sizes.pop(place) // PAGE) * PAGE
        system.madvise(place - place % PAGE, length, mmap.MADV_DONTNEED)
        return system.mprotect(place - place % PAGE, length, _NONE) and None

    def realloc(_, place, size):
        if place not in sizes:
            return old["realloc"](None, place, size)
        new = allocate(size, 0xFF)
        ctypes.memmove(new, place, min(size, sizes[place]))
        free(None, place, 0)
        return new

    found = {
        "malloc": lambda _, size: allocate(size, 0xFF),
        "calloc": lambda _, count, size: allocate(count * size, 0),
        "realloc": realloc,
        "free": free,
    }
    for name, function in found.items():
        _put_up.append(KINDS[name](function))
        setattr(handler, name, _put_up[-1])


def without_room(count, dtype, rows=0):
    """Zeros as of `layout.aligned_zeros`, but without the room by which these are moved to a cache line."""
    import numpy as np

    return np.zeros((rows, count) if rows else count, dtype)


def answer(job):
    """Return the class of one case, in a process whose arrays have fences."""
    if not _put_up:
        import farhorizon.case.case
        import farhorizon.engine.engine  # noqa: F401 (what has been imported needs no fences)

        for module in [one for one in sys.modules.values() if hasattr(one, "aligned_zeros")]:
            module.aligned_zeros = without_room
        put_up(job["number"] % 2 == 0)
    text = cases.text_of(cases.Draw(machinery.random_of(job["seed"], job["number"])).case())
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return {"text": text, **fuzz.library(text, Path(name))}
        except Exception as error:
            return {"text": text, "class": "traceback", "where": fuzz.place(error)}


def campaign(count, seed, processes, folder, report=print):
    """Return the number of cases by class, without assertions."""
    jobs = ({"seed": seed, "number": number} for number in range(count))
    return machinery.table(
        machinery.answers(Path(__file__), jobs, processes, 10 * fuzz.LIMIT, folder), fuzz.BAD, folder, report
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        machinery.serve(answer)
    else:
        folder = Path(tempfile.mkdtemp(prefix="farhorizon-fences-"))
        counts = campaign(options.cases, machinery.seed_of(options.seed), options.processes, folder)
        print(f"{folder}: {options.cases} cases")
        sys.exit(1 if set(fuzz.BAD) & set(counts) else 0)
