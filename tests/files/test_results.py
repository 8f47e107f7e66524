"""Results files: what is written is read back, by us, xarray and VTK, and damage is reported."""

import warnings

import h5py
import numpy as np
import pytest

from farhorizon.errors import FileFormatError, InputError, ValidityWarning
from farhorizon.files.results import open_results
from farhorizon.files.results_writer import ResultsWriter

SHAPES = {1: (7,), 2: (7, 5), 3: (7, 5, 4)}


def values(dim, dtype, number):
    """Return an array whose entries all differ, with a nan as outside a window."""
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
    """Their file is smaller, and is resumed like any other."""
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
    """Entries of a balance are read back by name, also in xarray; rows without one are nan, and resuming truncates
    them like the others.
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
    """Components come first in fields, probes and xarray; the three components of VTK are not visible."""
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
    """Fields of different width in one file; probes record the vector even if it is not written as a field."""
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


def test_an_output_that_is_no_number_is_not_called_damage(tmp_path):
    write(tmp_path / "a.h5")
    with pytest.raises(InputError, match="index: must be a whole number") as error:
        open_results(tmp_path / "a.h5").field("v", "last")
    assert not isinstance(error.value, FileFormatError)


def test_damaged_results_are_told_at_the_access(tmp_path):
    write(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file["farhorizon/history/energy"]
        file["VTKHDF/PointData/v"].resize(1, axis=0)
    with pytest.raises(FileFormatError, match="/VTKHDF/PointData/v is too short"):
        open_results(tmp_path / "a.h5")


def vtk_outputs(path):
    """Return times and images as VTK, and hence ParaView, reads them."""
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
    """Check that every node of an output has the same position and values in VTK's image."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    assert image.GetDimensions() == (*results.shape, 1, 1)[:3]
    for name in results.field_names:
        array = vtk_to_numpy(image.GetPointData().GetArray(name))
        field = results.field(name, index)
        assert array.size == field.size and array.dtype == field.dtype
        for node in np.ndindex(field.shape):
            place = [axis[i] for axis, i in zip(results.axes, node, strict=True)] + [0.0] * (3 - results.dim)
            number = image.FindPoint(place)
            # rounding of origin + i spacing
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
    """Point data have three components, x fastest, and the third is zero in 2D."""
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
    """A new file with one output, and one that was truncated to one; VTK lists the output twice."""
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


def contents(path):
    """Return everything that a results file contains."""
    results = open_results(path, verify=False)
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
    """Damage anywhere gives a FileFormatError, or (in padding) everything is read as it was."""
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
            with warnings.catch_warnings(), pytest.raises((FileFormatError, ValidityWarning)):
                warnings.simplefilter("error")
                open_results(path)
    assert told > 10


def test_a_flipped_bit_of_a_field_is_told_with_file_and_dataset(tmp_path):
    path = write(tmp_path / "a.h5").path
    data = bytearray(path.read_bytes())
    place = data.index(values(2, "float64", 1).T.tobytes())
    data[place + 100] ^= 1
    path.write_bytes(data)
    with pytest.warns(ValidityWarning, match=r"a\.h5 is damaged.* cannot be read: VTKHDF/PointData/u\[1\]; remedy"):
        results = open_results(path)
    np.testing.assert_array_equal(results.field("u", 0), values(2, "float64", 0))
    with pytest.raises(FileFormatError, match=r"a\.h5 is damaged: VTKHDF/PointData/u fails its check sum"):
        results.field("u", 1)
