"""The topology of one scenario's samples: GS and GS-C, each beside its noise floor.

The floor is the score between two samples of the real distribution, taken the same way. A score near its
floor says nothing; and as the scores are blind to position, they are never told without precision and
coverage.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.evaluator.complement import sample_complement
from services.evaluator.complement_score import TurnedTimes, complement_score, turned_living_times
from services.evaluator.samplers import Sampler
from services.evaluator.scenes import SAMPLES, Scene
from services.evaluator.statistics import Interval, mean_interval
from services.evaluator.topology import LANDMARKS, Mapper, geometry_score, mean_living_times

Cloud = NDArray[np.float64]
SCORES = ("gs", "gsc_boundary", "gsc_true")


@dataclass(frozen=True, slots=True)
class Scored:
    """A score of the sampler beside the score of further real samples."""

    score: float
    floor: float


@dataclass(frozen=True, slots=True)
class SceneTopology:
    """Topology of one scenario.

    Args:
        index: the scenario's number within its split.
        gs: geometry score.
        gsc_boundary: GS-C, the complements of both sides by the boundary algorithm; None for other than two
            joints.
        gsc_true: GS-C, the real side's complement from its true collision states; likewise.
        remainder: largest share of living time with too many loops to be counted.
    """

    index: int
    gs: Scored
    gsc_boundary: Scored | None
    gsc_true: Scored | None
    remainder: float


@dataclass(frozen=True, slots=True)
class ScoreSummary:
    """A score and its floor over scenarios."""

    score: Interval
    floor: Interval


def scene_topology(
    scene: Scene, sampler: Sampler, draws: int, samples: int = SAMPLES, mapper: Mapper = map
) -> SceneTopology:
    """GS, and for two joints GS-C, of a sampler on one scenario.

    Args:
        scene: the scenario.
        sampler: under test.
        draws: of landmarks, per cloud and turn.
        samples: points per cloud.
        mapper: spreads the draws; results do not depend on it.
    """
    generated = np.asarray(sampler.sample(scene.image, samples, scene.sampler_seed(1)), dtype=np.float64)
    clouds = (scene.free(samples, scene.rng(3)), generated, scene.free(samples, scene.rng(4)))
    rng = scene.rng(5)
    real, ours, again = (mean_living_times(cloud, rng, draws=draws, mapper=mapper) for cloud in clouds)
    plain = Scored(geometry_score(real, ours), geometry_score(real, again))
    remainder = max(real.remainder, ours.remainder, again.remainder)
    if scene.space.dim != 2:
        return SceneTopology(scene.index, plain, None, None, remainder)
    boundary, true = _complement_scores(scene, clouds, draws, mapper)
    return SceneTopology(scene.index, plain, boundary, true, remainder)


def summarise_topology(scenes: Sequence[SceneTopology], rng: np.random.Generator) -> dict[str, ScoreSummary]:
    """Means of every score that was taken, with intervals over scenarios.

    Raises:
        EvaluationError: no scenarios.
    """
    summary = {}
    for name in SCORES:
        rows = [getattr(scene, name) for scene in scenes]
        if None not in rows:
            scores, floors = [row.score for row in rows], [row.floor for row in rows]
            summary[name] = ScoreSummary(mean_interval(scores, rng), mean_interval(floors, rng))
    return summary


def _complement_scores(
    scene: Scene, clouds: tuple[Cloud, Cloud, Cloud], draws: int, mapper: Mapper
) -> tuple[Scored, Scored]:
    """GS-C with the real side's complement by the boundary algorithm, and with its true collision states."""
    rng, count = scene.rng(6), len(clouds[0])

    def turned(cloud: Cloud) -> TurnedTimes:
        return turned_living_times(cloud, scene.space, rng, draws=draws, mapper=mapper)

    real, ours, again = (turned(cloud) for cloud in clouds)
    real_c, ours_c, again_c = (turned(sample_complement(c, scene.space, rng, count)) for c in clouds)
    collisions = scene.collisions(count, rng)
    # Fewer collision states than landmarks in a hundred thousand draws: no obstacle to speak of.
    true_c = turned(collisions if len(collisions) >= LANDMARKS else collisions[:0])
    return (
        Scored(complement_score(real, ours, real_c, ours_c), complement_score(real, again, real_c, again_c)),
        Scored(complement_score(real, ours, true_c, ours_c), complement_score(real, again, true_c, again_c)),
    )
