"""ASGI middleware that refuses bodies above a size, announced or not, and above what all may hold."""

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from inference_api.guards.concurrency import RETRY_AFTER_S, full_detail
from inference_api.guards.rate import client_of
from inference_api.guards.shares import Full, Shares
from inference_api.problems import BODY_TOO_LARGE, OVERLOADED, RequestError, problem_response

MAX_BODY_BYTES = 8 * 1024 * 1024
_MAX_DIGITS = 30
_RETRY_AFTER = (b"retry-after", str(RETRY_AFTER_S).encode())


class BodyLimit:
    """Answers 413 to a body that announces more than ``limit`` bytes, or sends more without announcing.

    What has arrived counts until its request is answered; 503 is the answer where all bodies together, or
    those of one client, would be too much.

    Args:
        app: what is protected.
        limit: largest body, in bytes.
        held_bytes: of all bodies together, above ``limit``.
    """

    def __init__(
        self, app: ASGIApp, limit: int = MAX_BODY_BYTES, held_bytes: int = 8 * MAX_BODY_BYTES
    ) -> None:
        self._app = app
        self._limit = limit
        self._held = Shares(held_bytes)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, counting its body."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        # Without leading zeros, of which there may be more than Python turns into a number.
        announced = dict(scope["headers"]).get(b"content-length", b"0").lstrip(b"0")[:_MAX_DIGITS]
        if announced.isdigit() and int(announced) > self._limit:
            error = self._error(f"{int(announced)} bytes")
            response = problem_response(
                BODY_TOO_LARGE, str(error), expected=error.expected, got=error.got, remedy=error.remedy
            )
            await response(scope, receive, send)
            return
        read, client, full = 0, client_of(scope), None

        async def counted() -> Message:
            nonlocal read, full
            message = await receive()
            size = len(message.get("body", b""))
            if read + size > self._limit:
                raise self._error(f"more than {self._limit} bytes")
            if size:
                full = self._held.take(client, size)
                if full is not None:
                    raise self._full_error(full)
                read += size
            return message

        async def hinting(message: Message) -> None:
            if full is not None and message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), _RETRY_AFTER]
            await send(message)

        try:
            await self._app(scope, counted, hinting)
        finally:
            if read:
                self._held.give(client, read)

    def _full_error(self, full: Full) -> RequestError:
        return RequestError(
            OVERLOADED,
            full_detail(full, "bytes of bodies", self._held.limit),
            remedy=f"ask again after {RETRY_AFTER_S} s, and from fewer places at once",
        )

    def _error(self, got: str) -> RequestError:
        return RequestError(
            BODY_TOO_LARGE,
            "the body is too large",
            expected=f"at most {self._limit} bytes",
            got=got,
            remedy="send a smaller picture; 2048 pixels a side are the most that is accepted",
        )
