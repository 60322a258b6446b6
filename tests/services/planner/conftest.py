from collections.abc import Callable

import numpy as np
import pytest

from cspace.simulator import Problem
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.problems import Family
from cspace.worlds.planar.world import Disc, Scenario

MakeProblem = Callable[..., Problem]


def problem_of(
    discs=(), start=(0.0, 0.0), goal=(-3.0, 0.0), robot: PlanarArm = TWO_LINK, bottleneck_rad=0.1
) -> Problem:
    """A problem from discs and two configurations."""
    scenario = Scenario(robot, tuple(Disc(*disc) for disc in discs))
    return Problem(scenario, np.array(start), np.array(goal), Family.UNIFORM, bottleneck_rad, 0, 0)


@pytest.fixture
def make_problem() -> MakeProblem:
    return problem_of


@pytest.fixture
def blocked() -> Problem:
    """One disc above the base: the first joint has to go round below, or the arm has to fold."""
    return problem_of([(0.0, 3.0)])


@pytest.fixture
def disconnected() -> Problem:
    """Discs above and below that the first link can not pass."""
    return problem_of([(0.0, 2.0), (0.0, -2.0)], bottleneck_rad=0.0)


# Narrow passages of 0.074 and 0.066 rad, as the demo's seeds 31 and 32 draw them, which takes seconds.


@pytest.fixture(scope="session")
def narrow() -> Problem:
    discs = [
        (2.822251034628593, -0.9967638243619801),
        (-1.415326492703871, -2.0928747388048725),
        (3.238234527927437, 0.4613807511782708),
    ]
    return problem_of(
        discs, (-1.4539847821655814, 0.5922496151156444), (-1.5387810991447752, -2.9597004064292216)
    )


@pytest.fixture(scope="session")
def other_narrow() -> Problem:
    discs = [
        (3.3486580662506285, 0.855872759527669),
        (-2.02168088392913, -2.452487733472771),
        (2.2054092992303946, -1.8199814636478706),
    ]
    return problem_of(
        discs, (-2.3334018429893932, 2.8157346350945858), (-0.2464395099935408, 0.1748393889963067)
    )
