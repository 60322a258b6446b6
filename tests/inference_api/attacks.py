"""What one hostile client without a key does to a server, over and over, on one connection at a time.

    python -m tests.inference_api.attacks NAME PORT SECONDS

Each attack is a function of the port and of when to stop. Refusals and closed connections are what is hoped
for: the attacker connects again and goes on. Only servers on this machine are attacked.
"""

import json
import socket
import struct
import sys
import time
import zlib
from collections.abc import Callable
from contextlib import suppress

import numpy as np

HOST = "127.0.0.1"
# Another address than that of whoever else asks, so that the server can tell them apart.
SOURCE = ("127.0.0.2", 0)
PATIENCE_S = 15.0
MIB = 1024 * 1024
Attack = Callable[[int, float], None]


def chunk(kind: bytes, data: bytes) -> bytes:
    """A chunk of a PNG."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def ihdr(side: int, colour: int = 2) -> bytes:
    """A PNG's header."""
    return chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, colour, 0, 0, 0))


def png(side: int, colour: int = 2, *, twice: int = 0, seed: int | None = None) -> bytes:
    """A picture; ``twice`` is the side that a second header claims, a seed makes it one of its own."""
    channels = {0: 1, 2: 3, 6: 4}[colour]
    size = twice or side
    if seed is None:
        rows = bytes((1 + channels * size) * size)
    else:
        pixels = np.random.default_rng(seed).integers(0, 4, (size, 1 + channels * size), dtype=np.uint8)
        pixels[:, 0] = 0
        rows = pixels.tobytes()
    second = ihdr(twice, colour) if twice else b""
    data = chunk(b"IDAT", zlib.compress(rows, 1 if seed is not None else 9))
    return b"\x89PNG\r\n\x1a\n" + ihdr(side, colour) + second + data + chunk(b"IEND", b"")


def request(
    path: str, body: bytes, media_type: str, *further: str, method: str = "POST", length: int | None = None
) -> bytes:
    """A request's bytes."""
    size = len(body) if length is None else length
    lines = [f"{method} {path} HTTP/1.1", f"Host: {HOST}", f"Content-Type: {media_type}"]
    return "\r\n".join([*lines, f"Content-Length: {size}", *further, "", ""]).encode() + body


def sample(picture: bytes, **fields: str) -> bytes:
    """A form for ``POST /sample``."""
    parts = [
        f'--edge\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n{text}\r\n'
        for name, text in fields.items()
    ]
    file = '--edge\r\nContent-Disposition: form-data; name="image"; filename="a.png"\r\n\r\n'
    body = "".join([*parts, file]).encode() + picture + b"\r\n--edge--\r\n"
    return request("/sample", body, "multipart/form-data; boundary=edge")


def connect(port: int, timeout_s: float = PATIENCE_S) -> socket.socket:
    """A connection of the attacker's."""
    return socket.create_connection((HOST, port), timeout=timeout_s, source_address=SOURCE)


def exchange(port: int, data: bytes) -> bytes:
    """Send, and read until the answer is there or the server closes; what came."""
    with connect(port) as link:
        with suppress(OSError):
            link.sendall(data)
        return read_answer(link)


def read_answer(link: socket.socket) -> bytes:
    """One answer with its body, or what came before the end."""
    answer = b""
    with suppress(OSError):
        while b"\r\n\r\n" not in answer:
            part = link.recv(65536)
            if not part:
                return answer
            answer += part
        head, _, body = answer.partition(b"\r\n\r\n")
        lengths = [line[15:] for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:")]
        left = int(lengths[0]) - len(body) if lengths else 0
        while left > 0 and (part := link.recv(65536)):
            answer, left = answer + part, left - len(part)
    return answer


def again(data: Callable[[int], bytes]) -> Attack:
    """Send one request after the other."""

    def attack(port: int, until: float) -> None:
        turn = 0
        while time.monotonic() < until:
            exchange(port, data(turn))
            turn += 1

    return attack


def always(data: bytes) -> Attack:
    """Send the same request over and over."""
    return again(lambda _: data)


def endless_headers(port: int, until: float) -> None:
    """300 MB of headers, in one header or in many."""
    many = b"".join(b"X-%06d: %s\r\n" % (number, b"y" * 100) for number in range(2000))
    turn = 0
    while time.monotonic() < until:
        block = many if turn % 2 else b"y" * len(many)
        turn += 1
        with suppress(OSError), connect(port) as link:
            link.sendall(b"GET /health/live HTTP/1.1\r\nHost: x\r\nX-Long: ")
            for _ in range(300 * MIB // len(block)):
                if time.monotonic() >= until:
                    break
                link.sendall(block)


def never_reading(port: int, until: float) -> None:
    """Requests with large answers, one behind the other, of which none is read."""
    one = sample(png(48), n="20000", min_confidence="0")
    while time.monotonic() < until:
        with suppress(OSError), connect(port, 1.0) as link:
            while time.monotonic() < until:
                link.sendall(one)


def pipelined(port: int, until: float) -> None:
    """Small requests without a pause, whose answers are read and thrown away."""
    many = b"GET /health/live HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 1000
    while time.monotonic() < until:
        with suppress(OSError), connect(port) as link:
            link.sendall(many)
            while link.recv(65536) and time.monotonic() < until:
                pass


def slow_body(port: int, until: float) -> None:
    """A body of 8 MiB of which a byte comes now and then."""
    start = request("/sample", b"", "application/json", length=8 * MIB)
    while time.monotonic() < until:
        with suppress(OSError), connect(port) as link:
            link.sendall(start)
            while time.monotonic() < until:
                link.sendall(b" ")
                time.sleep(0.05)


def abandoned(port: int, until: float) -> None:
    """The dearest requests there are, each left at once."""
    one = sample(png(48), n="20000", min_confidence="1")
    while time.monotonic() < until:
        with suppress(OSError), connect(port) as link:
            link.sendall(one)
        time.sleep(0.05)


def dispositions(count: int) -> bytes:
    """A form of parts that name themselves at length."""
    odd = 'form-data; name="n"' + "; a*0*=x''%ff" * 60
    part = f"--edge\r\nContent-Disposition: {odd}\r\n\r\n1\r\n"
    return request("/sample", (part * count + "--edge--\r\n").encode(), "multipart/form-data; boundary=edge")


def many_pictures(turn: int) -> bytes:
    """As many pictures as a request may hold, none seen before."""
    images = np.random.default_rng(turn).integers(0, 256, (256, 48, 48, 3), dtype=np.uint8)
    tensor = {"name": "image", "datatype": "UINT8", "shape": list(images.shape)}
    tensor["parameters"] = {"binary_data_size": images.nbytes}
    head = json.dumps({"inputs": [tensor], "parameters": {"n": 70, "min_confidence": 1.0}}).encode()
    length = f"Inference-Header-Content-Length: {len(head)}"
    path = "/v2/models/cspace-sampler/infer"
    return request(path, head + images.tobytes(), "application/octet-stream", length)


_PUNYCODE = "multipart/form-data; boundary=edge; charset=punycode"
_FIELD = 'Content-Disposition: form-data; name="model"\r\n\r\n'
_UPGRADE = (
    "Connection: Upgrade",
    "Upgrade: websocket",
    "Sec-WebSocket-Version: 13",
    "Sec-WebSocket-Key: eA==",
)

ATTACKS: dict[str, Attack] = {
    "two headers in a picture": again(lambda turn: sample(png(64, twice=9400 - turn % 2), n="1")),
    "largest pictures": again(lambda turn: sample(png(2048, 6, seed=turn % 3), n="1")),
    "headers without end": endless_headers,
    "a form in punycode": always(
        request(
            "/sample", (f"--edge\r\n{_FIELD}a-{'a' * 60000}\r\n" * 5 + "--edge--\r\n").encode(), _PUNYCODE
        )
    ),
    "odd dispositions": always(dispositions(2000)),
    "empty arrays": always(
        request("/sample", b"[" + b"[]," * (8 * MIB // 3 - 2) + b"1]", "application/json")
    ),
    "empty arrays for v2": always(
        request("/v2/models/pretrained/infer", b"[" + b"[]," * (8 * MIB // 3 - 2) + b"1]", "application/json")
    ),
    "escapes": always(
        request("/sample", b'{"model":"' + b"\\u0041" * (8 * MIB // 6 - 10) + b'"}', "application/json")
    ),
    "a slow body": slow_body,
    "answers that are not read": never_reading,
    "requests in one go": pipelined,
    "the dearest request": always(sample(png(48), n="20000", min_confidence="1")),
    "dearest requests, abandoned": abandoned,
    "many pictures": again(many_pictures),
    "names of no model": again(lambda turn: sample(png(48), model=f"nobody-{turn}", n="1")),
    "upgrades": always(
        request("/sample?a=\r\nforged".replace("\r\n", "%0d%0a"), b"", "a/b", *_UPGRADE, method="GET")
    ),
}


def main(arguments: list[str]) -> int:
    """Attack for so many seconds."""
    name, port, seconds = arguments
    with suppress(OSError):
        ATTACKS[name](int(port), time.monotonic() + float(seconds))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
