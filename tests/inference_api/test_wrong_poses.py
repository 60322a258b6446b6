"""Twenty scenes with the arm in view, sent to ``/plan`` as they are and with what users get wrong."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count, islice

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray

from cspace.simulator import Split
from cspace.worlds import examples
from cspace.worlds.spatial.hypotheses import Request
from cspace.worlds.spatial.poses import make_pose, turn
from cspace.worlds.spatial.scenes import draw_scene
from tests.cspace.worlds.spatial.test_diagnosis import order_wxyz
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.test_bad_pictures import START, ask, camera_of

SCENES = 20
Pose = NDArray[np.float64]


@dataclass(frozen=True)
class Seen:
    depth_mm: NDArray[np.uint16]
    camera: dict[str, float]
    pose: Pose
    state: tuple[float, ...]


def seen_arms() -> Iterator[Seen]:
    """First pictures of scenes that show most of the arm."""
    world, rng = examples()["panda"], np.random.default_rng(17)
    for index in count():
        view = draw_scene(rng, world, Split.DEMO, index).view()
        camera, state = view.cameras[0], view.states[0]
        if state is None:
            continue
        request = Request(world.body, view.pictures[0].astype(float), camera, state)
        if request.score().arm > 0.5:
            intrinsics = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
            yield Seen(view.pictures[0], intrinsics, camera.matrix, tuple(state))


@pytest.fixture(scope="module")
def scenes() -> list[Seen]:
    return list(islice(seen_arms(), SCENES))


def planned(api: ApiClient, seen: Seen, pose: Pose, **fields: str) -> httpx.Response:
    ends = {"start": json.dumps(seen.state), "goal": json.dumps(START), "seed": "1"}
    camera = camera_of(pose, **seen.camera)
    return ask(api, "/plan", [seen.depth_mm], [camera], state=json.dumps(seen.state), **ends, **fields)


def refused(answer: httpx.Response) -> bool:
    return answer.status_code == 422 and answer.json()["type"].endswith("invalid-image")


@pytest.mark.slow
def test_right_poses_are_planned_as_without_the_check(panda_api: ApiClient, scenes: list[Seen]) -> None:
    for seen in scenes:
        checked = planned(panda_api, seen, seen.pose)
        unchecked = planned(panda_api, seen, seen.pose, check_pose="false")
        assert checked.status_code == unchecked.status_code == 200
        assert checked.json()["status"] == unchecked.json()["status"]


WRONG: dict[str, tuple[Callable[[Pose], Pose], str]] = {
    "inverted-pose": (np.linalg.inv, "base in the camera"),
    "opengl-frame": (lambda pose: pose @ np.diag([1.0, -1.0, -1.0, 1.0]), "OpenGL"),
    "quaternion-order": (order_wxyz, "quaternion"),
}


@pytest.mark.slow
@pytest.mark.parametrize("cause", WRONG)
def test_wrong_poses_are_refused_with_their_cause(
    panda_api: ApiClient, scenes: list[Seen], cause: str
) -> None:
    make_wrong, words = WRONG[cause]
    for seen in scenes:
        problem = assert_problem(planned(panda_api, seen, make_wrong(seen.pose)), 422, "invalid-image")
        assert words in json.dumps(problem)


@pytest.mark.slow
@pytest.mark.parametrize("scale", ["0.01", "0.0001"])
def test_depths_in_a_wrong_unit_are_refused(panda_api: ApiClient, scenes: list[Seen], scale: str) -> None:
    for seen in scenes:
        assert refused(planned(panda_api, seen, seen.pose, depth_scale_m=scale))


@pytest.mark.slow
def test_most_cameras_that_are_ten_degrees_off_are_refused(panda_api: ApiClient, scenes: list[Seen]) -> None:
    turned = [
        make_pose(turn(tuple(np.eye(3)[number % 3]), np.radians(10)) @ seen.pose[:3, :3], seen.pose[:3, 3])
        for number, seen in enumerate(scenes)
    ]
    answers = [refused(planned(panda_api, *one)) for one in zip(scenes, turned, strict=True)]
    assert sum(answers) >= 0.85 * SCENES
