"""GS-C: the geometry score of the free space and of its complement together.

Source: the paper's equation for GS-C: the largest score over four quarter turns of the enlarged disk, for the
cloud and for its complement, over 2 (t_max - 1).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import EvaluationError
from cspace.space import JointSpace
from services.evaluator.disk import QUARTER_TURNS, enlarged_turns
from services.evaluator.topology import (
    I_MAX,
    LANDMARKS,
    Mapper,
    RelativeLivingTimes,
    geometry_score,
    mean_living_times,
)


@dataclass(frozen=True, slots=True)
class TurnedTimes:
    """Mean living times of one cloud under the four turns."""

    turns: tuple[RelativeLivingTimes, ...]


def turned_living_times(
    configurations: NDArray[np.floating[Any]],
    space: JointSpace,
    rng: np.random.Generator,
    *,
    draws: int,
    mapper: Mapper = map,
) -> TurnedTimes:
    """Mean living times of (N, 2) configurations on the four enlarged disks.

    An empty cloud (the complement of one that fills the joint space) has no loop at any time.

    Raises:
        EvaluationError: points, but fewer than landmarks; or not two joints.
    """
    if len(configurations) == 0:
        none = RelativeLivingTimes(np.eye(1, I_MAX)[0], 0.0)
        return TurnedTimes((none,) * QUARTER_TURNS)
    if len(configurations) < LANDMARKS:
        raise EvaluationError(
            "the cloud is too small", expected=f"{LANDMARKS} points", got=str(len(configurations))
        )
    return TurnedTimes(
        tuple(
            mean_living_times(disk, rng, draws=draws, mapper=mapper)
            for disk in enlarged_turns(configurations, space)
        )
    )


def largest_score(first: TurnedTimes, second: TurnedTimes) -> float:
    """Largest geometry score over the turns."""
    return max(geometry_score(a, b) for a, b in zip(first.turns, second.turns, strict=True))


def complement_score(
    first: TurnedTimes,
    second: TurnedTimes,
    first_complement: TurnedTimes,
    second_complement: TurnedTimes,
    t_max: int = I_MAX,
) -> float:
    """GS-C of two clouds with their complements; 0 is equal."""
    both = largest_score(first, second) + largest_score(first_complement, second_complement)
    return both / (2.0 * (t_max - 1))
