"""ASGI middleware that answers where nobody else did."""

import asyncio
import logging

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from inference_api.problems import SHUTTING_DOWN, failure_response, problem_response

_LOG = logging.getLogger(__name__)


class LastResort:
    """Logs an error that nobody caught and answers 500, inside the middlewares that watch and rewrite.

    The framework's own last resort lies outside of them all: its answer would carry neither a request id nor
    security headers. A request that is cut off at the server's end is told so with 503.

    Args:
        app: that may fail.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began = False

        async def seen(message: Message) -> None:
            nonlocal began
            began = True
            await send(message)

        try:
            await self._app(scope, receive, seen)
        except asyncio.CancelledError:
            # The server cancels what is in flight when its time to end is up, and does nothing after it.
            if not began:
                await problem_response(
                    SHUTTING_DOWN,
                    "the server was told to end before this request was answered",
                    remedy="ask again: another process may answer by then",
                    headers={"Connection": "close", "Retry-After": "1"},
                )(scope, receive, send)
            raise
        except Exception as error:
            if began:
                raise
            _LOG.exception("an error that nobody foresaw")
            await failure_response(error)(scope, receive, send)
