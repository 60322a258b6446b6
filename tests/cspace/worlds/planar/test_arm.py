import json
from math import inf, pi, sqrt

import numpy as np
import pytest

from cspace.errors import ScenarioError
from cspace.worlds import robot_digest
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.world import PlanarWorld


def test_two_links_reach_where_they_point():
    positions = TWO_LINK.joint_positions_m([[0.0, 0.0], [pi / 2, 0.0], [pi / 2, -pi / 2], [pi / 4, pi / 2]])
    assert positions.shape == (4, 3, 2)
    np.testing.assert_allclose(positions[:, 0], 0.0)
    np.testing.assert_allclose(positions[:, 1], [[2, 0], [0, 2], [0, 2], [sqrt(2), sqrt(2)]], atol=1e-12)
    np.testing.assert_allclose(positions[:, 2], [[4, 0], [0, 4], [2, 2], [0, 2 * sqrt(2)]], atol=1e-12)


def test_joints_are_circles_unless_they_have_limits():
    space = PlanarArm(joint_limits_rad=(None, (-1.0, 2.0))).space
    assert space.periodic == (True, False)
    assert (space.lower, space.upper) == ((-pi, -1.0), (pi, 2.0))
    beyond = PlanarArm(joint_limits_rad=((-7.0, 4.0), None)).space
    assert (beyond.lower[0], beyond.upper[0], beyond.periodic) == (-7.0, 4.0, (False, True))


@pytest.mark.parametrize("arm", [TWO_LINK, THREE_LINK, PlanarArm(joint_limits_rad=(None, (-1.0, 2.0)))])
def test_a_robot_survives_json(arm):
    assert PlanarArm.from_dict(json.loads(json.dumps(arm.to_dict()))) == arm


@pytest.mark.parametrize(
    "values",
    [
        {"link_lengths_m": ()},
        {"link_lengths_m": (1.0, 0.0)},
        {"link_lengths_m": (1.0, inf)},
        {"half_width_m": 0.0},
        {"joint_limits_rad": (None,)},
        {"joint_limits_rad": (None, (1.0, 1.0))},
        {"joint_limits_rad": (None, (-4000.0, 1.0))},
        {"joint_limits_rad": (None, (1.0, 1.0 + 1e-7))},
    ],
)
def test_a_robot_that_cannot_be_is_an_error(values):
    with pytest.raises(ScenarioError, match="expected"):
        PlanarArm(**values)


def test_the_digests_of_robots_are_what_they_were():
    digests = [robot_digest(PlanarWorld(arm))[:16] for arm in (TWO_LINK, THREE_LINK)]
    assert digests == ["14c4c4a2dfa4d819", "0f5028b4ee2dd87b"]
