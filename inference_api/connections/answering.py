"""What is done to every answer on its way out, outside of the app."""

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uvicorn._types import ASGI3Application, ASGIReceiveCallable, ASGISendCallable, ASGISendEvent, Scope
    from uvicorn.protocols.http.httptools_impl import RequestResponseCycle


def closing_where_unread(
    app: "ASGI3Application",
    cycle: "RequestResponseCycle",
    lingering: Callable[[], asyncio.Transport],
) -> "ASGI3Application":
    """An app whose answer ends the connection where it begins before the request has been read to its end.

    Args:
        app: that answers.
        cycle: of uvicorn, with the request.
        lingering: makes a transport that waits for the client to have read the answer.
    """

    async def answer(scope: "Scope", receive: "ASGIReceiveCallable", send: "ASGISendCallable") -> None:
        async def closing(message: "ASGISendEvent") -> None:
            if cycle.more_body and not cycle.response_started:
                cycle.keep_alive = False
                cycle.transport = lingering()
            await send(message)

        try:
            await app(scope, receive, closing)
        except asyncio.CancelledError:
            # At the server's end; uvicorn would log it as an error, and this task ends here all the same.
            if not cycle.response_complete:
                raise

    return answer
