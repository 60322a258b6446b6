import json
from pathlib import Path

import numpy as np

import cspace.worlds.spatial
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.benchmark import LIMITS_RAD
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.obstacles import Obstacles

ROBOTS = Path(cspace.worlds.spatial.__file__).with_name("robots")
PANDA = SerialArm.from_dict(json.loads((ROBOTS / "panda.json").read_bytes()))
# Of KavrakiLab/vamp, Apache-2.0.
VAMP = SerialArm.from_dict(json.loads(Path(__file__).with_name("vamp_panda.json").read_bytes()))
UR5 = SerialArm.from_dict(json.loads((ROBOTS / "ur5.json").read_bytes()))
READY = [[0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]]


def test_the_panda_moves_as_another_description_of_it_does() -> None:
    q = np.random.default_rng(0).uniform(VAMP.space.lower, VAMP.space.upper, (100, 7))
    np.testing.assert_allclose(PANDA.link_frames(q), VAMP.link_frames(q), atol=1e-9)
    np.testing.assert_allclose(PANDA.tool_frames(q), VAMP.tool_frames(q), atol=1e-9)
    assert PANDA.with_limits(LIMITS_RAD).space == VAMP.space


def test_the_pandas_spheres_hold_those_of_a_model_that_lies_inside_it() -> None:
    centres, own = VAMP.spheres_m()[:, :3], PANDA.spheres_m()
    same_link = VAMP.sphere_links()[:, None] == PANDA.sphere_links()
    gaps = np.linalg.norm(centres[:, None] - own[:, :3], axis=-1) - own[:, 3]
    assert np.where(same_link, gaps, np.inf).min(axis=1).max() < 0.0


def test_the_panda_is_clear_of_itself_where_it_starts_and_its_pairs_are_those_of_its_srdf() -> None:
    assert CollisionChecker(PANDA, Obstacles()).clearance(READY)[0] > 0.0
    pairs = {frozenset(pair) for pair in PANDA.touching}
    assert {"panda_link5", "panda_leftfinger"} in pairs
    for disabled in ("panda_hand", "panda_link7", "panda_link4"):
        assert {"panda_link5", disabled} not in pairs


def test_the_ur5_has_the_geometry_of_its_makers_table() -> None:
    """Denavit-Hartenberg parameters: d1 0.08916, a2 0.425, a3 0.39225, d4 0.10915, d5 0.09465, d6 0.0823."""
    up, ready = UR5.tool_frames([[0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0], UR5.ready_rad])
    # Both to the maker's digits: the arm upright, and with its elbow at a right angle.
    np.testing.assert_allclose(up[:3, 3], [0.0, 0.19145, 0.08916 + 0.425 + 0.39225 + 0.09465], atol=2e-4)
    np.testing.assert_allclose(ready[:3, 3], [0.39225 + 0.09465, 0.10915, 0.43186], atol=2e-4)
    assert CollisionChecker(UR5, Obstacles()).clearance([UR5.ready_rad])[0] > 0.0
