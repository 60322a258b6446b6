"""Plans of an arm in space under constraints: where they end, and what all their states keep."""

from dataclasses import replace

import numpy as np
import pytest

from cspace.bundle import BundleSpec, RandomInput
from cspace.bundle.spec import fitted_problem
from cspace.errors import InputError
from cspace.plan import Seen, plan
from cspace.planning.paths import spaced
from cspace.query import PlanQuery
from cspace.simulator import Split, scenario_rng
from cspace.worlds import checker_of, examples, seen_checkers, simulator_of
from cspace.worlds.spatial.arm import ready_rad
from cspace.worlds.spatial.kinematics import Solving, solve_pose

WORLD = examples()["panda"]
SPEC = BundleSpec(world=WORLD, latent_dim=2, random_inputs=(RandomInput("noise", "normal", (2,)),))
ARM, SPACE = WORLD.body, WORLD.space
START = ready_rad(ARM)
DOWN = {"axis": [0.0, 0.0, 2.0], "up": [0.0, 0.0, -1.0]}
DENSE_RAD = 0.003


def sure(rows):
    return np.full(len(rows), 0.99, np.float32), None


@pytest.fixture(scope="module")
def scene():
    simulator = simulator_of(WORLD)
    return simulator.scene(scenario_rng(Split.DEMO, 4, 0), Split.DEMO, 0)


@pytest.fixture(scope="module")
def picture(scene):
    return simulator_of(WORLD).render(scene)


@pytest.fixture(scope="module")
def downward(scene, picture):
    """Two configurations that are free and seem so, the tool pointing down, a good way apart."""
    rng, found = np.random.default_rng(0), []
    checkers = checker_of(scene), seen_checkers(WORLD, picture, START[None])[0]
    exact = Solving(turn_rad=1e-3)
    for bearing in np.linspace(-1.8, 1.8, 13):
        place = 0.5 * np.cos(bearing), 0.5 * np.sin(bearing), 0.5
        rows = solve_pose(ARM, place, rng, approach=(0, 0, -1), solving=exact)
        for checker in checkers:
            rows = rows[checker.valid_batch(rows)]
        if len(rows):
            found.append(rows[np.argmin(SPACE.distance(START, rows))])
    return SPACE.to_float32(np.stack([found[0], found[-1]])).astype(np.float64)


def planned(picture, start, goal=None, *, world=WORLD, predict=sure, **fields):
    query = PlanQuery(
        tuple(start), None if goal is None else tuple(goal), **{"time_limit_s": 60.0, "seed": 1} | fields
    )
    spec = replace(SPEC, world=world)
    return plan(Seen(world, picture, predict), fitted_problem(spec, query), query)


def turned(configuration, by_rad, joint=0):
    found = np.array(configuration)
    found[joint] += by_rad
    return found


def tilt_rad(states):
    return np.arccos(np.clip(-ARM.tool_frames(states)[:, 2, 2], -1.0, 1.0))


def angle_rad(first, second):
    return np.arccos(np.clip((np.trace(first.T @ second) - 1.0) / 2.0, -1.0, 1.0))


def test_a_path_ends_with_the_tool_in_its_pose(picture, downward):
    there = ARM.tool_frames(downward[1:])[0]
    found = planned(picture, START, goal_pose={"pose": there.tolist()})
    assert found.status == "solved", found.reason
    assert np.allclose(found.path[0], START, atol=1e-6)
    (end,) = ARM.tool_frames(found.path[-1:])
    assert np.linalg.norm(end[:3, 3] - there[:3, 3]) <= 0.005
    assert angle_rad(end[:3, :3], there[:3, :3]) <= 0.05
    free = seen_checkers(WORLD, picture, found.path[:1])[-1]
    assert free.valid_batch(found.path).all()
    again = planned(picture, START, goal_pose={"pose": there.tolist()})
    assert np.array_equal(again.path, found.path)


def test_any_turn_about_the_tools_z_axis_will_do_where_it_is_free(picture, downward):
    there = ARM.tool_frames(downward[:1])[0]
    pose = {"translation": there[:3, 3].tolist(), "quaternion_xyzw": [1.0, 0.0, 0.0, 0.0]}
    goal = {"pose": pose, "tolerance_m": 0.002, "tolerance_rad": 0.01, "free_z_rotation": True}
    ends = []
    for seed in range(3):
        found = planned(picture, START, goal_pose=goal, seed=seed, ways=1)
        assert found.status == "solved", found.reason
        (end,) = ARM.tool_frames(found.path[-1:])
        assert np.linalg.norm(end[:3, 3] - there[:3, 3]) <= 0.002
        assert np.arccos(min(1.0, -end[2, 2])) <= 0.01
        ends.append(end)
    assert max(angle_rad(end[:3, :3], np.diag([1.0, -1.0, -1.0])) for end in ends) > 0.05


def test_a_pose_that_cannot_be_had_is_refused_with_the_reason(picture, downward):
    far = np.eye(4)
    far[:3, 3] = 3.0, 0.0, 0.5
    found = planned(picture, START, goal_pose={"pose": far.tolist()})
    assert (found.status, found.path.shape) == ("refused", (0, 7))
    assert "the tool cannot reach goal_pose" in found.reason
    # Surfaces everywhere.
    blocked = np.zeros_like(picture)
    there = {"pose": ARM.tool_frames(downward[1:])[0].tolist()}
    assert "touches" in planned(blocked, START, goal_pose=there).reason
    limits = [(angle - 0.05, angle + 0.05) for angle in START]
    assert "cannot reach" in planned(picture, START, goal_pose=there, limits=limits).reason


def test_all_states_keep_to_narrower_limits_that_a_path_would_leave_otherwise(picture, downward):
    start, goal = downward
    lowest = min(start[3], goal[3]) - 0.02

    def bowed(rows):
        """Surer where a joint is bent more than at both ends."""
        return np.where(rows[:, 3] < lowest - 0.08, 0.999, 0.3).astype(np.float32), None

    free = planned(picture, start, goal, predict=bowed)
    assert free.path[:, 3].min() < lowest
    limits = [None] * 3 + [(lowest, SPACE.upper[3])] + [None] * 3
    kept = planned(picture, start, goal, predict=bowed, limits=limits, alternatives=True)
    assert kept.status == "solved"
    assert len(kept.alternatives) > 1
    for path in (kept.path, *(one.path for one in kept.alternatives)):
        assert np.allclose(path[[0, -1]], [start, goal], atol=1e-6)
        assert (spaced(path, SPACE, DENSE_RAD)[:, 3] >= lowest).all()


def test_a_circle_is_gone_round_where_limits_let_it_and_unwrapped_without_a_jump(picture, downward):
    own = [joint.limits_rad for joint in ARM.joints]
    world = replace(WORLD, body=ARM.with_limits([None, *own[1:]]))
    first, second = turned(START, 2.6), turned(START, -2.6)
    nothing = np.stack([np.full(picture.shape[:3], 255, np.uint8), picture[..., 1]], axis=-1)
    short = planned(nothing, first, second, world=world)
    assert short.length_rad == pytest.approx(2.0 * np.pi - 5.2, abs=0.01)
    assert np.abs(np.diff(short.path[:, 0])).max() > np.pi
    for turns in (0, -2):
        sent = turned(first, 2.0 * np.pi * turns)
        going_on = planned(nothing, sent, second, world=world, unwrapped=True, alternatives=True)
        assert going_on.path[-1, 0] == pytest.approx(sent[0] + 2.0 * np.pi - 5.2, abs=1e-6)
        for path in (going_on.path, *(one.path for one in going_on.alternatives)):
            assert np.allclose(path[0], sent, atol=1e-6)
            assert np.abs(np.diff(path[:, 0])).max() < np.pi
            assert np.allclose(world.space.wrap(path[[0, -1]]), [first, second], atol=1e-6)
    long = planned(nothing, first, second, world=world, limits=[(-2.7, 2.7), *[None] * 6])
    assert long.length_rad >= 5.2 - 1e-6
    assert np.abs(long.path[:, 0]).max() <= 2.7
    beyond = planned(nothing, first, turned(second, 2.0 * np.pi), world=world, limits=[(2, 4), *[None] * 6])
    assert beyond.length_rad == pytest.approx(short.length_rad, abs=0.01)
    assert (beyond.path[:, 0] >= 2.0).all()
    assert (beyond.path[:, 0] <= 4.0).all()


@pytest.mark.parametrize("max_rad", [0.15, 0.4])
def test_the_tool_stays_upright_in_every_state(picture, downward, max_rad):
    start, goal = downward
    found = planned(picture, start, goal, upright=DOWN | {"max_rad": max_rad}, alternatives=True)
    assert found.status == "solved"
    for path in (found.path, *(one.path for one in found.alternatives)):
        assert np.allclose(path[[0, -1]], [start, goal], atol=1e-6)
        assert tilt_rad(spaced(path, SPACE, DENSE_RAD)).max() <= max_rad
    if max_rad == 0.15:
        free = planned(picture, start, goal)
        assert tilt_rad(spaced(free.path, SPACE, DENSE_RAD)).max() > max_rad
        pose = {"pose": ARM.tool_frames(goal[None])[0].tolist()}
        posed = planned(picture, start, goal_pose=pose, upright=DOWN | {"max_rad": max_rad})
        assert posed.status == "solved"
        assert tilt_rad(spaced(posed.path, SPACE, DENSE_RAD)).max() <= max_rad


def test_an_end_that_is_not_upright_is_refused_with_its_angle(picture, downward):
    tilted = turned(downward[0], 0.3, joint=5)
    (angle,) = tilt_rad(tilted[None])
    for name, ends in (("start", (tilted, downward[1])), ("goal", (downward[1], tilted))):
        found = planned(picture, *ends, upright=DOWN | {"max_rad": 0.2})
        assert (found.status, found.path.shape) == ("refused", (0, 7))
        assert name in found.reason
        assert f"{angle:.3f} rad" in found.reason


def limited(second):
    return {"goal": START, "limits": [None, second, *[None] * 5]}


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"goal": START, "limits": [None]}, "7 entries"),
        (limited((-2.0, 1.9)), "limits do not fit panda_joint2"),
        (limited((0.3, 0.3)), "limits do not fit panda_joint2"),
        (limited((0.4, 0.3)), "limits do not fit panda_joint2"),
        (limited((np.nan, 1.0)), "limits do not fit panda_joint2"),
        (limited((0.0, 1.0)), "start lies outside the limits of this request.*panda_joint2"),
        (
            {"goal": turned(START, 0.5), "limits": [(-0.1, 0.1), *[None] * 6]},
            "goal lies outside the limits of this request.*panda_joint1",
        ),
        ({"goal_pose": {"pose": [[1.0]]}}, "goal_pose has no pose"),
        ({"goal_pose": {}}, "goal_pose: pose is missing"),
        ({"goal_pose": {"pose": np.eye(4).tolist(), "tolerance_m": 0.0}}, "goal_pose: tolerance_m"),
        ({"goal_pose": {"pose": np.diag([1.0, 1, -1, 1]).tolist()}}, "goal_pose has a pose that is no rot"),
        ({"goal": START, "upright": {"axis": [0, 0, 0], "max_rad": 0.1}}, r"upright.axis is no direction"),
        ({"goal": START, "upright": {"axis": [0, 0, 1], "max_rad": 4.0}}, "upright: max_rad"),
        ({"goal": START, "upright": {"axis": [0, 0, 1]}}, "upright: max_rad is missing"),
        ({"goal": START, "goal_pose": {"pose": np.eye(4).tolist()}}, "got both"),
        ({}, "got neither"),
    ],
)
def test_constraints_that_are_none_are_told_by_their_name(picture, fields, words):
    with pytest.raises(InputError, match=words):
        planned(picture, START, **fields)


def test_a_robot_without_a_tool_has_no_such_constraints():
    spec, start = replace(SPEC, world=examples()["two-link"]), (0.0, 0.0)
    pose = {"pose": np.eye(4).tolist()}
    for fields in ({"goal": None, "goal_pose": pose}, {"goal": start, "upright": DOWN | {"max_rad": 0.1}}):
        with pytest.raises(InputError, match="no tool frame"):
            fitted_problem(spec, PlanQuery(start, **fields))
    fitted_problem(spec, PlanQuery(start, start, limits=((-1.0, 1.0), None), unwrapped=True))
