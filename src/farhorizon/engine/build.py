"""Writes the compiled program of one stencil shape to disk and imports it, so that Numba's cache finds it again."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import re
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

# The OpenMP layer of Numba busy-waits between parallel loops unless told otherwise before its first use.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

_HERE = Path(__file__).parent


def cache_folder() -> Path:
    """Folder of generated programs: ``FARHORIZON_CACHE`` or the user's cache folder, else a temporary one."""
    if "FARHORIZON_CACHE" in os.environ:
        candidates = [Path(os.environ["FARHORIZON_CACHE"])]
    else:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        candidates = [home / "farhorizon", Path(tempfile.gettempdir()) / f"farhorizon-{os.getuid() if hasattr(os, 'getuid') else 0}"]
    for folder in candidates:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                return folder
        except OSError:
            continue
    return Path(tempfile.mkdtemp(prefix="farhorizon-"))


def load_program(**settings: Any) -> ModuleType:
    """Module of compiled functions with the template's upper-case names set to `settings`.

    The file's name holds a hash of the template, the generator and the settings: Numba's own cache does not see
    a change of the generator.
    """
    template = (_HERE / "program.py").read_text()
    for name, value in settings.items():
        template, count = re.subn(rf"(?m)^{name} = .*$", f"{name} = {value!r}", template)
        assert count == 1, f"the template has no setting {name}"
    import numba

    mark = "\n".join([template, (_HERE / "simd.py").read_text(), numba.__version__, platform.machine()])
    name = "program_" + hashlib.sha256(mark.encode()).hexdigest()[:20]
    if name in sys.modules:
        return sys.modules[name]
    path = cache_folder() / f"{name}.py"
    if not path.exists():
        with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False) as file:
            file.write(template)
        os.replace(file.name, path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
