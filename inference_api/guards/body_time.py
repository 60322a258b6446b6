"""ASGI middleware that does not wait for a body for ever."""

import asyncio

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from inference_api.problems import REQUEST_TIMEOUT, RequestError


class BodyTime:
    """Answers 408 to a request whose body is not complete in time, and closes its connection.

    The time runs from the headers to the last byte, so a byte now and then does not help.

    Args:
        app: what is protected.
        limit_s: time for a body, in s.
    """

    def __init__(self, app: ASGIApp, limit_s: float) -> None:
        self._app = app
        self._limit_s = limit_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, timing its body."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        loop = asyncio.get_running_loop()
        until = loop.time() + self._limit_s
        complete, late = False, False

        async def timed() -> Message:
            nonlocal complete, late
            if complete:
                return await receive()
            try:
                async with asyncio.timeout_at(until):
                    message = await receive()
            except TimeoutError:
                late = True
                raise self._error() from None
            complete = message["type"] != "http.request" or not message.get("more_body", False)
            return message

        async def closing(message: Message) -> None:
            if late and message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), (b"connection", b"close")]
            await send(message)

        await self._app(scope, timed, closing)

    def _error(self) -> RequestError:
        return RequestError(
            REQUEST_TIMEOUT,
            "the body did not arrive in time",
            expected=f"all of it within {self._limit_s:g} s",
            remedy="send it again, over a faster connection or as a smaller picture",
        )
