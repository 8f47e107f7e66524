"""Results files in parts, as several processes write them: read as one file, by us and by VTK, and merged into one."""

import itertools
import shutil

import h5py
import numpy as np
import pytest

from farhorizon.cli import main
from farhorizon.errors import FileFormatError, InputError, ValidityWarning
from farhorizon.files.parts import folder_of, part_path
from farhorizon.files.results import open_results
from farhorizon.files.results_writer import ResultsWriter

CUTS = {1: ([0, 3, 7],), 2: ([0, 4, 7], [0, 2, 5]), 3: ([0, 3, 7], [0, 5], [0, 2, 4])}


def boxes_of(dim):
    """Return all boxes of a small lattice."""
    along = [list(itertools.pairwise(ends)) for ends in CUTS[dim]]
    return list(itertools.product(*along))


def field(dim, output, vector):
    """Return a field whose entries all differ."""
    shape = (dim,) * vector + tuple(ends[-1] for ends in CUTS[dim])
    return np.arange(np.prod(shape)).reshape(shape) / 7 + output


def written(path, dim, outputs=3, parts=True, vector=False, **options):
    """Write a file with some outputs, in parts or whole, and return its writers, that of the whole last."""
    boxes = boxes_of(dim) if parts else []
    shape = tuple(ends[-1] for ends in CUTS[dim])
    given = {
        "spacing": 0.5,
        "fields": ("u", "w"),
        "dtype": "float64",
        "components": {"u": dim if vector else 1, "w": 1},
    }
    given |= options
    lower = np.array([-1.5, 2.0, 0.25][:dim])
    whole = ResultsWriter.create(
        path, shape=shape, lower=lower, probes=lower[None], boxes=boxes, case="x = 1", program="fh 0", **given
    )
    every = []
    for number, box in enumerate(boxes):
        first, last = np.array(box).T
        part = ResultsWriter.create(
            part_path(path, number), shape=tuple(last - first), lower=lower + 0.5 * first, program="fh 0", **given
        )
        every.append((box, part))
    writers = [*every, (None, whole)]
    for k in range(outputs):
        append(writers, dim, k, vector)
    whole.finish()
    return writers


def append(writers, dim, k, vector=False):
    fields = {"u": field(dim, k, vector), "w": -field(dim, k, False)}
    for box, part in writers[:-1]:
        place = (..., *(slice(*ends) for ends in box))
        part.append(10 * k, 0.4 * k, {name: values[place] for name, values in fields.items()})
    whole = writers[-1][1]
    whole.append_probes(np.array([0.4 * k]), np.ones((1, *whole._layout.probe_shape)))
    whole.append(10 * k, 0.4 * k, fields if whole.whole else {}, energy=5.0 - k)


def content(path):
    """Return all datasets and attributes of a file."""
    found = {}

    def look(name, item):
        found[name, "attributes"] = {key: np.asarray(value).tolist() for key, value in item.attrs.items()}
        if isinstance(item, h5py.Dataset):
            values = item[()]
            found[name] = values.dtype, values.shape, values.tobytes(), item.chunks, item.compression, item.fletcher32

    with h5py.File(path) as file:
        file.visititems(look)
        look("/", file)
    return found


@pytest.mark.parametrize(("dim", "vector"), [(1, False), (2, False), (2, True), (3, True)])
def test_parts_are_read_as_one_and_merged(tmp_path, dim, vector):
    """The merged file equals the one that is written whole, to the last byte of every dataset."""
    written(tmp_path / "a.h5", dim, vector=vector, compress=dim == 2)
    written(tmp_path / "whole.h5", dim, parts=False, vector=vector, compress=dim == 2)
    results, whole = open_results(tmp_path / "a.h5"), open_results(tmp_path / "whole.h5")
    for k in range(3):
        for name in ("u", "w"):
            np.testing.assert_array_equal(results.field(name, k), whole.field(name, k))
    assert results.to_xarray().equals(whole.to_xarray()) and results.finished
    assert main(["merge", str(tmp_path / "a.h5")]) == 0
    assert content(tmp_path / "a-merged.h5") == content(tmp_path / "whole.h5")
    assert main(["merge", str(tmp_path / "whole.h5"), "-o", str(tmp_path / "copy.h5")]) == 0
    assert content(tmp_path / "copy.h5") == content(tmp_path / "whole.h5")


@pytest.mark.parametrize(("dim", "vector"), [(1, False), (2, True), (3, False)])
def test_parts_are_cut_anew(tmp_path, dim, vector):
    """For other boxes, some of a single node along an axis, as when other processes continue a run."""
    written(tmp_path / "a.h5", dim, vector=vector)
    written(tmp_path / "whole.h5", dim, parts=False, vector=vector)
    results, folder = open_results(tmp_path / "a.h5"), tmp_path / ".a.h5.cut"
    boxes = list(itertools.product(*[[(0, 1), (1, ends[-1])] for ends in CUTS[dim]]))
    folder.mkdir()
    for number, box in enumerate(boxes):
        results.cut(folder / part_path(tmp_path / "a.h5", number).name, box, 3)
    results.take_parts(boxes, folder)
    open_results(tmp_path / "a.h5").merge(tmp_path / "merged.h5")
    assert content(tmp_path / "merged.h5") == content(tmp_path / "whole.h5")


@pytest.mark.parametrize("outputs", [1, 3])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_vtk_reads_parts_as_one(tmp_path, dim, outputs):
    """This holds even while a part has one output more than the whole."""
    pytest.importorskip("vtkmodules")
    from test_results import vtk_outputs
    from vtkmodules.util.numpy_support import vtk_to_numpy

    writers = written(tmp_path / "a.h5", dim, outputs)
    box, first = writers[0]
    place = tuple(slice(*ends) for ends in box)
    first.append(100, 9.0, {"u": field(dim, 9, False)[place], "w": field(dim, 9, False)[place]})
    times, images = vtk_outputs(tmp_path / "a.h5")
    np.testing.assert_allclose(times[:outputs], 0.4 * np.arange(outputs))
    for k in range(outputs):
        array = vtk_to_numpy(images[k].GetPointData().GetArray("u"))
        np.testing.assert_array_equal(array, field(dim, k, False).T.ravel())
    assert len(open_results(tmp_path / "a.h5").times) == outputs


def test_a_file_in_parts_is_taken_up(tmp_path):
    path = tmp_path / "a.h5"
    writers = written(path, 2)
    again = [(box, ResultsWriter.resume(one.path, 1)) for box, one in writers]
    append(again, 2, 1)
    assert open_results(path).steps.tolist() == [0, 10]
    np.testing.assert_array_equal(open_results(path).field("u", 1), field(2, 1, False))
    [ResultsWriter.resume(one.path, 0) for _, one in writers]
    assert len(open_results(path).times) == 0


def test_parts_belong_to_their_file(tmp_path):
    """They are removed when another run replaces the file; missing and foreign parts are reported."""
    path = tmp_path / "a.h5"
    written(path, 2)
    assert len(list(folder_of(path).iterdir())) == 4
    shutil.copytree(tmp_path, tmp_path / "moved", ignore=lambda *_: ["moved"])
    np.testing.assert_array_equal(open_results(tmp_path / "moved" / "a.h5").field("w", 1), -field(2, 1, False))
    written(path, 1)
    assert [one.name for one in sorted(folder_of(path).iterdir())] == ["0000.h5", "0001.h5"]
    shutil.copy(tmp_path / "moved" / "a.h5.parts" / "0001.h5", part_path(path, 1))
    with pytest.raises(FileFormatError, match="is no part of"):
        open_results(path).field("u")
    part_path(path, 1).unlink()
    with pytest.raises(FileFormatError, match=r"lacks its part .*0001.h5.*keep the folder a.h5.parts"):
        open_results(path).field("u")
    written(path, 1, parts=False)
    assert not folder_of(path).exists()


def test_damage_in_a_part_is_told_when_the_whole_is_opened(tmp_path):
    path = tmp_path / "a.h5"
    written(path, 2)
    assert open_results(path).damaged() == []
    part = part_path(path, 2)
    data = bytearray(part.read_bytes())
    [first, last], [low, high] = boxes_of(2)[2]
    place = data.index(field(2, 1, False)[first:last, low:high].T.tobytes())
    data[place] ^= 4
    part.write_bytes(data)
    with pytest.warns(ValidityWarning, match=r"cannot be read: 0002\.h5: VTKHDF/PointData/u\[1\]"):
        results = open_results(path)
    assert np.isfinite(results.field("u", 0)).all()
    with pytest.raises(FileFormatError, match=r"0002\.h5 is damaged"):
        results.field("u", 1)


def test_what_is_no_part_is_not_read(tmp_path):
    """A renamed file refers to parts of another one, the file of the whole accepts no fields, and nothing merges into
    itself.
    """
    path = tmp_path / "a.h5"
    (_, whole) = written(path, 2)[-1]
    with pytest.raises(InputError, match="an output has every field of the file, no other"):
        whole.append(100, 9.0, {"u": field(2, 0, False), "w": field(2, 0, False)})
    with pytest.raises(InputError, match="cannot take its own place"):
        open_results(path).merge(path)
    path.rename(tmp_path / "b.h5")
    with pytest.raises(FileFormatError, match=r"refers to another place or file.*keeps its name"):
        open_results(tmp_path / "b.h5")
