"""Lines beside the fields of a results file: in the file itself, and in VTK's XML format for ParaView [1]_, because an
image in the format VTKHDF cannot contain lines.

References
----------
.. [1] VTK XML formats, https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from farhorizon.files.storage import replacing

Lines = Mapping[str, Sequence[np.ndarray]]


def flattened(lines: Lines) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """All points, shape (n, dim); the number of points of each line; the name of each line."""
    named = [(name, np.asarray(line, float)) for name, some in lines.items() for line in some]
    points = np.concatenate([line for _, line in named]) if named else np.zeros((0, 1))
    return points, np.array([len(line) for _, line in named], dtype=np.int64), [name for name, _ in named]


def gathered(points: np.ndarray, counts: np.ndarray, names: Sequence[str]) -> dict[str, list[np.ndarray]]:
    """Inverse of `flattened`: the lines by name."""
    found: dict[str, list[np.ndarray]] = {}
    for name, line in zip(names, np.split(points, np.cumsum(counts)[:-1]), strict=True) if names else ():
        found.setdefault(name, []).append(line)
    return found


def write_vtp(path: Path, lines: Lines) -> Path:
    """Write lines as VTK PolyData, single points as vertices, with a number for each name, from 0 on.

    Parameters
    ----------
    path : Path
        A name that ends in .vtp.
    lines : mapping of str to sequence of ndarray, each of shape (n, dim)
    """
    points, counts, names = flattened(lines)
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    ends = np.cumsum(counts)
    order = [*np.flatnonzero(counts == 1), *np.flatnonzero(counts > 1)]  # VTK counts vertices before lines
    kinds = {name: number for number, name in enumerate(lines)}
    numbers = [kinds[names[k]] for k in order]

    def array(name: str, values: Sequence[object] | np.ndarray, kind: str, width: int = 1) -> str:
        text = " ".join(map(repr, np.ravel(np.asarray(values)).tolist()))
        return f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}" format="ascii">{text}</DataArray>'

    def cells(tag: str, chosen: np.ndarray) -> str:
        places = [k for end, count in zip(ends[chosen], counts[chosen], strict=True) for k in range(end - count, end)]
        inside = array("connectivity", places, "Int64") + array("offsets", np.cumsum(counts[chosen]), "Int64")
        return f"<{tag}>{inside}</{tag}>"

    sizes = f'NumberOfVerts="{(counts == 1).sum()}" NumberOfLines="{(counts > 1).sum()}"'
    legend = escape(", ".join(f"{number} {name}" for name, number in kinds.items()))
    text = (
        f'<?xml version="1.0"?>\n<!-- {legend} -->\n<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian">'
        f'<PolyData><Piece NumberOfPoints="{len(points)}" {sizes} NumberOfStrips="0" NumberOfPolys="0">'
        f"<Points>{array('points', points, 'Float64', 3)}</Points>{cells('Verts', counts == 1)}"
        f"{cells('Lines', counts > 1)}<CellData>{array('kind', numbers, 'Int64')}</CellData>"
        "</Piece></PolyData></VTKFile>\n"
    )
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8")
    return path
