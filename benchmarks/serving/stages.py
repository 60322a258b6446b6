"""Where the time of a request goes: each step by itself, beside the bare session calls of the same run.

    python -m benchmarks.serving.stages --requests 200 --repeats 5 --out build/serving_stages.png

One client, one server on one core, ``.npy`` answers, as in ``latency.py``. The server is the API with a watch
on each step (``timed_server.py``), which costs it a few microseconds a step. A step's time is what it took
without the steps that it called; what is left of the client's time is the client, the kernel and uvicorn.
"""

import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt

from benchmarks.lines import spread
from benchmarks.machine import machine
from benchmarks.serving.latency import WARM_UP, bare, turns_parser
from benchmarks.serving.served import CLIENT_CORE, SERVER_CORE, Asker, new_pictures, served
from benchmarks.serving.timed_server import SESSIONS
from benchmarks.serving.timed_server import STEPS as SERVER_STEPS
from services.evaluator.evaluation.tables import markdown

OUTSIDE = "client, kernel, uvicorn"
STEPS = (*SERVER_STEPS, OUTSIDE)
NEW, KNOWN = "new picture", "picture sent before"

Turn = dict[str, float]


def main() -> int:
    parser = turns_parser(__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/serving_stages.png"), help="the picture")
    options = parser.parse_args()
    os.sched_setaffinity(0, {CLIENT_CORE % os.cpu_count()})
    each = options.requests + WARM_UP
    pictures = new_pictures(options.repeats * each)
    turns: dict[str, list[Turn]] = {NEW: [], KNOWN: []}
    alone = []
    for turn in range(options.repeats):
        fresh = pictures[turn * each : (turn + 1) * each]
        alone.append(bare(fresh, options.samples))
        for name, pngs in ((NEW, fresh), (KNOWN, fresh[:1] * each)):
            turns[name].append(one_turn(pngs, options.samples))
    print(f"{machine()}\n\nbare sessions: {spread(alone, 2)} ms\n\n{table(turns)}")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    draw(turns, statistics.median(alone), options.out)
    return 0


def one_turn(pngs: list[bytes], samples: int) -> Turn:
    """Milliseconds of each step in one server's life, without the first requests."""
    with tempfile.TemporaryDirectory() as folder:
        records, taken = Path(folder) / "records.jsonl", []
        program = ["-m", "benchmarks.serving.timed_server", str(records)]
        with served(core=SERVER_CORE, program=program) as api:
            ask = Asker(api.port, samples)
            for png in pngs:
                began = time.perf_counter()
                ask(png)
                taken.append(time.perf_counter() - began)
        found = [json.loads(line) for line in records.read_text().splitlines()]
    if len(found) != len(pngs):
        raise RuntimeError(f"{len(pngs)} requests, but {len(found)} records")
    requests = []
    for whole, own in zip(taken[WARM_UP:], found[WARM_UP:], strict=True):
        steps = {name: 1e3 * own.get(name, 0.0) for name in STEPS}
        steps[OUTSIDE] = 1e3 * (whole - sum(own.values()))
        requests.append(steps)
    return middle_half(requests)


def middle_half(requests: list[Turn]) -> Turn:
    """Means over the requests that are neither among the fastest nor among the slowest quarter.

    Medians of the steps would not add up to a request, and means of all would tell of the machine's pauses.
    """
    ordered = sorted(requests, key=lambda steps: sum(steps.values()))
    chosen = ordered[len(ordered) // 4 : -(len(ordered) // 4) or None]
    return {name: statistics.fmean(steps[name] for steps in chosen) for name in STEPS}


def table(turns: Mapping[str, list[Turn]]) -> str:
    """Every step, then what the steps come to, as Markdown."""
    rows = [["step", *(f"{name}, ms" for name in turns)]]
    rows += [
        [step, *(spread((turn[step] for turn in found), 2) for found in turns.values())] for step in STEPS
    ]
    for name, steps in (("all sessions", list(SESSIONS.values())), ("the whole request", STEPS)):
        sums = ([sum(turn[step] for step in steps) for turn in found] for found in turns.values())
        rows.append([name, *(spread(values, 2) for values in sums)])
    return markdown(rows)


def draw(turns: Mapping[str, list[Turn]], alone: float, path: Path) -> None:
    """A bar for each kind of request, the sessions in blue, beside the bare sessions."""
    figure, axes = plt.subplots(figsize=(10, 3.2), layout="constrained")
    blues, others = plt.get_cmap("Blues"), plt.get_cmap("tab20c")
    colours = {step: blues(0.4 + 0.15 * at) for at, step in enumerate(SESSIONS.values())}
    colours |= {step: others(4 + at) for at, step in enumerate(STEPS[len(SESSIONS) :])}
    axes.barh("bare sessions", alone, color="0.6")
    for name, found in turns.items():
        left = 0.0
        for step in STEPS:
            width = statistics.median(turn[step] for turn in found)
            axes.barh(name, width, left=left, color=colours[step], label=step if name == NEW else None)
            left += width
    axes.invert_yaxis()
    axes.set(xlabel="ms")
    axes.legend(fontsize=8, ncols=1, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    sys.exit(main())
