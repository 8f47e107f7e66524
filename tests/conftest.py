"""Numbers of threads, set before farhorizon (and with it NumPy and Numba) is imported, and the choice of slow cases."""

import os
from collections import Counter

import pytest

os.environ["NUMBA_NUM_THREADS"] = "2"  # whatever the shell has set: tests compare two threads with one
# The matrices of the linear algebra here are small, and the workers of pytest share the processors: threads of one
# worker that wait for each other busily take time from the others.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Put every n-th case of a test marked `sampled(n)` into the fast tier and the others into the slow one."""
    seen = Counter()
    for item in items:
        if (mark := item.get_closest_marker("sampled")) is not None:
            name = item.nodeid.partition("[")[0]
            if seen[name] % mark.args[0]:
                item.add_marker(pytest.mark.slow)
            seen[name] += 1
