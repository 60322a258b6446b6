import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.world import Disc, Scenario

LIMITED = PlanarArm(joint_limits_rad=(None, (-2.0, 2.5)))
LONG = PlanarArm((1.0, 0.8, 0.7, 0.9, 0.6), 0.05, (None, None, (-2.5, 3.0), None, None))
ROBOTS = st.sampled_from([TWO_LINK, THREE_LINK, LIMITED, LONG])
# Nearer to contact than this, the order of the additions decides.
ROUNDING_M = 1e-9

coordinates = st.floats(-5.0, 5.0)
disc_lists = st.lists(
    st.builds(Disc, coordinates, coordinates, st.floats(0.1, 2.0)), min_size=0, max_size=4
).map(tuple)
angles = st.floats(-7.0, 7.0) | st.sampled_from([0.0, np.pi / 2, np.pi, -np.pi])


def reference_clearance(scenario, q):
    """Plain numpy, one link and one disc at a time: distance of a point to a segment, less both radii."""
    points = np.zeros((scenario.robot.dim + 1, 2))
    for joint, length in enumerate(scenario.robot.link_lengths_m):
        heading = np.sum(q[: joint + 1])
        points[joint + 1] = points[joint] + length * np.array([np.cos(heading), np.sin(heading)])
    gaps = [np.inf]
    for tail, head in itertools.pairwise(points):
        for disc in scenario.discs:
            centre = np.array([disc.x_m, disc.y_m])
            share = np.clip(np.dot(centre - tail, head - tail) / np.dot(head - tail, head - tail), 0.0, 1.0)
            nearest = tail + share * (head - tail)
            gaps.append(np.linalg.norm(centre - nearest) - disc.radius_m - scenario.robot.half_width_m)
    return min(gaps)


def within_limits(scenario, q):
    limits = scenario.robot.joint_limits_rad or (None,) * scenario.robot.dim
    return all(lim is None or lim[0] <= value <= lim[1] for lim, value in zip(limits, q, strict=True))


@st.composite
def scenes(draw):
    robot = draw(ROBOTS)
    q = np.array([draw(angles) for _ in range(robot.dim)])
    return Scenario(robot, draw(disc_lists)), q


@given(scenes())
@settings(deadline=None, max_examples=150)
def test_clearance_is_the_distance_of_capsules_and_discs_and_free_is_what_has_some_within_limits(scene):
    scenario, q = scene
    checker, expected = CollisionChecker(scenario), reference_clearance(scenario, q)
    assert checker.clearance(q[None])[0] == pytest.approx(expected, abs=1e-9)
    assume(abs(expected) > ROUNDING_M)
    assert checker.valid(q) == (expected > 0.0 and within_limits(scenario, q))


@given(scenes(), st.data(), st.sampled_from([0.05, 0.2, 1.0]))
@settings(deadline=None, max_examples=60)
def test_an_edge_is_free_when_all_its_states_are(scene, data, resolution):
    scenario, a = scene
    b = np.array([data.draw(angles) for _ in range(scenario.robot.dim)])
    path = scenario.robot.space.difference(a, b)
    count = max(1, int(np.ceil(np.abs(path).max() / resolution)))
    states = [a + path * share for share in np.linspace(0.0, 1.0, count + 1)]
    clearances = np.array([reference_clearance(scenario, q) for q in states])
    assume(np.abs(clearances).min() > ROUNDING_M)
    expected = bool((clearances > 0.0).all()) and all(within_limits(scenario, q) for q in states)
    checker = CollisionChecker(scenario)
    assert checker.edge(a, b, resolution) == expected
    assert checker.edge_test(resolution)(a, b)[0] == expected


@pytest.mark.parametrize(
    ("robot", "start", "goal", "is_free"),
    [
        (TWO_LINK, [-0.2, 0.0], [0.2, 0.0], True),
        (TWO_LINK, [3.0, 0.0], [-3.0, 0.0], True),
        (TWO_LINK, [0.5, 0.0], [2.6, 0.0], False),
        # The short way would leave the limits, the straight one passes the disc.
        (PlanarArm(joint_limits_rad=((-3.1, 3.1), None)), [3.0, 0.0], [-3.0, 0.0], False),
    ],
)
def test_an_edge_takes_the_shorter_way_round_a_circle_and_none_round_a_limited_joint(
    robot, start, goal, is_free
):
    # At an angle of pi the first link points at (-2, 0); a disc above the base blocks the other way.
    assert CollisionChecker(Scenario(robot, (Disc(0.0, 3.0),))).edge(start, goal, 0.02) == is_free
