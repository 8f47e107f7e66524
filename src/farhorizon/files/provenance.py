"""What a file or a page was computed with."""

from __future__ import annotations

import platform

from farhorizon import __version__


def versions() -> list[tuple[str, str]]:
    """What the program runs on."""
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
    """What a run is computed with, beside its number of threads."""
    return [*versions(), ("machine", f"{platform.system()} {platform.machine()}")]
