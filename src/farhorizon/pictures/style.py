"""Style of figures, colours that colour-blind readers can distinguish, and numbers as text.

Matplotlib is imported when a picture is made. Pyplot is not used: no display is needed, and no figure stays open.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from farhorizon.errors import InputError
from farhorizon.rounding import MARGIN

_TITLE = 9.5  # points
_FILLED = 0.94  # of the width of a panel that a line of its title may fill: rendering makes letters wider
_STYLE = {
    "font.size": 9.0,
    "axes.titlesize": _TITLE,
    "axes.labelsize": 9.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "axes.linewidth": 0.7,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": True,
    "lines.linewidth": 1.3,
    "lines.markersize": 4.0,
    "grid.linewidth": 0.4,
    "grid.color": "0.88",
}
_SAVED: dict[str, Any] = {
    "dpi": 150,
    "bbox_inches": "tight",
    "pad_inches": 0.05,
}  # trims the strips that a layout leaves empty
# Colours of Okabe and Ito, which colour-blind readers can distinguish; their yellow is left out because it is hardly
# visible on white.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_DASHES = ("-", "--", "-.", ":")
RIM = (("white", 1.5), ("0.1", 0.8))  # a light rim makes a line visible on dark colours
# Maps that colour-blind readers can read: two hues on either side of white, and evenly rising lightness.
DIVERGING, SEQUENTIAL = "RdBu_r", "viridis"
DAMAGE = "magma_r"  # light where nothing is broken
FORMATS = ("png", "pdf", "svg")
_FEW = 8  # largest number of nodes whose values may lie beyond the colours
_MORE = 1.75  # if the largest value is more than this many times that of the other nodes
_SMALL = 400  # largest number of nodes of a field whose colours always cover all values
_BEYOND = 0.02  # of the range of colours: an arrow indicates values further beyond it
_SHADES = 256  # number of shades in a part of a colour map
_WORD = re.compile(r"(?:\$[^$]*\$|\S)+")  # formulas are kept whole
_CELSIUS = re.compile(r"\bdegC\b")
_MICRO = re.compile(r"\bu(?=[a-zA-Z])")  # as in us and um
_ROOT = re.compile(r"(\w+)\^\(1/2\)")
_UNITS: ContextVar[Mapping[str, str]] = ContextVar("units", default=MappingProxyType({}))


@lru_cache(maxsize=1)
def _picture() -> Any:
    """Class of figures that notebooks show without pyplot, and that are saved without empty margins."""
    from matplotlib.figure import Figure

    class Picture(Figure):
        def savefig(self, fname: Any, **options: Any) -> None:
            super().savefig(fname, **(_SAVED | options))

        def _repr_png_(self) -> bytes:
            buffer = io.BytesIO()
            self.savefig(buffer, format="png")
            return buffer.getvalue()

    return Picture


@contextmanager
def figure_at(path: str | Path | None, size: tuple[float, float], layout: str = "constrained") -> Iterator[Any]:
    """Yield an empty figure in the common style, with a size in inches, and save it at the end if there is a `path`,
    whose ending determines the format.
    """
    import matplotlib
    from matplotlib.rcsetup import cycler

    if path is not None and not Path(path).parent.is_dir():
        raise InputError(f"{path}: there is no directory {Path(path).parent}", remedy="create it first")
    # the two numbers are coprime, so that all combinations occur
    styles = [(_DASHES[i % len(_DASHES)], COLORS[i % len(COLORS)]) for i in range(len(_DASHES) * len(COLORS))]
    cycle = cycler(linestyle=[dash for dash, _ in styles]) + cycler(color=[color for _, color in styles])
    settings: dict[Any, Any] = {**_STYLE, "axes.prop_cycle": cycle}
    with matplotlib.rc_context(settings):
        figure = _picture()(figsize=size, layout=layout)
        yield figure
        if path is not None:
            figure.savefig(path)


def tidy(axes: Any, margin: bool = True) -> None:
    """Lay a grid below the curves of axes; with `margin`, let them end close to its sides."""
    if margin:
        axes.margins(x=0.01)
    axes.grid(True)
    axes.set_axisbelow(True)


@contextmanager
def counted_in(units: Mapping[str, str]) -> Iterator[None]:
    """Within this context, pictures state units: those given for "length", "time" and fields."""
    token = _UNITS.set(units)
    try:
        yield
    finally:
        _UNITS.reset(token)


def with_unit(name: str, *measured: str) -> str:
    """Label of a quantity with its unit from `counted_in`, or with a product of units; that of a length by default."""
    units = [_unit_of(quantity) for quantity in measured or ("length",)]
    return f"{name} ({' '.join(units)})" if all(units) else name


def _unit_of(measured: str) -> str:
    """Unit of a quantity, with the signs for micro, degrees and roots; empty if it has none."""
    text = _CELSIUS.sub("\N{DEGREE SIGN}C", _UNITS.get().get(measured, ""))
    return _ROOT.sub(r"√\1", _MICRO.sub("\N{MICRO SIGN}", text))


def speed_text(value: float) -> str:
    """Text of a speed with its unit."""
    length, time = (_UNITS.get().get(quantity) for quantity in ("length", "time"))
    return f"{value:.4g}" + (f" {length}/{time}" if length and time else "")


def length_text(value: float, digits: int = 3) -> str:
    """Text of a length with its unit."""
    return f"{value:.{digits}g} {_unit_of('length')}".rstrip()


def frequency_text(value: float) -> str:
    """Text of a frequency in cycles per unit of time."""
    return f"{value:.4g} cycles per {_unit_of('time') or 'time'}"


def number_text(value: float, scale: float) -> str:
    """Text of a coordinate with a proper minus sign; less than 1e-9 of the `scale` of coordinates is a rounding error
    of zero.
    """
    return f"{value if abs(value) > MARGIN * scale else 0.0:g}".replace("-", "\N{MINUS SIGN}")


def reach(field: np.ndarray) -> float:
    """Magnitude up to which the colours of a field reach: its largest one, unless only a few nodes come near it, as at
    the corners of a hole, and would make all others pale.
    """
    sizes = np.abs(field[np.isfinite(field)]).ravel()
    if sizes.size <= _SMALL:
        return float(sizes.max(initial=0.0))
    largest = np.partition(sizes, (-1 - _FEW, -1))
    most, usual = float(largest[-1]), float(largest[-1 - _FEW])
    return usual if 0 < _MORE * usual < most else most


def color_range(fields: Sequence[np.ndarray], signed: bool | None = None, usual: bool = False) -> dict[str, Any]:
    """Colour map and limits for several fields: diverging if they have both signs (negative values below a hundredth of
    the largest are undershoot unless `signed`), otherwise sequential; with `usual`, limited to what more than a few
    nodes `reach`.
    """
    values = np.concatenate([field[np.isfinite(field)].ravel() for field in fields])
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    if usual:
        most = max(map(reach, fields), default=0.0)
        low, high = max(low, -most), min(high, most)
    largest = max(-low, high)
    if low < -0.01 * largest if signed is None else signed:
        return {"cmap": DIVERGING, "vmin": -largest or -1.0, "vmax": largest or 1.0}
    if high == low:
        return {"cmap": SEQUENTIAL, "vmin": min(low, 0.0), "vmax": max(high, 0.0) or 1.0}
    return {"cmap": SEQUENTIAL, "vmin": low if low > 0.5 * high else 0.0, "vmax": high}


def scale_of(
    arrays: Sequence[np.ndarray],
    limits: tuple[float, float] | None,
    colors: str | None,
    signed: bool | None = None,
    usual: bool = False,
) -> dict[str, Any]:
    """Colour map and limits for several fields: those of `color_range`, or `limits`, with white at zero if it is
    inside."""
    if limits is not None:
        from matplotlib.colors import Normalize

        usual_map = _about_zero(*limits) if limits[0] < 0 < limits[1] and colors is None else SEQUENTIAL
        return {"cmap": colors or usual_map, "norm": Normalize(*limits)}
    scale = color_range(arrays, signed, usual and colors is None)
    return scale if colors is None else {**scale, "cmap": colors, "vmin": 0.0}


def _about_zero(low: float, high: float) -> Any:
    """Diverging colours from one limit to the other; equal magnitudes are equally dark."""
    if low == -high:
        return DIVERGING
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    width = 2 * max(-low, high)  # of the complete map
    shades = np.linspace(0.5 + low / width, 0.5 + high / width, _SHADES)
    return ListedColormap(colormaps[DIVERGING](shades), f"{DIVERGING} about zero")


def extent_beyond(
    arrays: Sequence[np.ndarray], limits: tuple[float, float] | None, scale: Mapping[str, Any] | None = None
) -> str:
    """Ends at which a colour bar has an arrow because values lie beyond the limits, or well beyond those of a scale."""
    if limits is None:
        if scale is None:
            return "neither"
        low, high = scale["vmin"], scale["vmax"]
        limits = (low - _BEYOND * (high - low), high + _BEYOND * (high - low))
    low = any(np.nanmin(array, initial=np.inf) < limits[0] for array in arrays)
    high = any(np.nanmax(array, initial=-np.inf) > limits[1] for array in arrays)
    return {(True, True): "both", (True, False): "min", (False, True): "max"}.get((low, high), "neither")


def time_text(time: float) -> str:
    """Text of a time with four digits and its unit, with a power of ten if there are many zeros."""
    text, unit = f"{time:.4g}", _unit_of("time")
    if "e" in text:
        digits, power = text.split("e")
        text = rf"${digits} \times 10^{{{int(power)}}}$"
    return f"{text} {unit}" if unit else text


def wrapped(text: str, inches: float) -> str:
    """A title broken into lines no wider than its panel; words that are wider are kept whole."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    font = FontProperties(size=_TITLE)
    lines: list[str] = []
    for word in _WORD.findall(text):
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and TextPath((0, 0), longer, prop=font).get_extents().width <= 72 * _FILLED * inches:
            lines[-1] = longer
        else:
            lines.append(word)
    return "\n".join(lines)
