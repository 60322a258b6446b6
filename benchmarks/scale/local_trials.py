"""What two worker slots give and what orchestration costs: the reference's local trials, by Ray and by hand.

    make up
    python -m benchmarks.scale.local_trials --out build/local_trials --tracking-uri http://127.0.0.1:5000

Four arms, in an order that turns with the repeat, on the data, networks and batches of a preset.
``together``: the preset's two local trials by the job's own code (Ray Tune, MLflow runs, checkpoints) on a
cluster of two slots. ``apart``: the same on a cluster of one slot, hence one after the other. ``alone``: one
trial on one slot. ``plain``: the same two trainings in two processes that know neither Ray nor MLflow nor
Lightning, from a barrier after their imports. The clock runs from the call that starts the trials to its
return; the cluster is up before. Latents are drawn, not encoded, which costs a step the same. Results are
kept line by line.
"""

import multiprocessing
import os
import shutil
import sys
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import ray
import torch

from benchmarks.command import tracked_arguments
from benchmarks.lines import measured, read, spread
from benchmarks.machine import ROOT
from cspace.dataset import Dataset
from services.evaluator.evaluation.tables import markdown
from services.registry.tracking.mlflow_tracking import MlflowTracking
from training.clusters.stages import partition
from training.config.clusters import TrainConfig, load_config
from training.datasets.generate import generate
from training.trials.arrays import TrainingArrays
from training.trials.launch import QUIET, run_trials
from training.trials.loading import make_wgan
from training.trials.request import TrialRequest
from training.trials.trainables import local_trial

EXPERIMENT = "benchmark-scale"
ARMS = ("plain", "together", "apart", "alone")


def slots(count: int) -> None:
    """A cluster of this machine with so many worker slots."""
    ray.shutdown()
    os.environ |= QUIET
    here = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", **QUIET}
    ray.init(
        address="local",
        num_cpus=count,
        include_dashboard=False,
        log_to_driver=False,
        logging_level="warning",
        _node_ip_address="127.0.0.1",
        runtime_env={"env_vars": here},
    )


def make_arrays(config: TrainConfig, dataset: Dataset) -> TrainingArrays:
    """Configurations, clusters and cells as in the job; latents that are drawn."""
    rng = np.random.default_rng(0)
    free, images = np.array(dataset.free), np.array(dataset.images)
    ids = np.repeat(np.arange(dataset.scenario_count), np.diff(dataset.free_offsets))
    parted = partition(config, free, dataset.world.space)
    labels, cells = parted.labels, parted.gated(config.gate, config.seed)
    shape = (dataset.scenario_count, config.vae.latent_dim)
    mu, sigma = rng.normal(size=shape).astype(np.float32), np.full(shape, 0.25, dtype=np.float32)
    arrays = TrainingArrays(free, ids, labels, mu, sigma, dataset.world, images, cells)
    return replace(arrays, cells=replace(cells, probabilities=arrays.shares().numpy()))


def orchestrated(config: TrainConfig, arrays: TrainingArrays, uri: str, out: Path, trials: int) -> dict:
    """Seconds of the first so many local trials by the job's own code."""
    shutil.rmtree(out, ignore_errors=True)
    began = time.perf_counter()
    tracking = MlflowTracking(uri)
    entries = [
        TrialRequest(
            out / "local" / f"local-{index}",
            tracking.start(EXPERIMENT, f"local-{index}").run_id,
            config.seed + 1 + index,
            index,
        )
        for index in range(trials)
    ]
    shared = {"train": config, "arrays": arrays, "tracking_uri": uri}
    done = run_trials(local_trial, entries, shared, config.resources)
    seconds = time.perf_counter() - began
    size = sum(path.stat().st_size for path in done[0].checkpoint.rglob("*") if path.is_file())
    return {"seconds": seconds, "checkpoint_bytes": size}


def plain(config: TrainConfig, arrays: TrainingArrays) -> dict:
    """Seconds of all local trainings at once, each a loop in a process of its own."""
    context = multiprocessing.get_context("spawn")
    count = config.clusters.count
    ready, go = context.Barrier(count + 1), context.Barrier(count + 1)
    workers = [
        context.Process(target=_loop, args=(config, arrays, index, ready, go)) for index in range(count)
    ]
    for worker in workers:
        worker.start()
    ready.wait()
    began = time.perf_counter()
    go.wait()
    for worker in workers:
        worker.join()
    if any(worker.exitcode for worker in workers):
        raise RuntimeError("a plain loop failed")
    return {"seconds": time.perf_counter() - began}


def _loop(config, arrays, index, ready, go):
    torch.set_num_threads(1)
    ready.wait()
    go.wait()
    module = make_wgan(config.local, arrays, index, config.seed + 1 + index)
    module.on_fit_start()
    for step in range(config.local.steps):
        module.training_step(step, step)


def run(arm: str, config: TrainConfig, arrays: TrainingArrays, uri: str, out: Path) -> dict:
    if arm == "plain":
        return plain(config, arrays)
    slots(2 if arm == "together" else 1)
    try:
        return orchestrated(config, arrays, uri, out / arm, 1 if arm == "alone" else 2)
    finally:
        ray.shutdown()


def report(rows: list[dict]) -> str:
    """Seconds of each arm, then ratios within repeats."""
    ratios = [("together", "apart"), ("together", "plain"), ("alone", "together")]
    table = [["preset", "steps a trial", "repeats", *ARMS, *(" / ".join(pair) for pair in ratios)]]
    for preset, steps in sorted({(row["preset"], row["steps"]) for row in rows}):
        mine = [row for row in rows if (row["preset"], row["steps"]) == (preset, steps)]
        by_arm = {arm: {row["repeat"]: row["seconds"] for row in mine if row["arm"] == arm} for arm in ARMS}
        cells = [spread(found.values()) if found else "-" for found in by_arm.values()]
        for over, under in ratios:
            both = by_arm[over].keys() & by_arm[under].keys()
            found = [by_arm[over][repeat] / by_arm[under][repeat] for repeat in both]
            cells.append(spread(found, 3) if found else "-")
        table.append([preset, str(steps), str(max(map(len, by_arm.values()))), *cells])
    return markdown(table)


def main() -> int:
    parser = tracked_arguments(__doc__)
    parser.add_argument("--preset", default="reference")
    parser.add_argument("--steps", type=int, help="of each trial; the preset's own where none are given")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=ARMS)
    options = parser.parse_args()
    out = options.out.resolve()
    sets = [] if options.steps is None else [f"local.steps={options.steps}"]
    config = load_config(options.preset, sets)
    results = out / "results.jsonl"

    @cache
    def arrays() -> TrainingArrays:
        slots(2)
        return make_arrays(config, generate(config.data, out / "data" / config.data.folder_name))

    for repeat in range(options.repeats):
        turn = repeat % len(options.arms)
        for arm in (*options.arms[turn:], *options.arms[:turn]):
            row = {"preset": options.preset, "steps": config.local.steps, "arm": arm, "repeat": repeat}
            asked = (options.tracking_uri, out / "trials")
            measured(results, row, lambda arm=arm, asked=asked: run(arm, config, arrays(), *asked))
    print(report(read(results)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
