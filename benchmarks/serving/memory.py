"""How much memory a server takes under the mix of requests that costs most.

    python -m benchmarks.serving.memory --seconds 120

Twenty clients, each with an address of its own, ask at the same time for what is dear: new depth pictures of
all sizes, as files and as tensors, 20,000 samples or confidences, plans of 10 s for the arm and in the plane,
large flat pictures, and bodies that are no request; a tenth of them is left at once. The memory of the server
and its children is read from ``/proc`` ten times a second: resident, and of that what is in no mapped file
and cannot be taken back.
"""

import json
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import machine
from benchmarks.serving.attack_requests import (
    READY,
    connect,
    depth_pictures,
    depth_tensors,
    form,
    plan,
    png,
    read_answer,
    request,
    sample,
)
from benchmarks.serving.served import Served, served
from cspace.png import encode_png

CLIENTS = 20
LONGEST = {"ways": "64", "time_limit_s": "10", "alternatives": "true"}


def pictures(turn: int) -> bytes:
    """Depth pictures of one of four sizes."""
    side, count = ((160, 4), (640, 4), (1024, 2), (2048, 1))[turn % 4]
    return _depth_pictures(side, count)(turn)


@cache
def _depth_pictures(side: int, count: int) -> Callable[[int], bytes]:
    return depth_pictures("/sample", side, count, n="1", min_confidence="0")


def many_samples(turn: int) -> bytes:
    return depth_pictures("/sample", count=1, n="20000", min_confidence=str(turn % 2))(turn)


def flat_samples(turn: int) -> bytes:
    return sample(_flat_picture(turn % 6), n="20000")


@cache
def _flat_picture(seed: int) -> bytes:
    return png(2048, 6, seed=seed)


def confidences(turn: int) -> bytes:
    return depth_pictures("/validity", count=1, configurations=_rows())(turn)


@cache
def _rows() -> str:
    rows = np.array(READY) + np.random.default_rng(0).uniform(-0.1, 0.1, (20_000, len(READY)))
    return json.dumps(rows.tolist())


def flat_plan(turn: int) -> bytes:
    picture = encode_png(np.random.default_rng(turn).integers(0, 256, (48, 48, 3), dtype=np.uint8))
    return form("/plan", [picture], start="[1.5, 0.5]", goal="[-1.5, 0.5]", **LONGEST)


KINDS: dict[str, Callable[[int], bytes]] = {
    "depth pictures": pictures,
    "depth pictures as tensors": lambda turn: depth_tensors(turn, 1024, 2),
    "samples of the arm": many_samples,
    "samples of flat pictures": flat_samples,
    "confidences": confidences,
    "plans of the arm": lambda turn: plan(turn, next_view="true", **LONGEST),
    "flat plans": flat_plan,
    "bodies that are no request": lambda _: request(
        "/sample", b"[" + b"[]," * 2_000_000 + b"1]", "application/json"
    ),
}


def ask(port: int, number: int, kinds: list[str], until: float, answers: Counter[tuple[str, str]]) -> None:
    """One client: one request after the other, now and then one that it leaves."""
    rng, turn = np.random.default_rng(number), number
    while time.monotonic() < until:
        kind = kinds[turn % len(kinds)]
        # No two requests are alike, so that no picture is known.
        data = KINDS[kind](int(rng.integers(2**20)))
        turn += 1
        outcome = "no answer"
        with suppress(OSError), connect(port, 120.0, f"127.0.4.{number + 1}") as link:
            link.sendall(data)
            if rng.random() < 0.1:
                time.sleep(0.05)
                outcome = "left"
            elif answer := read_answer(link):
                outcome = answer.split()[1].decode()
        answers[kind, outcome] += 1


def processes(api: Served) -> Iterator[int]:
    """Numbers of the server's process and of all below it."""
    found = [api.process_id]
    while found:
        one = found.pop()
        yield one
        with suppress(OSError):
            for children in Path(f"/proc/{one}/task").glob("*/children"):
                found += [int(child) for child in children.read_text().split()]


def memory_mib(api: Served) -> tuple[float, float]:
    """Resident, and of that what is no file."""
    total = {"VmRSS": 0, "RssAnon": 0, "RssShmem": 0}
    for process_id in processes(api):
        with suppress(OSError):
            for line in Path(f"/proc/{process_id}/status").read_text().splitlines():
                name, _, value = line.partition(":")
                if name in total:
                    total[name] += int(value.split()[0])
    return total["VmRSS"] / 1024, (total["RssAnon"] + total["RssShmem"]) / 1024


def memory_text(mib: tuple[float, float]) -> str:
    return f"{mib[0]:.0f} MiB, {mib[1]:.0f} without files"


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=120.0, help="of the load (default: %(default)s)")
    parser.add_argument(
        "--only", action="append", choices=tuple(KINDS), help="these requests; all when absent"
    )
    parser.add_argument(
        "--clients", type=int, default=CLIENTS, help="at the same time (default: %(default)s)"
    )
    parser.add_argument("--registry", help="address of an MLflow server: its processes count, too")
    parser.add_argument(
        "--threads", type=int, help="CSPACE_API_THREADS (default: as many as there are cores)"
    )
    options = parser.parse_args()
    settings = {"MLFLOW_TRACKING_URI": options.registry} if options.registry else {}
    if options.threads:
        settings["CSPACE_API_THREADS"] = str(options.threads)
    answers: Counter[tuple[str, str]] = Counter()
    with served(settings, core=None) as api:
        time.sleep(5.0)
        print(f"at rest: {memory_text(memory_mib(api))}", flush=True)
        until = time.monotonic() + options.seconds
        kinds = options.only or list(KINDS)
        clients = [
            threading.Thread(target=ask, args=(api.port, number, kinds, until, answers), daemon=True)
            for number in range(options.clients)
        ]
        for client in clients:
            client.start()
        most = (0.0, 0.0)
        began, last = time.monotonic(), 0.0
        while time.monotonic() < until or any(client.is_alive() for client in clients):
            now = memory_mib(api)
            most = max(most[0], now[0]), max(most[1], now[1])
            if time.monotonic() - last > options.seconds / 12:
                last = time.monotonic()
                print(f"{last - began:4.0f} s: {memory_text(now)}", flush=True)
            time.sleep(0.1)
        time.sleep(5.0)
        print(f"most: {memory_text(most)}")
        print(f"afterwards: {memory_text(memory_mib(api))}")
    print(machine())
    for (kind, outcome), count in sorted(answers.items()):
        print(f"{kind}: {count} x {outcome}")
    return 1 if any(outcome.startswith("5") and outcome != "503" for _, outcome in answers) else 0


if __name__ == "__main__":
    sys.exit(main())
