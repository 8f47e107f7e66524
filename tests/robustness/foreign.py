"""Damages files of other programs that a case may name: the case runs, or is refused in one line with their name.

python tests/robustness/foreign.py --files 10000 --seed 7
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
import tempfile
import warnings
from pathlib import Path

import machinery
import numpy as np

BAD = ("traceback", "crash", "hang", "no name", "several lines", "much memory")
LIMIT = 60.0  # seconds of processor time for one file
MEMORY = 2**31  # bytes of memory that no small file may ask for: more is refused by the operating system
ABOUT_OTHERS = "dimension", "near field", "no node lies"  # parts of refusals of a sound file that does not fit
NUMBERS = "0 -1 1 2 3 7 1000000000 99999999999999999999 1e400 nan inf -1e-320 x".split()


def voxels(path: Path, rng) -> None:
    """Write an array or a stack of images with a ball of cells."""
    place = np.stack(np.meshgrid(*[np.arange(7) - 3] * int(rng.integers(2, 4)), indexing="ij"))
    cells = ((place**2).sum(0) < 8).astype(rng.choice(["?", "u1", "<u2", ">i4"] if path.suffix == ".npy" else ["u1"]))
    if path.suffix == ".npy":
        with path.open("wb") as file:
            version = [(1, 0), (2, 0), (3, 0)][int(rng.integers(3))]
            np.lib.format.write_array(file, np.asarray(cells, order=str(rng.choice(["C", "F"]))), version)
        return
    from PIL import Image

    pages = [Image.fromarray(page) for page in (cells if cells.ndim == 3 else cells[None])]
    packed = rng.choice([None, "tiff_lzw", "tiff_deflate", "packbits", "jpeg"])
    pages[0].save(path, save_all=True, append_images=pages[1:], compression=packed)


def image(path: Path, rng) -> None:
    """Write an image with a dark disc."""
    from PIL import Image

    shape = [(9, 9), (9, 9, 3), (9, 9, 4)][int(rng.integers(2 if path.suffix == ".jpg" else 3))]
    pixels = np.full(shape, 255, np.uint8)
    pixels[2:7, 2:7] = 0 if len(shape) == 2 else (0, 0, 0, 255)[: shape[2]]
    Image.fromarray(pixels).save(path)


def samples(path: Path, rng) -> None:
    """Write a signal, with or without its times."""
    values = np.sin(np.pi * np.arange(21) / 20) ** 2
    table = np.column_stack([0.5 * np.arange(21), values]) if rng.random() < 0.5 else values
    if path.suffix == ".npy":
        np.save(path, table.astype(rng.choice(["<f8", "<f4", ">f8"])))
    else:
        np.savetxt(path, table, delimiter=", " if path.suffix == ".csv" else " ")


_CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)
_FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]


def surface(path: Path, rng) -> None:
    """Write a tetrahedron."""
    text = rng.random() < 0.5
    triangles = _CORNERS[np.array(_FACES)]
    if path.suffix == ".obj":
        lines = [f"v {x} {y} {z}" for x, y, z in _CORNERS] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in _FACES]
        path.write_text("\n".join(lines) + "\n")
    elif path.suffix == ".stl" and text:
        facets = ["".join(f"vertex {x} {y} {z}\n" for x, y, z in one) for one in triangles]
        inner = "".join(f"facet normal 0 0 0\nouter loop\n{one}endloop\nendfacet\n" for one in facets)
        path.write_text(f"solid s\n{inner}endsolid s\n")
    elif path.suffix == ".stl":
        facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        records = np.zeros(len(triangles), facet)
        records["corners"] = triangles
        path.write_bytes(bytes(80) + np.uint32(len(triangles)).tobytes() + records.tobytes())
    else:
        kind = "ascii" if text else "binary_little_endian"
        head = f"ply\nformat {kind} 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n"
        head += "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
        if text:
            rows = [" ".join(map(str, row)) for row in (*_CORNERS, *((3, *face) for face in _FACES))]
            path.write_text(head + "\n".join(rows) + "\n")
        else:
            faces = b"".join(b"\x03" + np.array(face, "<i4").tobytes() for face in _FACES)
            path.write_bytes(head.encode() + _CORNERS.tobytes() + faces)


def elements(path: Path, rng) -> None:
    """Write a mesh of triangles or tetrahedra in a format of Gmsh or VTK."""
    import meshio

    solid = rng.random() < 0.5
    cells = [("tetra", [(0, 1, 2, 3)])] if solid else [("triangle", [(0, 1, 2)])]
    tags = {"gmsh:physical": [[1]], "gmsh:geometrical": [[1]]} if path.suffix == ".msh" else {}
    names = {"all": np.array([1, 3 if solid else 2])} if path.suffix == ".msh" else {}
    mesh = meshio.Mesh(_CORNERS, cells, cell_data=tags, field_data=names)
    kind = {".msh": ["gmsh22", "gmsh"], ".vtk": ["vtk42", "vtk51"], ".vtu": ["vtu"]}[path.suffix]
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        meshio.write(path, mesh, str(rng.choice(kind)), binary=bool(rng.integers(2)))


#: Names of files, what writes them, and the part of a case that names them.
FILES = {
    **dict.fromkeys(("v.npy", "v.tif"), (voxels, 'body = { voxels = { file = "FILE", size = 0.5 } }')),
    **dict.fromkeys(("i.png", "i.jpg"), (image, 'body = { image = { file = "FILE", width = 4.0 } }')),
    **dict.fromkeys(("s.npy", "s.txt", "s.csv"), (samples, "")),
    **dict.fromkeys(("t.stl", "t.obj", "t.ply"), (surface, 'body = { mesh = { file = "FILE" } }')),
    **dict.fromkeys(("e.msh", "e.vtk", "e.vtu"), (elements, 'body = { elements = { file = "FILE", scale = 1.5 } }')),
}
SOURCE = """
[[source]]
type = "point-source"
at = [ORIGIN]
interpolation = "linear"
time = { type = "samples", values = "FILE", dt = 0.5 }
"""
CASE = """lattice = { spacing = 0.5, lower = [LOWER], upper = [UPPER]BODY }
model = { type = "wave", kernel = { horizon = 0.5 } }
boundary = { all = { type = "free" } }
run = { until = 1.0 }
"""


def case_of(name: str, dim: int) -> str:
    """Return a case that names a file."""
    body = FILES[name][1]
    ends = {word: ", ".join([value] * dim) for word, value in (("LOWER", "-2.0"), ("UPPER", "2.0"), ("ORIGIN", "0.1"))}
    text = CASE.replace("BODY", f", {body}" if body else "") + ("" if body else SOURCE)
    for word, value in {**ends, "FILE": name}.items():
        text = text.replace(word, value)
    return text


def damaged(data: bytes, rng) -> bytes:
    """Return the content of a file with one to three places damaged."""
    whole = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        if not whole:
            break
        # half of them where formats have their headers
        place = int(rng.integers(min(len(whole), 128) if rng.random() < 0.5 else len(whole)))
        what = rng.random()
        if what < 0.3:
            whole[place] ^= 1 << int(rng.integers(8))
        elif what < 0.4:
            whole[place : place + 8] = rng.bytes(len(whole[place : place + 8]))
        elif what < 0.5:
            del whole[place:]
        elif what < 0.6:
            del whole[place : place + int(rng.integers(1, 20))]
        elif what < 0.7:
            whole[place:place] = whole[place : place + int(rng.integers(1, 40))]
        elif what < 0.75:
            whole[place : place + 4] = rng.choice([b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", bytes(4), b"\0\0\xc0\x7f"])
        else:  # a number in a text
            found = list(re.finditer(rb"[-+]?\d[\d.e+-]*", bytes(whole)))
            if found:
                one = found[int(rng.integers(len(found)))]
                whole[one.start() : one.end()] = str(rng.choice(NUMBERS)).encode()
    return bytes(whole)


def limit_memory() -> None:
    """Let the operating system refuse memory far beyond what is in use, so that it shows as an error."""
    with contextlib.suppress(ImportError):
        import resource

        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, resource.RLIM_INFINITY))


def answer(job):
    """Damage a file, and use it in a case."""
    import farhorizon as fh
    from farhorizon.case.case import Case

    rng = machinery.random_of(job["seed"], job["number"])
    name = str(rng.choice(list(FILES)))
    dim = 3 if name[0] == "t" else 2 if name[0] == "i" else int(rng.integers(1 if name[0] == "s" else 2, 4))
    found = {"file": name, "dim": dim}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path, case = Path(folder, name), Path(folder, "case.toml")
        FILES[name][0](path, rng)
        whole = rng.random() < 0.05
        path.write_bytes(path.read_bytes() if whole else damaged(path.read_bytes(), rng))
        case.write_text(case_of(name, dim))
        said = io.StringIO()
        try:
            with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
                sim = Case.read(case).run()
                sim.run(sim.dt)
            there = np.ones(sim.lattice.shape, bool) if sim.lattice.mask is None else sim.lattice.mask
            finite = all(np.isfinite(values[..., there]).all() for values in sim.fields.values())
            found |= {"class": "accepted"} if finite else {"class": "traceback", "where": f"{name}: not finite"}
        except fh.InputError as error:
            words = str(error)
            found |= {"class": "refused", "where": words[:300]}
            if "\n" in words or said.getvalue():
                found |= {"class": "several lines", "where": f"{name}: {words[:150]}"}
            elif name not in words and not any(part in words for part in ABOUT_OTHERS):
                found |= {"class": "no name", "where": f"{name}: {words[:150]}"}
        except MemoryError as error:
            found |= {"class": "much memory", "where": f"{name}: {machinery.place(error)}"}
        except Exception as error:
            found |= {"class": "traceback", "where": f"{name}: {machinery.place(error)}"}
    return found


def campaign(count, seed, processes, folder, report=print, first=0):
    """Return the number of damaged files by class."""
    jobs = ({"seed": seed, "number": number} for number in range(first, first + count))
    return machinery.table(machinery.answers(Path(__file__), jobs, processes, LIMIT, folder), BAD, folder, report)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--files", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="number of the first file")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--show", type=int, metavar="NUMBER", help="damage this file here and print what is said")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        limit_memory()
        machinery.serve(answer)
    elif options.show is not None:
        print(answer({"seed": machinery.seed_of(options.seed), "number": options.show}))
    else:
        folder = Path(tempfile.mkdtemp(prefix="farhorizon-foreign-"))
        counts = campaign(
            options.files, machinery.seed_of(options.seed), options.processes, folder, first=options.first
        )
        print(f"{folder}: {options.files} files")
        sys.exit(1 if set(BAD) & set(counts) else 0)
