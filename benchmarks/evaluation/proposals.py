"""Do uniform proposals beside the generator's samples buy coverage, once the validity head has filtered both?

    python -m benchmarks.evaluation.proposals --bundle inference_api/pretrained --scenarios 60

A share of what the head is shown is uniform. What it lets pass at the bundle's threshold is kept until there
are 1000, on validation scenarios; a share of 1 is the head alone.
"""

import sys
from pathlib import Path

import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import machine
from cspace.bundle import Bundle
from cspace.splits import Split
from services.evaluator.evaluation.tables import markdown
from services.evaluator.measures.scenes import SAMPLES, Scene, Stage
from services.evaluator.statistics import mean_interval, ratio_of_sums_interval

SHARES = (0.0, 0.05, 0.1, 0.25, 0.5, 1.0)
# Enough for 1000 to pass where a fifth of the joint space is free.
DRAWN = 8 * SAMPLES


def kept(bundle: Bundle, scene: Scene, share: float) -> tuple[np.ndarray, float]:
    """(1000, d) samples that pass, in the order in which they were drawn, and the share that does."""
    rng = scene.rng(70)
    image = bundle.prepare(scene.image)
    learned = bundle.sample(image, DRAWN, scene.sampler_seed(), min_confidence=0.0).samples
    uniform = scene.space.to_float32(scene.space.sample_uniform(rng, DRAWN))
    drawn = np.where(rng.random((DRAWN, 1)) < share, uniform, learned)
    passed = bundle.score(image, drawn) >= np.float32(bundle.spec.confidence_threshold)
    return drawn[passed][:SAMPLES].astype(np.float64), float(passed.mean())


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--bundle", type=Path, required=True)
    parser.add_argument("--scenarios", type=int, default=60)
    options = parser.parse_args()
    bundle = Bundle.load(options.bundle)
    stage = Stage(bundle.spec.world, Split.VALIDATION, 0)
    scenes = [Scene(stage, index) for index in range(options.scenarios)]
    real = [scene.free(SAMPLES, scene.rng(0)) for scene in scenes]
    base = [
        scene.quality(scene.space.sample_uniform(scene.rng(1), SAMPLES), held_out)
        for scene, held_out in zip(scenes, real, strict=True)
    ]
    table = [["uniform share", "precision", "coverage", "EDr", "accepted"]]
    for share in SHARES:
        drawn = [kept(bundle, scene, share) for scene in scenes]
        rows = [
            scene.quality(samples, held_out)
            for (samples, _), scene, held_out in zip(drawn, scenes, real, strict=True)
        ]
        rng = np.random.default_rng(0)
        found = [
            mean_interval([getattr(row, name) for row in rows], rng) for name in ("precision", "coverage")
        ]
        found.append(ratio_of_sums_interval([row.energy for row in rows], [row.energy for row in base], rng))
        accepted = np.mean([passed for _, passed in drawn])
        table.append([f"{share:g}", *(f"{value:.3f}" for value in found), f"{accepted:.3f}"])
    print(f"{machine()}\n\n{markdown(table)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
