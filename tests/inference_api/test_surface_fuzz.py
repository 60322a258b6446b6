"""The whole surface by structure, against a real server: no 500, no hang, no growth, and good requests go on.

Case ``number`` is made from the seed ``number`` alone, so that the one that fails can be repeated:
``python -m tests.inference_api.test_surface_fuzz NUMBER`` prints its bytes.
"""

import os
import random
import re
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from benchmarks.serving.attack_requests import png, read_answer, sample
from tests.inference_api import body_fuzz, http_fuzz
from tests.inference_api.server import ServerProcess, server_process

SAMPLE_S, WHOLE_S = 20.0, 600.0
PATIENCE_S = 20.0
CHECK_EVERY = 50
GROWTH_MIB = 64
# What the contract knows; 500 is not among them. 100 asks for the body that `Expect` announced.
STATUSES = {100, 200, 307, 400, 401, 403, 404, 405, 408, 413, 414, 415, 421, 422, 429, 431, 503}
_STATUS = re.compile(rb"HTTP/1\.1 ([0-9]{3}) ")
GOOD = sample(png(48, seed=1), n="5", seed="7")


def case(number: int) -> bytes:
    """The bytes of one case."""
    rng = random.Random(number)  # noqa: S311 - a fuzz that can be repeated
    kind = number % 4
    if kind == 0:
        return http_fuzz.message(rng)
    if kind == 1 and rng.random() < 0.3:
        return http_fuzz.upgrade(rng)
    made = next(body_fuzz.requests(rng))
    # As a client writes them that does not look at what it writes.
    lines = [f"POST {made.path} HTTP/1.1", "Host: 127.0.0.1", f"Content-Length: {len(made.body)}"]
    lines += [f"{name}: {value}" for name, value in made.headers.items()]
    return "\r\n".join([*lines, "", ""]).encode("latin-1", errors="replace") + made.body


def send(port: int, data: bytes) -> bytes:
    """What comes back, all of it where the server closes, until it falls silent where it does not."""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as link:
        answer = b""
        try:
            link.sendall(data)
            # As one that has said all there is to say; else a message without its end waits for its deadline.
            link.shutdown(socket.SHUT_WR)
            while part := link.recv(65536):
                answer += part
        except TimeoutError:
            raise
        except OSError:
            # Closed before all was sent, or read.
            with suppress(OSError):
                answer += link.recv(65536)
        return answer


def statuses(answer: bytes) -> set[int]:
    """Of the answers, one behind the other."""
    return {int(status) for status in _STATUS.findall(answer)}


def resident_mib(server: ServerProcess) -> float:
    pages = int(Path(f"/proc/{server.process.pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1024**2


def good(port: int) -> bytes:
    """The samples that a good request is answered with."""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as link:
        link.sendall(GOOD)
        answer = read_answer(link)
    assert answer.startswith(b"HTTP/1.1 200 "), answer[:500]
    return answer.partition(b'"samples":')[2].partition(b'"confidence"')[0]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[ServerProcess]:
    chosen = {"CSPACE_PRETRAINED_MODEL": str(bundles["careful"]), "CSPACE_CACHED_PICTURES": "16"}
    with server_process(tmp_path_factory.mktemp("fuzz"), chosen) as found:
        yield found


def fuzz(server: ServerProcess, first: int, seconds: float) -> int:
    """Send cases for so long; how many there were."""
    port, number = int(server.address.rsplit(":", 1)[1]), first
    expected, before = good(port), 0.0
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        answer = send(port, case(number))
        assert statuses(answer) <= STATUSES, f"case {number}: {answer[:500]!r}"
        assert not answer or answer.startswith(b"HTTP/1.1 "), f"case {number}: {answer[:500]!r}"
        if (number - first) % CHECK_EVERY == 0:
            assert good(port) == expected, f"after case {number}"
        number += 1
        if number - first == CHECK_EVERY:
            # Warm by now: what is still to come is growth.
            before = resident_mib(server)
    grown = resident_mib(server) - before
    assert grown < GROWTH_MIB, f"{grown:.0f} MiB in {number - first} cases"
    return number - first


@pytest.mark.e2e
def test_a_sample_of_the_surface(server: ServerProcess) -> None:
    assert fuzz(server, 0, SAMPLE_S) > CHECK_EVERY


@pytest.mark.e2e
@pytest.mark.slow
@pytest.mark.timeout(2 * WHOLE_S)
def test_ten_minutes_of_the_surface(server: ServerProcess) -> None:
    assert fuzz(server, 1_000_000, WHOLE_S) > CHECK_EVERY


if __name__ == "__main__":
    sys.stdout.buffer.write(case(int(sys.argv[1])))
