"""What a benchmark ran on."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import _minicloth_kernels as kernels
import numpy as np

import cloth_envs


def processor() -> str:
    """The processor's name as the system tells it."""
    try:
        with open("/proc/cpuinfo") as lines:
            return next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def header() -> dict[str, object]:
    """Machine, versions and source revision, for the top of a benchmark's rows."""
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "instruction_set": kernels.instruction_set(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "minicloth": cloth_envs.__version__,
    }


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
