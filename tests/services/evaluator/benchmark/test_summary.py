"""Summaries of runs whose figures are known."""

import math

import numpy as np
import pytest

from cspace.worlds.planar.problems import Family
from services.evaluator.benchmark.arms import Group, Protocol, pick, plain_arm, table
from services.evaluator.benchmark.figures import cost_at
from services.evaluator.benchmark.report import sample_sections
from services.evaluator.benchmark.runs import frame_of
from services.evaluator.benchmark.summary import (
    best_known,
    metrics,
    ratios,
    spent,
    summarise_samples,
    until_close,
)

LEARNED, UNIFORM, SHORT = "RRT, way, 70 %", "RRT, uniform", "RRT, uniform, range 0.5"
STAR, LEARNED_STAR = "RRT*, uniform, optimising", "RRT*, way, 70 %, optimising"
ARMS = table(["way", "other"], 1.0)
BY_NAME = {arm.name: arm for arm in ARMS}
CHECKED = "RRT, way, 70 %, colliding last"


@pytest.fixture
def summarised(setting):
    """The summary of rows of narrow problems: arm, then measure, then estimate."""

    def summarise(rows, *names):
        arms = [BY_NAME[name] for name in names]
        found = summarise_samples(frame_of(rows, Protocol.FAMILIES), [Family.NARROW], arms, setting)
        return found, {
            name: own.set_index("measure")[["value", "low", "high", "count"]]
            for name, own in found.groupby("arm")
        }

    return summarise


def column(*values):
    return np.array(values, dtype=float)[:, None]


def none(values):
    return np.zeros(values.shape, dtype=bool)


def of_ratios(rng, values, failed, base):
    found = dict(ratios("x", values, failed, base, none(base), rng))
    return found["x_median"], found["x_p90"]


def test_ratios_are_of_quantiles_over_all_runs(rng):
    base = column(*range(10, 1010, 10))
    median, p90 = of_ratios(rng, base / 5.0, none(base), base)
    assert (median.estimate, p90.estimate) == (pytest.approx(0.2), pytest.approx(0.2))
    # A problem keeps its pair, so equal ratios leave no uncertainty.
    assert (median.low, median.high) == (pytest.approx(0.2), pytest.approx(0.2))
    assert median.count == 100


def test_a_run_without_success_ranks_behind_all_runs_of_both_arms(rng):
    # Cut off after 5, it counts as 400: the median of 400, 100, 100 is 100 and not 100 of 5, 100, 100.
    values, failed = column(5.0, 100.0, 400.0, 5.0), np.array([[True], [False], [False], [True]])
    base = column(400.0, 400.0, 400.0, 400.0)
    assert of_ratios(rng, values, failed, base)[0].estimate == pytest.approx(1.0)
    assert of_ratios(rng, values, none(values), base)[0].estimate == pytest.approx(52.5 / 400)


def test_several_runs_of_a_problem_are_resampled_together(rng):
    # One problem: resampling problems changes nothing, whatever its runs are.
    values, base = np.array([[1.0, 9.0, 5.0]]), np.array([[10.0, 10.0, 10.0]])
    median, _ = of_ratios(rng, values, none(values), base)
    assert (median.low, median.estimate, median.high) == (0.5, 0.5, 0.5)


def test_a_run_that_draws_nothing_counts_as_one_iteration(rng):
    zero, two = column(0.0, 0.0), column(2.0, 2.0)
    assert of_ratios(rng, zero, none(zero), two)[0].estimate == pytest.approx(0.5)


@pytest.fixture
def rows(make_run):
    """Three problems: learned takes a tenth of uniform's iterations, and range 0.5 three quarters."""
    found = []
    for problem, iterations in enumerate((100, 200, 2000)):
        done = problem < 2
        same = {"problem": problem, "check_s": 1e-5 * iterations, "state_checks": 10 * iterations}
        found += [
            make_run(
                **same, iterations=iterations, edge_checks=iterations, solved=done, solve_s=3e-5 * iterations
            ),
            make_run(
                **{**same, "check_s": 0.0},
                arm=SHORT, range_rad=0.5, iterations=iterations * 3 // 4, edge_checks=iterations * 3 // 4,
            ),
            make_run(
                **{**same, "check_s": 1e-6 * iterations, "state_checks": iterations},
                arm=LEARNED, group="learned", sampler="way", learned_share=0.7, length_rad=3.0,
                iterations=iterations // 10, edge_checks=iterations // 10, first_length_rad=3.0,
                solve_s=3e-6 * iterations, request_s=0.02, total_s=0.02 + 3e-6 * iterations,
            ),
        ]  # fmt: skip
    return found


def test_without_the_checks_request_and_planner_are_left(rows, paired):
    learned = spent(paired(rows), LEARNED)
    assert learned[:, 0] == pytest.approx([0.0202, 0.0204, 0.024])
    assert learned[:, 1] == pytest.approx([10.0, 20.0, 200.0])
    assert spent(paired(rows), LEARNED, "state_checks")[:, 1] == pytest.approx([100.0, 200.0, 2000.0])


def test_a_summary_holds_success_quantiles_ratios_and_what_pays(rows, summarised):
    whole, found = summarised(rows, UNIFORM, SHORT, LEARNED)
    uniform, short, learned = found[UNIFORM], found[SHORT], found[LEARNED]
    assert uniform.loc["solved", "value"] == pytest.approx(2 / 3)
    assert learned.loc["solved"].tolist()[0] == 1.0
    assert uniform.loc["iterations_median", "value"] == 200.0
    assert math.isinf(uniform.loc["iterations_p90", "high"])
    assert "iterations_ratio_median" not in uniform.index
    assert learned.loc["iterations_ratio_median", "value"] == pytest.approx(0.1)
    # The best uniform RRT is the one of range 0.5.
    assert learned.loc["iterations_ratio_own_best_median", "value"] == pytest.approx(20 / 150)
    assert "iterations_ratio_own_best_median" not in short.index
    # Lengths are compared where both have a path.
    assert learned.loc["length_ratio", ["value", "count"]].tolist() == [pytest.approx(0.75), 2]
    assert learned.loc["request_ms_median", "value"] == learned.loc["request_ms_p90", "value"] == 20.0
    # 3 requests of 20 ms and 4.6 ms against 46 ms of planning; 230 checks against 2300.
    costs = 1e6 * (0.0646 - 0.046)
    assert learned.loc["break_even_edge_base_from_us", "value"] == pytest.approx(costs / (2300 - 230))
    assert learned.loc["break_even_state_base_from_us", "value"] == pytest.approx(costs / (23000 - 2300))
    assert not [name for name in uniform.index if name.startswith("break_even")]
    logged = metrics(whole, ["solved", "final_excess"])
    assert logged["narrow/RRT_way_70/solved"] == 1.0
    assert len(logged) == 3


@pytest.fixture
def converging(make_run):
    """Two problems: uniform is close after 400 iterations in the first and never in the second."""

    def star(arm, problem, lengths, iterations):
        return make_run(
            arm=arm, problem=problem, planner="RRTstar", stop_at_first=False, iterations=1000,
            length_rad=lengths[-1], first_length_rad=lengths[0], cost_length_rad=lengths,
            cost_iterations=iterations, cost_edge_checks=iterations,
            cost_s=[count * 1e-3 for count in iterations],
        )  # fmt: skip

    return [
        star(STAR, 0, [6.0, 4.3, 4.1], [50, 200, 400]),
        star(STAR, 1, [6.0, 3.2], [50, 200]),
        star(LEARNED_STAR, 0, [4.5, 4.15], [20, 40]),
        star(LEARNED_STAR, 1, [3.1], [30]),
        make_run(length_rad=5.0),
        make_run(problem=1, length_rad=3.0),
    ]


def test_close_is_within_five_per_cent_of_the_best_of_all_arms_and_may_never_come(converging, paired):
    runs = paired(converging)
    best = best_known(runs)
    assert best == pytest.approx([4.1, 3.0])
    # 1.05 x 4.1 = 4.305: the second of the three. 1.05 x 3 = 3.15: none of uniform's, which ends after 1000.
    found, missed = until_close(runs, STAR, best)
    assert found["iterations"].ravel().tolist() == [200.0, 1000.0]
    assert missed.ravel().tolist() == [False, True]
    found, missed = until_close(runs, LEARNED_STAR, best)
    assert found["iterations"].ravel().tolist() == [40.0, 30.0]
    assert found["ms"].ravel() == pytest.approx([0.04, 0.03])
    assert not missed.any()


def test_optimising_arms_are_compared_with_plain_rrt_star(converging, summarised):
    _, found = summarised(converging, UNIFORM, STAR, LEARNED_STAR)
    uniform, learned = found[STAR], found[LEARNED_STAR]
    assert (uniform.loc["close", "value"], learned.loc["close", "value"]) == (0.5, 1.0)
    assert "close_iterations_ratio_median" not in uniform.index
    assert math.isinf(uniform.loc["close_iterations_median", "high"])
    # What ended after 1000 iterations ranks as 1000: (40 + 30) / 2 over (200 + 1000) / 2.
    assert learned.loc["close_iterations_ratio_median", "value"] == pytest.approx(35.0 / 600.0)
    assert learned.loc["close_ms_median", "value"] == pytest.approx(40.0)
    assert learned.loc["first_length_ratio", "value"] == pytest.approx((4.5 + 3.1) / 12.0)
    assert learned.loc["final_excess", "value"] == pytest.approx((4.15 / 4.1 + 3.1 / 3.0) / 2.0)
    # They have no figures of a first solution.
    assert "solved" not in uniform.index


def test_the_length_at_a_time_is_the_last_before_it():
    series = [(np.array([2.0, 5.0]), np.array([1.5, 1.1])), (np.array([4.0]), np.array([1.2]))]
    found = cost_at(series, np.array([1.0, 2.0, 4.5, 9.0]))
    assert found.tolist() == [[np.inf, 1.5, 1.5, 1.1], [np.inf, np.inf, 1.2, 1.2]]


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        (CHECKED, LEARNED),
        ("RRT, other, 100 %, filtered", "RRT, other, 100 %"),
        ("own RRT-Connect, way, 100 %, ordered, colliding last", "own RRT-Connect, way, 100 %"),
        (LEARNED, None),
        ("RRT, way, schedule in order", None),
    ],
)
def test_the_plain_arm_differs_in_the_treatment_alone(name, plain):
    found = plain_arm(BY_NAME[name], ARMS)
    assert (found.name if found else None) == plain


def test_every_treated_arm_has_a_plain_one_where_that_was_run():
    groups = (Group.FILTERED, Group.ORDERED, Group.CHECKED)
    treated = [arm for arm in ARMS if arm.group in groups and arm.sampler]
    assert all(plain_arm(arm, ARMS) is not None for arm in treated)
    assert plain_arm(BY_NAME[CHECKED], [BY_NAME[CHECKED]]) is None


def test_lost_and_won_runs_are_counted_in_pairs_and_the_interval_is_over_problems(
    make_run, summarised, setting
):
    # Within 1000 iterations: both, only the plain one, only the checked one, and only the checked one again.
    pairs = [(100, 100), (900, 1100), (1500, 800), (None, 1000)]
    names = (LEARNED, CHECKED)
    rows = [
        make_run(arm=arm, problem=problem, iterations=count or 1000, solved=count is not None)
        for problem, pair in enumerate(pairs)
        for arm, count in zip((*names, UNIFORM), (*pair, 100), strict=True)
    ]
    whole, _ = summarised(rows, UNIFORM, *names)
    sections = sample_sections(whole, pick(ARMS, names), setting)
    (treated,) = [rows for heading, _, rows in sections if heading.startswith("Samples filtered")]
    (row,) = treated.to_numpy().tolist()
    assert row[:5] == [CHECKED, LEARNED, "0.7500, 0.5000", "1 of 4", "2"]
    assert row[5].startswith("0.2500 [-0.5000, ")
