"""Trees reach what they grow towards: a step in its direction is not yet there."""

import numpy as np
import pytest

from cspace.planning.rrt_connect import Growth, grow_connect
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.world import Scenario

RANGE_RAD, RESOLUTION_RAD = 0.5, 0.05
# The sum over the joints is 3.7 rad: eight steps.
START, GOAL = np.array([-1.2, 0.3]), np.array([1.0, -1.2])


@pytest.fixture
def checker():
    return CollisionChecker(Scenario(TWO_LINK, ()))


def longest_step(path):
    return np.abs(TWO_LINK.space.difference(path[:-1], path[1:])).sum(axis=1).max()


@pytest.mark.parametrize("seed", range(2))
def test_two_trees_meet_in_one_configuration_and_jump_nowhere(checker, seed):
    states = TWO_LINK.space.sample_uniform(np.random.default_rng(seed), 50)
    path = grow_connect(checker, START, GOAL, states, Growth(RANGE_RAD, RESOLUTION_RAD)).path
    np.testing.assert_allclose(path[[0, -1]], [START, GOAL])
    assert longest_step(path) <= RANGE_RAD + 1e-9
