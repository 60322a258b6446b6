"""Settings of a planner."""

import math
from dataclasses import dataclass

from cspace.errors import ConfigError
from cspace.query import MAX_SEED

RRT = "RRT"
RRT_STAR = "RRTstar"
RRT_CONNECT = "RRTConnect"
SAMPLED_CONNECT = "SampledRRTConnect"
PLANNERS = (RRT, RRT_STAR, RRT_CONNECT, SAMPLED_CONNECT)
LEARNED_PLANNERS = (RRT, RRT_STAR, SAMPLED_CONNECT)
"""Planners that can draw learned samples; OMPL's RRTConnect draws uniform ones only."""


@dataclass(frozen=True, slots=True)
class PlannerSettings:
    """How a problem is solved.

    Args:
        planner: one of ``PLANNERS``, by OMPL's name; ``SampledRRTConnect`` is this project's own.
        range_rad: longest step of a tree, in OMPL's metric (the sum over the joints), rad.
        resolution_rad: largest distance between checked states of an edge in any joint, rad.
        goal_bias: share of the goal among the drawn states; RRT-Connect has none.
        time_limit_s: wall time after which the search ends.
        max_iterations: states drawn after which the search ends.
        seed: of OMPL and of the sample mixture, unsigned 64 bit.
        stop_at_first: whether RRT* ends with its first solution; the other planners always do.
    """

    planner: str = RRT
    range_rad: float = 1.0
    resolution_rad: float = 0.0314
    goal_bias: float = 0.05
    time_limit_s: float = 10.0
    max_iterations: int = 5000
    seed: int = 1
    stop_at_first: bool = True

    def __post_init__(self) -> None:
        positive = ("range_rad", "resolution_rad", "time_limit_s")
        rules = {
            "planner": (self.planner in PLANNERS, " or ".join(PLANNERS)),
            **{name: (0.0 < getattr(self, name) < math.inf, "above 0 and finite") for name in positive},
            "goal_bias": (0.0 <= self.goal_bias <= 1.0, "0 to 1"),
            "max_iterations": (self.max_iterations >= 1, "at least 1"),
            "seed": (0 <= self.seed <= MAX_SEED, "unsigned 64 bit"),
        }
        for name, (holds, expected) in rules.items():
            if not holds:
                raise ConfigError(f"{name} is out of range", expected=expected, got=repr(getattr(self, name)))
