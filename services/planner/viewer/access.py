"""Who may open the page and what it may send: hosts, origins, a token, few uploads, no public tunnel.

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

UPLOADS, UPLOAD_BYTES = 2, 64 * 2**20
# Browsers send parts of 512 KiB.
_MESSAGE_BYTES, _PARTS = 2**20, 1024


def open_server(host: str, port: int, **options: Any) -> tuple[viser.ViserServer, str]:
    """A viser server with these checks, and the address that opens its page."""
    token, hosts = secrets.token_urlsafe(24), frozenset({host, "localhost", "127.0.0.1", "[::1]"})
    with _admitting(lambda request: refusal(request, hosts, token)):
        server = viser.ViserServer(host, port, **options)
    for request in (messages.ShareUrlRequest, messages.ShareUrlDisconnect):
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


class Uploads:
    """Bounds uploads in number and size: those that arrive, and those in ``reading`` (sizes in bytes)."""

    def __init__(self, server: viser.ViserServer, refused: Callable[[], None]) -> None:
        self.reading: list[int] = []
        self._gui: Any = server.gui
        self._arriving: dict[str, Any] = self._gui._current_file_upload_states  # noqa: SLF001 - as above
        self._refused = refused
        own: dict[Any, Any]
        own = {messages.FileTransferStartUpload: self._start, messages.FileTransferPart: self._part}
        for kind, handler in own.items():
            server._connection.unregister_handler(kind)  # noqa: SLF001 - as above
            server._connection.register_handler(kind, handler)  # noqa: SLF001 - as above

    def _start(self, client: Any, message: messages.FileTransferStartUpload) -> None:
        sizes = [*self.reading, *(one["total_bytes"] for one in self._arriving.values()), message.size_bytes]
        fits = len(sizes) <= UPLOADS and sum(sizes) <= UPLOAD_BYTES and message.part_count <= _PARTS
        # viser forgets the uploads of a client that leaves only if it has sent its camera.
        known = self._gui._resolve_client(client) is not None and message.size_bytes >= 0  # noqa: SLF001 - as above
        if fits and known and message.transfer_uuid not in self._arriving:
            self._gui._handle_file_transfer_start(client, message)  # noqa: SLF001 - as above
        else:
            self._refused()

    def _part(self, client: Any, message: messages.FileTransferPart) -> None:
        arriving = self._arriving.get(message.transfer_uuid)
        if arriving is None or arriving["client_id"] != client:
            return
        if arriving["transferred_bytes"] + len(message.content) > arriving["total_bytes"]:
            del self._arriving[message.transfer_uuid]
        else:
            self._gui._handle_file_transfer_part(client, message)  # noqa: SLF001 - as above
