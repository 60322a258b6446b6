"""Whether what clients get is what the bundle gives: quality over HTTP beside that of the bundle itself.

    python -m benchmarks.serving.quality --scenarios 100

Nothing but ``n`` and a seed is asked for, so the model's own threshold holds. On the test scenarios; the
seeds over HTTP are others than those of the bundle, but for the last row, which has the same.
"""

import argparse
import sys
from dataclasses import dataclass

import numpy as np

from benchmarks.serving.served import BUNDLE, machine, served
from cspace.bundle import Bundle
from cspace.splits import Split
from services.evaluator.evaluation.tables import markdown
from services.evaluator.measures.reconstruction import SceneQuality, summarise
from services.evaluator.measures.samplers import BundleSampler, HttpSampler, Image, Sampler, Samples
from services.evaluator.measures.scenes import SAMPLES, Scene, Stage, reconstruct, summary_rng
from services.evaluator.statistics import difference_interval
from services.planner.sources.sampling_client import SamplingClient


@dataclass(frozen=True)
class OtherSeeds:
    """A sampler with seeds of its own."""

    sampler: Sampler

    def sample(self, image: Image, n: int, seed: int) -> Samples:
        return self.sampler.sample(image, n, seed + 1)


def measured(stage: Stage, sampler: Sampler, scenarios: int) -> list[SceneQuality]:
    return [reconstruct(Scene(stage, index), sampler) for index in range(scenarios)]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenarios", type=int, default=100)
    options = parser.parse_args()
    bundle = Bundle.load(BUNDLE)
    stage = Stage(bundle.spec.world, Split.TEST, 0)
    own = BundleSampler(bundle, min_confidence=bundle.spec.confidence_threshold or 0.0)
    with served() as api, SamplingClient(f"http://127.0.0.1:{api.port}") as client:
        over_http = HttpSampler(client, min_confidence=None)
        found = {
            "the bundle": measured(stage, own, options.scenarios),
            "over HTTP": measured(stage, OtherSeeds(over_http), options.scenarios),
            "over HTTP, same seeds": measured(stage, over_http, options.scenarios),
        }
    table = [["samples", "precision", "coverage", "EDr", "precision minus the bundle's", "coverage minus it"]]
    base = found["the bundle"]
    for name, scenes in found.items():
        row = summarise(scenes, summary_rng(0)).sampler
        apart = [
            difference_interval(
                [getattr(scene.sampler, value) for scene in scenes],
                [getattr(scene.sampler, value) for scene in base],
                np.random.default_rng(0),
            )
            for value in ("precision", "coverage")
        ]
        cells = [f"{value:.4f}" for value in (row.precision, row.coverage)]
        table.append([name, *cells, f"{row.edr:.3f}", *(f"{value:+.4f}" for value in apart)])
    print(f"{options.scenarios} test scenarios, {SAMPLES} samples each; {machine()}\n\n{markdown(table)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
