"""Instruction sets side by side: each in a process of its own, since kernels choose one when they are loaded."""

import multiprocessing
import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager

from cloth_envs.machine import header

LEVELS = ("baseline", "avx2", "avx512")
VARIABLE = "MINICLOTH_INSTRUCTION_SET"
# The matrix products of NumPy's OpenBLAS that use no wider instructions.
PRODUCTS = {"baseline": "Prescott", "avx2": "Haswell", "avx512": "SkylakeX"}
PRODUCT = """
import numpy as np, timeit
a = np.ones((512, 512), np.float32)
print(2 * 512**3 / min(timeit.repeat(lambda: a @ a, number=1, repeat=301)))
"""


def levels() -> list[str]:
    """What this processor has, lesser ones first."""
    return list(LEVELS[: LEVELS.index(str(header()["instruction_set"])) + 1])


@contextmanager
def process(level: str) -> Iterator[Executor]:
    """A process whose kernels use ``level``.

    Raises:
        RuntimeError: they do not: the processor lacks it.
    """
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = level
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        try:
            found = pool.submit(header).result()["instruction_set"]
        finally:
            if before is None:
                del os.environ[VARIABLE]
            else:
                os.environ[VARIABLE] = before
        if found != level:
            raise RuntimeError(f"kernels use {found} where {level} was asked for")
        yield pool


def peak_flops(level: str) -> float:
    """Floating-point operations a second of one thread [1/s], as a float32 matrix product of ``level`` reaches them."""
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    environment = {**os.environ, **one, "OPENBLAS_CORETYPE": PRODUCTS[level]}
    command = [sys.executable, "-c", PRODUCT]
    return float(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout)
