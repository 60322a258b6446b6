"""What other sites and strangers can do to the 3D viewer: nothing without the token, little with it."""

import asyncio
import html
from collections.abc import Iterator
from typing import Any

import httpx
import msgspec
import pytest
import viser
import viser._messages as messages
import websockets

from services.planner.viewer import open_server
from services.planner.viewer_panels import as_text

encode = msgspec.msgpack.encode
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1.0, 1.0, 1.0], "fov": 1.0,
    "near": 0.01, "far": 100.0, "image_height": 100, "image_width": 100, "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}  # fmt: skip


class Page:
    """A viser page with its checks."""

    def __init__(self) -> None:
        self.server, self.address = open_server("127.0.0.1", 0, verbose=False)

    def connect(self, address: str | None = None, **options: Any) -> Any:
        """Opens a WebSocket as the page does."""
        url = (address or self.address).replace("http://", "ws://").rstrip("/")
        protocol: Any = f"viser-v{viser.__version__}"
        return websockets.connect(url, subprotocols=[protocol], max_size=None, **options)


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    found = Page()
    yield found
    found.server.stop()


def status_of(page: Page, address: str | None = None, **options: Any) -> int:
    async def connect() -> int:
        try:
            async with page.connect(address, **options):
                return 101
        except websockets.InvalidStatus as error:
            return error.response.status_code

    return asyncio.run(connect())


def test_the_handshake_needs_the_token_the_host_and_the_origin(page: Page) -> None:
    place = page.address.rsplit("/", 2)[0]
    assert status_of(page) == 101
    assert status_of(page, origin=place) == 101
    assert status_of(page, place) == 403
    assert status_of(page, f"{page.address[:-1]}x/") == 403
    assert status_of(page, origin="http://evil.example") == 403
    assert status_of(page, origin=f"{place}0") == 403
    # A name that was made to mean 127.0.0.1.
    rebound = {"host": "evil.example:8090", "origin": "http://evil.example:8090"}
    upgrade = {"connection": "Upgrade", "upgrade": "websocket", "sec-websocket-version": "13"}
    assert httpx.get(page.address, headers=rebound | upgrade).status_code == 421
    # The client adds a second header.
    assert status_of(page, additional_headers={"Host": "evil.example:8090"}) == 421


def test_the_page_needs_the_token_too_and_tells_nobody_its_address(page: Page) -> None:
    answer = httpx.get(page.address)
    assert (answer.status_code, answer.headers["referrer-policy"]) == (200, "no-referrer")
    assert "<html" in answer.text
    place = page.address.rsplit("/", 2)[0]
    for address in (place, f"{place}/index.html", f"{place}/nothing/"):
        refused = httpx.get(address)
        assert refused.status_code == 403
        assert page.address not in refused.text
    assert httpx.get(page.address, headers={"host": "evil.example"}).status_code == 421
    assert httpx.get(f"{page.address}../../etc/passwd").status_code in (403, 404)


def test_nobody_can_ask_for_a_public_tunnel(page: Page) -> None:
    assert messages.ShareUrlRequest not in page.server._connection._incoming_handlers


def test_files_are_not_taken(page: Page) -> None:
    upload = {
        "type": "FileTransferStartUpload", "part_count": 2, "size_bytes": 1000, "source_component_uuid": "x",
        "transfer_uuid": "y", "filename": "f", "mime_type": "",
    }  # fmt: skip

    async def send() -> None:
        async with page.connect() as socket:
            await socket.send(encode(CAMERA))
            await asyncio.sleep(0.3)
            await socket.send(encode(upload))
            await asyncio.sleep(0.3)
            assert page.server.gui._current_file_upload_states == {}

    asyncio.run(send())


def test_a_message_is_shown_as_text() -> None:
    wicked = '<iframe srcdoc="<script>parent.X=1</script>">'
    assert "<iframe" not in as_text(wicked)
    assert html.escape(wicked) in as_text(wicked)
