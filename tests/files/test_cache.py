"""The cache folder: damaged files are made again, and code in a folder that others may write to is not run."""

import importlib.util
import os
import re
import subprocess
import sys
from collections import namedtuple
from types import ModuleType

import numba
import numpy as np
import pytest

from farhorizon.engine import chain_loops
from farhorizon.engine.codegen import build, numba_internals
from farhorizon.engine.codegen.compiled import njit
from farhorizon.files import cache

MODULE = """
from numba import types
from farhorizon.engine.codegen.compiled import cfunc, njit

@njit(cache=True)
def double(x):
    return 2 * x

@cfunc(types.float64(types.float64))
def triple(x):
    return 3 * x
"""


def executed(path):
    """Return the module of a file, executed anew."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    del sys.modules[path.stem]
    return module


def loaded(path):
    """Execute the module of a file anew, use it, and return how often it found compiled code."""
    module = executed(path)
    assert module.double(3.5) == 7.0 and module.triple.ctypes(2.0) == 6.0
    return sum(module.double.stats.cache_hits.values()) + module.triple.cache_hits


def test_damaged_machine_code_is_compiled_again(tmp_path, monkeypatch):
    """A flipped bit, a truncated, an empty or a missing file: compiled again, once."""
    monkeypatch.setenv("FARHORIZON_CACHE", str(tmp_path))
    path = tmp_path / "compiled_here.py"
    path.write_text(MODULE)
    assert (loaded(path), loaded(path)) == (0, 2)
    rng = np.random.default_rng(8)
    for file in sorted((tmp_path / "__pycache__").glob("compiled_here.*.nb?")):
        whole = file.read_bytes()
        flipped = [bytearray(whole) for _ in range(4)]
        for data in flipped:
            data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        for data in (*flipped, whole[: len(whole) // 2], b"", None):
            file.unlink() if data is None else file.write_bytes(data)
            assert (loaded(path), loaded(path)) == (1, 2)


def test_machine_code_of_types_that_are_no_more_is_compiled_again(tmp_path, monkeypatch):
    """Another version of the program may have left such code."""
    monkeypatch.setenv("FARHORIZON_CACHE", str(tmp_path))
    path = tmp_path / "compiled_before.py"
    path.write_text(MODULE.replace("2 * x", "x[0]"))
    before = ModuleType("types_of_before")
    before.Pair = namedtuple("Pair", "a b", module="types_of_before")
    monkeypatch.setitem(sys.modules, "types_of_before", before)
    assert executed(path).double(before.Pair(3, 4)) == 3
    monkeypatch.delitem(sys.modules, "types_of_before")
    assert executed(path).double((5, 6)) == 5


def test_machine_code_of_fields_in_another_order_is_compiled_again(tmp_path, monkeypatch):
    """Their types are the same, and the class has the same name."""
    monkeypatch.setenv("FARHORIZON_CACHE", str(tmp_path))
    path = tmp_path / "compiled_in_order.py"
    path.write_text(MODULE.replace("2 * x", "x[1].a"))
    for fields, expected in (("a b", 0), ("a b", 1), ("b a", 0), ("b a", 1)):
        module = ModuleType("types_of_pairs")
        module.Pair = namedtuple("Pair", fields, module="types_of_pairs")
        monkeypatch.setitem(sys.modules, "types_of_pairs", module)
        double = executed(path).double
        assert double((0, module.Pair(a=3, b=4))) == 3
        assert sum(double.stats.cache_hits.values()) == expected


#: Waits as if the function took long to compile, and reports that it was compiled.
SLOWLY = """
import sys, time
from farhorizon.engine.codegen.numba_internals import CFunc
compile_it = CFunc._compile_uncached

def slowly(self):
    print("compiled", flush=True)
    time.sleep(1.0)
    return compile_it(self)

CFunc._compile_uncached = slowly
sys.path.insert(0, sys.argv[1])
import compiled_together
assert compiled_together.triple.ctypes(2.0) == 6.0
"""


def test_of_processes_that_start_together_one_compiles(tmp_path, monkeypatch):
    monkeypatch.setenv("FARHORIZON_CACHE", str(tmp_path))
    (tmp_path / "compiled_together.py").write_text(MODULE)
    command = [sys.executable, "-c", SLOWLY, str(tmp_path)]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [one.communicate(timeout=60)[0] for one in both]
    assert [one.returncode for one in both] == [0, 0] and sorted(said) == ["", "compiled\n"]
    assert not list((tmp_path / "__pycache__").glob("*.lock"))


def test_all_that_is_internal_to_numba_is_in_one_module():
    """What a release of Numba may change is looked for there alone, and everything used of it is checked at import."""
    internals = cache.Path(numba_internals.__file__)
    known = {owner.__name__.split(".")[-1]: names for owner, names in numba_internals.USED.items()}
    for file in cache.Path(build.__file__).parents[2].rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        if file != internals:
            assert not re.findall(r"^\s*(?:from|import) numba\.(?!extending)", text, re.MULTILINE), file.name
            for module in ("cgutils", "sigutils", "arrayobj"):
                assert set(re.findall(rf"\b{module}\.(\w+)", text)) <= set(known[module]), file.name


def test_a_version_of_numba_without_them_is_named(monkeypatch):
    monkeypatch.delattr(numba_internals.cgutils, "for_range")
    with pytest.raises(ImportError, match=rf"Numba {re.escape(numba.__version__)} .*cgutils.for_range.*numba>="):
        numba_internals.check()


def test_all_compiled_functions_have_that_cache():
    """No module of the package imports Numba's own decorators."""
    for file in cache.Path(build.__file__).parents[2].rglob("*.py"):
        lines = [line for line in file.read_text().splitlines() if line.startswith("from numba import")]
        assert not any(word in line for line in lines for word in ("njit", "cfunc", "jit")), file.name


def test_no_machine_code_lies_beside_the_sources(tmp_path, monkeypatch):
    """What others read, and a package manager counts, is not written: neither by a module of the package nor beside
    one of the user's.
    """
    monkeypatch.setenv("FARHORIZON_CACHE", str(tmp_path / "cache"))
    package = cache.Path(build.__file__).parents[2]
    before = set(package.rglob("*.nb?"))
    (tmp_path / "compiled_of_a_user.py").write_text(MODULE)
    loaded(tmp_path / "compiled_of_a_user.py")
    weights = np.ones((2, 1))
    anew = njit(cache=True, error_model="numpy")(chain_loops.chain_responses.py_func)
    anew(weights, 1.0, 0.1, 0.0, np.arange(1, 5))
    assert list((tmp_path / "cache" / "__pycache__").glob("chain_loops.*.nbc"))
    assert set(package.rglob("*.nb?")) == before and not (tmp_path / "__pycache__").exists()
    assert len(list((tmp_path / "cache" / "__pycache__").glob("compiled_of_a_user.*.nbc"))) == 2


@pytest.mark.parametrize("damage", [b"", b"\xff\xfe garbage", b"VALUE = 2\n"])
def test_damaged_generated_programs_are_written_again(tmp_path, monkeypatch, damage):
    monkeypatch.setattr(build, "cache_folder", lambda: tmp_path)
    for _ in range(2):
        assert build._load_file("rows_of_this_test", "VALUE = 1\n").VALUE == 1
        del sys.modules["rows_of_this_test"]
        (tmp_path / "rows_of_this_test.py").write_bytes(damage)


def test_half_a_module_is_none(tmp_path, monkeypatch):
    """A module whose import was interrupted is imported again."""
    monkeypatch.setattr(build, "cache_folder", lambda: tmp_path)
    text = "from farhorizon.engine.codegen import build\nif build.CUT_SHORT:\n    raise KeyboardInterrupt\nVALUE = 1\n"
    monkeypatch.setattr(build, "CUT_SHORT", True, raising=False)
    with pytest.raises(KeyboardInterrupt):
        build._load_file("rows_cut_short", text)
    monkeypatch.setattr(build, "CUT_SHORT", False)
    assert build._load_file("rows_cut_short", text).VALUE == 1
    del sys.modules["rows_cut_short"]


def test_damaged_arrays_are_none(tmp_path):
    path = tmp_path / "a.npz"
    assert cache.kept(path) is None
    cache.keep(path, poles=np.arange(5.0), error=0.5)
    assert cache.kept(path)["poles"].tolist() == [0, 1, 2, 3, 4] and cache.kept(path)["error"] == 0.5
    data = path.read_bytes()
    for place in range(0, len(data), 7):
        damaged = bytearray(data)
        damaged[place] ^= 4
        path.write_bytes(damaged)
        assert cache.kept(path) is None
    cache.keep(tmp_path / "none" / "a.npz", poles=np.zeros(2))  # a cache that cannot be written is no error


def test_old_temporary_files_go(tmp_path):
    for name, age in ((".a.npz.1-2.tmp", 2e5), (".b.npz.1-2.tmp", 0.0), ("tmpabc.tmp", 2e5)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (cache.time.time() - age,) * 2)
    cache.keep(tmp_path / "a.npz", x=np.zeros(1))
    assert sorted(p.name for p in tmp_path.iterdir()) == [".b.npz.1-2.tmp", "a.npz"]


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners of POSIX")
def test_a_shared_folder_that_others_may_write_is_not_taken(tmp_path, monkeypatch):
    """Whoever can write there could have us run any code."""
    monkeypatch.delenv("FARHORIZON_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null/none")
    monkeypatch.setattr(cache.tempfile, "tempdir", str(tmp_path))
    shared = tmp_path / f"farhorizon-{os.getuid()}"
    assert cache.cache_folder() == shared and shared.stat().st_mode & 0o777 == 0o700
    shared.chmod(0o770)
    assert cache.cache_folder() != shared
    shared.rmdir()
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    shared.symlink_to(tmp_path / "elsewhere")
    assert cache.cache_folder() not in (shared, tmp_path / "elsewhere")
    shared.unlink()
    shared.mkdir(mode=0o700)
    assert cache.cache_folder() == shared
    if os.getuid() == 0:
        os.chown(shared, 65534, 65534)
        assert cache.cache_folder() != shared
