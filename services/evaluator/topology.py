"""Geometry score: the topology of two point clouds compared through witness complexes.

Source: Khrulkov and Oseledets, Geometry Score: A Method For Comparing Generative Adversarial Networks, ICML
2018, equations 2 to 5, algorithms 1 and 2. As in the authors' own program, distances are passed where GUDHI
documents squared ones, and the numbers here equal theirs. Unlike there, landmarks are drawn without
replacement, from a generator that is passed in, and living times at ``i_max`` loops or more are reported
instead of dropped.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import gudhi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from cspace.errors import EvaluationError

LANDMARKS = 64
I_MAX = 100
# The complex has no simplex above a triangle, so a witness uses its three nearest landmarks and those within
# the relaxation of the third; all further ones can be left out of the table without changing the result.
_ALWAYS_NEAR = 3

Mapper = Callable[[Callable[[NDArray[np.int64]], "RelativeLivingTimes"], Iterable[NDArray[np.int64]]], Any]


@dataclass(frozen=True, slots=True)
class RelativeLivingTimes:
    """How long each number of loops lives.

    Args:
        values: (i_max,) share of the filtration with 0, 1, 2, ... loops.
        remainder: share with ``i_max`` loops or more; values and remainder sum to one.
    """

    values: NDArray[np.float64]
    remainder: float


def default_gamma(count: int) -> float:
    """Largest filtration value over the largest distance, for a cloud of ``count`` points."""
    return count / 5000.0 / 128.0


def relative_living_times(
    points: NDArray[np.floating[Any]],
    landmark_indices: NDArray[np.integer[Any]],
    gamma: float,
    i_max: int = I_MAX,
) -> RelativeLivingTimes:
    """Relative living times of loops (H1) for one choice of landmarks.

    Args:
        points: (N, d), all of them witnesses.
        landmark_indices: (L,) rows of ``points``.
        gamma: largest filtration value over the largest distance between a point and a landmark.
        i_max: number of loops from which on they are counted together.

    Raises:
        EvaluationError: no points, too few landmarks, or a gamma that is not positive.
    """
    if points.ndim != 2 or len(points) == 0 or len(landmark_indices) < _ALWAYS_NEAR or not gamma > 0.0:
        raise EvaluationError(
            "no witness complex can be built",
            expected=f"points (N, d), {_ALWAYS_NEAR} landmarks or more, gamma above 0",
            got=f"points {points.shape}, {len(landmark_indices)} landmarks, gamma {gamma}",
        )
    distances = cdist(points, points[landmark_indices])
    alpha_max = float(distances.max()) * gamma
    complex_ = gudhi.WitnessComplex(_nearest_table(distances, alpha_max))
    tree = complex_.create_simplex_tree(max_alpha_square=alpha_max, limit_dimension=2)
    tree.compute_persistence(homology_coeff_field=2)
    return living_times(tree.persistence_intervals_in_dimension(1), alpha_max, i_max)


def living_times(
    intervals: NDArray[np.floating[Any]], alpha_max: float, i_max: int = I_MAX
) -> RelativeLivingTimes:
    """Living times from persistence intervals (equations 2 and 3).

    Args:
        intervals: (M, 2) birth and death; a death at infinity counts as ``alpha_max``.
        alpha_max: end of the filtration.
        i_max: number of loops from which on they are counted together.
    """
    spans = np.asarray(intervals, dtype=np.float64).reshape(-1, 2)
    spans = np.where(np.isinf(spans), alpha_max, spans)
    # Without any interval the filtration has no length to measure when all points coincide.
    if len(spans) == 0:
        return RelativeLivingTimes(np.eye(1, i_max)[0], 0.0)
    switches = np.unique(np.append(spans.ravel(), [0.0, alpha_max]))
    middles = (switches[1:] + switches[:-1]) / 2.0
    loops = ((middles[:, None] >= spans[:, 0]) & (middles[:, None] < spans[:, 1])).sum(axis=1)
    shares = np.bincount(loops, weights=np.diff(switches), minlength=i_max) / alpha_max
    return RelativeLivingTimes(shares[:i_max], float(shares[i_max:].sum()))


def mean_living_times(
    points: NDArray[np.floating[Any]],
    rng: np.random.Generator,
    *,
    draws: int,
    gamma: float | None = None,
    landmarks: int = LANDMARKS,
    i_max: int = I_MAX,
    mapper: Mapper = map,
) -> RelativeLivingTimes:
    """Mean relative living times over seeded draws of landmarks (equation 4, algorithm 1).

    All landmarks are drawn before any complex is built, so that a parallel ``mapper`` (a process pool's
    ``map``) gives the same numbers.

    Raises:
        EvaluationError: fewer points than landmarks, or no draws.
    """
    if len(points) < landmarks or draws < 1:
        raise EvaluationError(
            "living times need points and draws",
            expected=f"{landmarks} points and one draw or more",
            got=f"{len(points)} points, {draws} draws",
        )
    picks = [rng.choice(len(points), landmarks, replace=False) for _ in range(draws)]
    one = LivingTimesOf(points, default_gamma(len(points)) if gamma is None else gamma, i_max)
    times = list(mapper(one, picks))
    values = np.mean([t.values for t in times], axis=0)
    return RelativeLivingTimes(values, float(np.mean([t.remainder for t in times])))


@dataclass(frozen=True)
class LivingTimesOf:
    """:func:`relative_living_times` of fixed points; a class because process pools send no closures."""

    points: NDArray[np.floating[Any]]
    gamma: float
    i_max: int

    def __call__(self, landmark_indices: NDArray[np.int64]) -> RelativeLivingTimes:
        """Living times for one choice of landmarks."""
        return relative_living_times(self.points, landmark_indices, self.gamma, self.i_max)


def geometry_score(first: RelativeLivingTimes, second: RelativeLivingTimes) -> float:
    """Sum of squared differences of two mean living times (equation 5, algorithm 2); 0 is equal."""
    return float(np.sum((first.values - second.values) ** 2))


def _nearest_table(distances: NDArray[np.float64], alpha_max: float) -> list[list[tuple[int, float]]]:
    """Per witness its near landmarks with their distances, nearest first."""
    third = np.partition(distances, _ALWAYS_NEAR - 1, axis=1)[:, _ALWAYS_NEAR - 1 : _ALWAYS_NEAR]
    witnesses, landmarks = np.nonzero(distances <= third + alpha_max)
    lengths = distances[witnesses, landmarks]
    order = np.lexsort((lengths, witnesses))
    entries = list(zip(landmarks[order].tolist(), lengths[order].tolist(), strict=True))
    ends = np.cumsum(np.bincount(witnesses, minlength=len(distances))).tolist()
    return [entries[start:end] for start, end in zip([0, *ends], ends, strict=False)]
