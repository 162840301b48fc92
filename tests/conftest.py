"""For all tests: one thread each for torch and BLAS.

Their idle threads spin; with many small operations on a busy machine, or beside another worker, that takes up to ten
times as long. Set before either is imported; what a test starts as a process of its own inherits it.
"""

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")
