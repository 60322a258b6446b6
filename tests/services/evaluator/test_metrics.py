"""Metrics on known answers, and one that a newcomer adds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cspace.space import JointSpace
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator import metrics
from services.evaluator.evaluation import (
    MAX_METRICS,
    Budget,
    Evaluation,
    Setting,
    run_metrics,
    run_unit,
    table_of,
    units,
)
from services.evaluator.metrics import Head, Run, Samples, Task, measured, metric, metrics_of
from services.evaluator.metrics.coverage import covered
from services.evaluator.metrics.energy import energy_distance
from services.evaluator.metrics.knn import inside_manifold
from services.evaluator.report import measure_columns, terminal_table
from tests.fakes.uniform_sampler import UniformSampler

TORUS = JointSpace((-np.pi, -np.pi), (np.pi, np.pi), (True, True))
MIXED = JointSpace((-np.pi, -3.0), (np.pi, 3.0), (True, False))


@pytest.fixture
def toy():
    """One more metric."""
    metrics_of(Task.RECONSTRUCTION)

    @metric("first_joint")
    def first_joint(group: Samples) -> float:
        return float((group.samples[:, 0] > 0.0).mean())

    yield
    del metrics._METRICS[Task.RECONSTRUCTION, "first_joint"]


def test_a_metric_of_ones_own_is_found_in_table_and_mlflow(toy):
    budget = Budget(3, 50, 0, 0, 1, 0, 1)
    setting = Setting(PlanarWorld(), 5, budget)
    sampler = UniformSampler(setting.world.space)
    results = [run_unit(unit, setting, sampler) for unit in units(setting)]
    evaluation = Evaluation(setting, "m/1", table_of(results, "m/1"), 1.0)
    values = evaluation.table[evaluation.table["metric"] == "first_joint"]
    # Two splits, three scenarios; the sampler, uniform and real samples.
    assert len(values) == 18
    assert values["value"].between(0.0, 1.0).all()
    logged = run_metrics(evaluation)
    assert len(logged) <= MAX_METRICS
    estimate = evaluation.estimate("first_joint", "sampler", "uniform")
    assert logged["validation/first_joint"] == estimate.estimate
    assert estimate.low <= estimate.estimate <= estimate.high
    assert "test/first_joint" in logged
    assert "first_joint" in measure_columns(evaluation)["measure"]
    assert "first_joint" in terminal_table(evaluation)


def value(name, given, task=Task.RECONSTRUCTION):
    found = [value for one, _, value in measured(task, given) if one == name]
    return found[0] if len(found) == 1 else found


def estimates(name, values, uniform=None, task=Task.RECONSTRUCTION):
    (one,) = (one for one in metrics_of(task) if one.name == name)
    table = np.array(values, dtype=np.float64).reshape(len(values), -1)
    other = table if uniform is None else np.array(uniform, dtype=np.float64).reshape(len(values), -1)
    return one.estimates(table, other, np.random.default_rng(0))


def test_precision_is_the_free_share_with_gain_low_quantile_and_minimum(rng):
    samples = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [-1.0, 0.0]] * 2)
    group = Samples(samples, TORUS.sample_uniform(rng, 10), TORUS, lambda q: q[:, 0] >= 0, 0.2)
    assert value("precision", group) == 0.75
    found = estimates("precision", [0.5 + i / 20 for i in range(11)], [0.4 + i / 20 for i in range(11)])
    assert found["precision_gain"].low == pytest.approx(0.1)
    assert found["precision_p10"].estimate == pytest.approx(0.55)
    assert found["precision_minimum"].estimate == 0.5


def test_edr_sums_over_scenarios_before_it_divides():
    # An open scenario, where uniform's distance is almost zero, would blow up a mean of ratios.
    assert estimates("energy", [0.1, 0.1], [1.0, 1e-6])["edr"].estimate == pytest.approx(0.2, rel=1e-4)


def test_energy_distance_equals_its_definition_without_self_pairs(rng):
    first, second = TORUS.sample_uniform(rng, 7), TORUS.sample_uniform(rng, 5)
    x, y = TORUS.embed(first), TORUS.embed(second)
    cross = np.mean([[np.linalg.norm(a - b) for b in y] for a in x])
    within = [
        np.mean([np.linalg.norm(a - b) for i, a in enumerate(z) for j, b in enumerate(z) if i != j])
        for z in (x, y)
    ]
    assert energy_distance(first, second, TORUS) == pytest.approx(2 * cross - sum(within))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.sampled_from([TORUS, MIXED]))
def test_coverage_and_manifolds_equal_those_of_the_distance_matrix(seed, k, space):
    rng = np.random.default_rng(seed)
    real, made = space.sample_uniform(rng, 12), 0.6 * space.sample_uniform(rng, 20)
    matrix = space.distance(real[:, None], made[None])
    np.testing.assert_array_equal(covered(real, made, space, 0.7), matrix.min(axis=1) <= 0.7)
    for points, members in ((made, real), (real, made)):
        radii = np.sort(space.distance(members[:, None], members), axis=1)[:, k]
        expected = np.mean((space.distance(points[:, None], members) <= radii).any(axis=1))
        assert inside_manifold(points, members, space, k) == expected


def test_a_head_that_is_right_and_sure_has_no_error_and_only_near_contact_counts_as_near():
    free = np.array([True, False, True, False])
    sure = Head(np.where(free, 1.0, 0.0), free, np.array([0.05, -0.05, 1.0, -1.0]), 0.7, 0.1)
    assert value("accuracy", sure, Task.HEAD) == 1.0
    assert value("acceptance", sure, Task.HEAD) == 0.7
    assert value("near", sure, Task.HEAD) == [2.0, 2.0]
    unsure = Head(
        np.array([0.9, 0.1, 0.9, 0.1]), free[[0, 0, 1, 1]], np.array([0.5, 0.09, -0.09, -0.5]), 1.0, 0.1
    )
    assert value("accuracy", unsure, Task.HEAD) == 0.5
    assert value("near", unsure, Task.HEAD) == [0.0, 2.0]
    assert estimates("near", [[0.0, 0.0]], task=Task.HEAD) == {}


def test_the_calibration_error_is_the_gap_between_confidence_and_share():
    free = np.arange(100) < 60
    bins = [value("calibration", Head(np.full(100, 0.8), free, np.ones(100), 1.0, 0.1), Task.HEAD)]
    found = estimates("calibration", bins, task=Task.HEAD)
    assert found["calibration_error"].estimate == pytest.approx(0.2)


def test_a_failed_run_costs_as_much_as_the_worst_and_ratios_are_paired():
    runs = [Run(solved, cost, 7) for solved, cost in ((True, 100), (True, 300), (False, 5))]
    uniform = [value("iterations", run, Task.PLANNING) for run in runs]
    found = estimates("iterations", [[20, 1], [40, 1], [60, 1]], uniform, Task.PLANNING)
    assert found["iterations_ratio"].estimate == pytest.approx(300 / 40)
    assert found["iterations_median"].estimate == 40
    assert estimates("iterations", uniform, task=Task.PLANNING)["iterations_median"].estimate == 300
    success = estimates("success", [1.0, 1.0, 1.0], task=Task.PLANNING)["success"]
    assert success.low == pytest.approx(0.025 ** (1 / 3))
