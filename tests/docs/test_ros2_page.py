"""The ROS 2 node of the integrations page: depth pictures, and what goes wrong."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cspace.simulator import Split
from cspace.worlds import examples, picture_file_of, simulator_of
from cspace.worlds.spatial.view import read_view
from cspace_client.wire import Trajectory
from inference_api.settings import PRETRAINED_FOLDER
from tests.docs import ros
from tests.docs.blocks import ROOT, Kind, blocks
from tests.inference_api.server import api_server

PAGE = ROOT / "docs" / "integrations.md"
JOINTS = [f"panda_joint{number}" for number in range(1, 8)]


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """The names that the page's block makes."""
    ros.install()
    (block,) = (found for found in blocks(PAGE) if found.kind is Kind.PYTHON)
    names: dict[str, Any] = {}
    exec(block.source, names)  # noqa: S102 - the documents are the project's own
    return names


def image_of(page: dict[str, Any], pixels: np.ndarray[Any, Any], encoding: str, padding: int = 0) -> Any:
    """A message whose rows are longer than its pixels."""
    rows = pixels.reshape(len(pixels), -1).view(np.uint8)
    padded = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    height, width = pixels.shape[:2]
    shape = {"height": height, "width": width, "step": padded.shape[1]}
    return page["Image"](encoding=encoding, data=padded.tobytes(), **shape)


@pytest.mark.parametrize("padding", [0, 4])
def test_depth_in_metres_and_in_millimetres_keeps_its_pixels(page: dict[str, Any], padding: int) -> None:
    metres = np.array([[0.5, np.nan, 1.25], [np.inf, 0.0, 70.0]], dtype=np.float32)
    millimetres = np.array([[500, 0, 1250], [0, 0, 65535]], dtype=np.uint16)
    for pixels, encoding in ((metres, "32FC1"), (millimetres, "16UC1")):
        found = page["depth_of"](image_of(page, pixels, encoding, padding))
        assert found.dtype == pixels.dtype
        assert np.array_equal(found, pixels, equal_nan=pixels.dtype == np.float32)


def test_a_trajectory_becomes_a_message(page: dict[str, Any]) -> None:
    node = page["Planner"]("http://127.0.0.1:9", ["joint"], np.eye(4).tolist())
    found = {"times_s": [0.0, 0.5, 2.25], "positions": [[3.0], [3.25], [2.0]], "velocities": [[0], [-1], [0]]}
    points = node.message(Trajectory.model_validate(found)).points
    assert [(point.positions, point.velocities) for point in points] == [
        ([3.0], [0.0]), ([3.25], [-1.0]), ([2.0], [0.0])
    ]  # fmt: skip
    times = [(point.time_from_start.sec, point.time_from_start.nanosec) for point in points]
    assert times == [(0, 0), (0, 500_000_000), (2, 250_000_000)]


def test_a_goal_before_the_first_picture_or_without_a_server_is_told(page: dict[str, Any]) -> None:
    node = page["Planner"]("http://127.0.0.1:9", ["a", "b"], np.eye(4).tolist())
    goal = page["JointState"](name=["a", "b"], position=[0.0, 0.0])
    node.on_goal(goal)
    node.client = page["SamplingClient"]("http://127.0.0.1:9", 1.0, retries=0)
    node.on_image(image_of(page, np.full((48, 48), 900, np.uint16), "16UC1"))
    node.on_camera(
        page["CameraInfo"](width=48, height=48, k=[48.0, 0.0, 23.5, 0.0, 48.0, 23.5, 0.0, 0.0, 1.0])
    )
    node.on_state(goal)
    node.on_goal(goal)
    assert node.published == []
    assert "no picture" in node.warnings[0]
    assert "127.0.0.1:9" in node.warnings[1]


@pytest.fixture
def space_api(tmp_path: Path) -> Iterator[str]:
    arm = PRETRAINED_FOLDER.with_name("pretrained_panda")
    with api_server(tmp_path, {"CSPACE_PRETRAINED_MODEL": str(arm)}) as found:
        yield found


@pytest.mark.slow
@pytest.mark.e2e
@pytest.mark.timeout(600)
def test_a_depth_picture_and_a_goal_become_a_trajectory_of_seven_joints(
    page: dict[str, Any], space_api: str
) -> None:
    world = examples()["panda"]
    problem = simulator_of(world).problem("shelf", Split.DEMO, 12)
    taken = read_view(picture_file_of(problem.scenario), world.body)
    values = taken.cameras[0].to_dict()
    k = [values["fx"], 0.0, values["cx"], 0.0, values["fy"], values["cy"], 0.0, 0.0, 1.0]
    pose = values["pose"]
    node = page["Planner"](space_api, JOINTS, pose, model="pretrained", min_confidence=0.0, time_limit_s=10.0)
    node.on_camera(page["CameraInfo"](width=values["width"], height=values["height"], k=k))
    node.on_image(image_of(page, taken.pictures[0], "16UC1"))
    node.on_state(page["JointState"](name=JOINTS[::-1], position=problem.start[::-1].tolist()))
    node.on_goal(page["JointState"](name=JOINTS, position=problem.goal.tolist()))
    node.client.close()
    assert node.warnings == []
    points = [point.positions for point in node.published[0].points]
    assert np.allclose(points[0], problem.start, atol=1e-3)
    assert np.allclose(points[-1], problem.goal, atol=1e-3)
    assert {len(point) for point in points} == {7}
    assert not any(node.published[0].points[-1].velocities)
