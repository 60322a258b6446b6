import numpy as np
import pytest

from services.evaluator.benchmark.arms import pick, table
from services.evaluator.benchmark.figures import cost_at
from services.evaluator.benchmark.results import best_known, converge, until_close
from services.evaluator.benchmark.summary import PairedRuns

UNIFORM, LEARNED, OTHER = "RRT*, uniform, optimising", "RRT*, way, 70 %, optimising", "RRT, uniform"


@pytest.fixture
def paired(make_run):
    """Two problems: uniform is close after 400 iterations in the first and never in the second."""

    def star(arm, problem, lengths, iterations):
        return make_run(
            arm=arm, problem=problem, planner="RRTstar", stop_at_first=False, iterations=1000,
            length_rad=lengths[-1], first_length_rad=lengths[0], cost_length_rad=lengths,
            cost_iterations=iterations, cost_edge_checks=iterations,
            cost_s=tuple(count * 1e-3 for count in iterations),
        )  # fmt: skip

    return PairedRuns(
        [
            star(UNIFORM, 0, (6.0, 4.3, 4.1), (50, 200, 400)),
            star(UNIFORM, 1, (6.0, 3.2), (50, 200)),
            star(LEARNED, 0, (4.5, 4.15), (20, 40)),
            star(LEARNED, 1, (3.1,), (30,)),
            make_run(arm=OTHER, length_rad=5.0),
            make_run(arm=OTHER, problem=1, length_rad=3.0),
        ]
    )


def test_the_best_known_is_over_all_arms(paired):
    assert best_known(paired) == pytest.approx([4.1, 3.0])


def test_close_is_within_five_per_cent_and_may_never_come(paired):
    best = best_known(paired)
    # 1.05 x 4.1 = 4.305: the second of the three. 1.05 x 3 = 3.15: none of uniform's.
    assert until_close(paired, UNIFORM, best)["iterations"].ravel().tolist() == [200.0, np.inf]
    found = until_close(paired, LEARNED, best)
    assert found["iterations"].ravel().tolist() == [40.0, 30.0]
    assert found["s"].ravel() == pytest.approx([0.04, 0.03])


def test_ratios_are_to_plain_rrt_star_with_what_never_came_last(paired, rng):
    arms = pick(table(["way"], 1.0), [UNIFORM, LEARNED])
    uniform, learned = converge(paired, arms, rng)
    assert (uniform.close.estimate, learned.close.estimate) == (0.5, 1.0)
    assert uniform.iteration_ratios is None
    assert uniform.iterations.median_is_bound
    # What ended after 1000 iterations ranks as 1000: (40 + 30) / 2 over (200 + 1000) / 2.
    assert learned.iteration_ratios.median.estimate == pytest.approx(35.0 / 600.0)
    assert learned.first_length.estimate == pytest.approx((4.5 + 3.1) / 12.0)
    assert learned.final_excess == pytest.approx((4.15 / 4.1 + 3.1 / 3.0) / 2.0)


def test_the_length_at_a_time_is_the_last_before_it():
    series = [(np.array([2.0, 5.0]), np.array([1.5, 1.1])), (np.array([4.0]), np.array([1.2]))]
    found = cost_at(series, np.array([1.0, 2.0, 4.5, 9.0]))
    assert found.tolist() == [[np.inf, 1.5, 1.5, 1.1], [np.inf, np.inf, 1.2, 1.2]]
