"""ASGI middleware that refuses requests above a number in flight, at once instead of in a queue."""

from starlette.types import ASGIApp, Receive, Scope, Send

from inference_api.guards.pages import is_watching
from inference_api.problems import OVERLOADED, problem_response

RETRY_AFTER_S = 1


class Concurrency:
    """Answers 503 while ``limit`` requests are in flight, from their headers to the end of their answers.

    Health pages and metrics are neither counted nor refused.

    Args:
        app: what is protected.
        limit: requests at the same time.
    """

    def __init__(self, app: ASGIApp, limit: int) -> None:
        self._app = app
        self._limit = limit
        self._in_flight = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http" or is_watching(scope):
            await self._app(scope, receive, send)
            return
        # No lock: nothing is awaited between the look and the count, and one loop runs them all.
        if self._in_flight >= self._limit:
            response = problem_response(
                OVERLOADED,
                f"{self._limit} requests are being answered already",
                remedy=f"ask again after {RETRY_AFTER_S} s, and from fewer places at once",
                headers={"Retry-After": str(RETRY_AFTER_S)},
            )
            await response(scope, receive, send)
            return
        self._in_flight += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._in_flight -= 1
