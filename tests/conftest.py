"""Threads of the tests, set before farhorizon (and with it NumPy and Numba) is imported."""

import os

os.environ.setdefault("NUMBA_NUM_THREADS", "2")
# The linear algebra here is of small matrices, and the workers of pytest share the processors: threads of one that wait
# busily for each other take the other's time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_sessionstart() -> None:
    """Of several workers each compiles other programs of the time loop, so that none is compiled twice: the rest are
    found on disk.
    """
    worker, count = os.environ.get("PYTEST_XDIST_WORKER", ""), int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if count < 2:
        return
    import farhorizon as fh

    kernel, square = fh.Kernel(1.0), fh.Lattice(1.0, (0.0, 0.0), (8.0, 8.0))
    runs = [
        (fh.Wave(kernel), fh.Free()),
        (fh.Elastic(kernel, 1.0, 0.3, material="state-based"), fh.Free()),
        (fh.Elastic(kernel, 1.0, critical_stretch=1.0), fh.Free()),
        (fh.Wave(kernel), fh.Sponge(3)),
    ]
    for model, side in runs[int(worker.removeprefix("gw")) :: count]:
        fh.Simulation(square, model, side, threads=1).step(1)
