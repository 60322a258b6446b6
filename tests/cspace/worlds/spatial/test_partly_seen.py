"""Problems that are seen in part, and what planners may take the rest to be."""

from dataclasses import replace

import numpy as np
import pytest

from cspace.simulator import ProblemRequest, Split, UnseenPolicy
from cspace.worlds import checker_of, examples, partly_seen, picture_file_of, simulator_of
from cspace.worlds.spatial.benchmark import level_face
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.visibility import lookup

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


def test_what_the_goal_grasps_is_carried_there_and_the_table_is_known(problem):
    held = SETS.problem(replace(REQUEST, held=True), "motionbench_table_pick", 1, 2)
    scene, before = held.scenario, problem.scenario.obstacles
    assert set(SETS.grasping) < set(SETS.sources["MotionBenchMaker"])
    (can,), (table,) = scene.known.attached, scene.known.scene
    (gone,) = [one for one in before.cylinders if one not in scene.obstacles.cylinders]
    assert (can.cylinder.radius_m, can.cylinder.length_m) == (gone.radius_m, 2.0 * gone.half_length_m)
    tool = problem.scenario.world.body.tool_frames(problem.goal[None])[0]
    np.testing.assert_allclose(tool @ can.matrix, gone.pose, atol=1e-6)
    assert table.box.size_m == tuple(2.0 * half for half in max(before.boxes, key=level_face).half_m)
    np.testing.assert_array_equal([held.start, held.goal], [problem.start, problem.goal])
    # The can touches what the empty hand does not, in truth as for every planner.
    rows = held.space.sample_uniform(np.random.default_rng(0), 2000)
    image = scene.world.read_picture(picture_file_of(scene))
    empty = CollisionChecker(scene.world.body, scene.obstacles).valid_batch(rows)
    full = checker_of(scene).valid_batch(rows)
    np.testing.assert_array_equal(full, SETS.checkers(held, image, UnseenPolicy.KNOWN)[0].valid_batch(rows))
    assert (full <= empty).all()
    assert (empty & ~full).sum() > 10
    assert SETS.mesh_checker(held) is None
    # The request knows of both, and sees the can as a part of the arm.
    read = scene.world.examine_picture(picture_file_of(scene))
    assert [one.name for one in read.known.known.attached] == [can.name]
    assert not read.known.free(rows[empty & ~full]).all()
    assert read.known.free(rows[full]).all()
    view = replace(scene, state=tuple(held.goal), noise=None).view()
    top = (tool @ can.matrix @ (0.0, 0.0, 0.05, 1.0))[:3]
    with_it, without = (
        lookup(image, scene.world.sensor.grid, top[None]).distance_m[0]
        for image in (scene.world.examined(view).known.seen, scene.world.observed(view))
    )
    assert without < 0.05 < with_it
