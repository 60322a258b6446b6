from collections.abc import Callable

import numpy as np
import pytest

from cspace.simulator import Problem
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.problems import Family
from cspace.worlds.planar.world import Disc, Scenario

MakeProblem = Callable[..., Problem]


@pytest.fixture
def make_problem() -> MakeProblem:
    """A problem from discs and two configurations."""

    def make(
        discs=(), start=(0.0, 0.0), goal=(-3.0, 0.0), robot: PlanarArm = TWO_LINK, bottleneck_rad=0.1
    ) -> Problem:
        scenario = Scenario(robot, tuple(Disc(*disc) for disc in discs))
        return Problem(scenario, np.array(start), np.array(goal), Family.UNIFORM, bottleneck_rad, 0, 0)

    return make


@pytest.fixture
def blocked(make_problem) -> Problem:
    """One disc above the base: the first joint has to go round below, or the arm has to fold."""
    return make_problem([(0.0, 3.0)])


@pytest.fixture
def disconnected(make_problem) -> Problem:
    """Discs above and below that the first link can not pass."""
    return make_problem([(0.0, 2.0), (0.0, -2.0)], bottleneck_rad=0.0)
