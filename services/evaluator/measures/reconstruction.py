"""How well samples reconstruct the free space: precision, coverage and energy distance, always together.

Precision alone rewards a sampler that repeats one good configuration, coverage alone one that is uniform.
The precision and recall of k-NN manifolds tell the same two errors without a collision check or a radius.
Beside every sampler stand the uniform one and real samples judged against real samples.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist, pdist

from cspace.errors import EvaluationError
from cspace.problem import UNIFORM
from cspace.space import JointSpace
from services.evaluator.measures.nearest import Configurations, coverage, knn_precision_recall, require_group
from services.evaluator.measures.occupancy import OccupancySummary, SceneOccupancy, summarise_occupancy
from services.evaluator.statistics import (
    Interval,
    difference_interval,
    mean_interval,
    quantile_interval,
    ratio_of_sums_interval,
)

LOW_QUANTILE = 0.1


@dataclass(frozen=True, slots=True)
class SampleQuality:
    """One sampler on one scenario.

    Args:
        precision: collision-free share of its samples.
        coverage: share of held-out free configurations with a sample within the radius of coverage.
        energy: energy distance to the held-out configurations.
        knn_precision: share of its samples in the k-NN manifold of the held-out configurations.
        knn_recall: share of the held-out configurations in the k-NN manifold of its samples.
    """

    precision: float
    coverage: float
    energy: float
    knn_precision: float
    knn_recall: float


@dataclass(frozen=True, slots=True)
class SceneQuality:
    """The sampler, the uniform one, and real samples on one scenario.

    ``confident`` is the sampler again, with the samples alone that its validity head lets pass, None where
    those are too few; ``occupancy`` is that head. Both are None without one. ``index`` counts within the
    family, and the uniform family is the scenarios as they are drawn for training.
    """

    index: int
    sampler: SampleQuality
    uniform: SampleQuality
    real: SampleQuality
    confident: SampleQuality | None = None
    occupancy: SceneOccupancy | None = None
    family: str = UNIFORM


@dataclass(frozen=True, slots=True)
class SamplerSummary:
    """One sampler over all scenarios; ``edr`` is its summed energy distance over uniform's."""

    precision: Interval
    coverage: Interval
    edr: Interval
    precision_p10: Interval
    precision_minimum: float
    knn_precision: Interval
    knn_recall: Interval


@dataclass(frozen=True, slots=True)
class ReconstructionSummary:
    """All samplers over all scenarios, and the paired gain in precision over uniform.

    ``confident`` and ``occupancy`` are None for samplers without a validity head, ``confident`` also for
    those whose head lets too few samples pass in some scenario.
    """

    sampler: SamplerSummary
    uniform: SamplerSummary
    real: SamplerSummary
    precision_gain: Interval
    confident: SamplerSummary | None = None
    occupancy: OccupancySummary | None = None


def energy_distance(first: Configurations, second: Configurations, space: JointSpace) -> float:
    """2 E|X - Y| - E|X - X'| - E|Y - Y'| on the space's embedding of (N, d) and (M, d).

    Unbiased: no point is paired with itself, so that equal distributions average zero and single values may
    lie slightly below. No root is taken (Szekely and Rizzo 2013).

    Raises:
        EvaluationError: fewer than two configurations in one of the two.
    """
    require_group(first, second, at_least=2)
    x, y = space.embed(first), space.embed(second)
    return float(2.0 * cdist(x, y).mean() - pdist(x).mean() - pdist(y).mean())


def sample_quality(
    samples: Configurations,
    held_out: Configurations,
    space: JointSpace,
    free: Callable[[Configurations], NDArray[np.bool_]],
    radius_rad: float,
) -> SampleQuality:
    """All metrics of (N, d) samples against (M, d) held-out free configurations.

    Args:
        samples: what is judged.
        held_out: free configurations that nobody was trained on.
        space: the joint space.
        free: exact collision check, (N, d) to (N,).
        radius_rad: of coverage.

    Raises:
        EvaluationError: a group with fewer members than k-NN needs, or samples that are not finite.
    """
    require_group(samples, held_out)
    if not np.isfinite(samples).all():
        raise EvaluationError("the sampler returned configurations that are not finite")
    knn = knn_precision_recall(held_out, samples, space)
    return SampleQuality(
        float(np.mean(free(samples))),
        coverage(held_out, samples, space, radius_rad),
        energy_distance(samples, held_out, space),
        knn.precision,
        knn.recall,
    )


def summarise(scenes: Sequence[SceneQuality], rng: np.random.Generator) -> ReconstructionSummary:
    """Summaries with bootstrap intervals over scenarios.

    Raises:
        EvaluationError: no scenarios.
    """
    uniform = [scene.uniform for scene in scenes]
    sampler = [scene.sampler for scene in scenes]
    return ReconstructionSummary(
        _summary(sampler, uniform, rng),
        _summary(uniform, uniform, rng),
        _summary([scene.real for scene in scenes], uniform, rng),
        difference_interval([q.precision for q in sampler], [q.precision for q in uniform], rng),
        *_head_summaries(scenes, uniform, rng),
    )


def _head_summaries(
    scenes: Sequence[SceneQuality], uniform: Sequence[SampleQuality], rng: np.random.Generator
) -> tuple[SamplerSummary | None, OccupancySummary | None]:
    confident = [scene.confident for scene in scenes if scene.confident is not None]
    heads = [scene.occupancy for scene in scenes if scene.occupancy is not None]
    return (
        _summary(confident, uniform, rng) if len(confident) == len(scenes) else None,
        summarise_occupancy(heads, rng) if len(heads) == len(scenes) else None,
    )


def _summary(
    rows: Sequence[SampleQuality], uniform: Sequence[SampleQuality], rng: np.random.Generator
) -> SamplerSummary:
    precision = [row.precision for row in rows]
    # Resampling of their own leaves the other intervals as they are without these measures.
    (apart,) = rng.spawn(1)
    return SamplerSummary(
        mean_interval(precision, rng),
        mean_interval([row.coverage for row in rows], rng),
        ratio_of_sums_interval([row.energy for row in rows], [row.energy for row in uniform], rng),
        quantile_interval(precision, LOW_QUANTILE, rng),
        min(precision),
        mean_interval([row.knn_precision for row in rows], apart),
        mean_interval([row.knn_recall for row in rows], apart),
    )
