"""Good answers, damaged by chance along their structure, through a real socket into either HTTP client.

A long run: ``fuzz("sync", seed=2, time_s=600.0)``; one case again: ``damaged(seed, index)``.
"""

import itertools
import random
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import httpx
import numpy as np
from anyio.from_thread import start_blocking_portal

from cspace.errors import SamplerError
from services.planner.client import RetryPolicy, SamplingClient
from services.planner.samples import SampleBatch
from tests.fakes.async_client import AsyncSamplingClient
from tests.services.planner.hostile_server import GOOD_BODY, GOOD_HEADERS, SEED, N, hostile_server

PNG = b"\x89PNG picture"
DEADLINE_S = 0.2
MARGIN_S = 5.0
POLICY = RetryPolicy(attempts=2, base_s=1e-3, cap_s=2e-3, deadline_s=DEADLINE_S)

STATUSES = [b"200 OK", b"200", b"2000 OK", b"100 Continue", b"103 Hints", b"101 Switch", b"204 No",
            b"206 Part", b"301 Moved", b"304 Not", b"404 No", b"422 No", b"429 Busy", b"500 No", b"503 Busy",
            b"600 Odd", b"-1 No", b"\xff\xff"]  # fmt: skip
VALUES = [b"", b"0", b"-1", b"7", b"8", b"9" * 19, b"9" * 400, b"1e9", b"nan", b"gzip", b"chunked", b"close",
          b"identity", b"a" * 9000, b"\x1b[31m", b"\xe2\x80\xae", b"\xff", b"7, 7", b"application/x-npy",
          b"application/problem+json", b"Sat, 01 Mar 9999 12:00:00 +9999", b"http://[::1"]  # fmt: skip
NAMES = [b"Content-Encoding", b"Transfer-Encoding", b"Connection", b"Location", b"Set-Cookie", b"Retry-After",
         b"X-Novelty", b"Server-Timing", b"Content-Length", b"Upgrade", b"X\x00", b"", b" X"]  # fmt: skip
BODIES = [GOOD_BODY, b"", b"[" * 5000, b'{"title": "\\u001b\\ud800"}', b'{"title": 1' + b"0" * 6000 + b"}"]
NUMBERS = [b"0", b"-2", b"3", b"9" * 9, b"9" * 40, b"True", b"None", b"()", b"'2'", b"2.0", b"0x2", b"1_0"]


def damaged(seed: int, index: int) -> bytes:
    """The answer of one case."""
    chance = random.Random(f"{seed} {index}")  # noqa: S311 - chance is no secret
    headers = [(name.encode(), value.encode()) for name, value in GOOD_HEADERS.items()]
    body = _body(chance) if chance.random() < 0.5 else GOOD_BODY
    framed, framing = _framed(body, chance)
    headers += framing
    for _ in range(chance.randrange(3)):
        headers = chance.choice(HEADER_DAMAGE)(headers, chance)
    status = b"200 OK" if chance.random() < 0.7 else chance.choice(STATUSES)
    end = b"\r\n" if chance.random() < 0.95 else chance.choice([b"\n", b"\r", b"\r\n\r\n", b"\0"])
    lines = [b"HTTP/1.1 " + status, *(name + b": " + value for name, value in headers), b"", b""]
    content = end.join(lines) + framed
    if chance.random() < 0.1:
        content = b"HTTP/1.1 103 Early Hints\r\nX: 1\r\n\r\n" * chance.randrange(1, 50) + content
    for _ in range(chance.choice([0, 0, 0, 0, 1, 3])):
        content = chance.choice(BYTE_DAMAGE)(content, chance)
    return content


def fuzz(kind: str, seed: int, time_s: float) -> Counter[str]:
    """Ask for damaged answers for so long by a kind of client; how often each class came out.

    Raises:
        AssertionError: a case gave anything but a sound batch or an error of the tree, or took too long.
    """
    found: Counter[str] = Counter()
    content, until = b"", time.monotonic() + time_s

    def script(link: socket.socket) -> None:
        link.sendall(content)
        # Else an answer that promises more than it holds would cost the deadline every time.
        if not content.endswith(GOOD_BODY):
            link.shutdown(socket.SHUT_WR)

    with hostile_server(script) as server, _client(kind, server.url) as sample:
        for index in itertools.takewhile(lambda _: time.monotonic() < until, itertools.count()):
            content = damaged(seed, index)
            found[_outcome(sample, f"case {index} of seed {seed}: {content[:600]!r}")] += 1
    return found


def _outcome(sample: Callable[[], SampleBatch], description: str) -> str:
    began = time.monotonic()
    try:
        found: SampleBatch | SamplerError = sample()
    except SamplerError as error:
        found = error
    except Exception as error:
        raise AssertionError(description) from error
    assert time.monotonic() - began < DEADLINE_S + MARGIN_S, description
    if isinstance(found, SampleBatch):
        assert (found.seed, found.fallback, len(found.samples)) == (SEED, False, N - found.shortfall), (
            description
        )
        assert np.all(np.abs(found.samples.astype(np.float64)) <= np.pi), description
    else:
        assert str(found).isprintable(), description
        # What the client catches of its own making would hide behind an endpoint that is away.
        assert isinstance(found.__cause__, httpx.TransportError | TimeoutError | None), description
    return type(found).__name__


@contextmanager
def _client(kind: str, url: str) -> Iterator[Callable[[], SampleBatch]]:
    if kind == "sync":
        with SamplingClient(url, policy=POLICY) as client:
            yield lambda: client.sample(PNG, N, seed=SEED)
    else:
        awaited = AsyncSamplingClient(url, policy=POLICY)
        with start_blocking_portal() as portal, portal.wrap_async_context_manager(awaited):
            yield lambda: portal.call(lambda: awaited.sample(PNG, N, seed=SEED))


Headers = list[tuple[bytes, bytes]]


def _body(chance: random.Random) -> bytes:
    kind = chance.randrange(3)
    if kind == 0:
        return chance.choice(BODIES)
    if kind == 1:
        shape = chance.choice([b"(%s, 2)", b"(2, %s)", b"%s", b"(2, 2, %s)"]) % chance.choice(NUMBERS)
        return GOOD_BODY.replace(b"(2, 2)", shape)
    return GOOD_BODY[:128] + chance.randbytes(16)


def _framed(body: bytes, chance: random.Random) -> tuple[bytes, Headers]:
    kind = chance.random()
    if kind < 0.5:
        return body, [(b"Content-Length", b"%d" % len(body))]
    if kind < 0.6:
        return body, [(b"Content-Length", b"%d" % (len(body) + chance.choice([-1, 1, 100, 10**6, 10**15])))]
    if kind < 0.7:
        return body, [(b"Connection", b"close")]
    size = chance.randrange(1, 90)
    chunks = [
        b"%x\r\n%s\r\n" % (len(body[at : at + size]), body[at : at + size])
        for at in range(0, len(body), size)
    ]
    return b"".join(chunks) + b"0\r\n\r\n", [(b"Transfer-Encoding", b"chunked")]


def _drop(headers: Headers, chance: random.Random) -> Headers:
    at = chance.randrange(len(headers) or 1)
    return headers[:at] + headers[at + 1 :]


def _repeat(headers: Headers, chance: random.Random) -> Headers:
    return headers + [chance.choice(headers)] * chance.choice([1, 1, 500]) if headers else headers


def _value(headers: Headers, chance: random.Random) -> Headers:
    at = chance.randrange(len(headers) or 1)
    return [(name, chance.choice(VALUES) if i == at else value) for i, (name, value) in enumerate(headers)]


def _more(headers: Headers, chance: random.Random) -> Headers:
    return [*headers, (chance.choice(NAMES), chance.choice(VALUES))]


HEADER_DAMAGE = [_drop, _repeat, _value, _more]


def _cut(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randrange(len(content) + 1)]


def _flip(content: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(len(content) + 1)
    return content[:at] + chance.randbytes(1) + content[at + 1 :]


def _insert(content: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(len(content) + 1)
    return content[:at] + chance.randbytes(chance.choice([1, 2, 30, 3000])) + content[at:]


def _double(content: bytes, chance: random.Random) -> bytes:
    one, two = sorted(chance.randrange(len(content) + 1) for _ in range(2))
    return content[:two] + content[one:two] * chance.choice([1, 1, 20]) + content[two:]


BYTE_DAMAGE = [_cut, _flip, _insert, _double]
