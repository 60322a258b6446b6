"""Who may ask from where, and how much: hosts and origins, bodies and deadlines, places to compute.

nginx bounds slow connections and rates in deployments (SECURITY.md); this bounds what a request may take of
the process.
"""

import asyncio
import math
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterable
from contextlib import AsyncExitStack
from typing import Annotated
from weakref import WeakValueDictionary

from anyio import CancelScope, CapacityLimiter, current_time, fail_after
from fastapi import Depends, Request
from prometheus_client import Gauge
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from inference_api.problems import (
    BODY_TOO_LARGE,
    FOREIGN_ORIGIN,
    REQUEST_TIMEOUT,
    RequestError,
    overloaded,
    problem_response,
)

MAX_BODY_BYTES = 8 * 1024 * 1024
# Of all bodies that have arrived and are not answered.
MAX_HELD_BYTES = 8 * MAX_BODY_BYTES
# From the headers to the last byte of a body.
BODY_TIMEOUT_S = 30.0
# A request that is not answered by then is refused, before a proxy in front gives up (60 s) without a reason.
ANSWER_S = 50.0
# Of places and bytes, what one client may take at most.
CLIENT_SHARE = 0.75
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
HEALTH = ("/health/live", "/health/ready")
METRICS, SEARCH = "/metrics", "/plan"
WORKBENCH_FILES = "/workbench/files"
WAITING = Gauge("cspace_requests_waiting", "Requests that wait for a place to compute.")


def client_of(scope: Scope) -> str:
    """By whom requests are counted: the name of the key, else the peer's address."""
    name = scope.get("state", {}).get("client")
    return f"peer {(scope.get('client') or ('unknown', 0))[0]}" if name is None else f"key {name}"


class RefuseForeignOrigins:
    """ASGI middleware: 403 for pages of other sites, but those at ``origins``.

    A page of any site makes its visitor's browser ask servers on loopback. That shows in headers that no page
    can forge. One whose name is made to mean 127.0.0.1 (DNS rebinding) is refused by its Host header.
    """

    def __init__(self, app: ASGIApp, origins: Iterable[str]) -> None:
        self._app, self._origins = app, frozenset(map(str.lower, origins))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["path"] not in HEALTH and self._is_foreign(scope):
            raise RequestError(
                FOREIGN_ORIGIN,
                "the request comes from a page of another site",
                remedy="have the server's CSPACE_API_ORIGINS name the page's origin",
            )
        await self._app(scope, receive, send)

    def _is_foreign(self, scope: Scope) -> bool:
        headers = Headers(scope=scope)
        origin = headers.get("origin")
        if origin is not None:
            own = f"{scope['scheme']}://{headers.get('host', '')}"
            return origin.lower() not in (own.lower(), *self._origins)
        if headers.get("sec-fetch-site") not in ("cross-site", "same-site"):
            return False
        # A link to a page of this server: the visitor leaves the other site.
        return not (scope["method"] == "GET" and headers.get("sec-fetch-mode") == "navigate")


class Shares:
    """So many places, of which one client holds a part at most; for one event loop."""

    def __init__(self, limit: int, what: str) -> None:
        self._limit, self._what = limit, what
        self._held: Counter[str] = Counter()

    def take(self, client: str, amount: int = 1) -> None:
        """Takes places for a client; raises RequestError where there are not as many."""
        if self._held.total() + amount > self._limit:
            raise overloaded(f"the server is full: {self._limit} {self._what} are all that it takes")
        if self._held[client] + amount > max(1, int(CLIENT_SHARE * self._limit)):
            raise overloaded(f"this client's share of the server's {self._limit} {self._what} is full")
        self._held[client] += amount

    def give(self, client: str, amount: int = 1) -> None:
        """Gives places back."""
        self._held -= Counter({client: amount})


class LimitRequests:
    """ASGI middleware: bounds requests in flight, their bodies, and the time until a body is here.

    It notes in ``state.deadline`` until when a request has to be answered, see :class:`Place`. Health pages
    and metrics matter most when a server is overloaded, and are not counted.
    """

    def __init__(self, app: ASGIApp, max_in_flight: int) -> None:
        self._app = app
        self._places = Shares(max_in_flight, "requests in flight")
        self._bytes = Shares(MAX_HELD_BYTES, "bytes of bodies")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["path"] in (*HEALTH, METRICS):
            await self._app(scope, receive, send)
            return
        client, size, until = client_of(scope), 0, time.monotonic() + BODY_TIMEOUT_S

        async def receive_bounded() -> Message:
            nonlocal size, until
            try:
                # However the body trickles, its time runs from the headers on.
                with fail_after(max(0.0, until - time.monotonic())):
                    message = await receive()
            except TimeoutError:
                raise RequestError(
                    REQUEST_TIMEOUT,
                    f"the body did not arrive within {BODY_TIMEOUT_S:g} s",
                    remedy="send it again, over a faster connection or as a smaller picture",
                    headers={"Connection": "close"},
                ) from None
            if not message.get("more_body", False):
                # What comes after it is that the client goes away.
                until = math.inf
            more = len(message.get("body", b""))
            if size + more > MAX_BODY_BYTES:
                raise RequestError(
                    BODY_TOO_LARGE,
                    "the body is too large",
                    expected=f"at most {MAX_BODY_BYTES} bytes",
                    remedy="send a smaller picture; 2048 pixels a side are the most that is accepted",
                )
            self._bytes.take(client, more)
            size += more
            return message

        try:
            self._places.take(client)
        except RequestError as error:
            await problem_response(error)(scope, receive, send)
            return
        scope.setdefault("state", {})["deadline"] = time.monotonic() + ANSWER_S
        try:
            await self._app(scope, receive_bounded, send)
        finally:
            self._places.give(client)
            self._bytes.give(client, size)


class Place:
    """A request's place to compute; searches ask it now and then whether to go on."""

    def __init__(self, deadline: float) -> None:
        self.deadline, self.is_abandoned = deadline, False

    def check_cancelled(self) -> None:
        """Raises where the client has gone away or the deadline has passed; cheap, and for any thread."""
        if self.is_abandoned:
            raise ClientDisconnect
        if time.monotonic() > self.deadline:
            raise overloaded(f"the server is too busy to answer this request within {ANSWER_S:g} s")


class ComputePlaces:
    """As many places as cores; a client never holds the last one, unless there is but one."""

    def __init__(self, cores: int) -> None:
        self.all = CapacityLimiter(cores)
        # Searches take long: they never hold the last place together, either.
        self.searches = CapacityLimiter(max(1, cores - 1))
        # The JSON parser holds up all other threads, so one at a time is enough.
        self.parsing = CapacityLimiter(1)
        self._of_client = max(1, cores - 1)
        # A client's limiter is there as long as one of its requests is.
        self._clients: WeakValueDictionary[str, CapacityLimiter] = WeakValueDictionary()

    def of(self, client: str) -> CapacityLimiter:
        """The places of one client."""
        return self._clients.setdefault(client, CapacityLimiter(self._of_client))


async def take_place(request: Request) -> AsyncIterator[Place]:
    """FastAPI's dependency: a place to compute, for a request whose body and model are there."""
    places: ComputePlaces = request.app.state.places
    limiters = [places.of(client_of(request.scope)), places.all]
    if request.url.path == SEARCH:
        limiters.insert(1, places.searches)
    place, patience = Place(request.state.deadline), CancelScope(deadline=current_time() + ANSWER_S)
    async with AsyncExitStack() as held:
        held.callback(asyncio.create_task(_watch(request, place, patience)).cancel)
        with patience:
            for limiter in limiters:
                with WAITING.track_inprogress():
                    await limiter.acquire_on_behalf_of(place)
                held.callback(limiter.release_on_behalf_of, place)
        place.check_cancelled()
        try:
            yield place
        finally:
            # Also where the server ends, and the route is still running in its thread.
            place.is_abandoned = True


async def _watch(request: Request, place: Place, patience: CancelScope) -> None:
    """Abandons a place when the client goes away; what comes after a body is nothing else."""
    while (await request.receive())["type"] != "http.disconnect":
        pass
    place.is_abandoned = True
    patience.cancel()


# Given back before the answer is sent: whoever reads slowly holds none.
ComputePlace = Annotated[Place, Depends(take_place, scope="function")]
