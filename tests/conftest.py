"""Threads of the tests, set before farhorizon (and with it Numba) is imported."""

import os

os.environ.setdefault("NUMBA_NUM_THREADS", "2")
