"""The second table, on runs whose numbers are known."""

import numpy as np
import pytest

from services.evaluator.benchmark.plans.setting import BASE
from services.evaluator.benchmark.plans.summary import ALL, HARD, Checked, gather_checked

WAYS = "RRT-Connect, ways of model"
RNG = np.random.default_rng(0)


@pytest.fixture
def searches(make_search):
    """Three problems: uniform 100, 200, 1000 states; ways 50, 100, 100 and 10 ms for them."""
    uniform = [make_search(BASE.name, at, states) for at, states in enumerate((100, 200, 1000))]
    ways = [
        make_search(WAYS, at, states, request_s=0.01, as_is=at == 0, length_rad=2.0)
        for at, states in enumerate((50, 100, 100))
    ]
    return [*uniform, *ways]


def summarised(runs):
    return {one.arm: one for one in Checked("box", runs, 1).summaries(RNG)}


def test_states_are_told_by_median_and_p90_and_in_ratios(searches):
    found = summarised(searches)
    assert list(found) == [BASE.name, WAYS]
    ways = found[WAYS]
    assert (ways.counts["state_checks"].median, ways.counts["state_checks"].p90) == (100, 100)
    assert [ratio.estimate for ratio in ways.ratios] == [0.5, 0.1]
    assert ways.as_is == pytest.approx(1 / 3)
    assert ways.length.estimate == 0.5
    assert found[BASE.name].ratios is None


def test_the_price_from_which_on_ways_save_time_is_where_the_lines_cross(searches):
    worth = summarised(searches)[WAYS].worth
    # Half of what a search takes are its checks: 30 ms and 0.25 ms against 1.3 ms, and 1050 states fewer.
    assert worth.costs.low_s == pytest.approx((0.03025 - 0.0013) / 1050)


def test_times_are_told_at_the_prices_of_spheres_and_of_meshes(searches, make_search):
    ways = summarised(searches)[WAYS]
    assert ways.spheres_ms == pytest.approx(10.0 + 0.2)
    assert ways.meshes_ms is None
    dear = [make_search(arm, 0, 100, mesh_check_s=1e-5) for arm in (BASE.name, WAYS)]
    assert summarised(dear)[WAYS].meshes_ms == pytest.approx(0.1 + 1.0)


def test_a_problem_that_is_not_solved_ranks_behind_all_others(make_search):
    uniform = [make_search(BASE.name, at, 100) for at in range(3)]
    ways = [make_search(WAYS, 0, 10, solved=False), *(make_search(WAYS, at, 50) for at in (1, 2))]
    found = summarised([*uniform, *ways])[WAYS]
    assert found.counts["state_checks"].p90_is_bound
    assert found.solved == pytest.approx(2 / 3)
    assert found.ratios[1].estimate == 0.5


def test_of_the_runs_of_a_problem_the_median_counts_and_missing_ones_are_waited_for(make_search):
    runs = [
        make_search(arm, at, states, run=run)
        for arm in (BASE.name, WAYS)
        for at in (0, 1)
        for run, states in enumerate((10, 20, 900))
    ]
    checked = Checked("box", runs, 1)
    assert (checked.count, checked.runs_each) == (2, 3)
    assert checked.summaries(RNG)[0].counts["state_checks"].p90 == 20
    assert Checked("box", runs[:-1], 1).count == 1


def test_groups_are_all_the_hard_ones_and_every_family(searches, make_search):
    others = [make_search(arm, 0, 10, family="table") for arm in (BASE.name, WAYS)]
    found = gather_checked([*searches, *others], (1,), ("box",))
    counts = [(one.name, one.count) for one in found]
    assert counts == [(f"sets, {ALL}", 4), (f"sets, {HARD}", 3), ("box", 3), ("table", 1)]
