"""What other sites and strangers can do to the 3D viewer: nothing without the token, little with it."""

import asyncio
import html
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import msgspec
import pytest
import viser
import viser._messages as messages
import websockets

from cspace.errors import InputError
from cspace.worlds import examples
from services.planner.viewer.access import UPLOAD_BYTES, Uploads, open_server
from services.planner.viewer.scene import as_text
from services.planner.viewer.uploads import views_of_recording
from tests.training.data.test_recordings import UP, Recorder, image, info, joints, only_file, transforms

encode = msgspec.msgpack.encode
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [1.0, 1.0, 1.0], "fov": 1.0,
    "near": 0.01, "far": 100.0, "image_height": 100, "image_width": 100, "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}  # fmt: skip


class Page:
    """A viser page with an upload button and its checks."""

    def __init__(self) -> None:
        self.server, self.address = open_server("127.0.0.1", 0, verbose=False)
        self.refused: list[str] = []
        self.button: Any = self.server.gui.add_upload_button("Open a file")
        self.bounds = Uploads(self.server, lambda: self.refused.append("refused"))
        self.uuid = self.button._impl.uuid

    @property
    def arriving(self) -> dict[str, Any]:
        found: dict[str, Any] = self.server.gui._current_file_upload_states
        return found

    def connect(self, address: str | None = None, **options: Any) -> Any:
        """Opens a WebSocket as the page does."""
        url = (address or self.address).replace("http://", "ws://").rstrip("/")
        protocol: Any = f"viser-v{viser.__version__}"
        return websockets.connect(url, subprotocols=[protocol], max_size=None, **options)

    def start(self, name: str, size: int, parts: int = 1) -> bytes:
        fields = {
            "source_component_uuid": self.uuid,
            "transfer_uuid": name,
            "filename": name,
            "mime_type": "",
        }
        return encode({"type": "FileTransferStartUpload", "part_count": parts, "size_bytes": size, **fields})

    def part(self, name: str, content: bytes, index: int = 0) -> bytes:
        fields = {"source_component_uuid": self.uuid, "transfer_uuid": name, "part_index": index}
        return encode({"type": "FileTransferPart", "content": content, **fields})


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
    assert status_of(page, f"{page.address[:-2]}x/") == 403
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


def test_nobody_can_ask_for_a_public_tunnel(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr(page.server, "request_share_url", lambda: asked.append("share"))

    async def ask() -> None:
        async with page.connect() as socket:
            await socket.send(encode({"type": "ShareUrlRequest"}))
            await asyncio.sleep(0.5)

    asyncio.run(ask())
    assert asked == []
    assert messages.ShareUrlRequest not in page.server._connection._incoming_handlers


def test_uploads_are_bounded_in_number_and_size_and_go_with_their_client(page: Page) -> None:
    async def flood() -> None:
        async with page.connect() as socket:
            # Before its camera viser would not forget the uploads of a client that leaves.
            await socket.send(page.start("early", 10))
            await asyncio.sleep(0.3)
            assert page.arriving == {}
            await socket.send(encode(CAMERA))
            await asyncio.sleep(0.3)
            for at in range(15):
                await socket.send(page.start(f"many {at}", 1000, 2))
            await asyncio.sleep(0.3)
            assert set(page.arriving) == {"many 0", "many 1"}
            # More than was announced.
            await socket.send(page.part("many 0", b"\0" * 1001))
            await asyncio.sleep(0.3)
            assert set(page.arriving) == {"many 1"}
            for size, parts in ((UPLOAD_BYTES, 2), (1 << 40, 2), (-1, 2), (10, 10**9)):
                await socket.send(page.start("large", size, parts))
            await asyncio.sleep(0.3)
            assert set(page.arriving) == {"many 1"}
        await asyncio.sleep(0.5)
        assert page.arriving == {}

    asyncio.run(flood())
    assert len(page.refused) == 1 + 13 + 4


WICKED = '<iframe srcdoc="<script>parent.X=1</script>">'


def test_frame_names_of_a_recording_are_shown_as_text(tmp_path: Path) -> None:
    recorded = Recorder().add("/tf_static", "tf_static", transforms(0.0, ("world", "q", UP)))
    recorded.add("/camera/depth/image_raw", "image", image(0.0, frame=WICKED))
    recorded.add("/camera/depth/camera_info", "info", info(0.0))
    recorded.add("/joint_states", "joints", joints(0.0), joints(0.01))
    content = only_file(recorded.write(tmp_path / "bag"), ".mcap").read_bytes()
    with pytest.raises(InputError, match="cannot be imported") as caught:
        views_of_recording("bag.mcap", content, examples()["panda"], "base_link")
    assert "iframe" in str(caught.value)
    shown = as_text(str(caught.value))
    assert "<iframe" not in shown
    assert html.escape(WICKED) in shown
