"""What several tests need."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")  # of torch: on networks this small its threads only wait for each other


@pytest.fixture
def stopped(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], AbstractContextManager[object]]:
    """``with stopped(n):`` a training in it is interrupted after ``n`` steps."""

    @contextmanager
    def within(steps: int) -> Iterator[None]:
        left = iter(range(steps))

        def bar(work: Iterable[int], **_: object) -> Iterator[int]:
            for step in work:
                if next(left, None) is None:
                    raise KeyboardInterrupt
                yield step

        with monkeypatch.context() as patch:
            patch.setattr("training.fit.tqdm", bar)
            with pytest.raises(KeyboardInterrupt):
                yield

    return within
