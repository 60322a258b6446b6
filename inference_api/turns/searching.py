"""A search within a request: what it costs, when others have their turns, and what it needs."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from inference_api.failures import NoKernelsError
from inference_api.turns.turns import LONG_ROWS, Turn

# What a stint of a search takes; others have their turns between two of them.
_STINT_S = 0.02


@contextmanager
def searching(turn: Turn) -> Iterator[Callable[[], None]]:
    """The turn of a request that searches; gives what the search calls now and then.

    A search lasts as long as it lasts: it pays stint by stint.

    Raises:
        NoKernelsError: the compiler of the checks is not installed.
        ClientDisconnect: the client has gone away.
    """
    turn.spend(LONG_ROWS + 1.0)
    try:
        yield _paced(turn.between)
    except ImportError as error:
        raise NoKernelsError(
            "this server does not plan",
            expected="the packages of the extra plan",
            got=f"no {error.name or 'compiler'}",
            remedy="ask a server that has them, or sample here and plan elsewhere",
        ) from error


def _paced(between: Callable[[], None]) -> Callable[[], None]:
    """The same, at most once a stint."""
    last_s = time.monotonic()

    def pause() -> None:
        nonlocal last_s
        if time.monotonic() - last_s >= _STINT_S:
            between()
            last_s = time.monotonic()

    return pause
