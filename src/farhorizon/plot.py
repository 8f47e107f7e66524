"""Pictures for papers: fields, probes, energy and error histories, as PNG files.

matplotlib is imported when a picture is made; no global state of pyplot is touched, so that a picture can be made on any machine and thread.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from farhorizon.errors import InputError

if TYPE_CHECKING:
    from farhorizon.results import Results

_STYLE = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "axes.linewidth": 0.7,
    "lines.linewidth": 1.3,
    "axes.grid": False,
    "grid.linewidth": 0.4,
    "grid.color": "0.85",
    "mathtext.fontset": "dejavusans",
    "savefig.dpi": 150,
    "axes.prop_cycle": None,
}
# Okabe and Ito's colours, told apart by the colour-blind; yellow is left out, which does not show on white.
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_DASHES = ("-", "--", "-.", ":")
# What a logarithmic axis shows at most below its maximum: beyond double precision there is nothing to see.
_DECADES = 20


@contextmanager
def _figure(path: str | Path, size: tuple[float, float], layout: str = "constrained") -> Iterator[Any]:
    """Yield an empty figure in our style; save it as `path` at the end."""
    import matplotlib
    from cycler import cycler
    from matplotlib.figure import Figure

    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no directory {path.parent}", remedy="create it first")
    style = {**_STYLE, "axes.prop_cycle": cycler(linestyle=_DASHES) * cycler(color=_COLORS)}
    with matplotlib.rc_context(style):  # type: ignore[arg-type]
        figure = Figure(figsize=size, layout=layout)  # type: ignore[arg-type]
        yield figure
        figure.savefig(path)
