from dataclasses import replace

import numpy as np
import pytest

from cspace.errors import EvaluationError
from cspace.simulator import Problem
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.problems import Family
from cspace.worlds.planar.world import Disc, Scenario
from services.evaluator.evaluation.measured import planning_table
from services.evaluator.measures.planning import (
    PlanningTrial,
    RunOutcome,
    plan_trial,
    success_rate,
    summarise_family,
)
from services.planner.result import PlanResult
from services.planner.settings import PlannerSettings
from tests.fakes.uniform_sampler import ScoredUniformSampler, UniformSampler

# One disc on the y axis: turning the first joint through a quarter circle collides, through the others it
# does not.
BLOCKED = Scenario(TWO_LINK, (Disc(0.0, 3.0),))
START, GOAL = np.array([0.0, 0.0]), np.array([-3.0, 0.0])
SETTINGS = PlannerSettings(
    planner="RRT",
    range_rad=1.0,
    resolution_rad=0.05,
    goal_bias=0.05,
    time_limit_s=5.0,
    max_iterations=500,
    seed=1,
)


def problem(start=START, goal=GOAL):
    return Problem(BLOCKED, start, goal, Family.UNIFORM, 0.1, 0, 0)


def result(path, *, solved=True, iterations=10, **changes):
    values = {
        "solved": solved,
        "path": np.asarray(path, dtype=np.float64).reshape(-1, 2),
        "length_rad": 3.0,
        "iterations": iterations,
        "edge_checks": 2 * iterations,
        "solve_time_s": 1e-3 * iterations,
        "learned_drawn": 4,
        "uniform_drawn": 6,
        "reason": "exact solution",
    }
    return PlanResult(**(values | changes))


def outcome(success=True, iterations=10, length_rad=2.0):
    return RunOutcome(
        success, iterations, 2 * iterations, 1e-3 * iterations, length_rad if success else None, 0, "done"
    )


def trial(uniform, learned, family=Family.UNIFORM, index=0):
    return PlanningTrial(family, index, 1, uniform, learned, 0.002)


def planned_by(found, *, sampler=None, settings=SETTINGS, goal=GOAL):
    """A trial whose planner gives this result, and what it was asked."""
    calls = []

    def solver(*given):
        calls.append(given)
        return found

    sampler = sampler or UniformSampler(TWO_LINK.space)
    return plan_trial(problem(goal=goal), 3, 77, sampler, settings, solver), calls


def at(first, second):
    return np.array([first, second])


# Both ends are free and lie 0.9 rad apart, with a collision half way.
THROUGH = at(np.pi, 0.0)


@pytest.mark.parametrize(
    ("path", "goal", "success"),
    [
        ([START, GOAL], GOAL, True),
        ([START, GOAL + at(9e-7, 0.0)], GOAL, True),
        ([START, GOAL + at(2e-6, 0.0)], GOAL, False),
        ([START + 0.1, GOAL], GOAL, False),
        ([START], GOAL, False),
        ([START, at(3.0, 0.0), GOAL], GOAL, False),
        ([START, THROUGH / 2 - at(0.8, 0.0), THROUGH], THROUGH, False),
    ],
)
def test_a_path_is_a_success_that_meets_both_ends_and_no_obstacle_by_a_finer_check(path, goal, success):
    # The planner's own resolution is coarse where the obstacle lies between two states.
    settings = replace(SETTINGS, resolution_rad=3.0 if goal is THROUGH else 0.05)
    found = planned_by(result(path), settings=settings, goal=goal)[0].learned
    assert (found.success, found.reason == "solved") == (success, success)
    assert (found.length_rad is None) is not success


def test_both_runs_share_problem_and_seed_and_only_one_gets_samples():
    measured, calls = planned_by(result([START, GOAL]))
    assert [call[1].seed for call in calls] == [77, 77]
    assert calls[0][2] is None
    assert calls[1][2].shape == (300, 2)
    assert measured.uniform.success
    assert measured.learned.success
    assert measured.index == 3


def test_an_unsolved_run_keeps_the_planner_s_reason():
    measured, _ = planned_by(result([], solved=False, reason="iteration limit"))
    assert not measured.uniform.success
    assert measured.uniform.reason == "iteration limit"


def test_failures_are_counted_and_rank_last(rng):
    trials = [
        trial(outcome(iterations=100), outcome(iterations=20)),
        trial(outcome(iterations=300), outcome(iterations=40)),
        trial(outcome(success=False, iterations=5), outcome(iterations=60)),
    ]
    summary = summarise_family(Family.UNIFORM, trials, rng)
    assert summary.uniform.success.estimate == pytest.approx(2 / 3)
    assert summary.learned.success.low == pytest.approx(0.025 ** (1 / 3))
    assert summary.uniform.iterations.median == 300
    assert summary.uniform.iterations.censored == 1
    assert summary.uniform.iterations.p90_is_bound
    assert summary.iterations_ratio.estimate == pytest.approx(300 / 40)


def test_lengths_are_compared_only_where_both_succeeded(rng):
    trials = [
        trial(outcome(length_rad=4.0), outcome(length_rad=3.0)),
        trial(outcome(success=False), outcome(length_rad=9.0)),
    ]
    ratio = summarise_family(Family.UNIFORM, trials, rng).length_ratio
    assert ratio.estimate == pytest.approx(0.75)
    assert ratio.count == 1


def test_no_common_success_leaves_no_length_ratio(rng):
    trials = [trial(outcome(success=False), outcome())]
    assert summarise_family(Family.UNIFORM, trials, rng).length_ratio is None


def test_a_family_without_trials_is_an_error(rng):
    with pytest.raises(EvaluationError, match="narrow"):
        summarise_family(Family.NARROW, [trial(outcome(), outcome())], rng)


def test_the_success_rate_is_of_the_learned_samples():
    trials = [trial(outcome(success=False), outcome()), trial(outcome(), outcome(success=False))]
    assert success_rate(trials).estimate == 0.5
    assert success_rate(trials[:1]).estimate == 1.0


def scored(threshold):
    """Uniform samples of which those with a negative first joint pass."""
    return ScoredUniformSampler(TWO_LINK.space, lambda q: q[:, 0] < 0.0, threshold)


def test_a_validity_head_adds_a_run_with_as_many_samples_that_pass_it():
    found, calls = planned_by(result([START, GOAL]), sampler=scored(0.5))
    assert found.confident.success
    uniform, learned, confident = (call[2] for call in calls)
    assert uniform is None
    assert learned.shape == confident.shape == (300, 2)
    assert (learned[:, 0] > 0.0).any()
    assert (confident[:, 0] < 0.0).all()
    # Where too few pass there is none.
    assert planned_by(result([START, GOAL]), sampler=scored(2.0))[0].confident is None


def test_the_filter_s_factor_is_below_one_where_it_costs_work():
    trials = [
        replace(trial(outcome(), outcome(iterations=10), index=i), confident=outcome(iterations=40))
        for i in range(5)
    ]
    found = summarise_family(Family.UNIFORM, trials, np.random.default_rng(0))
    assert found.filter_ratio.estimate == pytest.approx(0.25)
    assert found.confident.iterations.median == 40
    names = [row[1] for row in planning_table([found])]
    assert names == ["samples", "uniform", "learned", "confident", "saved factor", "filter factor"]


def test_without_a_head_there_is_no_filter_to_judge():
    found = summarise_family(Family.UNIFORM, [trial(outcome(), outcome())], np.random.default_rng(0))
    assert (found.confident, found.filter_ratio) == (None, None)
    assert [row[1] for row in planning_table([found])] == ["samples", "uniform", "learned", "saved factor"]
