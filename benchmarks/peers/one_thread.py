"""Common part of the comparisons: one thread for every program, and the tables of the other benchmarks."""

import os
import sys
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"  # read by the libraries when they are loaded
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from common import interleaved, median, ratio, save, table  # noqa: E402

__all__ = ["interleaved", "median", "ratio", "save", "table"]
