"""Rows of the report about a set-up before its run, each a name and a value."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import numpy as np

from farhorizon.analysis.resolution import Band
from farhorizon.checks.examined import Examined
from farhorizon.engine.engine import Layer
from farhorizon.geometry.lattice import AXES
from farhorizon.pictures.style import length_text, speed_text

Rows = list[tuple[str, str]]

#: What bonds do beyond their critical stretch, by softening law.
_ENDS = {None: "break at", "linear": "soften linearly from", "exponential": "soften exponentially from"}


def options_shown(boundary: Any) -> str:
    """A boundary with those options that differ from their defaults."""
    given = {f.name: getattr(boundary, f.name) for f in fields(boundary) if getattr(boundary, f.name) != f.default}
    return f"{type(boundary).__name__}({', '.join(f'{k}={v!r}' for k, v in given.items())})"


def lattice_rows(sim: Examined) -> Rows:
    """The lattice, its stencil and its time step."""
    lattice, stencil = sim.lattice, sim.stencil
    shape, reach = (" x ".join(map(str, numbers)) for numbers in (lattice.shape, stencil.reach))
    limit = f"{sim.dt / sim.step_limit:.3g} of the stable limit {sim.step_limit:.6g}"
    return [
        ("near field", f"{shape} nodes, {lattice.nodes} shown, spacing {length_text(lattice.spacing, 6)}"),
        ("stencil", f"{len(stencil.weights)} neighbours, reach {reach} nodes"),
        ("time step", f"{sim.dt:.6g}, {limit} ({sim.model.integrator.name})"),
    ]


def wave_rows(sim: Examined, waves: Band | None) -> Rows:
    """The wave speeds, and the range of wavelengths in the data."""
    rows = []
    if sim.model.speeds:
        of = ' of the medium "in the middle of all speeds"' if sim.varied else ""
        speeds = ", ".join(f"{wave} {speed_text(c)}" for wave, c in sim.model.speeds.items())
        rows.append(("wave speeds", speeds + of))
    if waves is not None:
        nodes = f"{waves.typical / sim.lattice.spacing:.3g} nodes"
        half = f"half of the energy below {length_text(waves.typical)} = {nodes}"
        rows.append(("wavelengths", f"{waves.shortest:.3g} to {length_text(waves.longest)}, {half}"))
    return rows


def layer_rows(sim: Examined, waves: Band | None) -> Rows:
    """The layers, and how far the medium is computed beyond sides that extend it; alike sides share a row."""
    lead = 3 - sim.lattice.dim
    layers = [
        (_side(axis - lead, side), _layer(sim, axis - lead, side, layer, waves))
        for (axis, side), layer in sim.engine.layers.items()
    ]
    extents = [(_side(*key), str(extent)) for key, extent in sim.extents.items()]
    return [*_merged("layer", layers), *_merged("extended", extents)]


def _layer(sim: Examined, axis: int, side: int, layer: Layer, waves: Band | None) -> str:
    boundary, name = sim.sides[axis, side], _side(axis, side)
    length, reach = layer.columns * sim.lattice.spacing, sim.stencil.reach[axis]
    wavelengths = "" if waves is None else f" = {length / waves.typical:.3g} wavelengths"
    text = f"{layer.columns} nodes = {layer.columns / reach:.3g} horizons{wavelengths}, length {length:g}"
    if boundary.target is not None or name in sim.thickness:
        text += f", target {boundary.wanted(sim.model.target):g}"
    if name in sim.thickness:
        text += f"; {sim.thickness[name]}"
    elif boundary.open_ended:
        text += "; a usual number, until trial runs choose it for a run of known length"
    return text


def _side(axis: int, side: int) -> str:
    return AXES[axis] + "-+"[side > 0]


def _merged(what: str, sides: Iterable[tuple[str, str]]) -> Rows:
    """Rows about sides, each with its text, with one row for all sides that have the same text."""
    names_by_text: dict[str, list[str]] = {}
    for name, text in sides:
        names_by_text.setdefault(text, []).append(name)
    return [(f"{what} {', '.join(names)}", text) for text, names in names_by_text.items()]


def side_rows(sim: Examined) -> Rows:
    """Sides that have no rows elsewhere, the condition along an outline, and exact ends."""
    windowed = sim.lattice.window is not None
    rows = [
        (f"side {_side(*key)}", options_shown(boundary))
        for key, boundary in sim.sides.items()
        if not (boundary.stretched or boundary.exact or boundary.extended or (boundary.closing and windowed))
    ]
    if sim.closure is not None:
        if windowed:
            rows.append(("outline", options_shown(sim.sides[0, -1])))
        rows.append(("fitted", sim.closure.describe()))
    return rows + [(f"exact end {name}", representation) for name, representation in sim.ends.items()]


def metal_rows(sim: Examined) -> Rows:
    """The metal of a corrosion model, and the speed of its front."""
    dissolution = sim.model.dissolution
    if dissolution is None:
        return []
    metal = int(np.nansum(sim.fields["solid"]))
    liquid = f"saturation {dissolution.saturation:g}, interface {dissolution.interface:g} of the liquid"
    rows = [("metal", f"{metal} solid nodes shown, {liquid}")]
    if metal:
        concentration = float(np.nanmax(sim.fields["u"]))
        speed = dissolution.speed(sim.lattice.spacing, sim.lattice.dim, concentration, sim.background)
        control = f"under activation control{' (limited by saturation)' if dissolution.limited else ''}"
        scaled = f"for another speed v: interface = {dissolution.interface / speed:.4g} v"
        rows.append(("front", f"speed {speed_text(speed)} {control}; {scaled}"))
    return rows


def size_rows(sim: Examined) -> Rows:
    """Computed nodes, memory, and absent bonds."""
    engine = sim.engine
    extra = engine.size - int(np.prod(sim.lattice.shape))
    times = engine.nbytes / (np.prod(sim.field_shape) * engine.dtype.itemsize)
    digits = ", layers store six digits" if engine.kept != engine.dtype else ""
    return [
        ("nodes computed", f"{int(np.prod(engine.core.nodes))} in the core, {extra} beyond the near field"),
        ("memory", f"{mebibytes(engine.nbytes)} = {times:.3g} near fields{digits}"),
        ("absent bonds", str(engine.absent.count)),
    ]


def bond_rows(sim: Examined) -> Rows:
    """The behaviour of bonds that follow a law of their own stretch."""
    law, bonds = sim.model.bond_law, sim.engine.bonds
    if law is None:
        return []
    breaking = "none breaks"
    if np.isfinite(bonds.limit):
        least, largest = (f"{stretch:.4g}" for stretch in bonds.critical_stretches)
        stretch = least if least == largest else f"{least} to {largest}"
        breaking = f"{_ENDS[law.softening]} a stretch of {stretch}, except within one reach of sides that are not free"
    if law.law is not None:
        breaking = f"{law.law}, except within one reach of sides that are not free"
    shape = "nonlinear" if law.nonlinear else "linear"
    contact = ", absent ones carry compression" if law.contact else ""
    if law.slides and sim.engine.get("faces.nodes").size:
        contact += f", faces of cracks slide with a friction of {law.friction:g}"
    return [("bonds", f"{shape}, {breaking}{contact}; predictions are for the linear form with intact bonds")]


def mebibytes(size: float) -> str:
    """A number of bytes in words."""
    return f"{size / 2**20:.3g} MiB"
