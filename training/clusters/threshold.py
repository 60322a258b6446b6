"""The confidence that a bundle recommends: chosen by a rule, on validation scenarios."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.splits import Split
from cspace.world import World
from services.evaluator.measures.scenes import Scene, Stage

# Of a scene's seeds, apart from those that the evaluator's measurements use.
STREAM = 45
CANDIDATES = tuple(round(0.5 + 0.05 * step, 2) for step in range(10))


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """Configurations in one scenario.

    Args:
        confidence: (n,) by the validity head.
        free: (n,) whether each is.
    """

    confidence: NDArray[np.floating]
    free: NDArray[np.bool_]

    def passing(self, threshold: float) -> tuple[float, float]:
        """Shares of all: what reaches the threshold, and what reaches it and is free."""
        passes = self.confidence >= threshold
        return float(np.mean(passes)), float(np.mean(passes & self.free))


def choose_threshold(
    learned: Sequence[Scored], target_precision: float, candidates: Sequence[float] = CANDIDATES
) -> float:
    """The lowest candidate at which the samples that pass are as precise as wanted.

    Both the mean over scenarios and their 10th percentile count, for a sampler that is right on average may
    fail one scenario in ten; the percentile may miss as much again as the mean.

    Args:
        learned: the generator's samples, by scenario.
        target_precision: of the mean, 0 to 1.
        candidates: rising thresholds.

    Returns:
        The threshold; the highest candidate where none is enough.
    """
    for threshold in candidates:
        passing = np.array([rows.passing(threshold) for rows in learned])
        if not passing[:, 0].all():
            break
        if _precise(passing, target_precision):
            return threshold
    return candidates[-1]


def _precise(passing: NDArray[np.float64], target: float) -> bool:
    precisions = passing[:, 1] / passing[:, 0]
    low = 1.0 - 2.0 * (1.0 - target)
    return bool(precisions.mean() >= target and np.quantile(precisions, 0.1) >= low)


def validation_scores(
    bundle: Bundle, world: World, scenarios: int, samples: int = 1000
) -> tuple[list[Scored], list[Scored]]:
    """A bundle's samples and uniform ones in validation scenarios, as its head scores them."""
    stage = Stage(world, Split.VALIDATION, 0)
    learned: list[Scored] = []
    uniform: list[Scored] = []
    for scene in (Scene(stage, index) for index in range(scenarios)):
        picture = bundle.prepare(scene.image)
        drawn = bundle.sample(picture, samples, scene.sampler_seed(STREAM), min_confidence=0.0).samples
        anywhere = scene.space.to_float32(scene.space.sample_uniform(scene.rng(STREAM), samples))
        for group, rows in ((learned, drawn), (uniform, anywhere)):
            group.append(Scored(bundle.score(picture, rows), scene.checker.valid_batch(rows)))
    return learned, uniform
