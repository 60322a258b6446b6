"""How good a bundle is, without a registry: precision, coverage, EDr, its validity head, on unseen scenarios.

    python -m benchmarks.bundle_quality inference_api/pretrained --scenarios 200

The test split is for reporting: decide on validation (``--split validation``), then look at test once.
"""

import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.command import arguments, spread
from benchmarks.machine import machine
from cspace.bundle import Bundle
from cspace.simulator import Split
from services.commands import aligned
from services.evaluator.evaluation import Row, estimates_of, measure_samples, reconstruct
from services.evaluator.metrics import Task
from services.evaluator.scenes import SAMPLES, Scene, Stage, bundle_sampler

TIMED = (300, 1000)
FILTERED = "uniform, kept by the head"


def measure(folder: Path, split: Split, seed: int, indices: range) -> list[Row]:
    bundle = Bundle.load(folder)
    stage = Stage(bundle.spec.world, split, seed)
    rows: list[Row] = []
    for index in indices:
        scene = Scene(stage, index)
        rows += reconstruct(scene, bundle_sampler(bundle))
        if bundle.has_validity:
            rows += measure_samples(scene, {FILTERED: filtered_uniform(bundle, scene)})
    return rows


def filtered_uniform(bundle: Bundle, scene: Scene) -> NDArray[np.float64]:
    """Uniform configurations that the validity head keeps, without the generator."""
    rows = scene.space.to_float32(scene.space.sample_uniform(scene.rng(4), 20 * SAMPLES))
    kept = bundle.predict(bundle.prepare(scene.image), rows)[0] >= (bundle.spec.confidence_threshold or 0.0)
    return rows[kept][:SAMPLES].astype(np.float64)


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
        measured = [row for part in pool.map(one, parts) for row in part]
    found = estimates_of(measured, options.seed)
    rows = [["samples", "precision", "coverage", "EDr", "precision p10", "precision minimum"]]
    for name in ("sampler", "confident", FILTERED, "uniform", "real"):
        if (name, "precision") in found:
            measures = ("precision", "coverage", "edr", "precision_p10", "precision_minimum")
            rows.append([name, *(f"{found[name, measure]:.3f}" for measure in measures)])
    print(f"{options.bundle}, {options.scenarios} {options.split} scenarios, {SAMPLES} samples each")
    print(f"{machine()}\n\n{aligned(rows)}")
    head = {measure: value for (_, measure), value in estimates_of(measured, options.seed, Task.HEAD).items()}
    if head:
        names = ["accuracy", "within 0.1 m of contact", "calibration error", "accepted"]
        cells = [f"{head['accuracy']:.4f}", f"{head['near_accuracy']:.3f}"]
        cells += [f"{head['calibration_error']:.4f}", f"{head['acceptance']:.3f}"]
        print(f"\n{aligned([names, cells])}")
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
