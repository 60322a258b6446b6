"""A process that was told to end does end, whatever its threads do.

Threads that compute can not be interrupted, and the interpreter waits for them. So a thread of its own waits
for the signal, then for the grace, and ends the process without asking anybody.
"""

import logging
import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import FrameType

# After the grace, for what an orderly end still has to do.
MARGIN_S = 1.0
FORCED = 3
LOG_PATIENCE_S = 0.3
_LOG = logging.getLogger(__name__)


def end_in_time(grace_s: float, first: Callable[[], None] | None = None) -> None:
    """End this process with :data:`FORCED` if it is there :data:`MARGIN_S` after a signal's grace.

    What handles SIGINT and SIGTERM so far goes on doing so. Outside of the main thread there are no signals,
    and nothing is done.

    Args:
        grace_s: time for an orderly end, in s.
        first: done before a forced end.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    heard, told = os.pipe()
    os.set_blocking(told, False)
    watch = threading.Thread(target=_watch, args=(heard, grace_s, first), name="ending", daemon=True)
    watch.start()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _telling(told, signal.getsignal(number)))


Handler = Callable[[int, FrameType | None], object] | int | signal.Handlers | None


def _telling(told: int, before: Handler) -> Callable[[int, FrameType | None], None]:
    def handle(number: int, frame: FrameType | None) -> None:
        # No lock and no new thread here: what was interrupted may hold any.
        with suppress(BlockingIOError):
            os.write(told, b"!")
        if callable(before):
            before(number, frame)

    return handle


def _watch(heard: int, grace_s: float, first: Callable[[], None] | None) -> None:
    # A thread that hangs may hold the log, so another one writes the line. It is started here, as Python 3.12
    # starts none once the interpreter waits for the last threads.
    late = threading.Event()
    telling = threading.Thread(target=_tell, args=(grace_s, late), name="ending-log", daemon=True)
    telling.start()
    os.read(heard, 1)
    time.sleep(grace_s + MARGIN_S)
    late.set()
    telling.join(LOG_PATIENCE_S)
    if first is not None:
        first()
    os._exit(FORCED)


def _tell(grace_s: float, late: threading.Event) -> None:
    late.wait()
    _LOG.error("the process did not end within %g s of being told to, and is ended", grace_s + MARGIN_S)
