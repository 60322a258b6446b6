"""A path that the independent check rejects: the search begins again, finer, and both searches count."""

import numpy as np
import pytest

from cspace.simulator import Split
from cspace.worlds.planar.problems import Family, draw_problem
from services.planner import result
from services.planner.ompl_planner import solve
from services.planner.result import Reason
from services.planner.settings import PRM, RRT, SAMPLED_CONNECT, PlannerSettings

SETTINGS = PlannerSettings(max_iterations=2000, seed=1)
SAMPLES = np.random.default_rng(0).uniform(-np.pi, np.pi, (300, 2))


@pytest.mark.slow
@pytest.mark.parametrize("planner", [RRT, SAMPLED_CONNECT, PRM])
def test_a_path_that_the_check_rejects_is_searched_anew_at_the_checks_resolution(planner):
    settings = PlannerSettings(planner=planner, resolution_rad=2.0, range_rad=2.0, max_iterations=20_000)
    again = []
    for index in range(6):
        problem = draw_problem(Family.NARROW, Split.DEMO, 31, index)
        result = solve(problem, settings, SAMPLES)
        assert result.solved or result.reason == Reason.REJECTED
        if result.resolution_rad < settings.resolution_rad:
            assert result.resolution_rad == pytest.approx(0.2)
            assert result.learned_drawn + result.uniform_drawn <= result.iterations
            again.append(result.solved)
    # So coarse a check of motions lets paths through walls; the finer one hardly any.
    assert len(again) >= 1
    assert any(again)


def test_what_the_first_search_took_counts_as_well(monkeypatch):
    problem = draw_problem(Family.UNIFORM, Split.DEMO, 31, 0)
    single = solve(problem, SETTINGS)
    verdicts = iter([Reason.REJECTED, Reason.SOLVED])
    monkeypatch.setattr(result, "check_path", lambda *_: next(verdicts))
    both = solve(problem, SETTINGS)
    assert both.solved
    assert both.iterations > single.iterations
    assert both.edge_checks > single.edge_checks
    assert both.state_checks > 5 * single.state_checks
