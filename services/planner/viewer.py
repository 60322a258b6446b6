"""Serve a page that shows an arm among obstacles in 3D, with the API's samples and plans.

viser checks neither hosts nor origins. Its page connects to the path that it was opened at, so the token is
the first part of the path, and a page of another site, which does not know it, can neither connect nor read.
Public tunnels and file transfers are off.
"""

import argparse
import contextlib
import hmac
import io
import secrets
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from http import HTTPStatus
from typing import Any

import httpx
import viser
import viser._messages as messages
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from cspace.errors import CspaceError, InputError
from cspace.world import World
from cspace.worlds import read_world
from cspace_client import ClientError, SamplingClient
from services.planner.samples import usual_api
from services.planner.viewer_panels import PlanPanel, ScenePanel, as_text
from services.planner.viewer_state import SceneState

# The camera looks here, m in the base frame.
FOCUS_M = (0.45, 0.0, 0.35)
_MESSAGE_BYTES = 2**20
# Of viser, switched off.
_UNUSED = (
    messages.ShareUrlRequest,
    messages.ShareUrlDisconnect,
    messages.FileTransferStartUpload,
    messages.FileTransferPart,
)


class Viewer:
    """Shows a planning problem, and changes it; ``address`` opens the page."""

    def __init__(self, api: SamplingClient, model: str, host: str, port: int) -> None:
        self.api, self.lock = api, threading.RLock()
        # Before a port is taken: whoever names a wrong model gets an error and no page.
        self.state = SceneState(api, world_of(api.url, model), model)
        self.server, self.address = open_server(host, port, label="cspace-sampler", verbose=False)
        self.server.initial_camera.position = (1.6, -1.3, 1.3)
        self.server.initial_camera.look_at = FOCUS_M
        self.server.scene.set_up_direction("+z")
        self.server.scene.add_grid("/ground", 2.0, 2.0, cell_size=0.1, section_size=0.5)
        self.server.gui.add_html(as_text(f"Model: {model}"))
        self.scene, self.plan = ScenePanel(self), PlanPanel(self)
        self.guarded(self.scene.show)

    def guarded(self, action: Callable[[], None]) -> None:
        """Runs one action at a time, with what it sets off; an error is shown where the user looks."""
        with self.lock:
            try:
                action()
            except (CspaceError, ClientError, httpx.HTTPError) as error:
                self.scene.message.content = as_text(f"{type(error).__name__}: {error}")


def world_of(api_url: str, model: str) -> World:
    """The world of a model, as ``GET /models`` describes it; a bare name means its champion."""
    name, _, alias = model.partition("@")
    answer = httpx.get(f"{api_url}/models", params={"name": name.partition("/")[0]}, timeout=30.0)
    for one in answer.raise_for_status().json()["models"]:
        is_meant = one["name"] == name and (alias or "champion") in one["aliases"]
        if (is_meant or one["reference"] == model) and (one["world"] or {}).get("kind") == "spatial":
            return read_world(one["world"])
    expected = f"a model of an arm in space among those of {api_url}/models"
    raise InputError(f"the viewer cannot show the model {model}", expected=expected)


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


@contextlib.contextmanager
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, serve, print the address that holds the token."""
    parser = argparse.ArgumentParser(
        "python -m services.planner.viewer", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--api", default=usual_api(), help="address of the API (default: %(default)s)")
    parser.add_argument("--model", default="pretrained-panda", help="that answers (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8090, help="where to listen (default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        with SamplingClient(options.api) as api:
            with contextlib.redirect_stdout(io.StringIO()):  # viser prints its address without the token
                viewer = Viewer(api, options.model, "127.0.0.1", options.port)
            sys.stdout.write(f"{viewer.address}\n")
            sys.stdout.flush()
            threading.Event().wait()
    except (CspaceError, ClientError, httpx.HTTPError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
