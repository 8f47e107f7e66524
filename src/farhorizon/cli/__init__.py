"""The command line: new, keys, run, check, compare, sweep, invert, plot, merge, reproduce, validate, demo,
schema, info.

Each command is a function of the parsed options in a module named after it, which imports what it needs when it is
called; `parser` defines the options. This module handles how the process begins and ends.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from functools import partial
from typing import Any, NoReturn

from farhorizon.cli.common import BAD_INPUT, FAILED, GOOD, INTERRUPTED, check_json, one_line_warnings
from farhorizon.cli.parser import command_parser
from farhorizon.cli.processes import end_all, first_process_prints, pass_on_refusal, silence
from farhorizon.machine import without_collection


def process() -> NoReturn:
    """The `farhorizon` command as a process: Ctrl-C ends it at once with a one-line message, and ends a run between two
    steps.

    Python loses a KeyboardInterrupt that is raised in callbacks (of the compiler, of destructors, at its own exit).
    Leaving is safe at any time, because at any moment files are either complete or have a journal.
    """
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # background jobs of a script ignore it
        signal.signal(signal.SIGINT, _leave)
    sys.exit(main())


def _leave(number: int, frame: Any) -> None:
    with suppress(Exception):  # the signal may arrive during a print
        sys.stdout.flush()
    os.write(2, b"farhorizon: interrupted\n")
    os._exit(INTERRUPTED)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line, by default that of the process, and return the exit code."""
    with first_process_prints():
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
        # silences all but the results and errors, which go to `options.output` and `options.errors`
        with silence() if getattr(options, "quiet", False) else nullcontext(), one_line_warnings():
            code = int(options.command(options) or GOOD)
        sys.stdout.flush()  # a full disk can still be reported here
        return code
    except SystemExit as leaving:  # of the parser, which has said why on the first process, if it was there
        if leaving.code:
            pass_on_refusal(sys.argv[1:] if arguments is None else arguments)
        raise
    except KeyboardInterrupt as error:  # first, because it may arrive while other errors are imported
        end_all(options, error, _interrupted)
        return _interrupted()
    except Exception as error:
        end_all(options, error, partial(_report, error))
        return _report(error)


def _interrupted() -> int:
    print("farhorizon: interrupted", file=sys.stderr)
    return INTERRUPTED


def _report(error: Exception) -> int:
    """Report an error that is not the program's fault in one line and return the exit code; re-raise any other."""
    from farhorizon.errors import FarhorizonError, InputError

    bad_input = InputError | PermissionError | FileExistsError | FileNotFoundError | NotADirectoryError
    if isinstance(error, OSError):
        _let_go_of_stdout()
        if isinstance(error, BrokenPipeError):  # the reader of our output, such as head, has exited
            return FAILED
        text = f"{error.strerror or error}" + (f": {error.filename}" if error.filename else "")
    elif isinstance(error, MemoryError):
        text = f"not enough memory ({error or 'no more to be had'}); remedy: a coarser or smaller lattice"
    elif isinstance(error, FarhorizonError):
        text = str(error)
    else:
        raise error
    print(f"farhorizon: {text}", file=sys.stderr)
    return BAD_INPUT if isinstance(error, bad_input) else FAILED


def _let_go_of_stdout() -> None:
    """If nobody reads the output, redirect it to the null device, so that nothing is written at exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
