"""ASGI middleware that refuses requests above a number in flight, at once instead of in a queue."""

from starlette.types import ASGIApp, Receive, Scope, Send

from inference_api.guards.rate import client_of
from inference_api.guards.shares import Full, Shares
from inference_api.page_names import is_watching
from inference_api.problems import OVERLOADED, problem_response

RETRY_AFTER_S = 1


class Concurrency:
    """Answers 503 while ``limit`` requests are in flight, from their headers to the end of their answers.

    A single client is refused earlier, so that its slow requests leave places for others. Health pages and
    metrics are neither counted nor refused.

    Args:
        app: what is protected.
        limit: requests at the same time.
    """

    def __init__(self, app: ASGIApp, limit: int) -> None:
        self._app = app
        self._places = Shares(limit)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http" or is_watching(scope):
            await self._app(scope, receive, send)
            return
        client = client_of(scope)
        full = self._places.take(client)
        if full is not None:
            response = problem_response(
                OVERLOADED,
                full_detail(full, "requests in flight", self._places.limit),
                remedy=f"ask again after {RETRY_AFTER_S} s, and from fewer places at once",
                headers={"Retry-After": str(RETRY_AFTER_S)},
            )
            await response(scope, receive, send)
            return
        try:
            await self._app(scope, receive, send)
        finally:
            self._places.give(client)


def full_detail(full: Full, what: str, limit: int) -> str:
    """What is said to whom got no place."""
    if full == "server":
        return f"the server is full: {limit} {what} are all that it takes"
    return f"this client's share of the server's {limit} {what} is full; others still find room"
