"""How well samples reconstruct the free space: precision, coverage and energy distance, always together."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist, pdist

from cspace.errors import EvaluationError
from cspace.simulator import UNIFORM
from cspace.space import JointSpace
from services.evaluator.measures.occupancy import OccupancySummary, SceneOccupancy, summarise_occupancy
from services.evaluator.statistics import (
    Interval,
    difference_interval,
    mean_interval,
    quantile_interval,
    ratio_of_sums_interval,
)

Configurations = NDArray[np.floating[Any]]

# A ball of 5 of 1000 uniform points on the torus of two joints has a radius of 0.25 rad, close to that of
# coverage. The source takes 3 of 50000; with so few points 3 leave holes between real samples themselves.
NEIGHBOURS = 5


@dataclass(frozen=True, slots=True)
class KnnQuality:
    """Precision and recall of k-NN manifolds, both in [0, 1].

    Args:
        precision: share of generated samples inside the real samples' manifold.
        recall: share of real samples inside the generated samples' manifold.
    """

    precision: float
    recall: float


def coverage(
    held_out: Configurations, samples: Configurations, space: JointSpace, radius_rad: float
) -> float:
    """Share of (M, d) held-out configurations with one of (N, d) samples within a radius, round the circles.

    Raises:
        EvaluationError: one of the two is empty.
    """
    return float(np.mean(covered(held_out, samples, space, radius_rad)))


def covered(
    held_out: Configurations, samples: Configurations, space: JointSpace, radius_rad: float
) -> NDArray[np.bool_]:
    """Which of (M, d) held-out configurations have one of (N, d) samples within a radius, (M,).

    Raises:
        EvaluationError: one of the two is empty.
    """
    require_group(held_out)
    nearest, _ = _tree(samples, space).query(_from_zero(held_out, space))
    return np.asarray(nearest <= radius_rad)


def knn_precision_recall(
    real: Configurations, generated: Configurations, space: JointSpace, k: int = NEIGHBOURS
) -> KnnQuality:
    """Precision and recall of Kynkaanniemi et al. 2019, equations 1 and 2, in the joint space's own metric.

    The manifold of a group is the union of balls round its members, each as large as the distance to the
    member's k-th nearest neighbour within the group, itself not counted.

    Args:
        real: (M, d) configurations of the true distribution, rad.
        generated: (N, d) configurations under test, rad.
        space: tells which joints are circles.
        k: neighbours that a ball reaches.

    Raises:
        EvaluationError: k below 1, or a group without k + 1 members.
    """
    if k < 1:
        raise EvaluationError("a ball needs a neighbour to reach", expected="k >= 1", got=str(k))
    require_group(real, generated, at_least=k + 1)
    trees = _tree(real, space), _tree(generated, space)
    return KnnQuality(
        float(np.mean(_within(trees[1], trees[0], k))), float(np.mean(_within(trees[0], trees[1], k)))
    )


def require_group(*groups: Configurations, at_least: int = 1) -> None:
    """Raise where a group is no (N, d) array of enough rows.

    Raises:
        EvaluationError: it is not.
    """
    for group in groups:
        if group.ndim != 2 or len(group) < at_least:
            raise EvaluationError(
                "the group of configurations is too small",
                expected=f"shape (N, d) with N >= {at_least}",
                got=f"shape {group.shape}",
            )


def _within(points: cKDTree, manifold: cKDTree, k: int) -> NDArray[np.bool_]:
    """Which points lie in a ball of the manifold, (n,)."""
    # Each member is its own nearest neighbour, at distance zero.
    distances, _ = manifold.query(manifold.data, [k + 1])
    inside = np.zeros(points.n, dtype=np.bool_)
    for reached in points.query_ball_point(manifold.data, distances[:, 0]):
        inside[reached] = True
    return inside


def _tree(configurations: Configurations, space: JointSpace) -> cKDTree:
    require_group(configurations)
    # A period of 0 tells the tree that a joint is no circle.
    return cKDTree(_from_zero(configurations, space), boxsize=np.where(space.periodic, 2.0 * np.pi, 0.0))


def _from_zero(configurations: Configurations, space: JointSpace) -> NDArray[np.float64]:
    """Circles moved to [0, 2 pi), which is what a periodic tree takes."""
    shifted = np.asarray(configurations, dtype=np.float64)
    turned = np.mod(shifted, 2.0 * np.pi)
    # The modulo of a tiny negative number rounds up to the full period.
    turned = np.where(turned >= 2.0 * np.pi, 0.0, turned)
    return np.where(space.periodic, turned, shifted)


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
        samples: to evaluate.
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
    (own_rng,) = rng.spawn(1)
    return SamplerSummary(
        mean_interval(precision, rng),
        mean_interval([row.coverage for row in rows], rng),
        ratio_of_sums_interval([row.energy for row in rows], [row.energy for row in uniform], rng),
        quantile_interval(precision, LOW_QUANTILE, rng),
        min(precision),
        mean_interval([row.knn_precision for row in rows], own_rng),
        mean_interval([row.knn_recall for row in rows], own_rng),
    )
