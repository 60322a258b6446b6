"""How many trials a tracking server keeps up with: calls a second from ever more clients.

    make up
    python -m benchmarks.scale.tracking_rate --out build/tracking --tracking-uri http://127.0.0.1:5000

A call is what a trial sends when its buffer is five seconds old: ``--metrics`` points of one run. Every
client is a process with a run of its own that calls as fast as it is answered. A trial calls once in five
seconds, so a server that answers 20 calls a second keeps up with 100 trials.
"""

import multiprocessing
import statistics
import sys
import time
from functools import partial

from benchmarks.command import tracked_arguments
from benchmarks.lines import measured, read, spread
from services.evaluator.evaluation.tables import markdown
from services.registry.tracking.mlflow_tracking import MlflowTracking

EXPERIMENT = "benchmark-scale"
BUFFER_AGE_S = 5.0


def client(uri: str, metrics: int, seconds: float, ready, answers) -> None:
    """Call for so many seconds; answers with the time of each call."""
    # A buffer that is sent by hand only.
    run = MlflowTracking(uri, buffer_size=10**9, buffer_age_s=10.0**9).start(EXPERIMENT, "tracking-rate")
    ready.wait()
    times, began, step = [], time.perf_counter(), 0
    while time.perf_counter() - began < seconds:
        for _ in range(metrics // 5):
            step += 1
            run.metrics({f"metric_{number}": 0.5 for number in range(5)}, step)
        called = time.perf_counter()
        run.flush()
        times.append(time.perf_counter() - called)
    answers.put(times)
    run.finish()


def measure(uri: str, clients: int, metrics: int, seconds: float) -> dict:
    context = multiprocessing.get_context("spawn")
    ready, answers = context.Barrier(clients), context.Queue()
    work = [
        context.Process(target=client, args=(uri, metrics, seconds, ready, answers)) for _ in range(clients)
    ]
    for one in work:
        one.start()
    times = [time_s for _ in work for time_s in answers.get(timeout=seconds + 120.0)]
    for one in work:
        one.join()
    ordered = sorted(times)
    return {
        "calls_per_s": len(times) / seconds,
        "median_ms": statistics.median(times) * 1e3,
        "p99_ms": ordered[int(0.99 * (len(ordered) - 1))] * 1e3,
    }


def report(rows: list[dict]) -> str:
    table = [["clients", "repeats", "calls/s", "median, ms", "p99, ms", "trials it keeps up with"]]
    for clients in sorted({row["clients"] for row in rows}):
        mine = [row for row in rows if row["clients"] == clients]
        cells = [spread(row[name] for row in mine) for name in ("calls_per_s", "median_ms", "p99_ms")]
        trials = statistics.median(row["calls_per_s"] for row in mine) * BUFFER_AGE_S
        table.append([str(clients), str(len(mine)), *cells, f"{trials:.0f}"])
    return markdown(table)


def main() -> int:
    parser = tracked_arguments(__doc__)
    parser.add_argument("--clients", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--metrics", type=int, default=25, help="points of a call")
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    results = options.out.resolve() / "results.jsonl"
    for repeat in range(options.repeats):
        for clients in options.clients:
            row = {"clients": clients, "repeat": repeat, "metrics": options.metrics}
            asked = (options.tracking_uri, clients, options.metrics, options.seconds)
            measured(results, row, partial(measure, *asked))
    print(report(read(results)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
