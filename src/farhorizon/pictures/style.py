"""What all pictures have in common: figures in one style, colours that the colour-blind tell apart, numbers as text.

matplotlib is imported when a picture is made; pyplot is not used, so that no display is needed and no figure stays
open.
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

_TITLE = 9.5  # points
_FILLED = 0.94  # of a panel's width by a line of its title: pixels make letters wider
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
}  # no strips that a layout has left empty
# Okabe and Ito's colours, which the colour-blind can tell apart; their yellow is left out, as it does not show on
# white.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_DASHES = ("-", "--", "-.", ":")
RIM = (("white", 1.5), ("0.1", 0.8))  # a light rim shows a line on dark colours
# Maps that the colour-blind read: two hues on either side of white, and lightness that rises evenly.
DIVERGING, SEQUENTIAL = "RdBu_r", "viridis"
DAMAGE = "magma_r"  # light where nothing is broken
FORMATS = ("png", "pdf", "svg")
_FEW = 8  # nodes whose values may lie beyond the colours
_MORE = 1.75  # if the largest is more than so many times that of the others
_SMALL = 400  # nodes of a field that is shown whole
_BEYOND = 0.02  # of the range of colours: what is further beyond is told by an arrow
_SHADES = 256  # of a part of a colour map
_WORD = re.compile(r"(?:\$[^$]*\$|\S)+")  # formulas are not broken
_CELSIUS = re.compile(r"\bdegC\b")
_MICRO = re.compile(r"\bu(?=[a-zA-Z])")  # of us and um
_ROOT = re.compile(r"(\w+)\^\(1/2\)")
_UNITS: ContextVar[Mapping[str, str]] = ContextVar("units", default=MappingProxyType({}))


@lru_cache(maxsize=1)
def _picture() -> Any:
    """A figure that notebooks show without pyplot, and that is saved without empty edges."""
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
    """Yield an empty figure in our style, and save it as `path`, if there is one, at the end: the ending of its name is
    the format.
    """
    import matplotlib
    from cycler import cycler

    if path is not None and not Path(path).parent.is_dir():
        raise InputError(f"{path}: there is no directory {Path(path).parent}", remedy="create it first")
    # coprime: all combinations
    styles = [(_DASHES[i % len(_DASHES)], COLORS[i % len(COLORS)]) for i in range(len(_DASHES) * len(COLORS))]
    cycle = cycler(linestyle=[dash for dash, _ in styles]) + cycler(color=[color for _, color in styles])
    settings: dict[Any, Any] = {**_STYLE, "axes.prop_cycle": cycle}
    with matplotlib.rc_context(settings):
        figure = _picture()(figsize=size, layout=layout)
        yield figure
        if path is not None:
            figure.savefig(path)


@contextmanager
def counted_in(units: Mapping[str, str]) -> Iterator[None]:
    """Within it pictures name the units of what they show: of "length", "time" and fields, as far as they are given."""
    token = _UNITS.set(units)
    try:
        yield
    finally:
        _UNITS.reset(token)


def with_unit(name: str, *measured: str) -> str:
    """The label of what is measured in a unit of `counted_in`, or in a product of these; by default of a coordinate."""
    units = [_unit_of(one) for one in measured or ("length",)]
    return f"{name} ({' '.join(units)})" if all(units) else name


def _unit_of(measured: str) -> str:
    """The unit of what is measured, with the signs of micro, of degrees and of roots; empty without one."""
    text = _CELSIUS.sub("\N{DEGREE SIGN}C", _UNITS.get().get(measured, ""))
    return _ROOT.sub(r"√\1", _MICRO.sub("\N{MICRO SIGN}", text))


def speed_text(value: float) -> str:
    """A speed with its unit."""
    known = _UNITS.get()
    both = known.get("length"), known.get("time")
    return f"{value:.4g}" + (f" {both[0]}/{both[1]}" if all(both) else "")


def length_text(value: float) -> str:
    """A length with three digits and its unit."""
    return f"{value:.3g} {_unit_of('length')}".rstrip()


def number_text(value: float, scale: float) -> str:
    """Text of a coordinate, free of round-off and with a true minus sign; `scale` is the size of coordinates that
    matter.
    """
    return f"{value if abs(value) > 1e-9 * scale else 0.0:g}".replace("-", "\N{MINUS SIGN}")


def reach(field: np.ndarray) -> float:
    """Magnitude up to which the colours of a field reach: its largest, unless no more than a few nodes come near it, as
    at the corners of a hole, which would dim all others.
    """
    sizes = np.abs(field[np.isfinite(field)]).ravel()
    if sizes.size <= _SMALL:
        return float(sizes.max(initial=0.0))
    largest = np.partition(sizes, (-1 - _FEW, -1))
    most, others = float(largest[-1]), float(largest[-1 - _FEW])
    return others if 0 < _MORE * others < most else most


def color_range(fields: Sequence[np.ndarray], signed: bool | None = None, usual: bool = False) -> dict[str, Any]:
    """Colour map and limits of some fields: symmetric and diverging if they have both signs, sequential otherwise; of
    what is `usual` up to what more than a few nodes `reach`.

    Negative values below a hundredth of the largest value are taken for undershoot, not for a sign, unless `signed` is
    given.
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
    """Colour map and norm of some fields: what `color_range` finds, or `limits`, about zero if they have both signs."""
    if limits is not None:
        from matplotlib.colors import Normalize

        both = limits[0] < 0 < limits[1] and colors is None
        found = _about_zero(*limits) if both else SEQUENTIAL
        return {"cmap": colors or found, "norm": Normalize(*limits)}
    scale = color_range(arrays, signed, usual and colors is None)
    return scale if colors is None else {**scale, "cmap": colors, "vmin": 0.0}


def _about_zero(low: float, high: float) -> Any:
    """The diverging colours from one limit to the other: those of equal magnitudes are equally dark."""
    if low == -high:
        return DIVERGING
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    whole = 2 * max(-low, high)
    shades = np.linspace(0.5 + low / whole, 0.5 + high / whole, _SHADES)
    return ListedColormap(colormaps[DIVERGING](shades), f"{DIVERGING} about zero")


def extent_beyond(
    arrays: Sequence[np.ndarray], limits: tuple[float, float] | None, scale: Mapping[str, Any] | None = None
) -> str:
    """At which ends a colour bar has an arrow: values lie beyond the limits, or well beyond those of a scale."""
    if limits is None:
        if scale is None:
            return "neither"
        low, high = scale["vmin"], scale["vmax"]
        limits = (low - _BEYOND * (high - low), high + _BEYOND * (high - low))
    low = any(np.nanmin(array, initial=np.inf) < limits[0] for array in arrays)
    high = any(np.nanmax(array, initial=-np.inf) > limits[1] for array in arrays)
    return {(True, True): "both", (True, False): "min", (False, True): "max"}.get((low, high), "neither")


def time_text(time: float) -> str:
    """A time with four digits and its unit; powers of ten where there are many zeros."""
    text, unit = f"{time:.4g}", _unit_of("time")
    if "e" in text:
        digits, power = text.split("e")
        text = rf"${digits} \times 10^{{{int(power)}}}$"
    return f"{text} {unit}" if unit else text


def wrapped(text: str, inches: float) -> str:
    """A title on as many lines as it takes to be no wider than its panel; a word that is wider stays whole."""
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
