"""Checks of a serial arm among obstacles, held against distances that are computed apart."""

import numpy as np
import pytest

from cspace.simulator import Split
from cspace.worlds.spatial.arm import Joint, Part, SerialArm
from cspace.worlds.spatial.bodies import clearance_m
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.furniture import SpatialScenes
from cspace.worlds.spatial.obstacles import Box, Obstacles
from cspace.worlds.spatial.poses import make_pose, pose_of
from cspace.worlds.spatial.scenes import draw_layout
from tests.cspace.worlds.spatial.test_robots import PANDA, READY

RESOLUTION_RAD = 0.05
# One link of 1 m along its own x that turns about z, with a ball at its end.
BATON = SerialArm("baton", (Joint("turn"),), (Part("tip", 1, ((1.0, 0.0, 0.0, 0.1),)),))
WALL = Obstacles((Box(pose_of(make_pose(np.eye(3), (0.0, 1.2, 0.0))), (2.0, 0.15, 1.0)),))


@pytest.fixture(scope="module", params=[0, 1, 5])
def checker(request):
    layout = draw_layout(SpatialScenes(), Split.VALIDATION, 0, request.param)
    return CollisionChecker(PANDA, layout.obstacles)


@pytest.fixture(scope="module")
def configurations():
    return PANDA.space.sample_uniform(np.random.default_rng(3), 400)


def test_clearance_is_the_least_of_obstacles_and_the_arm_itself(checker, configurations):
    moving = PANDA.sphere_links() > 0
    centres, radii = PANDA.sphere_centres_m(configurations)[:, moving], PANDA.spheres_m()[moving, 3]
    apart = clearance_m(checker.obstacles, centres, radii)
    itself = CollisionChecker(PANDA, Obstacles()).clearance(configurations)
    assert np.allclose(checker.clearance(configurations), np.minimum(apart, itself), atol=1e-12)
    assert (itself < apart).any()
    assert (apart < itself).any()


def test_free_is_where_clearance_is_above_zero(checker, configurations):
    free = checker.valid_batch(configurations)
    assert np.array_equal(free, checker.clearance(configurations) > 0.0)
    assert 0.1 < free.mean() < 0.95
    assert [checker.valid(q) for q in configurations[:50]] == free[:50].tolist()


def test_the_base_stands_on_a_table_and_the_arm_does_not_touch_it():
    table = CollisionChecker(
        PANDA, Obstacles.of([Box(pose_of(make_pose(np.eye(3), (0.3, 0.0, -0.02))), (0.8, 0.8, 0.02))])
    )
    waits, below = READY[0], np.array([0.0, 1.7, 0.0, -0.4, 0.0, 2.0, 0.0])
    assert table.valid_batch(np.stack([waits, below])).tolist() == [True, False]
    clear, deep = table.clearance(np.stack([waits, below]))
    assert clear > 0.0 > deep


def test_outside_its_limits_nothing_is_free():
    checker = CollisionChecker(PANDA, Obstacles())
    assert checker.valid(READY[0])
    for joint in range(7):
        # The last joint turns the hand round its own axis, which collides with nothing.
        outside = np.array(READY[0])
        outside[joint] = PANDA.space.upper[joint] + 1e-6
        assert not checker.valid(outside)
    outside[-1] -= 2e-6
    assert checker.valid(outside)


def test_a_way_is_free_where_all_its_states_are(checker, configurations):
    free = configurations[checker.valid_batch(configurations)]
    starts, ends = free[:60], free[60:120]
    shares = np.linspace(0.0, 1.0, 400)[:, None]
    finely = [
        bool(checker.valid_batch(a + shares * (b - a)).all()) for a, b in zip(starts, ends, strict=True)
    ]
    found = checker.edge_batch(starts, ends, 0.01)
    # A collision shorter than a step may be missed by either.
    assert (found == finely).mean() > 0.97
    assert found.any()
    assert not found.all()
    check = checker.edge_test(0.01)
    results = [check(a, b) for a, b in zip(starts, ends, strict=True)]
    assert [free for free, _ in results] == found.tolist()
    steps = np.ceil(np.abs(ends - starts).max(axis=1) / 0.01)
    assert all(looked == count + 2 for (free, looked), count in zip(results, steps, strict=True) if free)


def test_a_circle_is_gone_round_on_its_shorter_side():
    checker = CollisionChecker(BATON, WALL)
    assert checker.valid([0.0])
    assert not checker.valid([np.pi / 2])
    assert checker.edge([-3.0], [3.0], RESOLUTION_RAD)
    assert not checker.edge([0.5], [2.5], RESOLUTION_RAD)
    assert checker.clearance([[0.0]])[0] == pytest.approx(1.05 - 0.1)


def test_trees_meet_across_a_circle_s_seam():
    checker = CollisionChecker(BATON, WALL)
    nodes, parents = np.zeros((2, 100, 1)), np.full((2, 100), -1)
    nodes[0, 0], nodes[1, 0] = 0.4, 2.7
    counts, checks = np.ones(2, dtype=np.int64), np.zeros(2, dtype=np.int64)
    states = BATON.space.sample_uniform(np.random.default_rng(0), 50)
    done, _, first, second = checker.grow_trees(
        nodes, parents, counts, checks, states, 0, 0.5, RESOLUTION_RAD
    )
    assert 0 < done <= 50
    assert first >= 0
    assert second >= 0
    assert nodes[0, first] == pytest.approx(nodes[1, second])
    assert checks[1] > checks[0] > 0
    for side in (0, 1):
        grown, parent = nodes[side, 1 : counts[side]], parents[side, 1 : counts[side]]
        assert checker.edge_batch(nodes[side][parent], grown, RESOLUTION_RAD).all()
