"""How good a bundle is, without a registry: precision, coverage, EDr, its validity head, on unseen scenarios.

    python -m benchmarks.evaluation.bundle_quality inference_api/pretrained --scenarios 200

The test split is for reporting: decide on validation (``--split validation``), then look at test once.
"""

import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from benchmarks.command import arguments, spread
from benchmarks.machine import machine
from cspace.bundle import Bundle
from cspace.simulator import Split
from services.evaluator.measures.sample_quality import SceneQuality, summarise
from services.evaluator.measures.scenes import SAMPLES, Scene, Stage, bundle_sampler, reconstruct, summary_rng
from services.evaluator.tables import markdown

TIMED = (300, 1000)


def measure(folder: Path, split: Split, seed: int, indices: range) -> list[SceneQuality]:
    bundle = Bundle.load(folder)
    stage = Stage(bundle.spec.world, split, seed)
    return [reconstruct(Scene(stage, index), bundle_sampler(bundle)) for index in indices]


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--scenarios", type=int, default=200)
    parser.add_argument("--split", choices=["validation", "test"], default="test")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    split = Split[options.split.upper()]
    one = partial(measure, options.bundle, split, options.seed)
    parts = [range(first, min(first + 10, options.scenarios)) for first in range(0, options.scenarios, 10)]
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        scenes = [scene for part in pool.map(one, parts) for scene in part]
    found = summarise(scenes, summary_rng(options.seed))
    rows = [["samples", "precision", "coverage", "EDr", "precision p10", "precision minimum"]]
    for name in ("sampler", "confident", "uniform", "real"):
        row = getattr(found, name)
        if row is not None:
            values = (row.precision, row.coverage, row.edr, row.precision_p10)
            rows.append([name, *(f"{value:.3f}" for value in values), f"{row.precision_minimum:.3f}"])
    print(f"{options.bundle}, {options.scenarios} {options.split} scenarios, {SAMPLES} samples each")
    print(f"{machine()}\n\n{markdown(rows)}")
    head = found.occupancy
    if head is not None:
        names = ["accuracy", "within 0.1 m of contact", "calibration error", "accepted"]
        cells = [f"{head.accuracy:.4f}", f"{head.near_accuracy:.3f}"]
        cells += [f"{head.calibration_error:.4f}", f"{head.acceptance:.3f}"]
        print(f"\n{markdown([names, cells])}")
    print(f"\n{_times(options.bundle)}")
    return 0


def _times(folder: Path) -> str:
    """Milliseconds for one picture, encoder, generator and head together, one thread."""
    bundle = Bundle.load(folder)
    stage = Stage(bundle.spec.world, Split.VALIDATION, 0)
    image, lines = Scene(stage, 0).image, []
    for count in TIMED:
        taken = []
        for seed in range(25):
            began = time.perf_counter()
            bundle.sample(image, count, seed)
            taken.append(1e3 * (time.perf_counter() - began))
        lines.append(f"{count} samples, ms: {spread(taken[5:])}")
    return "; ".join(lines)


if __name__ == "__main__":
    sys.exit(main())
