"""Free ways: their ends, their steps, their lengths."""

from dataclasses import replace

import numpy as np
import pytest

from cspace.planning.paths import length_rad, spaced
from cspace.planning.rrt_connect import Growth, grow_connect
from cspace.simulator import Split
from cspace.space import circles
from cspace.worlds.spatial.arm import Joint, Part, SerialArm
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.furniture import SpatialScenes, block
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.poses import Frame
from cspace.worlds.spatial.problems import PathLimits, find_path, is_free
from cspace.worlds.spatial.scenes import draw_layout
from tests.cspace.worlds.spatial.test_robots import PANDA, READY

LIMITS = PathLimits(tries=2)
# Two links of 0.5 m in the plane z = 0, of balls.
_LINK = tuple((x, 0.0, 0.0, 0.04) for x in np.linspace(0.0, 0.5, 11))
TWO_LINKS = SerialArm(
    "two_links",
    (Joint("first"), Joint("second", Frame((0.5, 0.0, 0.0)))),
    (Part("upper", 1, _LINK), Part("lower", 2, _LINK)),
)
# A wall at x = 0.6 m; the arm stretches through its door, and turns by 1.8 rad only if it is drawn in before.
DOOR = Obstacles.of(
    [block((0.58, 0.62), (-2.0, -0.25), (-0.5, 0.5)), block((0.58, 0.62), (0.25, 2.0), (-0.5, 0.5))]
)

# Compiling the kernels takes longer than the tests.
pytestmark = pytest.mark.slow
THROUGH, ASIDE = np.zeros(2), np.array([1.8, 0.0])


@pytest.fixture(scope="module", params=[0, 1, 2])
def ends(request):
    """A checker of a scene with two free configurations that the straight way does not join."""
    layout = draw_layout(SpatialScenes(), Split.VALIDATION, 0, request.param)
    checker = CollisionChecker(PANDA, layout.obstacles)
    drawn = PANDA.space.sample_uniform(np.random.default_rng(request.param), 400)
    start = np.asarray(READY[0])
    assert checker.valid(start)
    free = drawn[checker.valid_batch(drawn)]
    joined = checker.edge_batch(np.broadcast_to(start, free.shape).copy(), free, 0.01)
    return checker, start, free[~joined]


def raw_way(checker, start, goal, seed):
    states = checker.space.sample_uniform(np.random.default_rng(seed), LIMITS.states)
    return grow_connect(checker, start, goal, states, Growth(2.0, 0.02)).path


def test_a_way_leads_from_start_to_goal_and_every_step_of_it_is_free(ends):
    checker, start, goals = ends
    for goal in goals[:2]:
        path = find_path(checker, start, goal, np.random.default_rng(0), LIMITS)
        assert path is not None
        assert np.array_equal(path[0], start)
        assert np.array_equal(path[-1], goal)
        assert is_free(checker, path)
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= LIMITS.step_rad + 1e-12
        dense = spaced(path, PANDA.space, 0.01)
        assert checker.valid_batch(dense).all()


def test_shortening_never_lengthens_and_keeps_a_way_free_and_its_ends(ends):
    checker, start, goals = ends
    raw = raw_way(checker, start, goals[0], 1)
    lengths = [length_rad(raw, PANDA.space)]
    for shortcuts in (0, 1, 5, 20, 100):
        short = checker.shortened(raw, np.random.default_rng(2), shortcuts, 0.005)
        assert is_free(checker, short)
        assert np.array_equal(short[[0, -1]], raw[[0, -1]])
        assert (np.linalg.norm(np.diff(short, axis=0), axis=1) > 0.0).all()
        lengths.append(length_rad(short, PANDA.space))
    assert lengths[1] == lengths[0]
    assert (np.diff(lengths) <= 1e-9).all()
    assert lengths[-1] < lengths[0]


def test_the_arm_is_drawn_out_of_a_door():
    checker = CollisionChecker(TWO_LINKS, DOOR)
    assert not checker.edge(THROUGH, ASIDE, 0.01)
    path = find_path(checker, THROUGH, ASIDE, np.random.default_rng(0))
    assert path is not None
    assert np.allclose(path[[0, -1]], [THROUGH, ASIDE])
    assert is_free(checker, path)
    # The elbow bends by half a turn or nearly, to either side, and back.
    assert np.abs(path[:, 1]).max() > 1.0
    assert length_rad(path, circles(2)) < 6.0


def test_without_a_door_no_way_is_found():
    checker = CollisionChecker(TWO_LINKS, Obstacles.of([block((0.58, 0.62), (-0.3, 0.3), (0.03, 0.5))]))
    assert not checker.valid(THROUGH)
    assert find_path(checker, THROUGH, ASIDE, np.random.default_rng(0)) is None
    jamb = [block((0.58, 0.62), (low, low + 0.1), (-0.5, 0.5)) for low in (-0.15, 0.05)]
    shut = CollisionChecker(TWO_LINKS, Obstacles.of(jamb))
    assert shut.valid(THROUGH)
    assert shut.valid(ASIDE)
    assert find_path(shut, THROUGH, ASIDE, np.random.default_rng(0), replace(LIMITS, states=2000)) is None
