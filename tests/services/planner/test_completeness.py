"""Whatever the learned samples are, a planner solves what uniform RRT solves."""

import numpy as np
import pytest

from cspace.simulator import Split
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.problems import Family, draw_problem
from services.planner.ompl_planner import solve
from services.planner.result import LEARNED_PLANNERS, RRT, RRT_STAR, PlannerSettings

GARBAGE = 300
BUDGET = 20_000


@pytest.fixture(scope="module")
def solved_by_uniform_rrt(narrow, other_narrow):
    drawn = [draw_problem(Family.UNIFORM, Split.DEMO, 50, index) for index in range(10)]
    settings = PlannerSettings(RRT, max_iterations=BUDGET, time_limit_s=60.0)
    problems = [problem for problem in (*drawn, narrow, other_narrow) if solve(problem, settings).solved]
    assert len(problems) >= 11
    return problems


def colliding(problem):
    """States in collision and no others."""
    drawn = problem.scenario.robot.space.sample_uniform(np.random.default_rng(0), 40 * GARBAGE)
    found = drawn[~CollisionChecker(problem.scenario).valid_batch(drawn)][:GARBAGE]
    assert len(found) == GARBAGE
    return found


def one_free_point(problem):
    return np.tile(problem.start, (GARBAGE, 1))


def one_blocked_point(problem):
    return np.tile(colliding(problem)[0], (GARBAGE, 1))


@pytest.mark.parametrize("planner", LEARNED_PLANNERS)
@pytest.mark.parametrize("garbage", [colliding, one_free_point, one_blocked_point])
def test_a_model_that_only_emits_garbage_costs_no_solution(solved_by_uniform_rrt, planner, garbage):
    settings = PlannerSettings(planner, max_iterations=BUDGET + GARBAGE, time_limit_s=60.0)
    # RRT* takes ten times as long; the last two problems are the narrow ones.
    problems = solved_by_uniform_rrt[-5:] if planner == RRT_STAR else solved_by_uniform_rrt
    found = [solve(problem, settings, garbage(problem), 0.0) for problem in problems]
    assert [result.reason for result in found] == ["solved"] * len(found)
    # Uniform states come after the last learned one, and some searches needed them.
    uniform = [result for result in found if result.uniform_drawn > 0]
    assert uniform
    assert all(result.learned_drawn == GARBAGE for result in uniform)
