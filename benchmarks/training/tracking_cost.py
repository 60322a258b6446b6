"""What tracking costs: a WGAN-GP of the default size with and without an MLflow run, in turns.

    make up
    python -m benchmarks.training.tracking_cost --tracking-uri http://127.0.0.1:5000

Each pair trains the same steps from the same seed, once with a run that forgets and once with a run
on the server, in an order that alternates. The cost is the ratio of a pair's wall times less one; the
median over pairs is what counts.
"""

import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from benchmarks.command import arguments
from benchmarks.training.forgetful import ForgetfulRun, report_nothing
from cspace.space import circles
from services.registry.tracking.mlflow_tracking import MlflowTracking
from training.config.clusters import load_config
from training.models.checkpoint import seeded_initialisation
from training.models.data import ScenarioSamples
from training.models.modules import WganGpModule
from training.trials.checkpoints import TrialFolder
from training.trials.fit import Rhythm, fit

EXPERIMENT = "benchmark-tracking-cost"


def module(steps: int) -> WganGpModule:
    config = load_config("quickstart", [f"global.steps={steps}"]).global_
    rng = torch.Generator().manual_seed(0)
    scenarios, rows = 4000, 400_000
    samples = ScenarioSamples(
        (torch.rand(rows, 2, generator=rng) * 2.0 - 1.0) * torch.pi,
        torch.arange(rows) % scenarios,
        torch.randn(scenarios, 64, generator=rng),
        torch.full((scenarios, 64), 0.25),
    )
    with seeded_initialisation(0):
        return WganGpModule(config, samples, (torch.zeros(2), torch.ones(2)), 0, circles(2))


def timed(steps: int, rhythm: Rhythm, run) -> float:
    trained = module(steps)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        fit("global", trained, steps, rhythm, run, TrialFolder(Path(folder)), report_nothing)
    return time.perf_counter() - began


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--tracking-uri", required=True)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--pairs", type=int, default=7)
    options = parser.parse_args()
    torch.set_num_threads(1)
    resources = load_config("quickstart").resources
    rhythm = Rhythm(resources.log_every_steps, resources.checkpoint_every_steps)
    tracking = MlflowTracking(options.tracking_uri)
    timed(20, rhythm, ForgetfulRun())
    ratios, plain_s = [], []
    for pair in range(options.pairs):
        run = tracking.start(EXPERIMENT, f"pair-{pair}")
        order = [ForgetfulRun(), run] if pair % 2 == 0 else [run, ForgetfulRun()]
        times = {type(one) is ForgetfulRun: timed(options.steps, rhythm, one) for one in order}
        ratios.append(times[False] / times[True] - 1.0)
        plain_s.append(times[True])
        print(
            f"pair {pair}: {times[True]:.2f} s without, {times[False]:.2f} s with, {ratios[-1]:+.2%}",
            flush=True,
        )
    low, high = np.min(ratios), np.max(ratios)
    spread = f"(min {low:+.2%}, max {high:+.2%}), {options.pairs} pairs"
    print(f"tracking cost: median {statistics.median(ratios):+.2%} {spread}")
    print(
        f"plain training: median {statistics.median(plain_s) / options.steps * 1e3:.1f} ms a generator step"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
