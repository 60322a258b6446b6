"""The confidence that a bundle recommends: chosen by a rule, on validation scenarios."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.robot import PlanarArm
from cspace.scenario import Camera, Split
from services.evaluator.scenes import Scene, Stage

# Of a scene's seeds, apart from those that the evaluator's measurements use.
STREAM = 45
CANDIDATES = tuple(round(0.5 + 0.05 * step, 2) for step in range(10))


def choose_threshold(
    scores: Sequence[tuple[NDArray[np.floating], NDArray[np.bool_]]],
    target_precision: float,
    candidates: Sequence[float] = CANDIDATES,
) -> float:
    """The lowest candidate at which the samples that pass are as precise as wanted.

    Both the mean over scenarios and their 10th percentile count, for a sampler that is right on average may
    fail one scenario in ten; the percentile may miss as much again as the mean.

    Args:
        scores: per scenario (n,) confidences and whether each sample is free.
        target_precision: of the mean, 0 to 1.
        candidates: rising thresholds.

    Returns:
        The threshold; the highest candidate where none is enough.
    """
    for threshold in candidates:
        precisions = [
            float(np.mean(free[confidence >= threshold]))
            for confidence, free in scores
            if np.any(confidence >= threshold)
        ]
        if len(precisions) < len(scores):
            break
        low = 1.0 - 2.0 * (1.0 - target_precision)
        if np.mean(precisions) >= target_precision and np.quantile(precisions, 0.1) >= low:
            return threshold
    return candidates[-1]


def validation_scores(
    bundle: Bundle, robot: PlanarArm, camera: Camera, scenarios: int, samples: int = 1000
) -> list[tuple[NDArray[np.float32], NDArray[np.bool_]]]:
    """Confidences of a bundle's samples in validation scenarios, and whether each sample is free."""
    stage = Stage(robot, camera, Split.VALIDATION, 0)
    found = []
    for scene in (Scene(stage, index) for index in range(scenarios)):
        drawn = bundle.sample(scene.image, samples, scene.sampler_seed(STREAM), min_confidence=0.0)
        if drawn.confidence is not None:
            found.append((drawn.confidence, scene.checker.valid_batch(drawn.samples)))
    return found
