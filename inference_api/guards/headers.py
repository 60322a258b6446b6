"""ASGI middleware for the headers that tell browsers what not to do with an answer."""

from starlette.types import ASGIApp, Message, Receive, Scope, Send

# After OWASP's REST Security Cheat Sheet. A page that needs more, /docs, brings a policy of its own.
SECURITY_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
RAW_SECURITY_HEADERS = [(name.lower().encode(), value.encode()) for name, value in SECURITY_HEADERS.items()]


class SecurityHeaders:
    """Adds :data:`SECURITY_HEADERS` to every answer that does not have its own.

    Args:
        app: whose answers they are.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = message.get("headers", [])
                own = {name.lower() for name, _ in headers}
                message["headers"] = [
                    *headers,
                    *(header for header in RAW_SECURITY_HEADERS if header[0] not in own),
                ]
            await send(message)

        await self._app(scope, receive, with_headers)
