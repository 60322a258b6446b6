"""Two checkouts in turns: what requests take, and how many a server answers, by one and by the other.

    python -m benchmarks.serving.in_turns --before /path/to/other/checkout --requests 500

Both servers run all the time on one core, the client on the other, and every request goes to one and then to
the other, the first of the two changing. Throughput: eight clients without a pause, in stretches of two
seconds that change as well. Ratios are of the other checkout's, request by request and stretch by stretch.
"""

import asyncio
import os
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import httpx
import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import ROOT, machine
from benchmarks.serving.attack_requests import exchange, plan
from benchmarks.serving.load import Client, capacity
from benchmarks.serving.served import CLIENT_CORE, Asker, new_pictures, served
from cspace.query import DEFAULT_PATHS
from services.evaluator.tables import markdown

SAMPLES, WARM_UP, STRETCH_S, AT_ONCE = 300, 30, 2.0, 8
Took = list[list[float]]


def in_order(turn: int) -> tuple[int, int]:
    return (0, 1) if turn % 2 else (1, 0)


def requests(ports: list[int], count: int) -> dict[str, Took]:
    """Milliseconds by kind of request and server."""
    askers = [Asker(port, SAMPLES) for port in ports]
    kinds = {"a new picture": {}, "one sent before": {}, "one sent before, JSON": {"accept": "*/*"}}
    took: dict[str, Took] = {kind: [[], []] for kind in kinds}
    for turn, png in enumerate(new_pictures(count + WARM_UP)):
        for kind, options in kinds.items():
            for which in in_order(turn):
                began = time.perf_counter()
                askers[which](png, **options)
                if turn >= WARM_UP:
                    took[kind][which].append(1e3 * (time.perf_counter() - began))
    return took


def plans(ports: list[int], count: int) -> Took:
    """Milliseconds of plans of the arm from a new depth picture, by server."""
    took: Took = [[], []]
    for port in ports:
        while httpx.get(f"http://127.0.0.1:{port}/health/ready", timeout=60).status_code != 200:
            time.sleep(1)
    for turn in range(count + 2):
        data = plan(turn, ways=str(DEFAULT_PATHS), time_limit_s="2", alternatives="true", next_view="true")
        for which in in_order(turn):
            began = time.perf_counter()
            answer = exchange(ports[which], data, 60.0)
            if b" 200 " not in answer[:16]:
                raise RuntimeError(answer)
            if turn >= 2:
                took[which].append(1e3 * (time.perf_counter() - began))
    return took


async def throughput(ports: list[int], stretches: int) -> Took:
    """Requests a second by server."""
    clients, found = [Client(port) for port in ports], [[], []]
    for turn in range(stretches + 1):
        for which in in_order(turn):
            rate = await capacity(clients[which], STRETCH_S, AT_ONCE)
            if turn:
                found[which].append(rate)
    return found


def row(name: str, unit: str, before: list[float], now: list[float]) -> list[str]:
    ratios = np.array(now) / np.array(before)
    low, middle, high = np.quantile(ratios, [0.25, 0.5, 0.75])
    return [
        f"{name}, {unit}", f"{np.median(before):.2f}", f"{np.median(now):.2f}", f"{middle:.3f}",
        f"{low:.3f} to {high:.3f}",
    ]  # fmt: skip


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--before", type=Path, required=True, help="the other checkout")
    parser.add_argument("--requests", type=int, default=500, help="of each kind (default: %(default)s)")
    parser.add_argument("--plans", type=int, default=60, help="of the arm (default: %(default)s)")
    parser.add_argument("--stretches", type=int, default=15, help="of throughput (default: %(default)s)")
    options = parser.parse_args()
    os.sched_setaffinity(0, {CLIENT_CORE % os.cpu_count()})
    table = [["", "before", "now", "ratio, median", "quartiles"]]
    with ExitStack() as stack:
        servers = [stack.enter_context(served(root=root)) for root in (options.before.resolve(), ROOT)]
        ports = [server.port for server in servers]
        for kind, (before, now) in requests(ports, options.requests).items():
            table.append(row(kind, "ms", before, now))
        table.append(row("a plan of the arm", "ms", *plans(ports, options.plans)))
        table.append(row("throughput", "requests/s", *asyncio.run(throughput(ports, options.stretches))))
    print(f"{machine()}\n\n{markdown(table)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
