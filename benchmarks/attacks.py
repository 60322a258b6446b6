"""What one hostile client does to a bare server: memory, health, and another client's samples.

    python -m benchmarks.attacks --seconds 10

Attacker and two clients are processes of their own. One client asks for 300 samples, the other whether the
server is alive, both with pauses of 20 ms. Each attack runs after a quiet stretch, whose 99th percentile is
the usual one. Memory is the rise of the server's resident size, to its peak, from the start of the attack.
Only servers on this machine are attacked.
"""

import base64
import http.client
import json
import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor, wait
from contextlib import suppress
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.command import arguments
from benchmarks.machine import ROOT, machine, resident_mib, served
from cspace.files import encode_png
from cspace.worlds.spatial.camera import encode_depth

CONNECTIONS, PAUSE_S, MIB = 4, 0.02, 2**20
READY = [0, -0.785, 0, -2.356, 0, 1.571, 0.785]
POSE = {"translation": [1.3, -0.8, 1.0], "quaternion_xyzw": [-0.3342, 0.8068, 0.4502, -0.1865]}
PICTURE = base64.b64encode(encode_png(np.full((48, 48, 3), 255, np.uint8))).decode()
KEYS = b"{" + b",".join(b'"%x":0' % number for number in range(MIB // 10)) + b"}"
Message = tuple[str, bytes]


def as_json(page: str, **fields: object) -> Message:
    return page, json.dumps(fields).encode()


def depth(side: int, turn: int, page: str = "/sample", **fields: object) -> Message:
    """Four depth pictures of the shipped arm; no two turns have the same camera."""
    picture = base64.b64encode(encode_depth(np.full((side, side), 1500, np.uint16))).decode()
    camera = {"fx": 0.7 * side, "fy": 0.7 * side, "cx": side / 2 + 1e-5 * turn, "cy": side / 2, "pose": POSE}
    return as_json(page, image=[picture] * 4, camera=[camera] * 4, model="pretrained-panda", **fields)


def plan(turn: int) -> Message:
    return depth(160, turn, "/plan", start=READY, goal=[1.0, *READY[1:]], ways=64, time_limit_s=10)


def rows(_: int) -> Message:
    values = np.random.default_rng(0).uniform(-3.0, 3.0, (20_000, 2)).round(6).tolist()
    return as_json("/validity", image=PICTURE, configurations=values)


def filled(unit: bytes, size: int = MIB) -> Message:
    """JSON of so many bytes."""
    return "/validity", b'{"configurations":[' + unit * ((size - 30) // len(unit)) + b"0]}"


# What is sent, from how many addresses, and how long its answer is waited for, s.
ATTACKS: dict[str, tuple[Callable[[int], Message], int, float]] = {
    "fresh depth pictures": (lambda turn: depth(160, turn, n=1, min_confidence=0), 1, 60.0),
    "fresh depth pictures, 2048 pixels a side": (lambda turn: depth(2048, turn, n=1), 1, 60.0),
    "20,000 rows to score in JSON": (rows, 1, 60.0),
    "the same, left after 20 ms": (rows, 1, 0.02),
    "plans from 16 addresses": (plan, 16, 60.0),
    "1 MiB of empty arrays": (lambda _: filled(b"[],"), 1, 60.0),
    "1 MiB of short strings": (lambda _: filled(b'"ab",'), 1, 60.0),
    "1 MiB of numbers": (lambda _: filled(b"0.5,"), 1, 60.0),
    "1 MiB of different keys": (lambda _: ("/validity", KEYS), 1, 60.0),
    "8 MiB of JSON": (lambda _: filled(b"0.5,", 8 * MIB), 1, 60.0),
    "the list of models": (lambda _: ("/models", b""), 1, 60.0),
}


def send(link: http.client.HTTPConnection, message: Message) -> int:
    page, body = message
    link.request("POST" if body else "GET", page, body or None, {"Content-Type": "application/json"})
    answer = link.getresponse()
    answer.read()
    return answer.status


def attack(port: int, seconds: float, name: str) -> None:
    make, addresses, patience_s = ATTACKS[name]
    until = time.monotonic() + seconds

    def one(number: int) -> None:
        turn = number
        while time.monotonic() < until:
            source = (f"127.0.3.{1 + number % addresses}", 0)
            link = http.client.HTTPConnection("127.0.0.1", port, patience_s, source_address=source)
            with suppress(OSError, http.client.HTTPException):
                send(link, make(turn))
            link.close()
            turn += 1000

    connections = max(CONNECTIONS, 2 * addresses)
    with ThreadPoolExecutor(connections) as pool:
        list(pool.map(one, range(connections)))


def ask(port: int, seconds: float, page: str) -> list[float]:
    """Milliseconds of each request; a refusal counts as 60 s."""
    message = as_json(page, image=PICTURE, n=300) if page == "/sample" else (page, b"")
    link, found, until = http.client.HTTPConnection("127.0.0.1", port, 60), [], time.monotonic() + seconds
    while time.monotonic() < until:
        began = time.perf_counter()
        found.append(1e3 * (time.perf_counter() - began) if send(link, message) == 200 else 60e3)
        time.sleep(PAUSE_S)
    return found


def stretch(pool: Executor, port: int, process: int, seconds: float, name: str | None) -> tuple[float, ...]:
    """The 99th percentile of samples and the longest look at health, ms; and the rise of memory, MiB."""
    # The peak starts anew.
    Path(f"/proc/{process}/clear_refs").write_text("5")
    before_mib = resident_mib(process, "VmRSS")
    attacks = [pool.submit(attack, port, seconds, name)] if name else []
    asked = [pool.submit(ask, port, seconds, page) for page in ("/sample", "/health/live")]
    samples, health = (one.result() for one in asked)
    wait(attacks)
    return float(np.quantile(samples, 0.99)), max(health), resident_mib(process, "VmHWM") - before_mib


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of a stretch (default: %(default)s)")
    parser.add_argument("--only", action="append", choices=ATTACKS, help="these attacks; all when absent")
    parser.add_argument("--root", type=Path, default=ROOT, help="checkout whose server is attacked")
    options, found = parser.parse_args(), {}
    with served(options.root) as (port, process), ProcessPoolExecutor(3, get_context("spawn")) as pool:
        send(http.client.HTTPConnection("127.0.0.1", port, 120), depth(160, 0, n=1))
        # Nobody starts while an attack is measured.
        list(pool.map(time.sleep, [1.0] * 3))
        for name in options.only or ATTACKS:
            usual, _, _ = stretch(pool, port, process, options.seconds, None)
            p99, health, rise = stretch(pool, port, process, options.seconds, name)
            found[name] = {"memory, MiB": rise, "health, ms": health, "p99, ms": p99, "ratio": p99 / usual}
            print(name, {key: round(value, 2) for key, value in found[name].items()}, flush=True)
    print(f"\n{machine()}\n\n{pd.DataFrame(found).T.round(2).to_string()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
