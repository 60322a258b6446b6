"""A server under load: its capacity, a minute at 70 % of it, and three times as much as it can do.

    python -m benchmarks.serving.load --seconds 60

Requests for 300 samples arrive at random times (Poisson) whether or not earlier ones were answered, and their
time counts from when they were due. The server has one core, the client the other. Every second picture was
sent before.
"""

import asyncio
import collections
import os
import sys
import time
from dataclasses import dataclass, field

import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import machine
from benchmarks.serving.served import CLIENT_CORE, Served, form, new_pictures, served
from services.evaluator.tables import markdown

SAMPLES = 300
PICTURES = 2000


@dataclass
class Tally:
    """Seconds by status; 0 for a connection that failed."""

    seconds: dict[int, list[float]] = field(default_factory=lambda: collections.defaultdict(list))

    def row(self, name: str, rate: float, grown_mib: float) -> list[str]:
        """A line of the table."""
        good = self.seconds.get(200, [0.0])
        refused = [taken for status in (429, 503) for taken in self.seconds.get(status, [])]
        other = sum(len(taken) for status, taken in self.seconds.items() if status not in (200, 429, 503))
        return [
            name, f"{rate:.0f}", str(len(good)), _quantiles(good), str(len(refused)), _quantiles(refused),
            str(other), f"{grown_mib:+.1f}",
        ]  # fmt: skip


def _quantiles(seconds: list[float]) -> str:
    if not seconds:
        return "-"
    return " / ".join(f"{1e3 * np.quantile(seconds, q):.0f}" for q in (0.5, 0.99, 1.0))


class Client:
    """Connections that are kept and taken by whoever asks next."""

    def __init__(self, port: int) -> None:
        self.port, self.idle = port, []
        self.messages = [self._message(png) for png in new_pictures(PICTURES)]
        self.count = 0

    def number(self) -> int:
        """Of the next picture: every second one is new as long as there are new ones."""
        return self.count // 2 if self.count % 2 else 0

    async def ask(self) -> int:
        """One request; its status, 0 where the connection failed."""
        self.count += 1
        message = self.messages[self.number() % PICTURES]
        try:
            reader, writer = (
                self.idle.pop() if self.idle else await asyncio.open_connection("127.0.0.1", self.port)
            )
            writer.write(message)
            head = await reader.readuntil(b"\r\n\r\n")
            lines = head.lower().split(b"\r\n")
            length = next(int(line[15:]) for line in lines if line.startswith(b"content-length:"))
            await reader.readexactly(length)
        except (OSError, asyncio.IncompleteReadError):
            return 0
        if b"connection: close" in lines:
            writer.close()
        else:
            self.idle.append((reader, writer))
        return int(head.split()[1])

    async def answered(self) -> None:
        """One request that must not be refused."""
        status = await self.ask()
        if status != 200:
            raise RuntimeError(f"status {status}")

    def _message(self, png: bytes) -> bytes:
        body, headers = form(png, SAMPLES)
        headers |= {"Host": "127.0.0.1", "Accept": "application/x-npy", "Content-Length": str(len(body))}
        lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
        return f"POST /sample HTTP/1.1\r\n{lines}\r\n".encode() + body


async def capacity(client: Client, seconds: float, at_once: int = 8) -> float:
    """Requests a second of so many clients that ask without a pause."""
    until, done = time.perf_counter() + seconds, 0

    async def go_on() -> None:
        nonlocal done
        while time.perf_counter() < until:
            await client.answered()
            done += 1

    await asyncio.gather(*(go_on() for _ in range(at_once)))
    return done / seconds


async def arrivals(client: Client, rate: float, seconds: float) -> Tally:
    """Requests at random times."""
    tally, rng, open_tasks = Tally(), np.random.default_rng(0), set()
    began, due = time.perf_counter(), 0.0

    async def one(due: float) -> None:
        status = await client.ask()
        tally.seconds[status].append(time.perf_counter() - began - due)

    while due < seconds:
        due += rng.exponential(1.0 / rate)
        await asyncio.sleep(max(0.0, began + due - time.perf_counter()))
        task = asyncio.create_task(one(due))
        open_tasks.add(task)
        task.add_done_callback(open_tasks.discard)
    await asyncio.gather(*open_tasks)
    return tally


async def measure(api: Served, seconds: float) -> list[list[str]]:
    """The three parts."""
    client = Client(api.port)
    await capacity(client, 3.0)
    most = await capacity(client, 10.0)
    table = [["load", "requests/s", "answered", "ms", "refused", "ms", "other", "memory, MiB"]]
    for name, share, duration in (("70 %", 0.7, seconds), ("three times", 3.0, seconds / 3)):
        before = api.resident_kib
        tally = await arrivals(client, share * most, duration)
        grown = (api.resident_kib - before) / 1024
        table.append(tally.row(f"{name} of {most:.0f}", share * most, grown))
    await client.answered()
    return table


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    os.sched_setaffinity(0, {CLIENT_CORE % os.cpu_count()})
    with served() as api:
        table = asyncio.run(measure(api, options.seconds))
    print(f"{machine()}\n\n{markdown(table)}\n\nms: median / 99th percentile / longest")
    return 0


if __name__ == "__main__":
    sys.exit(main())
