"""Threads of the tests, set before farhorizon (and with it NumPy and Numba) is imported."""

import os

os.environ.setdefault("NUMBA_NUM_THREADS", "2")
# The linear algebra here is of small matrices, and the workers of pytest share the processors: threads of one that wait
# busily for each other take the other's time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
