"""Damaged files of other programs: one line, with the name of the file."""

import sys
import tracemalloc

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.files.foreign import naming, npy, reading


def _npy(header, data=bytes(64)):
    """An NPY file with any header."""
    words = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(words).to_bytes(2, "little") + words + data


SOUND = "{'descr': '<f8', 'fortran_order': False, 'shape': (8,), }"
DAMAGED_NPY = {
    "no end of the header": SOUND[:-2],
    "a key that is missing": "{'descr': '<f8', 'shape': (8,), }",
    "a type that is none": SOUND.replace("<f8", "<q8"),
    "Python objects": SOUND.replace("<f8", "|O"),
    "more data than there are": SOUND.replace("(8,)", "(100000, 100000)"),
    "a negative size": SOUND.replace("8,", "-8,"),
}


@pytest.mark.parametrize("header", DAMAGED_NPY.values(), ids=DAMAGED_NPY)
@pytest.mark.parametrize("taken", [lambda path: fh.Voxels(path, 1.0), lambda path: fh.Samples(path, 1.0)])
def test_damaged_arrays(header, taken, tmp_path):
    path = tmp_path / "an array.npy"
    path.write_bytes(_npy(header))
    with pytest.raises(fh.InputError, match=r"an array\.npy") as caught:
        taken(path)
    assert "\n" not in str(caught.value)


def test_sound_arrays(tmp_path):
    for values in (np.arange(8.0), np.asfortranarray(np.arange(12).reshape(3, 4)), np.array([True, False])):
        np.save(tmp_path / "a.npy", values)
        found = npy(tmp_path / "a.npy")
        assert type(found) is np.ndarray and found.dtype == values.dtype
        np.testing.assert_array_equal(found, values)


def test_a_header_asks_for_no_memory(tmp_path):
    """8 GB are promised, 64 bytes are there."""
    path = tmp_path / "bomb.npy"
    path.write_bytes(_npy(SOUND.replace("8,", "1000000000,")))
    tracemalloc.start()
    with pytest.raises(fh.FileFormatError):
        fh.Samples(path, 1.0)
    assert tracemalloc.get_traced_memory()[1] < 1e8
    tracemalloc.stop()


@pytest.mark.parametrize("error", [KeyError(273), IndexError("3"), TypeError("no"), MemoryError(), SystemExit(1)])
def test_whatever_a_reader_raises(error, tmp_path, capsys):
    path = tmp_path / "a.vtk"
    path.touch()
    with pytest.raises(fh.FileFormatError, match=r"cannot read the mesh .*a\.vtk: it is damaged"):
        with reading(path, "the mesh", "mesh", "export it anew"):
            print("several\nlines", file=sys.stderr)
            raise error
    assert capsys.readouterr() == ("", "")


def test_an_interrupt_is_none_of_them(tmp_path):
    path = tmp_path / "a.vtk"
    path.touch()
    with pytest.raises(KeyboardInterrupt), reading(path, "the mesh", "mesh", ""):
        raise KeyboardInterrupt


def test_errors_about_the_content_name_the_file():
    with pytest.raises(fh.InputError, match=r"samples: all are zero \(in the file a\.txt\); value: 0; limit: 1"):
        with naming("a.txt"):
            raise fh.InputError("all are zero", value=0, limit=1, key="samples")
    with pytest.raises(fh.InputError, match=r"^samples: all are zero$"), naming([0.0]):
        raise fh.InputError("all are zero", key="samples")


def test_numbers_of_points_that_a_mesh_lacks(tmp_path):
    """The reader takes them, and they were indices out of range."""
    path = tmp_path / "damaged.vtk"
    path.write_text(
        "# vtk DataFile Version 4.2\nx\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 3 double\n0 0 0 1 0 0 0 1 0\n"
        "CELLS 1 4\n3 0 1 7\nCELL_TYPES 1\n5\n"
    )
    pytest.importorskip("meshio")
    with pytest.raises(fh.InputError, match=r"numbers of points.*damaged\.vtk"):
        fh.Elements(path)
