"""PRM: OMPL's growth of a roadmap, from milestones that are given."""

import numpy as np
import pytest
from ompl import base as ob
from scipy.stats import mannwhitneyu

from cspace.worlds.planar.checks import CollisionChecker
from services.planner import ompl_planner
from services.planner.ompl_planner import solve
from services.planner.result import Reason
from services.planner.settings import PRM, PlannerSettings


def settings(seed=1, **changes):
    return PlannerSettings(**({"planner": PRM, "seed": seed} | changes))


def samples_of(count, seed=0):
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, 2))


def rows(array):
    return {tuple(row) for row in np.round(array, 12)}


def test_the_milestones_are_the_free_learned_samples_and_the_two_ends(disconnected):
    samples = samples_of(200)
    result = solve(disconnected, settings(max_iterations=200), samples, 0.0, keep_tree=True)
    assert (result.learned_drawn, result.uniform_drawn, result.iterations) == (200, 0, 200)
    ends = np.stack([disconnected.start, disconnected.goal])
    free = samples[CollisionChecker(disconnected.scenario).valid_batch(samples)]
    vertices = rows(result.tree.vertices)
    assert vertices <= rows(free) | rows(ends)
    # OMPL leaves out milestones without an edge.
    assert len(vertices) > 0.9 * len(free)


def test_milestones_are_drawn_in_the_order_given_until_the_ends_are_joined(make_problem):
    # The first link can not pass the disc above the base, so the way is round below, over the second sample.
    problem = make_problem([(0.0, 3.0)], (0.0, 0.0), (3.0, 0.0))
    result = solve(problem, settings(), [[0.5, 0.0], [-1.5, 0.0], [-1.4, 0.0]], 0.0)
    assert result.solved
    assert (result.iterations, result.learned_drawn, result.uniform_drawn) == (2, 2, 0)
    assert np.array_equal(result.path, [[0.0, 0.0], [-1.5, 0.0], [3.0, 0.0]])


def test_ends_that_see_each_other_need_no_milestone(make_problem):
    result = solve(make_problem(start=(0.0, 0.0), goal=(1.0, 0.5)), settings())
    assert result.solved
    assert (result.iterations, result.edge_checks, len(result.path)) == (0, 1, 2)


def test_the_path_is_the_shortest_way_through_the_roadmap(narrow):
    result = solve(narrow, settings(), keep_tree=True)
    assert result.solved
    space, tree = narrow.scenario.robot.space, result.tree
    # Floyd and Warshall, as a second opinion.
    ways = np.full((len(tree.vertices),) * 2, np.inf)
    lengths = space.distance(tree.vertices[tree.edges[:, 0]], tree.vertices[tree.edges[:, 1]])
    ways[tree.edges[:, 0], tree.edges[:, 1]] = ways[tree.edges[:, 1], tree.edges[:, 0]] = lengths
    for middle in range(len(ways)):
        ways = np.minimum(ways, ways[:, middle, None] + ways[middle])
    start, goal = (int(np.argmin(space.distance(tree.vertices, end))) for end in (narrow.start, narrow.goal))
    assert result.length_rad == pytest.approx(ways[start, goal], abs=1e-9)


@pytest.mark.slow
def test_uniform_draws_are_no_better_or_worse_than_ompl_s_own_valid_states(narrow, monkeypatch):
    ours = [solve(narrow, settings(seed)).edge_checks for seed in range(60)]

    class Ends(ompl_planner.DrawnMilestones):
        """OMPL's own sampler after the ends."""

        def __init__(self, information, *arguments):
            super().__init__(information, *arguments)
            self.own = ob.UniformValidStateSampler(information)

        def sample(self, state):
            return super().sample(state) if self._ends else self.own.sample(state)

    monkeypatch.setattr(ompl_planner, "DrawnMilestones", Ends)
    theirs = [solve(narrow, settings(seed)).edge_checks for seed in range(60)]
    assert ours[:20] != theirs[:20]
    assert mannwhitneyu(ours, theirs).pvalue > 1e-3


def test_milestones_that_are_all_the_same_point_are_one(disconnected):
    same = np.tile([[0.1, 0.1]], (60, 1))
    result = solve(disconnected, settings(max_iterations=60), same, 0.0, keep_tree=True)
    assert result.reason == Reason.ITERATION_LIMIT
    assert result.learned_drawn == 60
    assert len(rows(result.tree.vertices)) <= 3


def test_the_iteration_limit_counts_every_draw(disconnected):
    blocked = np.tile([[np.pi / 2, 0.0]], (101, 1))
    result = solve(disconnected, settings(max_iterations=101), blocked, 0.0)
    assert (result.reason, result.iterations) == (Reason.ITERATION_LIMIT, 101)
    assert result.state_checks >= 101
