"""Token buckets by client, and the ASGI middleware that asks them."""

import math
import time
from collections import OrderedDict
from collections.abc import Callable

from starlette.types import ASGIApp, Receive, Scope, Send

from inference_api.guards.addresses import subscriber
from inference_api.guards.authentication import CLIENT
from inference_api.page_names import is_watching
from inference_api.problems import TOO_MANY_REQUESTS, problem_response

MAX_CLIENTS = 4096


class TokenBuckets:
    """One bucket a client: full at first, a token a request, refilled evenly.

    Args:
        rate_per_s: tokens that come back each second, above 0.
        burst: tokens that a bucket holds.
        capacity: how many clients are remembered; the one that asked longest ago is forgotten first.
        clock: seconds, monotonic.
    """

    def __init__(
        self,
        rate_per_s: float,
        burst: int,
        *,
        capacity: int = MAX_CLIENTS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._rate_per_s = rate_per_s
        self._burst = burst
        self._capacity = capacity
        self._clock = clock
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._buckets)

    def take(self, client: str) -> float:
        """Take a token; 0.0, or without one the time in s until there is one."""
        now = self._clock()
        held, then = self._buckets.get(client, (float(self._burst), now))
        held = min(self._burst, held + (now - then) * self._rate_per_s)
        wait_s = 0.0 if held >= 1.0 else (1.0 - held) / self._rate_per_s
        self._buckets[client] = (held - 1.0 if wait_s == 0.0 else held, now)
        self._buckets.move_to_end(client)
        if len(self._buckets) > self._capacity:
            self._buckets.popitem(last=False)
        return wait_s


class RateLimit:
    """Answers 429 to a client that asks more often than it may; health pages and metrics do not count.

    Args:
        app: what is protected.
        buckets: of the clients.
    """

    def __init__(self, app: ASGIApp, buckets: TokenBuckets) -> None:
        self._app = app
        self._buckets = buckets

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http" or is_watching(scope):
            await self._app(scope, receive, send)
            return
        wait_s = self._buckets.take(client_of(scope))
        if wait_s == 0.0:
            await self._app(scope, receive, send)
            return
        seconds = math.ceil(wait_s)
        response = problem_response(
            TOO_MANY_REQUESTS,
            "this client asks more often than it may",
            remedy=f"ask again after {seconds} s",
            headers={"Retry-After": str(seconds)},
        )
        await response(scope, receive, send)


def client_of(scope: Scope) -> str:
    """By whom requests are counted: the name of the key, else the peer's address, of IPv6 the first half."""
    if CLIENT in scope:
        return f"key {scope[CLIENT]}"
    return f"peer {subscriber((scope.get('client') or ('unknown', 0))[0])}"
