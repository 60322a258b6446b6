"""The background's looks at the registry: in a daemon thread, for they may wait and nobody waits for them."""

import asyncio
import logging
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future
from contextlib import asynccontextmanager
from threading import Event, Thread

from anyio import to_thread

from inference_api.models.store import ModelStore

_LOG = logging.getLogger(__name__)


@asynccontextmanager
async def following(store: ModelStore, poll_s: float, first_s: float) -> AsyncIterator[None]:
    """A store whose models are loaded, and which follows its registry until this is left.

    Args:
        store: with nothing loaded yet.
        poll_s: between two looks.
        first_s: for the first look, without which the shipped model would answer for a champion.
    """
    poller = Poller(store.refresh, poll_s, first_s)
    try:
        # First, for the registry and the shipped model then take their time together.
        store.start()
        poller.start()
        await to_thread.run_sync(store.load_shipped)
        await poller.first_look()
        yield
    finally:
        poller.stop()
        store.close()


class Poller:
    """Calls a look again and again.

    Args:
        look: told how long it may wait for what it has found, s.
        poll_s: between two looks, and how long each but the first waits.
        first_s: how long the first one waits.
    """

    def __init__(self, look: Callable[[float], None], poll_s: float, first_s: float) -> None:
        self._look, self._poll_s, self._first_s = look, poll_s, first_s
        self._ended = Event()
        self._looked: Future[None] = Future()

    def start(self) -> None:
        """Begin to look."""
        Thread(target=self._run, name="poll", daemon=True).start()

    def stop(self) -> None:
        """Look no more; a look that is under way is not waited for."""
        self._ended.set()

    async def first_look(self) -> None:
        """Return when the first look is over, or after the time that it may wait."""
        done = asyncio.wrap_future(self._looked)
        await asyncio.wait([done], timeout=self._first_s)

    def _run(self) -> None:
        wait_s = self._first_s
        while not self._ended.is_set():
            try:
                self._look(wait_s)
            except Exception:  # noqa: BLE001 - a loop that has ended would never serve another promotion
                _LOG.exception("looking the champion up failed")
            if not self._looked.done():
                self._looked.set_result(None)
            wait_s = self._poll_s
            self._ended.wait(self._poll_s)
