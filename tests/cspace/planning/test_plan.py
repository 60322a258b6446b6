"""Plans by bundles: which confidence decides, what is refused, what is reported."""

import time
from dataclasses import replace

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.bundle.spec import fitted_plan
from cspace.errors import InputError
from cspace.plan import Seen, plan
from cspace.planning.cost import calibration_error, given_free, score
from cspace.planning.search import find_paths
from cspace.query import PlanQuery
from cspace.simulator import Split
from cspace.worlds import examples, seen_checkers, simulator_of

WORLD = examples()["two-link"]
STEP = 0.1


@pytest.fixture(scope="module")
def bundle(tiny_bundle):
    return Bundle.load(tiny_bundle)


@pytest.fixture(scope="module")
def scene():
    simulator = simulator_of(WORLD)
    problem = simulator.problem("uniform", Split.VALIDATION, 0, 0)
    return simulator.render(problem.scenario), problem


def query_of(problem, **fields):
    return PlanQuery(tuple(problem.start), tuple(problem.goal), time_limit_s=60.0, **fields)


def confidence(bundle, picture, path):
    """Of a path whose start is known to be free."""
    predict = given_free(lambda rows: bundle.predict(picture, rows), WORLD.space, path[:1])
    (found,) = score([path], WORLD.space, 0.15, predict)
    return found.whole


def test_a_plan_is_a_way_from_start_to_goal_with_what_is_believed_of_it(bundle, scene):
    image, problem = scene
    picture = bundle.prepare(image)
    found = bundle.plan(picture, query_of(problem, seed=3))
    assert found.status == "solved"
    assert np.allclose(found.path[[0, -1]], [problem.start, problem.goal], atol=1e-6)
    assert found.edges.shape == (len(found.path) - 1,)
    assert found.unseen is None
    assert found.found == 4
    assert found.confidence == confidence(bundle, picture, found.path)
    assert found.edges.min() == pytest.approx(found.least.confidence)
    again = bundle.plan(picture, query_of(problem, seed=3))
    assert np.array_equal(again.path, found.path)


@pytest.mark.parametrize("ways", [1, 8])
def test_a_plan_is_at_least_as_sure_as_the_surest_way_that_was_found(bundle, scene, ways):
    image, problem = scene
    picture = bundle.prepare(image)
    ends = np.array([problem.start, problem.goal])
    found = find_paths(seen_checkers(WORLD, image, ends), *ends, ways, 0, time.thread_time() + 60.0)
    assert len(found.paths) == ways
    surest = max(confidence(bundle, picture, path) for path in found.paths)
    assert bundle.plan(picture, query_of(problem, ways=ways)).confidence >= surest


def test_a_start_counts_as_free_and_so_does_a_goal_that_is_known_to_be(scene):
    image, problem = scene
    ends = np.array([problem.start, problem.goal])

    def predict(rows):
        """Doubt about both ends alone."""
        near = WORLD.space.distance(ends[:, None], rows[None]).min(axis=0) < 0.4
        return np.where(near, 0.5, 1.0).astype(np.float32), None

    found = plan(Seen(WORLD, image, predict), ends, query_of(problem))
    assert found.least.along > 0.5
    known = plan(Seen(WORLD, image, predict), ends, query_of(problem, goal_free=True))
    assert found.confidence < known.confidence < 1.0


def test_a_path_below_the_minimum_confidence_is_refused_with_its_confidence(bundle, scene):
    image, problem = scene
    picture = bundle.prepare(image)
    sure = bundle.plan(picture, query_of(problem)).confidence
    assert 0.0 < sure < 1.0
    refused = bundle.plan(picture, query_of(problem, min_confidence=min(1.0, sure + 1e-3)))
    assert (refused.status, refused.path.shape, refused.confidence) == ("refused", (0, 2), sure)
    assert 0.0 <= refused.least.along <= 1.0
    assert bundle.plan(picture, query_of(problem, min_confidence=sure)).status == "solved"


def test_a_refused_plan_names_its_goal_where_that_is_expected_to_touch_something(scene):
    image, problem = scene
    ends = np.array([problem.start, problem.goal])

    def predict(rows):
        return np.where(WORLD.space.distance(ends[1], rows) < 0.2, 0.3, 1.0).astype(np.float32), None

    seen = Seen(WORLD, image, predict)
    found = plan(seen, ends, query_of(problem, min_confidence=0.9))
    assert found.reason == "the goal is expected to touch something, with a confidence of 0.30"
    assert plan(seen, ends, query_of(problem, min_confidence=0.9, goal_free=True)).reason is None
    assert plan(seen, ends, query_of(problem)).reason is None


def test_what_does_not_fit_the_robot_is_refused(bundle, scene):
    image, _ = scene
    picture = bundle.prepare(image)
    with pytest.raises(InputError, match="goal"):
        bundle.plan(picture, PlanQuery((0.0, 0.0), (0.0, 0.0, 0.0)))


def test_the_cost_of_a_path_is_its_mean_times_its_length_and_its_largest():
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])

    def predict(rows):
        return np.where(abs(rows[:, 1] - 1.0) < 0.06, 0.5, 1.0).astype(np.float32), None

    (one,) = score([path], WORLD.space, STEP, predict)
    assert one.cost == pytest.approx(one.costs.mean() * 3.0 + np.log(2.0))
    assert one.costs.mean() > 0.0


def test_the_cost_of_a_path_does_not_depend_on_the_step():
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])

    def predict(rows):
        return (1.0 - 0.2 * np.abs(np.sin(rows[:, 0] + rows[:, 1]))).astype(np.float32), None

    costs = [score([path], WORLD.space, step, predict)[0].cost for step in (0.3, 0.1, 0.01)]
    assert costs[0] == pytest.approx(costs[2], rel=0.1)
    assert costs[1] == pytest.approx(costs[2], rel=0.04)


def test_each_piece_has_its_least_and_its_largest_with_its_corners():
    path = np.array([[0.0, 0.0], [0.2, 0.0], [0.2, 0.2]])

    def predict(rows):
        return (1.0 - rows.sum(axis=1)).astype(np.float32), rows.sum(axis=1).astype(np.float32)

    (one,) = score([path], WORLD.space, STEP, predict)
    assert one.of_pieces(one.confidence, np.minimum).tolist() == pytest.approx([0.8, 0.6])
    assert one.of_pieces(one.unseen, np.maximum).tolist() == pytest.approx([0.2, 0.4])
    assert one.of_pieces(one.confidence, np.maximum).tolist() == pytest.approx([1.0, 0.8])
    assert one.length_rad == pytest.approx(0.4)
    assert score([], WORLD.space, STEP, predict) == []


def test_where_nobody_says_how_sure_a_plan_has_to_be_calibrated_bundles_ask_for_some(bundle, scene):
    image, problem = scene
    query = query_of(problem)
    assert fitted_plan(bundle.spec, query).min_confidence == 0.0
    calibrated = replace(bundle.spec, plan_calibration=((0.0, 1.0),))
    assert fitted_plan(calibrated, query).min_confidence == 0.2
    for least in (0.0, 0.9):
        assert fitted_plan(calibrated, replace(query, min_confidence=least)).min_confidence == least
    assert bundle.plan(bundle.prepare(image), query).status == "solved"


def test_the_calibration_error_is_the_distance_of_confidence_and_truth():
    sure = np.array([0.05, 0.05, 0.95, 0.95])
    assert calibration_error(sure, np.array([False, False, True, True])) == pytest.approx(0.05)
    assert calibration_error(sure, np.array([True, True, False, False])) == pytest.approx(0.95)
