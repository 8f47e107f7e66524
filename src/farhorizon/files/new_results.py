"""Creation of results files: checked content, and the groups and datasets to which outputs are appended."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import h5py
import numpy as np

from farhorizon.errors import InputError
from farhorizon.files.hdf5 import CHUNK_ROWS, grow, put_fixed, put_word, put_words
from farhorizon.files.parts import Box
from farhorizon.files.polylines import Lines, flattened
from farhorizon.files.region_numbers import FIELD, Regions
from farhorizon.files.results_layout import (
    FORMAT,
    RESERVED,
    RESULTS_VERSION,
    chunk_of,
    make_field,
    put_boxes,
    vtk_shape,
)


class Planned(NamedTuple):
    """Content of a new results file.

    Attributes
    ----------
    shape : tuple of int
        Nodes along x[, y[, z]].
    lower : tuple of float
        Coordinates of the first node.
    spacing : float
    fields : dict of str to int
        Number of components of each field.
    dtype : dtype
        Type of the stored fields.
    probes : ndarray, shape (n, dim)
        Positions of the probes.
    probe_components : int
        Number of components of the values at the probes.
    boxes : sequence of Box
        Boxes of the parts that store the fields; empty if the file itself stores them.
    """

    shape: tuple[int, ...]
    lower: tuple[float, ...]
    spacing: float
    fields: dict[str, int]
    dtype: np.dtype
    probes: np.ndarray
    probe_components: int
    boxes: Sequence[Box]


def planned(
    shape: Sequence[int],
    lower: Sequence[float] | np.ndarray,
    spacing: float,
    fields: tuple[str, ...],
    dtype: Any,
    probes: np.ndarray | None,
    components: int | Mapping[str, int],
    boxes: Sequence[Box],
) -> Planned:
    """Content of a new file, from checked arguments of `ResultsWriter.create`.

    Raises
    ------
    InputError
        An argument is wrong.
    """
    real = _checked_precision(dtype)
    nodes, origin = tuple(int(n) for n in shape), tuple(float(v) for v in lower)
    _check_lattice(nodes, origin, spacing)
    _check_fields(fields)
    places = _checked_probes(probes, len(nodes))
    width = dict.fromkeys(fields, components) if isinstance(components, int) else dict(components)
    probed_width = width.get("u", width[fields[0]])
    if not {width[name] for name in fields} <= {1, 2, 3}:
        raise InputError("fields in results files have up to three components", value=components, limit="1 to 3")
    shown = {name: width[name] for name in fields}
    return Planned(nodes, origin, float(spacing), shown, real, places, probed_width, boxes)


def _checked_precision(dtype: Any) -> np.dtype:
    found = np.dtype(dtype)
    if found not in (np.dtype("float32"), np.dtype("float64")):
        raise InputError(
            "results are stored in single or double precision", value=found, remedy="use float32 or float64"
        )
    return found


def _check_lattice(shape: tuple[int, ...], lower: tuple[float, ...], spacing: float) -> None:
    if len(shape) not in (1, 2, 3) or len(lower) != len(shape) or min(shape) < 1:
        raise InputError(
            "shape has one to three entries, all positive, and lower as many", value=f"shape {shape}, lower {lower}"
        )
    if not np.isfinite(spacing) or spacing <= 0:
        raise InputError("the spacing is a positive number", value=spacing)


def _check_fields(fields: tuple[str, ...]) -> None:
    for name in fields:
        if not name or name in RESERVED or "/" in name or name.startswith("."):
            remedy = f"use a name without '/', not beginning with '.', and none of {', '.join(sorted(RESERVED))}"
            raise InputError("this name cannot be used for a field in a results file", value=repr(name), remedy=remedy)
    if not fields or len(set(fields)) != len(fields):
        remedy = "name one or more, each once"
        raise InputError("fields are one or more different names", value=fields, key="fields", remedy=remedy)


def _checked_probes(probes: np.ndarray | None, dim: int) -> np.ndarray:
    places = np.zeros((0, dim)) if probes is None else np.asarray(probes, dtype=float)
    if places.ndim != 2 or places.shape[1] != dim:
        raise InputError("probes have the shape (n, dim)", value=places.shape, limit=f"(n, {dim})")
    return places


def make_vtk(file: Any, plan: Planned, compress: bool) -> None:
    """Create what VTK reads: the lattice, and fields without outputs."""
    vtk = file.create_group("VTKHDF")
    padded, origin = (*plan.shape, 1, 1)[:3], (*plan.lower, 0.0, 0.0)[:3]
    vtk.attrs["Version"] = np.array([2, 0])
    vtk.attrs.create("Type", b"ImageData", dtype=h5py.string_dtype("ascii", len("ImageData")))
    vtk.attrs["WholeExtent"] = np.array([0, padded[0] - 1, 0, padded[1] - 1, 0, padded[2] - 1])
    vtk.attrs["Origin"] = np.array(origin)
    vtk.attrs["Spacing"] = np.full(3, plan.spacing)
    vtk.attrs["Direction"] = np.eye(3).ravel()
    steps, data = vtk.create_group("Steps"), vtk.create_group("PointData")
    steps.attrs["NSteps"] = 0
    grow(steps, "Values", "f8")
    offsets = steps.create_group("PointDataOffsets")
    for name, components in plan.fields.items():
        stored = vtk_shape(plan.shape, components)
        if len(plan.boxes):
            data.create_dataset(name, (0, *stored), plan.dtype)
        else:
            make_field(data, name, stored, plan.dtype, compress)
        grow(offsets, name, "i8")
        kind = "Scalars" if components == 1 else "Vectors"
        if kind not in data.attrs:
            put_word(data.attrs, kind, name)


def make_own(
    file: Any, plan: Planned, case: str, words: Mapping[str, str], tables: Mapping[str, Mapping[str, str] | None]
) -> Any:
    """Create the group for everything that VTK does not know, with what is known before the first output.

    Parameters
    ----------
    file : h5py.File
    plan : Planned
    case : str
        Text of the case file.
    words, tables : mapping
        Strings by name, and tables of strings, which are stored as JSON.
    """
    group = file.create_group("farhorizon")
    told = {name: json.dumps(dict(table or {})) for name, table in tables.items()}
    for name, word in {"format": FORMAT, **words, "cautions": "[]", **told}.items():
        put_word(group.attrs, name, word)
    attributes = {
        "version": RESULTS_VERSION,
        "finished": False,
        "dim": len(plan.shape),
        "shape": plan.shape,
        "spacing": plan.spacing,
        "lower": plan.lower,
        "components": list(plan.fields.values()),
        "probe_components": plan.probe_components,
        "outputs": 0,
    }
    for name, value in attributes.items():
        group.attrs[name] = value
    if len(plan.boxes):
        put_boxes(group, plan.boxes)
    put_words(group, "case", [case])
    put_words(group, "fields", tuple(plan.fields))
    put_fixed(group, "probes", plan.probes)
    return group


def put_outlines(group: Any, outlines: Lines) -> None:
    """Store lines to be shown."""
    points, counts, names = flattened(outlines)
    shown = group.create_group("outlines")
    put_fixed(shown, "points", points)
    put_fixed(shown, "counts", counts)
    if names:
        put_words(shown, "names", names)


def put_regions(vtk: Any, group: Any, regions: Regions, shape: tuple[int, ...]) -> None:
    """Store the regions as point data of every output: as a single row, to which all outputs refer."""
    stored = vtk_shape(shape, 1)
    values = np.asarray(regions.numbers, np.int32).T.reshape(1, *stored)
    options = {"chunks": chunk_of(stored, 4), "fletcher32": True, "compression": "gzip", "shuffle": True}
    vtk["PointData"].create_dataset(FIELD, data=values, **options)
    grow(vtk["Steps/PointDataOffsets"], FIELD, "i8")
    put_words(group, "regions", regions.names)


def make_columns(group: Any, plan: Planned, accounts: Sequence[str]) -> None:
    """Create the datasets that grow with outputs, rows of the history and records of the probes."""
    for name in ("steps", "history_rows", "record_rows"):
        grow(group, name, "i8")
    history = group.create_group("history")
    history.attrs["rows"] = 0
    grow(history, "times", "f8")
    grow(history, "energy", "f8")
    records = group.create_group("records")
    records.attrs["rows"] = 0
    grow(records, "times", "f8")
    if count := len(plan.probes):
        probed = () if plan.probe_components == 1 else (plan.probe_components,)
        grow(records, "values", "f8", (count, *probed), (CHUNK_ROWS, min(count, 64), *probed))
    if accounts:
        put_words(group, "accounts", accounts)
        grow(history, "balance", "f8", (len(accounts),))
