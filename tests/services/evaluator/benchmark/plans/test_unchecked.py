"""The first table, on runs whose numbers are known."""

import numpy as np
import pytest

from cspace.worlds.unseen import Taken
from services.evaluator.benchmark.plans.report import plans_table, sureness_table
from services.evaluator.benchmark.plans.setting import NO_PROBLEM
from services.evaluator.benchmark.plans.summary import Plans, gather_plans

FREE, KNOWN = Taken.FREE.value, Taken.KNOWN.value
RNG = np.random.default_rng(0)


@pytest.fixture
def four(make_plan):
    """Four problems: the model's ways by confidence free, free, 5 mm deep, and none."""
    sure = {0: (0.9, 0.01), 1: (0.8, 0.02), 2: (0.2, -0.005)}
    model = [make_plan("model", at, depth, confidence=value) for at, (value, depth) in sure.items()]
    free = [make_plan(FREE, at, -0.02, unseen=0.4 + 0.2 * at) for at in range(3)]
    known = [make_plan(KNOWN, at, 0.01) for at in range(4)]
    return [*model, make_plan("model", 3, None), *free, make_plan(FREE, 3, 0.03, unseen=0.995), *known]


def by_arm(runs):
    return {one.arm: one for one in Plans(runs, "sets", 1).summaries(RNG)}


def test_shares_are_of_problems_and_of_ways(four):
    found = by_arm(four)
    assert list(found) == ["model", FREE, KNOWN]
    model, free = found["model"], found[FREE]
    assert (model.solved.estimate, model.refused.estimate) == (0.75, 0.25)
    assert (model.collide.estimate, model.collide.count) == (pytest.approx(1 / 3), 3)
    assert model.deep.estimate == 0.0
    assert (free.collide.estimate, free.deep.estimate) == (0.75, 0.75)
    assert model.search_ms == pytest.approx((100.0, 100.0))


def test_the_difference_to_unseen_free_is_over_problems_that_both_solve(four):
    found = by_arm(four)
    assert found["model"].more.estimate == pytest.approx(1 / 3 - 1.0)
    assert found["model"].more.count == 3
    assert found[KNOWN].more.estimate == -0.75
    assert found[FREE].more is None


def test_meshes_that_nobody_asked_are_told_as_not_looked_at(four, make_plan):
    (row,) = [row for row in plans_table(list(by_arm(four).values()))[1:] if row[0] == "model"]
    assert row[5] == "not looked at"
    looked = [make_plan(FREE, at, 0.01, meshes_free=at > 0) for at in range(4)]
    assert by_arm(looked)[FREE].meshes.estimate == 0.25


def test_only_the_surest_ways_are_answers_at_a_higher_confidence(four):
    sure = Plans(four, "sets", 1).sureness("model")
    np.testing.assert_allclose(sure.share, [0.25, 0.5, 0.75])
    np.testing.assert_allclose(sure.collide, [0.0, 0.0, 1 / 3])
    np.testing.assert_allclose(sure.least, [0.9, 0.8, 0.2])
    # 0.1, 0.2 and 0.2 away from what is true.
    assert sure.calibration_error == pytest.approx(0.5 / 3)
    assert (sure.surer_half.estimate, sure.surer_half.count) == (0.0, 1)
    rows = sureness_table([sure])[1:]
    assert rows[1] == ["model", "0.6", "0.50", "0.800", "0.000"]
    assert rows[-1] == ["model", "1.0", "0.75", "0.200", "0.333"]


def test_problems_are_those_that_all_arms_have_run_and_whose_ends_are_free(four, make_plan):
    bad = [make_plan(arm, 4, None, status=NO_PROBLEM) for arm in ("model", FREE, KNOWN)]
    half = [make_plan("model", 5, 0.01, confidence=0.5)]
    plans = Plans([*four, *bad, *half], "sets", 1)
    assert (plans.count, plans.left_out) == (4, 1)
    assert gather_plans([*four, *bad], (1, 2))[0].pictures == 1


def test_ways_are_told_by_family_and_by_what_is_unseen_along_them(four):
    plans = Plans(four, "sets", 1)
    assert plans.by_family()["box"]["model"].count == 3
    bins = plans.by_unseen()
    assert list(bins) == [(0.0, 0.5), (0.5, 0.8), (0.8, 0.95), (0.99, 1.0)]
    assert [one[FREE].count for one in bins.values()] == [1, 1, 1, 1]
    assert [one[FREE].estimate for one in bins.values()] == [1.0, 1.0, 1.0, 0.0]
    assert all(one[KNOWN] is None for one in bins.values())


def test_without_ways_nothing_is_said_of_confidence(make_plan):
    plans = Plans([make_plan("model", 0, None), make_plan(FREE, 0, None)], "sets", 1)
    assert plans.sureness("model") is None
    assert plans.by_unseen() == {}
    assert plans.summaries(RNG)[0].collide is None
