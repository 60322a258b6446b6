"""Whether what clients get is what the bundle gives: quality over HTTP beside that of the bundle itself.

    python -m benchmarks.serving.quality --scenarios 100

Nothing but ``n`` and a seed is asked for, so the model's own threshold holds. On the test scenarios; the
seeds over HTTP are others than those of the bundle, but for the last row, which has the same.
"""

import sys

import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import machine
from benchmarks.serving.served import BUNDLE, served
from cspace.bundle import Bundle
from cspace.query import SampleQuery
from cspace.simulator import Split
from services.evaluator.measures.sample_quality import SceneQuality, summarise
from services.evaluator.measures.scenes import SAMPLES, Scene, Stage, reconstruct, summary_rng
from services.evaluator.statistics import difference_interval
from services.evaluator.tables import markdown
from services.planner.client import SamplingClient
from services.planner.samples import BundleSampler, Picture, SampleBatch, SampleSource


class AsClientsAsk(SampleSource):
    """A source that is asked for nothing but a count and a seed, so that a model's own threshold holds."""

    def __init__(self, source: SampleSource, later: int = 0) -> None:
        self.source, self.later = source, later

    def answer(self, picture: Picture, query: SampleQuery, model: str | None = None) -> SampleBatch:
        return self.source.answer(picture, SampleQuery(query.n, query.seed + self.later), model)


def measured(stage: Stage, sampler: SampleSource, scenarios: int) -> list[SceneQuality]:
    return [reconstruct(Scene(stage, index), sampler) for index in range(scenarios)]


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--scenarios", type=int, default=100)
    options = parser.parse_args()
    bundle = Bundle.load(BUNDLE)
    stage = Stage(bundle.spec.world, Split.TEST, 0)
    own = AsClientsAsk(BundleSampler(bundle))
    with served() as api, SamplingClient(f"http://127.0.0.1:{api.port}") as client:
        found = {
            "the bundle": measured(stage, own, options.scenarios),
            "over HTTP": measured(stage, AsClientsAsk(client, later=1), options.scenarios),
            "over HTTP, same seeds": measured(stage, AsClientsAsk(client), options.scenarios),
        }
    table = [["samples", "precision", "coverage", "EDr", "precision minus the bundle's", "coverage minus it"]]
    base = found["the bundle"]
    for name, scenes in found.items():
        row = summarise(scenes, summary_rng(0)).sampler
        differences = [
            difference_interval(
                [getattr(scene.sampler, value) for scene in scenes],
                [getattr(scene.sampler, value) for scene in base],
                np.random.default_rng(0),
            )
            for value in ("precision", "coverage")
        ]
        cells = [f"{value:.4f}" for value in (row.precision, row.coverage)]
        table.append([name, *cells, f"{row.edr:.3f}", *(f"{value:+.4f}" for value in differences)])
    print(f"{options.scenarios} test scenarios, {SAMPLES} samples each; {machine()}\n\n{markdown(table)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
