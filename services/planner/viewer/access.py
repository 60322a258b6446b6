"""Who may open the page: hosts, origins, a token; no public tunnel, no file transfers.

viser checks none of these. Its page connects to the path that it was opened at, so the token is the first
part of the path, and a page of another site, which does not know it, can neither connect nor read.
"""

import hmac
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any

import viser
import viser._messages as messages
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

_MESSAGE_BYTES = 2**20
_UNUSED = (
    messages.ShareUrlRequest,
    messages.ShareUrlDisconnect,
    messages.FileTransferStartUpload,
    messages.FileTransferPart,
)


def open_server(host: str, port: int, **options: Any) -> tuple[viser.ViserServer, str]:
    """A viser server with these checks, and the address that opens its page."""
    token, hosts = secrets.token_urlsafe(24), frozenset({host, "localhost", "127.0.0.1", "[::1]"})
    with _admitting(lambda request: refusal(request, hosts, token)):
        server = viser.ViserServer(host, port, **options)
    for request in _UNUSED:
        server._connection.unregister_handler(request)  # noqa: SLF001 - there is no setting for it
    server.gui.configure_theme(show_share_button=False)
    return server, f"http://{host}:{server.get_port()}/{token}/"


def refusal(request: Request, hosts: frozenset[str], token: str) -> tuple[HTTPStatus, str] | None:
    """Why a handshake or a page is refused; None admits it and takes the token off its path."""
    host = ",".join(request.headers.get_all("Host")).lower()
    if (host[: host.find("]") + 1] or host.partition(":")[0]) not in hosts or "," in host:
        return HTTPStatus.MISDIRECTED_REQUEST, "The viewer does not answer under this name.\n"
    if any(origin.lower() != f"http://{host}" for origin in request.headers.get_all("Origin")):
        return HTTPStatus.FORBIDDEN, "The request comes from a page of another site.\n"
    given, _, rest = request.path.removeprefix("/").partition("?")[0].partition("/")
    if not hmac.compare_digest(given.encode(), token.encode()):
        return HTTPStatus.FORBIDDEN, "Open the address that the viewer printed: it holds a token.\n"
    request.path = f"/{rest}"
    return None


@contextmanager
def _admitting(refusal: Callable[[Request], tuple[HTTPStatus, str] | None]) -> Iterator[None]:
    """Makes viser, which starts its server within its constructor, ask before each handshake."""
    serve = websockets.asyncio.server.serve

    def guarded(*arguments: Any, process_request: Any, **options: Any) -> Any:
        def admit(connection: ServerConnection, request: Request) -> Response | None:
            if refused := refusal(request):
                return connection.respond(*refused)
            page: Response | None = process_request(connection, request)
            if page is not None:
                page.headers["Referrer-Policy"] = "no-referrer"
            return page

        return serve(*arguments, **options | {"process_request": admit, "max_size": _MESSAGE_BYTES})

    websockets.asyncio.server.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]
