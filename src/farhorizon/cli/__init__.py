"""The command line: new, keys, run, check, compare, sweep, plot, merge, reproduce, validate,
demo, schema, info.

A command is a function of the parsed options in a module of its name, which imports what it needs when it is called;
`parser` says what each may be given. Here is how a process begins and how it ends.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from functools import partial
from typing import Any, NoReturn

from farhorizon.cli.common import BAD_INPUT, FAILED, GOOD, INTERRUPTED, check_json, said_plainly
from farhorizon.cli.parser import command_parser
from farhorizon.cli.processes import end_all, said_by_first, silence
from farhorizon.machine import without_collection


def process() -> NoReturn:
    """The `farhorizon` command as a process: Ctrl-C ends it at once and in one line, and a run between two steps.

    Python loses a KeyboardInterrupt that is raised in callbacks (of the compiler, of destructors, at its own exit).
    Leaving is safe at any time, since files are complete or have a journal whenever a process dies.
    """
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as for jobs in the background of a script
        signal.signal(signal.SIGINT, _leave)
    sys.exit(main())


def _leave(number: int, frame: Any) -> None:
    with suppress(Exception):  # it may come while something is printed
        sys.stdout.flush()
    os.write(2, b"farhorizon: interrupted\n")
    os._exit(INTERRUPTED)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line, by default that of the process; returns the exit code."""
    with said_by_first():
        return _main(arguments)


def _main(arguments: Sequence[str] | None) -> int:
    options = None
    try:
        options = command_parser().parse_args(arguments)
        options.output, options.errors = sys.stdout, sys.stderr
        options.given = sys.argv[1:] if arguments is None else list(arguments)
        with without_collection():
            import farhorizon.case.case  # noqa: F401

        check_json(getattr(options, "json", None))
        # but for what goes to `options.output` and `options.errors`: the result and errors
        with silence() if getattr(options, "quiet", False) else nullcontext(), said_plainly():
            code = int(options.command(options) or GOOD)
        sys.stdout.flush()  # here a full disk can still be told
        return code
    except KeyboardInterrupt as error:  # first: it comes while the names of other errors are imported, too
        end_all(options, error, _interrupted)
        return _interrupted()
    except Exception as error:
        end_all(options, error, partial(_tell, error))
        return _tell(error)


def _interrupted() -> int:
    print("farhorizon: interrupted", file=sys.stderr)
    return INTERRUPTED


def _tell(error: Exception) -> int:
    """Explain in one line an error that is no fault of the program, and return the exit code; raises others again."""
    from farhorizon.errors import FarhorizonError, InputError

    code = (
        BAD_INPUT
        if isinstance(error, InputError | PermissionError | FileExistsError | FileNotFoundError | NotADirectoryError)
        else FAILED
    )
    if isinstance(error, OSError):
        _let_go_of_stdout()
        if isinstance(error, BrokenPipeError):  # the reader of our output, such as head, has gone
            return FAILED
        print(
            f"farhorizon: {error.strerror or error}" + (f": {error.filename}" if error.filename else ""),
            file=sys.stderr,
        )
    elif isinstance(error, MemoryError):
        print(
            f"farhorizon: not enough memory ({error or 'no more to be had'}); remedy: a coarser or smaller lattice",
            file=sys.stderr,
        )
    elif isinstance(error, FarhorizonError):
        print(f"farhorizon: {error}", file=sys.stderr)
    else:
        raise error
    return code


def _let_go_of_stdout() -> None:
    """If nobody takes what is printed, throw it away, so that nothing is written at the exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
