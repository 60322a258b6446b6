"""What many trials on many nodes cost the driver: real Ray nodes on one machine, trials that only sleep.

    python -m benchmarks.scale.placement --out build/placement --nodes 1 4 16 32

Each node has one slot and gets one trial, by the job's own code: it sleeps, reports ``--reports`` times,
and is done. All nodes share this machine's processor, so seconds say little about a
real cluster of that size; what carries over is the driver's own processor time for a trial and for a report,
and how often the arrays are stored. Sizes for which memory does not suffice are left out, and said so.
"""

import os
import shutil
import sys
import time
from pathlib import Path

os.environ |= {"RAY_AUTH_MODE": "disabled", "RAY_USAGE_STATS_ENABLED": "0"}

import numpy as np
import ray
from ray import tune
from ray.experimental import get_object_locations

from benchmarks.command import arguments
from benchmarks.lines import append, read, spread
from benchmarks.scale.nodes import free_bytes, many_nodes, memory_bytes
from services.evaluator.evaluation.tables import markdown
from training.config.clusters import ResourceConfig
from training.trials.launch import run_trials
from training.trials.outcomes import FINISHED
from training.trials.request import TrialRequest

# Enough to be stored, and little enough for the stores of many nodes in one memory.
ARRAY_BYTES = 8 * 2**20


def sleeper():
    """A trainable; made here so that workers get it by value."""

    def sleep(trial, array, reports, seconds, notes):
        began = time.time()
        node = ray.get_runtime_context().get_node_id()
        for step in range(1, reports + 1):
            time.sleep(seconds / reports)
            if step == reports:
                Path(notes, trial.name).write_text(f"{began} {time.time()} {node} {array.nbytes}")
                (trial.folder / f"step-{step:09d}").mkdir(parents=True)
            tune.report({"steps_per_s": 1.0, FINISHED: step == reports})

    return sleep


def measure(count: int, reports: int, seconds: float, out: Path) -> dict:
    stored, put = [], ray.put

    def counted(value, *args, **kwargs):
        reference = put(value, *args, **kwargs)
        if isinstance(value, np.ndarray):
            stored.append(reference)
        return reference

    shutil.rmtree(out, ignore_errors=True)
    (out / "notes").mkdir(parents=True)
    began = time.perf_counter()
    with many_nodes(count):
        up_s = time.perf_counter() - began
        ray.put = counted
        trials = [TrialRequest(out / "job" / "sleep" / f"trial-{index}") for index in range(count)]
        array = np.zeros(ARRAY_BYTES, dtype=np.uint8)
        shared = {"array": array, "reports": reports, "seconds": seconds, "notes": str(out / "notes")}
        called, wall, cpu = time.time(), time.perf_counter(), time.process_time()
        run_trials(sleeper(), trials, shared, ResourceConfig())
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        memory = memory_bytes()
        ray.put = put
        held = sum(len(found["node_ids"]) for found in get_object_locations(stored).values())
    notes = [path.read_text().split() for path in (out / "notes").iterdir()]
    starts = [float(note[0]) - called for note in notes]
    return {
        "nodes": count,
        "nodes_used": len({note[2] for note in notes}),
        "reports": count * reports,
        "up_s": up_s,
        "first_start_s": min(starts),
        "last_start_s": max(starts),
        "wall_s": wall,
        "driver_cpu_s": cpu,
        "memory_bytes": memory,
        "array_puts": len(stored),
        "array_copies": held,
    }


def report(rows: list[dict]) -> str:
    head = ["nodes", "repeats", "nodes used", "arrays stored", "copies", "first start, s", "last start, s"]
    table = [[*head, "wall, s", "driver's CPU, s", "memory, GiB"]]
    for count in sorted({row["nodes"] for row in rows}):
        mine = [row for row in rows if row["nodes"] == count]
        whole = [
            spread([row[name] for row in mine], 0) for name in ("nodes_used", "array_puts", "array_copies")
        ]
        times = [spread([row[name] for row in mine]) for name in ("first_start_s", "last_start_s", "wall_s")]
        last = [spread([row["driver_cpu_s"] for row in mine], 2)]
        last += [spread([row["memory_bytes"] / 2**30 for row in mine])]
        table.append([str(count), str(len(mine)), *whole, *times, *last])
    return markdown(table)


def line(rows: list[dict]) -> str:
    """The driver's processor time as a straight line in trials and reports, by least squares."""
    if len({row["nodes"] for row in rows}) < 2 or len({row["reports"] / row["nodes"] for row in rows}) < 2:
        return "the cost of a trial and of a report needs two numbers of nodes and of reports"
    known = np.array([[1.0, row["nodes"], row["reports"]] for row in rows])
    fixed, trial, one = np.linalg.lstsq(known, np.array([row["driver_cpu_s"] for row in rows]), rcond=None)[0]
    return f"driver's CPU: {fixed:.2f} s, {trial * 1e3:.0f} ms a trial, {one * 1e3:.1f} ms a report"


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--nodes", type=int, nargs="+", default=[1, 4, 16, 32])
    parser.add_argument("--reports", type=int, nargs="+", default=[4, 40], help="of each trial")
    parser.add_argument("--seconds", type=float, default=20.0, help="that a trial sleeps")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--memory-gb", type=float, default=8.0, help="that all nodes together may take")
    options = parser.parse_args()
    out = options.out.resolve()
    results = out / "results.jsonl"
    # What a driver does once in its life is done here.
    measure(1, 1, 1.0, out / "trials")
    for count in sorted(options.nodes):
        for repeat in range(options.repeats):
            for reports in options.reports:
                rows = read(results)
                row = {"nodes": count, "reports": count * reports, "repeat": repeat}
                if any(row.items() <= one.items() for one in rows):
                    continue
                # Part of the memory is the driver's and the head's, so this errs on the safe side.
                shares = [one["memory_bytes"] / one["nodes"] for one in rows if one["nodes"] <= count]
                need = min(shares, default=0.0)
                if need * count > min(options.memory_gb * 2**30, 0.8 * free_bytes()):
                    print(f"{count} nodes are left out: they would take {need * count / 2**30:.1f} GiB")
                    continue
                row |= measure(count, reports, options.seconds, out / "trials")
                append(results, row)
                print(row, flush=True)
    print(report(read(results)))
    print(line(read(results)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
