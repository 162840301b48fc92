"""What one thread of this machine can do at most."""

from __future__ import annotations

import os
import subprocess
import sys

SGEMM = """
import time, numpy as np
a = np.ones((1024, 1024), np.float32)
a @ a
best = 1e9
for _ in range(20):
    start = time.perf_counter()
    a @ a
    best = min(best, time.perf_counter() - start)
print(2 * 1024**3 / best)
"""


def peak_flops() -> float:
    """Floating-point operations a second of one thread [1/s], as a float32 matrix product reaches them."""
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    done = subprocess.run(
        [sys.executable, "-c", SGEMM], env={**os.environ, **one}, capture_output=True, text=True, check=True
    )
    return float(done.stdout)
