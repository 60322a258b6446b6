"""Settings of a planner, validated once where they are made."""

import math
from dataclasses import dataclass

from cspace.errors import ConfigError
from cspace.query import MAX_SEED

RRT = "RRT"
RRT_STAR = "RRTstar"
RRT_CONNECT = "RRTConnect"
SAMPLED_CONNECT = "SampledRRTConnect"
PRM = "PRM"
INFORMED_RRT_STAR = "InformedRRTstar"
BIT_STAR = "BITstar"
PLANNERS = (RRT, RRT_STAR, RRT_CONNECT, SAMPLED_CONNECT, PRM, INFORMED_RRT_STAR, BIT_STAR)
LEARNED_PLANNERS = (RRT, RRT_STAR, SAMPLED_CONNECT, PRM)
"""Planners that can draw learned samples; the others draw uniform ones only."""
OPTIMISING_PLANNERS = (RRT_STAR, INFORMED_RRT_STAR, BIT_STAR)
"""Planners that shorten their path while they are allowed to."""


@dataclass(frozen=True, slots=True)
class PlannerSettings:
    """How a problem is solved.

    Args:
        planner: one of ``PLANNERS``, by OMPL's name; ``SampledRRTConnect`` is this project's own.
        range_rad: longest step of a tree, in OMPL's metric (the sum over the joints), rad; PRM and BIT* have
            none.
        resolution_rad: largest distance between checked states of an edge in any joint, rad.
        goal_bias: share of the goal among the drawn states; RRT-Connect, PRM and BIT* have none.
        time_limit_s: wall time after which the search ends.
        max_iterations: states drawn after which the search ends; BIT* still ends the batch that it is at.
        seed: of OMPL and of the sample mixture, unsigned 64 bit.
        stop_at_first: whether the optimising planners end with their first solution; the others always do.
        colliding_last: whether learned samples that collide are drawn after all others instead of in their
            turn.

    Raises:
        ConfigError: a value is out of its range.
    """

    planner: str = RRT
    range_rad: float = 1.0
    resolution_rad: float = 0.0314
    goal_bias: float = 0.05
    time_limit_s: float = 10.0
    max_iterations: int = 5000
    seed: int = 1
    stop_at_first: bool = True
    colliding_last: bool = False

    def __post_init__(self) -> None:
        if self.planner not in PLANNERS:
            raise ConfigError(
                "the planner is unknown", expected=" or ".join(PLANNERS), got=repr(self.planner)
            )
        for name in ("range_rad", "resolution_rad", "time_limit_s"):
            value = getattr(self, name)
            _require(0.0 < value < math.inf, name, "above 0 and finite", value)
        _require(0.0 <= self.goal_bias <= 1.0, "goal_bias", "0 to 1", self.goal_bias)
        _require(self.max_iterations >= 1, "max_iterations", "at least 1", self.max_iterations)
        _require(0 <= self.seed <= MAX_SEED, "seed", "unsigned 64 bit", self.seed)


def check_uniform_share(share: float) -> None:
    """Refuse a share of uniform samples that is none.

    Raises:
        ConfigError: it is not within 0 to 1.
    """
    _require(0.0 <= share <= 1.0, "uniform_share", "0 to 1", share)


def _require(holds: bool, name: str, expected: str, got: float) -> None:
    if not holds:
        raise ConfigError(f"{name} is out of range", expected=expected, got=repr(got))
