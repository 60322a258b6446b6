"""The scheduler: so many requests compute at the same time in threads, the others wait, fairly by client.

A request calls :meth:`Job.check_cancelled` every few ms. After 10 ms of computing it hands its place to
whoever is next, and it ends there when its client has gone away. Clients pay for the time that they compute.
Long requests never have all places, unless there is but one; of each client few are under way at a time.

Who is next: start-time fair queueing (Goyal, Vin, Cheng 1996). Each request is given a start on a virtual
clock: where the clock stands, or where what its client asked for before ends, whichever is later. The
earliest start is next.
"""

import asyncio
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from threading import Event, Lock
from typing import Generic, TypeVar

from anyio import CapacityLimiter, to_thread
from prometheus_client import Gauge
from starlette.requests import ClientDisconnect

from cspace.bundle.sampling import BUDGET, BUDGET_AT_LEAST
from cspace.bundle.spec import WAYS, BundleSpec
from cspace.query import SampleQuery
from inference_api.limits import MAX_CLIENTS, RETRY_AFTER_S, Shares, overloaded
from inference_api.problem_types import OVERLOADED, NoKernelsError, RequestError

Item = TypeVar("Item")
Result = TypeVar("Result")
# Takes what is to be called when the client goes away, and returns what ends that; both on the event loop.
Watch = Callable[[Callable[[], None]], Callable[[], None]]

# Costs are in rows: one is a sample that is drawn by the shipped model, or what takes as long.
ROWS_A_SECOND = 50_000.0
# What a request costs before more is known of it, and above what it is long.
USUAL_ROWS, LONG_ROWS = 320.0, 4096.0
# So much of a request goes before the rest of longer ones: a plan ends soon beside plans that go on for long.
YOUNG_ROWS = 8192.0
# Others have their turns after so much computing.
STINT_S = 0.01
# Long requests that have begun and not ended, each with its part of an answer: of one client, in all. The
# first of a client begins whatever the others have under way.
LONG_OF_CLIENT, LONG_AT_ONCE = 2, 16
# Computing that has not come to the end of a stint for so long does not work as it should.
STUCK_S = 20.0
# A request that is not answered by then is refused, before a proxy in front gives up (60 s) without a reason.
ANSWER_S = 50.0
# Requests that wait for models at the same time; more are refused.
LOOKUPS = 16
# So much takes as long as a row: JSON that is parsed, pixels that are decoded, values of an array.
_JSON_BYTES, _PIXELS, _VALUES = 600, 400, 100


def rows_of(
    *, rows: float = 0, json_bytes: int = 0, pixels: int = 0, values: int = 0, searches: bool = False
) -> float:
    """What a request, or a part of one, may cost at most.

    Args:
        rows: samples, or configurations that are scored.
        json_bytes: to be parsed.
        pixels: of pictures that are not known yet.
        values: of the arrays that these become.
        searches: a search lasts as long as its client wants: it is long.
    """
    parts = rows + json_bytes / _JSON_BYTES + pixels / _PIXELS + values / _VALUES
    return parts + (LONG_ROWS + 1.0 if searches else 0.0)


class FairQueue(Generic[Item]):
    """Items that wait, by client; for one thread, but for :meth:`charge`.

    Args:
        capacity: how many clients are remembered at least while they are ahead of the clock.
    """

    def __init__(self, capacity: int = MAX_CLIENTS) -> None:
        self._capacity = capacity
        self._clock = 0.0
        self._ends: dict[str, float] = {}
        # Not accounted for yet. To wake the other thread for each would cost more than what it tells.
        self._charges: deque[tuple[str, float]] = deque()
        self._waiting: list[tuple[float, Item]] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def begin(self, client: str, cost: float) -> None:
        """Accounts for work that need not wait, of a cost of 0 or more."""
        self._clock = self._start(client, cost)

    def push(self, client: str, cost: float, item: Item, lead: float = 0.0) -> None:
        """Lets an item wait.

        Args:
            client: whose it is.
            cost: of any unit, 0 or more.
            item: that waits.
            lead: how far before its start it may be next. Its client pays for it all the same.
        """
        self._waiting.append((self._start(client, cost) - lead, item))

    def charge(self, client: str, cost: float) -> None:
        """Accounts for what begun work costs beyond what was told; from any thread."""
        self._charges.append((client, cost))

    def pop(self, fits: Callable[[Item], bool]) -> Item | None:
        """The next item among those that fit, None without one; the first come of equal starts."""
        found = [(start, place) for place, (start, item) in enumerate(self._waiting) if fits(item)]
        if not found:
            return None
        start, place = min(found)
        self._clock = max(self._clock, start)
        return self._waiting.pop(place)[1]

    def discard(self, item: Item) -> bool:
        """Takes an item out; whether it was there."""
        before = len(self._waiting)
        self._waiting = [entry for entry in self._waiting if entry[1] is not item]
        return len(self._waiting) < before

    def _start(self, client: str, cost: float) -> float:
        while self._charges:
            self._extend(*self._charges.popleft())
        if len(self._ends) > self._capacity:
            self._ends = {name: end for name, end in self._ends.items() if end > self._clock}
        return self._extend(client, cost)

    def _extend(self, client: str, cost: float) -> float:
        start = max(self._clock, self._ends.get(client, 0.0))
        self._ends[client] = start + cost
        return start


class Job:
    """One request in the scheduler, as the work in its thread sees it. Made by :class:`Scheduler`.

    Args:
        scheduler: where it belongs.
        client: whose it is.
        watch: tells when the client goes away; None where nobody can.
    """

    def __init__(self, scheduler: "Scheduler", client: str, watch: Watch | None) -> None:
        self.client = client
        self.is_long = False
        # Nobody wants the result any more.
        self.is_abandoned = False
        self.is_late = False
        # When the present stint began, and what the thread had computed by then.
        self.since_s, self._computed_s = 0.0, 0.0
        self.called: asyncio.Future[bool] | None = None
        self._scheduler, self._watch = scheduler, watch
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
        """Tells what more the request will cost, as :func:`rows_of` has it; from the thread, in advance.

        Raises:
            ClientDisconnect: the client has gone away.
        """
        self._rows += rows
        if self._rows > LONG_ROWS and not self.is_long:
            self._pay()
            self._step_aside(becoming_long=True)

    def check_cancelled(self) -> None:
        """Lets others compute where a stint is over, and ends a request that nobody wants; from the thread.

        Raises:
            ClientDisconnect: the client has gone away.
        """
        if self._scheduler.clock() - self._computed_s < STINT_S:
            self._stop_if_abandoned()
            return
        self._pay()
        if self._paid > LONG_ROWS and not self.is_long:
            self._step_aside(becoming_long=True)
        elif self._scheduler.anybody_waits:
            self._step_aside()
        else:
            self._loop.call_soon_threadsafe(self.listen)
            self._stop_if_abandoned()

    @contextmanager
    def searching(self) -> Iterator[Callable[[], None]]:
        """Pays for a search; gives what the search calls now and then.

        Raises:
            NoKernelsError: the compiler of the checks is not installed.
            ClientDisconnect: the client has gone away.
        """
        self.spend(rows_of(searches=True))
        try:
            yield self.check_cancelled
        except ImportError as error:
            raise NoKernelsError(
                "this server does not plan",
                expected="the packages of the extra plan",
                got=f"no {error.name or 'compiler'}",
                remedy="ask a server that has them, or sample here and plan elsewhere",
            ) from error

    def sampling(
        self, spec: BundleSpec, query: SampleQuery, pictures: int = 1
    ) -> AbstractContextManager[Callable[[], None]]:
        """Pays for samples; gives what the sampler calls between its parts. Raises as :meth:`searching`."""
        if spec.model_kind == WAYS:
            return self.searching()
        threshold = spec.confidence_threshold if query.min_confidence is None else query.min_confidence
        rows = max(BUDGET * query.n, BUDGET_AT_LEAST) if threshold else query.n
        self.spend(rows_of(rows=pictures * rows))
        return nullcontext(self.check_cancelled)

    def compute(self, work: Callable[["Job"], Result]) -> Result:
        """The work's result; in the thread."""
        with self._lock:
            self._began = True
        self._computed_s = self._scheduler.clock()
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
                    self._loop.call_soon_threadsafe(self._scheduler.leave, self)

    def resume(self) -> None:
        """It is this request's turn; on the event loop."""
        self._call(there=True)
        self._resumed.set()

    def listen(self) -> None:
        """Stops waiting and working when the client goes away; on the event loop."""
        if self._watch is not None and self._unwatch is None and not self._ended:
            self._unwatch = self._watch(self._leave)

    def abandon(self) -> bool:
        """Nobody wants the result any more; on the event loop. Whether no thread is at it (any more)."""
        with self._lock:
            self.is_abandoned = True
            at_it = self._began and not self._ended
        self._resumed.set()
        return not at_it

    def give_up(self) -> None:
        """It takes too long; on the event loop."""
        self.is_late = True
        self._leave()

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
        """Charges the client for the stint that ends here; the next one begins."""
        computed_s = self._scheduler.clock()
        rows = (computed_s - self._computed_s) * ROWS_A_SECOND
        self.since_s, self._computed_s = time.monotonic(), computed_s
        self._paid += rows
        self._scheduler.charge(self.client, max(0.0, rows - self._ahead))
        self._ahead = max(0.0, self._ahead - rows)

    def _step_aside(self, *, becoming_long: bool = False) -> None:
        self.is_long |= becoming_long
        self._resumed.clear()
        self._loop.call_soon_threadsafe(self._scheduler.hand_over, self)
        self._resumed.wait()
        self._stop_if_abandoned()

    def _stop_if_abandoned(self) -> None:
        if self.is_abandoned:
            raise ClientDisconnect


class Scheduler:
    """Runs work off the event loop.

    Args:
        threads: how much work is done at the same time, at least 1.
        waiting: told how many wait for their turn.
        clock: how long the thread that asks has computed, s.
        answer_s: how long a request may take, waiting included.
    """

    def __init__(
        self,
        threads: int,
        waiting: Gauge,
        clock: Callable[[], float] = time.thread_time,
        answer_s: float = ANSWER_S,
    ) -> None:
        self.clock, self._answer_s = clock, answer_s
        self._places, self._long_places = threads, max(1, threads - 1)
        self._waiting = waiting
        self._queue: FairQueue[Job] = FairQueue()
        self._running: set[Job] = set()
        self._under_way: set[Job] = set()
        # Threads are more than places, for those that have stepped aside keep theirs.
        self._limiter = CapacityLimiter(float("inf"))

    @property
    def anybody_waits(self) -> bool:
        """Whether a place that becomes free would be taken by another request."""
        return len(self._queue) > 0

    @property
    def is_stuck(self) -> bool:
        """Whether every place has been taken by one and the same stint for longer than any should take."""
        now_s = time.monotonic()
        running = tuple(self._running)
        return len(running) >= self._places and all(now_s - job.since_s > STUCK_S for job in running)

    async def run(
        self, work: Callable[[Job], Result], client: str = "", watch: Watch | None = None
    ) -> Result:
        """What the work returns or raises.

        Args:
            work: takes its job, which it tells its cost and asks between its parts.
            client: by whom work is shared out.
            watch: tells when the client goes away, which takes its request out of the queue, or ends it at
                its next check; None where nobody can.

        Raises:
            ClientDisconnect: the client has gone away.
            RequestError: it takes too long, for others compute, too.
        """
        job = Job(self, client, watch)
        late = asyncio.get_running_loop().call_later(self._answer_s, job.give_up)
        try:
            return await self._run(job, work)
        except ClientDisconnect:
            if not job.is_late:
                raise
            raise RequestError(
                OVERLOADED,
                "the server is too busy for this request",
                expected=f"an answer within {self._answer_s:g} s",
                got="other requests that compute at the same time",
                remedy="ask for less at once, or again in some seconds",
                headers={"Retry-After": str(RETRY_AFTER_S)},
            ) from None
        finally:
            late.cancel()

    async def _run(self, job: Job, work: Callable[[Job], Result]) -> Result:
        if len(self._running) < self._places and not self.anybody_waits:
            self._queue.begin(job.client, USUAL_ROWS)
            self._seat(job)
        else:
            await self._wait(job)
        try:
            return await to_thread.run_sync(
                partial(job.compute, work), limiter=self._limiter, abandon_on_cancel=True
            )
        finally:
            job.stop_listening()
            # Cancelled, the thread goes on to its next check, and gives its place back by itself.
            if job.abandon():
                self.leave(job)

    def charge(self, client: str, rows: float) -> None:
        """Accounts for what a request of a client turned out to cost; from any thread."""
        self._queue.charge(client, rows)

    def hand_over(self, job: Job) -> None:
        """Lets others compute before a job goes on."""
        if job.is_abandoned:
            job.resume()
            return
        job.listen()
        self._running.discard(job)
        self._push(job, 0.0)
        self._call_next()

    def leave(self, job: Job) -> None:
        """Gives a job's place, or its place in the queue, to whoever is next."""
        if self._queue.discard(job):
            self._waiting.dec()
        self._running.discard(job)
        self._under_way.discard(job)
        self._call_next()

    async def _wait(self, job: Job) -> None:
        job.called = called = asyncio.get_running_loop().create_future()
        self._push(job, USUAL_ROWS)
        # Those that wait may be long ones that may not take what is free.
        self._call_next()
        job.listen()
        there = False
        try:
            there = await called
        finally:
            if not there:
                job.stop_listening()
                self.leave(job)
        if not there:
            raise ClientDisconnect

    def _seat(self, job: Job) -> None:
        job.since_s = time.monotonic()
        self._running.add(job)
        if job.is_long:
            self._under_way.add(job)

    def _push(self, job: Job, rows: float) -> None:
        self._queue.push(job.client, rows, job, YOUNG_ROWS if job.is_young else 0.0)
        self._waiting.inc()

    def _call_next(self) -> None:
        while len(self._running) < self._places:
            job = self._queue.pop(self._may_compute)
            if job is None:
                return
            self._waiting.dec()
            self._seat(job)
            job.resume()

    def _may_compute(self, job: Job) -> bool:
        if not job.is_long:
            return True
        if sum(other.is_long for other in self._running) >= self._long_places:
            return False
        of_client = sum(other.client == job.client for other in self._under_way)
        is_few = of_client < LONG_OF_CLIENT and len(self._under_way) < LONG_AT_ONCE
        return is_few or of_client == 0 or job in self._under_way


class Lookups:
    """Runs what may wait long for the registry and computes nothing, in threads of its own."""

    def __init__(self) -> None:
        self._shares = Shares(LOOKUPS)
        self._limiter = CapacityLimiter(LOOKUPS)

    async def run(self, wait: Callable[[], Result], client: str = "") -> Result:
        """What the call returns or raises, in a thread; one that is cancelled is left to its own end.

        Raises:
            RequestError: all places, or the client's share of them, are taken.
        """
        full = self._shares.take(client)
        if full is not None:
            raise overloaded(full, "requests that wait for models", self._shares.limit)
        try:
            return await to_thread.run_sync(wait, limiter=self._limiter, abandon_on_cancel=True)
        finally:
            self._shares.give(client)
