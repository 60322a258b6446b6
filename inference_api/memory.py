"""What keeps the memory of a long-lived server flat, and its collections short."""

import ctypes
import gc

_M_ARENA_MAX = -8
# One for the event loop, one for the threads that compute and load.
ARENAS = 2


def few_arenas() -> bool:
    """Keep glibc from giving each thread an arena of its own, which models that come and go would fragment.

    Returns:
        Whether the C library could be told; other ones than glibc have no arenas.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return False
    return bool(mallopt(_M_ARENA_MAX, ARENAS))


def settle() -> None:
    """Take what there is now out of all later garbage collections.

    An answer with many samples makes as many lists, which has the whole process collected; going through what
    the start has made, which stays anyway, would stop every thread for some 30 ms.
    """
    gc.collect()
    gc.freeze()
