"""What one hostile client without a key does to a server, over and over, on one connection at a time.

    python -m benchmarks.serving.attack_requests NAME PORT SECONDS

Each attack is a function of the port and of when to stop. Refusals and closed connections are what is hoped
for: the attacker connects again and goes on. Only servers on this machine are attacked.
"""

import argparse
import base64
import json
import socket
import struct
import sys
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

import numpy as np

from cspace.worlds.spatial.camera import encode_depth

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


def form(path: str, pictures: Sequence[bytes], **fields: str | Sequence[str]) -> bytes:
    """A form; a field of several texts is repeated."""
    texts = [
        (name, text)
        for name, given in fields.items()
        for text in ([given] if isinstance(given, str) else given)
    ]
    parts = [
        f'--edge\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n{text}\r\n'.encode()
        for name, text in texts
    ]
    file = b'--edge\r\nContent-Disposition: form-data; name="image"; filename="a.png"\r\n\r\n'
    parts += [file + picture + b"\r\n" for picture in pictures]
    return request(path, b"".join(parts) + b"--edge--\r\n", "multipart/form-data; boundary=edge")


def sample(picture: bytes, **fields: str) -> bytes:
    """A form for ``POST /sample``."""
    return form("/sample", [picture], **fields)


def connect(port: int, timeout_s: float = PATIENCE_S, source: str = SOURCE[0]) -> socket.socket:
    """A connection of the attacker's."""
    return socket.create_connection((HOST, port), timeout=timeout_s, source_address=(source, 0))


def exchange(port: int, data: bytes, timeout_s: float = PATIENCE_S, source: str = SOURCE[0]) -> bytes:
    """Send, and read until the answer is there or the server closes; what came."""
    with connect(port, timeout_s, source) as link:
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


def tensors(model: str, arrays: Mapping[str, np.ndarray], **parameters: float) -> bytes:
    """A request of the Open Inference Protocol, with its arrays as bytes behind the JSON object."""
    inputs = [
        {
            "name": name,
            "datatype": _DATATYPES[array.dtype.str[1:]],
            "shape": list(array.shape),
            "parameters": {"binary_data_size": array.nbytes},
        }
        for name, array in arrays.items()
    ]
    head = json.dumps({"inputs": inputs, "parameters": parameters}).encode()
    body = head + b"".join(array.tobytes() for array in arrays.values())
    length = f"Inference-Header-Content-Length: {len(head)}"
    return request(f"/v2/models/{model}/infer", body, "application/octet-stream", length)


_DATATYPES = {"u1": "UINT8", "u2": "UINT16", "f8": "FP64"}


def many_pictures(turn: int) -> bytes:
    """As many pictures as a request may hold, none seen before."""
    images = np.random.default_rng(turn).integers(0, 256, (256, 48, 48, 3), dtype=np.uint8)
    return tensors("cspace-sampler", {"image": images}, n=70, min_confidence=1.0)


# Of a depth camera whose pixels are as wide as a hand.
PANDA, SIDE, POSE = "pretrained-panda", 160, [[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0.4], [0, 0, 0, 1]]
# Where the arm of the model stands, and a camera that looks at it from the side.
READY = [0, -0.785, 0, -2.356, 0, 1.571, 0.785]
_ASIDE = [
    [-0.7071, -0.3714, -0.6018, 1.3],
    [-0.7071, 0.3714, 0.6018, -0.8],
    [0, 0.851, -0.5252, 1],
    [0, 0, 0, 1],
]


def depth_png(side: int, mm: int = 300, block_mm: int = 0) -> bytes:
    """A depth picture of one distance, with a block in the middle where one is told."""
    pixels = np.full((side, side), mm, dtype=np.uint16)
    if block_mm:
        pixels[side // 3 : side // 2, side // 3 : side // 2] = block_mm
    return encode_depth(pixels)


def pinholes(turn: int, side: int = SIDE, count: int = 4) -> list[dict[str, Any]]:
    """Cameras of some pictures; another turn's are others, so that nothing is known of what they show."""
    focal = 0.134 * side
    middles = (side / 2 + 1e-5 * (count * turn + number) for number in range(count))
    return [{"fx": focal, "fy": focal, "cx": cx, "cy": side / 2, "pose": POSE} for cx in middles]


def depth_pictures(page: str, side: int = SIDE, count: int = 4, **fields: str) -> Callable[[int], bytes]:
    """Depth pictures that are never known."""
    pictures = [depth_png(side)] * count

    def data(turn: int) -> bytes:
        cameras = [json.dumps(one) for one in pinholes(turn, side, count)]
        return form(page, pictures, model=PANDA, camera=cameras, **fields)

    return data


def known_bodies(turn: int) -> bytes:
    """As many bodies as a request may hold, as large and as fine as they may be, and never the same twice."""
    rng = np.random.default_rng(turn)
    triangles = np.zeros(625, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    triangles["corners"] = rng.uniform(-1.0, 1.0, triangles["corners"].shape)
    mesh = bytes(80) + struct.pack("<I", len(triangles)) + triangles.tobytes()
    shapes = [{"mesh": {"file": "a"}}] * 32 + [{"box": {"size_m": [2.0, 2.0, 2.0]}}] * 468
    places = rng.uniform(-1.0, 1.0, (len(shapes), 3)).round(3).tolist()
    scene = [
        {"name": str(number), **shape, "pose": {"translation": place}}
        for number, (shape, place) in enumerate(zip(shapes, places, strict=True))
    ]
    rod = {"cylinder": {"radius_m": 0.05, "length_m": 1.0}}
    body = {
        "model": PANDA,
        "image": base64.b64encode(depth_png(SIDE)).decode(),
        "camera": [pinholes(turn)[0]],
        "configurations": [READY] * 2000,
        "scene": scene,
        "attached": [{"name": f"held {number}", **rod} for number in range(16)],
        "meshes": {"a": base64.b64encode(mesh).decode()},
    }
    return request("/validity", json.dumps(body).encode(), "application/json")


def depth_tensors(turn: int, side: int = SIDE, count: int = 4) -> bytes:
    """The same as tensors."""
    cameras = pinholes(turn, side, count)
    arrays = {
        "depth": np.full((count, side, side), 300, "<u2"),
        "intrinsics": np.array([[one[name] for name in ("fx", "fy", "cx", "cy")] for one in cameras]),
        "poses": np.array([POSE] * count, dtype="<f8"),
    }
    return tensors(PANDA, arrays, n=1, min_confidence=0.0)


def configurations() -> bytes:
    """As many configurations as a request may ask about, in JSON."""
    rows = np.random.default_rng(0).uniform(-3.0, 3.0, (20_000, 2)).tolist()
    body = {"image": base64.b64encode(png(48)).decode(), "configurations": rows}
    return request("/validity", json.dumps(body).encode(), "application/json")


def plan(seed: int, **fields: str | Sequence[str]) -> bytes:
    """A plan from where the arm stands to somewhere near, past a block; each seed has its own picture."""
    goal = (np.array(READY) + np.random.default_rng(seed).uniform(-0.5, 0.5, 7)).tolist()
    camera = {"fx": 114.25, "fy": 114.25, "cx": 79.5 + 1e-5 * seed, "cy": 79.5, "pose": _ASIDE}
    given: dict[str, str | Sequence[str]] = {
        "start": json.dumps(READY),
        "goal": json.dumps(goal),
        "camera": json.dumps(camera),
        **fields,
    }
    return form("/plan", [depth_png(SIDE, 1800, 900)], model=PANDA, **given)


def next_views(turn: int) -> bytes:
    """Plans with as many cameras to choose the next view from as there may be."""
    camera = {"fx": 114.25, "fy": 114.25, "cy": 59.5, "width": 160, "height": 120, "pose": _ASIDE}
    views = [json.dumps(camera | {"cx": 79.5 + 0.1 * number}) for number in range(64)]
    return plan(turn % 64, view=views, ways="1", min_confidence="0")


def left_soon(data: bytes) -> Attack:
    """Requests whose client goes away after 20 ms."""

    def attack(port: int, until: float) -> None:
        while time.monotonic() < until:
            with suppress(OSError), connect(port) as link:
                link.sendall(data)
                time.sleep(0.02)

    return attack


def at_once(attack: Attack, connections: int) -> Attack:
    """The same attack on several connections."""

    def attacking(port: int, until: float) -> None:
        with ThreadPoolExecutor(connections) as pool:
            list(pool.map(attack, [port] * connections, [until] * connections))

    return attacking


def plans_of_addresses(port: int, until: float) -> None:
    """Two plans of the longest time from each of 16 addresses."""

    def attack(number: int) -> None:
        turn = number
        while time.monotonic() < until:
            left_s = until - time.monotonic()
            data = plan(turn, ways="64", time_limit_s="10")
            with suppress(OSError):
                exchange(port, data, max(0.1, left_s), f"127.0.3.{1 + number // 2}")
            turn += 32

    with ThreadPoolExecutor(32) as pool:
        list(pool.map(attack, range(32)))


_PUNYCODE = "multipart/form-data; boundary=edge; charset=punycode"
_FIELD = 'Content-Disposition: form-data; name="model"\r\n\r\n'
_UPGRADE = (
    "Connection: Upgrade",
    "Upgrade: websocket",
    "Sec-WebSocket-Version: 13",
    "Sec-WebSocket-Key: eA==",
)

ATTACKS: dict[str, Attack] = {
    "fresh depth pictures": at_once(again(depth_pictures("/sample", n="1", min_confidence="0")), 4),
    "fresh depth pictures, 2048 pixels a side": at_once(again(depth_pictures("/sample", 2048, n="1")), 4),
    "fresh depth pictures for scores": at_once(
        again(depth_pictures("/validity", configurations=json.dumps([READY]))), 4
    ),
    "fresh depth pictures for plans": at_once(
        again(depth_pictures("/plan", start=json.dumps(READY), goal=json.dumps(READY), time_limit_s="0.01")),
        4,
    ),
    "fresh depth pictures for v2": at_once(again(depth_tensors), 4),
    "known bodies": at_once(again(known_bodies), 4),
    "20,000 rows to score in JSON": at_once(always(configurations()), 4),
    "the same, left after 20 ms": at_once(left_soon(configurations()), 4),
    "64 cameras for a next view": at_once(again(next_views), 4),
    "plans from 16 addresses": plans_of_addresses,
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
    "the list of models": always(request("/models", b"", "a/b", method="GET")),
    "upgrades": always(
        request("/sample?a=\r\nforged".replace("\r\n", "%0d%0a"), b"", "a/b", *_UPGRADE, method="GET")
    ),
}


def main(arguments: list[str]) -> int:
    """Attack for so many seconds."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.serving.attack_requests")
    parser.add_argument("name", choices=sorted(ATTACKS))
    parser.add_argument("port", type=int)
    parser.add_argument("seconds", type=float)
    options = parser.parse_args(arguments)
    with suppress(OSError):
        ATTACKS[options.name](options.port, time.monotonic() + options.seconds)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
