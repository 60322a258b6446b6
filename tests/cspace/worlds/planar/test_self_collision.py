"""Arms that collide with themselves: links that share no joint, by their capsules."""

import itertools

import numpy as np
import pytest

from cspace.errors import ScenarioError
from cspace.simulator import Problem
from cspace.worlds import robot_digest
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.world import PlanarWorld, Scenario
from services.planner.ompl_planner import solve
from services.planner.result import RRT_CONNECT, SAMPLED_CONNECT, PlannerSettings
from tests.capsules import self_clearance_by_hand
from tests.cspace.worlds.planar.test_collision import FOLDING


@pytest.mark.parametrize("links", [(1.0, 0.2, 1.0), (1.0, 1.0, 0.1, 1.0)])
def test_an_arm_that_always_collides_with_itself_is_refused(links):
    with pytest.raises(ScenarioError, match=r"always collides with itself.*0\.2 m"):
        PlanarArm(links, 0.1, self_collision=True)
    assert PlanarArm(links, 0.1).dim == len(links)


@pytest.mark.parametrize("planner", [SAMPLED_CONNECT, RRT_CONNECT])
def test_no_tree_and_no_path_passes_through_the_arm_itself(planner):
    # Between them the third link turns past the second one's ends, on the short way through the first link.
    start, goal = np.array([0.0, 1.2, 2.0]), np.array([0.0, 1.2, -2.0])
    plain, scenario = Scenario(PlanarArm(FOLDING.link_lengths_m, 0.1), ()), Scenario(FOLDING, ())
    assert CollisionChecker(plain).edge(start, goal, 0.01)
    assert not CollisionChecker(scenario).edge(start, goal, 0.01)
    problem = Problem(scenario, start, goal)
    result = solve(problem, PlannerSettings(planner=planner, max_iterations=20_000), keep_tree=True)
    assert result.solved
    assert result.tree is not None
    assert all(self_clearance_by_hand(FOLDING, q) > 0.0 for q in result.tree.vertices)
    for first, second in itertools.pairwise(result.path):
        for share in np.linspace(0.0, 1.0, 20):
            q = first + share * FOLDING.space.difference(first, second)
            # Links that cross are 0.2 m deep; between the states that a check looks at they move by less.
            assert self_clearance_by_hand(FOLDING, q) > -0.05


def test_the_digests_of_robots_are_what_they_were():
    digests = [robot_digest(PlanarWorld(arm))[:16] for arm in (TWO_LINK, THREE_LINK)]
    assert digests == ["14c4c4a2dfa4d819", "0f5028b4ee2dd87b"]
