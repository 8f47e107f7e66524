"""Polar plots of patterns over directions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from farhorizon.pictures.style import figure_at, number_text, with_unit

_MOST = 4  # largest number of frequencies drawn
_FLAT = 1e-9
PLANES = ((0, 1), (1, 2), (2, 0))


def polar_picture(
    directions: np.ndarray,
    frequencies: np.ndarray,
    levels: Mapping[str, np.ndarray],
    path: str | Path | None,
    label: str = "",
) -> Any:
    """Draw levels over directions, with one line per wave and one panel per frequency.

    In 3D there is one row of panels for each of the planes xy, yz and zx that contains directions.

    Parameters
    ----------
    directions : ndarray, shape (D, 2) or (D, 3)
        Unit vectors.
    frequencies : ndarray, shape (F,)
        Up to four of them are drawn.
    levels : mapping of str to ndarray
        Non-negative levels of each wave, shape (F, D).
    path : str or Path, optional
    label : str
        Name of the levels.

    Returns
    -------
    matplotlib.figure.Figure
    """
    planes = [(plane, where) for plane in PLANES if (where := _within(directions, plane)).size]
    drawn = np.unique(np.linspace(0, len(frequencies) - 1, min(len(frequencies), _MOST)).round().astype(int))
    top = max((float(np.nanmax(values, initial=0)) for values in levels.values()), default=0.0)
    with figure_at(path, (0.6 + 2.7 * len(drawn), 0.5 + 2.7 * len(planes))) as figure:
        panels = figure.subplots(len(planes), len(drawn), squeeze=False, subplot_kw={"projection": "polar"})
        for row, (plane, where) in zip(panels, planes, strict=True):
            for panel, number in zip(row, drawn, strict=True):
                turn = np.arctan2(directions[where, plane[1]], directions[where, plane[0]]) % (2 * np.pi)
                _, order = np.unique(turn.round(9), return_index=True)  # an axis lies in two planes
                closed = np.append(order, order[:1])
                for wave, values in levels.items():
                    panel.plot(turn[closed], values[number, where][closed], label=wave)
                panel.set_rlim(0, (1.05 * top) or 1.0)
                panel.tick_params(labelsize="x-small")
                panel.set_rlabel_position(100)
                there = "" if directions.shape[1] == 2 else f", {'xyz'[plane[0]]}{'xyz'[plane[1]]} plane"
                cycles = number_text(float(frequencies[number]), float(frequencies.max()))
                per = with_unit("", "frequency").strip(" ()").removeprefix("1")
                panel.set_title(f"f = {cycles}{per}{there}")
        if len(levels) > 1:
            figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside right upper")
        figure.supxlabel(label, fontsize="medium")
    return figure


def _within(directions: np.ndarray, plane: tuple[int, int]) -> np.ndarray:
    """Indices of the directions that lie in a plane."""
    if directions.shape[1] == 2:
        return np.arange(len(directions)) if plane == (0, 1) else np.zeros(0, int)
    (normal,) = {0, 1, 2} - set(plane)
    return np.flatnonzero(np.abs(directions[:, normal]) < _FLAT)
