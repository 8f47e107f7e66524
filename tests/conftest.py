"""Threads of the tests, set before farhorizon (and with it NumPy and Numba) is imported; which cases are slow."""

import os
from collections import Counter

import pytest

os.environ["NUMBA_NUM_THREADS"] = "2"  # whatever the shell has: tests compare two threads with one
# The linear algebra here is of small matrices, and the workers of pytest share the processors: threads of one that wait
# busily for each other take the other's time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Of a test that is `sampled(n)` the fast tier has every n-th case, the slow tier the others."""
    seen = Counter()
    for item in items:
        if (mark := item.get_closest_marker("sampled")) is not None:
            name = item.nodeid.partition("[")[0]
            if seen[name] % mark.args[0]:
                item.add_marker(pytest.mark.slow)
            seen[name] += 1
