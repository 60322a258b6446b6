"""Problems that are seen in part, and what planners may take the rest to be."""

from dataclasses import replace

import numpy as np
import pytest

from cspace.errors import ScenarioError
from cspace.simulator import ProblemRequest, Split, Taken
from cspace.worlds import default_world, examples, partly_seen, picture_of
from cspace.worlds.spatial.benchmark import LIMITS_RAD, middle
from cspace.worlds.spatial.obstacles import Box, Obstacles
from cspace.worlds.spatial.poses import make_pose, pose_of

REQUEST = ProblemRequest(Split.VALIDATION)
SETS = partly_seen(examples()["panda"])


@pytest.fixture(scope="module")
def problem():
    return SETS.problem(REQUEST, "motionbench_table_pick", 1, 2)


def test_worlds_that_are_seen_whole_have_none():
    with pytest.raises(ScenarioError, match="hide nothing"):
        partly_seen(default_world())


def test_the_sets_are_of_the_panda_alone():
    assert list(SETS.sources) == ["MotionBenchMaker", "own families"]
    assert list(partly_seen(examples()["ur5"]).sources) == ["own families"]
    assert SETS.count("motionbench_box", Split.VALIDATION) == 30
    assert SETS.count("motionbench_box", Split.TEST) == 70
    assert SETS.count("shelf", Split.TEST) is None
    assert set(SETS.hard) < set(SETS.sources["MotionBenchMaker"])


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
    image = picture_of(problem.scenario)
    rng = np.random.default_rng(0)
    rows = problem.space.sample_uniform(rng, 300)
    free = {taken: SETS.checkers(problem, image, taken)[-1].valid_batch(rows) for taken in Taken}
    assert free[Taken.OCCUPIED].sum() <= free[Taken.CLEARED].sum() < free[Taken.FREE].sum()
    np.testing.assert_array_equal(free[Taken.TRUE], free[Taken.FREE] & free[Taken.KNOWN])
    ends = np.array([problem.start, problem.goal])
    occupied, cleared = (
        SETS.checkers(problem, image, taken)[-1].valid_batch(ends)
        for taken in (Taken.OCCUPIED, Taken.CLEARED)
    )
    assert occupied.tolist() == [True, False]
    assert cleared.all()


def test_the_share_that_is_unseen_is_less_with_more_pictures(problem):
    rows = problem.space.sample_uniform(np.random.default_rng(0), 50)
    alone = replace(problem.scenario, cameras=problem.scenario.cameras[:1])
    shares = [SETS.unseen(picture_of(scene), rows) for scene in (alone, problem.scenario)]
    assert all(((share >= 0.0) & (share <= 1.0)).all() for share in shares)
    assert shares[1].mean() < shares[0].mean()


def test_meshes_judge_where_they_are_installed(problem):
    pytest.importorskip("pinocchio", reason="the extra spatial")
    assert SETS.mesh_checker(problem).valid_batch(np.array([problem.start, problem.goal])).all()


def test_own_problems_are_drawn_anew_for_another_seed():
    found = [SETS.problem(ProblemRequest(Split.VALIDATION, seed, "scene"), "table", 0, 1) for seed in (0, 1)]
    assert not np.array_equal(found[0].start, found[1].start)


def test_the_middle_is_that_of_the_box_round_everything():
    turned = pose_of(make_pose([[0, -1, 0], [1, 0, 0], [0, 0, 1]], (1.0, 0.0, 0.0)))
    flat = pose_of(make_pose(np.eye(3), (-1.0, 0.0, 2.0)))
    boxes = (Box(turned, (0.5, 0.1, 0.1)), Box(flat, (0.2, 0.2, 0.2)))
    np.testing.assert_allclose(middle(Obstacles(boxes, ())), (-0.05, 0.0, 1.05), atol=1e-9)


def test_the_benchmarks_problems_have_its_limits_and_own_ones_the_makers(problem):
    assert problem.space.upper == tuple(high for _, high in LIMITS_RAD)
    own = SETS.problem(REQUEST, "table", 0, 1)
    assert own.space.upper == examples()["panda"].space.upper == SETS.world.space.upper
    checkers = SETS.checkers(problem, picture_of(problem.scenario), Taken.KNOWN)
    assert {checker.space for checker in checkers} == {problem.space}
