"""Requests whose bodies follow their format almost: drawn by structure, each from a seeded generator.

    for request in islice(requests(random.Random(seed)), count):
        post(request.path, headers=request.headers, content=request.body)

The same seed gives the same requests. No body is larger than the server takes, few are larger than 100 kB.
"""

import base64
import json
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cspace.png import encode_png
from tests.inference_api.png_fuzz import png

# With 300 pictures behind it still less than a server takes.
MOST_BYTES = 6 * 2**20
SAMPLE, INFER = "/sample", "/v2/models/{}/infer"
MODELS = ("pretrained", "cspace-sampler", "cspace-sampler@path", "nobody", "a%40b", "%00", "..", "x" * 500)
GOOD = base64.b64encode(encode_png(np.zeros((16, 16, 3), np.uint8))).decode()
BOUNDARIES = (b"x", b"-", b"----", b"a b", b"'", b"b" * 70, b"b" * 71, b"", b"\xff", b"limit ")
WRONG_SIZES = (-1, 2**63, True, 1.5, "1", 10**400)
PARAMETERS = ("n", "seed", "epsilon_sigma", "start", "goal", "binary_data_output", "min_confidence")
JSON_LENGTH = "Inference-Header-Content-Length"
HUGE_NUMBERS = (10**400, -(10**400), 2**31, 2**63, 2**64, -1, 0, 1e308, 5e-324, 2**31 - 1, 10**999)
TEXTS = (
    "",
    "x",
    "\ud800",
    "\0",
    "\U0010ffff",
    "é",
    "3",
    "[" * 2000,
    "x" * 70_000,
    "NaN",
    "1" * 5000,
    "[1e999]",
)
RAW_NUMBERS = (
    b"1e999",
    b"-0",
    b"1e-999",
    b"NaN",
    b"Infinity",
    b"9" * 5000,
    b"0." + b"3" * 3000,
    b"01",
    b"+1",
)


@dataclass(frozen=True, slots=True)
class FuzzRequest:
    """One request to send with POST.

    Args:
        path: of the page.
        headers: by name.
        body: its bytes.
    """

    path: str
    headers: dict[str, str] = field(default_factory=dict)
    body: bytes = b""


def requests(rng: random.Random) -> Iterator[FuzzRequest]:
    """Requests without end."""
    kinds: tuple[Callable[[random.Random], FuzzRequest], ...] = (picture, form, sample_json, tensors)
    while True:
        yield rng.choice(kinds)(rng)


def picture(rng: random.Random) -> FuzzRequest:
    """A good form or JSON object round a wrong picture."""
    data = png(rng)[: MOST_BYTES // 2]
    if rng.random() < 0.5:
        text = json.dumps({"image": base64.b64encode(data).decode(), "n": 3, "model": "pretrained"})
        return FuzzRequest(SAMPLE, {"content-type": "application/json"}, text.encode())
    parts = [
        b'--limit\r\nContent-Disposition: form-data; name="image"; filename="a.png"\r\n\r\n' + data,
        b'\r\n--limit\r\nContent-Disposition: form-data; name="n"\r\n\r\n3\r\n--limit--\r\n',
    ]
    return FuzzRequest(SAMPLE, {"content-type": "multipart/form-data; boundary=limit"}, b"".join(parts))


def form(rng: random.Random) -> FuzzRequest:
    """A multipart form with wrong boundaries, headers, names, texts or ends."""
    boundary = _mostly(rng, b"limit", *BOUNDARIES)
    mark = b"--" + boundary
    parts = [mark + _gap(rng) + _part(rng, boundary) for _ in range(rng.choice([0, 1, 2, 3, 5, 5, 5, 20]))]
    parts *= rng.choice([1] * 9 + [500]) if sum(map(len, parts)) < 8000 else 1
    end = _mostly(rng, b"--\r\n", b"--", b"", b"-", b"\r\n", b"--" + mark + b"\r\n", b"--rest" * 50)
    body = _mostly(rng, b"", b"\r\n", b"preamble\r\n", b"-") + b"".join(parts) + mark + end
    charset = rng.choice(
        ["", "", "; charset=punycode", "; charset=idna", "; charset=utf-16", "; charset=\0", "; " * 40]
    )
    quoted = _mostly(rng, 'boundary="{}"', "boundary={}", "boundary*={}", 'boundary="{}', "BOUNDARY={}")
    content_type = "multipart/form-data; " + quoted.format(boundary.decode("latin-1")) + charset
    return FuzzRequest(SAMPLE, {"content-type": content_type}, _torn(rng, body))


def sample_json(rng: random.Random) -> FuzzRequest:
    """A JSON object with members of other types, wide, deep, huge, twice, or torn."""
    members = {
        name: _value(rng, rng.choice([0, 0, 1, 2]))
        for name in ("image", "model", "colour", *PARAMETERS)
        if rng.random() < 0.2
    }
    if rng.random() < 0.7:
        members |= {"image": GOOD, "n": members.get("n", 3)}
    return FuzzRequest(SAMPLE, {"content-type": "application/json"}, _torn(rng, _written(rng, members)))


def tensors(rng: random.Random) -> FuzzRequest:
    """A request of the Open Inference Protocol with shapes, types, sizes and lengths that do not fit."""
    images = np.zeros((_mostly(rng, 1, 2, 0, 300), 48, 48, 3), np.uint8)
    tail = b""
    entry: dict[str, object] = {
        "name": _mostly(rng, "image", "\ud800", "x" * 200, 3),
        "datatype": _mostly(rng, "UINT8", "FP32", "UINT64", "INT32", "BYTES", "", None),
        "shape": _mostly(rng, list(images.shape), _shape(rng)),
    }
    if rng.random() < 0.6:
        tail = images.tobytes()[: _mostly(rng, None, -1, 100)]
        size = _mostly(rng, images.nbytes, len(tail), *WRONG_SIZES)
        entry["parameters"] = {"binary_data_size": size}
    else:
        entry["data"] = _mostly(
            rng, [0] * 6912, _value(rng, 2), [_value(rng, 2)], [10**400], [[[]]] * 50, [[0] * 6912]
        )
    body: dict[str, object] = {"inputs": [entry] * _mostly(rng, 1, 2, 0, 17), "parameters": {"n": 3}}
    for name in ("id", "outputs", "parameters", "model_name", "colour"):
        if rng.random() < 0.1:
            body[name] = _value(rng, 2)
    if rng.random() < 0.4:
        body["parameters"] = {name: _value(rng, 0) for name in PARAMETERS if rng.random() < 0.3}
    head = _written(rng, body)
    lengths = ("0", "-1", str(len(head) + 1), "9" * 30, "1e3", "", str(2**64))
    headers = {} if rng.random() < 0.05 else {JSON_LENGTH: _mostly(rng, str(len(head)), *lengths)}
    return FuzzRequest(INFER.format(rng.choice(MODELS[:3] * 3 + MODELS)), headers, _torn(rng, head) + tail)


def _mostly(rng: random.Random, good: Any, *others: Any) -> Any:
    return rng.choice(others) if rng.random() < 0.12 else good


def _gap(rng: random.Random) -> bytes:
    return _mostly(rng, b"\r\n", *[b"\r\n"] * 9, b" \r\n", b"\n", b"\r", b"", b"x\r\n", b" " * 5000 + b"\r\n")


def _part(rng: random.Random, boundary: bytes) -> bytes:
    name = rng.choice(
        [
            b"image",
            b"n",
            b"seed",
            b"epsilon_sigma",
            b"start",
            b"model",
            b"",
            b"\xff",
            b"x" * 3000,
            b"_charset_",
        ]
    )
    disposition = rng.choice(
        [
            b'form-data; name="%b"',
            b'form-data; name="%b"; filename="a.png"',
            b"form-data; name=%b; filename*=utf-8''a%%20b",
            b'form-data; name="%b"; filename="a\\"b;c"',
            b'form-data; name="%b' + b";" * 3000,
            b'name="%b"',
            b'form-data; name*0="%b"',
            b"form-data" + b' ; "' * 500 + b'; name="%b"',
        ]
    )
    lines = [b"Content-Disposition: " + disposition % name]
    lines += _mostly(rng, [], [b"a: b"] * 9, [b": x"], [b"no colon"], [b"x: " + b"y" * 5000], [b"\0: 1"])
    value = rng.choice(
        [
            b"3",
            b"0.5",
            b"1" * 60_000 + b"x",
            b"[" * 500,
            b"[1, 2]",
            b"\xff\xfe",
            rng.randbytes(rng.choice([0, 10, 1000])),
            b"\r\n--" + boundary[:-1],
            b"x" * rng.choice([70_000, 2]),
            png(rng)[:100_000],
            b"--" + boundary + b"--",
        ]
    )
    return b"\r\n".join(lines) + rng.choice([b"\r\n\r\n"] * 9 + [b"\r\n", b"\n\n"]) + value + b"\r\n"


def _value(rng: random.Random, depth: int) -> object:
    if depth and rng.random() < 0.5:
        size = rng.choice([0, 1, 2, 3, 8, 70, 1200])
        inner = _value(rng, depth - 1)
        size = min(size, 200_000 // len(json.dumps(inner)))
        if rng.random() < 0.5:
            return [inner] * size
        return {rng.choice(TEXTS) + str(index): inner for index in range(min(size, 20))}
    plain = rng.choice([None, True, False, 0, 3, 0.5, -0.0, "AAAA", "pretrained", [], {}, [0, 0], [0.5, [1]]])
    return rng.choice(
        [plain, plain, rng.choice(HUGE_NUMBERS), rng.choice(TEXTS), rng.randint(-(2**70), 2**70)]
    )


def _shape(rng: random.Random) -> object:
    sizes = [
        rng.choice([0, 1, -1, 3, 48, 2**31, 10**999, 2**62, True, 1.5, "1"])
        for _ in range(rng.randint(0, 10))
    ]
    return rng.choice([sizes, sizes, None, "48", {}, [[1]] * 9])


def _written(rng: random.Random, value: object) -> bytes:
    """JSON text, now and then not quite."""
    text = json.dumps(value).encode()
    chance = rng.random()
    if chance < 0.1:
        return text.replace(b"0", rng.choice(RAW_NUMBERS), rng.choice([1, 3]))
    if chance < 0.15:
        return text[:-1] + b',"n":1,"n":2}'
    if chance < 0.2:
        deep = rng.choice([10, 500, 990, 3000, 100_000])
        return text[:-1] + b',"start":' + b"[" * deep + b"]" * deep + b"}"
    if chance < 0.25:
        return b'{"start":[' + b"[]," * rng.choice([10, 4000, 60_000]) + b"[]]}"
    return text


def _torn(rng: random.Random, body: bytes) -> bytes:
    body, chance = body[:MOST_BYTES], rng.random()
    if not body or chance < 0.9:
        return body
    at = rng.randrange(len(body))
    if chance < 0.94:
        return body[:at]
    if chance < 0.97:
        return body[:at] + rng.randbytes(rng.choice([1, 2, 8])) + body[at:]
    return body[:at] + body[at + rng.choice([1, 4, 100]) :]
