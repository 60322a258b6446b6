"""ASGI middleware that refuses bodies above a size, announced or not."""

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from inference_api.problems import BODY_TOO_LARGE, RequestError, problem_response

MAX_BODY_BYTES = 8 * 1024 * 1024


class BodyLimit:
    """Answers 413 to a body that announces more than ``limit`` bytes, or sends more without announcing.

    Args:
        app: what is protected.
        limit: largest body, in bytes.
    """

    def __init__(self, app: ASGIApp, limit: int = MAX_BODY_BYTES) -> None:
        self._app = app
        self._limit = limit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, counting its body."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        announced = dict(scope["headers"]).get(b"content-length", b"0")
        if announced.isdigit() and int(announced) > self._limit:
            error = self._error(f"{int(announced)} bytes")
            response = problem_response(
                BODY_TOO_LARGE, str(error), expected=error.expected, got=error.got, remedy=error.remedy
            )
            await response(scope, receive, send)
            return
        read = 0

        async def counted() -> Message:
            nonlocal read
            message = await receive()
            read += len(message.get("body", b""))
            if read > self._limit:
                raise self._error(f"more than {self._limit} bytes")
            return message

        await self._app(scope, counted, send)

    def _error(self, got: str) -> RequestError:
        return RequestError(
            BODY_TOO_LARGE,
            "the body is too large",
            expected=f"at most {self._limit} bytes",
            got=got,
            remedy="send a smaller picture; 2048 pixels a side are the most that is accepted",
        )
