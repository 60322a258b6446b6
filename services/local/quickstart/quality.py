"""Quality of versions as a client sees it: over HTTP, on scenarios never trained on."""

from collections.abc import Mapping, Sequence

import numpy as np

from cspace.query import SampleQuery
from cspace.splits import Split
from cspace.worlds import picture_file_of, robot_digest
from services.evaluator.measures.reconstruction import ReconstructionSummary, SceneQuality, summarise
from services.evaluator.measures.scenes import Scene, Stage
from services.local.quickstart.tours import Tour
from services.planner.sources.samples import SampleSource
from services.planner.sources.sampling_client import SamplingClient

SAMPLES = 1000
# Other scenarios than those of the evaluation job, whose seed is 0.
SEED = 1


def served_quality(url: str, references: Sequence[str], tour: Tour) -> Mapping[str, ReconstructionSummary]:
    """Ask for versions, without their validity filter and with it, and judge all on the same scenarios.

    Args:
        url: of the inference API.
        references: the versions, as the API takes them.
        tour: whose scenarios, and how many.

    Returns:
        By reference the summary over all scenarios of ``SAMPLES`` samples each; ``confident`` is as
        served, and None where too few samples came in some scenario.

    Raises:
        SamplerUnavailableError: the API does not answer.
        SamplerError: it refused a request.
    """
    stage = Stage(tour.world, Split.TEST, SEED)
    with SamplingClient(url, robot=robot_digest(stage.world)) as client:
        rows = [_rows(Scene(stage, index), client, references) for index in range(tour.scenarios)]
    return {one: summarise([row[one] for row in rows], np.random.default_rng(SEED)) for one in references}


def _rows(scene: Scene, client: SampleSource, references: Sequence[str]) -> dict[str, SceneQuality]:
    held_out = scene.free(SAMPLES, scene.rng(0))
    uniform = scene.quality(scene.space.sample_uniform(scene.rng(1), SAMPLES), held_out)
    real = scene.quality(scene.free(SAMPLES, scene.rng(2)), held_out)

    picture = picture_file_of(scene.scenario)

    def judged(reference: str) -> SceneQuality:
        queries = (SampleQuery(SAMPLES, scene.sampler_seed(), min_confidence=least) for least in (0.0, None))
        drawn, served = (client.answer(picture, query, reference).samples for query in queries)
        as_served = scene.quality(served.astype(np.float64), held_out) if len(served) == SAMPLES else None
        return SceneQuality(
            scene.index, scene.quality(drawn.astype(np.float64), held_out), uniform, real, as_served
        )

    return {reference: judged(reference) for reference in references}
