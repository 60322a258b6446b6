"""Messages of HTTP/1.1 that are wrong in their structure: lines, headers, framing, upgrades, what follows."""

import random

_METHODS = [
    b"GET",
    b"POST",
    b"HEAD",
    b"PUT",
    b"OPTIONS",
    b"CONNECT",
    b"TRACE",
    b"PRI",
    b"get",
    b"G\x00T",
    b"",
    b"A" * 300,
]
_PATHS = [
    b"/health/live",
    b"/sample",
    b"/models",
    b"/metrics",
    b"/docs",
    b"/v2",
    b"/v2/models/pretrained/infer",
    b"*",
    b"http://127.0.0.1/sample",
    b"//sample",
    b"/%2e%2e/%00",
    b"/\xff\xfe",
    b"/sample?" + b"a=b&" * 400,
    b"/" + b"x" * 9000,
    b"/v2/models/..%2f..%2f/ready",
    b"/v2/models/a/versions/999999999999999999999/infer",
    b"/docs/assets/../../app.py",
]
_VERSIONS = [b"HTTP/1.1", b"HTTP/1.0", b"HTTP/2.0", b"HTTP/0.9", b"HTTP/1.1 ", b"HTTP/11", b"", b"http/1.1"]
_HOSTS = [
    b"127.0.0.1",
    b"localhost:80",
    b"[::1]",
    b"evil.example",
    b"",
    b"127.0.0.1, evil",
    b"127.0.0.1:99999999",
    b"\xff",
]
_TYPES = [
    b"application/json",
    b"multipart/form-data; boundary=edge",
    b"multipart/form-data",
    b"application/octet-stream",
    b"multipart/form-data; boundary=" + b"b" * 300,
    b"multipart/form-data; boundary=edge; charset=punycode",
    b"text/plain",
    b"application/json; charset=utf-16",
    b";" * 400,
    b"multipart/form-data; boundary=\xff",
]
_FRAMES = [
    [],
    [b"Content-Length: 0"],
    [b"Content-Length: 5"],
    [b"Content-Length: -1"],
    [b"Content-Length: 99999999999999999999"],
    [b"Content-Length: 5", b"Content-Length: 6"],
    [b"Content-Length: 5, 5"],
    [b"Transfer-Encoding: chunked"],
    [b"Transfer-Encoding: chunked", b"Content-Length: 5"],
    [b"Transfer-Encoding: chunked, chunked"],
    [b"Transfer-Encoding: gzip, chunked"],
    [b"Transfer-Encoding: xchunked"],
    [b"Content-Length : 5"],
    [b"Content-Length: +5"],
]
_ODD = [
    b"Expect: 100-continue",
    b"Expect: 200-ok",
    b"Connection: close",
    b"Connection: keep-alive, x, x",
    b"Origin: http://evil",
    b"Origin: null",
    b"Sec-Fetch-Site: cross-site",
    b"Accept: application/x-npy;q=nan, */*;q=1e999",
    b"Accept: " + b"a," * 2000,
    b"X-Request-ID: " + b"\xe9" * 50,
    b"X-Forwarded-For: 1.2.3.4, ::ffff:5.6.7.8, unknown",
    b"Authorization: Bearer " + b"x" * 3000,
    b"Authorization: Basic \xff",
    b"Content-Encoding: gzip",
    b"Inference-Header-Content-Length: " + b"9" * 30,
    b" folded: line",
    b"No colon at all",
    b": no name",
    b"Sp ace: x",
    b"X: a\x00b",
    b"X: a\rb",
    b"Cookie: " + b"c=d; " * 300,
    b"Range: bytes=0-0,-1",
    b"Upgrade: h2c",
    b"HTTP2-Settings: AAMAAABkAAQCAAAAAAIAAAAA",
    b"Trailer: X",
]
_WEBSOCKET = [
    b"Connection: Upgrade",
    b"Upgrade: websocket",
    b"Sec-WebSocket-Version: 13",
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
    b"Sec-WebSocket-Protocol: a, b",
    b"Sec-WebSocket-Extensions: permessage-deflate; client_max_window_bits=x",
]
_FRAME_BYTES = b"\x81\x85\x00\x00\x00\x00hello\x89\x00\x88\x82\x00\x00\x00\x00\x03\xe8"


def message(rng: random.Random) -> bytes:
    """One message, or several in a row; mostly wrong somewhere, sometimes everywhere."""
    return b"".join(_one(rng) for _ in range(rng.choice((1, 1, 1, 2, 5))))


def upgrade(rng: random.Random) -> bytes:
    """A request for a WebSocket with frames behind it, some parts left out or repeated."""
    lines = [line for line in _WEBSOCKET for _ in range(rng.choice((0, 1, 1, 1, 2)))]
    rng.shuffle(lines)
    path = rng.choice([*_PATHS[:7], b"/sample%0d%0aforged: line", b"/a%0aINFO:%20forged"])
    head = [rng.choice((b"GET", b"GET", b"POST")) + b" " + path + b" HTTP/1.1", b"Host: 127.0.0.1", *lines]
    return _mutated(rng, b"\r\n".join([*head, b"", b""]) + _FRAME_BYTES * rng.choice((0, 1, 50)))


def _one(rng: random.Random) -> bytes:
    first = b" ".join(
        part
        for part in (
            rng.choice(_METHODS[:3] * 4 + _METHODS),
            rng.choice(_PATHS),
            rng.choice([_VERSIONS[0]] * 8 + _VERSIONS),
        )
        if part
    )
    headers = [b"Host: " + rng.choice([_HOSTS[0]] * 6 + _HOSTS)] * rng.choice((1, 1, 1, 1, 0, 2))
    headers += [b"Content-Type: " + rng.choice(_TYPES)] * rng.choice((0, 1, 1, 2))
    headers += rng.choice(_FRAMES)
    headers += [rng.choice(_ODD) for _ in range(rng.choice((0, 0, 1, 3)))]
    headers += [
        b"X-%d: %s" % (number, b"y" * rng.choice((0, 1, 100)))
        for number in range(rng.choice((0, 0, 0, 90, 150)))
    ]
    rng.shuffle(headers)
    end = rng.choice([b"\r\n"] * 8 + [b"\n", b"\r", b"\r\r\n"])
    return _mutated(rng, end.join([first, *headers, b"", b""]) + _body(rng))


def _body(rng: random.Random) -> bytes:
    kind = rng.randrange(5)
    if kind == 0:
        return b""
    if kind == 1:
        return rng.choice((b"hello", b"{}", b"[]", b"--edge--\r\n", b"\x00" * 20))
    sizes = [
        b"5",
        b"0",
        b"5;ext=" + b"e" * rng.choice((1, 20_000)),
        b"ffffffffffffffffff",
        b"-1",
        b"5 ",
        b"0x5",
        b"",
        b"00005",
    ]
    chunks = [rng.choice([sizes[0]] * 4 + sizes) + b"\r\nhello\r\n" for _ in range(rng.choice((1, 2, 50)))]
    trailers = rng.choice((b"", b"", b"X: y\r\n", b"X: y\r\n" * 500, b"Content-Length: 3\r\n"))
    return b"".join(chunks) + rng.choice((b"0\r\n", b"0\r\n", b"")) + trailers + b"\r\n"


def _mutated(rng: random.Random, data: bytes) -> bytes:
    if rng.random() < 0.6 or not data:
        return data
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 10))):
        if not changed:
            break
        at, kind = rng.randrange(len(changed)), rng.randrange(4)
        if kind == 0:
            changed[at] = rng.randrange(256)
        elif kind == 1:
            del changed[at : at + rng.choice((1, 2, 40))]
        elif kind == 2:
            changed[at:at] = rng.choice((b"\r\n", b"\x00", b" ", b":", b"\xff\xfe", b"\t"))
        else:
            changed[at:at] = changed[at : at + 60]
    return bytes(changed)
