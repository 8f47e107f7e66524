"""The file of a checkpoint: what is written is read back bitwise, and damage is reported."""

import os
from pathlib import Path

import h5py
import numpy as np
import pytest

from farhorizon.errors import FileFormatError, InputError
from farhorizon.files.checkpoint_format import read_checkpoint, write_checkpoint


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
    """Damage anywhere gives a FileFormatError, or (in padding) leaves everything as it was."""
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
