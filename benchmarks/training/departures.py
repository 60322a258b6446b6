"""What departures of the training from the paper are worth, each taken back alone.

    python -m benchmarks.training.departures --out build/departures --seeds 3 --workers 2

One network without look-ups and gate, the budget and the validation scenarios of
``benchmarks.training.clusters``, two joints, pairs of scenarios. Results are kept line by line, so that a run
that was stopped goes on where it was.
"""

import multiprocessing
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.command import arguments
from benchmarks.lines import append, read
from benchmarks.machine import machine
from benchmarks.training.clusters import BARE, WIDTH, Trainer, trained_wgan
from cspace.files import make_output_folder
from services.evaluator.evaluation.tables import markdown
from services.evaluator.statistics import difference_interval, mean_interval, ratio_of_sums_interval
from training.config.clusters import load_config

JOINTS = 2
AS_IT_IS = "as it is"
# Settings of the paper, or the number of scenarios that are left.
TAKEN_BACK: dict[str, str | int] = {
    AS_IT_IS: 0,
    "two-sided penalty": "penalty=two_sided",
    "critic on standardised angles": "critic_features=standardised",
    "critic by a projection of the scenario's id": "critic_condition=projection",
    "100 scenarios": 100,
}


def trained(trainer: Trainer, name: str, seed: int, steps: int) -> torch.nn.Module:
    """The generator of one network with one departure taken back."""
    change, arrays = TAKEN_BACK[name], trainer.arrays
    sets = [*BARE, *(f"local.{key}={value}" for key, value in WIDTH.items()), f"local.steps={steps}"]
    if isinstance(change, str):
        sets.append(f"local.{change}")
    elif change:
        kept = arrays.ids < change
        arrays = replace(
            arrays,
            configurations=arrays.configurations[kept],
            ids=arrays.ids[kept],
            labels=arrays.labels[kept],
            mu=arrays.mu[:change],
            sigma=arrays.sigma[:change],
        )
    return trained_wgan(load_config("quickstart", sets).local, arrays, None, seed).generator


_TRAINERS: list[Trainer] = []


def _work(job: tuple[str, int, int, Path]) -> dict[str, object]:
    name, seed, steps, out = job
    torch.set_num_threads(1)
    if not _TRAINERS:
        _TRAINERS.append(Trainer(JOINTS, out))
    (trainer,) = _TRAINERS
    rows = trainer.measure(trained(trainer, name, seed, steps))
    return {"name": name, "seed": seed, "steps": steps, "rows": rows}


def report(rows: list[dict], uniform: np.ndarray) -> str:
    """Each departure taken back, beside the training as it is."""
    found = {name: [np.array(row["rows"]) for row in rows if row["name"] == name] for name in TAKEN_BACK}
    table = [
        ["taken back", "seeds", "precision", "over as it is", "coverage", "EDr", "seeds' sd of precision"]
    ]
    base = np.mean(found[AS_IT_IS], axis=0)
    for name, seeds in found.items():
        if not seeds:
            continue
        mean, rng = np.mean(seeds, axis=0), np.random.default_rng(0)
        gained = "" if name == AS_IT_IS else f"{difference_interval(mean[:, 0], base[:, 0], rng):+.3f}"
        spread = np.std([seed[:, 0].mean() for seed in seeds])
        quality = [mean_interval(mean[:, 0], rng), mean_interval(mean[:, 1], rng)]
        ratio = ratio_of_sums_interval(mean[:, 2], uniform[:, 2], rng)
        cells = [f"{quality[0]:.3f}", gained, f"{quality[1]:.3f}", f"{ratio:.3f}", f"{spread:.3f}"]
        table.append([name, str(len(seeds)), *cells])
    return markdown(table)


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=640, help="generator steps")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=1, help="trainings at a time, one thread each")
    options = parser.parse_args()
    make_output_folder(options.out)
    results = options.out / "departures.jsonl"
    torch.set_num_threads(1)
    known = {(row["name"], row["seed"], row["steps"]) for row in read(results)}
    jobs = [(name, seed, options.steps) for seed in range(options.seeds) for name in TAKEN_BACK]
    uniform = np.array(Trainer(JOINTS, options.out).measure(None))
    with multiprocessing.get_context("spawn").Pool(options.workers) as pool:
        left = [(*job, options.out) for job in jobs if job not in known]
        for count, found in enumerate(pool.imap_unordered(_work, left), start=1):
            append(results, found)
            print(f"{count}/{len(left)} {found['name']}, seed {found['seed']}", flush=True)
    rows = [row for row in read(results) if row["steps"] == options.steps]
    print(f"{machine()}\n\n{report(rows, uniform)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
