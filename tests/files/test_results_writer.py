"""Writing of results files: resumed, appended to, killed while writing; what is refused."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from test_results import values, write

from farhorizon.errors import FileFormatError, InputError
from farhorizon.files.results import open_results
from farhorizon.files.results_writer import ResultsWriter


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
    """An interrupted append has made the datasets longer, but has not changed the counts."""
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
        "import sys; import numpy as np; from farhorizon.files.results_writer import ResultsWriter\n"
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


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ({"fields": ("a/b",)}, "'a/b'"),
        ({"fields": ("energy",)}, "energy"),
        ({"fields": ()}, "different names"),
        ({"fields": ("u", "u")}, "different names"),
        ({"components": 4}, "up to three components"),
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


def test_one_count_too_many_is_not_counted(tmp_path):
    """HDF5 alone leaves such a file when it is killed between two writes: readers and writers use what is stored."""
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


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
@pytest.mark.parametrize(
    ("mode", "action"), [(0o000, "open_results"), (0o000, "ResultsWriter"), (0o444, "write"), (0o000, "write")]
)
def test_missing_permission_is_an_input_error(mode, action):
    """The test runs as an unprivileged user."""
    with tempfile.TemporaryDirectory() as folder:  # others have no access to pytest's
        os.chmod(folder, 0o777)
        path = write(Path(folder) / "a.h5", dim=1).path
        os.chmod(path, mode)
        assert without_privileges(lambda: refused(action, path)) == 0


def refused(action, path):
    with pytest.raises(InputError, match="permission denied"):
        {"open_results": open_results, "ResultsWriter": ResultsWriter, "write": lambda p: write(p, dim=1)}[action](path)


def without_privileges(function):
    """Return the exit code of a child that runs a function as an unprivileged user: 0, or 1 if it raised."""
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
