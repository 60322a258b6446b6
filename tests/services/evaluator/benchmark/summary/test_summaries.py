import numpy as np
import pytest

from cspace.errors import EvaluationError
from services.evaluator.benchmark.arms import Arm, Group, pick, table
from services.evaluator.benchmark.summary import PairedRuns, length_ratio, ratios, spent, summarise

LEARNED, UNIFORM, SHORT = "RRT, way, 70 %", "RRT, uniform", "RRT, uniform, range 0.5"


def column(*values):
    return np.array(values, dtype=float)[:, None]


def none(values):
    return np.zeros(values.shape, dtype=bool)


def test_ratios_are_of_quantiles_over_all_runs(rng):
    base = column(*range(10, 1010, 10))
    found = ratios(base / 5.0, none(base), base, none(base), rng)
    assert found.median.estimate == pytest.approx(0.2)
    assert found.p90.estimate == pytest.approx(0.2)
    # A problem keeps its pair, so equal ratios leave no doubt.
    assert (found.median.low, found.median.high) == (pytest.approx(0.2), pytest.approx(0.2))
    assert found.median.count == 100


def test_a_run_without_success_ranks_behind_all_runs_of_both_arms(rng):
    # Cut off after 5, it counts as 400: the median of 400, 100, 100 is 100 and not 100 of 5, 100, 100.
    values, failed = column(5.0, 100.0, 400.0, 5.0), np.array([[True], [False], [False], [True]])
    base = column(400.0, 400.0, 400.0, 400.0)
    found = ratios(values, failed, base, none(base), rng)
    assert found.median.estimate == pytest.approx(1.0)
    assert ratios(values, none(values), base, none(base), rng).median.estimate == pytest.approx(52.5 / 400)


def test_several_runs_of_a_problem_are_resampled_together(rng):
    # One problem: resampling problems changes nothing, whatever its runs are.
    values, base = np.array([[1.0, 9.0, 5.0]]), np.array([[10.0, 10.0, 10.0]])
    found = ratios(values, none(values), base, none(base), rng)
    assert (found.median.low, found.median.estimate, found.median.high) == (0.5, 0.5, 0.5)


def test_a_run_that_draws_nothing_counts_as_one_iteration(rng):
    zero, two = column(0.0, 0.0), column(2.0, 2.0)
    assert ratios(zero, none(zero), two, none(two), rng).median.estimate == pytest.approx(0.5)


@pytest.fixture
def paired(make_run):
    """Three problems: learned takes a tenth of uniform's iterations, and range 0.5 three quarters."""
    runs = []
    for problem, iterations in enumerate((100, 200, 2000)):
        done = problem < 2
        same = {"problem": problem, "check_s": 1e-5 * iterations, "state_checks": 10 * iterations}
        runs += [
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
    return PairedRuns(runs)


@pytest.fixture
def arms() -> tuple[Arm, ...]:
    return pick(table(["way"], 1.0), [LEARNED, UNIFORM, SHORT])


def test_what_is_left_without_the_checks_is_request_and_planner(paired):
    learned = spent(paired, LEARNED)
    assert learned.fixed_s == pytest.approx([0.0202, 0.0204, 0.024])
    assert learned.checks == pytest.approx([10.0, 20.0, 200.0])
    assert spent(paired, LEARNED, "state_checks").checks == pytest.approx([100.0, 200.0, 2000.0])


def test_a_summary_holds_success_quantiles_ratios_and_what_pays(paired, arms, rng):
    uniform, short, learned = summarise(paired, arms, rng)
    assert [one.arm.name for one in (uniform, short, learned)] == [UNIFORM, SHORT, LEARNED]
    assert (uniform.solved.estimate, learned.solved.estimate) == (pytest.approx(2 / 3), 1.0)
    assert uniform.iterations.median == 200.0
    assert uniform.iterations.p90_is_bound
    assert uniform.iteration_ratios is None
    assert learned.iteration_ratios.median.estimate == pytest.approx(0.1)
    assert learned.own_best == SHORT
    assert learned.own_best_ratios.median.estimate == pytest.approx(20 / 150)
    assert short.own_best_ratios is None
    assert learned.length_ratio.estimate == pytest.approx(0.75)
    assert learned.parts_ms["request"] == pytest.approx((20.0, 20.0))
    # 3 requests of 20 ms and 4.6 ms against 46 ms of planning; 230 checks against 2300.
    assert learned.worth.edge_base.costs.low_s == pytest.approx((0.0646 - 0.046) / (2300 - 230))
    assert learned.worth.state_base.costs.low_s == pytest.approx((0.0646 - 0.046) / (23000 - 2300))
    assert uniform.worth is None


def test_lengths_are_compared_where_both_have_a_path(paired, rng):
    assert length_ratio(paired, LEARNED, UNIFORM, rng).count == 2


def test_arms_that_go_on_after_their_first_solution_are_told_of_elsewhere(paired, rng):
    arm = Arm(UNIFORM, Group.OPTIMISING, "RRTstar", UNIFORM, stop_at_first=False)
    assert summarise(paired, [arm], rng) == []


def test_runs_that_do_not_pair_are_refused(make_run):
    with pytest.raises(EvaluationError, match="one family"):
        PairedRuns([make_run(), make_run(family="uniform")])
    with pytest.raises(EvaluationError, match="lacks runs"):
        PairedRuns([make_run(), make_run(problem=1), make_run(arm=LEARNED)])
    with pytest.raises(EvaluationError, match="no such arm"):
        PairedRuns([make_run()]).values("another", "iterations")
