"""Results file and checkpoint: what is written comes back, and damage is told."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from farhorizon.cli import main
from farhorizon.errors import FileFormatError, InputError
from farhorizon.files.results import ResultsWriter, open_results, read_checkpoint, write_checkpoint

SHAPES = {1: (7,), 2: (7, 5), 3: (7, 5, 4)}


def values(dim, dtype, number):
    """An array whose every entry is different, with a nan as outside a window."""
    array = (np.arange(np.prod(SHAPES[dim])) + 100.0 * number + 1 / 3).reshape(SHAPES[dim]).astype(dtype)
    array.flat[2] = np.nan
    return array


def write(path, dim=2, dtype="float64", outputs=3, fields=("u", "v"), **options):
    probes = np.arange(2.0 * dim).reshape(2, dim)
    lower = (-1.5, 2.0, 0.25)[:dim]
    writer = ResultsWriter.create(
        path,
        shape=SHAPES[dim],
        spacing=0.5,
        lower=lower,
        fields=fields,
        dtype=dtype,
        probes=probes,
        case="[lattice] # ä",
        program="fh 0",
        **options,
    )
    for k in range(outputs):
        writer.append_probes(0.4 * k + np.array([0.1, 0.2, 0.3]), np.array([[k, k], [k, 1], [k, -k]]))
        data = {name: (1 + n) * values(dim, dtype, k) for n, name in enumerate(fields)}
        writer.append(10 * k, 0.4 * k, data, 5.0 - k)
    return writer


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_round_trip(tmp_path, dim, dtype):
    writer = write(tmp_path / "a.h5", dim, dtype)
    assert (writer.outputs, writer.rows, writer.records) == (3, 3, 9)
    results = open_results(tmp_path / "a.h5")
    np.testing.assert_array_equal(results.times, [0, 0.4, 0.8])
    np.testing.assert_array_equal(results.steps, [0, 10, 20])
    assert results.field_names == ("u", "v") and results.case == "[lattice] # ä" and results.program == "fh 0"
    for k in range(3):
        assert results.field("v", k).dtype == dtype
        np.testing.assert_array_equal(results.field("u", k), values(dim, dtype, k))
        np.testing.assert_array_equal(results.field("v", k - 3), 2 * values(dim, dtype, k))
    assert [len(axis) for axis in results.axes] == list(SHAPES[dim])
    np.testing.assert_array_equal(results.axes[0], [-1.5, -1, -0.5, 0, 0.5, 1, 1.5])
    np.testing.assert_array_equal(results.probes, np.arange(2.0 * dim).reshape(2, dim))
    np.testing.assert_array_equal(results.history_times, results.times)
    np.testing.assert_allclose(results.probe_times[:4], [0.1, 0.2, 0.3, 0.5])
    np.testing.assert_array_equal(results.probe_values[3:6], [[1, 1], [1, 1], [1, -1]])
    np.testing.assert_array_equal(results.energy, [5, 4, 3])


def test_packed_fields_are_the_same_fields(tmp_path):
    """In a smaller file, which is taken up as others are."""
    plain, packed = (tmp_path / name for name in ("a.h5", "b.h5"))
    for path in (plain, packed):
        writer = ResultsWriter.create(
            path,
            shape=(60, 50),
            spacing=0.5,
            lower=(0, 0),
            fields=("u",),
            dtype="f8",
            components=2,
            compress=path == packed,
        )
        for k in range(3):
            field = np.zeros((2, 60, 50))
            field[:, 20:30, 20:30] = np.random.default_rng(k).normal(size=(2, 10, 10))
            writer.append(k, float(k), {"u": field})
    ResultsWriter.resume(packed, 2).append(2, 2.0, {"u": field})
    for k in range(3):
        np.testing.assert_array_equal(open_results(packed).field("u", k), open_results(plain).field("u", k))
    assert packed.stat().st_size < 0.3 * plain.stat().st_size


def test_provenance_and_units_come_back(tmp_path):
    writer = write(tmp_path / "a.h5", units={"length": "µm"}, provenance={"command": "farhorizon run a.toml"})
    results = open_results(writer.path)
    assert results.units == {"length": "µm"} and results.provenance == {"command": "farhorizon run a.toml"}
    made = results.to_xarray()
    assert made.attrs["command"] == "farhorizon run a.toml" and made["x"].attrs["units"] == "µm"
    assert open_results(write(tmp_path / "b.h5").path).units == {}


def test_balance(tmp_path):
    """Entries of a balance come back by name, in xarray too; rows without one are nan, and resuming cuts them like the
    others.
    """
    names = ["stored", "x-", "residual"]
    writer = ResultsWriter.create(
        tmp_path / "a.h5", shape=(7,), spacing=0.5, lower=(0.0,), fields=("u",), dtype="float64", accounts=names
    )
    for k in range(3):
        writer.append(
            k,
            float(k),
            {"u": np.zeros(7)},
            balance={name: k + 10.0 * i for i, name in enumerate(names)} | {"other": 1.0},
        )
    results = open_results(tmp_path / "a.h5")
    assert list(results.balance) == names
    np.testing.assert_array_equal(results.balance["x-"], [10, 11, 12])
    assert results.to_xarray()["balance"].sel(account="residual").values[-1] == 22
    writer = ResultsWriter.resume(tmp_path / "a.h5", 1)
    writer.append(5, 5.0, {"u": np.zeros(7)}, energy=1.0)
    writer.append(6, 6.0, {"u": np.zeros(7)}, balance=dict.fromkeys(names, 7.0))
    np.testing.assert_array_equal(open_results(tmp_path / "a.h5").balance["stored"], [0, np.nan, 7])
    assert open_results(write(tmp_path / "b.h5").path).balance == {}


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_to_xarray(tmp_path, dim):
    write(tmp_path / "a.h5", dim)
    dataset = open_results(tmp_path / "a.h5").to_xarray()
    assert dataset["u"].dims == ("time", "x", "y", "z")[: dim + 1]
    np.testing.assert_array_equal(dataset["u"].sel(time=0.4), values(dim, "float64", 1))
    assert dataset["energy"].dims == ("history_time",) and dataset["probe_values"].shape == (9, 2)
    assert dataset["probe_x"].values.tolist() == [0.0, float(dim)]
    assert dataset.attrs["case"] == "[lattice] # ä" and dataset.attrs["spacing"] == 0.5


@pytest.mark.parametrize("dim", [2, 3])
def test_vectors(tmp_path, dim):
    """Components come first, in fields, probes and xarray; VTK's three components do not show."""
    data = np.stack([c + values(dim, "float64", 0) for c in range(dim)])
    writer = ResultsWriter.create(
        tmp_path / "a.h5",
        shape=SHAPES[dim],
        spacing=0.5,
        lower=(0.0,) * dim,
        fields=("u",),
        dtype="float64",
        probes=np.zeros((2, dim)),
        components=dim,
    )
    probed = np.arange(2.0 * dim).reshape(2, dim)
    for k in range(3):
        writer.append(k, float(k), {"u": (k + 1) * data}, 1.0)
        writer.append_probes(np.array([float(k)]), k * probed[None])
    with pytest.raises(InputError, match="lattice shape"):
        writer.append(4, 4.0, {"u": data[0]})
    writer = ResultsWriter.resume(tmp_path / "a.h5", 2)
    writer.append(2, 2.0, {"u": 3 * data}, 1.0)
    writer.append_probes(np.array([1.0, 2.0]), np.array([probed, 2 * probed]))
    results = open_results(tmp_path / "a.h5")
    for k in range(3):
        np.testing.assert_array_equal(results.field("u", k), (k + 1) * data)
    np.testing.assert_array_equal(results.probe_values, np.arange(3.0)[:, None, None] * probed)
    dataset = results.to_xarray()
    assert dataset["u"].dims == ("time", "component", "x", "y", "z")[: dim + 2]
    np.testing.assert_array_equal(dataset["u"].sel(time=1.0, component="y"), 2 * data[1])
    assert dataset["probe_values"].sel(component="x").shape == (3, 2)


def test_vectors_beside_scalars(tmp_path):
    """Fields of different width in one file; probes show the vector, also where it is not written."""
    damage = values(2, "float64", 0)
    u = np.stack([damage + 1, damage + 2])
    for fields in (("u", "damage"), ("damage",)):
        writer = ResultsWriter.create(
            tmp_path / "a.h5",
            shape=SHAPES[2],
            spacing=0.5,
            lower=(0.0, 0.0),
            fields=fields,
            dtype="float64",
            probes=np.zeros((1, 2)),
            components={"u": 2, "damage": 1},
        )
        for k in range(2):
            writer.append(k, float(k), {name: {"u": u, "damage": damage}[name] + k for name in fields}, 1.0)
            writer.append_probes(np.array([float(k)]), np.array([[[k, 2.0]]]))
        results = open_results(tmp_path / "a.h5")
        np.testing.assert_array_equal(results.field("damage", 1), damage + 1)
        np.testing.assert_array_equal(results.probe_values[:, 0], [[0, 2], [1, 2]])
        dataset = results.to_xarray()
        assert dataset["damage"].dims == ("time", "x", "y") and dataset["probe_values"].dims == (
            "probe_time",
            "probe",
            "component",
        )
        if "u" in fields:
            np.testing.assert_array_equal(dataset["u"].sel(component="y", time=1.0), u[1] + 1)


def test_without_probes_and_energy(tmp_path):
    writer = ResultsWriter.create(tmp_path / "a.h5", shape=(3,), spacing=1, lower=(0,), fields=("u",), dtype="float64")
    empty = open_results(tmp_path / "a.h5")
    assert empty.times.size == 0 and empty.to_xarray().sizes["time"] == 0
    writer.append(0, 0.0, {"u": np.zeros(3)})
    assert empty.history_times.size == 0 and empty.probe_values.shape == (0, 0)
    writer.append(1, 1.0, {"u": np.ones(3)}, energy=2.0)
    assert empty.energy.tolist() == [2.0] and empty.times.tolist() == [0.0, 1.0]  # the file is read at each access


@pytest.mark.parametrize("kept", [0, 1, 3])
def test_resume_cuts_off(tmp_path, kept):
    write(tmp_path / "a.h5")
    writer = ResultsWriter.resume(tmp_path / "a.h5", kept)
    assert (writer.outputs, writer.rows, writer.records) == (kept, kept, 3 * kept)
    results = open_results(tmp_path / "a.h5")
    np.testing.assert_array_equal(results.steps, [0, 10, 20][:kept])
    assert 3 * results.energy.size == results.probe_times.size == results.probe_values.shape[0] == 3 * kept
    new = {"u": values(2, "float64", 9), "v": values(2, "float64", 8)}
    writer.append(25, 1.0, new, 0.0)
    assert results.steps.tolist() == [*[0, 10, 20][:kept], 25]
    np.testing.assert_array_equal(results.field("u", kept), new["u"])
    with h5py.File(tmp_path / "a.h5") as file:
        assert {d.shape[0] for d in file["VTKHDF/PointData"].values()} == {kept + 1}
        assert file["VTKHDF/Steps/PointDataOffsets/u"][:].tolist() == (list(range(kept + 1)) if kept else [0, 0])


def test_resume_keeps_the_rows_asked_for(tmp_path):
    write(tmp_path / "a.h5")
    assert ResultsWriter.resume(tmp_path / "a.h5", 2, rows=2, records=8).records == 8
    with pytest.raises(FileFormatError, match=r"fewer records.*value: 8; limit: 9"):
        ResultsWriter.resume(tmp_path / "a.h5", 2, records=9)
    with pytest.raises(FileFormatError, match=r"fewer history rows.*value: 2; limit: 3"):
        ResultsWriter.resume(tmp_path / "a.h5", 2, rows=3)
    with pytest.raises(FileFormatError, match=r"a\.h5 holds fewer outputs.*value: 2; limit: 4"):
        ResultsWriter.resume(tmp_path / "a.h5", 4)
    with pytest.raises(InputError):
        ResultsWriter.resume(tmp_path / "a.h5", -1)


def test_half_an_output_does_not_count(tmp_path):
    """An append that was cut short has made the datasets longer, but not the counts."""
    write(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["VTKHDF/PointData/u"].resize(4, axis=0)
        file["farhorizon/history/times"].resize(11, axis=0)
        file["farhorizon/records/times"].resize(11, axis=0)
    results = open_results(tmp_path / "a.h5")
    assert (
        len(results.times) == 3
        and results.history_times.size == 3
        and results.probe_times.size == 9
        and results.to_xarray().sizes["time"] == 3
    )
    ResultsWriter(tmp_path / "a.h5").append(30, 1.2, {"u": np.ones((7, 5)), "v": np.ones((7, 5))})
    assert results.steps.tolist() == [0, 10, 20, 30]


def test_killed_process_leaves_a_valid_file(tmp_path):
    path = tmp_path / "a.h5"
    script = (
        "import sys; import numpy as np; from farhorizon.files.results import ResultsWriter\n"
        "w = ResultsWriter.create(sys.argv[1], shape=(60, 50), spacing=1, lower=(0, 0), fields=('u',), "
        "dtype='float64')\n"
        "for k in range(10**6):\n"
        "    w.append(k, float(k), {'u': np.full((60, 50), float(k))}, float(k)); print(k, flush=True)"
    )
    process = subprocess.Popen([sys.executable, "-c", script, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if int(line) == 20:
            break
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    results = open_results(path)
    assert len(results.times) >= 21
    assert all((results.field("u", k) == k).all() for k in range(len(results.times)))
    assert ResultsWriter.resume(path, 21).outputs == 21


@pytest.mark.parametrize("reader", [open_results, ResultsWriter, read_checkpoint])
def test_foreign_files(tmp_path, reader):
    (tmp_path / "text.h5").write_text("time,u\n0,1\n")
    (tmp_path / "empty.h5").touch()
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["u"] = np.zeros(3)
    for name in ("text.h5", "empty.h5", "other.h5"):
        with pytest.raises(FileFormatError, match=f"{name}.*remedy"):
            reader(tmp_path / name)
    with pytest.raises(InputError, match=r"none\.h5: no such file"):
        reader(tmp_path / "none.h5")


@pytest.mark.parametrize("part", [0.2, 0.5, 0.9, 0.999])
def test_truncated_file(tmp_path, part):
    write(tmp_path / "a.h5")
    write_checkpoint(tmp_path / "c.h5", {"u": np.arange(1000.0)}, {})
    for name, reader in (("a.h5", open_results), ("c.h5", read_checkpoint)):
        data = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(data[: int(part * len(data))])
        with pytest.raises(FileFormatError, match=f"{name} is truncated"):
            reader(tmp_path / name)


def test_damaged_results_are_told_at_the_access(tmp_path):
    write(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file["farhorizon/history/energy"]
        file["VTKHDF/PointData/v"].resize(1, axis=0)
    with pytest.raises(FileFormatError, match="/VTKHDF/PointData/v is too short"):
        open_results(tmp_path / "a.h5")


def test_newer_version(tmp_path):
    write(tmp_path / "a.h5")
    write_checkpoint(tmp_path / "c.h5", {}, {})
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["farhorizon"].attrs["version"] = 99
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        file.attrs["version"] = 99
    for name, reader in (("a.h5", open_results), ("c.h5", read_checkpoint)):
        with pytest.raises(FileFormatError, match=r"value: 99.*update farhorizon"):
            reader(tmp_path / name)


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"dtype": "int32"}, "float32 or float64"),
        ({"dtype": "float16"}, "float32 or float64"),
        ({"shape": (3, 3)}, "one to three entries"),
        ({"shape": (0,)}, "all positive"),
        ({"shape": (1, 1, 1, 1), "lower": (0.0,) * 4}, "one to three entries"),
        ({"spacing": 0.0}, "positive"),
        ({"fields": ("a/b",)}, "'a/b'"),
        ({"fields": ("energy",)}, "energy"),
        ({"fields": ()}, "different names"),
        ({"fields": ("u", "u")}, "different names"),
        ({"probes": np.zeros((2, 3))}, r"\(n, 1\)"),
    ],
)
def test_create_refuses(tmp_path, wrong, match):
    good = {"shape": (3,), "spacing": 1.0, "lower": (0.0,), "fields": ("u",), "dtype": "float64"}
    with pytest.raises(InputError, match=match):
        ResultsWriter.create(tmp_path / "a.h5", **{**good, **wrong})
    assert not (tmp_path / "a.h5").exists()


def test_create_replaces_results_only(tmp_path):
    write(tmp_path / "a.h5", outputs=3)
    write(tmp_path / "a.h5", outputs=1)
    assert len(open_results(tmp_path / "a.h5").times) == 1
    (tmp_path / "thesis.tex").write_text("dear to me")
    with pytest.raises(InputError, match="not overwritten"):
        write(tmp_path / "thesis.tex")
    assert (tmp_path / "thesis.tex").read_text() == "dear to me"
    with pytest.raises(InputError, match="no directory"):
        write(tmp_path / "none" / "a.h5")
    with pytest.raises(InputError, match="is a directory"):
        write(tmp_path)


def test_append_refuses_and_leaves_the_file(tmp_path):
    writer = write(tmp_path / "a.h5")
    good = {"u": np.zeros((7, 5)), "v": np.zeros((7, 5))}
    for arguments, match in [
        ((30, 1.2, {"u": good["u"]}), "every field"),
        ((30, 1.2, {**good, "v": np.zeros((5, 7))}), r"field 'v'.*value: \(5, 7\); limit: \(7, 5\)"),
        ((20, 1.2, good), "value: 20; limit: > 20"),
    ]:
        with pytest.raises(InputError, match=match):
            writer.append(*arguments)
    with pytest.raises(InputError, match="do not match"):
        writer.append_probes(np.zeros(2), np.zeros((2, 3)))
    writer.append_probes(np.zeros(0), np.zeros((0, 2)))
    results = open_results(tmp_path / "a.h5")
    assert len(results.times) == 3 and results.history_times.size == 3
    for name, index in (("w", 0), ("u", 3), ("u", -4)):
        with pytest.raises(InputError):
            results.field(name, index)


def vtk_outputs(path):
    """Times and images as VTK, and so ParaView, reads them."""
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    images = []
    for time in times:
        reader.UpdateTimeStep(time)
        images.append(vtkImageData())
        images[-1].DeepCopy(reader.GetOutput())
    return times, images


def assert_same(results, index, image):
    """Every node of an output has its place and its values in VTK's image too."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    assert image.GetDimensions() == (*results.shape, 1, 1)[:3]
    for name in results.field_names:
        array = vtk_to_numpy(image.GetPointData().GetArray(name))
        field = results.field(name, index)
        assert array.size == field.size and array.dtype == field.dtype
        for node in np.ndindex(field.shape):
            place = [axis[i] for axis, i in zip(results.axes, node, strict=True)] + [0.0] * (3 - results.dim)
            number = image.FindPoint(place)
            # round-off of origin + i spacing
            np.testing.assert_allclose(image.GetPoint(number), place, rtol=0, atol=1e-12)
            np.testing.assert_array_equal(array[number], field[node])


@pytest.mark.slow
@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_vtk_reads_the_file(tmp_path, dim, dtype, compress):
    write(tmp_path / "a.h5", dim, dtype, compress=compress)
    results = open_results(tmp_path / "a.h5")
    times, images = vtk_outputs(tmp_path / "a.h5")
    assert tuple(times) == tuple(results.times)
    for k, image in enumerate(images):
        assert_same(results, k, image)


def test_vtk_reads_vectors(tmp_path):
    """Point data of three components, x fastest, the third one zero in the plane."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    data = np.random.default_rng(1).standard_normal((2, 7, 5))
    writer = ResultsWriter.create(
        tmp_path / "a.h5", shape=(7, 5), spacing=0.5, lower=(0, 0), fields=("u",), dtype="float64", components=2
    )
    for k in range(2):
        writer.append(k, float(k), {"u": (k + 1) * data})
    for k, image in enumerate(vtk_outputs(tmp_path / "a.h5")[1]):
        read = vtk_to_numpy(image.GetPointData().GetArray("u")).reshape(5, 7, 3)
        np.testing.assert_array_equal(read[..., :2].T, (k + 1) * data)
        assert not read[..., 2].any()


@pytest.mark.slow
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_vtk_reads_a_single_output(tmp_path, dim):
    """Both a new file with one output and one that was cut back to one; VTK lists the output twice."""
    write(tmp_path / "new.h5", dim, outputs=1)
    write(tmp_path / "cut.h5", dim, outputs=3)
    ResultsWriter.resume(tmp_path / "cut.h5", 1)
    for name in ("new.h5", "cut.h5"):
        results = open_results(tmp_path / name)
        times, images = vtk_outputs(tmp_path / name)
        assert set(times) == set(results.times) == {0.0}
        assert_same(results, 0, images[0])


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(4, 1), (1, 4), (4, 3, 1), (1, 4, 3)])
def test_vtk_reads_axes_of_one_node(tmp_path, shape):
    lower = (0.0,) * len(shape)
    writer = ResultsWriter.create(
        tmp_path / "a.h5", shape=shape, spacing=1, lower=lower, fields=("u",), dtype="float64"
    )
    for k in range(2):
        writer.append(k, float(k), {"u": k + np.arange(np.prod(shape)).reshape(shape)})
    results = open_results(tmp_path / "a.h5")
    for k, image in enumerate(vtk_outputs(tmp_path / "a.h5")[1]):
        assert_same(results, k, image)


def checkpoint_arrays():
    rng = np.random.default_rng(1)
    return {
        "u": rng.standard_normal((4, 5, 6)),
        "boundary/x-/memory": rng.standard_normal(7).astype("float32"),
        "broken": np.array([True, False, True]),
        "step": np.array(12),
        "modes": rng.standard_normal(3) + 1j,
        "none": np.zeros((0, 3)),
        "transposed": np.asfortranarray(rng.standard_normal((3, 4))),
        "nan": np.array([np.nan, -0.0, np.inf]),
    }


def test_checkpoint_round_trip(tmp_path):
    arrays, meta = checkpoint_arrays(), {"outputs": 3, "case": "ä", "dt": 0.1 + 0.2, "nested": {"a": [1, None, True]}}
    write_checkpoint(tmp_path / "c.h5", {"old": np.zeros(3)}, {})
    write_checkpoint(tmp_path / "c.h5", arrays, meta)
    back, meta_back = read_checkpoint(tmp_path / "c.h5")
    assert meta_back == meta and list(back) == list(arrays)
    for name, array in arrays.items():
        assert back[name].dtype == array.dtype and back[name].shape == array.shape
        assert back[name].tobytes() == array.tobytes()
    assert [p.name for p in tmp_path.iterdir()] == ["c.h5"]


def test_failed_checkpoint_keeps_the_old_one(tmp_path, monkeypatch):
    write_checkpoint(tmp_path / "c.h5", {"u": np.ones(3)}, {"step": 1})

    def full(*_args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="No space"):
        write_checkpoint(tmp_path / "c.h5", {"u": np.zeros(3)}, {"step": 2})
    assert read_checkpoint(tmp_path / "c.h5")[1] == {"step": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["c.h5"]


def test_checkpoint_refuses(tmp_path):
    with pytest.raises(InputError, match="does not hold numbers"):
        write_checkpoint(tmp_path / "c.h5", {"u": np.array(["a", None], dtype=object)}, {})
    with pytest.raises(InputError, match="meta is not JSON"):
        write_checkpoint(tmp_path / "c.h5", {}, {"a": np.zeros(3)})
    with pytest.raises(InputError, match="no directory"):
        write_checkpoint(tmp_path / "none" / "c.h5", {}, {})
    assert list(tmp_path.iterdir()) == []


def test_incomplete_checkpoint(tmp_path):
    write_checkpoint(tmp_path / "c.h5", {"u": np.ones(3)}, {})
    with h5py.File(tmp_path / "c.h5", "r+") as file:
        file.attrs.modify("complete", False)
    with pytest.raises(FileFormatError, match="incomplete"):
        read_checkpoint(tmp_path / "c.h5")


def test_any_flipped_byte_is_told_or_harmless(tmp_path):
    """Damage anywhere: either FileFormatError, or (in padding) everything comes back as it was."""
    path: Path = tmp_path / "c.h5"
    arrays = checkpoint_arrays()
    write_checkpoint(path, arrays, {"step": 12})
    data = path.read_bytes()
    told = 0
    for place in np.random.default_rng(2).integers(len(data), size=300):
        damaged = bytearray(data)
        damaged[place] ^= 0xFF
        path.write_bytes(damaged)
        try:
            back, meta = read_checkpoint(path)
        except FileFormatError:
            told += 1
        else:
            assert meta == {"step": 12} and all(
                back[name].tobytes() == array.tobytes() for name, array in arrays.items()
            )
    assert told > 0


def test_damaged_number_in_an_array(tmp_path):
    array = np.random.default_rng(3).standard_normal(1000)
    write_checkpoint(tmp_path / "c.h5", {"u": array}, {})
    data = bytearray((tmp_path / "c.h5").read_bytes())
    data[data.index(array.tobytes()) + 4321] ^= 1
    (tmp_path / "c.h5").write_bytes(data)
    with pytest.raises(FileFormatError, match="array 'u' fails its check sum"):
        read_checkpoint(tmp_path / "c.h5")


def test_one_count_too_many_is_not_counted(tmp_path):
    """As HDF5 alone leaves a file that was killed between two of its writes: what is held counts, for readers and
    writers.
    """
    write(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["farhorizon"].attrs["outputs"] = 4
        file["farhorizon/history"].attrs["rows"] = 4
        file["farhorizon/records"].attrs["rows"] = 12
        file["VTKHDF/PointData/u"].resize(4, axis=0)
    results = open_results(tmp_path / "a.h5")
    assert len(results.times) == 3 and results.energy.size == 3 and results.probe_times.size == 9
    writer = ResultsWriter.resume(tmp_path / "a.h5", 3)
    writer.append(30, 1.2, {"u": np.ones((7, 5)), "v": np.ones((7, 5))})
    assert results.steps.tolist() == [0, 10, 20, 30] and (results.field("u", 3) == 1).all()


def test_finished_is_noted_and_taken_back(tmp_path):
    writer = write(tmp_path / "a.h5")
    assert not open_results(writer.path).finished
    writer.finish()
    assert open_results(writer.path).finished
    ResultsWriter.resume(writer.path, 2)
    assert not open_results(writer.path).finished


def contents(path):
    """All that a results file tells."""
    results = open_results(path)
    fields = [results.field(name, k).tobytes() for name in results.field_names for k in range(len(results.times))]
    columns = [
        a.tobytes() for a in (results.times, results.steps, results.energy, results.probe_values, results.probes)
    ]
    return (
        fields,
        columns,
        results.case,
        results.program,
        results.shape,
        results.spacing,
        results.lower,
        results.components,
    )


@pytest.mark.sampled(2)
@pytest.mark.parametrize("compress", [False, True])
def test_any_flipped_bit_of_results_is_told_or_harmless(tmp_path, compress):
    """Damage anywhere: FileFormatError, or (in padding) everything is read as it was."""
    path = write(tmp_path / "a.h5", compress=compress).path
    data, good, told = path.read_bytes(), contents(path), 0
    rng = np.random.default_rng(4)
    for place in rng.integers(len(data), size=120):
        damaged = bytearray(data)
        damaged[place] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            assert contents(path) == good, f"bit at byte {place}"
        except FileFormatError:
            told += 1
    assert told > 10


def test_a_flipped_bit_of_a_field_is_told_with_file_and_dataset(tmp_path):
    path = write(tmp_path / "a.h5").path
    data = bytearray(path.read_bytes())
    place = data.index(values(2, "float64", 1).T.tobytes())
    data[place + 100] ^= 1
    path.write_bytes(data)
    results = open_results(path)
    np.testing.assert_array_equal(results.field("u", 0), values(2, "float64", 0))
    with pytest.raises(FileFormatError, match=r"a\.h5 is damaged: VTKHDF/PointData/u fails its check sum"):
        results.field("u", 1)


@pytest.mark.parametrize("kind", ["external data", "external link", "soft link", "virtual"])
def test_what_stands_in_other_files_is_refused(tmp_path, kind):
    """A results file may come from anybody: what it refers to is not read, nor are links of a checkpoint followed."""
    path = write(tmp_path / "a.h5", dim=1).path
    secret = tmp_path / "secret"
    secret.write_bytes(b"root:x:0:0" * 100)
    write_checkpoint(tmp_path / "c.ckpt", {"u": np.zeros(3)}, {})
    for name, place in ((path, "VTKHDF/PointData/u"), (tmp_path / "c.ckpt", "arrays/0")):
        with h5py.File(name, "r+") as file:
            del file[place]
            if kind == "external data":
                file.create_dataset(place, (3, 7), "f8", external=[(str(secret), 0, h5py.h5f.UNLIMITED)])
            elif kind == "external link":
                file[place] = h5py.ExternalLink(str(path), "/farhorizon/probes")
            elif kind == "soft link":
                file[place] = h5py.SoftLink("/farhorizon/probes")
            else:
                layout = h5py.VirtualLayout((3, 7), "f8")
                layout[:] = h5py.VirtualSource(str(path), "u", (3, 7))
                file.create_virtual_dataset(place, layout)
    for reader in (open_results, ResultsWriter):
        with pytest.raises(FileFormatError, match=r"a\.h5.*refers to another"):
            reader(path)
    with pytest.raises(FileFormatError, match=r"c\.ckpt.*refers to another"):
        read_checkpoint(tmp_path / "c.ckpt")


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
@pytest.mark.parametrize(
    ("mode", "action"), [(0o000, "open_results"), (0o000, "ResultsWriter"), (0o444, "write"), (0o000, "write")]
)
def test_missing_permission_is_an_input_error(mode, action):
    """By a user whom permissions bind."""
    with tempfile.TemporaryDirectory() as folder:  # others have no way to pytest's
        os.chmod(folder, 0o777)
        path = write(Path(folder) / "a.h5", dim=1).path
        os.chmod(path, mode)
        assert without_privileges(lambda: refused(action, path)) == 0


def refused(action, path):
    with pytest.raises(InputError, match="permission denied"):
        {"open_results": open_results, "ResultsWriter": ResultsWriter, "write": lambda p: write(p, dim=1)}[action](path)


def without_privileges(function):
    """Exit code of a child that runs a function as a user whom permissions bind: 0, or 1 if it raised."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            if os.getuid() == 0:
                os.setgid(65534)
                os.setuid(65534)
            function()
            code = 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def test_no_text_is_kept_where_hdf5_has_no_check_sum(tmp_path):
    """Texts of variable length lie in a heap without one: a flipped bit there made HDF5 hang or crash."""
    case = (
        'lattice = { spacing = 0.5, lower = [-2.0], upper = [2.0] }\nmodel = { type = "wave", kernel = { horizon = '
        "1.0 } }\n"
    )
    case += 'boundary = { all = { type = "fixed" } }\nrun = { until = 2.0 }\noutput = { probes = [[0.0]] }\n'
    (tmp_path / "a.toml").write_text(case)
    assert main(["run", str(tmp_path / "a.toml"), "--out", str(tmp_path), "--keep-checkpoint"]) == 0
    for name in ("a.h5", "a.ckpt"):
        assert b"GCOL" not in (tmp_path / name).read_bytes()  # the mark of such a heap
