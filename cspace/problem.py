"""Planning problems: start and goal in a scene."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.space import JointSpace
from cspace.world import Scene

UNIFORM = "uniform"
"""The family that every world has: ends anywhere in a scene like those of training."""
NARROW = "narrow"
"""The family whose ends a narrow passage joins and nothing wider; not every robot has it."""


OWN = "own"
"""What a problem is called that somebody made by hand."""


@dataclass(frozen=True, eq=False)
class Problem:
    """A planning problem.

    Args:
        scenario: the robot among its obstacles.
        start: (d,) rad.
        goal: (d,) rad.
        family: what it is like.
        bottleneck_rad: largest clearance at which start and goal stay connected; 0 without a path, NaN where
            nobody looked.
        seed: that it was drawn from.
        rejected: draws before it that were not of the family.
    """

    scenario: Scene
    start: NDArray[np.float64]
    goal: NDArray[np.float64]
    family: str = OWN
    bottleneck_rad: float = math.nan
    seed: int = 0
    rejected: int = 0

    @property
    def space(self) -> JointSpace:
        """The robot's joint space."""
        return self.scenario.world.space
