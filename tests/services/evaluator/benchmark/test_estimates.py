"""Estimates of runs whose figures are known."""

import math

import numpy as np
import pytest

from cspace.errors import EvaluationError
from services.evaluator.benchmark.job import NO_PROBLEM
from services.evaluator.benchmark.report import break_even_us, confidence_curve, ratios
from services.evaluator.benchmark.variants import Protocol

UNIFORM, LEARNED = "RRT, uniform", "RRT, model, 70 %"
MODEL, FREE, KNOWN = "model", "unseen is free", "truth everywhere"
GROUP = "MotionBenchMaker, 1"
MS = 1e-3


def found(results, variant, group="narrow"):
    own = results.summary[(results.summary["family"] == group) & (results.summary["variant"] == variant)]
    return own.set_index("measure")["value"].to_dict()


@pytest.mark.parametrize(
    ("values", "base", "expected"),
    [
        ([2.0, 20.0, 100.0], [10.0, 100.0, 500.0], 0.2),
        # A failure counts as the largest value of both: the median of 400, 100, 100 over 400.
        ([np.inf, 100.0, 100.0], [400.0, 400.0, 400.0], 0.25),
        ([np.inf, np.inf, 100.0], [400.0, 400.0, 400.0], 1.0),
        # What takes no iteration counts as one.
        ([0.0, 0.0], [2.0, 2.0], 0.5),
    ],
)
def test_ratios_are_of_quantiles_over_problems(values, base, expected):
    rng = np.random.default_rng(0)
    estimate = dict(ratios("x", np.array(values), np.array(base), rng))["x_median"]
    assert estimate.estimate == pytest.approx(expected)
    assert estimate.low <= estimate.estimate <= estimate.high


@pytest.mark.parametrize(
    ("learned", "others", "expected"),
    [
        # Learned samples save 150 checks, which have to pay for 9 ms.
        ((10 * MS, 50.0), [(1 * MS, 200.0)], 60.0),
        ((1 * MS, 50.0), [(1 * MS, 200.0)], 0.0),
        ((0.5 * MS, 50.0), [(1 * MS, 50.0)], 0.0),
        ((10 * MS, 200.0), [(1 * MS, 50.0)], math.inf),
        # Of several others, the dearest counts: 9 ms for 30 checks.
        ((10 * MS, 50.0), [(1 * MS, 200.0), (1 * MS, 80.0)], 300.0),
        ((10 * MS, 50.0), [(1 * MS, 200.0), (1 * MS, 40.0)], math.inf),
    ],
)
def test_break_even_by_hand(learned, others, expected):
    assert break_even_us(np.array([learned, *others])) == pytest.approx(expected)


@pytest.fixture
def planar():
    """Three problems: learned samples take a tenth of the work, and uniform ones fail in the last."""
    rows = []
    for problem, count in enumerate((100, 200, 2000)):
        work = {"problem": problem, "state_check_s": 1e-6}
        done = problem < 2
        rows += [
            work | {"variant": UNIFORM, "iterations": count, "edge_checks": count, "state_checks": 10 * count,
                    "solved": done, "solve_s": 3e-5 * count, "length_rad": 4.0 if done else None},
            work | {"variant": LEARNED, "iterations": count // 10, "edge_checks": count // 10,
                    "state_checks": count, "solve_s": 3e-6 * count, "request_s": 0.02, "length_rad": 3.0},
        ]  # fmt: skip
    return rows


def test_success_work_and_what_pays(planar, results_of):
    results = results_of(planar)
    uniform, learned = found(results, UNIFORM), found(results, LEARNED)
    assert (uniform["solved"], learned["solved"]) == (pytest.approx(2 / 3), 1.0)
    assert (uniform["iterations_median"], uniform["iterations_p90"]) == (200.0, math.inf)
    # The failure counts as 200, the largest number of both: 20 of 200.
    assert learned["iterations_ratio_median"] == pytest.approx(20 / 200)
    assert learned["length_ratio"] == pytest.approx(0.75)
    # 60 ms of requests and 6.9 ms - 2.3 ms of planning against 69 ms - 23 ms; 230 checks against 2300.
    costs_us = 1e6 * (0.0646 - 0.046)
    assert learned["break_even_edge_base_from_us"] == pytest.approx(costs_us / (2300 - 230))
    assert learned["break_even_state_base_from_us"] == pytest.approx(costs_us / (23000 - 2300))
    assert not [name for name in uniform if name.startswith("break_even")]
    assert results.metrics()["narrow/RRT_model_70/iterations_ratio_median"] == pytest.approx(0.1)
    assert "narrow/RRT_uniform/iterations_p90" not in results.metrics()
    assert "| RRT, model, 70 % |" in results.markdown([])


def test_problems_are_those_that_all_variants_have_run(planar, results_of):
    assert found(results_of(planar[:-1]), LEARNED)["iterations_p90"] == 20.0
    with pytest.raises(EvaluationError, match="all variants"):
        results_of([planar[0], planar[3]]).note()


def planned(variant, problem, clearance_m, **values):
    solved = clearance_m is not None
    status = "solved" if solved else "refused"
    return {
        "variant": variant, "problem": problem, "pictures": 0 if variant == KNOWN else 1, "status": status,
        "solved": solved, "clearance_m": clearance_m, "search_s": 0.1, "request_s": 0.2,
        "family": "motionbench_table_pick",
    } | values  # fmt: skip


@pytest.fixture
def four(results_of):
    """Four problems: the model's paths by confidence free, free, 5 mm deep, and none."""
    sure = {0: (0.9, 0.01), 1: (0.8, 0.02), 2: (0.2, -0.005)}
    rows = [planned(MODEL, at, depth, confidence=value) for at, (value, depth) in sure.items()]
    rows += [planned(FREE, at, -0.02, meshes_free=at > 0) for at in range(3)]
    rows += [planned(MODEL, 3, None), planned(FREE, 3, 0.03, meshes_free=True)]
    rows += [planned(KNOWN, at, 0.01) for at in range(4)]
    rows += [planned(one, 4, None, status=NO_PROBLEM) for one in (MODEL, FREE, KNOWN)]
    return results_of(rows, Protocol.PLANS)


def test_plans_collide_by_paths_and_are_compared_where_both_solve(four):
    model, free = found(four, MODEL, GROUP), found(four, FREE, GROUP)
    assert (model["solved"], model["refused"]) == (0.75, 0.25)
    assert (model["collide"], free["collide"]) == (pytest.approx(1 / 3), 0.75)
    assert (free["meshes"], "meshes" in model) == (0.25, False)
    assert model["more"] == pytest.approx(1 / 3 - 1.0)
    assert found(four, KNOWN, GROUP)["more"] == -0.75
    # 0.1, 0.2 and 0.2 away from the truth.
    assert model["calibration_error"] == pytest.approx(0.5 / 3)
    assert set(four.groups) == {GROUP, "motionbench_table_pick, 1"}
    curve = confidence_curve(four.runs[four.runs["variant"] == MODEL])
    np.testing.assert_allclose(curve["collide"], [0.0, 0.0, 1 / 3])
    assert "1 problems are left out" in four.markdown([])
