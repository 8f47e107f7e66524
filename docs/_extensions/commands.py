"""The command line as Markdown, from its parsers."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from unittest import mock

from farhorizon.cli.parser import command_parser


def markdown() -> str:
    """Usage, arguments and options of each command."""
    with mock.patch.dict(os.environ, COLUMNS="100", NO_COLOR="1"):
        parser = command_parser()
        (commands,) = (one for one in parser._actions if isinstance(one, argparse._SubParsersAction))
        lines = [parser.epilog or "", ""]
        for name, command in commands.choices.items():
            lines += [
                f"## farhorizon {name}",
                "",
                command.description or "",
                "",
                "```text",
                command.format_usage().rstrip(),
            ]
            lines += ["```", "", *_arguments(command)]
        return "\n".join(lines)


def _arguments(command: argparse.ArgumentParser) -> Iterator[str]:
    for one in command._actions:
        if not isinstance(one, argparse._HelpAction):
            value = f" {one.metavar or one.dest.upper()}" if one.nargs != 0 and one.option_strings else ""
            yield f"`{', '.join(one.option_strings) or one.dest}{value}`"
            yield f": {one.help[0].upper()}{one.help[1:]}.\n"
