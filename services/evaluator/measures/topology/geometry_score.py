"""Geometry score: the topology of two point clouds compared through witness complexes.

Source: Khrulkov and Oseledets, Geometry Score: A Method For Comparing Generative Adversarial Networks, ICML
2018, equations 2 to 5, algorithms 1 and 2. As in the authors' own program, the relaxation is of distances and
not of squared ones, and the numbers here equal theirs. Unlike there, landmarks are drawn without replacement,
from a generator that is passed in, and living times at ``i_max`` loops or more are reported instead of
dropped.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from cspace.errors import EvaluationError
from services.evaluator.measures.topology.witness import witness_complex

LANDMARKS = 64
# As in the original experiments; with two thousand GS-C hardly tells slightly noisy samples from real ones.
POINTS = 5000
I_MAX = 100
# A triangle has as many.
FEWEST_LANDMARKS = 3

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
        points: (N, d), all of them witnesses, in any number of dimensions.
        landmark_indices: (L,) rows of ``points``.
        gamma: largest filtration value over the largest distance between a point and a landmark.
        i_max: number of loops from which on they are counted together.

    Raises:
        EvaluationError: no points, points that are not finite, too few landmarks, or gamma not above 0.
    """
    if points.ndim != 2 or len(points) == 0 or len(landmark_indices) < FEWEST_LANDMARKS or not gamma > 0.0:
        raise EvaluationError(
            "no witness complex can be built",
            expected=f"points (N, d), {FEWEST_LANDMARKS} landmarks or more, gamma above 0",
            got=f"points {points.shape}, {len(landmark_indices)} landmarks, gamma {gamma}",
        )
    distances = cdist(points, points[landmark_indices])
    alpha_max = float(distances.max()) * gamma
    if not np.isfinite(alpha_max):
        raise EvaluationError("no witness complex can be built", expected="finite points", got="nan or inf")
    return living_times(witness_complex(distances, alpha_max).loop_intervals(), alpha_max, i_max)


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
