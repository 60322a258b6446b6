"""Problems that are seen in part, and what planners may take the rest to be."""

import numpy as np
import pytest

from cspace.simulator import ProblemRequest, Split, UnseenPolicy
from cspace.worlds import examples, partly_seen, simulator_of

REQUEST = ProblemRequest(Split.VALIDATION)
SETS = partly_seen(examples()["panda"])


@pytest.fixture(scope="module")
def problem():
    return SETS.problem(REQUEST, "motionbench_table_pick", 1, 2)


def test_two_cameras_stand_on_either_side_and_draws_are_the_same_again(problem):
    scene = problem.scenario
    focus = np.array(scene.regions[0].box.pose)[:2, 3]
    places = [np.array(camera.pose)[:2, 3] - focus for camera in scene.cameras]
    sides = [np.sign(x * focus[1] - y * focus[0]) for x, y in places]
    assert sorted(sides) == [-1.0, 1.0]
    again = SETS.problem(REQUEST, "motionbench_table_pick", 1, 2)
    assert again.scenario.cameras == scene.cameras
    assert SETS.problem(REQUEST, "motionbench_table_pick", 1, 1).scenario.cameras != scene.cameras[:1]


def test_what_is_taken_for_occupied_collides_and_what_is_true_is_kept_to(problem):
    image = simulator_of(problem.scenario.world).render(problem.scenario)
    rng = np.random.default_rng(0)
    rows = problem.space.sample_uniform(rng, 300)
    free = {taken: SETS.checkers(problem, image, taken)[-1].valid_batch(rows) for taken in UnseenPolicy}
    assert (
        free[UnseenPolicy.OCCUPIED].sum() <= free[UnseenPolicy.CLEARED].sum() < free[UnseenPolicy.FREE].sum()
    )
    np.testing.assert_array_equal(free[UnseenPolicy.TRUE], free[UnseenPolicy.FREE] & free[UnseenPolicy.KNOWN])
    ends = np.array([problem.start, problem.goal])
    occupied, cleared = (
        SETS.checkers(problem, image, taken)[-1].valid_batch(ends)
        for taken in (UnseenPolicy.OCCUPIED, UnseenPolicy.CLEARED)
    )
    assert occupied.tolist() == [True, False]
    assert cleared.all()


def test_meshes_judge_where_they_are_installed(problem):
    pytest.importorskip("pinocchio", reason="the extra spatial")
    assert SETS.mesh_checker(problem).valid_batch(np.array([problem.start, problem.goal])).all()
