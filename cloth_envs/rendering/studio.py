"""The one thread in which everything is drawn: a window of OpenGL belongs to the thread that made it.

So an environment may be drawn, closed or dropped in any thread. The thread is there while something is open, and a process
that has closed all may be forked.
"""

import atexit
import os
import sys
import threading
import traceback
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

T = TypeVar("T")
Answer = SimpleQueue[tuple[bool, Any]]
ENDING = 10.0  # s that the end of the process waits for a picture in the making


class Drawing(Protocol):
    """What is drawn on: made anywhere, used in the studio only."""

    @property
    def is_open(self) -> bool:
        """Whether it holds a window."""

    def close(self) -> None:
        """Give everything back."""

    def abandon(self) -> None:
        """Keep everything as it is for ever, in a process to which it does not belong."""


class Studio:
    """Runs jobs one after the other, in a thread of its own (in the main thread on macOS, as its windows must)."""

    def __init__(self) -> None:
        self._lock = threading.RLock()  # reentrant, since a garbage collection may discard in the midst of anything
        self._jobs: SimpleQueue[tuple[Drawing, Callable[[], Any], Answer]] = SimpleQueue()
        self._open: set[Drawing] = set()
        self._thread: threading.Thread | None = None
        self._ended = self._orphaned = False
        self._in_main = sys.platform == "darwin"

    def run(self, drawing: Drawing, job: Callable[[], T]) -> T:
        """What ``job``, which uses ``drawing``, returns or raises.

        Raises:
            RuntimeError: in a forked process whose parent had a window open, at the end of the process, or, on macOS, in
                another thread than the main one.
        """
        refusal = self._refusal()
        if refusal is not None:
            raise RuntimeError(refusal)
        if threading.current_thread() is self._thread:
            return job()
        answer: Answer = SimpleQueue()
        with self._lock:
            self._open.add(drawing)
            self._jobs.put((drawing, job, answer))
            if not self._in_main and self._thread is None:
                self._thread = threading.Thread(target=self._work, name="minicloth-studio", daemon=True)
                self._thread.start()
            thread = self._thread
        if thread is None:
            self._work()
        done, value = answer.get()
        if thread is not None and self._thread is not thread:
            thread.join()  # it has nothing left to do
        if done:
            return value
        try:
            raise value
        finally:
            del value  # or error and frame would hold each other

    def close(self, drawing: Drawing) -> None:
        """Close ``drawing``; nothing happens if it is not open here. Where no job may run, that is left for later."""
        if self._refusal() is not None:
            self.discard(drawing)
        elif drawing in self._open:
            self.run(drawing, drawing.close)

    def discard(self, drawing: Drawing) -> None:
        """Close ``drawing`` soon, without waiting; nothing happens if it is not open here."""
        with self._lock:
            if drawing in self._open:
                self._jobs.put((drawing, drawing.close, SimpleQueue()))

    def _refusal(self) -> str | None:
        """Why this thread of this process may not draw, or None."""
        if self._orphaned:
            return (
                "this process was forked while its parent had a picture open, which drawing does not survive: start it with "
                'multiprocessing.get_context("spawn") or "forkserver" (AsyncVectorEnv takes context="spawn"), or close() '
                "what has drawn before the fork"
            )
        if self._ended:
            return "the process is ending: draw before that"
        if self._in_main and threading.current_thread() is not threading.main_thread():
            return (
                f"on macOS pictures are drawn in the main thread only, this one is {threading.current_thread().name!r}: "
                "call render() in the main thread, or use processes"
            )
        return None

    def _work(self) -> None:
        """Do jobs until nothing is open, or, in the main thread, until none is left."""
        while True:
            drawing, job, answer = self._jobs.get()
            try:
                outcome: tuple[bool, Any] = True, job()
            except BaseException as error:
                traceback.clear_frames(error.__traceback__)  # or what is in them would be freed in another thread
                outcome = False, error
            with self._lock:
                if not drawing.is_open:
                    self._open.discard(drawing)
                idle = self._jobs.empty() and (self._in_main or not self._open)
                if idle:
                    self._thread = None
            answer.put(outcome)
            del drawing, job, answer, outcome
            if idle:
                return

    def _end(self) -> None:
        """Close what is open, at the end of the process."""
        self._ended = True
        for drawing in list(self._open):
            self.discard(drawing)
        thread = self._thread
        if thread is not None:
            thread.join(ENDING)
        elif not self._jobs.empty():
            self._work()

    def _forked(self) -> None:
        """In a new child: the thread is not there, and the parent's windows hang whoever touches them."""
        lost = list(self._open)
        self._lock, self._jobs, self._open, self._thread = threading.RLock(), SimpleQueue(), set(), None
        self._orphaned = bool(lost)
        for drawing in lost:
            drawing.abandon()


STUDIO = Studio()
atexit.register(STUDIO._end)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=STUDIO._forked)
