"""The commands and their options."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Callable
from contextlib import suppress
from difflib import get_close_matches
from typing import Any, NoReturn

from farhorizon.cli.check_command import check_command
from farhorizon.cli.invert_command import invert_command
from farhorizon.cli.result_commands import merge_command, plot_command
from farhorizon.cli.run_command import run_command
from farhorizon.cli.study_commands import (
    compare_command,
    demo_command,
    reproduce_command,
    sweep_command,
    validate_command,
)
from farhorizon.cli.text_commands import info_command, keys_command, new_command, schema_command

_NEGATIVE = re.compile(r"-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")


class _Version(argparse.Action):
    """Prints the version, which is imported only then."""

    def __call__(self, parser: argparse.ArgumentParser, *given: Any) -> NoReturn:
        from farhorizon import __version__

        print(f"farhorizon {__version__}")
        parser.exit()


class _Command(argparse.ArgumentParser):
    """Rejects unknown options itself: argparse leaves them to the main parser, whose usage message does not help."""

    def parse_known_args(self, *given: Any) -> tuple[argparse.Namespace, list[str]]:  # type: ignore[override]
        known, unknown = super().parse_known_args(*given)
        if unknown:
            options = re.findall(r"--[\w-]+", self.format_help())
            near = get_close_matches(unknown[0].partition("=")[0], options, 1)
            guess = f"; did you mean {near[0]}?" if near else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{guess}")
        return known, unknown


def command_parser() -> argparse.ArgumentParser:
    """The parser of command lines; its result has the function of the command as `command`."""
    parser = argparse.ArgumentParser(
        prog="farhorizon",
        description="Waves, elasticity, fracture, diffusion, heat and corrosion in an unbounded peridynamic or "
        "classical medium, computed on a small grid.",
        epilog="Start with 'farhorizon demo'; then 'farhorizon new wave -o my.toml' and 'farhorizon run my.toml'. Exit "
        "code: 0 good, 1 run failed, 2 bad input, 130 interrupted (Ctrl-C), 143 terminated.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND", parser_class=_Command)
    for name, (function, options, text) in _COMMANDS.items():
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        sub.set_defaults(command=function)
        for add in options:
            add(sub)
    _offer_completion(parser)
    return parser


def _offer_completion(parser: argparse.ArgumentParser) -> None:
    """Answer completion requests of the shell, if argcomplete is installed."""
    if "_ARGCOMPLETE" in os.environ:
        with suppress(ImportError):
            import argcomplete

            argcomplete.autocomplete(parser)


def _new(sub: argparse.ArgumentParser) -> None:
    kind = sub.add_argument("kind", nargs="?", metavar="KIND", help="kind of case, such as wave")
    kind.completer = _kinds  # type: ignore[attr-defined]  # for argcomplete
    sub.add_argument("-o", "--out", metavar="FILE", help="the file (default: print it)")
    sub.add_argument("--force", action="store_true", help="overwrite the file")


def _keys(sub: argparse.ArgumentParser) -> None:
    key = sub.add_argument(
        "prefix", nargs="?", default="", metavar="KEY", help="a key with dots, or the first part of one"
    )
    key.completer = _known_keys  # type: ignore[attr-defined]  # for argcomplete


def _kinds(**_: Any) -> tuple[str, ...]:
    """The kinds of cases, for the shell."""
    from farhorizon.case.templates import KINDS

    return tuple(KINDS)


def _known_keys(prefix: str, **_: Any) -> list[str]:
    """Keys of case files with as many dots as what has been typed, for the shell."""
    from farhorizon.case.keys import all_keys

    return sorted({key.path for key in all_keys() if key.path.count(".") == prefix.count(".")})


def _time(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        static = "; to its static state a run goes by --set run.until=static --set run.limit=T"
        raise argparse.ArgumentTypeError(f"not a time: {text!r}{static if text == 'static' else ''}") from None


def _run(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("case", help="case file (TOML)")
    sub.add_argument("--out", metavar="DIR", default=".", help="folder of the results (default: here)")
    sub.add_argument(
        "--resume", action="store_true", help="continue from the checkpoint NAME.ckpt of an interrupted run"
    )
    sub.add_argument("--until", type=_time, metavar="T", help="end time instead of the case's")
    sub.add_argument("--force", action="store_true", help="overwrite the results of a finished run")
    sub.add_argument(
        "--keep-checkpoint",
        action="store_true",
        help="keep NAME.ckpt even after the end of the case, for --resume --until T",
    )
    sub.add_argument("--no-report", action="store_true", help="write no page about the run (NAME/report.html)")
    sub.add_argument("--allow-unstable", action="store_true", help="run even if a mode grows")


def _check(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("case", help="case file (TOML)")
    sub.add_argument(
        "--details", action="store_true", help="also print all details and the tables of predicted reflection"
    )
    sub.add_argument(
        "--out", metavar="DIR", help="draw nodes, reflection and a growing mode into this folder (default: no pictures)"
    )
    sub.add_argument(
        "--tune",
        action="store_true",
        help="search for the settings of a PlaneWave or Higdon boundary that reflect least and are certified",
    )
    sub.add_argument(
        "--budget",
        type=float,
        metavar="SECONDS",
        help="time for the stability certificate (default: that of the run, 5 to 30 s)",
    )


def _compare(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("case", help="case file (TOML)")
    sub.add_argument("--out", metavar="DIR", default=".", help="folder of the pictures (default: here)")
    sub.add_argument(
        "--times", type=float, nargs="+", metavar="T", help="times at which to compare (default: 40 equidistant times)"
    )


def _sweep(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("case", help="case file (TOML)")
    sub.add_argument(
        "changes",
        nargs="+",
        metavar="KEY=VALUES",
        help="values of a key, such as model.speed=1.0,2.0; for several keys all combinations are computed",
    )
    sub.add_argument(
        "--jobs", type=int, default=1, metavar="N", help="number of cases computed at the same time (default: 1)"
    )
    sub.add_argument("--out", metavar="DIR", default=".", help="folder of the table NAME-sweep.csv (default: here)")
    sub.add_argument("--force", action="store_true", help="compute again what the table already contains")


def _invert(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "file",
        metavar="FILE",
        help="inversion file (TOML): a table [inversion] with the words of fh.invert, and a table [[shot]] with case "
        "and data for each run; farhorizon keys inversion explains them",
    )
    sub.add_argument("--out", metavar="DIR", default=".", help="folder of NAME_inversion.h5 (default: here)")
    sub.add_argument("--force", action="store_true", help="begin anew instead of continuing NAME_inversion.h5")
    sub.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="another value of a key of the file, such as inversion.iterations=40; may be repeated",
    )


def _plot(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("result", help="results file (NAME.h5)")
    sub.add_argument(
        "--out", metavar="DIR", help="folder of the pictures (default: beside the file, its name without .h5)"
    )
    sub.add_argument(
        "--time",
        "--times",
        dest="times",
        type=float,
        nargs="+",
        metavar="T",
        help="times (default: four equidistant ones)",
    )
    sub.add_argument(
        "--field",
        nargs="+",
        metavar="NAME",
        help="fields, components, or derivatives of displacements: u u_x u_divergence u_curl (default: all fields)",
    )
    sub.add_argument(
        "--slice",
        nargs="+",
        default=[],
        metavar="z=0.5",
        help="in 3D the planes to draw, one picture each (default: the three through the middle in one picture)",
    )
    sub._negative_number_matcher = _NEGATIVE  # argparse's own matcher takes -1e-5 for an option
    sub.add_argument("--range", type=float, nargs=2, metavar=("LOW", "HIGH"), help="range of the colours")
    sub.add_argument("--db", action="store_true", help="draw magnitudes in decibels relative to the largest")
    sub.add_argument(
        "--deformed",
        type=float,
        nargs="?",
        const=0.0,
        metavar="FACTOR",
        help="for elastic runs in 2D, draw the deformed shape, displacements times a factor (default: a round one)",
    )
    sub.add_argument(
        "--isosurfaces",
        type=float,
        nargs="*",
        metavar="VALUE",
        help="in 3D, draw the surfaces on which the first field, or each --field, has these values (default: a fifth "
        "and a half of the largest)",
    )
    sub.add_argument(
        "--movie",
        action="store_true",
        help="make a film of the first field, or of each --field: GIF, and MP4 with imageio-ffmpeg",
    )
    sub.add_argument("--format", default="png", metavar="png|pdf|svg", help="format of pictures (default: png)")


def _merge(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("result", help="results file (NAME.h5) of a run on several processes")
    sub.add_argument("-o", "--out", metavar="FILE", help="the file (default: NAME-merged.h5 beside it)")


def _entry(sub: argparse.ArgumentParser, names: Callable[[], list[str]]) -> None:
    """Options of the two commands that compute an entry of a collection, whose names the shell completes."""
    name = sub.add_argument("name", nargs="?", help="name in the list, its part before the first hyphen, or all")
    name.completer = lambda **_: names()  # type: ignore[attr-defined]  # for argcomplete
    sub.add_argument("--out", metavar="DIR", default=".", help="folder of the pictures (default: here)")
    sub.add_argument(
        "--full",
        action="store_true",
        help="full size, or the largest that is offered, where the default is smaller; takes minutes",
    )


def _reproduction(sub: argparse.ArgumentParser) -> None:
    def names() -> list[str]:
        from farhorizon.papers import REPRODUCTIONS

        return REPRODUCTIONS.names()

    _entry(sub, names)
    sub.add_argument("--details", action="store_true", help="print all numbers, not only those that the paper prints")


def _validation(sub: argparse.ArgumentParser) -> None:
    def names() -> list[str]:
        from farhorizon.validation import VALIDATIONS

        return VALIDATIONS.names()

    _entry(sub, names)


def _demo(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--out", metavar="DIR", default="farhorizon-demo", help="folder of the picture (default: farhorizon-demo)"
    )


def _schema(sub: argparse.ArgumentParser) -> None:
    with_json = [name for name, (_, options, _) in _COMMANDS.items() if _computing in options]
    sub.add_argument(
        "of",
        nargs="?",
        choices=with_json,
        metavar="COMMAND",
        help=f"the command whose --json output is described: {', '.join(with_json)} (default: case files)",
    )


def _changes(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="another value of a key of the case, such as model.speed=2.0; may be repeated",
    )


def _computing(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--json", metavar="FILE", help="also write the numbers to a JSON file")
    sub.add_argument("--threads", type=int, metavar="N", help="threads of the time loop (default: all available)")
    sub.add_argument("--quiet", action="store_true", help="print only errors and the result")


#: Function of each command, functions that add its options, and its help text.
_COMMANDS: dict[str, tuple[Callable[..., int], tuple[Callable[[argparse.ArgumentParser], None], ...], str]] = {
    "new": (new_command, (_new,), "write a commented case to start from; without a kind, list all kinds"),
    "keys": (
        keys_command,
        (_keys,),
        "explain the keys of a case file, such as model.kernel; without one, list the tables",
    ),
    "run": (
        run_command,
        (_run, _changes, _computing),
        "run a case: writes NAME.h5 (opens in ParaView) and pictures in NAME/",
    ),
    "check": (
        check_command,
        (_check, _changes, _computing),
        "check a case without running it: step limit, stability, reflection, layer, memory, time",
    ),
    "compare": (
        compare_command,
        (_compare, _changes, _computing),
        "measure the error of a case against the infinite medium, and that of a fixed and of a free edge",
    ),
    "sweep": (
        sweep_command,
        (_sweep, _changes, _computing),
        "run a case for many values of some keys and collect the results in one table, which a later call continues",
    ),
    "invert": (
        invert_command,
        (_invert, _computing),
        "find the medium for which runs agree with data: writes NAME_inversion.h5, which a later call continues, and "
        "pictures",
    ),
    "plot": (plot_command, (_plot,), "draw pictures of a results file"),
    "merge": (merge_command, (_merge,), "merge the results of several processes into one file"),
    "reproduce": (
        reproduce_command,
        (_reproduction, _computing),
        "recompute a published table or figure, all of a paper, or all, and compare; without a name, list them",
    ),
    "validate": (
        validate_command,
        (_validation, _computing),
        "compute a problem of an unbounded medium whose exact solution is known; without a name, list them",
    ),
    "demo": (
        demo_command,
        (_demo, _computing),
        "two notches in an infinite membrane: run, compare and draw, in under a minute",
    ),
    "schema": (
        schema_command,
        (_schema,),
        "print the JSON Schema of case files, with which editors complete and check them, or of a command's output",
    ),
    "info": (info_command, (), "print versions, threads and caches"),
}
