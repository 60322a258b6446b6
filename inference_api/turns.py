"""Requests are computed in turns: so many at the same time in threads, the others wait, fairly by client.

A long request is cut into stints: between two of them it hands its turn to whoever waits, and ends where its
client has gone away. Long ones never have all the threads, unless there is but one.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from threading import Event, Lock
from typing import TypeVar

from anyio import CapacityLimiter, to_thread
from prometheus_client import Gauge
from starlette.requests import ClientDisconnect

from inference_api.fair_queue import FairQueue

Result = TypeVar("Result")
Gone = Callable[[], Awaitable[None]]

# In rows, that is samples drawn: what a request costs before more is known of it, and what a stint is worth.
USUAL_ROWS, STINT_ROWS = 320.0, 4096.0
# Computing that has not come to the end of a stint for so long does not work as it should.
STUCK_S = 20.0


class Turn:
    """One request's turn, as the work in its thread sees it. Made by :class:`Turns`.

    Args:
        turns: where it belongs.
        client: whose it is.
        gone: returns when the client has gone away; None where nobody can tell.
    """

    def __init__(self, turns: "Turns", client: str, gone: Gone | None) -> None:
        self.client = client
        self.is_long = False
        # When the present stint began.
        self.since_s = 0.0
        self.called: asyncio.Future[None] | None = None
        self._turns, self._gone = turns, gone
        self._loop = asyncio.get_running_loop()
        self._began, self._ended, self._abandoned = False, False, False
        self._lock, self._resumed = Lock(), Event()
        self._listener: asyncio.Task[None] | None = None

    def spend(self, rows: float) -> None:
        """Tell what the request costs; from the thread, before the cost arises.

        Args:
            rows: samples that may be drawn, or what costs as much.

        Raises:
            ClientDisconnect: the client has gone away.
        """
        if rows > STINT_ROWS:
            # Pays stint by stint.
            self.is_long = True
            self._step_aside()
        elif rows > USUAL_ROWS:
            self._charge(rows - USUAL_ROWS)

    def between(self) -> None:
        """The end of a stint; from the thread. Returns when it is this request's turn again.

        Raises:
            ClientDisconnect: the client has gone away.
        """
        if self._turns.anybody_waits:
            self._step_aside()
        else:
            self._charge(STINT_ROWS)
        self.since_s = time.monotonic()
        self._stop_if_abandoned()

    def compute(self, work: Callable[["Turn"], Result]) -> Result:
        """The work's result; in the thread."""
        with self._lock:
            self._began = True
            self._stop_if_abandoned()
        try:
            return work(self)
        finally:
            with self._lock:
                self._ended = True
            if self._abandoned:
                # A loop that has been closed has no turns to give.
                with suppress(RuntimeError):
                    self._loop.call_soon_threadsafe(self._turns.leave, self)

    def resume(self) -> None:
        """It is this request's turn; on the event loop."""
        if self.called is not None and not self.called.done():
            self.called.set_result(None)
        self._resumed.set()

    def listen(self) -> None:
        """Stop the work when the client goes away; on the event loop."""
        if self._gone is not None and self._listener is None and not self._ended:
            self._listener = asyncio.ensure_future(self._wait_for_end(self._gone))

    @property
    def is_abandoned(self) -> bool:
        """Whether nobody wants the result any more."""
        return self._abandoned

    def abandon(self) -> bool:
        """Nobody wants the result any more; on the event loop. Whether no thread is at it (any more)."""
        with self._lock:
            self._abandoned = True
            at_it = self._began and not self._ended
        self._resumed.set()
        return not at_it

    def stop_listening(self) -> None:
        """The work has ended, or goes on for nobody; on the event loop."""
        if self._listener is not None:
            self._listener.cancel()

    async def heard(self, called: "asyncio.Future[None]") -> bool:
        """Wait for a call or the client's end, whichever comes first; whether the client is still there."""
        if self._gone is None:
            await called
            return True
        listener = asyncio.ensure_future(self._gone())
        try:
            await asyncio.wait((called, listener), return_when=asyncio.FIRST_COMPLETED)
            return not listener.done()
        finally:
            listener.cancel()

    async def _wait_for_end(self, gone: Gone) -> None:
        await gone()
        self.abandon()

    def _charge(self, rows: float) -> None:
        self._loop.call_soon_threadsafe(self._turns.charge, self.client, rows)

    def _step_aside(self) -> None:
        self._resumed.clear()
        self._loop.call_soon_threadsafe(self._turns.hand_over, self)
        self._resumed.wait()
        self._stop_if_abandoned()

    def _stop_if_abandoned(self) -> None:
        if self._abandoned:
            raise ClientDisconnect


class Turns:
    """Runs work off the event loop.

    Args:
        threads: how much work is done at the same time, at least 1.
        waiting: told how many wait for their turn.
    """

    def __init__(self, threads: int, waiting: Gauge) -> None:
        self._places, self._long_places = threads, max(1, threads - 1)
        self._waiting = waiting
        self._queue: FairQueue[Turn] = FairQueue()
        self._running: set[Turn] = set()
        # Threads are more than places, for those that have stepped aside keep theirs.
        self._limiter = CapacityLimiter(float("inf"))

    @property
    def anybody_waits(self) -> bool:
        """Whether a turn that ends now would be taken by another request."""
        return len(self._queue) > 0

    @property
    def are_stuck(self) -> bool:
        """Whether every place has been taken by one and the same stint for longer than any should take."""
        now_s = time.monotonic()
        running = tuple(self._running)
        return len(running) >= self._places and all(now_s - turn.since_s > STUCK_S for turn in running)

    async def run(self, work: Callable[[Turn], Result], client: str = "", gone: Gone | None = None) -> Result:
        """What the work returns or raises.

        Args:
            work: takes its turn, which it may tell its cost and ask between its parts.
            client: by whom work is shared out.
            gone: returns when the client has gone away, which takes its request out of the queue, or ends
                it at its next pause; None where nobody can tell.

        Raises:
            ClientDisconnect: the client has gone away.
        """
        turn = Turn(self, client, gone)
        if len(self._running) < self._places and not self.anybody_waits:
            self._queue.begin(client, USUAL_ROWS)
            self._seat(turn)
        else:
            await self._wait(turn)
        try:
            return await to_thread.run_sync(
                partial(turn.compute, work), limiter=self._limiter, abandon_on_cancel=True
            )
        finally:
            turn.stop_listening()
            # Cancelled, the thread goes on to its next pause, and gives its place back by itself.
            if turn.abandon():
                self.leave(turn)

    def charge(self, client: str, rows: float) -> None:
        """Account for what a request of a client turned out to cost."""
        self._queue.charge(client, rows)

    def hand_over(self, turn: Turn) -> None:
        """Let others compute before a turn goes on."""
        if turn.is_abandoned:
            turn.resume()
            return
        turn.listen()
        self._running.discard(turn)
        self._push(turn, STINT_ROWS)
        self._call_next()

    def leave(self, turn: Turn) -> None:
        """Give a turn's place, or its place in the queue, to whoever is next."""
        if self._queue.discard(turn):
            self._waiting.dec()
        self._running.discard(turn)
        self._call_next()

    async def _wait(self, turn: Turn) -> None:
        turn.called = called = asyncio.get_running_loop().create_future()
        self._push(turn, USUAL_ROWS)
        there = False
        try:
            there = await turn.heard(called)
        finally:
            if not there:
                self.leave(turn)
        if not there:
            raise ClientDisconnect

    def _seat(self, turn: Turn) -> None:
        turn.since_s = time.monotonic()
        self._running.add(turn)

    def _push(self, turn: Turn, rows: float) -> None:
        self._queue.push(turn.client, rows, turn)
        self._waiting.inc()

    def _call_next(self) -> None:
        while len(self._running) < self._places:
            turn = self._queue.pop(self._may_compute)
            if turn is None:
                return
            self._waiting.dec()
            self._seat(turn)
            turn.resume()

    def _may_compute(self, turn: Turn) -> bool:
        return not turn.is_long or sum(other.is_long for other in self._running) < self._long_places
