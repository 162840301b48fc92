"""For all tests: a fixture, and one thread each for torch and BLAS.

Their idle threads spin; with many small operations on a busy machine, or beside another worker, that takes up to ten
times as long. Set before either is imported; what a test starts as a process of its own inherits it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager

import pytest

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")


@pytest.fixture(autouse=True)
def coarse_grids_are_meant(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests are fast on grids that are too coarse for folds."""
    monkeypatch.setattr("cloth_envs.folds.warn_coarse", lambda scene: None)


@pytest.fixture
def stopped(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], AbstractContextManager[object]]:
    """A context, entered by ``with`` and a number of steps: a training in it is interrupted after these."""

    @contextmanager
    def within(steps: int) -> Iterator[None]:
        left = iter(range(steps))

        def watched(work: Iterable[int], *_: object, **__: object) -> Iterator[int]:
            for step in work:
                if next(left, None) is None:
                    raise KeyboardInterrupt
                yield step

        with monkeypatch.context() as patch:
            patch.setattr("training.fit.progress", watched)
            with pytest.raises(KeyboardInterrupt):
                yield

    return within
