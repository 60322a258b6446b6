"""Workers over cores: how many requests a second one machine answers, with pictures that are new and known.

    python -m benchmarks.serving.workers --seconds 10 --repeats 3

Each worker keeps pictures of its own, so that one that was sent before is known to those workers alone that
had it. The clients are one process beside the server on the same cores, and what it takes of them is told:
without it the server would have that much more.
"""

import asyncio
import os
import statistics
import sys
import time

from benchmarks.command import arguments
from benchmarks.lines import spread
from benchmarks.machine import machine
from benchmarks.serving.load import Client, capacity
from benchmarks.serving.served import served
from services.evaluator.evaluation.tables import markdown

AT_ONCE = 32
# Pictures that are sent again and again: one, and as many as a fleet of so many cameras at rest would send.
KINDS = {"new": 0, "one, sent before": 1, "100, sent before": 100}


class Asking(Client):
    """Clients that send so many pictures in turn; 0 for new ones as long as there are any."""

    pictures = 0

    def number(self) -> int:
        """Of the next picture."""
        return self.count % self.pictures if self.pictures else self.count


async def rates(port: int, seconds: float) -> dict[str, tuple[float, float]]:
    """Requests a second and the clients' share of one core, by kind of pictures."""
    client, found = Asking(port), {}
    for kind, pictures in KINDS.items():
        client.pictures = pictures
        await capacity(client, 2.0, AT_ONCE)
        began, cpu = time.perf_counter(), time.process_time()
        rate = await capacity(client, seconds, AT_ONCE)
        found[kind] = (rate, (time.process_time() - cpu) / (time.perf_counter() - began))
    return found


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--most", type=int, default=len(os.sched_getaffinity(0)), help="workers at most")
    options = parser.parse_args()
    found: dict[tuple[int, str], list[tuple[float, float]]] = {}
    for turn in range(options.repeats):
        for workers in range(1, options.most + 1):
            program = ("-m", "inference_api", *(() if workers == 1 else ("--workers", str(workers))))
            with served(core=None, program=program) as api:
                for kind, one in asyncio.run(rates(api.port, options.seconds)).items():
                    found.setdefault((workers, kind), []).append(one)
            print(f"turn {turn}, {workers} workers", flush=True)
    table = [["workers", "pictures", "requests/s", "the clients' share of a core"]]
    for (workers, kind), turns in sorted(found.items(), key=lambda item: item[0][0]):
        share = statistics.median(cpu for _, cpu in turns)
        table.append([str(workers), kind, spread((rate for rate, _ in turns), 0), f"{share:.2f}"])
    print(f"{machine()}\n\n{markdown(table)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
