"""Lines beside the fields of a results file: in the file itself, and in VTK's XML format for ParaView [1]_, because an
image in the format VTKHDF cannot contain lines.

References
----------
.. [1] VTK XML formats, https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from farhorizon.files.hdf5 import put_fixed, put_words, read_rows, words_in
from farhorizon.files.storage import replacing

Lines = Mapping[str, Sequence[np.ndarray]]  # by name, each of shape (n, dim)


def _flattened(lines: Lines) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """All points, shape (n, dim); the number of points of each line; the name of each line."""
    named = [(name, np.asarray(line, float)) for name, several in lines.items() for line in several]
    points = np.concatenate([line for _, line in named]) if named else np.zeros((0, 1))
    return points, np.array([len(line) for _, line in named], dtype=np.int64), [name for name, _ in named]


def put_lines(group: Any, name: str, lines: Lines) -> None:
    """Store lines in a file."""
    points, counts, names = _flattened(lines)
    stored = group.create_group(name)
    put_fixed(stored, "points", points)
    put_fixed(stored, "counts", counts)
    if names:
        put_words(stored, "names", names)


def lines_in(group: Any, path: Path, name: str) -> dict[str, list[np.ndarray]]:
    """Lines in a file, by name."""
    lines: dict[str, list[np.ndarray]] = {}
    if name in group and (names := words_in(group[name], "names")):
        points, counts = (read_rows(group[name], path, part) for part in ("points", "counts"))
        for word, line in zip(names, np.split(points, np.cumsum(counts)[:-1]), strict=True):
            lines.setdefault(word, []).append(line)
    return lines


def write_vtp(path: Path, lines: Lines) -> Path:
    """Write lines as VTK PolyData to a .vtp file, single points as vertices, with a number for each name, from 0 on."""
    points, counts, names = _flattened(lines)
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    ends = np.cumsum(counts)
    order = [*np.flatnonzero(counts == 1), *np.flatnonzero(counts > 1)]  # VTK counts vertices before lines
    numbers = {name: number for number, name in enumerate(lines)}
    of_cells = [numbers[names[k]] for k in order]

    def array(name: str, values: Sequence[object] | np.ndarray, dtype: str, width: int = 1) -> str:
        text = " ".join(map(repr, np.ravel(np.asarray(values)).tolist()))
        return f'<DataArray type="{dtype}" Name="{name}" NumberOfComponents="{width}" format="ascii">{text}</DataArray>'

    def cells(tag: str, chosen: np.ndarray) -> str:
        places = [k for end, count in zip(ends[chosen], counts[chosen], strict=True) for k in range(end - count, end)]
        inside = array("connectivity", places, "Int64") + array("offsets", np.cumsum(counts[chosen]), "Int64")
        return f"<{tag}>{inside}</{tag}>"

    sizes = f'NumberOfVerts="{(counts == 1).sum()}" NumberOfLines="{(counts > 1).sum()}"'
    legend = escape(", ".join(f"{number} {name}" for name, number in numbers.items()))
    text = (
        f'<?xml version="1.0"?>\n<!-- {legend} -->\n<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian">'
        f'<PolyData><Piece NumberOfPoints="{len(points)}" {sizes} NumberOfStrips="0" NumberOfPolys="0">'
        f"<Points>{array('points', points, 'Float64', 3)}</Points>{cells('Verts', counts == 1)}"
        f"{cells('Lines', counts > 1)}<CellData>{array('kind', of_cells, 'Int64')}</CellData>"
        "</Piece></PolyData></VTKFile>\n"
    )
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8")
    return path
