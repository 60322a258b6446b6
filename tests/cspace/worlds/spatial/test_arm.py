"""Serial arms; ``vamp_panda.json`` is the Panda's model of 59 spheres of KavrakiLab/vamp (Apache-2.0)."""

import json
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest

from cspace.errors import ScenarioError
from cspace.worlds.spatial.arm import Joint, Part, SerialArm
from cspace.worlds.spatial.poses import Frame

TEXT = Path(__file__).with_name("vamp_panda.json").read_text(encoding="utf-8")
PANDA = SerialArm.from_dict(json.loads(TEXT))
ELBOW = SerialArm(
    "elbow",
    (Joint("shoulder", Frame((0.0, 0.0, 0.5))), Joint("elbow", Frame((1.0, 0.0, 0.0)), (0.0, 1.0, 0.0))),
    (Part("upper", 1, ((0.5, 0.0, 0.0, 0.1),)), Part("lower", 2, ((0.0, 0.0, 1.0, 0.2),))),
    (("upper", "lower"),),
    Frame((0.0, 0.0, 1.0)),
)
READY = [0.0, -pi / 4, 0.0, -3 * pi / 4, 0.0, pi / 2, pi / 4]


def test_the_tool_of_an_elbow_is_where_a_drawing_puts_it() -> None:
    tools = ELBOW.tool_frames([[0.0, 0.0], [pi / 2, 0.0], [0.0, pi / 2], [pi / 2, pi / 2]])[:, :3, 3]
    np.testing.assert_allclose(tools, [[1, 0, 1.5], [0, 1, 1.5], [2, 0, 0.5], [0, 2, 0.5]], atol=1e-12)


def test_pandas_tool_is_where_its_maker_says() -> None:
    stretched, ready = PANDA.tool_frames([[0.0] * 7, READY])
    np.testing.assert_allclose(stretched[:3, 3], [0.088, 0.0, 1.033 - 0.2104], atol=1e-12)
    np.testing.assert_allclose(ready[:3, 3], [0.3069, 0.0, 0.4869], atol=1e-4)
    np.testing.assert_allclose(ready[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-12)


def test_spheres_move_with_their_links() -> None:
    centres = ELBOW.sphere_centres_m([[0.0, 0.0], [pi / 2, pi / 2]])
    np.testing.assert_allclose(
        centres, [[[0.5, 0, 0.5], [1, 0, 1.5]], [[0, 0.5, 0.5], [0, 2, 0.5]]], atol=1e-12
    )
    assert PANDA.sphere_count == len(PANDA.sphere_links()) == 59
    assert PANDA.sphere_centres_m(np.zeros((3, 7))).shape == (3, 59, 3)


def test_no_sphere_is_beyond_the_reach() -> None:
    rng = np.random.default_rng(0)
    centres = PANDA.sphere_centres_m(rng.uniform(-pi, pi, (200, 7)))
    reached = (np.linalg.norm(centres, axis=-1) + PANDA.spheres_m()[:, 3]).max()
    assert 0.8 * PANDA.reach_m < reached < PANDA.reach_m


def test_what_is_written_is_read_again_and_equal_arms_are_one() -> None:
    again = SerialArm.from_dict(json.loads(json.dumps(PANDA.to_dict())))
    assert again == PANDA
    assert len({again, PANDA, ELBOW}) == 2
    assert replace(PANDA, touching=()) != PANDA


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "planar_arm"},
        {"colour": "white"},
        {"joints": []},
        {"joints": [{"name": "one", "axis": [0, 0, 2]}], "parts": [], "touching": []},
        {"joints": [{"name": "one", "limits_rad": [1, 1]}], "parts": [], "touching": []},
        {"joints": [{"name": "one", "limits_rad": [0, 2000]}], "parts": [], "touching": []},
        {"touching": [["panda_link0", "panda_link9"]]},
        {"touching": [["panda_hand", "panda_link7"]]},
        {"touching": [["panda_link0", "panda_link5"], ["panda_link5", "panda_link0"]]},
        {"parts": [{"name": "a", "link": 8, "spheres_m": [[0, 0, 0, 1]]}], "touching": []},
        {"parts": [{"name": "a", "link": 0, "spheres_m": [[0, 0, 0, 0]]}], "touching": []},
    ],
)
def test_a_description_is_read_strictly(change: dict[str, object]) -> None:
    with pytest.raises(ScenarioError):
        SerialArm.from_dict(json.loads(TEXT) | change)


@pytest.mark.parametrize("pitch", [0.3, -pi / 2])
def test_a_frame_is_its_matrix(pitch: float) -> None:
    matrix = Frame((1.0, 2.0, 3.0), (0.4, pitch, -2.5)).matrix()
    np.testing.assert_allclose(Frame.of(matrix).matrix(), matrix, atol=1e-12)
