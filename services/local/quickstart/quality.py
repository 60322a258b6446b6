"""Precision and coverage of a version as a client sees it: over HTTP, on scenarios never trained on."""

from dataclasses import dataclass

import numpy as np

from cspace.splits import Split
from cspace.worlds import default_world
from services.evaluator.measures.reconstruction import ReconstructionSummary, summarise
from services.evaluator.measures.scenes import Scene, Stage, reconstruct
from services.planner.sources.samples import PinnedSource
from services.planner.sources.sampling_client import SamplingClient

SCENARIOS = 100
SAMPLES = 1000
# Other scenarios than those of the evaluation job, whose seed is 0.
SEED = 1


@dataclass(frozen=True, slots=True)
class ServedQuality:
    """The summary over ``SCENARIOS`` scenarios of ``SAMPLES`` samples each."""

    reference: str
    summary: ReconstructionSummary


def served_quality(url: str, reference: str) -> ServedQuality:
    """Ask for a version by ``name/version`` without its validity filter and judge what comes.

    Raises:
        SamplerUnavailableError: the API does not answer.
        SamplerError: it refused a request.
    """
    stage = Stage(default_world(), Split.TEST, SEED)
    with SamplingClient(url) as client:
        sampler = PinnedSource(client, reference)
        rows = [reconstruct(Scene(stage, index), sampler, SAMPLES) for index in range(SCENARIOS)]
    return ServedQuality(reference, summarise(rows, np.random.default_rng(SEED)))
