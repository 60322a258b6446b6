"""Requests are computed in turns: so many at the same time in threads, the others wait, fairly by client.

A request is cut into stints: between two of them it hands its turn to whoever waits, and ends where its
client has gone away. Its client pays for the time that it computes. Long ones never have all the threads,
unless there is but one; of each client few are under way at a time.
"""

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from threading import Event, Lock
from typing import TypeVar

from anyio import CapacityLimiter, to_thread
from prometheus_client import Gauge
from starlette.requests import ClientDisconnect

from inference_api.turns.costs import LONG_ROWS, ROWS_A_SECOND, STINT_S, USUAL_ROWS, YOUNG_ROWS
from inference_api.turns.fair_queue import FairQueue

Result = TypeVar("Result")
# Takes what is to be called when the client goes away, and returns what ends that; both on the event loop.
Watch = Callable[[Callable[[], None]], Callable[[], None]]

# Long requests that have begun and not ended, each with its part of an answer: of one client, in all. The
# first of a client begins whatever the others have under way.
LONG_OF_CLIENT, LONG_AT_ONCE = 2, 16
# Computing that has not come to the end of a stint for so long does not work as it should.
STUCK_S = 20.0


class Turn:
    """One request's turn, as the work in its thread sees it. Made by :class:`Turns`.

    Args:
        turns: where it belongs.
        client: whose it is.
        watch: tells when the client goes away; None where nobody can.
    """

    def __init__(self, turns: "Turns", client: str, watch: Watch | None) -> None:
        self.client = client
        self.is_long = False
        # Nobody wants the result any more.
        self.is_abandoned = False
        # When the present stint began, and what the thread had computed by then.
        self.since_s, self._computed_s = 0.0, 0.0
        self.called: asyncio.Future[bool] | None = None
        self._turns, self._watch = turns, watch
        self._loop = asyncio.get_running_loop()
        self._began, self._ended = False, False
        # Expected to cost, and what the client has paid for, of which the first is paid in advance.
        self._rows, self._paid, self._ahead = 0.0, 0.0, USUAL_ROWS
        self._lock, self._resumed = Lock(), Event()
        self._unwatch: Callable[[], None] | None = None

    @property
    def is_young(self) -> bool:
        """Whether it has computed little so far."""
        return self._paid < YOUNG_ROWS

    def spend(self, rows: float) -> None:
        """Tell what more the request will cost; from the thread, before the cost arises.

        Args:
            rows: of :func:`inference_api.turns.costs.rows_of`.

        Raises:
            ClientDisconnect: the client has gone away.
        """
        self._rows += rows
        if self._rows > LONG_ROWS and not self.is_long:
            self._pay()
            self._step_aside(becoming_long=True)

    def between(self) -> None:
        """A moment at which others may have their turns; from the thread, as often as it likes.

        Does nothing before a stint is over; then it returns when it is this request's turn again.

        Raises:
            ClientDisconnect: the client has gone away.
        """
        if self._turns.clock() - self._computed_s < STINT_S:
            self._stop_if_abandoned()
            return
        self._pay()
        if self._paid > LONG_ROWS and not self.is_long:
            self._step_aside(becoming_long=True)
        elif self._turns.anybody_waits:
            self._step_aside()
        else:
            self._loop.call_soon_threadsafe(self.listen)
            self._stop_if_abandoned()

    def compute(self, work: Callable[["Turn"], Result]) -> Result:
        """The work's result; in the thread."""
        with self._lock:
            self._began = True
        self._computed_s = self._turns.clock()
        try:
            self._stop_if_abandoned()
            return work(self)
        finally:
            self._pay()
            with self._lock:
                self._ended = True
            if self.is_abandoned:
                # A loop that has been closed has no turns to give.
                with suppress(RuntimeError):
                    self._loop.call_soon_threadsafe(self._turns.leave, self)

    def resume(self) -> None:
        """It is this request's turn; on the event loop."""
        self._call(there=True)
        self._resumed.set()

    def listen(self) -> None:
        """Stop waiting and working when the client goes away; on the event loop."""
        if self._watch is not None and self._unwatch is None and not self._ended:
            self._unwatch = self._watch(self._leave)

    def abandon(self) -> bool:
        """Nobody wants the result any more; on the event loop. Whether no thread is at it (any more)."""
        with self._lock:
            self.is_abandoned = True
            at_it = self._began and not self._ended
        self._resumed.set()
        return not at_it

    def stop_listening(self) -> None:
        """The work has ended, or goes on for nobody; on the event loop."""
        if self._unwatch is not None:
            self._unwatch()

    def _leave(self) -> None:
        self.abandon()
        self._call(there=False)

    def _call(self, *, there: bool) -> None:
        if self.called is not None and not self.called.done():
            self.called.set_result(there)

    def _pay(self) -> None:
        """Charge the client for the stint that ends here; the next one begins."""
        computed_s = self._turns.clock()
        rows = (computed_s - self._computed_s) * ROWS_A_SECOND
        self.since_s, self._computed_s = time.monotonic(), computed_s
        self._paid += rows
        self._turns.charge(self.client, max(0.0, rows - self._ahead))
        self._ahead = max(0.0, self._ahead - rows)

    def _step_aside(self, *, becoming_long: bool = False) -> None:
        self.is_long |= becoming_long
        self._resumed.clear()
        self._loop.call_soon_threadsafe(self._turns.hand_over, self)
        self._resumed.wait()
        self._stop_if_abandoned()

    def _stop_if_abandoned(self) -> None:
        if self.is_abandoned:
            raise ClientDisconnect


class Turns:
    """Runs work off the event loop.

    Args:
        threads: how much work is done at the same time, at least 1.
        waiting: told how many wait for their turn.
        clock: how long the thread that asks has computed, s.
    """

    def __init__(self, threads: int, waiting: Gauge, clock: Callable[[], float] = time.thread_time) -> None:
        self.clock = clock
        self._places, self._long_places = threads, max(1, threads - 1)
        self._waiting = waiting
        self._queue: FairQueue[Turn] = FairQueue()
        self._running: set[Turn] = set()
        self._under_way: set[Turn] = set()
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

    async def run(
        self, work: Callable[[Turn], Result], client: str = "", watch: Watch | None = None
    ) -> Result:
        """What the work returns or raises.

        Args:
            work: takes its turn, which it may tell its cost and ask between its parts.
            client: by whom work is shared out.
            watch: tells when the client goes away, which takes its request out of the queue, or ends it at
                its next pause; None where nobody can.

        Raises:
            ClientDisconnect: the client has gone away.
        """
        turn = Turn(self, client, watch)
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
        """Account for what a request of a client turned out to cost; from any thread."""
        self._queue.charge(client, rows)

    def hand_over(self, turn: Turn) -> None:
        """Let others compute before a turn goes on."""
        if turn.is_abandoned:
            turn.resume()
            return
        turn.listen()
        self._running.discard(turn)
        self._push(turn, 0.0)
        self._call_next()

    def leave(self, turn: Turn) -> None:
        """Give a turn's place, or its place in the queue, to whoever is next."""
        if self._queue.discard(turn):
            self._waiting.dec()
        self._running.discard(turn)
        self._under_way.discard(turn)
        self._call_next()

    async def _wait(self, turn: Turn) -> None:
        turn.called = called = asyncio.get_running_loop().create_future()
        self._push(turn, USUAL_ROWS)
        # Those that wait may be long ones that may not take what is free.
        self._call_next()
        turn.listen()
        there = False
        try:
            there = await called
        finally:
            if not there:
                turn.stop_listening()
                self.leave(turn)
        if not there:
            raise ClientDisconnect

    def _seat(self, turn: Turn) -> None:
        turn.since_s = time.monotonic()
        self._running.add(turn)
        if turn.is_long:
            self._under_way.add(turn)

    def _push(self, turn: Turn, rows: float) -> None:
        self._queue.push(turn.client, rows, turn, YOUNG_ROWS if turn.is_young else 0.0)
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
        if not turn.is_long:
            return True
        if sum(other.is_long for other in self._running) >= self._long_places:
            return False
        of_client = sum(other.client == turn.client for other in self._under_way)
        is_few = of_client < LONG_OF_CLIENT and len(self._under_way) < LONG_AT_ONCE
        return is_few or of_client == 0 or turn in self._under_way
