"""Writing of files: a process that dies at any point, a full disk, two processes at once."""

import errno
import os
import subprocess
import sys

import numpy as np
import pytest

import farhorizon as fh
from farhorizon.files import storage
from farhorizon.files.checkpoint_format import read_checkpoint, write_checkpoint
from farhorizon.files.results import open_results
from farhorizon.files.results_writer import ResultsWriter

SHAPE = (40, 30)


def begun(path, outputs=2):
    """Return the writer of a results file with some outputs, each filled with its number."""
    writer = ResultsWriter.create(
        path, shape=SHAPE, spacing=1.0, lower=(0, 0), fields=("u", "v"), dtype="float64", probes=np.zeros((2, 2))
    )
    for _ in range(outputs):
        append(writer)
    return writer


def append(writer):
    k = writer.outputs
    writer.append_probes(np.array([float(k)]), np.full((1, 2), k))
    writer.append(k, float(k), {"u": np.full(SHAPE, float(k)), "v": np.full(SHAPE, -1.0 - k)}, energy=1.0 + k)


def whole(path):
    """Return the number of outputs of a results file, after checking all its values."""
    results = open_results(path)
    count = len(results.times)
    for k in range(count):
        assert (results.field("u", k) == k).all() and (results.field("v", k) == -1 - k).all()
    np.testing.assert_array_equal(results.energy, 1 + np.arange(count))
    records = results.probe_values[:, 1]  # written before their output
    np.testing.assert_array_equal(records, np.arange(len(records)))
    assert count <= len(records) <= count + 1
    return count


def in_child(function):
    """Return the exit code of a forked process that runs a function; 99 if it raised, minus the signal if it died."""
    child = os.fork()
    if child == 0:
        code = 99
        try:
            function()
            code = 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def dying(number, function):
    """Run a function, and end the process in place of its call `number` of the functions that change files."""
    calls = [0]

    def counted(call):
        def instead(*arguments, **options):
            calls[0] += 1
            if calls[0] == number:
                if call is os.write:  # half of the data is written
                    os.pwrite(
                        arguments[0], arguments[1][: len(arguments[1]) // 2], os.lseek(arguments[0], 0, os.SEEK_CUR)
                    )
                os._exit(42)
            return call(*arguments, **options)

        return instead

    for name in ("write", "replace", "truncate", "ftruncate", "unlink", "fsync"):
        setattr(os, name, counted(getattr(os, name)))
    function()


def every_death(function):
    """End `function` at its first call that changes a file, then at the second, and so on, and yield the numbers of
    these calls until it runs to its end.
    """
    number = 1
    while (code := in_child(lambda: dying(number, function))) == 42:  # noqa: B023
        yield number
        number += 1
    assert code == 0 and number > 3


def test_an_append_that_dies_anywhere_is_there_or_not(tmp_path):
    """The file can be read, resumed and appended to, wherever the process ended, even within a write."""
    path = tmp_path / "a.h5"
    begun(path)
    before = path.read_bytes()
    counts = set()
    for _ in every_death(lambda: append(ResultsWriter(path))):
        counts.add(whole(path))  # a reader takes a journal into account
        writer = ResultsWriter.resume(path, 2)
        append(writer)
        append(ResultsWriter(path))
        assert whole(path) == 4
        storage.remove_leftovers(path)
        assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]
        path.write_bytes(before)
    assert counts == {2, 3}


@pytest.mark.slow
def test_a_creation_or_a_checkpoint_that_dies_anywhere_leaves_the_old_one_or_the_new(tmp_path):
    path = tmp_path / "a.h5"
    begun(path)
    before, seen = path.read_bytes(), set()
    for _ in every_death(lambda: begun(path, 0)):
        seen.add(whole(path))
        path.write_bytes(before)
    assert seen == {0, 2}
    path, seen = tmp_path / "a.ckpt", set()
    write_checkpoint(path, {"u": np.zeros(1000)}, {"old": True})
    for _ in every_death(lambda: write_checkpoint(path, {"u": np.ones(1000)}, {"old": False})):
        arrays, meta = read_checkpoint(path)
        assert (arrays["u"] == (0 if meta["old"] else 1)).all()
        seen.add(meta["old"])
        write_checkpoint(path, {"u": np.zeros(1000)}, {"old": True})
    assert seen == {True, False}


def test_a_creation_over_an_interrupted_append_is_not_touched_by_it_later(tmp_path):
    """The journal of the old file is removed before the new file is in place."""
    path = tmp_path / "a.h5"
    begun(path)
    for _ in every_death(lambda: append(ResultsWriter(path))):
        if (tmp_path / ".a.h5.journal").exists():
            break
    begun(path, 1)
    append(ResultsWriter(path))
    assert whole(path) == 2


@pytest.mark.parametrize("room", [0, 100, 2_000, 9_000, 19_000])
def test_a_full_disk_is_an_error_and_leaves_the_file(tmp_path, room):
    """At a limit of the file size there is an OSError and no crash at exit, and the file is unchanged."""
    path, checkpoint = tmp_path / "a.h5", tmp_path / "a.ckpt"
    begun(path)
    write_checkpoint(checkpoint, {"u": np.zeros(10)}, {})
    before = path.read_bytes()
    script = f"""
import resource, sys
import numpy as np
from farhorizon.files.checkpoint_format import write_checkpoint
from farhorizon.files.results_writer import ResultsWriter
writer = ResultsWriter({str(path)!r})
resource.setrlimit(resource.RLIMIT_FSIZE, ({len(before) + room}, {len(before) + room}))
errors = 0
for write in (lambda: writer.append(2, 2.0, {{"u": np.ones({SHAPE}), "v": np.ones({SHAPE})}}, energy=3.0),
              lambda: write_checkpoint({str(checkpoint)!r}, {{"u": np.zeros(100_000)}}, {{}})):
    try:
        write()
    except OSError as error:
        errors += error.errno == {errno.EFBIG}
sys.exit(errors)
"""
    assert subprocess.run([sys.executable, "-c", script], timeout=60).returncode == 2
    assert path.read_bytes() == before and len(read_checkpoint(checkpoint)[0]["u"]) == 10
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.ckpt", "a.h5"]


def test_a_lock_is_held_by_one_and_ends_with_its_process(tmp_path):
    path = tmp_path / ".a.lock"
    with storage.locked(path):
        with pytest.raises(fh.InputError, match="another run writes"), storage.locked(path):
            pass
        assert path.exists()
    assert not path.exists()

    def take():
        lock = storage.locked(path)
        lock.__enter__()
        os._exit(7)

    assert in_child(take) == 7 and path.exists()
    with storage.locked(path):
        pass
    assert not path.exists()


def test_draft_is_a_file_of_its_own(tmp_path):
    """Random reads, writes and truncations against the same operations on bytes; the file changes only at the end."""
    rng = np.random.default_rng(5)
    path = tmp_path / "x"
    for _ in range(50):
        content = rng.bytes(int(rng.integers(1, 60)))
        path.write_bytes(content)
        model = bytearray(content)
        with storage.changing(path) as draft:
            for _ in range(20):
                place, data = int(rng.integers(0, len(model) + 1)), rng.bytes(int(rng.integers(0, 30)))
                draft.seek(place)
                draft.write(data)
                model[place : place + len(data)] = data
                assert path.read_bytes()[: len(content)] == content
                draft.seek(place // 2)
                assert draft.read(40).rstrip(b"\0") == bytes(model[place // 2 : place // 2 + 40]).rstrip(b"\0")
            draft.truncate(len(model))
        assert path.read_bytes() == model and len(list(tmp_path.iterdir())) == 1
