import json
from pathlib import Path

import numpy as np

import cspace.worlds.spatial
from cspace.worlds.spatial.robot.arm import SerialArm
from cspace.worlds.spatial.robot.kinematics import arm_arrays, self_distance_batch

ROBOTS = Path(cspace.worlds.spatial.__file__).with_name("robots")
PANDA = SerialArm.from_dict(json.loads((ROBOTS / "panda.json").read_bytes()))
# Of KavrakiLab/vamp, Apache-2.0.
VAMP = SerialArm.from_dict(json.loads(Path(__file__).with_name("vamp_panda.json").read_bytes()))
READY = [[0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]]


def test_the_panda_moves_as_another_description_of_it_does() -> None:
    q = np.random.default_rng(0).uniform(VAMP.space.lower, VAMP.space.upper, (100, 7))
    np.testing.assert_allclose(PANDA.link_frames(q), VAMP.link_frames(q), atol=1e-9)
    np.testing.assert_allclose(PANDA.tool_frames(q), VAMP.tool_frames(q), atol=1e-9)
    assert PANDA.space == VAMP.space


def test_the_pandas_spheres_hold_those_of_a_model_that_lies_inside_it() -> None:
    centres, own = VAMP.spheres_m()[:, :3], PANDA.spheres_m()
    same_link = VAMP.sphere_links()[:, None] == PANDA.sphere_links()
    gaps = np.linalg.norm(centres[:, None] - own[:, :3], axis=-1) - own[:, 3]
    assert np.where(same_link, gaps, np.inf).min(axis=1).max() < 0.0


def test_the_panda_is_clear_of_itself_where_it_starts_and_holds_its_wrist_apart() -> None:
    assert self_distance_batch(np.asarray(READY), arm_arrays(PANDA))[0] > 0.0
    pairs = {frozenset(pair) for pair in PANDA.touching}
    assert {"panda_link5", "panda_hand"} in pairs
    assert {"panda_link5", "panda_link7"} in pairs
    assert not any({"panda_link4", "panda_link5"} == pair for pair in pairs)
