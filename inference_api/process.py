"""The process: its memory stays flat, its collections short, and it ends when it was told to."""

import asyncio
import ctypes
import gc
import logging
import os
import signal
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial
from types import FrameType

from anyio import to_thread

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
# One for the event loop, one for the threads that compute and load.
ARENAS = 2
# By itself glibc raises both to twice these. With half of these, reading a depth picture takes 40 % longer.
MMAP_BYTES, TRIM_BYTES = 16 * 2**20, 32 * 2**20
TRIM_S = 1.0
# After the grace, for what an orderly end still has to do.
MARGIN_S = 1.0
FORCED = 3
LOG_PATIENCE_S = 0.3
_LOG = logging.getLogger(__name__)


def few_arenas() -> bool:
    """Keep glibc from giving each thread an arena, which models fragment, and bound what it keeps free.

    Returns:
        Whether the C library could be told; other ones than glibc have no arenas.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return False
    bounds = ((_M_ARENA_MAX, ARENAS), (_M_MMAP_THRESHOLD, MMAP_BYTES), (_M_TRIM_THRESHOLD, TRIM_BYTES))
    return all(bool(mallopt(*bound)) for bound in bounds)


@asynccontextmanager
async def trimmed(every_s: float = TRIM_S) -> AsyncIterator[None]:
    """While this is entered, the free pages of all arenas go back to the system again and again.

    Without work in between it takes 0.3 ms; after an array of space some 20 ms, in a thread.

    Args:
        every_s: seconds between two times.
    """
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError, TypeError):
        yield
        return
    async with repeated(partial(trim, 0), every_s):
        yield


@asynccontextmanager
async def repeated(
    call: Callable[[], object], every_s: float, *, at_end: bool = False
) -> AsyncIterator[None]:
    """While this is entered, something is called in a thread again and again.

    Args:
        call: which raises nothing.
        every_s: seconds between two times.
        at_end: whether it is called once more when this is left.
    """

    async def again() -> None:
        while True:
            await asyncio.sleep(every_s)
            await to_thread.run_sync(call)

    task = asyncio.create_task(again())
    try:
        yield
    finally:
        task.cancel()
        if at_end:
            await to_thread.run_sync(call)


def settle() -> None:
    """Take what there is now out of all later garbage collections.

    An answer with many samples makes as many lists, which has the whole process collected; going through what
    the start has made, which stays anyway, would stop every thread for some 30 ms.
    """
    gc.collect()
    gc.freeze()


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
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    watch = threading.Thread(target=_watch, args=(reader, grace_s, first), name="ending", daemon=True)
    watch.start()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _notifying(writer, signal.getsignal(number)))


Handler = Callable[[int, FrameType | None], object] | int | signal.Handlers | None


def _notifying(writer: int, before: Handler) -> Callable[[int, FrameType | None], None]:
    def handle(number: int, frame: FrameType | None) -> None:
        # No lock and no new thread here: what was interrupted may hold any.
        with suppress(BlockingIOError):
            os.write(writer, b"!")
        if callable(before):
            before(number, frame)

    return handle


def _watch(reader: int, grace_s: float, first: Callable[[], None] | None) -> None:
    # A thread that hangs may hold the log, so another one writes the line. It is started here, as Python 3.12
    # starts none once the interpreter waits for the last threads.
    late = threading.Event()
    log_writer = threading.Thread(target=_log_late_end, args=(grace_s, late), name="ending-log", daemon=True)
    log_writer.start()
    os.read(reader, 1)
    time.sleep(grace_s + MARGIN_S)
    late.set()
    log_writer.join(LOG_PATIENCE_S)
    if first is not None:
        first()
    os._exit(FORCED)


def _log_late_end(grace_s: float, late: threading.Event) -> None:
    late.wait()
    _LOG.error("the process did not end within %g s of being told to, and is ended", grace_s + MARGIN_S)
