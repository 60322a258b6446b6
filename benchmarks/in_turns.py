"""Two checkouts in turns: what requests take, and how many a server answers, by one and by the other.

    python -m benchmarks.in_turns --before /path/to/other/checkout --requests 500

Both servers run all the time on one core, the client on the other, and every request goes to one and then to
the other, the first of the two changing. Throughput: eight clients without a pause, in stretches of two
seconds that change as well. Ratios are of the other checkout's, request by request and stretch by stretch.
"""

import asyncio
import os
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pandas as pd

from benchmarks.command import arguments
from benchmarks.machine import ROOT, machine, served
from cspace.query import DEFAULT_PATHS
from cspace.simulator import Scene, Simulator, Split
from cspace.worlds import default_world, examples, simulator_of

SAMPLES, WARM_UP, STRETCH_S, AT_ONCE, PICTURES = 300, 30, 2.0, 8, 2000
SERVER_CORE, CLIENT_CORE = 0, 1
SEED = 99
NPY = "application/x-npy"
Took = list[list[float]]


def new_pictures(count: int) -> list[bytes]:
    """So many PNG files, each of a scenario of its own."""
    simulator = simulator_of(default_world())
    return [simulator.picture_file(one) for one in simulator.scenes(Split.DEMO, SEED, count)]


def in_order(turn: int) -> tuple[int, int]:
    """Which server is asked first."""
    return (0, 1) if turn % 2 else (1, 0)


def timed_ms(client: httpx.Client, page: str, accept: str = "*/*", **request: Any) -> float:
    """Milliseconds of a request; an error for any other status than 200."""
    began = time.perf_counter()
    client.post(page, headers={"Accept": accept}, **request).raise_for_status()
    return 1e3 * (time.perf_counter() - began)


def samples(clients: list[httpx.Client], count: int) -> dict[str, Took]:
    """Milliseconds of requests for samples by kind and server."""
    kinds = {"a new picture": NPY, "one sent before": NPY, "one sent before, JSON": "*/*"}
    took: dict[str, Took] = {kind: [[], []] for kind in kinds}
    for turn, png in enumerate(new_pictures(count + WARM_UP)):
        for kind, accept in kinds.items():
            for which in in_order(turn):
                form = {"data": {"n": SAMPLES}, "files": {"image": png}}
                taken_ms = timed_ms(clients[which], "/sample", accept, **form)
                if turn >= WARM_UP:
                    took[kind][which].append(taken_ms)
    return took


def plans(clients: list[httpx.Client], count: int) -> Took:
    """Milliseconds of plans of the Panda from a new depth picture, by server."""
    simulator, took = simulator_of(examples()["panda"]), [[], []]
    for turn, scene in enumerate(simulator.scenes(Split.DEMO, SEED, count + 2)):
        form = plan_form(simulator, scene, turn)
        for which in in_order(turn):
            taken_ms = timed_ms(clients[which], "/plan", **form)
            if turn >= 2:
                took[which].append(taken_ms)
    return took


def plan_form(simulator: Simulator, scene: Scene, turn: int) -> Mapping[str, Any]:
    """A request for a plan in a scene, between uniform configurations that are free in truth."""
    space = scene.world.space
    drawn = space.sample_uniform(np.random.default_rng(turn), 500)
    start, goal = drawn[simulator.checker(scene).valid_batch(drawn)][:2].tolist()
    fields = {
        "model": "pretrained-panda", "start": str(start), "goal": str(goal), "ways": DEFAULT_PATHS,
        "time_limit_s": "2", "min_confidence": "0", "alternatives": "true",
    }  # fmt: skip
    return {"data": fields, "files": {"image": simulator.picture_file(scene)}}


async def throughput(addresses: list[str], stretches: int) -> Took:
    """Requests a second by server, of clients that ask without a pause; half of the pictures are new."""
    pictures, found = new_pictures(PICTURES), [[], []]
    limits, count = httpx.Limits(max_connections=AT_ONCE), 0

    async def ask(client: httpx.AsyncClient, until: float) -> int:
        nonlocal count
        done = 0
        while time.perf_counter() < until:
            count += 1
            png = pictures[count // 2 % PICTURES if count % 2 else 0]
            form = {"data": {"n": SAMPLES}, "files": {"image": png}}
            (await client.post("/sample", headers={"Accept": NPY}, **form)).raise_for_status()
            done += 1
        return done

    for turn in range(stretches + 1):
        for which in in_order(turn):
            async with httpx.AsyncClient(base_url=addresses[which], limits=limits, timeout=60) as client:
                until = time.perf_counter() + STRETCH_S
                done = await asyncio.gather(*(ask(client, until) for _ in range(AT_ONCE)))
            if turn:
                found[which].append(sum(done) / STRETCH_S)
    return found


def row(name: str, took: Took) -> dict[str, str]:
    """Medians of both, and quartiles of the ratios."""
    before, now = (np.array(one) for one in took)
    low, middle, high = np.quantile(now / before, [0.25, 0.5, 0.75])
    medians = {"before": f"{np.median(before):.2f}", "now": f"{np.median(now):.2f}"}
    return {"": name, **medians, "ratio, median": f"{middle:.3f}", "quartiles": f"{low:.3f} to {high:.3f}"}


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--before", type=Path, required=True, help="the other checkout")
    parser.add_argument("--requests", type=int, default=500, help="of each kind (default: %(default)s)")
    parser.add_argument("--plans", type=int, default=60, help="of the arm (default: %(default)s)")
    parser.add_argument("--stretches", type=int, default=15, help="of throughput (default: %(default)s)")
    options = parser.parse_args()
    os.sched_setaffinity(0, {CLIENT_CORE % os.cpu_count()})
    rows = []
    with ExitStack() as stack:
        roots = options.before.resolve(), ROOT
        ports = [stack.enter_context(served(root, SERVER_CORE))[0] for root in roots]
        addresses = [f"http://127.0.0.1:{port}" for port in ports]
        clients = [stack.enter_context(httpx.Client(base_url=one, timeout=60)) for one in addresses]
        for kind, took in samples(clients, options.requests).items():
            rows.append(row(f"{kind}, ms", took))
        rows.append(row("a plan of the arm, ms", plans(clients, options.plans)))
        rows.append(row("throughput, requests/s", asyncio.run(throughput(addresses, options.stretches))))
    print(f"{machine()}\n\n{pd.DataFrame(rows).to_markdown(index=False, disable_numparse=True)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
