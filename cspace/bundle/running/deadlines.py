"""A run that does not end is ended: one thread looks after all runs of the process.

A run puts itself into a table and takes itself out again; both are one step of the interpreter and need no
lock. onnxruntime looks at what ends a run before each node, so a single node that computes for long is only
ended behind it.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

RUN_LIMIT_S = 30.0
# How late a run is ended at most, about.
TICK_S = 0.25


class Deadlines:
    """What has to have ended by when. The thread starts with the first entry."""

    def __init__(self) -> None:
        self._ends: dict[object, tuple[float, Callable[[], None]]] = {}
        self._thread: threading.Thread | None = None
        self._starting = threading.Lock()

    def begin(self, key: object, limit_s: float, end: Callable[[], None]) -> None:
        """Call ``end`` once ``limit_s`` have passed, unless :meth:`done` was called before.

        Args:
            key: of this entry, and of no other at the same time.
            limit_s: above 0.
            end: quick, and must not raise; called in another thread.
        """
        self._ends[key] = (time.monotonic() + limit_s, end)
        thread = self._thread
        # Not alive in a child process, which has inherited all but the thread.
        if thread is None or not thread.is_alive():
            self._start()

    def done(self, key: object) -> None:
        """The entry has ended by itself, or was ended."""
        self._ends.pop(key, None)

    @contextmanager
    def ended_by(self, limit_s: float, end: Callable[[], None]) -> Iterator[None]:
        """The same round a block."""
        key = object()
        self.begin(key, limit_s, end)
        try:
            yield
        finally:
            self.done(key)

    def _start(self) -> None:
        with self._starting:
            if self._thread is None or not self._thread.is_alive():
                self._thread = threading.Thread(target=self._watch, name="bundle-deadlines", daemon=True)
                self._thread.start()

    def _watch(self) -> None:
        while True:
            time.sleep(TICK_S)
            now = time.monotonic()
            # A copy in one step, for runs come and go meanwhile.
            for key, (deadline, end) in list(self._ends.items()):
                if now >= deadline:
                    self.done(key)
                    end()


DEADLINES = Deadlines()
