"""The topology of one scenario's samples: GS and GS-C, each beside its noise floor.

The floor is the score between two samples of the real distribution, taken the same way. A score near its
floor says nothing; and as the scores are blind to position, they are never told without precision and
coverage.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.evaluator.measures.scenes import Scene, unfiltered
from services.evaluator.measures.topology import (
    LANDMARKS,
    POINTS,
    TurnedTimes,
    complement_score,
    geometry_score,
    mean_living_times,
    sample_complement,
    turned_living_times,
)
from services.evaluator.statistics import Interval, mean_interval
from services.planner.samples import SampleSource

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
        gsc_boundary: GS-C, the complements of both sides by the boundary algorithm; without the turns where
            there are not two joints.
        gsc_true: GS-C, the real side's complement from its true collision states; likewise.
        remainder: largest share of living time with too many loops to be counted.
    """

    index: int
    gs: Scored
    gsc_boundary: Scored
    gsc_true: Scored
    remainder: float


@dataclass(frozen=True, slots=True)
class ScoreSummary:
    """A score and its floor, over scenarios or over the repeats of one."""

    score: Interval
    floor: Interval


def scene_topology(
    scene: Scene,
    sampler: SampleSource,
    draws: int,
    samples: int = POINTS,
) -> SceneTopology:
    """GS and GS-C of a sampler on one scenario.

    Args:
        scene: the scenario.
        sampler: under test.
        draws: of landmarks, per cloud and turn.
        samples: points per cloud.
    """
    seed = int(scene.rng(11).integers(0, 2**63))
    generated = unfiltered(sampler, scene.image, samples, seed)
    real, again = (scene.free(samples, scene.rng(stream)) for stream in (3, 4))
    clouds = (real, generated, again)
    rng = scene.rng(5)
    times = [mean_living_times(cloud, rng, draws=draws) for cloud in clouds]
    plain = Scored(geometry_score(times[0], times[1]), geometry_score(times[0], times[2]))
    boundary, true = _complement_scores(scene, clouds, scene.rng(6), draws)
    return SceneTopology(scene.index, plain, boundary, true, max(one.remainder for one in times))


def summarise_topology(scenes: Sequence[SceneTopology], rng: np.random.Generator) -> dict[str, ScoreSummary]:
    """Means of every score that was taken, with intervals over scenarios.

    Raises:
        EvaluationError: no scenarios.
    """
    summary = {}
    for name in SCORES:
        rows = [getattr(scene, name) for scene in scenes]
        scores, floors = [row.score for row in rows], [row.floor for row in rows]
        summary[name] = ScoreSummary(mean_interval(scores, rng), mean_interval(floors, rng))
    return summary


def _complement_scores(
    scene: Scene, clouds: tuple[Cloud, Cloud, Cloud], rng: np.random.Generator, draws: int
) -> tuple[Scored, Scored]:
    """GS-C with the real side's complement by the boundary algorithm, and with its true collision states."""
    count = len(clouds[0])

    def turned(cloud: Cloud) -> TurnedTimes:
        return turned_living_times(cloud, scene.space, rng, draws=draws)

    real, ours, again = (turned(cloud) for cloud in clouds)
    real_c, ours_c, again_c = (turned(sample_complement(c, scene.space, rng, count)) for c in clouds)
    collisions = scene.collisions(count, rng)
    # Fewer collision states than landmarks in a hundred thousand draws: no obstacle to speak of.
    true_c = turned(collisions if len(collisions) >= LANDMARKS else collisions[:0])
    return (
        Scored(complement_score(real, ours, real_c, ours_c), complement_score(real, again, real_c, again_c)),
        Scored(complement_score(real, ours, true_c, ours_c), complement_score(real, again, true_c, again_c)),
    )
