"""GS-C: the geometry score of the free space and of its complement together.

Source: the paper's equation for GS-C: the largest score over four quarter turns of the enlarged disk, for the
cloud and for its complement, over 2 (t_max - 1).

The disk and its turns are for two joints. With any other number the clouds are compared as they are. What the
complement adds then is less: on a plane a separate part of the free space is a loop of the complement
(Alexander duality), in three dimensions it is a void, which H1 does not count; there a loop of one side is a
loop of the other, and both are counted.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import EvaluationError
from cspace.space import JointSpace
from services.evaluator.measures.topology.disk import QUARTER_TURNS, enlarged_turns
from services.evaluator.measures.topology.geometry_score import (
    I_MAX,
    LANDMARKS,
    Mapper,
    RelativeLivingTimes,
    geometry_score,
    mean_living_times,
)


@dataclass(frozen=True, slots=True)
class TurnedTimes:
    """Mean living times of one cloud, four turns for two joints and the cloud as it is for others."""

    turns: tuple[RelativeLivingTimes, ...]


def turned_living_times(
    configurations: NDArray[np.floating[Any]],
    space: JointSpace,
    rng: np.random.Generator,
    *,
    draws: int,
    mapper: Mapper = map,
) -> TurnedTimes:
    """Mean living times of (N, d) configurations: on the four enlarged disks for d = 2, else as they are.

    An empty cloud (the complement of one that fills the joint space) has no loop at any time.

    Raises:
        EvaluationError: points, but fewer than landmarks.
    """
    planar = space.dim == 2
    if len(configurations) == 0:
        none = RelativeLivingTimes(np.eye(1, I_MAX)[0], 0.0)
        return TurnedTimes((none,) * (QUARTER_TURNS if planar else 1))
    if len(configurations) < LANDMARKS:
        raise EvaluationError(
            "the cloud is too small", expected=f"{LANDMARKS} points", got=str(len(configurations))
        )
    clouds = enlarged_turns(configurations, space) if planar else (configurations,)
    return TurnedTimes(tuple(mean_living_times(cloud, rng, draws=draws, mapper=mapper) for cloud in clouds))


def largest_score(first: TurnedTimes, second: TurnedTimes) -> float:
    """Largest geometry score over the turns.

    Raises:
        EvaluationError: one cloud has been turned and the other has not.
    """
    if len(first.turns) != len(second.turns):
        raise EvaluationError(
            "the clouds differ in their turns", expected=str(len(first.turns)), got=str(len(second.turns))
        )
    return max(geometry_score(a, b) for a, b in zip(first.turns, second.turns, strict=True))


def complement_score(
    first: TurnedTimes,
    second: TurnedTimes,
    first_complement: TurnedTimes,
    second_complement: TurnedTimes,
    t_max: int = I_MAX,
) -> float:
    """GS-C of two clouds with their complements; 0 is equal.

    Raises:
        EvaluationError: clouds of two joints and of another number.
    """
    both = largest_score(first, second) + largest_score(first_complement, second_complement)
    return both / (2.0 * (t_max - 1))
