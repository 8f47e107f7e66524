"""`farhorizon merge`: merge the results of several processes into one file."""

from __future__ import annotations

import argparse
from pathlib import Path

from farhorizon.cli.common import GOOD


def merge_command(options: argparse.Namespace) -> int:
    from farhorizon.files.results import open_results

    path = Path(options.result)
    results = open_results(path, verify=False)
    made = results.merge(path.with_name(f"{path.stem}-merged{path.suffix}") if options.out is None else options.out)
    print(f"{made}: {len(results.times)} outputs of {', '.join(results.field_names)}")
    return GOOD
