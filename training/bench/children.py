"""Processes of one thread that end with the one that started them."""

import os
import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import TextIO

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Children:
    """Those that were started. Ctrl-C in a terminal reaches them by itself, SIGTERM within ``watched``."""

    def __init__(self) -> None:
        self._started: list[subprocess.Popen[bytes]] = []
        self._stopped = False

    def start(self, command: Sequence[str], log: TextIO) -> subprocess.Popen[bytes]:
        """Start ``command``, which writes into ``log``; it ends at once where SIGTERM has come."""
        child = subprocess.Popen(command, env=os.environ | ONE_THREAD, stdout=log, stderr=log)
        self._started.append(child)
        if self._stopped:
            child.terminate()
        return child

    @contextmanager
    def watched(self) -> Iterator[None]:
        """While this lasts SIGTERM ends them too, and then this process with the code 143; in the main thread only."""

        def end(number: int, _: FrameType | None) -> None:
            self._stopped = True
            self._terminate()
            raise SystemExit(128 + number)

        before = signal.signal(signal.SIGTERM, end)
        try:
            yield
        finally:
            signal.signal(signal.SIGTERM, before)
            self._terminate()
            for child in self._started:
                child.wait()

    def _terminate(self) -> None:
        for child in self._started:  # which does nothing to those that have ended
            child.terminate()
