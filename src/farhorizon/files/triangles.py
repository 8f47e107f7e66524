"""Triangulated surfaces from files: STL, OBJ and PLY."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from farhorizon.errors import FileFormatError, InputError
from farhorizon.files.foreign import reading

_STL_HEAD = 84  # bytes: a comment, and the number of triangles
_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


def read_triangles(path: Path) -> np.ndarray:
    """Corners of the triangles of a surface, shape (n, 3, 3), from STL, OBJ or PLY as the extension says; faces with
    more corners are divided into fans of triangles.
    """
    readers = {".stl": _stl, ".obj": _obj, ".ply": _ply}
    if path.suffix.lower() not in readers:
        raise InputError("unknown kind of surface file", value=path.name, limit=", ".join(readers), key="mesh")
    with reading(path, "the surface", "mesh", "export it anew, as binary STL"):
        triangles = readers[path.suffix.lower()](path.read_bytes())
    if not len(triangles):
        raise FileFormatError(f"{path} has no triangles")
    return triangles


def _stl(content: bytes) -> np.ndarray:
    if len(content) >= _STL_HEAD:
        (count,) = struct.unpack_from("<I", content, _STL_HEAD - 4)
        if len(content) == _STL_HEAD + 50 * count:  # bytes of a facet: twelve numbers, and an attribute
            facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
            return np.frombuffer(content, facet, count, _STL_HEAD)["corners"].astype(float)
    words = [line.split() for line in content.decode("ascii").splitlines()]
    return np.array([line[1:4] for line in words if line[:1] == ["vertex"]], float).reshape(-1, 3, 3)


def _obj(content: bytes) -> np.ndarray:
    words = [line.split() for line in content.decode().splitlines()]
    points = np.array([line[1:4] for line in words if line[:1] == ["v"]], float)
    # corner/texture/normal, counted from one, or from the end if negative
    faces = [[int(corner.split("/")[0]) for corner in line[1:]] for line in words if line[:1] == ["f"]]
    return _fans(points, [[i - 1 if i > 0 else len(points) + i for i in face] for face in faces])


def _ply(content: bytes) -> np.ndarray:
    head, body = re.split(rb"end_header\r?\n", content, maxsplit=1)
    lines = [line.split() for line in head.decode("ascii").splitlines()]
    if lines[0] != ["ply"]:
        raise ValueError
    (encoding,) = (line[1] for line in lines if line[0] == "format")
    counts = {line[1]: int(line[2]) for line in lines if line[0] == "element"}
    if list(counts)[:2] != ["vertex", "face"]:
        raise ValueError
    start = lines.index(["element", "face", str(counts["face"])])
    vertex = [line[1:] for line in lines[:start] if line[0] == "property"]
    face = [line[1:] for line in lines[start:] if line[0] == "property"]
    if len(face) != 1 or face[0][0] != "list":
        raise ValueError
    at = [[name for _, name in vertex].index(axis) for axis in "xyz"]
    if encoding == "ascii":
        rows = [line.split() for line in body.decode("ascii").splitlines() if line.strip()]
        points = np.array(rows[: counts["vertex"]], float)[:, at]
        return _fans(points, [list(map(int, row[1:])) for row in rows[counts["vertex"] :][: counts["face"]]])
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}[encoding]
    stored = np.dtype([(name, order + _PLY_TYPES[of]) for of, name in vertex])
    records = np.frombuffer(body, stored, counts["vertex"])
    points = np.stack([records[axis] for axis in "xyz"], 1).astype(float)
    number, corner = (np.dtype(order + _PLY_TYPES[of]) for of in face[0][1:3])
    faces, place = [], counts["vertex"] * stored.itemsize
    for _ in range(counts["face"]):
        size = int(np.frombuffer(body, number, 1, place)[0])
        faces.append(np.frombuffer(body, corner, size, place + number.itemsize).tolist())
        place += number.itemsize + size * corner.itemsize
    return _fans(points, faces)


def _fans(points: np.ndarray, faces: Sequence[Sequence[int]]) -> np.ndarray:
    corners = [(face[0], b, c) for face in faces for b, c in pairwise(face[1:])]
    triangles = np.array(corners, int).reshape(-1, 3)
    if triangles.size and triangles.min() < 0:
        raise ValueError
    return points[triangles]
