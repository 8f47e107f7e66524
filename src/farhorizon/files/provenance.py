"""The software and the machine that produced a file or a page."""

from __future__ import annotations

import platform

from farhorizon import __version__


def versions() -> list[tuple[str, str]]:
    """Versions of the program and of what it runs on."""
    import h5py
    import numba
    import numpy
    import scipy

    return [
        ("farhorizon", __version__),
        ("python", platform.python_version()),
        *((module.__name__, module.__version__) for module in (numpy, scipy, numba, h5py)),
    ]


def computed_with() -> list[tuple[str, str]]:
    """Versions and machine of a run; the number of threads is recorded elsewhere."""
    return [*versions(), ("machine", f"{platform.system()} {platform.machine()}")]
