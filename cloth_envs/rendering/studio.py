"""The one thread in which everything is drawn: a window of OpenGL belongs to the thread that made it.

So an environment may be drawn, closed or dropped in any thread. The thread ends soon after the last window is closed,
and a process that has closed all may be forked.
"""

import atexit
import os
import sys
import threading
import traceback
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, Protocol, TypeVar

T = TypeVar("T")
Answer = SimpleQueue[tuple[bool, Any]]
LINGER = 1.0  # s that the thread, and what ``Studio.at_rest`` gives back, waits for another window
PATIENCE = 10.0  # s that the end of the process, or a fork, waits for the thread to end


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
    """Runs jobs one after the other, in a thread of its own (in the main thread on macOS, as its windows must).

    Args:
        at_rest: called in the thread when nothing is open any more.
    """

    def __init__(self, at_rest: Callable[[], None]) -> None:
        self._at_rest, self._in_main = at_rest, sys.platform == "darwin"
        self._lock = threading.RLock()  # reentrant, since a garbage collection may discard in the midst of anything
        self._jobs: SimpleQueue[tuple[Drawing, Callable[[], Any], Answer] | None] = SimpleQueue()
        self._open: set[Drawing] = set()
        self._thread: threading.Thread | None = None
        self._ended = self._orphaned = False
        atexit.register(self._end)
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(before=self._leave, after_in_child=self._forked)

    def run(self, drawing: Drawing, job: Callable[[], T]) -> T:
        """What ``job``, which uses ``drawing``, returns or raises.

        Raises:
            RuntimeError: in a forked process whose parent had a window open, at the end of the process, or, on macOS,
                in another thread than the main one.
            SystemExit: at the end of the process, in a daemon thread.
        """
        refusal = self._refusal()
        if refusal is not None:
            if self._ended and threading.current_thread().daemon:
                raise SystemExit  # ends the thread without a word, which the process would do next
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
        if self._in_main:
            self._work()
        done, value = answer.get()
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
                "this process was forked while its parent had a picture open, which drawing does not survive: start it "
                'with multiprocessing.get_context("spawn") or "forkserver" (AsyncVectorEnv takes context="spawn"), or '
                "close() what has drawn before the fork"
            )
        if self._ended:
            return "the process is ending: draw before that"
        here = threading.current_thread()
        if self._in_main and here is not threading.main_thread():
            return (
                f"on macOS pictures are drawn in the main thread only, and this one is {here.name!r}: call "
                "render() in the main thread, or use processes"
            )
        return None

    def _work(self) -> None:
        """Do jobs until nothing is open and none comes; in the main thread, until none is left."""
        while True:
            try:
                task = self._jobs.get(timeout=0.0 if self._in_main else LINGER)
            except Empty:
                task = None
            if task is not None:
                self._do(*task)
                del task  # with all that hangs on it
                continue
            if not self._open:
                self._at_rest()
            with self._lock:
                if self._jobs.empty() and (self._in_main or not self._open):
                    self._thread = None
                    return

    def _do(self, drawing: Drawing, job: Callable[[], Any], answer: Answer) -> None:
        try:
            outcome: tuple[bool, Any] = True, job()
        except BaseException as error:
            traceback.clear_frames(error.__traceback__)  # or what is in them would be freed in another thread
            outcome = False, error
        with self._lock:
            if not drawing.is_open:
                self._open.discard(drawing)
        answer.put(outcome)

    def _leave(self) -> None:
        """End the thread now if nothing is open."""
        thread = self._thread
        if thread is not None and thread is not threading.current_thread() and not self._open:
            self._jobs.put(None)
            thread.join(PATIENCE)

    def _end(self) -> None:
        """Close what is open, at the end of the process."""
        self._ended = True
        for drawing in list(self._open):
            self.discard(drawing)
        thread = self._thread
        if thread is not None:
            self._jobs.put(None)
            thread.join(PATIENCE)
        elif self._in_main:
            self._work()

    def _forked(self) -> None:
        """In a new child: the thread is not there, and the parent's windows hang whoever touches them."""
        lost = list(self._open)
        self._lock, self._jobs, self._open, self._thread = threading.RLock(), SimpleQueue(), set(), None
        self._orphaned = self._orphaned or bool(lost)
        for drawing in lost:
            drawing.abandon()
