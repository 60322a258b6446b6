"""ASGI middleware: below ``/v2`` an error is the Open Inference Protocol's ``{"error": "..."}``.

Problems (RFC 9457) are rewritten on their way out, wherever they were made: by a route, by the limit of the
body, or because there is no such page.
"""

import json

from fastapi.responses import JSONResponse
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from inference_api.problems import MEDIA_TYPE

PREFIX = "/v2"
# The protocol knows one status for a request that is wrong.
_STATUS = {422: 400}


class ProtocolErrors:
    """Rewrites problems of the protocol's pages.

    Args:
        app: whose problems.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on and its answer back."""
        path = scope.get("path", "")
        if scope["type"] != "http" or not (path == PREFIX or path.startswith(f"{PREFIX}/")):
            await self._app(scope, receive, send)
            return
        answer = _Answer(send)
        try:
            await self._app(scope, receive, answer.send)
        except Exception:
            if not answer.began:
                text = "an error that the server did not foresee; its log has it"
                await JSONResponse({"error": text}, 500)(scope, receive, send)
            raise


class _Answer:
    """Sends an answer on; a problem is held until it is whole, and rewritten."""

    def __init__(self, send: Send) -> None:
        self.began = False
        self._send = send
        self._held: Message | None = None
        self._body = b""

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.began = True
            if MutableHeaders(raw=list(message["headers"])).get("content-type") == MEDIA_TYPE:
                self._held = message
                return
        elif self._held is not None:
            self._body += message.get("body", b"")
            if not message.get("more_body", False):
                await self._rewrite(self._held)
            return
        await self._send(message)

    async def _rewrite(self, start: Message) -> None:
        body = json.dumps({"error": json.loads(self._body)["detail"]}).encode("ascii")
        headers = MutableHeaders(raw=list(start["headers"]))
        headers["content-type"] = "application/json"
        headers["content-length"] = str(len(body))
        status = _STATUS.get(start["status"], start["status"])
        await self._send({**start, "status": status, "headers": headers.raw})
        await self._send({"type": "http.response.body", "body": body})
