"""What keeps the memory of a long-lived server flat, and its collections short."""

import asyncio
import ctypes
import gc
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from anyio import to_thread

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
# One for the event loop, one for the threads that compute and load.
ARENAS = 2
# By itself glibc raises both to twice these. With half of these, reading a depth picture takes 40 % longer.
MMAP_BYTES, TRIM_BYTES = 16 * 2**20, 32 * 2**20
TRIM_S = 1.0


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

    async def again() -> None:
        while True:
            await asyncio.sleep(every_s)
            await to_thread.run_sync(trim, 0)

    task = asyncio.create_task(again())
    try:
        yield
    finally:
        task.cancel()


def settle() -> None:
    """Take what there is now out of all later garbage collections.

    An answer with many samples makes as many lists, which has the whole process collected; going through what
    the start has made, which stays anyway, would stop every thread for some 30 ms.
    """
    gc.collect()
    gc.freeze()
